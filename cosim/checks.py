"""Checks of a system before it runs: names, causalities, types, units, bounds, unconnected and doubly fed inputs."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace

from cosim.errors import CosimError, nearest
from cosim.fmu import Fmu, FmuVariable, Value, elements, read_fmu
from cosim.system import ComponentInstance, Connection, Mapped, Port, StartValue, System
from fmus_src.units import Unit, conversion

SOURCES = ("output", "calculatedParameter", "parameter")
LISTED = 8  # names in a warning
SINGLY = 3  # connections that get a warning each
UNITLESS = Unit("1", 1.0, 0.0, ())


@dataclass(frozen=True)
class Link:
    """A checked connection: indices of the components, their variables; input = factor * output + offset."""

    source: int
    output: FmuVariable
    target: int
    input: FmuVariable
    factor: float
    offset: float


@dataclass(frozen=True)
class CheckedPort:
    """A checked mechanical port: index of the component, its pairs of effort (input), flow (output) and position."""

    name: str
    component: int
    pairs: tuple[tuple[FmuVariable, FmuVariable, str], ...]


@dataclass(frozen=True)
class CheckedSystem:
    """A system that can run.

    Attributes:
        names, fmus: of the components, in order.
        start: start values of each component, in the FMU's own units.
        mapped: of each component, what its FMU calls variables of which the system has other names.
        warnings: one line each.
    """

    name: str
    names: tuple[str, ...]
    fmus: tuple[Fmu, ...]
    links: tuple[Link, ...]
    start: tuple[Mapping[str, Value], ...]
    warnings: tuple[str, ...]
    ports: tuple[CheckedPort, ...] = ()
    mapped: tuple[Mapping[str, Mapped], ...] = ()


def check(system: System, isolated: Collection[str] = ()) -> CheckedSystem:
    """Check a system against its FMUs.

    Args:
        isolated: names of the components that run in their own processes.

    Raises:
        CosimError: the first thing found wrong, in one line.
    """
    if not system.components:
        raise CosimError(f"system '{system.name}' has no component")
    fmus = tuple(read_fmu(c.fmu) for c in system.components)
    names = tuple(c.name for c in system.components)
    for fmu in fmus:
        users = [n for n, f in zip(names, fmus, strict=True) if f.path == fmu.path and n not in isolated]
        if fmu.once_per_process and len(users) > 1:
            raise CosimError(
                f"{fmu.path.name} can be instantiated only once, but {' and '.join(users)} use it; isolate all but one"
            )
    system = by_elements(system)
    links = tuple(_link(c, names, fmus) for c in system.connections)
    fed: dict[tuple[int, str, int], Connection] = {}  # by reference: an input may have several names
    for connection, link in zip(system.connections, links, strict=True):
        other = fed.setdefault((link.target, link.input.type, link.input.reference), connection)
        if other is not connection:
            raise CosimError(
                f"{connection.target}.{connection.input} has two sources: {other} and {connection}; keep one"
            )
    start = tuple(
        {n: _start_value(c, f.variable(c.name, n), v, f.version) for n, v in c.start.items()}
        for c, f in zip(system.components, fmus, strict=True)
    )
    warnings = [*system.notes, *_unitless(links, names)]
    for k, (name, fmu) in enumerate(zip(names, fmus, strict=True)):
        inputs = [v for v in fmu.variables.values() if v.causality == "input"]
        loose = [v for v in inputs if (k, v.type, v.reference) not in fed and (name, v.name) not in system.open_inputs]
        if loose:
            values = ", ".join(f"{v.name} = {start[k].get(v.name, v.start)}" for v in loose[:LISTED])
            values += f", ... ({len(loose)} inputs)" if len(loose) > LISTED else ""
            warnings.append(f"{name}: not connected, start value used: {values}")
    ports = tuple(_port(p, names, fmus) for p in system.ports)
    mapped = tuple(c.mapped for c in system.components)
    warnings += [w for p in system.ports for w in _lost_pairs(p, fmus[names.index(p.component)])]
    return CheckedSystem(system.name, names, fmus, links, start, tuple(warnings), ports, mapped)


def by_elements(system: System) -> System:
    """The system with connections of whole arrays as those of their elements.

    Raises:
        CosimError: two arrays have different numbers of elements, or an FMU cannot be read.
    """
    fmus, names = tuple(read_fmu(c.fmu) for c in system.components), tuple(c.name for c in system.components)
    return replace(system, connections=tuple(e for c in system.connections for e in _by_elements(c, names, fmus)))


def _by_elements(connection: Connection, names: tuple[str, ...], fmus: tuple[Fmu, ...]) -> list[Connection]:
    """A connection of whole arrays as those of their elements: of equal indices, or else in their order."""
    found = []
    for name, variable in ((connection.source, connection.output), (connection.target, connection.input)):
        known: Collection[str] = fmus[names.index(name)].variables if name in names else ()
        found.append(elements(known, variable) if variable not in known else [])
    if not all(found):
        return [connection]
    if len(found[0]) != len(found[1]):
        raise CosimError(
            f"connection {connection}: {len(found[0])} elements to {len(found[1])}; connect arrays of one length"
        )
    return [replace(connection, output=a, input=b) for a, b in zip(*found, strict=True)]


def _link(connection: Connection, names: tuple[str, ...], fmus: tuple[Fmu, ...]) -> Link:
    for name in (connection.source, connection.target):
        if name not in names:
            raise CosimError(f"connection {connection}: no component '{name}'{nearest(name, names)}")
    source, target = names.index(connection.source), names.index(connection.target)
    output = fmus[source].variable(f"connection {connection}: {connection.source}", connection.output)
    taken = fmus[target].variable(f"connection {connection}: {connection.target}", connection.input)
    if output.causality not in SOURCES:
        raise CosimError(
            f"connection {connection}: {output.name} is no output but {output.causality}; connect an output"
        )
    if taken.causality != "input":
        raise CosimError(
            f"connection {connection}: {taken.name} is no input but {taken.causality}; connect to an input"
        )
    kinds = [v.type.replace("Enumeration", "Integer") for v in (output, taken)]
    if "String" in kinds:
        raise CosimError(f"connection {connection}: text cannot be connected; set it as a parameter")
    if kinds[0] != kinds[1] and kinds != ["Integer", "Real"]:
        raise CosimError(f"connection {connection}: {output.type} cannot feed {taken.type}; connect equal types")
    factor, offset = 1.0, 0.0
    units = output.unit or connection.units[0], taken.unit or connection.units[1]
    if connection.convert_units and units[0] is not None and units[1] is not None:
        try:
            factor, offset = conversion(units[0], units[1])
        except ValueError as error:
            raise CosimError(f"connection {connection}: unit {error}; connect quantities of one kind") from error
    return Link(
        source, output, target, taken, connection.factor * factor, connection.factor * offset + connection.offset
    )


def _port(port: Port, names: tuple[str, ...], fmus: tuple[Fmu, ...]) -> CheckedPort:
    """A port whose pairs exist and make powers; pairs that a swapped FMU lacks are left out."""
    if port.component not in names:
        raise CosimError(f"port '{port.name}': no component '{port.component}'{nearest(port.component, names)}")
    k = names.index(port.component)
    pairs = []
    for effort, flow, position in port.pairs:
        if effort not in fmus[k].variables or flow not in fmus[k].variables:
            continue
        force, velocity = fmus[k].variables[effort], fmus[k].variables[flow]
        if (force.causality, velocity.causality) != ("input", "output"):
            raise CosimError(f"port '{port.name}': {effort} must be an input of {port.component}, {flow} an output")
        units = [u.name if u else "no unit" for u in (force.unit, velocity.unit)]
        if not _makes_watt(force.unit, velocity.unit):
            raise CosimError(f"port '{port.name}': {effort} ({units[0]}) times {flow} ({units[1]}) is no power in W")
        pairs.append((force, velocity, position))
    return CheckedPort(port.name, k, tuple(pairs))


def _lost_pairs(port: Port, fmu: Fmu) -> list[str]:
    missing = [n for n in dict.fromkeys(n for pair in port.pairs for n in pair) if n and n not in fmu.variables]
    return [f"port {port.name}: not measured in full, {fmu.path.name} has no {', '.join(missing)}"] if missing else []


def _makes_watt(effort: Unit | None, flow: Unit | None) -> bool:
    """Whether the product of two units is the watt, radians being numbers."""
    if effort is None or flow is None:
        return False
    total = Counter(dict(effort.exponents))
    total.update(dict(flow.exponents))
    base = {b: e for b, e in total.items() if e and b != "rad"}
    return base == {"kg": 1, "m": 2, "s": -3} and math.isclose(effort.factor * flow.factor, 1.0)


def _unitless(links: tuple[Link, ...], names: tuple[str, ...]) -> list[str]:
    """Warnings for connections between a variable with unit and one without; one for an FMU with many of them."""
    found: dict[str, list[tuple[Link, str, str]]] = {}
    for k in links:
        unit = k.output.unit or k.input.unit or UNITLESS
        if (k.output.unit is None) != (k.input.unit is None) and unit.exponents and k.output.type == k.input.type:
            bare, variable = (k.source, k.output.name) if k.output.unit is None else (k.target, k.input.name)
            found.setdefault(names[bare], []).append((k, variable, unit.name))
    warnings = []
    for name, group in found.items():
        if len(group) > SINGLY:
            listed = ", ".join(f"{variable} ({unit})" for _, variable, unit in group[:LISTED])
            more = f", ... ({len(group)} connections)" if len(group) > LISTED else ""
            warnings.append(f"{name}: no unit where the other end has one, values unchanged: {listed}{more}")
            continue
        warnings += [
            f"{names[k.source]}.{k.output.name} -> {names[k.target]}.{k.input.name}: only one end has a unit"
            f" ('{unit}'); the value is passed unchanged"
            for k, _, unit in group
        ]
    return warnings


def _start_value(component: ComponentInstance, variable: FmuVariable, given: StartValue, version: str) -> Value:
    """The value in the FMU's unit and type, within its bounds."""
    where = f"{component.name}.{variable.name} = {given.value}"
    chosen = variable.initial in ("exact", "approx") and variable.causality != "structuralParameter"
    settable = variable.causality in ("parameter", "input") or chosen
    if not settable or variable.variability == "constant":
        raise CosimError(f"{where}: is {variable.causality} and cannot be set; set a parameter")
    value = _typed(where, variable, given.value)
    if isinstance(value, (bool, str)):
        return value
    if isinstance(value, int) and version == "2.0" and not -(2**31) <= value < 2**31:
        raise CosimError(f"{where}: does not fit an FMI integer of 32 bits")
    if isinstance(value, int) and abs(value) > 2**53:
        raise CosimError(f"{where}: has more than 53 bits, so that it would not pass as it is; give a smaller one")
    if given.unit is not None and variable.unit is not None:
        try:
            factor, offset = conversion(given.unit, variable.unit)
        except ValueError as error:
            raise CosimError(f"{where}: unit {error}") from error
        value = factor * value + offset
    elif given.unit is not None and given.unit.exponents:
        raise CosimError(f"{where} {given.unit.name}: the FMU declares no unit for it; give the value without unit")
    if isinstance(value, float):
        value = given.factor * value + given.offset
    elif (given.factor, given.offset) != (1.0, 0.0):
        raise CosimError(f"{where}: an integer takes no factor or offset")
    if not math.isfinite(value):
        raise CosimError(f"{where}: is not finite")
    unit = f" {variable.unit.name}" if variable.unit else ""
    if variable.min is not None and value < variable.min:
        raise CosimError(f"{where}: {value:g}{unit} is below its minimum {variable.min:g}")
    if variable.max is not None and value > variable.max:
        raise CosimError(f"{where}: {value:g}{unit} is above its maximum {variable.max:g}")
    return value


def _typed(where: str, variable: FmuVariable, value: Value) -> Value:
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if isinstance(value, int) and abs(value) >= 2**63:
        raise CosimError(f"{variable.name}: an integer of {len(str(value))} digits is no value that can be set")
    if variable.type == "Real" and number:
        return float(value)
    if variable.type in ("Integer", "Enumeration") and number and math.isfinite(float(value)) and value == int(value):
        return int(value)
    if variable.type == "Boolean" and (isinstance(value, bool) or value in (0, 1)):
        return bool(value)
    if variable.type == "String" and isinstance(value, str):
        return value
    raise CosimError(f"{where}: is no {variable.type}; give a value of that type")
