"""Verification engine: quantities against closed forms, reference files in every format, the plan's rules."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from cosim.case import case_folder
from cosim.errors import CosimError
from cosim.run import RunSettings
from cosim.system import ComponentInstance, StartValue, System
from cosim.verification.metrics import explained_variance, measure
from cosim.verification.modes import fit_oscillations
from cosim.verification.plan import Check, Comparison, Quantity, choose, read_plan
from cosim.verification.reference import Record, fmi_unit, read_history, read_row
from cosim.verification.runs import Job
from cosim.verification.sources import from_figures
from cosim.verification.table import Reference, reference_values, rows_of
from fmus_src.component import Component

T = np.arange(0.0, 200.0 + 0.025, 0.05)


def damped(t: np.ndarray, frequency: float, zeta: float, phase: float = 0.3) -> np.ndarray:
    omega = 2 * np.pi * frequency
    return np.exp(-zeta * omega * t) * np.cos(omega * np.sqrt(1 - zeta**2) * t + phase)


def record(where: str = "here", **channels: np.ndarray) -> Record:
    return Record(where, T, channels)


def check(quantity: Quantity, channel: str = "X", limit: str = "relative", **others: object) -> Check:
    return Check(channel, quantity, quantity, limit, 0.01, **others)


def comparison(*checks: Check, **others: object) -> Comparison:
    return Comparison("c", "case", checks, (0.0, 200.0), **others)


# --- quantities ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("frequency", "zeta"), [(0.0841, 0.0052), (0.0072, 0.037), (0.132, 0.18), (2.457, 0.0088)])
def test_decay_gives_back_frequency_and_damping(frequency: float, zeta: float) -> None:
    x = 0.7 + 5.0 * damped(T, frequency, zeta)
    periods = 400.0 if frequency < 0.01 else 200.0
    t = np.arange(0.0, periods, 0.05)
    mode = fit_oscillations(t, 0.7 + 5.0 * damped(t, frequency, zeta), (1.04 * frequency,)).modes[0]
    # The model is exact: only the search's own tolerance is left.
    assert mode.frequency == pytest.approx(frequency, rel=1e-6)
    assert mode.damping_ratio == pytest.approx(zeta, rel=1e-4)
    assert x.size == T.size


def test_two_modes_and_noise_are_told_apart() -> None:
    noise = np.random.default_rng(1).normal(0.0, 0.05, T.size)
    x = 5.0 * damped(T, 0.0806, 0.0089) + 0.5 * damped(T, 0.5401, 0.0053) + noise
    low = fit_oscillations(T, x, (0.084, 0.53)).modes
    # Error of a least squares fit to 4000 samples with noise of a tenth of the small mode: below 1e-4 in frequency.
    assert [m.frequency for m in low] == pytest.approx([0.0806, 0.5401], rel=2e-4)
    assert [m.damping_ratio for m in low] == pytest.approx([0.0089, 0.0053], rel=0.03)


def test_no_such_mode_is_an_error() -> None:
    with pytest.raises(ValueError, match="no mode within a factor"):
        fit_oscillations(T, damped(T, 0.5, 0.005), (0.08,))
    with pytest.raises(ValueError, match="fewer than two periods"):
        fit_oscillations(T, damped(T, 0.0072, 0.04), (0.0072,))
    with pytest.raises(ValueError, match="does not move"):
        fit_oscillations(T, np.zeros_like(T), (0.08,))


def test_wave_response_has_amplitude_and_phase_despite_a_free_mode() -> None:
    """T = 12.5 s beside a free mode of 0.084 Hz: a plain Fourier sum would be off by tens of %."""
    omega = 2 * np.pi / 12.5
    wave = 0.5 * np.cos(omega * T + 0.872)
    x = 0.5 * 9.6 * np.cos(omega * T + 0.872 + np.radians(85.7)) + 2.0 * damped(T, 0.0841, 0.0057)
    checks = check("amplitude", others=(0.084,)), check("phase", others=(0.084,), limit="absolute")
    c = comparison(*checks, wave_period=12.5)
    values = [measure(k, c, record(X=x, Wave1Elev=wave)) for k in checks]
    assert values == pytest.approx([9.6, 85.7], rel=1e-5)


def test_statistics_suppression_and_explained_variance() -> None:
    """A sinusoid's standard deviation is a / sqrt 2; a history 10 % too large explains all but 0.1^2 of it."""
    x = 3.0 + 2.0 * np.sin(2 * np.pi * 0.1 * T)
    c = comparison(undamped="u")
    assert measure(check("std"), c, record(X=x)) == pytest.approx(2.0 / np.sqrt(2.0), rel=1e-3)
    assert measure(check("suppression"), c, record(X=3.0 + 0.8 * (x - 3.0)), record(X=x)) == pytest.approx(20.0)
    larger = record(X=3.0 + 1.1 * (x - 3.0))
    assert explained_variance(check("R2"), c, record(X=x), larger, None) == pytest.approx(0.99, abs=1e-5)
    coarse = Record("coarse", T[::7], {"X": x[::7]})  # other sampling than ours
    assert explained_variance(check("R2"), replace(c, window=(0.0, 199.0)), coarse, record(X=x), None) > 1.0 - 1e-9


def test_mean_over_whole_turns() -> None:
    """A load that comes once per turn of a rotor at 12.1 rpm leaves no trace in the mean."""
    once = np.cos(2 * np.pi * 12.1 / 60.0 * T)
    c = replace(comparison(whole_turns_of="RotSpeed"), window=(150.0, 200.0))
    value = measure(check("mean"), c, record(X=7.0 + once, RotSpeed=np.full_like(T, 12.1)))
    assert value == pytest.approx(7.0, abs=2e-3)  # a sample more or less of 992: 1e-3
    plain = measure(check("mean"), replace(c, whole_turns_of=None, window=(150.0, 152.5)), record(X=7.0 + once))
    assert abs(plain - 7.0) > 0.2


def test_rows_pass_and_fail_by_their_tolerances() -> None:
    checks = check("mean"), check("phase", limit="absolute"), check("R2", limit="at_least"), check("mean", "Y")
    c = comparison(*checks, wave_period=10.0)
    omega = 0.2 * np.pi
    wave = np.cos(omega * T)
    reference = Reference("r", record(X=2.0 + np.cos(omega * T + np.pi - 0.01), Wave1Elev=wave))
    values = reference_values(c, {"c": reference}, {})
    ours = record(X=2.01 + np.cos(omega * T - np.pi + 0.01), Wave1Elev=wave)
    mean, phase, r2, missing = rows_of(c, reference, values, ours, None, {})
    assert (mean.status, mean.difference) == ("pass", pytest.approx(0.005, rel=1e-2))
    assert (phase.status, phase.difference) == ("FAIL", pytest.approx(np.degrees(0.02)))  # across 180 deg
    assert r2.passed
    assert missing.status == "missing"
    still = rows_of(replace(c, checks=checks[1:2]), reference, values, record(X=0 * T, Wave1Elev=wave), None, {})[0]
    assert (still.status, still.note) == ("FAIL", "here: X does not move; change the check's window or modes")
    assert {row.status for row in rows_of(c, reference, values, None, None, {})} == {"no run", "missing"}


# --- files -----------------------------------------------------------------------------------------------------------


def _outb(path: Path, frame: pd.DataFrame, units: list[str]) -> None:
    """OpenFAST's binary format 3 (uncompressed): the layout is documented in OpenFAST's ReadFASTbinary."""
    values = frame.to_numpy()
    content = struct.pack("<hiidd", 3, values.shape[1] - 1, len(values), values[0, 0], values[1, 0] - values[0, 0])
    content += struct.pack("<i", 4) + b"test"
    content += b"".join(name.ljust(10).encode() for name in frame.columns) + b"".join(
        u.ljust(10).encode() for u in units
    )
    path.write_bytes(content + np.ascontiguousarray(values[:, 1:]).tobytes())


def _out(path: Path, frame: pd.DataFrame, units: list[str]) -> None:
    lines = ["", "made for a test", "", "", "test", "", "\t".join(frame.columns), "\t".join(units)]
    rows = ["\t".join(f"{v:.8e}" for v in row) for row in frame.to_numpy()]
    path.write_text("\n".join([*lines, *rows]) + "\n")


def _csv(path: Path, frame: pd.DataFrame, units: list[str]) -> None:
    frame.set_axis([f"{n}_[{u[1:-1]}]" for n, u in zip(frame.columns, units, strict=True)], axis=1).to_csv(
        path, index=False
    )


def _parquet(path: Path, frame: pd.DataFrame, units: list[str]) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    named = str(dict(zip(frame.columns, units, strict=True)))  # Python's quotes, as some write it
    pq.write_table(pa.Table.from_pandas(frame, preserve_index=False).replace_schema_metadata({"units": named}), path)


@pytest.mark.parametrize(
    ("suffix", "write"), [(".parquet", _parquet), (".csv", _csv), (".out", _out), (".outb", _outb)]
)
def test_every_format_reads_alike(tmp_path: Path, suffix: str, write: Callable[..., None]) -> None:
    if suffix.startswith(".out"):
        pytest.importorskip("openfast_io", reason="extra 'openfast'")
    frame = pd.DataFrame({"Time": T[:50], "PtfmPitch": np.sin(T[:50]), "TwrBsMyt": 1e3 * np.cos(T[:50])})
    write(tmp_path / f"run.1{suffix}", frame, ["(s)", "(deg)", "(kN-m)"])
    read = read_history(tmp_path / f"run.1{suffix}")
    assert dict(read.units) == {"PtfmPitch": "deg", "TwrBsMyt": "kN.m"}
    np.testing.assert_allclose(read.time, frame["Time"], atol=1e-9)
    np.testing.assert_allclose(read.values("PtfmPitch", "rad"), np.radians(frame["PtfmPitch"]), atol=1e-9)
    np.testing.assert_allclose(read.values("TwrBsMyt", "kN.m"), frame["TwrBsMyt"], rtol=1e-7)
    with pytest.raises(CosimError, match=r"'kN.m' cannot be converted to 'm'"):
        read.values("TwrBsMyt", "m")


def test_openfast_units() -> None:
    assert [fmi_unit(u) for u in ("(kN-m)", "deg/s^2", "(-)", "m", "deg/sec")] == ["kN.m", "deg/s2", "1", "m", "deg/s"]


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.parquet", "no parquet", "a.parquet: cannot be read"),
        ("a.csv", "x,y\n1,2\n3,4\n", "no column 'Time'"),
        ("a.csv", "Time,y\n1,2\n1,4\n", "times do not increase"),
        ("a.xlsx", "", "not a history; known are"),
    ],
)
def test_damaged_files_are_named(tmp_path: Path, name: str, content: str, message: str) -> None:
    (tmp_path / name).write_text(content)
    with pytest.raises(CosimError, match=message):
        read_history(tmp_path / name)


def test_rows_of_a_table(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text(
        "kind,U,GenPwr_mean,GenPwr_std\nrigid,8,1676,0.1\nflexible,8,1690,0.2\nrigid,9,2400,0.1\n"
    )
    figures = read_row(tmp_path / "t.csv", {"kind": "rigid", "U": 8.0})
    assert (figures["GenPwr", "mean"], figures["GenPwr", "std"]) == (1676.0, 0.1)
    with pytest.raises(CosimError, match="0 rows have U = 10"):
        read_row(tmp_path / "t.csv", {"U": 10.0})
    with pytest.raises(CosimError, match="no column 'V'"):
        read_row(tmp_path / "t.csv", {"V": 10.0})


def test_values_that_are_no_numbers_and_windows_outside_are_errors() -> None:
    x = np.sin(T)
    x[100] = np.nan
    with pytest.raises(CosimError, match="X at 5 s is not a finite number"):
        measure(check("std"), comparison(), record(X=x))
    with pytest.raises(CosimError, match="covers 0 to 200 s, 300 to 400 s are to be compared"):
        measure(check("std"), replace(comparison(), window=(300.0, 400.0)), record(X=np.sin(T)))
    with pytest.raises(CosimError, match="no channel 'Y'"):
        measure(check("std", "Y"), comparison(), record(X=np.sin(T)))


# --- plan ------------------------------------------------------------------------------------------------------------

OWN = """
[parameters]
"hydro.drag_coefficient" = 0.9
[checks]
mine = [{ channels = ["PtfmPitch", "TTDspFA"], quantity = "std", relative = 0.05 }]
[comparison.mine]
case = "lc1"
window = [30.0, 90.0]
checks = ["mine"]
[comparison.mine_damped]
like = "mine"
damper = "mtmd"
[comparison."decay/decay_p5_none"]
case = "decay5"
window = [0.0, 50.0]
checks = ["mine"]
"""


def test_a_folder_adds_and_replaces_comparisons(tmp_path: Path) -> None:
    (tmp_path / "verification.toml").write_text(OWN)
    shipped, plan = read_plan(case_folder(), None), read_plan(case_folder(), tmp_path)
    assert set(plan) - set(shipped) == {"mine", "mine_damped"}
    assert [c.channel for c in plan["mine"].checks] == ["PtfmPitch", "TTDspFA"]
    assert (plan["mine_damped"].window, plan["mine_damped"].damper) == ((30.0, 90.0), "mtmd")
    assert plan["decay/decay_p5_none"].window == (0.0, 50.0)
    assert all(c.parameters["hydro.drag_coefficient"] == 0.9 for c in plan.values())
    assert set(choose(plan, ["MINE*"])) == {"mine", "mine_damped"}
    assert {c.group for c in choose(plan, ["decay", "lc4"]).values()} == {"decay", "turbulent"}
    with pytest.raises(CosimError, match="nothing to verify is called 'decy'; did you mean 'decay'"):
        choose(plan, ["decy"])


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("relative", "relativ", "unknown key 'checks.mine.relativ'"),
        ('"std"', '"sdt"', "no quantity 'sdt'; did you mean 'std'"),
        (", relative = 0.05", "", "std needs one tolerance"),
        ("[30.0, 90.0]", "[90.0, 30.0]", "window 90 to 30 s"),
        ('checks = ["mine"]', 'checks = ["mien"]', "no list of checks 'mien'; did you mean 'mine'"),
        ('like = "mine"', 'like = "main"', "mine_damped is like 'main'"),
        ('"std", relative', '"suppression", absolute', "suppression needs 'undamped'"),
        ('"std", relative', '"phase", absolute', "phase needs 'wave_period'"),
        ('"std"', '"frequency"', "frequency needs 'near'"),
    ],
)
def test_mistakes_in_a_plan_are_named(tmp_path: Path, old: str, new: str, message: str) -> None:
    (tmp_path / "verification.toml").write_text(OWN.replace(old, new))
    with pytest.raises(CosimError, match=message):
        read_plan(case_folder(), tmp_path)


def test_shipped_figures_belong_to_shipped_checks() -> None:
    """Every figure has its check (a figure without one is an error), and each natural frequency has its figure."""
    comparisons, references = from_figures(case_folder() / "verification-openfast.toml", read_plan(case_folder(), None))
    assert {c.group for c in comparisons.values()} == {"decay", "regular", "steady"}
    for name, c in comparisons.items():
        assert set(reference_values(c, references, {})) == set(c.checks), name


# --- reuse -----------------------------------------------------------------------------------------------------------


def test_key_knows_parameters_files_and_settings(built: Callable[[Component], Path], tmp_path: Path) -> None:
    c = Component("still", "A parameter and a file")
    c.output("y", c.parameter("a", 1.0, description="a"), description="y")
    fmu, wind = built(c), tmp_path / "wind.bts"
    wind.write_bytes(b"one")

    def key(a: float = 1.0, stop: float = 1.0, file: Path = wind, about: str = "") -> str:
        start = {"a": StartValue(a), "file": StartValue(str(file))}
        system = System("s", (ComponentInstance("still", fmu, start),))
        return Job("j", "label", system, RunSettings(stop=stop, about={"label": about})).key()

    other = tmp_path / "other.bts"
    other.write_bytes(b"two")
    assert key() == key(about="a label changes nothing")
    assert len({key(), key(a=2.0), key(stop=2.0), key(file=other)}) == 4
    json.loads(json.dumps(key()))
