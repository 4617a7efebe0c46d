"""The master's algorithms against closed forms: order, iteration, algebraic loops, sampled signals, rates, shocks."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

from cosim.errors import CosimError, RunFailed
from cosim.run import RunResult, RunSettings, simulate
from cosim.system import ComponentInstance, Connection, Port, StartValue, System, with_parameters
from fmus_src.component import Component

from .cosim_fmus import carried, mass, two_masses

Run = Callable[..., RunResult]
OMEGA = np.sqrt(3.0)  # of 1 kg and 0.5 kg joined by 1 N/m


@pytest.fixture(scope="module")
def oscillator(built: Callable[[Component], Path]) -> System:
    system = two_masses(built(mass()), built(carried()))
    port = Port("spring", "structure", (("force", "velocity", "position"),))
    return System(system.name, system.components, system.connections, ports=(port,))


@pytest.fixture
def run(tmp_path: Path) -> Run:
    def run(system: System, step: float, stop: float = 10.0, **settings: Any) -> RunResult:
        chosen = {"record": ("*.*",), "energy_tolerance": 0.0} | settings
        return simulate(
            system, RunSettings(stop=stop, step=step, **chosen), tmp_path / str(len(list(tmp_path.iterdir())))
        )

    return run


def stretch_error(result: RunResult) -> float:
    frame = result.frame()
    return float(np.abs(frame["damper.position"] - frame["structure.position"] - np.cos(OMEGA * frame.index)).max())


@pytest.mark.parametrize(
    ("settings", "order"),
    [  # measured orders in brackets; held inputs are of first order, each order of extrapolation adds one
        ({"extrapolation": "held"}, (0.9, 1.2)),
        ({"extrapolation": "linear"}, (1.9, 3.2)),
        ({"extrapolation": "quadratic"}, (2.9, 4.2)),
        ({"algorithm": "jacobi", "extrapolation": "held"}, (0.9, 1.5)),
        ({"algorithm": "jacobi", "extrapolation": "linear"}, (1.9, 3.2)),
        ({"algorithm": "iterated"}, (3.7, 4.5)),
        ({"algorithm": "newton"}, (3.7, 4.5)),
    ],
)
def test_observed_order(run: Run, oscillator: System, settings: dict[str, str], order: tuple[float, float]) -> None:
    errors = [stretch_error(run(oscillator, h, **settings)) for h in (0.2, 0.1, 0.05)]
    observed = np.log2(np.array(errors[:-1]) / errors[1:])
    assert order[0] < observed[-1] < order[1], (errors, observed)


@pytest.mark.parametrize(("extrapolation", "order"), [("linear", 2), ("quadratic", 3)])
def test_the_first_step_costs_no_order(
    run: Run, built: Callable[[Component], Path], extrapolation: str, order: int
) -> None:
    """A system that moves from the start: the first step is rehearsed, as nothing before it can be extrapolated."""
    thrown = Component("thrown", "Mass that moves at the start", internal_step=1e-3)
    f = thrown.input("force", unit="N", description="force")
    x = thrown.state("x", unit="m", description="position")
    v = thrown.state("v", unit="m/s", description="velocity", start=1.0)
    thrown.derivative(x, v)
    thrown.derivative(v, f)
    thrown.output("position", x, unit="m", description="position")
    system = two_masses(built(thrown), built(carried()), stretch=0.0)

    def error(step: float) -> float:
        frame = run(system, step, extrapolation=extrapolation).frame()
        return float(
            np.abs(frame["damper.position"] - frame["structure.position"] + np.sin(OMEGA * frame.index) / OMEGA).max()
        )

    assert np.log2(error(0.05) / error(0.025)) == pytest.approx(order, abs=0.1)


def test_iterated_coupling_agrees_with_itself(run: Run, oscillator: System) -> None:
    """Fixed point with Aitken's factor and Newton solve the same equations: equal to the iteration's tolerance."""
    a, b = (run(oscillator, 0.1, algorithm=name).frame() for name in ("iterated", "newton"))
    # 100 steps with an error of 1e-10 each
    np.testing.assert_allclose(a.to_numpy(), b.to_numpy(), atol=1e-8)


@pytest.mark.parametrize(
    ("settings", "m_2", "tolerance"),
    [  # The residual is an estimate from what crosses the port. Measured deviations: 0.4, 10, 20, 28 and 0.001 %.
        ({"extrapolation": "linear"}, 0.5, 0.05),
        ({"extrapolation": "linear"}, 1e6, 0.15),
        ({}, 0.5, 0.3),
        ({"algorithm": "jacobi", "extrapolation": "linear"}, 1e6, 0.4),
        ({"extrapolation": "held"}, 1e6, 1e-3),
    ],
)
def test_energy_residual_is_the_energy_that_the_coupling_adds(
    run: Run, oscillator: System, settings: dict[str, str], m_2: float, tolerance: float
) -> None:
    """No damping anywhere: what the oscillator's energy changes by over the run comes from the coupling."""
    starts = {"damper.m": m_2} | ({"damper.x_0": 0.0, "structure.x_0": 1.0} if m_2 > 1.0 else {})
    result = run(with_parameters(oscillator, starts), 0.05, stop=20.0, **settings)
    frame = result.frame()
    energy = (
        0.5 * frame["structure.velocity"] ** 2
        + 0.5 * m_2 * frame["damper.velocity"] ** 2
        + 0.5 * (frame["damper.position"] - frame["structure.position"]) ** 2
    )
    gained = float(energy.iloc[-1] - energy.iloc[0])
    assert result.ports["spring"]["residual"] == pytest.approx(gained, rel=tolerance)
    # crossed: the work done back and forth, 2 k A^2 = 2 J per period at a fixed end
    assert result.ports["spring"]["crossed"] > 1.0


def test_large_residuals_are_warned_of_and_iterated_coupling_has_none(run: Run, oscillator: System) -> None:
    held, linear, iterated = (
        run(oscillator, 0.05, **s) for s in ({"extrapolation": "held"}, {}, {"algorithm": "newton"})
    )
    assert any(w.startswith("port spring: the coupling added") for w in held.warnings)
    assert linear.warnings == iterated.warnings == ()
    # of fourth order: the position is a parabola over the step, and the velocity another (measured 2.7e-8)
    assert abs(iterated.ports["spring"]["residual"]) < 1e-7 * iterated.ports["spring"]["crossed"]


def gain() -> Component:
    """y = slope u + intercept + s sin(u): direct feed-through."""
    c = Component("gain", "A gain")
    slope = c.parameter("slope", 0.5, description="slope")
    intercept = c.parameter("intercept", 1.0, description="intercept")
    s = c.parameter("s", 0.0, description="share of the sine")
    u = c.input("u", description="input")
    c.output("y", slope * u + intercept + s * ca.sin(u), description="output")
    return c


def loop(fmu: Path, a: dict[str, float], b: dict[str, float]) -> System:
    parts = tuple(
        ComponentInstance(n, fmu, {k: StartValue(v) for k, v in values.items()}) for n, values in (("a", a), ("b", b))
    )
    return System("loop", parts, (Connection("a", "y", "b", "u"), Connection("b", "y", "a", "u")))


@pytest.mark.parametrize("slope", [0.5, -0.9, -3.0, 40.0])
def test_algebraic_loops_are_solved_whatever_their_gain(
    run: Run, built: Callable[[Component], Path], slope: float
) -> None:
    """y_a = slope y_b + 1, y_b = slope y_a + 2: substitution alone diverges for |slope| > 1."""
    result = run(
        loop(built(gain()), {"slope": slope}, {"slope": slope, "intercept": 2.0}), 0.1, stop=1.0, tolerance=1e-10
    )
    exact = (1.0 + 2.0 * slope) / (1.0 - slope**2)
    np.testing.assert_allclose(
        result.frame()["a.y"], exact, rtol=1e-8
    )  # the tolerance, amplified by the small solution


def test_nonlinear_loop(run: Run, built: Callable[[Component], Path]) -> None:
    result = run(loop(built(gain()), {"s": 0.8}, {"slope": -1.5}), 0.1, stop=0.5, tolerance=1e-12)
    a, b = result.last["a.y"], result.last["b.y"]
    assert a == pytest.approx(0.5 * b + 1.0 + 0.8 * np.sin(b), rel=1e-10)
    assert b == pytest.approx(-1.5 * a + 1.0, rel=1e-10)


def test_loops_of_small_quantities_are_solved_too(run: Run, built: Callable[[Component], Path]) -> None:
    """Tolerances refer to the nominal that an FMU declares."""
    c = Component("small", "A gain of small quantities")
    slope, intercept = (
        c.parameter("slope", -0.9, description="slope"),
        c.parameter("intercept", 1e-6, description="intercept"),
    )
    u = c.input("u", nominal=1e-6, description="input")
    c.output("y", slope * u + intercept, nominal=1e-6, description="output")
    result = run(loop(built(c), {}, {"intercept": 2e-6}), 0.1, stop=0.2)
    assert result.last["a.y"] == pytest.approx((1e-6 - 0.9 * 2e-6) / (1.0 - 0.81), rel=1e-4)


@pytest.mark.parametrize("algorithm", ["gauss-seidel", "newton"])
def test_a_loop_whose_gain_grows(run: Run, built: Callable[[Component], Path], algorithm: str) -> None:
    """y_a = t y_b + 1, y_b = -2 t y_a + 2: the Jacobian is renewed when it no longer serves."""
    c = Component("growing", "A gain that grows with time")
    slope, intercept = (
        c.parameter("slope", 1.0, description="rate"),
        c.parameter("intercept", 1.0, description="offset"),
    )
    u, clock = c.input("u", description="input"), c.state("clock", unit="s", description="time")
    c.derivative(clock, 1.0)
    c.output("y", slope * clock * u + intercept, description="output")
    frame = run(loop(built(c), {}, {"slope": -2.0, "intercept": 2.0}), 0.05, stop=4.0, algorithm=algorithm).frame()
    t = frame.index.to_numpy()
    np.testing.assert_allclose(frame["a.y"], (1.0 + 2.0 * t) / (1.0 + 2.0 * t**2), atol=2e-5)  # the loops' tolerance


def test_loop_without_solution_is_refused_with_its_path(run: Run, built: Callable[[Component], Path]) -> None:
    """y_a = y_b + 1, y_b = y_a + 1."""
    with pytest.raises(RunFailed, match=r"does not settle at t = 0 s \(algebraic loop a.* -> b.* -> .*\)"):
        run(loop(built(gain()), {"slope": 1.0}, {"slope": 1.0}), 0.1, stop=1.0)


def test_held_inputs_leave_loops_open_and_say_so(run: Run, built: Callable[[Component], Path]) -> None:
    result = run(loop(built(gain()), {}, {}), 0.1, stop=1.0, extrapolation="held")
    assert any(w.startswith("algebraic loop, its values held over each step: ") for w in result.warnings)


def sampler() -> Component:
    """Holds the value that its input had at the last multiple of 0.1 s."""
    c = Component("sampler", "Sample and hold", sample_time=0.1)
    u = c.input("u", unit="m", description="input")
    z = c.sampled_state("z", unit="m", description="sampled input")
    c.update(z, u)
    c.output("held", z, unit="m", description="sampled input")
    c.output("force", -z, unit="N", description="minus the sampled input")
    return c


@pytest.mark.parametrize("settings", [{}, {"extrapolation": "quadratic"}, {"algorithm": "newton"}])
@pytest.mark.parametrize("order", [1, -1])
def test_sampled_signals_are_exact_whatever_the_order_in_the_file(
    run: Run, built: Callable[[Component], Path], settings: dict[str, str], order: int
) -> None:
    """A mass pushed by a force that is sampled each 0.1 s: between the samples its motion is a parabola."""
    parts = (
        ComponentInstance("structure", built(mass()), {"x_0": StartValue(1.0)}),
        ComponentInstance("sampler", built(sampler())),
    )
    wires = (Connection("structure", "position", "sampler", "u"), Connection("sampler", "force", "structure", "force"))
    system = System("sampled", parts[::order], wires)
    frame = run(system, 0.025, stop=5.0, **settings).frame()
    x, v, force, exact = 1.0, 0.0, 0.0, []
    for n in range(len(frame)):
        exact.append(x)
        x, v = x + 0.025 * v + 0.5 * 0.025**2 * force, v + 0.025 * force
        if (n + 1) % 4 == 0:
            force = -x
    # Runge-Kutta integrates a parabola exactly: what is left is rounding over 200 steps
    np.testing.assert_allclose(frame["structure.position"], exact, atol=1e-11)


def test_slow_and_fast_components(run: Run, oscillator: System) -> None:
    """A component that steps at a multiple or a fraction of the step: still of second order, near the usual result."""

    def error(step: float, rate: float) -> float:
        return stretch_error(run(oscillator, step, extrapolation="linear", rates={"damper": rate}))

    assert error(0.05, 0.25) == pytest.approx(error(0.05, 1.0), rel=0.05)
    slow = [error(h, 2.0) for h in (0.05, 0.025, 0.0125)]
    assert np.log2(slow[1] / slow[2]) > 1.8
    # the slow end's force is extrapolated over two steps: about the error of the doubled step
    assert slow[1] < 2.0 * error(0.05, 1.0)


@pytest.mark.parametrize("rate", [1.5, 0.0, -1.0, 0.3])
def test_rates_that_make_no_sense_are_refused(run: Run, oscillator: System, rate: float) -> None:
    with pytest.raises(CosimError, match="rate of damper"):
        run(oscillator, 0.05, rates={"damper": rate})
    with pytest.raises(CosimError, match="no such component; did you mean 'damper'"):
        run(oscillator, 0.05, rates={"dampr": 2.0})
    with pytest.raises(CosimError, match=r"newton.*takes no multiples of the step"):
        run(oscillator, 0.05, rates={"damper": 2.0}, algorithm="newton")


def stopped() -> Component:
    """As `carried`, with a dashpot to the point that acts once the mass has come closer than `gap`: a shock."""
    c = Component("stopped", "Mass on a spring to a moving point, with an end stop", internal_step=1e-3)
    gap = c.parameter("gap", -0.5, unit="m", description="where the stop begins")
    p = c.input("point", unit="m", description="position of the spring's other end")
    w = c.input("point_velocity", unit="m/s", description="velocity of the spring's other end")
    x = c.state("x", unit="m", description="position", start=1.0)
    v = c.state("v", unit="m/s", description="velocity")
    inside = x - p - gap
    force = (x - p) + ca.if_else(ca.logic_and(inside < 0, v < w), 5.0 * (v - w), 0)
    c.derivative(x, v)
    c.derivative(v, -2.0 * force)
    c.output("position", x, unit="m", description="position")
    c.output("force", force, unit="N", description="force on the point")
    return c


def test_steps_with_a_shock_are_halved(run: Run, built: Callable[[Component], Path]) -> None:
    """A force that jumps within a step: its impulse errs by jump times step unless the step is repeated in parts."""
    parts = (ComponentInstance("structure", built(mass())), ComponentInstance("damper", built(stopped())))
    wires = (
        Connection("structure", "position", "damper", "point"),
        Connection("structure", "velocity", "damper", "point_velocity"),
        Connection("damper", "force", "structure", "force"),
    )
    system = System("shock", parts, wires, ports=(Port("stop", "structure", (("force", "velocity", "position"),)),))
    exact = run(system, 0.001, stop=3.0, algorithm="newton", decimation=50, energy_tolerance=1e-5).frame()
    plain, halved = (run(system, 0.05, stop=3.0, energy_tolerance=e) for e in (0.0, None))
    errors = [np.abs(r.frame()["structure.position"] - exact["structure.position"]).max() for r in (plain, halved)]
    assert errors[1] < 0.1 * errors[0], errors
    # Momentum: only the shock's step is repeated, the other steps stay as they are given.
    assert len(halved.frame()) == len(plain.frame())


def test_steps_are_not_halved_where_a_component_cannot_follow(
    run: Run, built: Callable[[Component], Path], oscillator: System, tmp_path: Path
) -> None:
    from .cosim_fmus import probe

    both = {"energy_tolerance": 1e-6, "rates": {"damper": 2.0}}
    with pytest.raises(CosimError, match=r"no mechanical port to judge steps by; set it to 0"):
        run(oscillator, 0.1, **both)
    parts = (*oscillator.components, ComponentInstance("p", probe(tmp_path)))
    foreign = System("foreign", parts, oscillator.connections, ports=oscillator.ports)
    with pytest.raises(CosimError, match=r"p: probe\.fmu cannot save its state.*set it to 0"):
        run(foreign, 0.1, energy_tolerance=1e-6)
    assert len(run(foreign, 0.1, energy_tolerance=None).frame()) == 101  # by default it then runs without


def test_what_cannot_go_back_is_not_iterated(run: Run, built: Callable[[Component], Path], tmp_path: Path) -> None:
    from .cosim_fmus import probe

    system = System("probe", (ComponentInstance("p", probe(tmp_path)), ComponentInstance("m", built(mass()))))
    with pytest.raises(CosimError, match=r"p: probe.fmu cannot save its state .*use algorithm gauss-seidel"):
        run(system, 0.1, algorithm="iterated")


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"algorithm": "gaus-seidel"}, "no algorithm 'gaus-seidel'; did you mean 'gauss-seidel'"),
        ({"extrapolation": "cubic"}, "no extrapolation 'cubic'"),
        ({"tolerance": -1.0}, "tolerance -1 must be between 0 and 1"),
        ({"energy_tolerance": float("nan")}, "energy_tolerance nan must be between 0"),
    ],
)
def test_settings_out_of_range_are_refused(run: Run, oscillator: System, settings: dict[str, Any], words: str) -> None:
    with pytest.raises(CosimError, match=words):
        run(oscillator, 0.1, **settings)
