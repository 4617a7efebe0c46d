"""A system of FMUs: components with start values, and connections; pure functions that change it.

`read_system` (from `cosim.ssp`) reads one from disk.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from cosim.errors import CosimError, nearest
from cosim.fmu import Value
from fmus_src.units import Unit, conversion


@dataclass(frozen=True)
class StartValue:
    """A start value; `unit` is None for the FMU's own unit. The FMU gets factor * converted value + offset."""

    value: Value
    unit: Unit | None = None
    factor: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True)
class Mapped:
    """What an FMU of other names has for a variable of the system: FMU's value = factor * system's + offset.

    Attributes:
        name: of the FMU's variable. convert: whether units are converted before the factor.
        unit: the system's own for that variable; None if it has none.
        unitless: the FMU declares none; it is then taken to have the system's.
    """

    name: str
    factor: float = 1.0
    offset: float = 0.0
    convert: bool = True
    unit: Unit | None = None
    unitless: bool = False


@dataclass(frozen=True)
class ComponentInstance:
    """A named use of an FMU, with start values of its parameters or inputs.

    `mapped` has the FMU's variables by the names that the system has for them, where these differ.
    """

    name: str
    fmu: Path
    start: Mapping[str, StartValue] = field(default_factory=dict)
    mapped: Mapping[str, Mapped] = field(default_factory=dict)


@dataclass(frozen=True)
class Connection:
    """source.output -> target.input; after unit conversion, input = factor * value + offset.

    `units` of output and input are the system's; they hold where the FMU declares none.
    """

    source: str
    output: str
    target: str
    input: str
    factor: float = 1.0
    offset: float = 0.0
    convert_units: bool = True
    units: tuple[Unit | None, Unit | None] = (None, None)

    def __str__(self) -> str:
        return f"{self.source}.{self.output} -> {self.target}.{self.input}"


@dataclass(frozen=True)
class Port:
    """A mechanical port of a component: forces and moments that it takes, velocities that it has there.

    Attributes:
        pairs: (input, output, position) of the component, such as ("hydro.force[1]", "platform.velocity[1]",
            "platform.position[1]"): the product of the first two is the power that comes in; the third, or "", is the
            output of which the second is the rate.
    """

    name: str
    component: str
    pairs: tuple[tuple[str, str, str], ...]


@dataclass(frozen=True)
class System:
    """Components in order, their connections and ports, and notes for the run's log (what was read but not used).

    `open_inputs` are (component, input) whose source was left out on purpose: no warning is due for them.
    """

    name: str
    components: tuple[ComponentInstance, ...]
    connections: tuple[Connection, ...] = ()
    notes: tuple[str, ...] = ()
    open_inputs: frozenset[tuple[str, str]] = frozenset()
    ports: tuple[Port, ...] = ()

    def component(self, name: str) -> ComponentInstance:
        """A component by name.

        Raises:
            CosimError: no such component.
        """
        for component in self.components:
            if component.name == name:
                return component
        raise CosimError(
            f"system '{self.name}': no component '{name}'{nearest(name, (c.name for c in self.components))}"
        )


def without(system: System, *names: str) -> System:
    """The system with components and all their connections dropped; the inputs they fed keep their start values.

    Raises:
        CosimError: no such component.
    """
    for name in names:
        system.component(name)
    return replace(
        system,
        components=tuple(c for c in system.components if c.name not in names),
        connections=tuple(c for c in system.connections if c.source not in names and c.target not in names),
        open_inputs=system.open_inputs | {(c.target, c.input) for c in system.connections if c.source in names},
        ports=tuple(p for p in system.ports if p.component not in names),
    )


def with_parameters(system: System, values: Mapping[str, StartValue | Value]) -> System:
    """The system with start values set, by `component.variable`; plain values are in the FMU's own units.

    Where a component's FMU has other names than the system, either will do; a plain value by the system's name is in
    the system's unit.

    Raises:
        CosimError: a name has no component of the system.
    """
    components = {c.name: c for c in system.components}
    start = {c.name: dict(c.start) for c in system.components}
    for full, value in values.items():
        owner, variable = split_name(full, set(components))
        given = value if isinstance(value, StartValue) else StartValue(value)
        mapped = components[owner].mapped.get(variable)
        if mapped is not None:
            variable, given = mapped.name, _transformed(given, mapped)
        start[owner][variable] = given
    return replace(system, components=tuple(replace(c, start=start[c.name]) for c in system.components))


def _transformed(given: StartValue, mapped: Mapped) -> StartValue:
    if isinstance(given.value, (bool, str)):
        return given
    value, unit = given.value, (given.unit or mapped.unit) if mapped.convert else None
    if unit is not None and mapped.unitless:
        if mapped.unit is not None:
            try:
                factor, offset = conversion(unit, mapped.unit)
            except ValueError as error:
                raise CosimError(f"{mapped.name} = {given.value:g}: unit {error}") from error
            value = factor * value + offset if (factor, offset) != (1.0, 0.0) else value
        unit = None
    return StartValue(value, unit, mapped.factor * given.factor, mapped.factor * given.offset + mapped.offset)


def split_name(full: str, components: set[str]) -> tuple[str, str]:
    """Component and variable of `component.variable` (component names may contain dots; the longest wins).

    Raises:
        CosimError: no component of that name.
    """
    owners = [c for c in components if full.startswith(f"{c}.")]
    if not owners:
        owner = full.split(".")[0]
        hint = nearest(owner, sorted(components))
        raise CosimError(f"'{full}': no component '{owner}'{hint} (names are component.variable)")
    owner = max(owners, key=len)
    return owner, full[len(owner) + 1 :]
