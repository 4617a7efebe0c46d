"""`modelDescription.xml` of FMI 2.0, for Co-Simulation and Model Exchange."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version
from xml.etree import ElementTree as ET

from fmus_src.component import Component
from fmus_src.export.exported import Exported, Exports
from fmus_src.units import Unit, conversion, unit
from fmus_src.variable import Variable


def tool_version() -> str:
    """Version of the installed distribution."""
    try:
        return version("fowt-cosim")
    except PackageNotFoundError:
        return "0+uninstalled"


def model_description(exports: Exports, guid: str, sources: tuple[str, ...]) -> str:
    """The XML text; the value references are positions in the runtime's variable table."""
    component = exports.equations.component
    root = ET.Element("fmiModelDescription", {
        "fmiVersion": "2.0",
        "modelName": component.name,
        "guid": guid,
        "description": component.description,
        **origin(component),
        "variableNamingConvention": "structured",
        "numberOfEventIndicators": str(len(exports.equations.switch_positions())),
    })  # fmt: skip
    common = {
        "modelIdentifier": component.name,
        "needsExecutionTool": "false",
        "canBeInstantiatedOnlyOncePerProcess": "false",
        "canNotUseMemoryManagementFunctions": "true",
        "canGetAndSetFMUstate": "true",
        "canSerializeFMUstate": "true",
        "providesDirectionalDerivative": "true" if component.directional_derivatives else "false",
    }
    exchange = ET.SubElement(root, "ModelExchange", common | {"completedIntegratorStepNotNeeded": "false"})
    cosimulation = ET.SubElement(root, "CoSimulation", common | {
        "canHandleVariableCommunicationStepSize": "true",
        "canInterpolateInputs": "true",
        "maxOutputDerivativeOrder": "0",
        "canRunAsynchronuously": "false",
    })  # fmt: skip
    for interface in (exchange, cosimulation):
        files = ET.SubElement(interface, "SourceFiles")
        for name in sources:
            ET.SubElement(files, "File", {"name": name})
    unit_definitions(ET.SubElement(root, "UnitDefinitions"), [e for e in exports.all if e.role != "time"])
    categories = ET.SubElement(root, "LogCategories")
    ET.SubElement(categories, "Category", {"name": "logStatusError", "description": "errors"})
    ET.SubElement(root, "DefaultExperiment", default_experiment(component))
    index = _variables(ET.SubElement(root, "ModelVariables"), exports)
    _structure(ET.SubElement(root, "ModelStructure"), exports, index)
    return to_text(root)


def origin(component: Component) -> dict[str, str]:
    """Attributes of both versions of FMI: whose model it is, under what licence, made by what."""
    given = {"author": component.author, "copyright": component.copyright, "license": component.license}
    stated = {name: text for name, text in given.items() if text}
    return {"version": tool_version(), **stated, "generationTool": f"fowt-cosim {tool_version()}"}


def default_experiment(component: Component) -> dict[str, str]:
    """What a tool runs if it is not told otherwise; many would stop at 1 s.

    60 s are five periods of the platform's pitch; the tolerance is for the importer's solver (model exchange).
    """
    return {"startTime": "0", "stopTime": "60", "tolerance": "1e-6", "stepSize": repr(component.internal_step)}


def to_text(root: ET.Element) -> str:
    """The document, indented."""
    ET.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"


def unit_definitions(parent: ET.Element, variables: list[Exported]) -> None:
    """The units of variables, each with its display units."""
    shown: dict[str, set[str]] = {}
    for v in (e.variable for e in variables if e.variable.kind == "real"):
        shown.setdefault(v.unit, set()).update({v.display_unit} if v.display_unit else set())
    for name in sorted(shown):
        base = unit(name)
        element = ET.SubElement(parent, "Unit", {"name": name})
        ET.SubElement(element, "BaseUnit", _base_unit(base))
        for display in sorted(shown[name]):
            factor, offset = conversion(base, unit(display))
            attributes = {"name": display, "factor": repr(factor)} | ({"offset": repr(offset)} if offset else {})
            ET.SubElement(element, "DisplayUnit", attributes)


def _base_unit(u: Unit) -> dict[str, str]:
    attributes = {base: str(exponent) for base, exponent in u.exponents}
    if u.factor != 1.0:
        attributes["factor"] = repr(u.factor)
    if u.offset != 0.0:
        attributes["offset"] = repr(u.offset)
    return attributes


def details(v: Variable) -> dict[str, str]:
    """Attributes of a number: bounds, unit, display unit, nominal value."""
    found = {key: number(v, value) for key, value in (("min", v.min), ("max", v.max)) if value is not None}
    if v.kind == "real":
        found["unit"] = v.unit
        if v.display_unit:
            found["displayUnit"] = v.display_unit
        if v.nominal is not None:
            found["nominal"] = repr(v.nominal)
    return found


def number(v: Variable, value: float) -> str:
    """A value as its type is written."""
    if v.kind == "boolean":
        return "true" if value else "false"
    return str(int(value)) if v.kind == "integer" else repr(float(value))


def _variables(parent: ET.Element, exports: Exports) -> dict[int, int]:
    """Write the scalar variables; returns the index (from 1) of each reference."""
    index: dict[int, int] = {}
    numeric = exports.of("parameter", "calculated", "input", "output", "state", "sampled_state", "rate")
    for e in numeric:
        for i, name in enumerate(e.element_names()):
            index[e.reference + i] = len(index) + 1
            _scalar(parent, e, name, i, index)
    for i, e in enumerate(exports.of("string")):
        attributes = _attributes(e, e.variable.name, i, "fixed")
        ET.SubElement(ET.SubElement(parent, "ScalarVariable", attributes), "String", {"start": e.variable.text})
    return index


def _attributes(e: Exported, name: str, reference: int, variability: str) -> dict[str, str]:
    attributes = {
        "name": name,
        "valueReference": str(reference),
        "description": e.variable.description,
        "causality": e.causality,
        "variability": variability,
    }
    return attributes | ({"initial": e.initial} if e.initial else {})


def _scalar(parent: ET.Element, e: Exported, name: str, i: int, index: dict[int, int]) -> None:
    v = e.variable
    attributes = _attributes(e, name, e.reference + i, e.element_variabilities[i])
    start = {"start": number(v, v.start[i])} if e.has_start else {}
    kind = {"real": "Real", "integer": "Integer", "boolean": "Boolean"}[v.kind]
    given = start if v.kind == "boolean" else details(v) | start
    if e.state is not None:
        given["derivative"] = str(index[e.state + i])
    ET.SubElement(ET.SubElement(parent, "ScalarVariable", attributes), kind, given)


def _structure(parent: ET.Element, exports: Exports, index: dict[int, int]) -> None:
    knowns = [index.get(e.reference + i) for e, i in exports.knowns()]  # time has none
    for tag, role in (("Outputs", "output"), ("Derivatives", "rate")):
        places = [index[e.reference + i] for e in exports.of(role) for i in range(e.variable.size)]  # type: ignore[arg-type]
        element = ET.SubElement(parent, tag) if places else None
        for place, row in zip(places, exports.dependencies[role], strict=True):
            depends = " ".join(str(k) for k, used in zip(knowns, row, strict=True) if used and k)
            ET.SubElement(element, "Unknown", {"index": str(place), "dependencies": depends})  # type: ignore[arg-type]
    initial = exports.of("output", "calculated", "state", "rate")
    if initial:
        element = ET.SubElement(parent, "InitialUnknowns")
        # At the start they may depend on any parameter: dependencies are left out, which FMI reads as "all".
        for place in sorted(index[e.reference + i] for e in initial for i in range(e.variable.size)):
            ET.SubElement(element, "Unknown", {"index": str(place)})
