"""Model exchange: an importer's integrator on the exported equations gives what the components themselves give."""

from __future__ import annotations

from collections.abc import Callable
from ctypes import c_double, c_void_p
from pathlib import Path
from typing import Any

import fmpy
import fmpy.fmi2
import fmpy.fmi3
import numpy as np
import pandas as pd
import pytest
from fmpy.fmi1 import FMICallException

from fmus_src.component import Component
from fmus_src.export.build import build_fmu
from fmus_src.instance import Instance, simulate
from fmus_src.mooring.model import component as mooring
from fmus_src.servo.model import component as servo
from fmus_src.simplified.model import component as simplified
from fmus_src.tmd.model import component as tmd

from .conftest import every_feature
from .loaded import Loaded

VERSIONS = pytest.mark.parametrize("fmi", ["2", "3"])
TOLERANCE = 1e-9  # of CVode, per step


def refined(component: Component, internal_step: float) -> Component:
    component.internal_step = internal_step
    return component


def exchange(path: Path, stop: float, interval: float, output: list[str], **options: Any) -> Any:
    return fmpy.simulate_fmu(
        str(path), fmi_type="ModelExchange", solver="CVode", relative_tolerance=TOLERANCE, stop_time=stop,
        output_interval=interval, output=output, **options,
    )  # fmt: skip


def at_times(result: Any, times: pd.Index) -> dict[str, Any]:
    """Last recorded value at each time: at an event there are two."""
    rows = np.searchsorted(result["time"], np.asarray(times) + 1e-9) - 1
    return {name: result[name][rows] for name in result.dtype.names}


THROWN = {"stroke": 0.3, "initial_displacement": 1.2, "c_stop": 2e4}


@pytest.fixture(scope="module")
def thrown() -> pd.DataFrame:
    """A damper from stop to stop, by our own steps."""
    return simulate(refined(tmd(), 5e-3), stop=4.0, step=0.05, parameters=THROWN)


@VERSIONS
def test_stops_are_event_indicators(fmi: str, fmu_folder: Path, thrown: pd.DataFrame) -> None:
    names = ["displacement", "velocity", "stop_force"]
    result = exchange(build_fmu(tmd(), fmu_folder, fmi=fmi), 4.0, 0.05, names, start_values=THROWN, record_events=True)
    found = at_times(result, thrown.index)
    assert len(result) > len(thrown) + 6  # events beside the regular points: it reached both stops
    # CVode's error per step, over some hundred steps between which a contact may magnify it: 1e-6 of 1 m and 1e6 N.
    for name, scale in zip(names, (1.0, 1.0, 1e6), strict=True):
        np.testing.assert_allclose(found[name], thrown[name], rtol=0, atol=2e-6 * scale, err_msg=name)


@pytest.fixture(scope="module")
def pitching() -> pd.DataFrame:
    return simulate(refined(simplified(), 5e-3), stop=4.0, step=0.1)


@VERSIONS
def test_simplified_model_by_cvode(fmi: str, fmu_folder: Path, pitching: pd.DataFrame) -> None:
    """From 5 degrees of pitch; at 3.26 s the nacelle's damper meets its stop, where CVode stops at an exact zero."""
    names = ["tower_top_displacement", "nacelle_damper.relative_displacement", "nacelle_damper.stop_force"]
    result = exchange(build_fmu(simplified(), fmu_folder, fmi=fmi), 4.0, 0.1, names)
    found = at_times(result, pitching.index)
    assert (found["nacelle_damper.stop_force"] != 0.0).sum() == 3
    for name in names:
        # our own error against the stop's damper of 25 1/s in steps of 5 ms: 0.125^5 / 120 of its speed, eight times
        scale = max(1.0, float(np.abs(pitching[name]).max()))
        np.testing.assert_allclose(found[name], pitching[name], rtol=0, atol=5e-6 * scale, err_msg=name)


@VERSIONS
def test_samples_are_time_events(fmi: str, fmu_folder: Path) -> None:
    """The controller samples its speed at the instants, whatever points the importer asks for."""
    rising = lambda t: {"generator.speed": 118.0 + 2.0 * t}  # noqa: E731
    expected = simulate(servo(), stop=1.0, step=0.0125, inputs=rising)
    signals = np.array([(0.0, 118.0), (1.0, 120.0)], dtype=[("time", float), ("generator.speed", float)])
    names = ["generator_torque", "electrical_power", "filtered_speed"]
    result = exchange(build_fmu(servo(), fmu_folder, fmi=fmi), 1.0, 0.1, names, input=signals)
    found = at_times(result, expected.index[::8])
    for name in names:  # the same operations at the same instants: rounding of the interpolated input only
        np.testing.assert_allclose(found[name], expected[name].iloc[::8], rtol=1e-12, err_msg=name)


@VERSIONS
def test_implicit_equations_are_solved_wherever_asked(fmi: str, fmu_folder: Path) -> None:
    moved = np.array([5.0, -3.0, 0.5]), np.array([0.02, -0.03, 0.05])
    twin = Instance(mooring())
    dtype = [("time", float)]
    if fmi == "2":
        dtype += [(f"platform.{q}[{i}]", float) for q in ("position", "rotation") for i in (1, 2, 3)]
        rows = [(0.0, *np.zeros(6)), (2.0, *moved[0], *moved[1])]
        names = ["force[1]", "moment[2]", "fairlead_tension[1]"]
    else:
        dtype += [(f"platform.{q}", float, (3,)) for q in ("position", "rotation")]
        rows = [(0.0, np.zeros(3), np.zeros(3)), (2.0, *moved)]
        names = ["force", "moment", "fairlead_tension"]
    fmu = build_fmu(mooring(), fmu_folder, fmi=fmi)
    result = exchange(fmu, 2.0, 0.5, names, input=np.array(rows, dtype=dtype))
    for row in result:
        share = row["time"] / 2.0
        for q, value in zip(("position", "rotation"), moved, strict=True):
            twin.set({f"platform.{q}[{i + 1}]": share * value[i] for i in range(3)})
        twin.initialise()
        found = [row["force[1]"], row["moment[2]"], row["fairlead_tension[1]"]] if fmi == "2" else [
            row["force"][0], row["moment"][1], row["fairlead_tension"][0]
        ]  # fmt: skip
        # Newton's residual of 1e-12 of a line of 1e3 m and 1e6 N, from different first guesses
        expected = [twin.get("force[1]"), twin.get("moment[2]"), twin.get("fairlead_tension[1]")]
        assert found == pytest.approx(expected, rel=1e-8, abs=1e-2)


class Exchanged:
    """A model-exchange instance of FMI 2.0, in continuous-time mode."""

    def __init__(self, fmu: Loaded, values: dict[str, float] | None = None) -> None:
        self.fmu = fmu
        self.n = len(fmu.description.derivatives)
        self.model = fmpy.fmi2.FMU2Model(
            guid=fmu.description.guid, unzipDirectory=str(fmu.folder),
            modelIdentifier=fmu.description.modelExchange.modelIdentifier, instanceName="one",
        )  # fmt: skip
        callbacks = fmpy.fmi2.fmi2CallbackFunctions()
        callbacks.logger = fmpy.fmi2.fmi2CallbackLoggerTYPE(fmu._log)
        callbacks.allocateMemory = fmpy.fmi2.fmi2CallbackAllocateMemoryTYPE(fmpy.fmi2.calloc)
        callbacks.freeMemory = fmpy.fmi2.fmi2CallbackFreeMemoryTYPE(fmpy.fmi2.free)
        self.model.instantiate(callbacks=callbacks)
        self.model.setupExperiment(startTime=0.0)
        if values:
            self.model.setReal(fmu.vr(*values), list(values.values()))
        self.model.enterInitializationMode()
        self.model.exitInitializationMode()
        self.next_event = self.model.newDiscreteStates()[-1]
        self.model.enterContinuousTimeMode()

    def set(self, values: dict[str, float]) -> None:
        self.model.setReal(self.fmu.vr(*values), list(values.values()))

    def get(self, *names: str) -> list[float]:
        return list(self.model.getReal(self.fmu.vr(*names)))

    def states(self) -> Any:
        buffer = (c_double * self.n)()
        self.model.getContinuousStates(buffer, self.n)
        return np.array(buffer)

    def rate(self, t: float, x: Any, inputs: dict[str, float] | None = None) -> Any:
        self.model.setTime(t)
        self.model.setContinuousStates((c_double * self.n)(*x), self.n)
        if inputs:
            self.set(inputs)
        buffer = (c_double * self.n)()
        self.model.getDerivatives(buffer, self.n)
        return np.array(buffer)

    def indicators(self) -> Any:
        n = self.fmu.description.numberOfEventIndicators
        buffer = (c_double * n)()
        self.model.getEventIndicators(buffer, n)
        return np.array(buffer)

    def event(self) -> None:
        self.model.enterEventMode()
        self.next_event = self.model.newDiscreteStates()[-1]
        self.model.enterContinuousTimeMode()


@pytest.fixture
def feature(built: Callable[[Component], Path], tmp_path: Path) -> Loaded:
    return Loaded(built(every_feature()), tmp_path)


def test_rates_at_any_time_state_and_input_are_those_of_the_definition(feature: Loaded) -> None:
    """In any order: intermediate results, tables and implicit solutions follow, nothing stale is left."""
    one, twin = Exchanged(feature), Instance(every_feature())
    twin.initialise()
    random = np.random.default_rng(1)
    for _ in range(30):
        # x[1] below 2.5 and u[2] above 0.2, as is held since the start, where x[1] = 3: an event is needed
        x, u = random.uniform(-2.0, 2.0, 2), random.uniform(-0.9, 0.2, 2)
        twin.set({"u[1]": u[0], "u[2]": u[1]})
        twin.set_states(x)
        one.rate(0.0, x, {"u[1]": u[0], "u[2]": u[1]})
        one.event()
        assert one.rate(0.0, x) == pytest.approx(twin.derivative(), rel=1e-13, abs=1e-13)
        names = list(twin.outputs())
        assert one.get(*names) == pytest.approx(list(twin.outputs().values()), rel=1e-11, abs=1e-11)
        assert one.indicators() == pytest.approx([x[0] - 2.5, u[1] - 0.2], abs=1e-13)
        assert one.get("der(x[1])", "der(x[2])") == one.rate(0.0, x).tolist()
    one.model.freeInstance()


def test_switches_are_held_between_events(built: Callable[[Component], Path], tmp_path: Path) -> None:
    c = Component("bend", "A slope that changes where the state is zero")
    x = c.state("x", start=0.5, description="state")
    side = c.switch("side", x)
    c.derivative(x, -1 - 3 * side)
    c.output("y", side, description="the switch")
    one = Exchanged(Loaded(built(c), tmp_path))
    assert one.rate(0.0, [0.5]) == [-4.0]
    assert one.model.completedIntegratorStep()[0] == 0
    assert one.rate(0.1, [-0.1]) == [-4.0]  # beyond the zero, within the importer's step: still smooth
    assert one.get("y") == [1.0]
    assert one.model.completedIntegratorStep()[0] == 1  # had the importer not found it
    one.event()
    assert one.rate(0.1, [-0.1]) == [-1.0]
    assert one.get("y") == [0.0]
    one.model.freeInstance()


def test_a_switch_at_zero_takes_the_sign_of_what_follows(built: Callable[[Component], Path], tmp_path: Path) -> None:
    """A root finder may return the state at which the indicator is zero to the last bit."""
    c = Component("ramp", "A slope that changes where the state is zero")
    x = c.state("x", start=-0.5, description="state")
    sign = c.parameter("sign", 1.0, description="of the slope")
    c.derivative(x, sign * (1 + 3 * c.switch("side", x)))
    fmu = Loaded(built(c), tmp_path)
    for direction, after in ((1.0, 4.0), (-1.0, -1.0)):
        one = Exchanged(fmu, {"sign": direction})
        one.rate(0.5, [0.0])
        one.event()
        assert one.rate(0.5, [0.0]) == [after]
        assert one.states() == [0.0]
        one.model.freeInstance()


def test_saved_states_continue_alike(feature: Loaded) -> None:
    """Heun's method with sampling, from a state saved in between and from its bytes: the same bits."""
    one = Exchanged(feature)

    def advance(first: int, last: int) -> list[float]:
        for i in range(first, last):
            t, h, u = 0.02 * i, 0.02, {"u[1]": 0.3 * np.sin(0.1 * i), "u[2]": 0.5}
            x = one.states()
            k = one.rate(t, x, u)
            one.rate(t + h, x + h / 2 * (k + one.rate(t + h, x + h * k)))
            due = t + h > one.next_event - 1e-9
            if one.model.completedIntegratorStep()[0] or due:
                one.event()
        return [*one.states(), *one.get("z", "root[1]", "held[2]")]

    advance(0, 12)
    state, next_event = one.model.getFMUstate(), one.next_event
    stored = one.model.serializeFMUstate(state)
    first = advance(12, 30)
    assert first[2] == 3 + 6  # six instants in 0.6 s
    one.model.setFMUstate(state)
    one.next_event = next_event
    assert advance(12, 30) == first
    again = one.model.deSerializeFMUstate(stored)
    one.model.setFMUstate(again)
    one.next_event = next_event
    assert advance(12, 30) == first
    one.model.freeFMUstate(state)
    one.model.freeFMUstate(again)
    one.model.freeInstance()


def test_directional_derivatives_of_rates(feature: Loaded) -> None:
    one, x, step = Exchanged(feature), np.array([1.3, -0.4]), 1e-5
    at = {"u[1]": 0.42, "u[2]": -0.33}
    one.rate(0.0, x, at)
    one.event()
    rates, states = feature.vr("der(x[1])", "der(x[2])"), feature.vr("x[1]", "x[2]")
    for i in range(2):
        shift = step * np.eye(2)[i]
        by_state = (one.rate(0.0, x + shift, at) - one.rate(0.0, x - shift, at)) / (2 * step)
        one.rate(0.0, x, at)
        exact = one.model.getDirectionalDerivative(rates, [states[i]], [1.0])
        # linear in x: rounding over the step only
        np.testing.assert_allclose(exact, by_state, rtol=0, atol=1e-9)
    by_input = (one.rate(0.0, x, at | {"u[2]": -0.33 + step}) - one.rate(0.0, x, at)) / step
    np.testing.assert_allclose(
        one.model.getDirectionalDerivative(rates, feature.vr("u[2]"), [1.0]), by_input, rtol=0, atol=1e-9
    )
    one.model.freeInstance()


def test_order_of_calls_is_enforced(feature: Loaded) -> None:
    for misuse, words in (
        (lambda m: m.newDiscreteStates(), "fmi2NewDiscreteStates: called out of order"),
        (lambda m: m.enterContinuousTimeMode(), "fmi2EnterContinuousTimeMode: called out of order"),
        (lambda m: m.setReal(feature.vr("rate"), [3.0]), "rate cannot be set outside event mode"),
        (lambda m: m.setTime(float("nan")), "nan s is no time"),
        (lambda m: m.setContinuousStates((c_double * 3)(), 3), "3 values, but there are 2"),
    ):
        one = Exchanged(feature)
        with pytest.raises(FMICallException):
            misuse(one.model)
        assert any(words in m for m in feature.messages), feature.messages
        one.model.freeInstance()
    slave = feature.instance()
    slave.setupExperiment(startTime=0.0)
    slave.enterInitializationMode()
    slave.exitInitializationMode()
    assert slave.dll.fmi2SetTime(c_void_p(slave.component), c_double(0.1)) == fmpy.fmi2.fmi2Error
    assert "fmi2SetTime: this is a co-simulation instance" in feature.messages[-1]
    slave.freeInstance()
