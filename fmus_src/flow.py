"""What flows between composed components: inputs and outputs, known one after another."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
import numpy.typing as npt

from fmus_src.component import Component
from fmus_src.equations import Equations
from fmus_src.lookups import Lookup

Pattern = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Wire:
    """input[target] = factor * value + offset, of an element; `kind` of the source: "y", "p" or "k"."""

    source: int
    kind: str
    output: int
    target: int
    input: int
    factor: float
    offset: float

    def scaled(self, value: Any) -> Any:
        """The input for a value of the source."""
        return value if (self.factor, self.offset) == (1.0, 0.0) else self.factor * value + self.offset


@dataclass(frozen=True)
class Member:
    """A component of the composition, and what depends directly on what.

    Attributes:
        outputs_by_input: (outputs, inputs); outputs_by_lookup: (outputs, lookups).
        lookups_by_input: (lookups, inputs); lookups_by_lookup: (lookups, lookups).
        rates_by_input, rates_by_lookup: of the state derivatives together, (inputs,), (lookups,).
    """

    name: str
    equations: Equations
    outputs_by_input: Pattern
    outputs_by_lookup: Pattern
    lookups_by_input: Pattern
    lookups_by_lookup: Pattern
    rates_by_input: Pattern
    rates_by_lookup: Pattern

    @classmethod
    def of(cls, name: str, equations: Equations) -> Member:
        """A derived component under the name that it has in the system."""
        ends = np.cumsum([lookup.result_size for lookup in equations.lookups], dtype=int)

        def by_lookup(function: ca.Function) -> Pattern:
            pattern = equations.sparsity(function, "w")
            parts = [part.any(axis=1) for part in np.split(pattern, ends, axis=1)[:-1]]
            return np.column_stack(parts) if parts else np.zeros((len(pattern), 0), dtype=bool)

        def stacked(rows: list[Pattern], columns: int) -> Pattern:
            return np.vstack([np.zeros((0, columns), dtype=bool), *(r.any(axis=0, keepdims=True) for r in rows)])

        return cls(
            name,
            equations,
            equations.sparsity(equations.outputs, "u"),
            by_lookup(equations.outputs),
            stacked([equations.sparsity(f, "u") for f in equations.lookup_arguments], equations.sizes["u"]),
            stacked([by_lookup(f) for f in equations.lookup_arguments], len(equations.lookups)),
            np.asarray(equations.sparsity(equations.derivatives, "u").any(axis=0)),
            np.asarray(by_lookup(equations.derivatives).any(axis=0)),
        )

    @property
    def component(self) -> Component:
        return self.equations.component

    def cut(self, rows: Sequence[int]) -> ca.Function:
        """(t, x, z, u, p, k, w) -> some of the outputs, without what the others need."""
        groups, sym, chosen, places, first = self.component.groups, self.component.sym, [], [], 0
        kept = 0
        for variable, expression in zip(groups["output"].variables, groups["output"].expressions, strict=True):
            inside = [r - first for r in rows if first <= r < first + variable.size]
            if inside:
                chosen.append(expression)
                places += [kept + r for r in inside]
                kept += variable.size
            first += variable.size
        causalities = ("state", "sampled_state", "input", "parameter", "calculated")
        columns = [groups[c].symbols for c in causalities] + [self.component.lookup_symbols]  # type: ignore[index]
        arguments: list[Any] = [self.component.time, *(ca.vertcat(*s) if s else sym(0, 1) for s in columns)]
        return ca.Function(f"{self.name}_cut", arguments, [ca.densify(ca.vertcat(*chosen)[places])])

    def input_name(self, place: int) -> str:
        """ "NAME.input" of an element."""
        return f"{self.name}.{self._names('input')[place]}"

    def output_name(self, place: int) -> str:
        """ "NAME.output" of an element."""
        return f"{self.name}.{self._names('output')[place]}"

    def _names(self, causality: Any) -> list[str]:
        return [n for v in self.equations.of(causality) for n in v.element_names()]


class Flow:
    """Expressions of inputs, outputs and lookup results of all members, as far as they are known.

    Attributes:
        columns: of each member its x, z, p and k.
        u: inputs of each member, scalars, None: not yet known. y: known outputs that are connected. w: lookup results.
        rows: outputs that are wanted.
    """

    def __init__(
        self,
        members: Sequence[Member],
        wires: Sequence[Wire],
        time: Any,
        sym: Any,
        keep: Callable[[str, Any], Any],
        look_up: Callable[[int, str, Lookup, Any], Any],
    ) -> None:
        self.members, self.wires, self.time, self.sym = members, wires, time, sym
        self.columns: list[dict[str, Any]] = [{} for _ in members]
        self.u: list[list[Any]] = [[None] * m.equations.sizes["u"] for m in members]
        self.y: list[dict[int, Any]] = [{} for _ in members]
        self.w: list[list[Any]] = [[None] * len(m.equations.lookups) for m in members]
        self.rows = [sorted({w.output for w in wires if w.source == m and w.kind == "y"}) for m in range(len(members))]
        self.keep, self._look_up = keep, look_up
        self._rates: dict[int, Any] = {}

    def feed_parameters(self) -> None:
        """Pass on what parameters feed."""
        for wire in self.wires:
            if wire.kind != "y":
                value = self.columns[wire.source][wire.kind][wire.output]
                self.u[wire.target][wire.input] = wire.scaled(value)

    def complete(self) -> bool:
        """Whether every input and lookup is known."""
        return all(v is not None for values in (*self.u, *self.w) for v in values)

    def advance(self) -> bool:
        """Evaluate lookups and outputs whose inputs are known, and pass them on; whether there were any."""
        moved = False
        for m in range(len(self.members)):
            moved |= self._advance_lookups(m)
            moved |= self._advance_outputs(m)
        return moved

    def arguments(self, m: int) -> list[Any]:
        """(t, x, z, u, p, k, w) of a member; what is not yet known is zero."""
        columns, equations = self.columns[m], self.members[m].equations
        u = [self.sym(0) if v is None else v for v in self.u[m]]
        w = [
            self.sym.zeros(lookup.result_size) if v is None else v
            for v, lookup in zip(self.w[m], equations.lookups, strict=True)
        ]
        joined = [ca.vertcat(*v) if v else self.sym(0, 1) for v in (u, w)]
        return [self.time, columns["x"], columns["z"], joined[0], columns["p"], columns["k"], joined[1]]

    def put_output(self, m: int, row: int, value: Any) -> None:
        """Make an output known, and the inputs that it feeds."""
        self.y[m][row] = value
        for wire in self.wires:
            if (wire.kind, wire.source, wire.output) == ("y", m, row) and self.u[wire.target][wire.input] is None:
                self.u[wire.target][wire.input] = wire.scaled(value)

    def rates(self, m: int) -> Any:
        """Time derivatives of a member's states."""
        if m not in self._rates:
            self._rates[m] = self.members[m].equations.derivatives(*self.arguments(m))
        return self._rates[m]

    def set_rates(self, m: int, rates: Any) -> None:
        """Give the derivatives of a member's states, where they come at less cost."""
        self._rates[m] = rates

    def _advance_lookups(self, m: int) -> bool:
        member, moved = self.members[m], False
        for i, lookup in enumerate(member.equations.lookups):
            if self.w[m][i] is None and self._known(m, member.lookups_by_input[i], member.lookups_by_lookup[i]):
                arguments = member.equations.lookup_arguments[i](*self.arguments(m))
                self.w[m][i] = self._look_up(m, member.name, lookup, arguments)
                moved = moved or self.w[m][i] is not None
        return moved

    def _advance_outputs(self, m: int) -> bool:
        member = self.members[m]
        ready = [
            row
            for row in self.rows[m]
            if row not in self.y[m] and self._known(m, member.outputs_by_input[row], member.outputs_by_lookup[row])
        ]
        if not ready:
            return False
        values = self.keep(member.name, member.cut(ready)(*self.arguments(m)))
        for row, value in zip(ready, ca.vertsplit(values), strict=True):
            self.put_output(m, row, value)
        return True

    def _known(self, m: int, inputs: Pattern, lookups: Pattern) -> bool:
        return all(self.u[m][i] is not None for i in np.flatnonzero(inputs)) and all(
            self.w[m][i] is not None for i in np.flatnonzero(lookups)
        )
