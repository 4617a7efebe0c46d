"""System structure and parameter values from SSP 1.0 files (.ssd, .ssv).

Read: components with FMU sources, connections with linear transformations, parameter sets inline or in files, units.
Refused: nested systems, parameter mappings, value-mapping transformations, DTDs. Parsed here because the
available readers drop transformations (pyssp_standard) or parameter bindings (fmpy) without a word.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from lxml import etree

from cosim.errors import CosimError
from cosim.fmu import Value
from cosim.system import ComponentInstance, Connection, Port, StartValue, System, with_parameters
from fmus_src.units import Unit
from fmus_src.units import unit as named_unit

PORTS = "org.fowt-cosim.ports"  # type of the SSD annotation that lists mechanical ports


def read_system(ssd: Path, fmu_folders: Sequence[Path] = ()) -> System:
    """Read a system.

    Args:
        ssd: system structure description; its sources are relative to its folder.
        fmu_folders: where to find NAME.fmu when a component's source is not at its place.

    Raises:
        CosimError: a file is missing, is not SSP, or uses a part of SSP that is not supported.
    """
    root = _parse(ssd, "SystemStructureDescription")
    system = root.find("{*}System")
    if system is None:
        raise CosimError(f"{ssd}: has no System element")
    elements = _children(system.find("{*}Elements"))
    for element in elements:
        if _tag(element) != "Component":
            raise CosimError(f"{ssd}: {_tag(element)} '{element.get('name')}' is not supported; use components only")
    components = tuple(_component(e, ssd, fmu_folders) for e in elements)
    names = [c.name for c in components]
    for name in names:
        if names.count(name) > 1:
            raise CosimError(f"{ssd}: component '{name}' appears twice; give each its own name")
    connections, notes = [], []
    for element in _children(system.find("{*}Connections")):
        ends = [element.get("startElement"), element.get("endElement")]
        if None in ends:
            loose = ".".join(
                filter(None, (ends[0] or ends[1], element.get("startConnector" if ends[0] else "endConnector")))
            )
            notes.append(f"{ssd.name}: the connection of {loose} to the system's own connector is not used")
            continue
        connections.append(_connection(element, ssd))
    name = system.get("name") or ssd.stem
    result = System(name, components, tuple(connections), tuple(notes), ports=_ports(system, ssd))
    # a set bound to the system takes precedence over those bound to its components
    for values in _bindings(system, ssd):
        result = with_parameters(result, values)
    return result


def read_parameters(ssv: Path) -> dict[str, StartValue]:
    """Start values of a parameter set file, by name.

    Raises:
        CosimError: the file is missing or no parameter set.
    """
    return _parameter_set(_parse(ssv, "ParameterSet"), ssv)


def _component(element: Any, ssd: Path, folders: Sequence[Path]) -> ComponentInstance:
    name, source = element.get("name"), element.get("source")
    if not name or not source:
        raise CosimError(f"{ssd}: component '{name or '?'}' has no {'source' if name else 'name'}")
    path = ssd.parent / unquote(source)
    places = [path, *(f / path.name for f in folders)]
    found = next((p for p in places if p.is_file()), None)
    if found is None:
        looked = ", ".join(str(p.parent) for p in places)
        raise CosimError(f"component '{name}': {path.name} is not in {looked}; build it or name its folder")
    start: dict[str, StartValue] = {}
    for values in _bindings(element, ssd):
        start |= values
    return ComponentInstance(name, found, start)


def _connection(element: Any, ssd: Path) -> Connection:
    source, output, target, input_ = (
        str(element.get(a)) for a in ("startElement", "startConnector", "endElement", "endConnector")
    )
    factor, offset = 1.0, 0.0
    for child in _children(element):
        if _tag(child) == "LinearTransformation":
            factor, offset = float(child.get("factor", 1.0)), float(child.get("offset", 0.0))
        elif _tag(child).endswith("Transformation"):
            raise CosimError(f"{ssd}: {source}.{output}: {_tag(child)} is not supported; only LinearTransformation is")
    convert = element.get("suppressUnitConversion", "false") not in ("true", "1")
    return Connection(source, output, target, input_, factor, offset, convert)


def _ports(system: Any, ssd: Path) -> tuple[Port, ...]:
    """Mechanical ports from the system's annotation of the type PORTS; FMI 2.0 has no terminals, SSP 1.0 no bonds."""
    ports = []
    for element in system.iterfind(f"{{*}}Annotations/{{*}}Annotation[@type='{PORTS}']/{{*}}Ports/{{*}}Port"):
        pairs = tuple((p.get("effort"), p.get("flow"), p.get("position", "")) for p in _children(element))
        port = Port(element.get("name") or "", element.get("component") or "", pairs)
        if not (port.name and port.component and all(effort and flow for effort, flow, _ in pairs)):
            raise CosimError(f"{ssd}: a Port needs name, component and Pairs with effort and flow")
        ports.append(port)
    return tuple(ports)


def _bindings(element: Any, ssd: Path) -> Iterator[dict[str, StartValue]]:
    for binding in _children(element.find("{*}ParameterBindings")):
        if binding.find("{*}ParameterMapping") is not None:
            raise CosimError(f"{ssd}: ParameterMapping is not supported; name the parameters as in the FMU")
        if binding.get("sourceBase", "SSD") != "SSD":
            raise CosimError(f"{ssd}: sourceBase='component' is not supported; put the parameter set beside the .ssd")
        source, prefix = binding.get("source"), binding.get("prefix", "")
        if source is not None:
            values = read_parameters(ssd.parent / unquote(source))
        else:
            inline = binding.find("{*}ParameterValues/{*}ParameterSet")
            if inline is None:
                raise CosimError(f"{ssd}: a ParameterBinding has neither source nor ParameterValues")
            values = _parameter_set(inline, ssd)
        yield {prefix + name: value for name, value in values.items()}


def _parameter_set(element: Any, file: Path) -> dict[str, StartValue]:
    units = {u.get("name"): _unit(u, file) for u in element.iterfind("{*}Units/{*}Unit")}
    values: dict[str, StartValue] = {}
    for parameter in element.iterfind("{*}Parameters/{*}Parameter"):
        name, children = parameter.get("name"), _children(parameter)
        if not name or not children:
            raise CosimError(f"{file}: parameter '{name or '?'}' has no {'value' if name else 'name'}")
        text, unit = children[0].get("value", ""), children[0].get("unit")
        try:
            value = _value(_tag(children[0]), text, file)
            resolved = None if unit is None else units.get(unit) or named_unit(unit)
        except ValueError as error:
            raise CosimError(f"{file}: parameter '{name}' = '{text}': {error}") from error
        values[name] = StartValue(value, resolved)
    return values


def _value(kind: str, text: str, file: Path) -> Value:
    """A parameter's value; a String that names a file beside the parameter set becomes its full path."""
    if kind == "Real":
        return float(text)
    if kind == "Integer":
        return int(text)
    if kind == "Boolean" and text in ("true", "false", "1", "0"):
        return text in ("true", "1")
    if kind == "String":
        path = file.parent / text
        return str(path.resolve()) if text and path.is_file() else text
    raise ValueError(f"is no {kind} value that can be set here")


def _unit(element: Any, file: Path) -> Unit:
    base = element.find("{*}BaseUnit")
    name = element.get("name")
    if base is None:
        raise CosimError(f"{file}: unit '{name}' has no BaseUnit")
    exponents = {b: int(base.get(b, 0)) for b in ("kg", "m", "s", "A", "K", "mol", "cd", "rad")}
    kept = tuple(sorted((b, e) for b, e in exponents.items() if e))
    return Unit(name, float(base.get("factor", 1.0)), float(base.get("offset", 0.0)), kept)


def _parse(file: Path, expected: str) -> Any:
    parser = etree.XMLParser(resolve_entities=False, no_network=True, load_dtd=False, remove_comments=True)
    try:
        tree = etree.parse(str(file), parser)
    except (OSError, etree.XMLSyntaxError) as error:
        reason = "no such file" if not file.exists() else str(error)
        raise CosimError(f"{file}: cannot be read ({reason})") from error
    if tree.docinfo.internalDTD is not None:
        raise CosimError(f"{file}: declares a document type; remove it (entities are not read)")
    root = tree.getroot()
    if _tag(root) != expected:
        raise CosimError(f"{file}: is a {_tag(root)}, not a {expected}")
    return root


def _children(element: Any) -> list[Any]:
    return [] if element is None else [e for e in element if isinstance(e.tag, str)]


def _tag(element: Any) -> str:
    return str(etree.QName(element).localname)
