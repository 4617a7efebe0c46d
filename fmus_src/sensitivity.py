"""Trajectories of a component with their derivatives to parameters, through the events of its switches.

States and sensitivities S = dx/dp are integrated by one Runge-Kutta scheme: the variational equations
S' = df/dx S + df/dp are derived by CasADi from the component's own equations. Between events this is the exact
derivative of what `Instance` computes. A switch's crossing is located within the step; there the rate jumps from f- to
f+ at a time that depends on the parameters, so S jumps by (f- - f+) dt/dp (the saltation matrix: Leine and Nijmeijer,
Dynamics and Bifurcations of Non-Smooth Mechanical Systems, 2004, section 7.1). A crossing that only grazes its surface
has no derivative; the trajectory itself is continuous in the parameters there.
"""

from __future__ import annotations

import hashlib
import math
import tempfile
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import numpy.typing as npt
from platformdirs import user_cache_path

from fmus_src.crossing import MAX_CROSSINGS, Flags, crossed, locate
from fmus_src.equations import Equations
from fmus_src.export.compiler import compile_shared
from fmus_src.export.platforms import native_platform
from fmus_src.lookups import SwitchLookup

Array = npt.NDArray[np.float64]

CHUNK = 64  # steps evaluated by one call between looks at the switches
# As in instance.py.


class Sensitivity:
    """Outputs of a component and their derivatives to some of its parameters.

    Args:
        equations: of a component without inputs, sampled states or lookups other than switches.
        unknowns: scalar names of the parameters to differentiate by.
        outputs: scalar names of outputs or states to observe.

    Raises:
        ValueError: the component has what is excluded above, or a name is unknown.
    """

    def __init__(self, equations: Equations, unknowns: Sequence[str], outputs: Sequence[str]) -> None:
        e, label = equations, equations.component.name
        if e.sizes["u"] or e.sizes["z"] or not all(isinstance(lookup, SwitchLookup) for lookup in e.lookups):
            raise ValueError(f"{label}: has inputs, sampled states or lookups; its sensitivities are not available")
        self._parameters = {n: i for i, n in enumerate(n for v in e.of("parameter") for n in v.element_names())}
        self._start = np.array([s for v in e.of("parameter") for s in v.start])
        self.unknowns = tuple(unknowns)
        self._label, self._longest = label, e.component.internal_step
        self._index(self.unknowns)
        self._functions = {False: _Functions(e, outputs, None), True: _Functions(e, outputs, self._index(unknowns))}

    def _index(self, names: Sequence[str]) -> list[int]:
        for name in names:
            if name not in self._parameters:
                raise ValueError(f"{self._label}: no parameter '{name}'")
        return [self._parameters[name] for name in names]

    def trajectory(
        self, parameters: Mapping[str, float], *, samples: int, spacing: float, derivatives: bool = True
    ) -> tuple[Array, Array]:
        """Outputs at 0, spacing, 2 spacing, ... and their derivatives.

        Args:
            parameters: values by scalar name; the others keep their defaults.
            samples: number of instants, the first one included; spacing: s.
            derivatives: False leaves the second result empty, which is faster.

        Returns:
            outputs, shape (samples, outputs), and derivatives, shape (samples, outputs, unknowns), in SI units.

        Raises:
            ValueError: a parameter is unknown.
            FloatingPointError: the solution is no longer finite.
        """
        p = self._start.copy()
        p[self._index(list(parameters))] = list(parameters.values())
        steps = max(1, math.ceil(spacing / self._longest - 1e-6))
        run = _Run(self._functions[derivatives], p, spacing / steps)
        blocks, reached = [run.observed()], 0
        while reached < (samples - 1) * steps:
            blocks.append(run.advance())
            reached += len(blocks[-1])
            if not np.all(np.isfinite(blocks[-1][-1])):
                raise FloatingPointError(f"{self._label}: not finite after {reached * spacing / steps:.4g} s")
        observed = np.concatenate(blocks)[: (samples - 1) * steps + 1 : steps]
        return observed[:, :, 0], observed[:, :, 1:]


class _Functions:
    """Compiled functions of [x, S] (states by 1 + unknowns), the switches' results, and constants (p, P, k, K)."""

    def __init__(self, e: Equations, outputs: Sequence[str], unknowns: Sequence[int] | None) -> None:
        count = len(unknowns or ())
        x, p, k, held = (ca.SX.sym(n, e.sizes[n]) for n in "xpkw")
        s_x, s_p, s_k = (ca.SX.sym(f"d{n}", e.sizes[n], count) for n in "xpk")
        state, h = ca.horzcat(x, s_x), ca.SX.sym("h")
        none: list[Any] = []

        def total(expression: Any) -> Any:
            """An expression beside its derivatives."""
            parts = [ca.jtimes(expression, a, d) for a, d in ((x, s_x), (p, s_p), (k, s_k)) if count and a.numel()]
            return ca.densify(ca.horzcat(expression, sum(parts)) if parts else expression)

        arguments = (0.0, x, none, none, p, k, held)
        constants = [p, s_p, k, s_k]
        rate = ca.Function("rate", [state, held, *constants], [total(e.derivatives(*arguments))])
        switches = ca.Function("switches", [state, *constants], [total(e.switches(*arguments[:6], 0.0))])

        def stage(d: Any, by: Any) -> Any:
            return rate(state + by * d, held, *constants)

        k1 = stage(0.0, 0.0)
        k2 = stage(k1, h / 2)
        k3 = stage(k2, h / 2)
        following = state + h / 6 * (k1 + 2 * k2 + 2 * k3 + stage(k3, h))
        observe = ca.Function("observe", [state, *constants], [total(_observed(e, outputs, arguments))])
        results = [following, switches(following, *constants)[:, 0], observe(following, *constants)]
        step = ca.Function("step", [state, held, *constants, h], results)
        functions = [rate, switches, observe, step, _repeated(step, CHUNK)]
        self.rate, self.switches, self.observe, self.step, self.chunk = _compiled(
            f"{e.component.name}_{count}", functions
        )

        calculated = e.calculate(p)
        first = ca.substitute(e.initial(p, k)[0], k, calculated)
        selection = ca.DM.zeros(e.sizes["p"], count)
        for column, row in enumerate(unknowns or ()):
            selection[row, column] = 1.0

        def given(expression: Any) -> Any:
            expression = ca.vertcat(expression)
            return ca.densify(ca.jtimes(expression, p, ca.SX(selection)) if count else ca.SX(expression.numel(), 0))

        self.prepare = ca.Function("prepare", [p], [selection, calculated, given(calculated)])
        self.initial = ca.Function("initial", [p], [ca.densify(ca.horzcat(first, given(first)))])


def _observed(e: Equations, names: Sequence[str], arguments: Sequence[Any]) -> Any:
    places = {n: i for i, n in enumerate(n for v in e.of("output") for n in v.element_names())}
    states = {n: i for i, n in enumerate(n for v in e.of("state") for n in v.element_names())}
    for name in names:
        if name not in places and name not in states:
            raise ValueError(f"{e.component.name}: no output or state '{name}'")
    y = e.outputs(*arguments)
    return ca.vertcat(*(y[places[n]] if n in places else arguments[1][states[n]] for n in names))


def _compiled(name: str, functions: Sequence[Any]) -> list[Any]:
    """The same functions as machine code, from the user's cache where it holds them: ten times as fast."""
    generator = ca.CodeGenerator(f"{name}.c")
    for function in functions:
        generator.add(function)
    code = f"#define GCC_HASCLASSVISIBILITY  /* export the functions */\n{generator.dump()}"
    key = hashlib.sha256(code.encode()).hexdigest()[:16]
    library = user_cache_path("fowt-cosim") / "sensitivity" / f"{name}-{key}{native_platform().suffix}"
    if not library.exists():
        with tempfile.TemporaryDirectory() as scratch:
            source = Path(scratch) / f"{name}.c"
            source.write_text(code, encoding="utf-8")
            compile_shared([source], library)
    return [ca.external(function.name(), str(library)) for function in functions]


def _repeated(step: Any, count: int) -> Any:
    """(state, held, constants..., h) -> states and switches after each of `count` steps, side by side."""
    # unrolled calls rather than `mapaccum`, which copies the constants for each step
    first, *rest = [ca.MX.sym(step.name_in(i), *step.size_in(i)) for i in range(step.n_in())]
    results = [step(first, *rest)]
    for _ in range(count - 1):
        results.append(step(results[-1][0], *rest))
    return ca.Function("chunk", [first, *rest], [ca.horzcat(*column) for column in zip(*results, strict=True)])


class _Run:
    """One integration under way: the present [x, S]."""

    def __init__(self, functions: _Functions, p: Array, h: float) -> None:
        self._f, self._h = functions, h
        selection, k, s_k = functions.prepare(p)
        self.constants = (ca.DM(p), selection, k, s_k)
        self.state = functions.initial(p).full()

    def observed(self) -> Array:
        """Outputs beside their derivatives now, shape (1, outputs, 1 + unknowns)."""
        return np.asarray(self._f.observe(self.state, *self.constants).full()[None])

    def advance(self) -> Array:
        """Go on by some steps: all that no switch interrupts, and one that it does, made in parts.

        Returns:
            outputs beside their derivatives after each step, shape (steps, outputs, 1 + unknowns).
        """
        held = self._switches(self.state) > 0.0
        states, after, observed = (r.full() for r in self._f.chunk(self.state, held, *self.constants, self._h))
        interrupted = np.flatnonzero(((after > 0.0) != held[:, None]).any(axis=0))
        free = int(interrupted[0]) if interrupted.size else CHUNK
        blocks = observed.reshape(len(observed), CHUNK, -1).swapaxes(0, 1)[:free]
        if free:
            width = self.state.shape[1]
            self.state = states[:, (free - 1) * width : free * width]
        if free == CHUNK:
            return np.asarray(blocks)
        self.state = self._in_parts(self.state)
        return np.concatenate([blocks, self.observed()])

    def _switches(self, state: Array) -> Array:
        return np.asarray(self._f.switches(state, *self.constants).full()[:, 0])

    def _step(self, state: Array, held: Flags, h: float) -> tuple[Array, Array]:
        following, switches, _ = self._f.step(state, held, *self.constants, h)
        return following.full(), switches.full().ravel()

    def _in_parts(self, state: Array) -> Array:
        """One step from crossing to crossing, as `Instance._sub_step`."""
        done = 0.0
        for crossing in range(MAX_CROSSINGS + 1):
            before, left = self._switches(state), self._h - done
            held = before > 0.0
            following, after = self._step(state, held, left)
            departs = (before == 0.0) & ((after > 0.0) != held)
            if departs.any():  # from zero: the sign is that of what follows
                held = held ^ departs
                following, after = self._step(state, held, left)
            if crossing == MAX_CROSSINGS or not crossed(after, held, before).any():
                return following
            length, state = locate(partial(self._step, state, held), left, before, (following, after), held)
            state = self._jump(state, held, before)
            done += length
            if done >= self._h:
                break
        return state

    def _jump(self, state: Array, held: Flags, before: Array) -> Array:
        """[x, S] after the crossing: each instant at which the rate changes moves with the parameters."""
        if state.shape[1] == 1:
            return state
        rate = self._f.rate(state, held, *self.constants).full()[:, 0]
        switches = self._f.switches(state, *self.constants).full()
        now = switches[:, 0] > 0.0
        which = int(np.flatnonzero(crossed(switches[:, 0], held, before))[0])
        after = self._f.rate(state, now, *self.constants).full()[:, 0]
        speed = self._slope(state, rate, which)
        if speed == 0.0:
            return state
        moved = state.copy()
        moved[:, 1:] -= np.outer(rate - after, switches[which, 1:]) / speed
        return moved

    def _slope(self, state: Array, rate: Array, which: int) -> float:
        """Rate of a switch's argument along the flow: its directional derivative, by the same seeds as parameters."""
        p, selection, k, s_k = self.constants
        seeded = np.hstack([state[:, :1], np.repeat(rate[:, None], state.shape[1] - 1, axis=1)])
        nothing = (p, 0 * selection, k, 0 * s_k)
        return float(self._f.switches(seeded, *nothing).full()[which, 1])
