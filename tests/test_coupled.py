"""The coupled system as a user runs it: decays against OpenFAST, damper arrangements, the shipped systems and cases.

OpenFAST figures: v5 (development, March 2026), NREL 5-MW turbine on the ITI Energy barge, computed for this project;
the histories' peaks and the modes are copied here.
"""

from __future__ import annotations

import zipfile
from pathlib import Path

import fmpy.ssp.ssd
import numpy as np
import pandas as pd
import pytest
from scipy.signal import find_peaks

from cosim.case import read_case, shipped_cases, with_damper
from cosim.checks import check
from cosim.cli.run import Changes, prepare
from cosim.connect import connect
from cosim.run import RunResult, simulate
from cosim.ssp import read_system
from cosim.ssp_writer import write_ssd
from fmus_src.library import build_library

CASES = shipped_cases()


def run(case: str, folder: Path, damper: str | None = None, **changes: object) -> RunResult:
    prepared = prepare(read_case(case), damper, Changes(**changes), quiet=True)  # type: ignore[arg-type]
    return simulate(prepared.system, prepared.settings, folder / f"{case}-{damper}")


def peaks(frame: pd.DataFrame, channel: str) -> tuple[np.ndarray, np.ndarray]:
    """Times and heights of the maxima, a parabola through three samples each."""
    t, x = frame.index.to_numpy(), frame[channel].to_numpy()
    at, _ = find_peaks(x, distance=round(8.0 / (t[1] - t[0])))
    left, mid, right = x[at - 1], x[at], x[at + 1]
    shift = 0.5 * (left - right) / (left - 2 * mid + right)
    return t[at] + shift * (t[1] - t[0]), mid - 0.25 * (left - right) * shift


def test_damped_decay_follows_openfast(tmp_path: Path) -> None:
    """10 deg decay with both dampers, platform pitch and first tower mode free: what the dampers are designed for."""
    frame = run("decay10", tmp_path).frame()
    times, heights = peaks(frame, "PtfmPitch")
    openfast_times = [12.92, 26.02, 42.75, 56.00, 70.23, 83.60]
    openfast_heights = [6.914, 3.000, 2.796, 3.058, 2.493, 1.444]
    # Our hydrodynamic coefficients are our own (within 2 % of the published): 0.5 % in period, 2 % of the first peak.
    np.testing.assert_allclose(times[:6], openfast_times, rtol=0.005)
    np.testing.assert_allclose(heights[:6], openfast_heights, atol=0.02 * openfast_heights[0])
    # The nacelle damper reaches its stop (8 m) in both; OpenFAST's largest travel is 8.3 m.
    assert 8.0 < frame["NStC1_XQ"].abs().max() < 8.6


def test_load_case_in_wind_and_waves(tmp_path: Path) -> None:
    """The first 120 s of load case 4: the controller holds rated power, and two dampers act as one FMU or as two."""
    one = run("lc4", tmp_path, "mtmd-unit", until=120.0).frame()
    two = run("lc4", tmp_path, "mtmd", until=120.0).frame()
    shared = [c for c in one.columns if c in two.columns]
    # rounding only: sums are taken in another order
    assert ((one[shared] - two[shared]).abs().max() / two[shared].std()).max() < 1e-9
    none = run("lc4", tmp_path, "none", until=120.0)
    assert none.summary["GenPwr"]["mean"] == pytest.approx(5000.0, rel=0.03)
    assert none.summary["RotSpeed"]["mean"] == pytest.approx(12.1, rel=0.05)
    assert two.loc[30.0:, "PtfmPitch"].std() < none.summary["PtfmPitch"]["std"]


def test_same_seed_same_bits(tmp_path: Path) -> None:
    first = run("lc2", tmp_path / "a", "none", until=10.0).frame()
    second = run("lc2", tmp_path / "b", "none", until=10.0).frame()
    other = run("lc2", tmp_path / "c", "none", until=10.0, seed=7).frame()
    assert first.equals(second)
    assert not np.allclose(first["Wave1Elev"], other["Wave1Elev"])
    assert not np.allclose(first["Wind1VelX"], other["Wind1VelX"])


@pytest.mark.parametrize("name", CASES)
def test_every_case_and_arrangement_passes_the_checks(name: str) -> None:
    folder, _ = build_library()
    case = read_case(name)
    for damper in case.dampers.values():
        system = with_damper(read_system(damper.system or case.system, [folder]), damper)
        checked = check(system)
        assert checked.warnings == ()


@pytest.mark.parametrize(
    ("name", "extra", "ports"),
    [
        ("barge", {"nacelle_damper": "tmd", "platform_damper": "tmd"}, {}),
        ("barge-mtmd", {"mtmd": "mtmd"}, {"mtmd.unit1": "nacelle_damper", "mtmd.unit2": "platform_damper"}),
    ],
)
def test_shipped_systems_follow_from_the_fmus(
    tmp_path: Path, name: str, extra: dict[str, str], ports: dict[str, str]
) -> None:
    """cases/*.ssd are what cosim.connect writes for today's FMUs (cases/README.md has the commands)."""
    _, fmus = build_library()
    parts = {n: fmus[n] for n in ("barge", "hydro", "mooring", "aero", "servo")} | {
        n: fmus[f] for n, f in extra.items()
    }
    written = write_ssd(connect(parts, ports), tmp_path / f"{name}.ssd")
    shipped = CASES["lc4"].parent / f"{name}.ssd"
    assert written.read_text() == shipped.read_text()
    with zipfile.ZipFile(tmp_path / "system.ssp", "w") as package:
        package.write(shipped, "SystemStructure.ssd")
    parsed = fmpy.ssp.ssd.read_ssd(str(tmp_path / "system.ssp"))  # validates against the SSP 1.0 schema
    assert {e.name for e in parsed.system.elements} == set(parts)
