"""Systems written as SSP: a structure description (.ssd), or a package (.ssp) with all that it takes to run."""

from __future__ import annotations

import zipfile
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, TypeGuard
from urllib.parse import quote

from lxml import etree

from cosim.archive import entry_names, folded, safe_name
from cosim.checks import CheckedSystem, Link, by_elements, check
from cosim.errors import CosimError
from cosim.fmu import Fmu, FmuVariable, Value, read_fmu
from cosim.resources import finds_resources, with_resources
from cosim.run import RunSettings
from cosim.ssp import PORTS, RUN, STRUCTURE
from cosim.system import ComponentInstance, Port, System
from fmus_src.units import Unit

Version = Literal["1.0", "2.0"]
VERSIONS: tuple[Version, ...] = ("1.0", "2.0")
# SSP 2.0 has kept the namespaces of 1.0
_SSP = "http://ssp-standard.org/SSP1/SystemStructure"
_SSD, _SSC, _SSV, _SSM = (f"{_SSP}{kind}" for kind in ("Description", "Common", "ParameterValues", "ParameterMapping"))
_OSP = "http://opensimulationplatform.com/SSP/OSPAnnotations"
PARAMETERS = "parameters"  # the name of every parameter set: Ecos applies those of one name only
_EPOCH = (1980, 1, 1, 0, 0, 0)  # the same system gives the same bytes


def write_ssd(system: System, path: Path) -> Path:
    """Write a system; sources are `resources/NAME.fmu`, connectors are those connected."""
    sources = {c.name: f"resources/{c.fmu.name}" for c in system.components}
    root = _structure(system, path.stem, sources, "1.0")
    etree.SubElement(root, f"{{{_SSD}}}DefaultExperiment", startTime="0.0")
    path.write_bytes(_text(root))
    return path


def write_package(
    system: System, settings: RunSettings, path: Path, version: Version = "1.0", *, mappings: bool = True
) -> Path:
    """Write a system as a package: structure, FMUs, parameter sets and the files that parameters name.

    Each component that has start values gets a parameter set `resources/COMPONENT.ssv`, in the FMU's units and by the
    system's names; where its FMU has other names, `resources/COMPONENT.ssm` maps them. Connections carry their
    conversion of units as a factor, since some tools do not convert. Files named by text parameters are put into the
    resources/ of the FMU itself if it looks for them there, else into the package's, and named without folder.

    Args:
        mappings: if not, parameter sets go by the FMUs' own names, for tools that read no `.ssm`.

    Raises:
        CosimError: the system cannot run, or the file exists or cannot be written.
    """
    if version not in VERSIONS:
        raise CosimError(f"SSP {version}: there are {' and '.join(VERSIONS)}")
    if path.exists():
        raise CosimError(f"{path}: exists; choose another name (nothing is overwritten)")
    system = by_elements(system)
    checked = check(system)
    if version == "1.0":
        _refuse_arrays(system)
    content = _Content()
    sources = {c.name: content.file(c.fmu, c.name) for c in system.components}
    root = _structure(system, path.stem, sources, version, checked.links)
    elements = root.iterfind(f".//{{{_SSD}}}Component")
    for element, component, start in zip(elements, system.components, checked.start, strict=True):
        if start:
            _bind(element, component, start, content, version, mappings)
    root.append(_experiment(settings, checked))
    content.entries[STRUCTURE] = _text(root)
    scratch = path.with_name(f"{path.name}.part")
    try:
        content.pack(scratch)
        scratch.replace(path)
    except OSError as error:
        raise CosimError(f"{path}: cannot be written ({error.strerror or error}); choose another place") from error
    finally:
        scratch.unlink(missing_ok=True)
    return path


class _Content:
    """What goes into a package: texts, and files under names that no other has."""

    def __init__(self) -> None:
        self.entries: dict[str, bytes | Path] = {}
        self._names: dict[Path, str] = {}
        self._brought: dict[Path, dict[str, Path]] = {}  # files in the resources of an FMU, by folded name

    def named_file(self, text: str, fmu: Path, owner: str) -> str:
        """What a text parameter is to say in the package; a file that it names is put where the FMU finds it."""
        if not text or not _is_file(text):
            return text
        if not finds_resources(fmu):
            return self.file(Path(text), owner).removeprefix("resources/")
        if f"resources/{text}" in entry_names(fmu):  # the FMU takes its own
            return text
        place, brought = Path(text).resolve(), self._brought.setdefault(fmu.resolve(), {})
        known = next((n for n, p in brought.items() if p == place), None)
        if known is None:
            taken = {folded(n.removeprefix("resources/")) for n in (*entry_names(fmu), *brought)}
            known = _free(place.name, owner, taken)
            brought[known] = place
        return known

    def file(self, path: Path, owner: str) -> str:
        """Name within the package of a file; one that several use is put there once."""
        place = path.resolve()
        if place not in self._names:
            self._names[place] = self.free(path.name, owner)
            self.entries[self._names[place]] = place
        return self._names[place]

    def free(self, name: str, owner: str) -> str:
        """A free name in resources/, with the owner's before it if need be."""
        return "resources/" + _free(name, owner, {folded(n.removeprefix("resources/")) for n in self.entries})

    def pack(self, path: Path) -> None:
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as package:
            for name, content in sorted(self.entries.items(), key=lambda item: (item[0] != STRUCTURE, item[0])):
                info = zipfile.ZipInfo(name, _EPOCH)
                packed_already = name.endswith(".fmu")
                info.compress_type = zipfile.ZIP_STORED if packed_already else zipfile.ZIP_DEFLATED
                package.writestr(info, self._bytes(content))

    def _bytes(self, content: bytes | Path) -> bytes:
        if isinstance(content, bytes):
            return content
        brought = self._brought.get(content)
        return with_resources(content, brought) if brought else content.read_bytes()


def _free(name: str, owner: str, taken: Collection[str]) -> str:
    """A name that any system can unpack and that is not taken (folded names), the owner's before it if need be."""
    tries = (name, f"{owner}-{name}", *(f"{i}-{owner}-{name}" for i in range(2, len(taken) + 3)))
    return next(n for n in map(safe_name, tries) if folded(n) not in taken)


def _structure(
    system: System, name: str, sources: Mapping[str, str], version: Version, links: Sequence[Link] = ()
) -> Any:
    """The root element; `links` are the checked connections, whose conversions are then written as factors."""
    root = etree.Element(
        f"{{{_SSD}}}SystemStructureDescription", {"version": version, "name": name}, nsmap={"ssd": _SSD, "ssc": _SSC}
    )
    element = etree.SubElement(root, f"{{{_SSD}}}System", name=name)
    elements = etree.SubElement(element, f"{{{_SSD}}}Elements")
    units: dict[str, Unit] = {}
    for component in system.components:
        source = quote(sources[component.name])
        item = etree.SubElement(elements, f"{{{_SSD}}}Component", name=component.name, source=source)
        used = _connectors(system, component)
        connectors = etree.SubElement(item, f"{{{_SSD}}}Connectors") if used else None  # the schema wants one at least
        for name, (variable, kind, shape) in used.items():
            connector = etree.SubElement(connectors, f"{{{_SSD}}}Connector", name=name, kind=kind)
            typed = etree.SubElement(connector, f"{{{_SSC}}}{_type(variable)}")
            if _defined(variable.unit):
                typed.set("unit", variable.unit.name)
                units[variable.unit.name] = variable.unit
            _write_shape(connector, shape)
    connections = etree.SubElement(element, f"{{{_SSD}}}Connections") if system.connections else None
    for i, c in enumerate(system.connections):
        start, end = _end(system, c.source, c.output, "start"), _end(system, c.target, c.input, "end")
        written = etree.SubElement(connections, f"{{{_SSD}}}Connection", start | end)
        if links and (links[i].factor, links[i].offset) != (1.0, 0.0):
            written.set("suppressUnitConversion", "true")
            etree.SubElement(written, f"{{{_SSC}}}LinearTransformation", factor=repr(links[i].factor),
                             offset=repr(links[i].offset))  # fmt: skip
    _write_ports(element, system.ports)
    _write_units(root, units, _SSD)
    return root


def _bind(
    element: Any,
    component: ComponentInstance,
    start: Mapping[str, Value],
    content: _Content,
    version: Version,
    mappings: bool,
) -> None:
    """Add a component's parameter set, and its mapping where the FMU has other names than the system."""
    public = {m.name: name for name, m in component.mapped.items() if m.name in start and mappings}
    renamed = any(name != fmu_name for fmu_name, name in public.items())
    names = {n: public.get(n, n) for n in start}
    if len(set(names.values())) < len(names):  # the FMU has, for something else, a name that the system uses too
        names, renamed = {n: n for n in start}, False
    fmu = read_fmu(component.fmu)
    values, shapes = _whole(fmu, start)
    names = {n: names.get(n, n) for n in values}
    ssv = content.free(f"{component.name}.ssv", component.name)
    content.entries[ssv] = _parameter_set(
        PARAMETERS, {names[n]: v for n, v in values.items()}, shapes, version,
        lambda text: content.named_file(text, component.fmu, component.name),
    )  # fmt: skip
    parent = etree.SubElement(element, f"{{{_SSD}}}ParameterBindings")
    binding = etree.SubElement(parent, f"{{{_SSD}}}ParameterBinding", source=quote(ssv))
    if renamed:
        ssm = content.free(f"{component.name}.ssm", component.name)
        mapping = etree.Element(f"{{{_SSM}}}ParameterMapping", {"version": version}, nsmap={"ssm": _SSM, "ssc": _SSC})
        for fmu_name, name in names.items():
            etree.SubElement(mapping, f"{{{_SSM}}}MappingEntry", source=name, target=fmu_name)
        content.entries[ssm] = _text(mapping)
        etree.SubElement(binding, f"{{{_SSD}}}ParameterMapping", source=quote(ssm))


def _whole(
    fmu: Fmu, start: Mapping[str, Value]
) -> tuple[dict[str, tuple[FmuVariable, list[Value]]], dict[str, tuple[int, ...]]]:
    """Start values by variable; arrays, of which any element is given, whole and with their shapes."""
    values, shapes = dict[str, tuple[FmuVariable, list[Value]]](), dict[str, tuple[int, ...]]()
    for name, value in start.items():
        variable, found = fmu.variables[name], fmu.array_of(name)
        whole, array = found or (name, None)
        if array is not None and whole not in values:
            as_type = {"Real": float, "Boolean": bool}.get(variable.type, int)
            values[whole], shapes[whole] = (variable, [as_type(x) for x in array.start]), array.shape
        values.setdefault(whole, (variable, [value]))[1][variable.reference - array.first if array else 0] = value
    return values, shapes


def _parameter_set(
    name: str,
    values: Mapping[str, tuple[FmuVariable, Sequence[Value]]],
    shapes: Mapping[str, Sequence[int]],
    version: Version,
    packed: Callable[[str], str],
) -> bytes:
    """The text of a parameter set; `packed` puts the file that a text names, if any, into the package."""
    root = etree.Element(
        f"{{{_SSV}}}ParameterSet", {"version": version, "name": name}, nsmap={"ssv": _SSV, "ssc": _SSC}
    )
    parameters, units = etree.SubElement(root, f"{{{_SSV}}}Parameters"), dict[str, Unit]()
    for parameter, (variable, own) in values.items():
        element = etree.SubElement(parameters, f"{{{_SSV}}}Parameter", name=parameter)
        text = " ".join(packed(v) if isinstance(v, str) else _number(v) for v in own)
        typed = etree.SubElement(element, f"{{{_SSV}}}{_type(variable)}", value=text)
        _write_shape(element, shapes.get(parameter, ()))
        if _defined(variable.unit):
            typed.set("unit", variable.unit.name)
            units[variable.unit.name] = variable.unit
    _write_units(root, units, _SSV)
    return _text(root)


def _experiment(settings: RunSettings, checked: CheckedSystem) -> Any:
    """Times, and as annotations what SSP has no place for: step and channels for us, step for libcosim."""
    times = {"startTime": repr(settings.start), "stopTime": repr(settings.stop)}
    element = etree.Element(f"{{{_SSD}}}DefaultExperiment", times)
    annotations = etree.SubElement(element, f"{{{_SSD}}}Annotations")
    ours = etree.SubElement(annotations, f"{{{_SSC}}}Annotation", type=RUN)
    run = etree.SubElement(ours, "Run", step=repr(settings.step), transient=repr(settings.transient),
                           recordEvery=str(settings.decimation))  # fmt: skip
    for channel in settings.channels:
        owner = next((k for k, n in enumerate(checked.names) if channel.variable.startswith(f"{n}.")), None)
        if owner is None:
            continue
        variable = channel.variable[len(checked.names[owner]) + 1 :]
        mapped = checked.mapped[owner].get(variable)
        if (mapped and (mapped.factor, mapped.offset) != (1.0, 0.0)) or (
            (name := mapped.name if mapped else variable) not in checked.fmus[owner].variables
        ):
            continue
        about = {"name": channel.name, "variable": f"{checked.names[owner]}.{name}"}
        about |= {"unit": channel.unit} if channel.unit is not None else {}
        etree.SubElement(run, "Output", about | ({"description": channel.description} if channel.description else {}))
    theirs = etree.SubElement(
        annotations, f"{{{_SSC}}}Annotation", {"type": "com.opensimulationplatform"}, nsmap={"osp": _OSP}
    )
    algorithm = etree.SubElement(theirs, f"{{{_OSP}}}Algorithm")  # libcosim takes no attribute here, xmlns neither
    etree.SubElement(algorithm, f"{{{_OSP}}}FixedStepAlgorithm", baseStepSize=repr(settings.step))
    return element


def _write_ports(parent: Any, ports: Sequence[Port]) -> None:
    if not ports:
        return
    annotations = etree.SubElement(parent, f"{{{_SSD}}}Annotations")
    annotation = etree.SubElement(annotations, f"{{{_SSC}}}Annotation", type=PORTS)
    listed = etree.SubElement(annotation, "Ports")  # an annotation holds one element
    for port in ports:
        element = etree.SubElement(listed, "Port", name=port.name, component=port.component)
        for effort, flow, position in port.pairs:
            etree.SubElement(element, "Pair", effort=effort, flow=flow, **({"position": position} if position else {}))


def _connectors(system: System, component: ComponentInstance) -> dict[str, tuple[FmuVariable, str, tuple[int, ...]]]:
    """What is connected of a component, by name: a variable, or an array with one of its elements; kind, shape."""
    name, fmu = component.name, read_fmu(component.fmu)
    used = dict[str, tuple[FmuVariable, str, tuple[int, ...]]]()
    taken = {c.input for c in system.connections if c.target == name}
    given = {c.output for c in system.connections if c.source == name}
    for variable in fmu.variables.values():
        if variable.name in taken | given:
            whole, array = fmu.array_of(variable.name) or (variable.name, None)
            used[whole] = (variable, "input" if variable.name in taken else "output", array.shape if array else ())
    return used


def _end(system: System, component: str, variable: str, side: str) -> dict[str, str]:
    """Attributes of a connection's end; elements of arrays are told by indices, from one."""
    whole = read_fmu(system.component(component).fmu).array_of(variable)
    named = {f"{side}Element": component, f"{side}Connector": whole[0] if whole else variable}
    indices = variable[variable.rindex("[") + 1 :].rstrip("])").replace(",", " ") if whole else ""
    return named | ({f"{side}Indices": indices} if whole else {})


def _write_shape(parent: Any, shape: Sequence[int]) -> None:
    for size in shape:
        etree.SubElement(parent, f"{{{_SSC}}}Dimension", size=str(size))


def _refuse_arrays(system: System) -> None:
    for c in system.connections:
        for owner, variable in ((c.source, c.output), (c.target, c.input)):
            fmu = read_fmu(system.component(owner).fmu)
            if fmu.array_of(variable):
                raise CosimError(f"{owner}: {variable} is of an array (FMI 3.0), which SSP 1.0 cannot connect; use 2.0")


def _write_units(root: Any, units: Mapping[str, Unit], namespace: str) -> None:
    if not units:
        return
    parent = etree.SubElement(root, f"{{{namespace}}}Units")
    for name in sorted(units):
        element = etree.SubElement(parent, f"{{{_SSC}}}Unit", name=name)
        base = {b: str(e) for b, e in units[name].exponents}
        if units[name].factor != 1.0:
            base["factor"] = repr(units[name].factor)
        if units[name].offset:
            base["offset"] = repr(units[name].offset)
        etree.SubElement(element, f"{{{_SSC}}}BaseUnit", base)


def _defined(unit: Unit | None) -> TypeGuard[Unit]:
    """Whether a unit can be written; one without definition stands for itself only."""
    return unit is not None and {b for b, _ in unit.exponents} <= {"kg", "m", "s", "A", "K", "mol", "cd", "rad"}


def _number(value: float | bool) -> str:
    return str(value).lower() if isinstance(value, bool) else repr(value)


def _type(variable: FmuVariable) -> str:
    return "Integer" if variable.type == "Enumeration" else variable.type


def _is_file(text: str) -> bool:
    try:
        return Path(text).is_file()
    except (OSError, ValueError):
        return False


def _text(root: Any) -> bytes:
    etree.indent(root)
    return bytes(etree.tostring(root, xml_declaration=True, encoding="UTF-8")) + b"\n"
