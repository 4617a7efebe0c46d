"""A system of FMUs: components with start values, and connections; pure functions that change it.

`read_system` (from `cosim.ssp`) reads one from disk.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from cosim.errors import CosimError, nearest
from cosim.fmu import Value, read_fmu
from fmus_src.units import Unit


@dataclass(frozen=True)
class StartValue:
    """A start value; `unit` is None for the FMU's own unit."""

    value: Value
    unit: Unit | None = None


@dataclass(frozen=True)
class ComponentInstance:
    """A named use of an FMU, with start values of its parameters or inputs."""

    name: str
    fmu: Path
    start: Mapping[str, StartValue] = field(default_factory=dict)


@dataclass(frozen=True)
class Connection:
    """source.output -> target.input; after unit conversion, input = factor * value + offset."""

    source: str
    output: str
    target: str
    input: str
    factor: float = 1.0
    offset: float = 0.0
    convert_units: bool = True

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


def with_swapped(system: System, name: str, fmu: Path) -> System:
    """The system with another FMU for a component; start values of variables it lacks are left out and noted.

    Raises:
        CosimError: no such component, or not a usable FMU.
    """
    old = system.component(name)
    known = read_fmu(fmu).variables
    lost = sorted(n for n in old.start if n not in known)
    notes = (f"{name}: {fmu.name} has no {', '.join(lost)}: left out of its start values",) if lost else ()
    new = ComponentInstance(name, fmu, {n: v for n, v in old.start.items() if n in known})
    return replace(
        system,
        components=tuple(new if c.name == name else c for c in system.components),
        notes=system.notes + notes,
    )


def with_parameters(system: System, values: Mapping[str, StartValue | Value]) -> System:
    """The system with start values set, by `component.variable`; plain values are in the FMU's own units.

    Raises:
        CosimError: a name has no component of the system.
    """
    names = {c.name for c in system.components}
    start = {c.name: dict(c.start) for c in system.components}
    for full, value in values.items():
        owner, variable = split_name(full, names)
        start[owner][variable] = value if isinstance(value, StartValue) else StartValue(value)
    return replace(system, components=tuple(replace(c, start=start[c.name]) for c in system.components))


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
