"""System structures from SSP 1.0 and 2.0: a .ssd with what it names, or a package (.ssp) of all that.

Read: components with FMU sources, nested systems (flattened: components are then named `inner.component`), connections
with linear transformations, parameter sets and mappings inline or in files, units, the systems' own connectors.
Refused in one line: other transformations, signal dictionaries, model exchange, sources outside the package, DTDs.
Parsed here because the available readers drop transformations (pyssp_standard) or parameter bindings (fmpy)
without a word.
"""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from cosim.archive import extract
from cosim.errors import CosimError
from cosim.recording import Channel
from cosim.ssp_parameters import (
    Origin,
    bindings,
    children,
    parse,
    read_mapping,
    read_parameters,
    tag_of,
    transformation,
    true,
    units_of,
)
from cosim.system import ComponentInstance, Connection, Port, StartValue, System, split_name, with_parameters
from fmus_src.units import Unit
from fmus_src.units import unit as named_unit

__all__ = ["PORTS", "RUN", "Structure", "read_mapping", "read_package", "read_parameters", "read_system"]

PORTS = "org.fowt-cosim.ports"  # type of the SSD annotation that lists mechanical ports
RUN = "org.fowt-cosim.run"  # and of the one that says how the system is run
STRUCTURE = "SystemStructure.ssd"
MOST = 2000  # components and systems in one structure
End = tuple[str, str]  # path of a component or system, connector


@dataclass(frozen=True)
class Structure:
    """A system with what its file says of how to run it.

    Attributes:
        start, stop, step: s; None where the file says nothing.
        outputs: what to record, from the system's own connectors and the annotation RUN.
    """

    system: System
    start: float | None = None
    stop: float | None = None
    step: float | None = None
    transient: float = 0.0
    record_every: int = 1
    outputs: tuple[Channel, ...] = ()


def read_system(ssd: Path, fmu_folders: Sequence[Path] = ()) -> System:
    """Read a system.

    Args:
        ssd: system structure description; its sources are relative to its folder.
        fmu_folders: where to find NAME.fmu when a component's source is not at its place.

    Raises:
        CosimError: a file is missing, is not SSP, or uses a part of SSP that is not supported.
    """
    return _read(Origin(ssd), fmu_folders).system


def read_package(ssp: Path, folder: Path) -> Structure:
    """Unpack a package into a folder and read its system.

    Raises:
        CosimError: it must not be unpacked, has no SystemStructure.ssd, or something within cannot be used.
    """
    extract(ssp, folder)
    if not (folder / STRUCTURE).is_file():
        raise CosimError(f"{ssp}: has no {STRUCTURE}; is it an SSP package?")
    try:
        found = _read(Origin(folder / STRUCTURE, folder))
    except CosimError as error:  # files by their names in the package, not by where they were unpacked
        raise CosimError(str(error).replace(f"{folder}{os.sep}", f"{ssp}{os.sep}")) from error
    others = sorted(p.name for p in folder.glob("*.ssd") if p.name != STRUCTURE)
    notes = [f"{ssp.name}: only {STRUCTURE} is used, not {', '.join(others)}"] if others else []
    return replace(found, system=replace(found.system, notes=(*found.system.notes, *notes)))


def _read(origin: Origin, folders: Sequence[Path] = ()) -> Structure:
    root = parse(origin, "SystemStructureDescription")
    top = root.find("{*}System")
    if top is None:
        raise CosimError(f"{origin.file}: has no System element")
    whole = _Whole(origin, folders, units_of(root, origin.file))
    whole.add(top, "")
    connections = whole.resolve()
    if not (root.get("version") or "").startswith(("1.", "2.")):
        whole.notes.append(f"{origin.file.name}: says version '{root.get('version')}'; is read as SSP 2.0")
    name = top.get("name") or origin.file.stem
    system = System(name, tuple(whole.components), connections, ports=_ports(top, origin.file))
    for path, values in whole.values:  # a set bound to a system takes precedence over those bound within
        system = with_parameters(system, whole.targets(path, values, {c.name for c in system.components}))
    system = replace(system, notes=tuple(whole.notes))
    return replace(_experiment(root, origin.file), system=system, outputs=(*whole.outputs(), *_listed(root)))


@dataclass
class _Whole:
    """What is found on the way through a system and those within it; "" is the path of the outermost one."""

    origin: Origin
    folders: Sequence[Path]
    units: dict[str, Unit]
    components: list[ComponentInstance] = field(default_factory=list)
    names: set[str] = field(default_factory=set)  # of the components
    systems: set[str] = field(default_factory=set)
    links: list[tuple[End, End, Connection]] = field(default_factory=list)
    values: list[tuple[str, dict[str, StartValue]]] = field(default_factory=list)
    connectors: dict[End, Unit | None] = field(default_factory=dict)
    parameters: set[End] = field(default_factory=set)  # those of the kind parameter
    notes: list[str] = field(default_factory=list)

    def add(self, system: Any, path: str) -> None:
        """Take in a system and those within it, depth first, so that outer parameter sets come later."""
        file = self.origin.file
        self.systems.add(path)
        self._add_connectors(system, path)
        for element in children(system.find("{*}Elements")):
            name, kind = element.get("name"), tag_of(element)
            full = f"{path}.{name}" if path else str(name)
            if not name:
                raise CosimError(f"{file}: a {kind} has no name")
            if full in self.systems or full in self.names:
                raise CosimError(f"{file}: component '{full}' appears twice; give each its own name")
            if len(self.names) + len(self.systems) > MOST:
                raise CosimError(f"{file}: has more than {MOST} components and systems; is that meant?")
            if kind == "System":
                self.add(element, full)
            elif kind == "Component":
                self.names.add(full)
                self._add_connectors(element, full)
                self.components.append(self._component(element, full))
            else:
                raise CosimError(f"{file}: {kind} '{full}' is not supported; use components and systems only")
        for element in children(system.find("{*}Connections")):
            self.links.append(self._link(element, path))
        for values, left in bindings(system, self.origin):
            self.values.append((path, values))
            self._note_left(path or "the system", left)

    def resolve(self) -> tuple[Connection, ...]:
        """Connections from component to component, through whatever systems lie between."""
        found = []
        for start, end, link in self.links:
            if end[0] in self.systems:
                if end[0] and end not in self._starting_at:
                    self.notes.append(
                        f"{self.origin.file.name}: the connection of {'.'.join(start)} to '{end[1]}' of {end[0]} leads"
                        " nowhere and is not used"
                    )
                continue
            if start[0] not in self.systems:
                found.append(link)
                continue
            chain = self._back(start, [link])
            if chain is None and start not in self.parameters:  # those pass on values of parameter sets
                self.notes.append(
                    f"{self.origin.file.name}: the connection of {'.'.join(end)} to the system's own connector"
                    f" '{start[1]}' is not used"
                )
            elif chain is not None:
                found.append(_joined(chain, self.origin.file))
        return tuple(found)

    def outputs(self) -> list[Channel]:
        """The outermost system's connectors that a component feeds."""
        found = []
        for start, end, link in self.links:
            if end[0]:
                continue
            chain = [link] if start[0] not in self.systems else self._back(start, [link])
            if chain is None:
                self.notes.append(f"{self.origin.file.name}: nothing feeds the system's own connector '{end[1]}'")
                continue
            if any((c.factor, c.offset) != (1.0, 0.0) for c in chain):
                self.notes.append(f"{self.origin.file.name}: '{end[1]}' is recorded without its transformation")
            unit = self.connectors.get(end)
            found.append(Channel(end[1], f"{chain[0].source}.{chain[0].output}", unit.name if unit else None))
        return found

    def targets(self, path: str, values: dict[str, StartValue], names: set[str]) -> dict[str, StartValue]:
        """Values by component.variable; one for a connector of a system goes to what that feeds."""
        found: dict[str, StartValue] = {}
        for name, value in values.items():
            full = f"{path}.{name}" if path else name
            ends = [(s, full[len(s) :].lstrip(".")) for s in self.systems if full.startswith(f"{s}." if s else "")]
            own = next((e for e in sorted(ends, reverse=True) if e in self.connectors), None)
            if own is None or any(full.startswith(f"{c}.") for c in names):
                split_name(full, names)  # names the mistake
                found[full] = value
            else:
                found |= {f"{owner}.{variable}": value for owner, variable in self._forward(own)}
        return found

    def _back(self, start: End, chain: list[Connection]) -> list[Connection] | None:
        """Connections from a component's output to where `chain` begins, or None if nothing feeds that."""
        seen = {start}
        while start[0] in self.systems:
            sources = self._ending_at.get(start, [])
            if len(sources) > 1:
                raise CosimError(f"{self.origin.file}: connector '{'.'.join(start)}' has two sources; keep one")
            if not sources:
                return None
            start, link = sources[0]
            if start in seen:
                raise CosimError(f"{self.origin.file}: connector '{'.'.join(start)}' feeds itself; give it an output")
            seen.add(start)
            chain = [link, *chain]
        return chain

    def _forward(self, start: End) -> list[End]:
        """Components' connectors that a system's connector feeds."""
        seen, waiting = {start}, [start]
        found: list[End] = []
        while waiting:
            here = waiting.pop()
            for end in self._starting_at.get(here, []):
                if end in seen:
                    continue
                seen.add(end)
                (waiting if end[0] in self.systems else found).append(end)
        return found

    @cached_property
    def _ending_at(self) -> dict[End, list[tuple[End, Connection]]]:
        found: dict[End, list[tuple[End, Connection]]] = {}
        for start, end, link in self.links:
            found.setdefault(end, []).append((start, link))
        return found

    @cached_property
    def _starting_at(self) -> dict[End, list[End]]:
        found: dict[End, list[End]] = {}
        for start, end, _ in self.links:
            found.setdefault(start, []).append(end)
        return found

    def _component(self, element: Any, name: str) -> ComponentInstance:
        file, source = self.origin.file, element.get("source")
        if not source:
            raise CosimError(f"{file}: component '{name}' has no source")
        kind = element.get("type", "application/x-fmu-sharedlibrary")
        if kind != "application/x-fmu-sharedlibrary" or element.get("implementation", "any") not in (
            "any",
            "CoSimulation",
        ):
            what = kind if kind != "application/x-fmu-sharedlibrary" else element.get("implementation")
            raise CosimError(f"{file}: component '{name}' is of the kind {what}; use FMUs for co-simulation")
        path = self.origin.locate(source)
        places = [path, *(f / path.name for f in self.folders)]
        found = next((p for p in places if p.is_file()), None)
        if found is None:
            looked = ", ".join(str(p.parent) for p in places)
            raise CosimError(f"component '{name}': {path.name} is not in {looked}; build it or name its folder")
        start: dict[str, StartValue] = {}
        for values, left in bindings(element, self.origin):
            start |= values
            self._note_left(name, left)
        return ComponentInstance(name, found, start)

    def _note_left(self, name: str, left: Sequence[str]) -> None:
        if left:
            self.notes.append(f"{name}: parameters that the mapping does not name are not used: {', '.join(left)}")

    def _add_connectors(self, element: Any, path: str) -> None:
        for connector in children(element.find("{*}Connectors")):
            name = next((t.get("unit") for t in children(connector) if t.get("unit")), None)
            end = path, connector.get("name") or ""
            self.connectors[end] = self._unit(name)
            if connector.get("kind") in ("parameter", "structuralParameter"):
                self.parameters.add(end)

    def _unit(self, name: str | None) -> Unit | None:
        if name is None or name in self.units:
            return self.units.get(name or "")
        try:
            return named_unit(name)
        except ValueError as error:
            raise CosimError(f"{self.origin.file}: {error}") from error

    def _link(self, element: Any, path: str) -> tuple[End, End, Connection]:
        ends: list[End] = []
        units: list[Unit | None] = []
        for side in ("start", "end"):
            name, connector = element.get(f"{side}Element"), element.get(f"{side}Connector")
            if not connector:
                raise CosimError(f"{self.origin.file}: a Connection has no {side}Connector")
            owner = path if name is None else f"{path}.{name}" if path else name
            indices = ",".join((element.get(f"{side}Indices") or "").split())  # from one, as Modelica's
            units.append(self.connectors.get((owner, connector)))
            ends.append((owner, f"{connector}[{indices}]" if indices else connector))
        start, end = ends
        factor, offset = transformation(element, f"{self.origin.file}: {'.'.join(start)}")
        convert = not true(element.get("suppressUnitConversion"))
        return start, end, Connection(*start, *end, factor, offset, convert, (units[0], units[1]))


def _joined(chain: Sequence[Connection], file: Path) -> Connection:
    """One connection for a chain of them."""
    first, last = chain[0], chain[-1]
    factor, offset = 1.0, 0.0
    for c in chain:
        factor, offset = c.factor * factor, c.factor * offset + c.offset
    if (offset and len(chain) > 1) or len({c.convert_units for c in chain}) > 1:
        raise CosimError(
            f"{file}: {first.source}.{first.output} -> {last.target}.{last.input} goes through systems with an offset"
            " or suppressed unit conversion on the way; transform it in one connection without units"
        )
    return Connection(
        first.source, first.output, last.target, last.input, factor, offset, first.convert_units,
        (first.units[0], last.units[1]),
    )  # fmt: skip


def _ports(system: Any, file: Path) -> tuple[Port, ...]:
    """Mechanical ports from the system's annotation of the type PORTS; FMI 2.0 has no terminals, SSP 1.0 no bonds."""
    ports = []
    for element in system.iterfind(f"{{*}}Annotations/{{*}}Annotation[@type='{PORTS}']/{{*}}Ports/{{*}}Port"):
        pairs = tuple((p.get("effort"), p.get("flow"), p.get("position", "")) for p in children(element))
        port = Port(element.get("name") or "", element.get("component") or "", pairs)
        if not (port.name and port.component and all(effort and flow for effort, flow, _ in pairs)):
            raise CosimError(f"{file}: a Port needs name, component and Pairs with effort and flow")
        ports.append(port)
    return tuple(ports)


def _experiment(root: Any, file: Path) -> Structure:
    """Times from DefaultExperiment, and what the annotation RUN or that of the Open Simulation Platform says."""
    default, run = root.find("{*}DefaultExperiment"), _run_annotation(root)
    other = root.find("{*}DefaultExperiment/{*}Annotations/{*}Annotation/{*}Algorithm/{*}FixedStepAlgorithm")

    def number(element: Any, name: str) -> float | None:
        text = None if element is None else element.get(name)
        try:
            value = None if text is None else float(text)
        except ValueError:
            value = math.nan
        if value is not None and not abs(value) < 1e9:
            raise CosimError(f"{file}: {name} = '{text}' is no usable number")
        return value

    step = number(run, "step")
    return Structure(
        System("", ()), number(default, "startTime"), number(default, "stopTime"),
        number(other, "baseStepSize") if step is None else step, number(run, "transient") or 0.0,
        int(number(run, "recordEvery") or 1),
    )  # fmt: skip


def _listed(root: Any) -> list[Channel]:
    run = _run_annotation(root)
    listed = [] if run is None else [c for c in children(run) if tag_of(c) == "Output"]
    made = [
        Channel(c.get("name") or "", c.get("variable") or "", c.get("unit"), c.get("description", "")) for c in listed
    ]
    return [o for o in made if o.name and o.variable]


def _run_annotation(root: Any) -> Any:
    return root.find(f"{{*}}DefaultExperiment/{{*}}Annotations/{{*}}Annotation[@type='{RUN}']/{{*}}Run")
