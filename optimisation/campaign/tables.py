"""A campaign's tables: suppression rates, which arrangement is better, levels, damper travel, extremes, fatigue.

Every function takes the table of `runs.parquet` (see `runs.COLUMNS`) and gives a new one. Arrangements are compared in
pairs of the same seed, thus in the same wind and sea: what a record has by chance it has in both, and most cancels.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd

from optimisation.campaign.fatigue import EXPONENTS, combined, wind_bins
from optimisation.campaign.intervals import CONFIDENCE, Estimate, estimate

MAIN_CHANNELS = ("PtfmPitch", "TTDspFA", "TwrBsMyt", "RootMyc1", "GenPwr")
REFERENCE = "none"
ORDER = ("mtmd", "tmd-p", "tmd-n")  # what the paper finds, the best first
LIFETIME = "lifetime"
GUMBEL_SEEDS = 10  # fewer maxima say too little of a distribution's tail


def suppression(
    table: pd.DataFrame,
    channels: Sequence[str] = MAIN_CHANNELS,
    *,
    statistic: str = "std",
    reference: str = REFERENCE,
    confidence: float = CONFIDENCE,
) -> pd.DataFrame:
    """Suppression rate (Wang et al. 2022, eq. 15) of each case, arrangement and channel: mean of the seeds' own rates.

    Args:
        statistic: column of the table whose reduction is meant.

    Returns:
        `case`, `damper`, `channel`, `unit`, `seeds` (pairs), `undamped`, `damped` (means of the statistic),
        `rate`, `half`, `low`, `high` (%), `probability` (confidence that the damper helps).
    """
    rows = []
    for case, damper, channel, unit, pair in _pairs(table, channels, statistic, reference):
        rates = 100.0 * (pair["undamped"] - pair["damped"]) / pair["undamped"]
        if not (pair["undamped"] > 0.0).all():
            continue  # what does not move cannot be suppressed
        e = estimate(rates, confidence)
        means = {"undamped": float(pair["undamped"].mean()), "damped": float(pair["damped"].mean())}
        rows.append({"case": case, "damper": damper, "channel": channel, "unit": unit, "seeds": e.count, **means,
                     "rate": e.mean, **_ends(e)})  # fmt: skip
    names = ["case", "damper", "channel", "unit", "seeds", "undamped", "damped", "rate", "half", "low", "high",
             "probability"]  # fmt: skip
    return pd.DataFrame(rows, columns=names)


def ranking(
    table: pd.DataFrame,
    channels: Sequence[str] = MAIN_CHANNELS,
    *,
    order: Sequence[str] = ORDER,
    statistic: str = "std",
    reference: str = REFERENCE,
    confidence: float = CONFIDENCE,
) -> pd.DataFrame:
    """Whether each arrangement of `order` is better than the next one: difference of their rates, paired by seed.

    Returns:
        `case`, `channel`, `better`, `worse`, `seeds`, `difference`, `half`, `low`, `high` (points of suppression rate),
        `probability` (confidence that the order holds), `verdict`: "yes", "no" or "open" (the interval holds zero).
    """
    rows = []
    rates: dict[tuple[str, str, str], pd.Series] = {}
    for case, damper, channel, _, pair in _pairs(table, channels, statistic, reference):
        rates[case, channel, damper] = 100.0 * (pair["undamped"] - pair["damped"]) / pair["undamped"]
    for case, channel in dict.fromkeys(key[:2] for key in rates):
        for better, worse in pairwise(order):
            if (case, channel, better) not in rates or (case, channel, worse) not in rates:
                continue
            difference = (rates[case, channel, better] - rates[case, channel, worse]).dropna()
            if difference.empty:
                continue
            e = estimate(difference, confidence)
            verdict = "yes" if e.low > 0.0 else "no" if e.high < 0.0 else "open"
            rows.append({"case": case, "channel": channel, "better": better, "worse": worse, "seeds": e.count,
                         "difference": e.mean, **_ends(e), "verdict": verdict})  # fmt: skip
    names = [
        "case",
        "channel",
        "better",
        "worse",
        "seeds",
        "difference",
        "half",
        "low",
        "high",
        "probability",
        "verdict",
    ]
    return pd.DataFrame(rows, columns=names)


def levels(
    table: pd.DataFrame,
    statistic: str,
    channels: Sequence[str] = MAIN_CHANNELS,
    *,
    confidence: float = CONFIDENCE,
) -> pd.DataFrame:
    """Mean over seeds of a statistic, such as the RMS of GenPwr, with its interval (of the seeds, not of a difference).

    Returns:
        `case`, `damper`, `channel`, `unit`, `seeds`, `value`, `half`, `low`, `high` in the channel's unit.
    """
    rows = []
    for (case, damper, channel), part in _groups(table, channels):
        e = estimate(part[statistic], confidence)
        rows.append({"case": case, "damper": damper, "channel": channel, "unit": part["unit"].iloc[0],
                     "seeds": e.count, "value": e.mean, "half": e.half, "low": e.low, "high": e.high})  # fmt: skip
    names = ["case", "damper", "channel", "unit", "seeds", "value", "half", "low", "high"]
    return pd.DataFrame(rows, columns=names)


def damper_travel(table: pd.DataFrame) -> pd.DataFrame:
    """Stroke used and end stops hit by each damper.

    Returns:
        `case`, `damper`, `channel` (of the displacement), `seeds`, `stroke` (mean over seeds of the largest
        displacement, m), `largest` (of all seeds, m), `stop_hits` (mean per run), `most_hits`.
    """
    moving = table[table["stroke"].notna()]
    groups = moving.groupby(["case", "damper", "channel"], sort=False)
    found = groups.agg(
        seeds=("seed", "nunique"), stroke=("stroke", "mean"), largest=("stroke", "max"),
        stop_hits=("stop_hits", "mean"), most_hits=("stop_hits", "max"),
    )  # fmt: skip
    return found.reset_index()


def extremes(
    table: pd.DataFrame,
    channels: Sequence[str] = MAIN_CHANNELS,
    *,
    reference: str = REFERENCE,
    confidence: float = CONFIDENCE,
) -> pd.DataFrame:
    """Extreme values: mean over seeds of the runs' maxima and minima, the largest of all, and the maxima's reduction.

    With at least 10 seeds, also a Gumbel distribution of the maxima (by L-moments); of fewer its tail is a guess.

    Returns:
        `case`, `damper`, `channel`, `unit`, `seeds`, `maximum`, `maximum_half`, `minimum`, `minimum_half`, `largest`,
        `smallest` in the channel's unit, `reduction`, `reduction_half` (% of the undamped maximum, paired by seed),
        `gumbel_location`, `gumbel_scale` (null below 10 seeds).
    """
    reductions = suppression(table, channels, statistic="max", reference=reference, confidence=confidence)
    reduced = reductions.set_index(["case", "damper", "channel"])
    rows = []
    for (case, damper, channel), part in _groups(table, channels):
        top, bottom = estimate(part["max"], confidence), estimate(part["min"], confidence)
        found = (case, damper, channel) in reduced.index
        location, scale = gumbel(part["max"]) if len(part) >= GUMBEL_SEEDS else (np.nan, np.nan)
        rows.append({
            "case": case, "damper": damper, "channel": channel, "unit": part["unit"].iloc[0], "seeds": top.count,
            "maximum": top.mean, "maximum_half": top.half, "minimum": bottom.mean, "minimum_half": bottom.half,
            "largest": float(part["max"].max()), "smallest": float(part["min"].min()),
            "reduction": reduced.loc[(case, damper, channel), "rate"] if found else np.nan,
            "reduction_half": reduced.loc[(case, damper, channel), "half"] if found else np.nan,
            "gumbel_location": location, "gumbel_scale": scale,
        })  # fmt: skip
    return pd.DataFrame(rows)


def gumbel(maxima: Sequence[float] | pd.Series) -> tuple[float, float]:
    """Location and scale of a Gumbel distribution by L-moments (Hosking, 1990): unbiased in scale, unlike moments."""
    x = np.sort(np.asarray(maxima, dtype=float))
    n = x.size
    second = 2.0 * float(np.sum(np.arange(n) * x)) / (n * (n - 1)) - float(x.mean())
    scale = second / np.log(2.0)
    return float(x.mean() - np.euler_gamma * scale), float(scale)


def fatigue_and_why(table: pd.DataFrame, speeds: Mapping[str, float]) -> tuple[pd.DataFrame, str]:
    """`fatigue` over a lifetime too where the cases' wind speeds allow, and why not where they do not, or ""."""
    try:
        return fatigue(table, speeds), ""
    except ValueError as error:
        return fatigue(table, {}), str(error)


def fatigue(
    table: pd.DataFrame,
    speeds: Mapping[str, float],
    *,
    reference: str = REFERENCE,
    confidence: float = CONFIDENCE,
    mean_speed: float = 10.0,
    shape: float = 2.0,
) -> pd.DataFrame:
    """Damage-equivalent loads of each case, and over a lifetime (`case` is then "lifetime"; see `fatigue.wind_bins`).

    The lifetime's interval is that of the seeds' own lifetimes, each of one seed in every case; it is given only for
    arrangements that have finished runs in every case.

    Args:
        speeds: mean wind speed of each load case, m/s.
        mean_speed: yearly mean, m/s; shape: of the Weibull distribution.

    Returns:
        `case`, `damper`, `channel`, `unit`, `exponent`, `seeds`, `del` (of all seeds, range at 1 Hz, channel's unit),
        `reduction`, `half`, `low`, `high` (%, paired by seed; null for the reference).
    """
    loads = table[table["del"].notna()]
    both = loads
    if len(speeds) > 1:
        weights = wind_bins(speeds, mean_speed=mean_speed, shape=shape).set_index("case")["weight"]
        lifetime = _lifetimes(loads, weights)
        both = pd.concat([loads, lifetime]) if len(lifetime) else loads
    channels = list(dict.fromkeys(loads["channel"]))
    reduced = suppression(both, channels, statistic="del", reference=reference, confidence=confidence)
    reduced = reduced.set_index(["case", "damper", "channel"])
    rows: list[dict[str, Any]] = []
    for (case, damper, channel), part in _groups(both, channels):
        m, n = EXPONENTS[str(channel)], len(part)
        found = reduced.loc[(case, damper, channel)] if (case, damper, channel) in reduced.index else {}
        rows.append({
            "case": case, "damper": damper, "channel": channel, "unit": part["unit"].iloc[0], "exponent": m,
            "seeds": n, "del": combined(part["del"], np.full(n, 1.0 / n), m), "reduction": found.get("rate", np.nan),
            **{k: found.get(k, np.nan) for k in ("half", "low", "high")},
        })  # fmt: skip
    names = ["case", "damper", "channel", "unit", "exponent", "seeds", "del", "reduction", "half", "low", "high"]
    return pd.DataFrame(rows, columns=names)


def _lifetimes(loads: pd.DataFrame, weights: pd.Series) -> pd.DataFrame:
    """A row for each arrangement, channel and seed that has all cases: the load over the lifetime."""
    rows = []
    for (damper, channel, seed), part in loads.groupby(["damper", "channel", "seed"], sort=False):
        found = part.set_index("case")["del"].reindex(weights.index)
        if found.isna().any():
            continue
        load = combined(found, weights, EXPONENTS[str(channel)])
        rows.append({"case": LIFETIME, "damper": damper, "seed": seed, "channel": channel,
                     "unit": part["unit"].iloc[0], "del": load})  # fmt: skip
    return pd.DataFrame(rows, columns=["case", "damper", "seed", "channel", "unit", "del"])


def _pairs(
    table: pd.DataFrame, channels: Sequence[str], statistic: str, reference: str
) -> Iterator[tuple[str, str, str, str, pd.DataFrame]]:
    """Of each case, arrangement and channel: values by seed, `undamped` and `damped`, of the seeds that have both."""
    values = {key: part.set_index("seed")[statistic].dropna() for key, part in _groups(table, channels)}
    units = table.drop_duplicates("channel").set_index("channel")["unit"]
    for (case, damper, channel), damped in values.items():
        undamped = values.get((case, reference, channel))
        if damper == reference or undamped is None:
            continue
        pair = pd.concat({"undamped": undamped, "damped": damped}, axis=1, join="inner").sort_index()
        if len(pair):
            yield case, damper, channel, str(units[channel]), pair


def _groups(table: pd.DataFrame, channels: Sequence[str]) -> Iterator[tuple[tuple[str, str, str], pd.DataFrame]]:
    """Rows of each case, arrangement and channel, sorted by seed; channels in the given order."""
    grouped = dict(iter(table.groupby(["case", "damper", "channel"], sort=False)))
    for case, damper in dict.fromkeys(key[:2] for key in grouped):
        for channel in channels:
            if (case, damper, channel) in grouped:
                yield (case, damper, channel), grouped[case, damper, channel].sort_values("seed")


def _ends(e: Estimate) -> dict[str, float]:
    return {"half": e.half, "low": e.low, "high": e.high, "probability": e.probability}
