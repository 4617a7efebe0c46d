"""A component simulated in-process, by the same algorithm as the C runtime of its FMU."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from itertools import count
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from fmus_src.component import Component
from fmus_src.crossing import MAX_CROSSINGS, Flags, crossed, locate
from fmus_src.equations import Equations, derive
from fmus_src.lookups import LookupMemory, SwitchLookup
from fmus_src.variable import Causality

Array = npt.NDArray[np.float64]

# As in the C runtime (integration.c).

_KEYS: dict[str, Causality] = {
    "p": "parameter",
    "k": "calculated",
    "u": "input",
    "y": "output",
    "x": "state",
    "z": "sampled_state",
}


class Instance:
    """One in-process instance: set parameters and inputs, initialise, step, read.

    Example:
        >>> from fmus_src.tmd.model import component
        >>> damper = Instance(component())
        >>> damper.set({"k": 6302.0, "initial_displacement": 0.1})
        >>> damper.initialise()
        >>> damper.do_step(0.0125)
        >>> damper.get("displacement") < 0.1
        True
    """

    def __init__(self, component: Component | Equations) -> None:
        self.equations = component if isinstance(component, Equations) else derive(component)
        e = self.equations
        self._values: dict[str, Array] = {}
        self._index: dict[str, tuple[str, int]] = {}
        for key, causality in _KEYS.items():
            self._values[key] = np.array([s for v in e.of(causality) for s in v.start])
            names = [n for v in e.of(causality) for n in v.element_names()]
            self._index |= {n: (key, i) for i, n in enumerate(names)}
        self._strings = {v.name: v.text for v in e.strings}
        self._slope = np.zeros(e.sizes["u"])
        self.time = 0.0
        self._samples = 0
        self._start = 0.0
        self._memory = LookupMemory(list(self._strings.values()))

    def set(self, values: Mapping[str, float | str]) -> None:
        """Set parameters or inputs by scalar name.

        Raises:
            KeyError: no such variable.
        """
        changed = False
        for name, value in values.items():
            if isinstance(value, str):
                if name not in self._strings:
                    raise KeyError(name)
                self._strings[name] = value
                continue
            key, index = self._index[name]
            self._values[key][index] = value
            changed = changed or key == "p"
        if changed:
            self._values["k"] = _flat(self.equations.calculate(self._values["p"]))

    def set_slope(self, slopes: Mapping[str, float]) -> None:
        """Set time derivatives of inputs for the next step (as fmi2SetRealInputDerivatives does)."""
        for name, slope in slopes.items():
            self._slope[self._index[name][1]] = slope

    def initialise(self, start: float = 0.0) -> None:
        """Evaluate calculated parameters and initial states."""
        e, v = self.equations, self._values
        self.time = self._start = start
        self._samples = 0
        self._memory = LookupMemory([self._strings[s.name] for s in e.strings])
        v["k"] = _flat(e.calculate(v["p"]))
        x, z = e.initial(v["p"], v["k"])
        v["x"], v["z"] = _flat(x), _flat(z)
        if e.component.sample_at_start:
            v["z"] = _flat(e.update(*self._arguments(self.time, v["x"])))

    def get(self, name: str) -> float:
        """Value of a scalar variable now."""
        key, index = self._index[name]
        if key == "y":
            return float(self._outputs()[index])
        return float(self._values[key][index])

    def outputs(self) -> dict[str, float]:
        """All outputs now, by scalar name."""
        values = self._outputs()
        return {n: float(values[i]) for n, (key, i) in self._index.items() if key == "y"}

    def do_step(self, step: float) -> None:
        """Advance by one communication step: Runge-Kutta sub-steps, stopping at sample instants."""
        component = self.equations.component
        end = self.time + step
        u0, t0 = self._values["u"].copy(), self.time
        while component.sample_time is not None:
            instant = self._start + (self._samples + 1) * component.sample_time
            near = 1e-4 * component.sample_time  # an end this close is the instant: importers add up rounding
            if instant > end + near:
                break
            self._integrate(end if instant > end - near else instant, u0, t0)
            self._values["u"] = u0 + self._slope * (self.time - t0)
            self._values["z"] = _flat(self.equations.update(*self._arguments(self.time, self._values["x"])))
            self._samples += 1
        self._integrate(end, u0, t0)
        self.time = end
        self._values["u"] = u0 + self._slope * step
        self._slope[:] = 0.0

    def set_states(self, x: Array) -> None:
        """Replace the continuous states, shape (states,), in order of declaration."""
        self._values["x"] = np.array(x, dtype=float)

    def derivative(self, x: Array | None = None) -> Array:
        """Right-hand side at the present inputs and the given (or present) states."""
        x = self._values["x"] if x is None else x
        return _flat(self.equations.derivatives(*self._arguments(self.time, x)))

    def _outputs(self) -> Array:
        return _flat(self.equations.outputs(*self._arguments(self.time, self._values["x"])))

    def _arguments(self, t: float, x: Array, held: Flags | None = None) -> list[Any]:
        """Arguments of the equations, lookups evaluated; `held`: results of the switches, in place of their signs."""
        v, e = self._values, self.equations
        arguments: list[Any] = [t, x, v["z"], v["u"], v["p"], v["k"], np.zeros(e.sizes["w"])]
        first = 0
        if held is not None:
            arguments[6][e.switch_positions()] = held
        for lookup, function in zip(e.lookups, e.lookup_arguments, strict=True):
            if held is None or not isinstance(lookup, SwitchLookup):
                result = lookup.evaluate(_flat(function(*arguments)), self._memory)
                arguments[6][first : first + lookup.result_size] = result
            first += lookup.result_size
        return arguments

    def _integrate(self, end: float, u0: Array, t0: float) -> None:
        span = end - self.time
        if span <= 0.0 or not self.equations.sizes["x"]:
            self.time = max(end, self.time)
            return
        steps = max(1, math.ceil(span / self.equations.component.internal_step - 1e-6))
        h, begin, x = span / steps, self.time, self._values["x"]
        for i in range(steps):
            x = self._sub_step(_Input(u0, self._slope, t0), begin + i * h, h, x)
        self._values["x"] = x
        self.time = end

    def _sub_step(self, u: _Input, t: float, h: float, x: Array) -> Array:
        """States after h: a Runge-Kutta step, or several from one crossing of a switch to the next."""
        done, held = 0.0, np.zeros(len(self.equations.switch_positions()), dtype=bool)
        if not held.size:
            return self._runge_kutta(u, t, h, x, held)
        for crossing in count():
            now, left = t + done, h - done
            before = self._switches(u, now, x, held)
            held = before > 0.0
            y, after = self._reach(u, now, x, held, left)
            departs = (before == 0.0) & ((after > 0.0) != held)
            if departs.any():  # from zero: the sign is that of what follows
                held = held ^ departs
                y, after = self._reach(u, now, x, held, left)
            if crossing == MAX_CROSSINGS or not crossed(after, held, before).any():
                return y
            length, x = locate(partial(self._reach, u, now, x, held), left, before, (y, after), held)
            done += length
            if done >= h:
                break
        return x

    def _reach(self, u: _Input, t: float, x: Array, held: Flags, h: float) -> tuple[Array, Array]:
        y = self._runge_kutta(u, t, h, x, held)
        return y, self._switches(u, t + h, y, held)

    def _switches(self, u: _Input, t: float, x: Array, held: Flags) -> Array:
        self._values["u"] = u.at(t)
        return _flat(self.equations.switches(*self._arguments(t, x, held)))

    def _runge_kutta(self, u: _Input, t: float, h: float, x: Array, held: Flags) -> Array:
        def rate(t: float, x: Array) -> Array:
            self._values["u"] = u.at(t)
            return _flat(self.equations.derivatives(*self._arguments(t, x, held)))

        k1 = rate(t, x)
        k2 = rate(t + h / 2, x + h / 2 * k1)
        k3 = rate(t + h / 2, x + h / 2 * k2)
        k4 = rate(t + h, x + h * k3)
        return x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


@dataclass(frozen=True)
class _Input:
    """Inputs over a communication step: value and slope at its begin."""

    start: Array
    slope: Array
    begin: float

    def at(self, t: float) -> Array:
        return self.start + self.slope * (t - self.begin)


def simulate(
    component: Component | Equations | Instance,
    *,
    stop: float,
    step: float,
    parameters: Mapping[str, float | str] | None = None,
    inputs: Callable[[float], Mapping[str, float]] | None = None,
) -> pd.DataFrame:
    """Simulate a component in-process.

    Args:
        stop, step: s; inputs are interpolated linearly between the communication points.
        inputs: time -> {scalar input name: value}.

    Returns:
        one row per communication point, indexed by time (s): outputs and states (but internal ones), SI units.
    """
    instance = component if isinstance(component, Instance) else Instance(component)
    instance.set(parameters or {})
    given = inputs or (lambda t: {})
    instance.set(given(0.0))
    instance.initialise()
    states = [n for v in instance.equations.of("state", "sampled_state") if not v.internal for n in v.element_names()]
    rows, times = [], []
    count = round(stop / step)
    for i in range(count + 1):
        times.append(i * step)
        rows.append(instance.outputs() | {n: instance.get(n) for n in states})
        if i < count:
            now, then = given(i * step), given((i + 1) * step)
            instance.set(now)
            instance.set_slope({n: (then[n] - now[n]) / step for n in now})
            instance.do_step(step)
    return pd.DataFrame(rows, index=pd.Index(times, name="time"))


def _flat(value: Any) -> Array:
    return np.asarray(value.full(), dtype=float).ravel()
