"""A campaign's evaluation: rainflow and damage against closed forms, intervals against what they claim."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd
import pytest

from optimisation.campaign.fatigue import combined, damage_equivalent_load, wind_bins
from optimisation.campaign.intervals import estimate
from optimisation.campaign.paper import beside_paper, paper_figures
from optimisation.campaign.runs import COLUMNS, stop_hits
from optimisation.campaign.spectra import mean_spectrum
from optimisation.campaign.tables import LIFETIME, extremes, fatigue, gumbel, levels, ranking, suppression

RATES = {"tmd-n": 5.0, "tmd-p": 9.0, "mtmd": 15.0}  # %


def table_of(
    seeds: int, scatter: float = 1.0, cases: tuple[str, ...] = ("lc1",), shared: float = 0.1, random_state: int = 7
) -> pd.DataFrame:
    """Runs whose suppression rates are `RATES`, with a `scatter` (points) between seeds.

    Args:
        shared: scatter of what all arrangements of a seed have in common (wind and sea), as a share.
    """
    generator = np.random.default_rng(random_state)
    rows: list[dict[str, Any]] = []
    for case in cases:
        for seed in range(seeds):
            sea = 2.0 * (1.0 + shared * generator.standard_normal())
            for damper in ("none", *RATES):
                rate = RATES.get(damper, 0.0) + (scatter * generator.standard_normal() if damper in RATES else 0.0)
                value = sea * (1.0 - rate / 100.0)
                row = dict.fromkeys(COLUMNS, math.nan) | {"case": case, "damper": damper, "seed": seed}
                row |= {"channel": "TwrBsMyt", "unit": "kN.m", "std": value, "rms": value, "max": 3.0 * value}
                rows.append(row | {"min": -2.0 * value, "mean": 0.0, "del": 4.0 * value})
    return pd.DataFrame(rows, columns=COLUMNS)


@pytest.mark.parametrize("exponent", [3.0, 4.0, 10.0])
def test_a_sinusoid_of_the_equivalent_frequency_is_equivalent_to_its_own_range(exponent: float) -> None:
    """One cycle a second of range 2 a: DEL = 2 a. 600 cycles less the halves at both ends: below 1e-3 of a load."""
    time = np.arange(0.0, 600.0 + 1e-9, 0.0125)
    assert damage_equivalent_load(5.0 * np.sin(2.0 * np.pi * time), 600.0, exponent) == pytest.approx(10.0, rel=1e-3)


def test_damage_scales_with_load_and_time_and_ignores_the_mean() -> None:
    """DEL is homogeneous of first degree; a record said twice as long does half the damage; a mean does none."""
    generator = np.random.default_rng(3)
    load = np.convolve(generator.standard_normal(6000), np.ones(40) / 40.0)
    once = damage_equivalent_load(load, 600.0, 4.0)
    assert damage_equivalent_load(1e6 * load + 1e7, 600.0, 4.0) == pytest.approx(1e6 * once, rel=1e-9)
    assert damage_equivalent_load(load, 1200.0, 4.0) == pytest.approx(once / 2.0**0.25, rel=1e-12)
    assert damage_equivalent_load(np.full(100, 7.0), 600.0, 10.0) == 0.0


def test_rainflow_counts_the_standards_example() -> None:
    """ASTM E1049-85, figure 6: ranges 3, 4, 6, 8, 9 with 0.5, 1.5, 0.5, 1.0, 0.5 cycles."""
    counts = {3.0: 0.5, 4.0: 1.5, 6.0: 0.5, 8.0: 1.0, 9.0: 0.5}
    load = damage_equivalent_load([-2, 1, -3, 5, -1, 3, -4, 4, -2], 1.0, 4.0)
    assert load == pytest.approx(sum(n * s**4 for s, n in counts.items()) ** 0.25, rel=1e-12)


def test_wind_bins_share_out_the_operating_time() -> None:
    """Rayleigh about 10 m/s: the share below V is 1 - exp(-pi/4 (V/10)^2); bins part halfway between the cases."""
    bins = wind_bins({"lc5": 24.0, "lc1": 4.0, "lc2": 8.0, "lc3": 12.0, "lc4": 18.0})
    assert bins["case"].tolist() == ["lc1", "lc2", "lc3", "lc4", "lc5"]
    edges = [3.0, 6.0, 10.0, 15.0, 21.0, 25.0]
    below = [1.0 - math.exp(-math.pi / 4.0 * (v / 10.0) ** 2) for v in edges]
    operating = below[-1] - below[0]
    assert bins.attrs["operating"] == pytest.approx(operating)
    assert bins["weight"].tolist() == pytest.approx([(b - a) / operating for a, b in pairwise(below)])
    with pytest.raises(ValueError, match="storm at 30 m/s"):
        wind_bins({"storm": 30.0})
    with pytest.raises(ValueError, match="leave one out"):
        wind_bins({"a": 8.0, "b": 8.0})


def test_a_lifetime_of_equal_loads_is_that_load_and_the_largest_counts_most() -> None:
    assert combined([5.0, 5.0, 5.0], [0.2, 0.5, 0.3], 10.0) == pytest.approx(5.0)
    assert combined([1.0, 10.0], [0.9, 0.1], 4.0) == pytest.approx((0.9 + 0.1 * 1e4) ** 0.25)
    table = table_of(6, scatter=0.5, cases=("lc1", "lc2"))
    found = fatigue(table, {"lc1": 4.0, "lc2": 8.0}).set_index(["case", "damper"])
    # A rate that is the same in every case is that of the lifetime; 0.5 points of scatter over 6 seeds: 0.2, thrice.
    assert found.loc[(LIFETIME, "mtmd"), "reduction"] == pytest.approx(RATES["mtmd"], abs=0.6)
    assert found.loc[(LIFETIME, "mtmd"), "seeds"] == 6
    lacking = table[~((table["case"] == "lc2") & (table["damper"] == "mtmd"))]
    assert (LIFETIME, "mtmd") not in fatigue(lacking, {"lc1": 4.0, "lc2": 8.0}).set_index(["case", "damper"]).index


@pytest.mark.parametrize("seeds", [3, 6])
def test_the_interval_covers_what_it_claims_where_a_bootstrap_does_not(seeds: int) -> None:
    """4000 campaigns of few seeds: 95 % of the intervals hold the true rate, within thrice the counting error."""
    generator = np.random.default_rng(11)
    rates = 12.0 + 2.0 * generator.standard_normal((4000, seeds))
    found = [estimate(r) for r in rates]
    assert np.mean([e.low <= 12.0 <= e.high for e in found]) == pytest.approx(0.95, abs=0.011)
    drawn = generator.integers(0, seeds, (400, seeds))  # resamples, shared by all campaigns
    low, high = np.quantile(rates[:, drawn].mean(axis=2), (0.025, 0.975), axis=1)
    assert np.mean((low <= 12.0) & (high >= 12.0)) < 0.91
    # and the confidence that the rate is positive is uniform where it is zero
    certain = np.array([estimate(r - 12.0).probability for r in rates])
    assert np.mean(certain < 0.05) == pytest.approx(0.05, abs=0.011)


def test_intervals_shrink_with_seeds_and_by_pairing() -> None:
    """Half widths go as t(n - 1) / sqrt(n): 1.05 for 6 seeds, 0.422 for 24; the seas' common 10 % cancels in pairs.

    Of 120 rates' half widths the mean has an error of 3 % for 6 seeds (their spread is 1 / sqrt(2 n - 2)).
    """
    cases = tuple(f"c{i}" for i in range(40))
    few, many = (suppression(table_of(n, cases=cases), ["TwrBsMyt"]) for n in (6, 24))
    assert few["half"].mean() / many["half"].mean() == pytest.approx(1.0497 / 0.4223, rel=0.1)
    assert few["half"].mean() == pytest.approx(1.0497 * 0.952, rel=0.1)  # 0.952: E[s] / sigma of six normal values
    # A single sea of 10 % scatter would give +- 10 points without pairs.
    unpaired = levels(table_of(6, cases=cases), "std", ["TwrBsMyt"])
    assert (unpaired["half"] / unpaired["value"]).mean() > 8.0 * few["half"].mean() / 100.0


def test_rates_pair_the_seeds_that_both_have() -> None:
    table = table_of(6, scatter=0.0)
    lacking = table[~((table["damper"] == "none") & (table["seed"] == 2))]
    rates = suppression(lacking, ["TwrBsMyt", "PtfmPitch"]).set_index("damper")
    assert rates["rate"].to_dict() == pytest.approx(RATES)
    assert rates["seeds"].tolist() == [5, 5, 5]
    one = suppression(table[table["seed"] == 0], ["TwrBsMyt"])
    assert one["half"].isna().all()
    assert one["rate"].tolist() == pytest.approx(list(RATES.values()))


def test_the_order_of_the_arrangements_is_said_only_where_the_seeds_say_it() -> None:
    sure = ranking(table_of(6, scatter=0.3), ["TwrBsMyt"])
    assert sure["verdict"].tolist() == ["yes", "yes"]
    assert (sure["probability"] > 0.99).all()
    swapped = ranking(table_of(6, scatter=0.3), ["TwrBsMyt"], order=("tmd-n", "mtmd"))
    assert swapped["verdict"].tolist() == ["no"]
    # Where chance drowns the difference, 95 of 100 comparisons stay open, within thrice the counting error.
    drowned = table_of(6, scatter=500.0, cases=tuple(f"c{i}" for i in range(100)))
    verdicts = ranking(drowned, ["TwrBsMyt"], order=("mtmd", "tmd-p"))["verdict"]
    assert (verdicts == "open").mean() == pytest.approx(0.95, abs=0.065)


def test_extremes_and_their_distribution() -> None:
    """Gumbel maxima of location 5 and scale 2 are found again within thrice the error of 400 (3 % of the scale)."""
    maxima = np.random.default_rng(5).gumbel(5.0, 2.0, 400)
    location, scale = gumbel(maxima)
    assert location == pytest.approx(5.0, abs=0.35)
    assert scale == pytest.approx(2.0, rel=0.13)
    few, many = (extremes(table_of(n), ["TwrBsMyt"]).set_index("damper") for n in (6, 12))
    assert few["gumbel_scale"].isna().all()
    assert many["gumbel_scale"].notna().all()
    table = table_of(6)
    highest = table[table["damper"] == "mtmd"]["max"]
    assert few.loc["mtmd", "largest"] == highest.max()
    assert few.loc["mtmd", "maximum"] == pytest.approx(highest.mean())


def test_an_average_spectrum_is_the_average_of_the_spectra(frame_of: Callable[[float], pd.DataFrame]) -> None:
    single = mean_spectrum([frame_of(1.0)], "x", transient=0.0)
    both = mean_spectrum([frame_of(1.0), frame_of(3.0)], "x", transient=0.0)
    assert both.density == pytest.approx(5.0 * single.density, rel=1e-9)  # (1 + 9) / 2
    assert (both.seeds, both.segments) == (2, 2 * single.segments)
    with pytest.raises(ValueError, match="differ in length"):
        mean_spectrum([frame_of(1.0), frame_of(1.0).iloc[:1500]], "x", transient=0.0)


@pytest.fixture
def frame_of() -> Callable[[float], pd.DataFrame]:
    noise = np.random.default_rng(2).standard_normal(12_001)
    time = pd.Index(np.arange(12_001) * 0.05, name="Time")
    return lambda amplitude: pd.DataFrame({"x": amplitude * noise}, index=time)


def test_stop_hits_are_contacts_on_either_side() -> None:
    """Ten periods of 9 m beyond stops at 8 m: two contacts each; a damper that begins beyond a stop has met it."""
    time = np.arange(0.0, 120.0, 0.05)
    assert stop_hits(9.0 * np.sin(2.0 * np.pi * time / 12.0), 8.0) == 20
    assert stop_hits(9.0 * np.cos(2.0 * np.pi * time / 12.0), 8.0) == 21
    assert stop_hits(7.9 * np.sin(2.0 * np.pi * time / 12.0), 8.0) == 0


def test_the_papers_figures_stand_beside_ours() -> None:
    figures = paper_figures().set_index(["quantity", "case", "damper", "channel"])["value"]
    assert figures[("suppression", "lc1", "mtmd", "TwrBsMyt")] == 36.33
    assert figures[("rms", "lc4", "mtmd", "GenPwr")] == 4966.43
    table = table_of(6, scatter=0.3)
    found = beside_paper(table)
    assert found[["case", "damper", "channel", "paper"]].values.tolist() == [["lc1", "mtmd", "TwrBsMyt", 36.33]]
    assert found["ours"].iloc[0] == pytest.approx(15.0, abs=0.5)
    assert not found["within"].iloc[0]
    assert beside_paper(table[table["seed"] == 0])["within"].iloc[0] is None
