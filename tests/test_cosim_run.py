"""Running systems of foreign FMUs: data types, units, start values, failures, interruption, and what is kept."""

from __future__ import annotations

import json
import math
import signal
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from cosim.errors import CosimError, RunFailed
from cosim.recording import Channel, read_results
from cosim.run import RunSettings, simulate
from cosim.system import ComponentInstance, Connection, StartValue, System, Value, with_parameters
from fmus_src.component import Component

from .cosim_fmus import carried, mass, probe, two_masses

ALL = ("*",)


@pytest.fixture(scope="module")
def probe_fmu(fmu_folder: Path) -> Path:
    return probe(fmu_folder)


def pair(fmu: Path, connections: tuple[tuple[str, str], ...] = (), **values: Value) -> System:
    """Probes `a` and `b`; connections as ("a.x", "b.y"); values as a_name=..."""
    start = {"a": {}, "b": {}} | {k: {n[2:]: StartValue(v) for n, v in values.items() if n[0] == k} for k in "ab"}
    links = tuple(Connection(s[0], s[2:], t[0], t[2:]) for s, t in connections)
    return System("pair", tuple(ComponentInstance(k, fmu, start[k]) for k in "ab"), links)


@pytest.mark.parametrize("algorithm", ["gauss-seidel", "jacobi"])
def test_integers_pass_exactly(probe_fmu: Path, tmp_path: Path, algorithm: Any) -> None:
    """Each counts one beyond what the other had before the step: discrete values are held over a step."""
    system = pair(probe_fmu, (("a.number", "b.count"), ("b.number", "a.count")))
    settings = RunSettings(stop=1.0, step=0.1, algorithm=algorithm, record=("b.number",))
    numbers = simulate(system, settings, tmp_path / "run").frame()["b.number"]
    assert numbers.tolist() == list(range(11))


def test_integers_against_the_order_settle_at_the_start(probe_fmu: Path, tmp_path: Path) -> None:
    """A chain of switches, each the opposite of the next, stepped from its end: one sweep does not settle it."""
    parts = tuple(ComponentInstance(k, probe_fmu, {"gate": StartValue(k == "d")}) for k in "abcd")
    links = tuple(Connection(k, "open", n, "gate") for k, n in zip("dcb", "cba", strict=True))
    settings = RunSettings(stop=0.1, step=0.1, record=("*.open",), order=("a", "b", "c", "d"))
    first = simulate(System("chain", parts, links), settings, tmp_path / "run").frame().iloc[0]
    again = simulate(System("chain", parts, links), replace(settings, order=("d",)), tmp_path / "again").frame().iloc[0]
    assert first.tolist() == again.tolist()


def test_booleans_pass(probe_fmu: Path, tmp_path: Path) -> None:
    system = pair(probe_fmu, (("a.open", "b.gate"),))
    frame = simulate(system, RunSettings(stop=0.3, step=0.1, record=("*.open",)), tmp_path / "run").frame()
    assert frame["a.open"].tolist() == [0, 1, 1, 1]  # not gate, where a's gate stays false
    assert frame["b.open"].tolist() == [0, 1, 0, 0]  # not what a's was before the step


def test_units_are_converted_and_the_first_row_is_the_initialised_state(probe_fmu: Path, tmp_path: Path) -> None:
    """a gives 1 rad; b takes degrees and turns half of the number into rad: settled before the first row."""
    system = pair(probe_fmu, (("a.through", "b.u"),), a_intercept=1.0, b_slope=0.5)
    channels = (Channel("Angle", "b.u", "rad"), Channel("Half", "b.through", "deg"))
    result = simulate(system, RunSettings(stop=1.0, step=0.5, channels=channels, record=("b.u",)), tmp_path / "run")
    first = result.frame().iloc[0]
    degrees = math.degrees(1.0)
    assert first["b.u"] == pytest.approx(degrees, rel=1e-14)
    assert first["Angle"] == pytest.approx(1.0, rel=1e-14)
    assert first["Half"] == pytest.approx(math.degrees(degrees / 2), rel=1e-14)
    schema = pq.read_schema(result.folder / "results.parquet")
    assert schema.field("Half").metadata[b"unit"] == b"deg"
    assert json.loads(schema.metadata[b"units"]) == {"Time": "s", "Angle": "rad", "Half": "deg", "b.u": "deg"}


def test_linear_transformation_comes_after_the_unit_conversion(probe_fmu: Path, tmp_path: Path) -> None:
    system = System(
        "scaled",
        (ComponentInstance("a", probe_fmu, {"intercept": StartValue(1.0)}), ComponentInstance("b", probe_fmu)),
        (Connection("a", "through", "b", "u", factor=2.0, offset=10.0),),
    )
    last = simulate(system, RunSettings(stop=0.1, step=0.1, record=("b.u",)), tmp_path / "run").last
    assert last["b.u"] == pytest.approx(2.0 * math.degrees(1.0) + 10.0, rel=1e-14)


def test_an_algebraic_loop_is_solved(probe_fmu: Path, tmp_path: Path) -> None:
    """u_b = deg(s u_a + 1) both ways: u = deg(1) / (1 - deg(s)), here deg(s) = 1/2, so u = deg(2)."""
    both = (("a.through", "b.u"), ("b.through", "a.u"))
    values = {"slope": math.radians(0.5), "intercept": 1.0}
    system = pair(probe_fmu, both, **{f"{k}_{n}": v for k in "ab" for n, v in values.items()})
    result = simulate(system, RunSettings(stop=0.1, step=0.1, record=ALL), tmp_path / "run")
    # affine: Newton's method, here by differences of 1e-3, finds it to rounding
    np.testing.assert_allclose(result.frame()["a.u"], math.degrees(2.0), rtol=1e-10)
    assert not any("loop" in w for w in result.warnings)


def test_an_fmu_that_holds_its_inputs_gets_their_mid_step_value(
    probe_fmu: Path, built: Callable[[Component], Path], tmp_path: Path
) -> None:
    """The probe sums h * u, and is fed with the speed t of a mass under constant force."""
    system = System(
        "ramp",
        (ComponentInstance("m", built(mass()), {"force": StartValue(1.0)}), ComponentInstance("p", probe_fmu)),
        (Connection("m", "velocity", "p", "u", convert_units=False),),
    )
    frame = simulate(system, RunSettings(stop=2.0, step=0.1, record=("p.integral", "p.u")), tmp_path / "run").frame()
    # velocity = t: the sum of mid-step values is t^2 / 2 exactly, and u is read at the step's end
    np.testing.assert_allclose(frame["p.integral"], frame.index.to_numpy() ** 2 / 2, atol=1e-12)
    np.testing.assert_allclose(frame["p.u"], frame.index, atol=1e-12)


@pytest.mark.parametrize(("status", "name"), [(2, "fmi2Discard"), (3, "fmi2Error"), (4, "fmi2Fatal")])
def test_a_failed_step_stops_with_the_fmus_own_words(probe_fmu: Path, tmp_path: Path, status: int, name: str) -> None:
    system = pair(probe_fmu, b_fail_at=1.05, b_fail_status=status)
    with pytest.raises(RunFailed) as failure:
        simulate(system, RunSettings(stop=5.0, step=0.1, record=ALL), tmp_path / "run")
    assert str(failure.value) == f"b: fmi2DoStep returned {name} at t = 1 s: valve 3 jammed at 7.5 bar"
    kept = read_results(tmp_path / "run")
    assert kept.index[-1] == pytest.approx(1.0)
    log = json.loads((tmp_path / "run" / "run.json").read_text())
    assert log["status"] == "failed"
    assert log["message"] == str(failure.value)


def test_a_value_that_is_not_finite_stops_the_run(probe_fmu: Path, tmp_path: Path) -> None:
    system = pair(probe_fmu, b_fail_at=1.05, b_fail_status=9)
    with pytest.raises(RunFailed, match=r"^b\.integral = nan at t = 1\.1 s: .*reduce the step"):
        simulate(system, RunSettings(stop=5.0, step=0.1, record=ALL), tmp_path / "run")
    assert len(read_results(tmp_path / "run")) == 11


def test_a_value_that_explodes_stops_the_run(probe_fmu: Path, tmp_path: Path) -> None:
    both = (("a.integral", "b.u"), ("b.through", "a.u"))  # grows as exp(57 t)
    system = pair(probe_fmu, both, b_slope=1.0, b_intercept=1.0)
    with pytest.raises(RunFailed, match=r"^[ab]\.(u|through|integral) = \S+ (deg |rad )?at t = "):
        simulate(system, RunSettings(stop=50.0, step=0.1, record=ALL), tmp_path / "run")


def test_ctrl_c_keeps_what_was_computed(probe_fmu: Path, tmp_path: Path) -> None:
    def interrupt(time: float) -> None:
        if time > 3.0:
            signal.raise_signal(signal.SIGINT)

    before = signal.getsignal(signal.SIGINT)
    settings = RunSettings(stop=1e6, step=0.1, record=("a.integral",))
    result = simulate(pair(probe_fmu, a_u=1.0), settings, tmp_path / "run", interrupt)
    assert signal.getsignal(signal.SIGINT) is before
    assert result.status == "stopped"
    assert f"stopped by the user at t = {result.time:.6g} s of 1e+06 s" in result.message
    frame = result.frame()
    assert 3.0 < frame.index[-1] == pytest.approx(result.time)
    np.testing.assert_allclose(frame["a.integral"], frame.index, rtol=1e-9, atol=1e-12)
    assert json.loads((tmp_path / "run" / "run.json").read_text())["status"] == "stopped"


def test_time_is_counted_not_accumulated(probe_fmu: Path, tmp_path: Path) -> None:
    result = simulate(pair(probe_fmu), RunSettings(stop=600.0, step=0.01, record=("a.u",)), tmp_path / "run")
    assert result.steps == 60_000
    assert np.array_equal(result.frame().index, np.arange(60_001) * 0.01)


def test_statistics_leave_out_the_transient(built: Callable[[Component], Path], tmp_path: Path) -> None:
    system = two_masses(built(mass()), built(carried()))
    settings = RunSettings(stop=50.0, start=10.0, step=0.05, transient=20.0, decimation=4, record=("damper.position",))
    result = simulate(system, settings, tmp_path / "run")
    frame = result.frame()
    assert frame.index[0] == 10.0
    assert np.allclose(np.diff(frame.index), 0.2)
    kept = frame.loc[30.0 - 1e-9 :, "damper.position"].to_numpy()
    expected = {"mean": kept.mean(), "std": kept.std(), "rms": np.sqrt((kept**2).mean()),
                "min": kept.min(), "max": kept.max()}  # fmt: skip
    written = json.loads((tmp_path / "run" / "summary.json").read_text())["damper.position"]
    assert result.summary["damper.position"] == written
    assert written.pop("unit") == "m"
    assert written == pytest.approx(expected, rel=1e-12)


def test_provenance_repeats_the_run(probe_fmu: Path, tmp_path: Path) -> None:
    import hashlib

    system = with_parameters(pair(probe_fmu, (("a.through", "b.u"),)), {"a.intercept": 0.25})
    simulate(system, RunSettings(stop=1.0, step=0.1, record=ALL), tmp_path / "run")
    log = json.loads((tmp_path / "run" / "run.json").read_text())
    assert log["status"] == "completed"
    assert log["components"]["a"]["sha256"] == hashlib.sha256(probe_fmu.read_bytes()).hexdigest()
    assert log["components"]["a"]["start"] == {"intercept": 0.25}
    assert log["connections"] == ["a.through -> b.u"]
    assert (log["settings"]["algorithm"], log["settings"]["step"]) == ("gauss-seidel", 0.1)
    assert 0.0 < sum(log["component_seconds"].values()) < log["wall_time"]


def test_an_existing_folder_is_never_touched(probe_fmu: Path, tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("precious")
    with pytest.raises(CosimError, match="is not empty; choose a new one"):
        simulate(pair(probe_fmu), RunSettings(stop=1.0, record=ALL), tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == ["mine.txt"]


def test_a_folder_that_cannot_be_made_is_one_clear_line(probe_fmu: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(CosimError, match=r"^results folder .*file.run: Not a directory; choose another$"):
        simulate(pair(probe_fmu), RunSettings(stop=1.0, record=ALL), tmp_path / "file" / "run")


@pytest.mark.skipif(sys.platform == "win32", reason="needs a file size limit of the operating system")
def test_a_full_disk_is_one_clear_line_and_keeps_what_was_written(
    probe_fmu: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import resource

    monkeypatch.setattr("cosim.recording.PART_BYTES", 100_000)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)

    def fill(time: float) -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (65_536, hard))

    settings = RunSettings(stop=2000.0, step=0.01, record=ALL)
    try:
        with pytest.raises(RunFailed, match=r"writing failed: .*; free disk space or choose another$"):
            simulate(pair(probe_fmu, a_u=1.0), settings, tmp_path / "run", fill)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    kept = read_results(tmp_path / "run")
    assert len(kept) > 1000
    assert kept.index.is_monotonic_increasing


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (RunSettings(stop=0.0), "stop 0 s must be finite and after start 0 s"),
        (RunSettings(stop=1.0, step=0.0), "step 0 s must be positive"),
        (RunSettings(stop=1.0, step=math.nan), "step nan s must be positive"),
        (RunSettings(stop=1.0, step=0.3), "not a whole number of steps of 0.3 s; use 0.9 or 1.2"),
        (RunSettings(stop=1.0, decimation=0), "decimation 0 must be 1 or more"),
        (RunSettings(stop=1.0, transient=1.0), "transient 1 s leaves nothing"),
        (RunSettings(stop=1.0, algorithm="newtn"), "no algorithm 'newtn'; did you mean 'newton'"),  # type: ignore[arg-type]
        (RunSettings(stop=1.0, record=ALL, order=("c",)), "order: no component 'c'"),
        (RunSettings(stop=1.0, record=("a.integrl",)), "did you mean 'a.integral'"),
        (RunSettings(stop=1.0), "nothing to record"),
        (
            RunSettings(stop=1.0, channels=(Channel("X", "a.u", "m"),)),
            "channel X: a.u: 'deg' cannot be converted to 'm'",
        ),
    ],
)
def test_bad_settings_are_refused_before_anything_is_written(
    probe_fmu: Path, tmp_path: Path, settings: RunSettings, words: str
) -> None:
    with pytest.raises(CosimError) as refused:
        simulate(pair(probe_fmu), settings, tmp_path / "run")
    assert words in str(refused.value)
    assert "\n" not in str(refused.value)
    assert not (tmp_path / "run").exists()
