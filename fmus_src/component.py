"""`Component`: a physical component declared once, in CasADi, from which everything else is derived.

A component is the continuous-time (and optionally sampled) system

    x' = f(t, x, z, u, p, k, w)         continuous states        `state`, `derivative`
    z+ = g(t, x, z, u, p, k, w)         sampled states           `sampled_state`, `update`
    y  = h(t, x, z, u, p, k, w)         outputs                  `output`
    k  = c(p)                           calculated parameters    `calculated`
    w  = l(t, x, z, u, p, k)            lookups: tables, wind fields, implicit equations, intermediate results, switches

with inputs u and parameters p. Declaring a variable returns its CasADi symbol (a column vector, or a matrix for a
two-element shape), to be used in the equations that follow. Names are FMI structured names ("platform.velocity");
the elements of an array are `name[1]`, `name[2]`, ... and `name[1,1]` (row by row), counted from one.

Example:
    >>> c = Component("oscillator", "A mass on a spring")
    >>> m = c.parameter("m", 2.0, unit="kg", description="mass", min=1e-6)
    >>> stiffness = c.parameter("stiffness", 8.0, unit="N/m", description="spring stiffness")
    >>> force = c.input("force", unit="N", description="external force")
    >>> x = c.state("position", unit="m", description="position", start=1.0)
    >>> v = c.state("velocity", unit="m/s", description="velocity")
    >>> c.derivative(x, v)
    >>> c.derivative(v, (force - stiffness * x) / m)
    >>> c.output("energy", 0.5 * m * v**2 + 0.5 * stiffness * x**2, unit="J", description="mechanical energy")
    >>> from fmus_src.instance import simulate
    >>> result = simulate(c, stop=1.0, step=0.01)
    >>> round(float(result["position"].iloc[-1]), 6)      # cos(2 t)
    -0.416147
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import casadi as ca
import numpy as np
import numpy.typing as npt

from fmus_src.lookups import FieldLookup, ImplicitLookup, Lookup, StoredLookup, SwitchLookup, TableLookup
from fmus_src.units import unit as resolve_unit
from fmus_src.variable import Causality, Kind, Variable, shape_of, shaped, size_of

Array = npt.NDArray[np.float64]

_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*(\.[A-Za-z_][A-Za-z0-9_]*)*")


@dataclass
class _Group:
    """Declared variables of one causality, with their flat symbols."""

    variables: list[Variable] = field(default_factory=list)
    symbols: list[Any] = field(default_factory=list)
    expressions: list[Any] = field(default_factory=list)


class Component:
    """Builder of a component; see the module's documentation.

    Args:
        name: model identifier, a C identifier in lower case.
        description: one sentence.
        symbols: "SX" expands every operation (fastest for small dense mechanics); "MX" keeps vectors, so that sums
            over many elements become loops in the generated C.
        internal_step: largest sub-step of the Runge-Kutta integrator, s.
        sample_time: period of `update`, s (sampled components only).
        sample_at_start: whether the first sample is taken at the start, with the inputs then, not one period later.
        directional_derivatives: whether its FMU gives them; without, it has half the code.
        author, copyright, license: of the model, as its FMUs state them; give your own for a model of your own.
    """

    def __init__(
        self,
        name: str,
        description: str,
        *,
        symbols: Literal["SX", "MX"] = "SX",
        internal_step: float = 0.0125,
        sample_time: float | None = None,
        sample_at_start: bool = False,
        directional_derivatives: bool = True,
        author: str = "fowt-cosim",
        copyright: str = "Copyright (c) 2026 The fowt-cosim authors",
        license: str = "MIT",
    ) -> None:
        if not re.fullmatch(r"[a-z][a-z0-9_]*", name):
            raise ValueError(f"component name '{name}' must be a lower-case C identifier")
        if not (internal_step > 0.0 and (sample_time is None or sample_time > 0.0)):
            raise ValueError(f"{name}: internal_step {internal_step} s and sample_time {sample_time} s must be above 0")
        if sample_at_start and sample_time is None:
            raise ValueError(f"{name}: sample_at_start needs a sample_time")
        self.name = name
        self.description = description
        self.internal_step = internal_step
        self.sample_time = sample_time
        self.sample_at_start = sample_at_start
        self.directional_derivatives = directional_derivatives
        self.author, self.copyright, self.license = author, copyright, license
        self.sym = ca.SX if symbols == "SX" else ca.MX
        self.time = self.sym.sym("time")
        self.strings: list[Variable] = []
        self.lookups: list[Lookup] = []
        self.lookup_arguments: list[Any] = []
        self.lookup_symbols: list[Any] = []
        self.places: dict[str, str] = {}
        causalities: tuple[Causality, ...] = (
            "parameter", "calculated", "input", "output", "state", "sampled_state",
        )  # fmt: skip
        self.groups: dict[Causality, _Group] = {c: _Group() for c in causalities}
        self._rates: dict[str, Any] = {}
        self._names: set[str] = set()

    # --- declarations -------------------------------------------------------------------------------------------

    def parameter(
        self,
        name: str,
        start: float | Sequence[Any] | Array,
        *,
        unit: str = "1",
        description: str,
        min: float | None = None,
        max: float | None = None,
        kind: Kind = "real",
        display_unit: str | None = None,
        nominal: float | None = None,
        tunable: bool = False,
    ) -> Any:
        """Declare a parameter; its shape is that of `start`. Returns its symbol."""
        values = np.asarray(start, dtype=float)
        variable = Variable(
            name, "parameter", description, unit, kind, values.shape, tuple(values.ravel().tolist()),
            min=min, max=max, display_unit=display_unit, nominal=nominal, tunable=tunable,
        )  # fmt: skip
        return self._declare(variable)

    def string_parameter(self, name: str, start: str = "", *, description: str) -> str:
        """Declare a text parameter (the path of a wind file, say); returns its name, which `field` takes."""
        self._reserve(name)
        self.strings.append(Variable(name, "parameter", description, kind="string", text=start))
        return name

    def calculated(
        self,
        name: str,
        expression: Any,
        *,
        unit: str = "1",
        description: str,
        nominal: float | None = None,
        internal: bool = False,
    ) -> Any:
        """Declare a value that depends on parameters only and is evaluated once, at initialisation."""
        shape = shape_of(expression)
        variable = Variable(
            name, "calculated", description, unit, shape=shape, start=(0.0,) * size_of(shape), nominal=nominal,
            internal=internal,
        )  # fmt: skip
        self.groups["calculated"].expressions.append(self._flat(expression))
        return self._declare(variable)

    def input(
        self,
        name: str,
        shape: int | tuple[int, ...] = (),
        *,
        unit: str = "1",
        description: str,
        start: float | Sequence[float] = 0.0,
        display_unit: str | None = None,
        nominal: float | None = None,
    ) -> Any:
        """Declare an input; returns its symbol."""
        variable = self._with_start(name, "input", shape, start, unit, description, display_unit, nominal)
        return self._declare(variable)

    def state(
        self,
        name: str,
        shape: int | tuple[int, ...] = (),
        *,
        unit: str = "1",
        description: str,
        start: Any = 0.0,
        display_unit: str | None = None,
        nominal: float | None = None,
    ) -> Any:
        """Declare a continuous state; `start` is a number or an expression in parameters. Returns its symbol."""
        return self._declare_state("state", name, shape, start, unit, description, display_unit, nominal)

    def sampled_state(
        self,
        name: str,
        shape: int | tuple[int, ...] = (),
        *,
        unit: str = "1",
        description: str,
        start: Any = 0.0,
        display_unit: str | None = None,
        nominal: float | None = None,
        internal: bool = False,
    ) -> Any:
        """Declare a state that changes at the sample instants k * sample_time only; k = 1, 2, ..., or from 0 on."""
        if self.sample_time is None:
            raise ValueError(f"{self.name}: sampled state '{name}' needs the component's sample_time")
        return self._declare_state(
            "sampled_state", name, shape, start, unit, description, display_unit, nominal, internal
        )

    def output(
        self,
        name: str,
        expression: Any,
        *,
        unit: str = "1",
        description: str,
        display_unit: str | None = None,
        nominal: float | None = None,
    ) -> None:
        """Declare an output by its expression."""
        shape = shape_of(expression)
        variable = Variable(
            name, "output", description, unit, shape=shape, start=(0.0,) * size_of(shape),
            display_unit=display_unit, nominal=nominal,
        )  # fmt: skip
        self.groups["output"].expressions.append(self._flat(expression))
        self._declare(variable)

    def derivative(self, state: Any, expression: Any) -> None:
        """Give the time derivative of a continuous state."""
        self._set_rate("state", state, expression)

    def update(self, state: Any, expression: Any) -> None:
        """Give the value that a sampled state takes at the next sample instant."""
        self._set_rate("sampled_state", state, expression)

    def port(self, name: str, place: str) -> None:
        """State where the force `name.force` acts whose motion is not `name.velocity` but `place.velocity`.

        The FMU's terminals (FMI 3.0) join both.
        """
        self.places[name] = place

    # --- lookups ------------------------------------------------------------------------------------------------

    def intermediate(self, name: str, expression: Any) -> Any:
        """Evaluate an expression once for all that uses it: lookups after it, and the equations.

        Without it each of them repeats what it has in common with the others.

        Returns:
            symbol of the expression's shape.
        """
        self._lookup(StoredLookup(name, int(expression.numel())), ca.vec(expression), (int(expression.numel()),))
        return ca.reshape(self.lookup_symbols[-1], *expression.shape)

    def switch(self, name: str, expression: Any) -> Any:
        """Declare where the equations are not smooth: the zeros of `expression`.

        Write the equations with the symbol returned in place of a comparison (`ca.if_else`, `ca.fmax`). The integrator
        holds it over a sub-step, so that its formula sees smooth equations, and ends the sub-step just past the
        first zero: the order of convergence is kept. A sign that changes twice within one sub-step goes unseen.

        Args:
            expression: column of n continuous functions of time, states, inputs, parameters and lookups.

        Returns:
            symbol of n elements: 1 where `expression` > 0, else 0.
        """
        size = int(expression.numel())
        return self._lookup(SwitchLookup(name, size), ca.vec(expression), (size,))

    def table(self, name: str, data: Array, first: float, spacing: float, which: Sequence[int], x: Any) -> Any:
        """Look up x[i] in table which[i] by linear interpolation on a uniform grid, held beyond its ends.

        Args:
            data: shape (tables, points, columns).
            first, spacing: grid of the abscissa.
            which: table of each argument, length n.
            x: n abscissae.

        Returns:
            symbol of shape (n, columns).
        """
        lookup = TableLookup(name, np.ascontiguousarray(data, dtype=float), first, spacing, tuple(which))
        return self._lookup(lookup, ca.vec(x), (len(which), data.shape[2]))

    def field(self, name: str, file_parameter: str, points: Any) -> tuple[Any, Any]:
        """Sample the turbulent wind box named by a string parameter at the points and the current time.

        Args:
            points: shape (n, 3), m, global frame.

        Returns:
            velocities (n, 3) in m/s, and a flag: 1 if a file is loaded, else 0 (the velocities are then 0).
        """
        files = [s.name for s in self.strings]
        n = int(points.shape[0])
        lookup = FieldLookup(name, n, files.index(file_parameter))
        result = self._lookup(lookup, ca.vertcat(self.time, ca.vec(points.T)), (3 * n + 1,))
        return ca.reshape(result[: 3 * n], 3, n).T, result[3 * n]

    def solve(self, name: str, residual: ca.Function, guess: Any, arguments: Any) -> Any:
        """Solve residual(y, a) = 0 for y by Newton's method, once for each row of `arguments`.

        The first solution starts from `guess(a)`, later ones from the solution before (kept with the FMU's state).

        Args:
            residual: CasADi function (y[n], a[m]) -> r[n].
            guess: CasADi function a[m] -> y[n].
            arguments: shape (count, m).

        Returns:
            symbol of shape (count, n).
        """
        count, _ = arguments.shape
        n = int(residual.size1_in(0))
        return self._lookup(ImplicitLookup(name, residual, guess, int(count)), ca.vec(arguments.T), (int(count), n))

    # --- internals ----------------------------------------------------------------------------------------------

    def _lookup(self, lookup: Lookup, arguments: Any, shape: tuple[int, ...]) -> Any:
        if lookup.name in [other.name for other in self.lookups]:
            raise ValueError(f"{self.name}: lookup '{lookup.name}' is declared twice")
        self.lookups.append(lookup)
        self.lookup_arguments.append(arguments)
        symbol = self.sym.sym(lookup.name, size_of(shape))
        self.lookup_symbols.append(symbol)
        return shaped(symbol, shape)

    def _reserve(self, name: str) -> None:
        if not _NAME.fullmatch(name):
            raise ValueError(f"{self.name}: '{name}' is not a structured name such as 'platform.velocity'")
        if name in self._names:
            raise ValueError(f"{self.name}: variable '{name}' is declared twice")
        self._names.add(name)

    def _declare(self, variable: Variable) -> Any:
        self._reserve(variable.name)
        for name in filter(None, (variable.unit, variable.display_unit)):
            resolve_unit(name)
        for value in variable.start:
            low = variable.min is not None and value < variable.min
            high = variable.max is not None and value > variable.max
            if low or high:
                raise ValueError(f"{self.name}.{variable.name}: start {value} is outside its bounds")
        group = self.groups[variable.causality]
        symbol = self.sym.sym(variable.name, variable.size)
        group.variables.append(variable)
        group.symbols.append(symbol)
        return shaped(symbol, variable.shape)

    def _with_start(
        self,
        name: str,
        causality: Causality,
        shape: int | tuple[int, ...],
        start: Any,
        unit: str,
        description: str,
        display_unit: str | None,
        nominal: float | None,
    ) -> Variable:
        full = (shape,) if isinstance(shape, int) else shape
        values = np.broadcast_to(np.asarray(start, dtype=float), full).ravel().tolist()
        return Variable(
            name, causality, description, unit, shape=full, start=tuple(values),
            display_unit=display_unit, nominal=nominal,
        )  # fmt: skip

    def _declare_state(
        self, causality: Causality, name: str, shape: Any, start: Any, unit: str, description: str,
        display_unit: str | None, nominal: float | None, internal: bool = False,
    ) -> Any:  # fmt: skip
        variable = self._with_start(name, causality, shape, 0.0, unit, description, display_unit, nominal)
        variable = replace(variable, internal=internal)
        flat = self._flat(start)
        if flat.numel() == 1 and variable.size != 1:
            flat = ca.repmat(flat, variable.size, 1)
        if flat.numel() != variable.size:
            raise ValueError(f"{self.name}.{name}: start has {flat.numel()} values, the state {variable.size}")
        self.groups[causality].expressions.append(flat)
        return self._declare(variable)

    def _set_rate(self, causality: Causality, state: Any, expression: Any) -> None:
        group = self.groups[causality]
        for variable, symbol in zip(group.variables, group.symbols, strict=True):
            own = shaped(symbol, variable.shape)
            if own.shape == state.shape and ca.is_equal(own, state, 2):
                flat = self._flat(expression)
                if flat.numel() != variable.size:
                    raise ValueError(f"{self.name}.{variable.name}: wrong number of elements in its equation")
                if variable.name in self._rates:
                    raise ValueError(f"{self.name}.{variable.name}: has two equations")
                self._rates[variable.name] = flat
                return
        raise ValueError(f"{self.name}: the equation's left side is no declared {causality.replace('_', ' ')}")

    def rates(self, causality: Causality) -> list[Any]:
        """Right-hand sides of the states of a causality, in order of declaration.

        Raises:
            ValueError: a state has no equation.
        """
        for variable in self.groups[causality].variables:
            if variable.name not in self._rates:
                raise ValueError(f"{self.name}.{variable.name}: has no equation")
        return [self._rates[v.name] for v in self.groups[causality].variables]

    def _flat(self, expression: Any) -> Any:
        """An expression as a dense column, row by row."""
        value = expression if isinstance(expression, (ca.SX, ca.MX)) else self.sym(ca.DM(np.asarray(expression)))
        return ca.densify(ca.vec(value.T))
