"""Components composed into one: closed forms, exact algebraic loops, sample instants, and agreement of the FMU."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import fmpy.validation
import numpy as np
import pytest

from fmus_src.barge.model import component as barge
from fmus_src.barge.turbine import nrel_5mw_barge
from fmus_src.component import Component
from fmus_src.compose import compose
from fmus_src.equations import Equations, derive
from fmus_src.instance import Instance, simulate
from fmus_src.tmd.model import component as tmd

from .barge_states import SWITCHES
from .conftest import every_feature
from .cosim_fmus import carried, mass
from .loaded import Loaded, initialised

G = 9.80665
TWO_MASSES = [("structure.position", "damper.point"), ("damper.force", "structure.force")]


def two_masses(internal_step: float) -> Component:
    return compose("two", {"structure": mass(), "damper": carried()}, TWO_MASSES, internal_step=internal_step)


def test_two_masses_swing_as_in_closed_form() -> None:
    """1 kg and 0.5 kg on a spring of 1 N/m, stretched by 1 m: cos(sqrt(3) t) apart; the error falls by 2^4."""
    errors = []
    for step in (0.02, 0.01):
        result = simulate(two_masses(step), stop=2.0, step=0.1, parameters={"damper.m": 0.5, "damper.x_0": 1.0})
        apart = result["damper.position"] - result["structure.position"]
        errors.append(float((apart - np.cos(np.sqrt(3.0) * result.index)).abs().max()))
        at_rest = result["structure.velocity"] + 0.5 * result["damper.velocity"]
        assert at_rest.abs().max() < 1e-14  # momentum: linear, so that Runge-Kutta keeps it to round-off
    assert errors[1] < 2e-9
    assert 15.0 < errors[0] / errors[1] < 17.0


def body() -> Component:
    """m a = force, with the acceleration as output."""
    c = Component("body", "Mass that tells its acceleration")
    m = c.parameter("m", 3.0, unit="kg", description="mass")
    push = c.input("push", unit="N", description="given force")
    force = c.input("force", 2, unit="N", description="force of what is attached")
    v = c.state("v", unit="m/s", description="velocity")
    total = c.intermediate("total", push + force[0] + force[1])
    c.derivative(v, total / m)
    c.output("acceleration", total / m, unit="m/s2", description="acceleration")
    return c


def attached(power: int) -> Component:
    """A force -m a^power."""
    c = Component("attached", "Mass felt as a force")
    m = c.parameter("m", 1.0, unit="kg", description="mass")
    a = c.input("acceleration", unit="m/s2", description="acceleration of the body")
    c.output("force", -m * a**power, unit="N", description="force on the body")
    return c


def loop(powers: tuple[int, int]) -> Component:
    parts = {"body": body(), **{f"a{i}": attached(power) for i, power in enumerate(powers, start=1)}}
    connections = [("body.acceleration", f"a{i}.acceleration") for i in (1, 2)]
    return compose("loop", parts, [*connections, *((f"a{i}.force", f"body.force[{i}]") for i in (1, 2))])


def test_affine_loop_is_solved_exactly() -> None:
    """Two masses carried along, heavier than the body: fixed-point iteration would diverge. It leads through an
    intermediate result of the body."""
    instance = Instance(loop((1, 1)))
    instance.set({"body.push": 7.0, "a1.m": 5.0, "a2.m": 11.0})
    instance.initialise()
    assert instance.get("body.acceleration") == pytest.approx(7.0 / 19.0, rel=1e-14)
    assert instance.derivative() == pytest.approx([7.0 / 19.0], rel=1e-14)
    assert instance.get("a2.force") == pytest.approx(-77.0 / 19.0, rel=1e-14)


def test_a_loop_that_is_not_affine_is_refused_by_its_path() -> None:
    with pytest.raises(ValueError, match="loop: algebraic loop that is not affine: ") as error:
        loop((1, 2))
    steps = str(error.value).split(": ")[-1].split(" -> ")
    assert steps[0] == steps[-1]
    assert set(steps) == {
        "body.acceleration", "a2.acceleration", "a2.force", "body.force[2]", "lookup 'total' of body",
    }  # fmt: skip


def exchanger(at_start: bool, sample_time: float = 0.1) -> Component:
    """A sampled value that becomes twice what the other has."""
    c = Component("exchanger", "Takes twice the other's value", sample_time=sample_time, sample_at_start=at_start)
    first = c.parameter("first", 1.0, description="value at the start")
    other = c.input("other", description="value of the other")
    ramp = c.input("ramp", description="a continuous value")
    z = c.sampled_state("z", start=first, description="value")
    seen = c.sampled_state("seen", description="the continuous value at the sample")
    c.update(z, 2 * other)
    c.update(seen, ramp)
    c.output("value", z, description="value")
    return c


def clock() -> Component:
    c = Component("clock", "Tells the time as a state")
    x = c.state("x", unit="s", description="time")
    c.derivative(x, 1.0)
    c.output("t", x, unit="s", description="time")
    return c


@pytest.mark.parametrize("at_start", [(False, False), (True, False), (True, True)])
def test_at_an_instant_all_see_the_values_before(at_start: tuple[bool, bool]) -> None:
    """Both take twice the other's value of before the instant, whichever comes first."""
    parts = {"a": exchanger(at_start[0]), "b": exchanger(at_start[1]), "clock": clock()}
    wires = [("a.value", "b.other"), ("b.value", "a.other"), ("clock.t", "a.ramp"), ("clock.t", "b.ramp")]
    pair = compose("pair", parts, wires, internal_step=0.05)
    result = simulate(pair, stop=0.5, step=0.05, parameters={"a.first": 1.0, "b.first": 10.0})
    a, b = 1.0, 10.0
    for instant in range(6):
        taken = [2 * b if instant or at_start[0] else a, 2 * a if instant or at_start[1] else b]
        a, b = taken
        for half in (0.0, 0.05) if instant < 5 else (0.0,):
            row = result.iloc[round((0.1 * instant + half) / 0.05)]
            assert row[["a.value", "b.value"]].tolist() == [a, b]
            assert row["a.seen"] == pytest.approx(0.1 * instant, abs=1e-12)


def test_mistakes_in_a_composition_are_named() -> None:
    parts = {"a": exchanger(False), "b": exchanger(False)}
    for wires, message in (
        ([("a.value", "b.others")], r"pair: no input 'b\.others'"),
        ([("a.values", "b.other")], r"pair: no output or parameter or calculated 'a\.values'"),
        ([("a.value", "b.other"), ("a.first", "b.other")], "b.other has two sources: a.value and a.first"),
    ):
        with pytest.raises(ValueError, match=message):
            compose("pair", parts, wires)
    with pytest.raises(ValueError, match=r"share one sample time, but have a 0\.1 s, b 0\.2 s"):
        compose("pair", {"a": exchanger(False), "b": exchanger(False, 0.2)})
    with pytest.raises(ValueError, match="2 values cannot feed 1"):
        compose("pair", {"a": every_feature(), "b": exchanger(False)}, [("a.rotated", "b.other")])


@pytest.fixture(scope="module")
def every_part() -> Component:
    """Every feature twice over: tables, implicit equations, intermediates, texts, sampled states; and a loop."""
    parts = {"one": every_feature(), "two": every_feature(), "body": body(), "added": attached(1)}
    wires = [
        ("one.rotated", "two.u"),
        ("one.root[1]", "body.push", 2.0, 0.5),
        ("body.acceleration", "added.acceleration"),
        ("added.force", "body.force[2]"),
    ]
    return compose("every_part", parts, wires, internal_step=0.02)


def test_fmu_of_a_composition_agrees_and_validates(
    every_part: Component, built: Callable[[Component], Path], tmp_path: Path
) -> None:
    path = built(every_part)
    assert fmpy.validation.validate_fmu(str(path)) == []
    fmu = Loaded(path, tmp_path)
    listed = {v.name: v for v in fmu.description.modelVariables}
    assert not fmu.description.coSimulation.providesDirectionalDerivative
    assert [n for n, v in listed.items() if v.causality == "input"] == ["one.u[1]", "one.u[2]", "body.force[1]"]
    assert {n for n, v in listed.items() if v.type == "String"} == {"one.file", "two.file"}
    names = [n for n, v in listed.items() if v.causality == "output"]
    values = {"two.rate": 3.0, "one.u[1]": 0.3, "one.u[2]": 0.2, "added.m": 4.0, "body.force[1]": 0.1}
    slave, twin = initialised(fmu, values), Instance(every_part)
    twin.set(values)
    twin.initialise()
    for i in range(10):
        slave.doStep(0.06 * i, 0.06)
        twin.do_step(0.06)
    ours = twin.outputs()
    # The same operations in the same order; only the rounding of library functions and sums may differ.
    assert slave.getReal(fmu.vr(*names)) == pytest.approx([ours[n] for n in names], rel=1e-11, abs=1e-11)
    # (3 + 4) kg under 2 root + 0.5 and 0.1 N, and the sampled states of both.
    assert ours["body.acceleration"] == pytest.approx((2 * ours["one.root[1]"] + 0.6) / 7.0, rel=1e-12)
    assert [ours["two.held[1]"], twin.get("one.z")] == [pytest.approx(ours["two.held[1]"]), 3 + 6]
    slave.freeInstance()


@pytest.fixture(scope="module")
def damped_barge() -> Equations:
    """The barge with a damper in the platform and one in the nacelle, which close algebraic loops."""
    parts = {"barge": barge(), "nacelle_damper": tmd(), "platform_damper": tmd()}
    wires: list[tuple[str, str]] = []
    for damper in ("nacelle_damper", "platform_damper"):
        motions = ("specific_force", "angular_velocity", "angular_acceleration")
        wires += [(f"barge.{damper}.{motion}", f"{damper}.attachment.{motion}") for motion in motions]
        wires += [(f"{damper}.{load}", f"barge.{damper}.{load}") for load in ("force", "moment")]
    return derive(compose("damped_barge", parts, wires))


def with_free(equations: Equations, free: tuple[str, ...], values: dict[str, float]) -> Instance:
    instance = Instance(equations)
    instance.set({f"barge.dof.{name}": float(name in free) for name in SWITCHES} | values)
    instance.initialise()
    return instance


def test_dampers_are_carried_by_the_barge_exactly(damped_barge: Equations) -> None:
    """In heave alone the dampers are part of the mass; fore-aft the platform's has the closed form's damping."""
    lifted = with_free(damped_barge, ("heave",), {"barge.hydro.force[3]": 1e8})
    total = 5.452e6 + 240000.0 + lifted.get("barge.rotor.mass") + nrel_5mw_barge().tower.integrals.mass
    assert lifted.get("barge.platform.acceleration[3]") == pytest.approx(1e8 / (total + 40000.0) - G, rel=1e-12)

    m, k, c = 200_000.0, 52597.0, 11911.0
    values = {"platform_damper.m": m, "platform_damper.k": k, "platform_damper.c": c, "nacelle_damper.m": 1e-3,
              "nacelle_damper.k": 0.0, "nacelle_damper.c": 0.0}  # fmt: skip
    surging = with_free(damped_barge, ("surge",), values)
    x, h = surging._values["x"].copy(), 1e-3
    columns = [(surging.derivative(x + h * e) - surging.derivative(x - h * e)) / (2 * h) for e in np.eye(x.size)]
    exponents = np.linalg.eigvals(np.array(columns).T)
    reduced = m * total / (m + total)
    exact = np.roots([reduced, c, k])
    found = exponents[np.abs(exponents.imag) > 0.1]
    # Differences of a linear motion: round-off, and the nacelle damper's 1e-3 kg of the 6e6 kg.
    assert sorted(found.imag) == pytest.approx(sorted(exact.imag), rel=1e-8)
    assert found.real == pytest.approx(exact.real, rel=1e-8)


def test_loops_between_barge_and_dampers_agree_with_iteration(damped_barge: Equations) -> None:
    """All degrees of freedom, moving: accelerations as those that barge and dampers agree on when asked in turn."""
    rng = np.random.default_rng(5)
    composed = Instance(damped_barge)
    composed.set({"barge.hydro.force[3]": 6e7, "nacelle_damper.c": 2000.0})
    composed.initialise()
    x = composed._values["x"] + 0.05 * rng.uniform(-1, 1, composed._values["x"].size)
    composed.set_states(x)
    parts = {"barge": Instance(barge()), "nacelle_damper": Instance(tmd()), "platform_damper": Instance(tmd())}
    parts["barge"].set({"hydro.force[3]": 6e7})
    parts["nacelle_damper"].set({"c": 2000.0})
    first = 0
    for part in parts.values():
        part.initialise()
        size = part.equations.sizes["x"]
        part.set_states(x[first : first + size])
        first += size
    for _ in range(40):  # converges by the ratio of the masses, 1/20, each time
        motion = parts["barge"].outputs()
        for damper in ("nacelle_damper", "platform_damper"):
            names = [n for v in parts[damper].equations.of("input") for n in v.element_names()]
            parts[damper].set({n: motion[n.replace("attachment", damper)] for n in names})
            loads = parts[damper].outputs()
            parts["barge"].set({f"{damper}.{n}": v for n, v in loads.items() if n.startswith(("force", "moment"))})
    expected = np.concatenate([part.derivative() for part in parts.values()])
    np.testing.assert_allclose(composed.derivative(), expected, rtol=1e-9, atol=1e-9)
    assert np.abs(expected).max() > 1.0


def test_end_stops_are_located_in_a_composition_too() -> None:
    """A damper that rings against its stops: alone and as a part it takes the same steps, to round-off."""
    alone = tmd()
    alone.internal_step = 0.0125
    values = {"initial_displacement": 7.9, "stroke": 4.0, "c": 100.0}
    one = compose("one", {"damper": tmd(), "clock": clock()}, internal_step=0.0125)
    assert derive(one).switch_positions().size == derive(tmd()).switch_positions().size > 0
    expected = simulate(alone, stop=6.0, step=0.0125, parameters=values)
    found = simulate(one, stop=6.0, step=0.0125, parameters={f"damper.{n}": v for n, v in values.items()})
    assert expected["displacement"].min() < -4.0
    np.testing.assert_allclose(found["damper.displacement"], expected["displacement"], rtol=0, atol=1e-11)
