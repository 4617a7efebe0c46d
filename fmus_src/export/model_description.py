"""`modelDescription.xml` of FMI 2.0 Co-Simulation."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version
from xml.etree import ElementTree as ET

import casadi as ca
import numpy as np

from fmus_src.equations import Equations
from fmus_src.units import Unit, conversion, unit
from fmus_src.variable import Variable

_FMI_CAUSALITY = {
    "parameter": "parameter",
    "calculated": "calculatedParameter",
    "input": "input",
    "output": "output",
    "state": "local",
    "sampled_state": "local",
}


def tool_version() -> str:
    """Version of the installed distribution."""
    try:
        return version("fowt-cosim")
    except PackageNotFoundError:
        return "0+uninstalled"


def model_description(equations: Equations, guid: str, sources: tuple[str, ...]) -> str:
    """The XML text; the value references are positions in the runtime's variable table."""
    component = equations.component
    root = ET.Element("fmiModelDescription", {
        "fmiVersion": "2.0",
        "modelName": component.name,
        "guid": guid,
        "description": component.description,
        "version": tool_version(),
        "author": "fowt-cosim",
        "license": "MIT",
        "generationTool": f"fowt-cosim {tool_version()}",
        "variableNamingConvention": "structured",
        "numberOfEventIndicators": "0",
    })  # fmt: skip
    cosimulation = ET.SubElement(root, "CoSimulation", {
        "modelIdentifier": component.name,
        "needsExecutionTool": "false",
        "canHandleVariableCommunicationStepSize": "true",
        "canInterpolateInputs": "true",
        "maxOutputDerivativeOrder": "0",
        "canRunAsynchronuously": "false",
        "canBeInstantiatedOnlyOncePerProcess": "false",
        "canNotUseMemoryManagementFunctions": "false",
        "canGetAndSetFMUstate": "true",
        "canSerializeFMUstate": "true",
        "providesDirectionalDerivative": "true" if component.directional_derivatives else "false",
    })  # fmt: skip
    files = ET.SubElement(cosimulation, "SourceFiles")
    for name in sources:
        ET.SubElement(files, "File", {"name": name})
    _units(ET.SubElement(root, "UnitDefinitions"), equations)
    categories = ET.SubElement(root, "LogCategories")
    ET.SubElement(categories, "Category", {"name": "logStatusError", "description": "errors"})
    ET.SubElement(root, "DefaultExperiment", {"startTime": "0", "stepSize": repr(component.internal_step)})
    _variables(ET.SubElement(root, "ModelVariables"), equations)
    _structure(ET.SubElement(root, "ModelStructure"), equations)
    ET.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"


def _units(parent: ET.Element, equations: Equations) -> None:
    shown: dict[str, set[str]] = {}
    for v in equations.variables:
        if v.kind == "real":
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


def _variables(parent: ET.Element, equations: Equations) -> None:
    reference = 0
    tunable, discrete = _tunable_references(equations), _discrete_references(equations)
    for v in equations.variables:
        for name, start in zip(v.element_names(), v.start, strict=True):
            if not v.internal:
                _scalar(parent, v, name, reference, start, reference in tunable, reference in discrete)
            reference += 1
    for i, v in enumerate(equations.strings):
        attributes = _attributes(v, v.name, i) | {"variability": "fixed", "initial": "exact"}
        ET.SubElement(ET.SubElement(parent, "ScalarVariable", attributes), "String", {"start": v.text})


def _tunable_references(equations: Equations) -> set[int]:
    """References of tunable parameters and of the calculated parameters that follow them."""
    tunable = np.array([v.tunable for v in equations.of("parameter") for _ in range(v.size)], dtype=bool)
    follows = np.asarray(ca.DM(equations.calculate.jac_sparsity(0, 0), 1.0).full() != 0.0)[:, tunable].any(axis=1)
    return set(np.flatnonzero(np.concatenate([tunable, follows])).tolist())


def _discrete_references(equations: Equations) -> set[int]:
    """References of what changes at sample instants only: sampled states, and the outputs that follow them alone.

    An output of parameters only is among them: FMI has no better word for an output that never changes.
    """
    sizes = equations.sizes
    first_output = sizes["p"] + sizes["k"] + sizes["u"]
    outputs = np.flatnonzero(equations.discrete_outputs()) + first_output
    first_sampled = first_output + sizes["y"] + sizes["x"]
    return {*outputs.tolist(), *range(first_sampled, first_sampled + sizes["z"])}


def _attributes(v: Variable, name: str, reference: int) -> dict[str, str]:
    return {
        "name": name,
        "valueReference": str(reference),
        "description": v.description,
        "causality": _FMI_CAUSALITY[v.causality],
    }


def _scalar(
    parent: ET.Element, v: Variable, name: str, reference: int, start: float, tunable: bool, discrete: bool
) -> None:
    attributes = _attributes(v, name, reference)
    if v.causality == "parameter":
        attributes |= {"variability": "tunable" if tunable else "fixed", "initial": "exact"}
    elif v.causality == "calculated":
        attributes |= {"variability": "tunable" if tunable else "fixed", "initial": "calculated"}
    elif v.causality == "input":
        attributes["variability"] = "continuous"
    else:
        attributes |= {"variability": "discrete" if discrete else "continuous", "initial": "calculated"}
    element = ET.SubElement(parent, "ScalarVariable", attributes)
    has_start = v.causality in ("parameter", "input")
    if v.kind == "boolean":
        ET.SubElement(element, "Boolean", {"start": "true" if start else "false"})
        return
    details: dict[str, str] = {}
    for key, value in (("min", v.min), ("max", v.max)):
        if value is not None:
            details[key] = _number(v, value)
    if v.kind == "real":
        details["unit"] = v.unit
        if v.display_unit:
            details["displayUnit"] = v.display_unit
        if v.nominal is not None:
            details["nominal"] = repr(v.nominal)
    if has_start:
        details["start"] = _number(v, start)
    ET.SubElement(element, "Real" if v.kind == "real" else "Integer", details)


def _number(v: Variable, value: float) -> str:
    return str(int(value)) if v.kind == "integer" else repr(float(value))


def _structure(parent: ET.Element, equations: Equations) -> None:
    names = [(v.causality, n) for v in equations.variables if not v.internal for n in v.element_names()]
    first_input = next((i for i, (c, _) in enumerate(names) if c == "input"), 0) + 1
    outputs = [i + 1 for i, (c, _) in enumerate(names) if c == "output"]
    calculated = [i + 1 for i, (c, _) in enumerate(names) if c == "calculated"]
    depends = equations.output_dependencies()
    inputs_of = {
        index: " ".join(str(first_input + j) for j in row.nonzero()[0])
        for index, row in zip(outputs, depends, strict=True)
    }
    if outputs:
        element = ET.SubElement(parent, "Outputs")
        for index in outputs:
            ET.SubElement(element, "Unknown", {"index": str(index), "dependencies": inputs_of[index]})
    if outputs or calculated:
        element = ET.SubElement(parent, "InitialUnknowns")
        # Outputs at the start may depend on any parameter: dependencies are left out, which FMI reads as "all".
        for index in sorted(outputs + calculated):
            ET.SubElement(element, "Unknown", {"index": str(index)})
