"""The CasADi functions of a component: what is evaluated in-process, and what is generated as C."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
import numpy.typing as npt
from scipy.sparse import csc_array, csr_array

from fmus_src.component import Component
from fmus_src.lookups import Lookup, SwitchLookup
from fmus_src.variable import Causality, Variable

STATE_INPUTS = ("t", "x", "z", "u", "p", "k", "w")


@dataclass(frozen=True)
class Equations:
    """A component's equations, checked and compiled to CasADi functions.

    All of `derivatives`, `outputs`, `update`, `switches` and `lookup_arguments[i]` take (t, x, z, u, p, k, w): time,
    states, sampled states, inputs, parameters, calculated parameters, lookup results. `forward` takes these and seeds
    (dx, du, dw) and returns (dx', dy); `lookup_forward[i]` likewise for a lookup's arguments. Both are left out of a
    component without directional derivatives. The signs of what `switches` returns are the switches' results in w, at
    `switch_positions()`.
    """

    component: Component
    variables: tuple[Variable, ...]
    strings: tuple[Variable, ...]
    lookups: tuple[Lookup, ...]
    sizes: dict[str, int]
    calculate: ca.Function
    initial: ca.Function
    derivatives: ca.Function
    outputs: ca.Function
    update: ca.Function
    switches: ca.Function
    lookup_arguments: tuple[ca.Function, ...]
    forward: ca.Function | None
    lookup_forward: tuple[ca.Function, ...]

    def of(self, *causalities: Causality) -> list[Variable]:
        """Variables of the causalities, in storage order."""
        return [v for v in self.variables if v.causality in causalities]

    def functions(self) -> list[ca.Function]:
        """All functions, in the order in which C is generated."""
        return [
            self.calculate, self.initial, self.derivatives, self.outputs, self.update, self.switches,
            *([self.forward] if self.forward else []), *self.lookup_arguments, *self.lookup_forward,
        ]  # fmt: skip

    def switch_positions(self) -> npt.NDArray[np.int_]:
        """Where the switches' results stand in w."""
        kinds = [isinstance(lookup, SwitchLookup) for lookup in self.lookups for _ in range(lookup.result_size)]
        return np.flatnonzero(kinds)

    def output_dependencies(self) -> npt.NDArray[np.bool_]:
        """Direct feed-through: outputs (rows) by inputs (columns), through lookups too."""
        return self.dependencies([self.outputs], ["u"])[0]

    def dependencies(self, functions: Sequence[ca.Function], names: Sequence[str]) -> list[npt.NDArray[np.bool_]]:
        """Of each function, its results (rows) by elements of the named arguments (columns), through lookups too."""

        def direct(function: ca.Function) -> npt.NDArray[np.bool_]:
            return np.hstack([self.sparsity(function, name) for name in names])

        known: list[Any] = [np.zeros((0, sum(self.outputs.numel_in(STATE_INPUTS.index(n)) for n in names)), dtype=bool)]
        for lookup, function in zip(self.lookups, self.lookup_arguments, strict=True):
            of_arguments = direct(function) | self._through(function, known)
            known.append(_product(lookup.dependencies(), of_arguments))
        return [direct(f) | self._through(f, known) for f in functions]

    def discrete_outputs(self) -> npt.NDArray[np.bool_]:
        """Outputs that change at sample instants only: they depend on neither time, states nor inputs, (y,)."""
        changes = np.zeros((0, 1), dtype=bool)
        for lookup, function in zip(self.lookups, self.lookup_arguments, strict=True):
            of_arguments = self._varies(function) | self._through(function, [changes])
            changes = np.vstack([changes, _product(lookup.dependencies(), of_arguments)])
        return ~(self._varies(self.outputs) | self._through(self.outputs, [changes])).ravel()

    def lookup_uses(self) -> list[tuple[str, ...]]:
        """Of each lookup, the functions that need its results, directly or through later lookups."""
        first = np.cumsum([0, *(lookup.result_size for lookup in self.lookups)])
        uses: list[tuple[str, ...]] = [()] * len(self.lookups)
        wanting = {f.name(): self._wants(f) for f in (self.derivatives, self.outputs, self.update, self.switches)}
        for i in reversed(range(len(self.lookups))):
            uses[i] = tuple(name for name, wants in wanting.items() if wants[first[i] : first[i + 1]].any())
            for name in uses[i]:
                wanting[name] = wanting[name] | self._wants(self.lookup_arguments[i])
        return uses

    def _through(self, function: ca.Function, of_inputs: list[Any]) -> Any:
        known = np.vstack(of_inputs)
        pattern = function.jac_sparsity(0, STATE_INPUTS.index("w"))
        ones = np.ones(pattern.nnz(), dtype=np.float32)
        direct = csc_array((ones, pattern.row(), pattern.colind()), shape=pattern.shape)[:, : known.shape[0]]
        return np.asarray(direct @ known.astype(np.float32) > 0.0)

    @staticmethod
    def _wants(function: ca.Function) -> npt.NDArray[np.bool_]:
        """Which lookup results a function depends on."""
        return np.diff(function.jac_sparsity(0, STATE_INPUTS.index("w")).colind()) > 0

    def _varies(self, function: ca.Function) -> npt.NDArray[np.bool_]:
        """Whether each result depends on time, states or inputs directly, (n, 1)."""
        varies = np.hstack([self.sparsity(function, name) for name in ("t", "x", "u")]).any(axis=1, keepdims=True)
        return np.asarray(varies)

    @staticmethod
    def sparsity(function: ca.Function, name: str) -> npt.NDArray[np.bool_]:
        """Whether each result of a function of (t, x, z, u, p, k, w) depends on each element of an argument."""
        pattern = function.jac_sparsity(0, STATE_INPUTS.index(name))
        return np.asarray(ca.DM(pattern, 1.0).full() != 0.0)


def _product(a: npt.NDArray[np.bool_], b: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
    """Which row of a, which is sparse, meets which column of b."""
    return np.asarray(csr_array(a.astype(np.float32)) @ b.astype(np.float32) > 0.0)


def derive(component: Component) -> Equations:
    """Check a component and compile its equations.

    Raises:
        ValueError: a state has no equation, or an expression uses a symbol that was not declared.
    """
    groups = component.groups
    sym = component.sym

    def column(parts: list[Any]) -> Any:
        return ca.vertcat(*parts) if parts else sym(0, 1)

    x, z, u, p, k = (column(groups[c].symbols) for c in ("state", "sampled_state", "input", "parameter", "calculated"))
    w = column(component.lookup_symbols)
    arguments = [component.time, x, z, u, p, k, w]
    seeds = [sym.sym(f"d{n}", s.numel()) for n, s in zip("xuw", (x, u, w), strict=True)]

    def function(name: str, inputs: list[Any], outputs: list[Any]) -> ca.Function:
        try:
            return ca.Function(name, inputs, outputs)
        except RuntimeError as error:
            free = [line for line in str(error).splitlines() if "free" in line] or [str(error).splitlines()[-1]]
            raise ValueError(f"{component.name}: {name} uses undeclared symbols: {free[0].strip()}") from error

    def directional(name: str, outputs: list[Any]) -> ca.Function:
        """Derivatives of outputs along a direction of x, u and w, in one forward sweep."""
        plain = function("plain", arguments, outputs)
        direction = [sym.zeros(a.shape) for a in arguments]
        for key, seed in zip("xuw", seeds, strict=True):
            direction[STATE_INPUTS.index(key)] = seed
        values = [sym.zeros(o.shape) for o in outputs]  # not used by a sweep that has the arguments
        along: Any = plain.forward(1)(*arguments, *values, *direction)
        results = list(along) if isinstance(along, (tuple, list)) else [along]
        return function(name, [*arguments, *seeds], [ca.densify(r) for r in results])

    rate, following = column(component.rates("state")), column(component.rates("sampled_state"))
    y = column(groups["output"].expressions)
    calculated = _in_order(p, groups["calculated"], sym)
    initial = [column(groups["state"].expressions), column(groups["sampled_state"].expressions)]
    lookup_arguments = [ca.densify(a) for a in component.lookup_arguments]
    switching = [isinstance(lookup, SwitchLookup) for lookup in component.lookups]
    signs = [a for a, s in zip(lookup_arguments, switching, strict=True) if s]
    switches = function("switches", arguments, [column(signs)])
    derivatives, outputs = function("derivatives", arguments, [rate]), function("outputs", arguments, [y])
    # Directions through lookups that neither rates nor outputs depend on are not needed: zero, which spares code.
    used = any(f.jac_sparsity(0, STATE_INPUTS.index("w")).nnz() for f in (derivatives, outputs))
    order: tuple[Causality, ...] = ("parameter", "calculated", "input", "output", "state", "sampled_state")
    sizes = {n: int(s.numel()) for n, s in zip("xzupkwy", (x, z, u, p, k, w, y), strict=True)}
    return Equations(
        component=component,
        variables=tuple(v for c in order for v in groups[c].variables),
        strings=tuple(component.strings),
        lookups=tuple(component.lookups),
        sizes=sizes,
        calculate=function("calculate", [p], [calculated]),
        initial=function("initial", [p, k], initial),
        derivatives=derivatives,
        outputs=outputs,
        update=function("update", arguments, [following]),
        switches=switches,
        lookup_arguments=tuple(function(f"lookup{i}", arguments, [a]) for i, a in enumerate(lookup_arguments)),
        forward=directional("forward", [rate, y]) if component.directional_derivatives else None,
        lookup_forward=tuple(
            directional(f"lookup{i}_forward", [a if used and not switching[i] else sym.zeros(a.shape)])
            for i, a in enumerate(lookup_arguments if component.directional_derivatives else [])
        ),
    )


def _in_order(p: Any, group: Any, sym: Any) -> Any:
    """Calculated parameters as expressions in p alone (one may use those declared before it)."""
    done: list[Any] = []
    for expression in group.expressions:
        earlier = group.symbols[: len(done)]
        uses = earlier and ca.depends_on(expression, ca.vertcat(*earlier))
        done.append(ca.substitute([expression], earlier, done)[0] if uses else expression)
    return ca.vertcat(*done) if done else sym(0, 1)
