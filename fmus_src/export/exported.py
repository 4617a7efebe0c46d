"""The variables that an FMU shows, whatever the version of FMI: declared ones, and those that follow from them."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import casadi as ca
import numpy as np
import numpy.typing as npt

from fmus_src.equations import Equations
from fmus_src.lookups import SwitchLookup
from fmus_src.variable import Causality, Variable

Role = Literal[
    "parameter", "calculated", "input", "output", "state", "sampled_state", "time", "rate", "indicator", "string"
]
FMI_CAUSALITY = {
    "parameter": "parameter",
    "string": "parameter",
    "calculated": "calculatedParameter",
    "input": "input",
    "output": "output",
    "time": "independent",
}  # others are local


@dataclass(frozen=True)
class Exported:
    """A variable of an FMU.

    Attributes:
        variable: what is declared of it: name, shape, unit, bounds, start.
        reference: place of its first element in the runtime's values; of a text its place after all of these.
        element_variabilities: FMI's word for each element.
        state: of a rate, the state's reference.
    """

    variable: Variable
    role: Role
    reference: int
    element_variabilities: tuple[str, ...]
    state: int | None = None

    @property
    def causality(self) -> str:
        return FMI_CAUSALITY.get(self.role, "local")

    @property
    def variability(self) -> str:
        """Of the whole: the least restricted of its elements."""
        order = ("fixed", "discrete", "tunable", "continuous")
        return max(self.element_variabilities, key=order.index, default="continuous")

    @property
    def initial(self) -> str | None:
        if self.role in ("parameter", "string"):
            return "exact"
        return None if self.role in ("input", "time") else "calculated"

    @property
    def has_start(self) -> bool:
        return self.role in ("parameter", "input", "string")

    def element_names(self) -> list[str]:
        """Scalar names; an element of a derivative is the derivative of an element: der(x[1])."""
        if self.role != "rate":
            return self.variable.element_names()
        inner = replace(self.variable, name=self.variable.name[4:-1])
        return [f"der({name})" for name in inner.element_names()]


@dataclass(frozen=True)
class Exports:
    """All variables of a component's FMU, in order of reference."""

    equations: Equations

    @cached_property
    def all(self) -> tuple[Exported, ...]:
        found, reference = [], 0
        tunable, discrete = _tunable(self.equations), _discrete(self.equations)
        for v in self.equations.variables:
            places = range(reference, reference + v.size)
            words = tuple(_variability(v.causality, i in tunable, i in discrete) for i in places)
            found.append(Exported(v, v.causality, reference, words))
            reference += v.size
        states = [e for e in found if e.role == "state"]
        derived: list[tuple[Variable, Role, int | None]] = [
            (Variable("time", "output", "simulation time", "s"), "time", None),
            *((_rate(e.variable), "rate", e.reference) for e in states),
            *((v, "indicator", None) for v in _indicators(self.equations)),
        ]
        for v, role, state in derived:
            found.append(Exported(v, role, reference, ("continuous",) * v.size, state))
            reference += v.size
        texts = (Exported(v, "string", reference + i, ("fixed",)) for i, v in enumerate(self.equations.strings))
        return (*found, *texts)

    def of(self, *roles: Role) -> list[Exported]:
        """Variables with one of these roles, internal ones left out."""
        return [e for e in self.all if e.role in roles and not e.variable.internal]

    @cached_property
    def dependencies(self) -> dict[str, npt.NDArray[np.bool_]]:
        """Of each role of unknowns, elements (rows) by knowns (columns): inputs, continuous states, time."""
        e = self.equations
        found = e.dependencies([e.outputs, e.derivatives, e.switches], ["u", "x", "t"])
        return dict(zip(("output", "rate", "indicator"), found, strict=True))

    def knowns(self) -> list[tuple[Exported, int]]:
        """The columns of `dependencies`: variable and element."""
        of_time = next(e for e in self.all if e.role == "time")
        return [(e, i) for e in [*self.of("input"), *self.of("state"), of_time] for i in range(e.variable.size)]


def _variability(causality: Causality, tunable: bool, discrete: bool) -> str:
    if causality in ("parameter", "calculated"):
        return "tunable" if tunable else "fixed"
    return "discrete" if discrete else "continuous"


def _rate(state: Variable) -> Variable:
    return Variable(
        f"der({state.name})", "state", f"time derivative of {state.name}", derivative_unit(state.unit),
        shape=state.shape, start=(0.0,) * state.size, nominal=state.nominal,
    )  # fmt: skip


def _indicators(equations: Equations) -> list[Variable]:
    return [
        Variable(
            f"event_indicators.{lookup.name}", "state", f"changes sign where {lookup.name} does",
            shape=() if lookup.size == 1 else (lookup.size,), start=(0.0,) * lookup.size,
        )
        for lookup in equations.lookups
        if isinstance(lookup, SwitchLookup)
    ]  # fmt: skip


def derivative_unit(name: str) -> str:
    """The unit per second, in the same style: m -> m/s -> m/s2, 1 -> 1/s, N.m/rad -> N.m/rad/s."""
    per_second = re.fullmatch(r"(.*/s)(\d*)", name)
    if per_second:
        return f"{per_second[1]}{int(per_second[2] or 1) + 1}"
    return f"{name or '1'}/s"


def _tunable(equations: Equations) -> set[int]:
    """References of tunable parameters and of the calculated parameters that follow them."""
    tunable = np.array([v.tunable for v in equations.of("parameter") for _ in range(v.size)], dtype=bool)
    follows = np.asarray(ca.DM(equations.calculate.jac_sparsity(0, 0), 1.0).full() != 0.0)[:, tunable].any(axis=1)
    return set(np.flatnonzero(np.concatenate([tunable, follows])).tolist())


def _discrete(equations: Equations) -> set[int]:
    """References of what changes at sample instants only: sampled states, and the outputs that follow them alone.

    An output of parameters only is among them: FMI has no better word for an output that never changes.
    """
    sizes = equations.sizes
    first_output = sizes["p"] + sizes["k"] + sizes["u"]
    outputs = np.flatnonzero(equations.discrete_outputs()) + first_output
    first_sampled = first_output + sizes["y"] + sizes["x"]
    return {*outputs.tolist(), *range(first_sampled, first_sampled + sizes["z"])}
