"""`compose`: connected components as one component, whose equations are integrated together.

A co-simulation exchanges values at communication points and is only as exact as what it assumes in between. The same
components composed are one system of differential equations, in which every connection holds at every instant: the
reference for a coupled run, and the way to get a whole turbine as one FMU.

Example: a mass on a spring, from two components.
    >>> mass = Component("mass", "A free mass")
    >>> m = mass.parameter("m", 2.0, unit="kg", description="mass")
    >>> force = mass.input("force", unit="N", description="force on it")
    >>> x = mass.state("x", unit="m", start=1.0, description="position")
    >>> v = mass.state("v", unit="m/s", description="velocity")
    >>> mass.derivative(x, v)
    >>> mass.derivative(v, force / m)
    >>> mass.output("position", x, unit="m", description="position")
    >>> spring = Component("spring", "A spring to the ground")
    >>> k = spring.parameter("k", 1.0, unit="N/m", description="stiffness")
    >>> length = spring.input("length", unit="m", description="elongation")
    >>> spring.output("tension", k * length, unit="N", description="tension")
    >>> system = compose(
    ...     "oscillator",
    ...     {"body": mass, "ground": spring},
    ...     [("body.position", "ground.length"), ("ground.tension", "body.force", -1.0, 0.0)],
    ... )
    >>> from fmus_src.instance import simulate
    >>> result = simulate(system, stop=1.0, step=0.1, parameters={"ground.k": 8.0})
    >>> round(float(result["body.position"].iloc[-1]), 6)      # cos(2 t)
    -0.416147

`fmus_src.export.build.build_fmu(system, folder)` makes its FMU.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import casadi as ca

from fmus_src.component import Component
from fmus_src.equations import derive
from fmus_src.flow import Flow, Member, Wire
from fmus_src.lookups import FieldLookup, Lookup
from fmus_src.loops import solve_loop
from fmus_src.variable import Causality, Variable

Connection = tuple[str, str] | tuple[str, str, float, float]
INTERNAL_STEP = 0.0125 / 8
_SYMBOLS: dict[Causality, str] = {
    "parameter": "p", "calculated": "k", "input": "u", "state": "x", "sampled_state": "z",
}  # fmt: skip


def compose(
    name: str,
    components: Mapping[str, Component],
    connections: Sequence[Connection] = (),
    *,
    description: str = "",
    internal_step: float | None = None,
) -> Component:
    """Compose components into one.

    Direct dependencies are resolved element by element. Where outputs depend on each other in a circle (a damper's
    force on the acceleration that it changes) the loop must be affine, and is solved exactly within the equations. At
    a sample instant all sampled states take their new values at once, from the values before.

    Args:
        components: by the name that each has in the system; one may be used several times.
        connections: (output, input) or (output, input, factor, offset) for input = factor * output + offset, in the
            variables' own units; "NAME.variable" with an element's index, or whole arrays of one shape. Parameters
            and calculated parameters may feed inputs too.
        description: of the whole; by default it names the parts.
        internal_step: largest sub-step of the integrator, s; None: 1.6 ms, or a component's own if that is less.

    Returns:
        a component whose variables are "NAME.variable" for every variable of the parts, less the connected inputs.

    Raises:
        ValueError: a connection names no such variable, an input has two sources, sampled parts differ in their sample
            time, or an algebraic loop is not affine.
    """
    derived = {part: derive(component) for part, component in components.items()}
    sampled = {part: c.sample_time for part, c in components.items() if c.sample_time is not None}
    if len(set(sampled.values())) > 1:
        listed = ", ".join(f"{part} {time:g} s" for part, time in sampled.items())
        raise ValueError(f"{name}: sampled components must share one sample time, but have {listed}")
    whole = _Composite(
        name,
        description or f"System of {', '.join(components)}",
        symbols="MX",
        internal_step=internal_step or min(INTERNAL_STEP, *(c.internal_step for c in components.values())),
        sample_time=next(iter(sampled.values()), None),
        sample_at_start=any(c.sample_at_start for c in components.values()),
        directional_derivatives=False,
    )
    members = [Member.of(part, equations) for part, equations in derived.items()]
    wires = whole.wires(members, connections)
    flow = whole.declare(members, wires)
    while not flow.complete():
        if not flow.advance():
            solve_loop(flow, name)
    whole.finish(flow)
    return whole


class _Composite(Component):
    """The component that the parts make up."""

    def wires(self, members: Sequence[Member], connections: Sequence[Connection]) -> list[Wire]:
        """Connections, element by element."""
        wires: list[Wire] = []
        fed: dict[tuple[int, int], str] = {}
        for connection in connections:
            source, target = connection[0], connection[1]
            factor, offset = (float(connection[2]), float(connection[3])) if len(connection) == 4 else (1.0, 0.0)
            sources = self._elements(members, source, ("output", "parameter", "calculated"))
            targets = self._elements(members, target, ("input",))
            if len(sources) != len(targets):
                raise ValueError(f"{self.name}: {source} -> {target}: {len(sources)} values cannot feed {len(targets)}")
            for (m, kind, i), (n, _, j) in zip(sources, targets, strict=True):
                if (n, j) in fed:
                    raise ValueError(f"{self.name}: {target} has two sources: {fed[n, j]} and {source}; keep one")
                fed[n, j] = source
                wires.append(Wire(m, kind, i, n, j, factor, offset))
        return wires

    def _elements(
        self, members: Sequence[Member], full: str, causalities: tuple[Causality, ...]
    ) -> list[tuple[int, str, int]]:
        """(member, symbol, place) of a variable's elements, or of one of them."""
        part, _, wanted = full.partition(".")
        for m, member in enumerate(members):
            for causality in causalities if member.name == part else ():
                key, place = _SYMBOLS.get(causality, "y"), 0
                for variable in member.equations.of(causality):
                    names = variable.element_names()
                    if wanted == variable.name:
                        return [(m, key, place + i) for i in range(variable.size)]
                    if wanted in names:
                        return [(m, key, place + names.index(wanted))]
                    place += variable.size
        wanted_kind = " or ".join(causalities)
        raise ValueError(f"{self.name}: no {wanted_kind} '{full}'; write it as component.variable")

    def declare(self, members: Sequence[Member], wires: Sequence[Wire]) -> Flow:
        """Declare the parts' parameters, unconnected inputs and states; what is known of the flow before a step."""
        connected = {(w.target, w.input) for w in wires}
        flow = Flow(members, wires, self.time, ca.MX, self._keep, self._carry_over)
        self._texts = []
        for m, member in enumerate(members):
            self._texts.append(len(self.strings))
            for text in member.equations.strings:
                self._reserve(f"{member.name}.{text.name}")
                self.strings.append(replace(text, name=f"{member.name}.{text.name}"))
            self._declare_values(flow, m, member)
            place = 0
            for variable in member.equations.of("input"):
                free = [(m, place + i) not in connected for i in range(variable.size)]
                for i, symbol in self._free_inputs(member.name, variable, free):
                    flow.u[m][place + i] = symbol
                place += variable.size
        flow.feed_parameters()
        return flow

    def _declare_values(self, flow: Flow, m: int, member: Member) -> None:
        """Parameters, calculated parameters and states of a part, as columns of the flow."""
        equations, given = member.equations, flow.columns[m]
        given["p"] = self._declare_all(member.name, equations.of("parameter"), None)
        calculated = equations.calculate(given["p"])
        given["k"] = self._declare_all(member.name, equations.of("calculated"), calculated)
        x, z = equations.initial(given["p"], given["k"])
        given["x"] = self._declare_all(member.name, equations.of("state"), x)
        given["z"] = self._declare_all(member.name, equations.of("sampled_state"), z)

    def _declare_all(self, part: str, variables: Sequence[Variable], values: Any) -> Any:
        """Declare variables under the part's name, with the elements of a column as their expressions."""
        symbols = []
        if values is not None and variables:
            offsets = [0]
            for variable in variables:
                offsets.append(offsets[-1] + variable.size)
            for variable, value in zip(variables, ca.vertsplit(values, offsets), strict=True):
                self.groups[variable.causality].expressions.append(value)
        for variable in variables:
            self._declare(replace(variable, name=f"{part}.{variable.name}"))
            symbols.append(self.groups[variable.causality].symbols[-1])
        return ca.vertcat(*symbols) if symbols else ca.MX(0, 1)

    def _free_inputs(self, part: str, variable: Variable, free: Sequence[bool]) -> list[tuple[int, Any]]:
        """Inputs that no connection feeds: a whole array, or what is left of one by its elements' names."""
        group = self.groups["input"]
        if all(free):
            self._declare(replace(variable, name=f"{part}.{variable.name}"))
            return list(enumerate(ca.vertsplit(group.symbols[-1])))
        left = []
        for i, name in enumerate(variable.element_names()):
            if free[i]:
                self._declare(replace(variable, name=f"{part}.{name}", shape=(), start=(variable.start[i],)))
                left.append((i, group.symbols[-1]))
        return left

    def _reserve(self, name: str) -> None:
        """As usual; an element of an array whose others are connected goes by its own name."""
        if name.endswith("]"):
            self._names.add(name)
        else:
            super()._reserve(name)

    def _keep(self, label: str, values: Any) -> Any:
        """Store what several expressions need, so that it is evaluated once."""
        return self.intermediate(f"{label}_{len(self.lookups)}", values)

    def _carry_over(self, m: int, part: str, lookup: Lookup, arguments: Any) -> Any:
        """A part's lookup as one of the whole's."""
        lookup = replace(lookup, name=f"{part}_{lookup.name}")  # type: ignore[type-var]
        if isinstance(lookup, FieldLookup):
            lookup = replace(lookup, file_index=self._texts[m] + lookup.file_index)
        return self._lookup(lookup, arguments, (lookup.result_size,))

    def finish(self, flow: Flow) -> None:
        """Give the equations of all states and outputs, every input being known."""
        started = None
        if self.sample_at_start and not all(
            member.component.sample_at_start for member in flow.members if member.component.sample_time is not None
        ):
            started = self.sampled_state("started", internal=True, description="0 at the first sample, later 1")
            self.update(started, 1.0)
        for m, member in enumerate(flow.members):
            arguments, equations = flow.arguments(m), member.equations
            self._set_rates(member, "state", flow.rates(m))
            following = equations.update(*arguments)
            if started is not None and not member.component.sample_at_start:
                following = ca.if_else(started, following, flow.columns[m]["z"])
            self._set_rates(member, "sampled_state", following)
            self._declare_all(member.name, equations.of("output"), equations.outputs(*arguments))

    def _set_rates(self, member: Member, causality: Causality, rates: Any) -> None:
        place = 0
        for variable in member.equations.of(causality):
            self._rates[f"{member.name}.{variable.name}"] = rates[place : place + variable.size]
            place += variable.size
