"""The master's coupling against closed forms: two parts of an oscillator, with the spring force between FMUs."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cosim.run import RunResult, RunSettings, simulate
from cosim.system import ComponentInstance, Connection, StartValue, System, with_parameters
from fmus_src.component import Component

from .cosim_fmus import carried, mass, two_masses

RECORD = ("structure.position", "structure.velocity", "damper.position", "damper.velocity")


@pytest.fixture(scope="module")
def system(built: Callable[[Component], Path]) -> System:
    return two_masses(built(mass()), built(carried()))


@pytest.fixture
def run(system: System, tmp_path: Path) -> Callable[..., RunResult]:
    def run(step: float, stop: float = 40.0, on: System = system, **settings: Any) -> RunResult:
        name = f"{step}-{'-'.join(map(str, settings.values()))}"
        return simulate(on, RunSettings(stop=stop, step=step, record=RECORD, **settings), tmp_path / name)

    return run


def damping(result: RunResult, m_1: float, m_2: float) -> float:
    """Damping ratio of the relative motion, from the slope of its energy's logarithm; k = 1 N/m."""
    frame = result.frame()
    x = frame["damper.position"] - frame["structure.position"]
    v = frame["damper.velocity"] - frame["structure.velocity"]
    reduced = 0.0 if m_2 == 0 else m_1 * m_2 / (m_1 + m_2)
    energy = 0.5 * x**2 + 0.5 * reduced * v**2
    omega = np.sqrt(1.0 / reduced)
    return float(-np.polyfit(frame.index, np.log(energy), 1)[0] / (2.0 * omega))


def test_default_keeps_an_undamped_system_undamped(run: Callable[..., RunResult]) -> None:
    # omega = sqrt(1 + 2) rad/s; at omega h = 0.043 the extrapolation error of the damping ratio is ~(omega h)^3 / 6.
    assert abs(damping(run(0.025), 1.0, 0.5)) < 1e-4


def test_momentum_is_kept(run: Callable[..., RunResult]) -> None:
    """No external force: the centre of mass stays where it was (x_2 = 1 m on 0.5 kg, so at 1/3 m)."""
    frame = run(0.025).frame()
    centre = (frame["structure.position"] + 0.5 * frame["damper.position"]) / 1.5
    # The force that the structure sees is the extrapolated one: its impulse errs by O((omega h)^2) per period.
    assert np.abs(centre - 1.0 / 3.0).max() < 1e-3


def test_linear_extrapolation_converges_with_second_order(run: Callable[..., RunResult]) -> None:
    def error(step: float) -> float:
        frame = run(step, stop=10.0).frame()
        exact = np.cos(np.sqrt(3.0) * frame.index)
        return float(np.abs(frame["damper.position"] - frame["structure.position"] - exact).max())

    coarse, middle, fine = (error(h) for h in (0.1, 0.05, 0.025))
    # 4 for exact second order; the damping part of the error is of third order, hence the upper bound.
    assert 3.5 < coarse / middle < 8.5
    assert 3.5 < middle / fine < 8.5


@pytest.mark.parametrize(("algorithm", "share"), [("gauss-seidel", -0.25), ("jacobi", -0.75)])
def test_held_inputs_damp_negatively_as_theory_says(
    run: Callable[..., RunResult], system: System, algorithm: str, share: float
) -> None:
    """A delay tau of the restoring force is a damping ratio -omega tau / 2: tau = h/2 and 3h/2.

    The moved end is so heavy here that the spring's force on the light mass crosses the coupling as a whole.
    """
    light = with_parameters(system, {"damper.m": 1e6, "damper.x_0": 0.0, "structure.x_0": 1.0})
    for h in (0.1, 0.05):
        measured = damping(run(h, on=light, algorithm=algorithm, extrapolation="held"), 1.0, 1e6)
        # the next term of the expansion is (omega h)^3: 1 % of the first at h = 0.1 s; Jacobi's is larger
        assert measured == pytest.approx(share * h, rel=0.02)


def test_jacobi_with_extrapolation_is_of_the_same_order(run: Callable[..., RunResult]) -> None:
    # Jacobi extrapolates both ways, with a coefficient about four times that of Gauss-Seidel (measured: 4.1).
    assert abs(damping(run(0.025, algorithm="jacobi"), 1.0, 0.5)) < 2e-4


def test_results_do_not_depend_on_the_length_of_blocks(
    run: Callable[..., RunResult], system: System, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    reference = run(0.1).frame()
    monkeypatch.setattr("cosim.run.BLOCK_SIMULATED", 0.3)
    again = simulate(system, RunSettings(stop=40.0, step=0.1, record=RECORD), tmp_path / "short").frame()
    assert reference.equals(again)


def test_order_can_be_given(run: Callable[..., RunResult], system: System) -> None:
    """The damper first: it then extrapolates the structure's motion, still without damping of its own."""
    reversed_order = run(0.025, order=("damper",))
    assert abs(damping(reversed_order, 1.0, 0.5)) < 2e-4
    assert not reversed_order.frame().equals(run(0.025).frame())


def test_agrees_with_the_fmpy_simulation_of_a_single_fmu(built: Callable[[Component], Path], tmp_path: Path) -> None:
    import fmpy

    path = built(mass())
    values = {"force": 2.0, "m": 4.0, "x_0": 1.0}
    system = System("one", (ComponentInstance("one", path, {n: StartValue(v) for n, v in values.items()}),))
    ours = simulate(system, RunSettings(stop=5.0, step=0.05, record=("one.position",)), tmp_path / "ours").frame()
    theirs = fmpy.simulate_fmu(
        str(path), stop_time=5.0, output_interval=0.05, start_values=values, output=["position"], use_event_mode=False
    )
    # the same binary, steps and input: what differs is fmpy's accumulated time
    np.testing.assert_allclose(ours["one.position"], theirs["position"], rtol=1e-12)
    np.testing.assert_allclose(ours["one.position"], 1.0 + 0.25 * ours.index.to_numpy() ** 2, rtol=1e-9)


def test_one_fmu_can_serve_twice(built: Callable[[Component], Path], tmp_path: Path) -> None:
    """A mass on a spring to a very heavy one: x = cos(sqrt(k / m) t); a second, loose spring-mass stays at rest."""
    m, s = built(mass()), built(carried())
    heavy = {"m": StartValue(1e9)}
    system = System(
        "twice",
        (
            ComponentInstance("wall", s, heavy),
            ComponentInstance("mass", m, {"x_0": StartValue(1.0), "m": StartValue(0.5)}),
            ComponentInstance("loose", s, heavy),
        ),
        (Connection("mass", "position", "wall", "point"), Connection("wall", "force", "mass", "force")),
    )
    result = simulate(system, RunSettings(stop=5.0, step=0.01, record=("*.position",)), tmp_path / "twice")
    frame = result.frame()
    # the coupling's phase error is of second order: (omega h)^2 = 2e-4
    np.testing.assert_allclose(frame["mass.position"], np.cos(np.sqrt(2.0) * frame.index), atol=3e-4)
    assert np.all(frame["loose.position"] == 0.0)
    assert any(w.startswith("loose: not connected") for w in result.warnings)


def test_agrees_with_libcosim_where_that_has_the_same_algorithm(
    system: System, run: Callable[..., RunResult], tmp_path: Path
) -> None:
    """libcosim is a Jacobi master with held inputs: the same values at every communication point."""
    pytest.importorskip("libcosimpy")
    from libcosimpy.CosimExecution import CosimExecution
    from libcosimpy.CosimLogging import CosimLogLevel, log_output_level
    from libcosimpy.CosimObserver import CosimObserver
    from libcosimpy.CosimSlave import CosimLocalSlave

    log_output_level(CosimLogLevel.FATAL)
    execution = CosimExecution.from_step_size(50_000_000)  # ns
    slaves = [CosimLocalSlave(fmu_path=str(c.fmu), instance_name=c.name) for c in system.components]
    index = {c.name: execution.add_local_slave(s) for c, s in zip(system.components, slaves, strict=True)}
    reference = {k: {v.name.decode(): v.reference for v in execution.slave_variables(i)} for k, i in index.items()}
    for name, start in system.component("damper").start.items():
        execution.real_initial_value(index["damper"], reference["damper"][name], start.value)
    for c in system.connections:
        execution.connect_real_variables(
            index[c.source], reference[c.source][c.output], index[c.target], reference[c.target][c.input]
        )
    observer = CosimObserver.create_last_value()
    execution.add_observer(observer)
    ours = run(0.05, stop=10.0, algorithm="jacobi", extrapolation="held").frame()
    for _, row in ours.iloc[1:].iterrows():
        execution.step()
        for name, i in index.items():
            theirs = observer.last_real_values(i, [reference[name]["position"]])[0]
            # rounding only (measured 4e-14 after 200 steps): the binaries and the inputs are the same
            assert row[f"{name}.position"] == pytest.approx(theirs, abs=1e-12)


def test_runs_in_threads_do_not_disturb_each_other(system: System, tmp_path: Path) -> None:
    from concurrent.futures import ThreadPoolExecutor

    settings = RunSettings(stop=20.0, step=0.05, record=RECORD)
    with ThreadPoolExecutor(4) as pool:
        runs = [pool.submit(simulate, system, settings, tmp_path / str(i)) for i in range(8)]
        last = [r.result().last for r in runs]
    assert all(values == last[0] for values in last)
