"""`modelDescription.xml` and `buildDescription.xml` of FMI 3.0, for Co-Simulation and Model Exchange."""

from __future__ import annotations

from xml.etree import ElementTree as ET

import numpy as np

from fmus_src.export.exported import Exported, Exports, Role
from fmus_src.export.model_description import default_experiment, details, number, origin, to_text, unit_definitions

VERSION = "3.0"
_TYPES = {"real": "Float64", "integer": "Int32", "boolean": "Boolean", "string": "String"}


def model_description3(exports: Exports, token: str) -> str:
    """The XML text; arrays are arrays, each of which has the value reference of its first element."""
    component = exports.equations.component
    root = ET.Element("fmiModelDescription", {
        "fmiVersion": VERSION,
        "modelName": component.name,
        "instantiationToken": token,
        "description": component.description,
        **origin(component),
        "variableNamingConvention": "structured",
    })  # fmt: skip
    common = {
        "modelIdentifier": component.name,
        "needsExecutionTool": "false",
        "canBeInstantiatedOnlyOncePerProcess": "false",
        "canGetAndSetFMUState": "true",
        "canSerializeFMUState": "true",
        "providesDirectionalDerivatives": "true" if component.directional_derivatives else "false",
        "providesAdjointDerivatives": "false",
        "providesPerElementDependencies": "false",
    }
    ET.SubElement(root, "ModelExchange", common | {"needsCompletedIntegratorStep": "true"})
    ET.SubElement(root, "CoSimulation", common | {
        "canHandleVariableCommunicationStepSize": "true",
        "maxOutputDerivativeOrder": "0",
        "providesIntermediateUpdate": "true",
        "hasEventMode": "false",
    })  # fmt: skip
    unit_definitions(ET.SubElement(root, "UnitDefinitions"), list(exports.all))
    categories = ET.SubElement(root, "LogCategories")
    ET.SubElement(categories, "Category", {"name": "logStatusError", "description": "errors"})
    ET.SubElement(root, "DefaultExperiment", default_experiment(component))
    variables = ET.SubElement(root, "ModelVariables")
    for e in exports.all:
        if not e.variable.internal:
            _variable(variables, e)
    _structure(ET.SubElement(root, "ModelStructure"), exports)
    return to_text(root)


def build_description(identifier: str, sources: tuple[str, ...]) -> str:
    """`sources/buildDescription.xml`."""
    root = ET.Element("fmiBuildDescription", {"fmiVersion": VERSION})
    configuration = ET.SubElement(root, "BuildConfiguration", {"modelIdentifier": identifier})
    files = ET.SubElement(configuration, "SourceFileSet")
    for name in sources:
        ET.SubElement(files, "SourceFile", {"name": name})
    return to_text(root)


def _variable(parent: ET.Element, e: Exported) -> None:
    v = e.variable
    attributes = {"name": v.name, "valueReference": str(e.reference), "description": v.description}
    attributes |= {"causality": e.causality, "variability": e.variability}
    if e.initial:
        attributes["initial"] = e.initial
    if v.kind not in ("string", "boolean"):
        attributes |= details(v)
    if e.has_start and v.kind != "string":
        attributes["start"] = " ".join(number(v, x) for x in v.start)
    if e.role == "input" and v.kind == "real" and e.variability == "continuous":
        attributes["intermediateUpdate"] = "true"
    if e.state is not None:
        attributes["derivative"] = str(e.state)
    element = ET.SubElement(parent, _TYPES[v.kind], attributes)
    for length in v.shape:
        ET.SubElement(element, "Dimension", {"start": str(length)})
    if v.kind == "string":
        ET.SubElement(element, "Start", {"value": v.text})


def _structure(parent: ET.Element, exports: Exports) -> None:
    def unknowns(tag: str, role: Role) -> None:
        rows, first = exports.dependencies[role], 0
        for e in exports.of(role):
            used = np.any(rows[first : first + e.variable.size], axis=0)
            first += e.variable.size
            references = dict.fromkeys(
                k.reference for (k, _), u in zip(exports.knowns(), used.tolist(), strict=True) if u
            )
            depends = " ".join(str(r) for r in references)
            ET.SubElement(parent, tag, {"valueReference": str(e.reference), "dependencies": depends})

    unknowns("Output", "output")
    unknowns("ContinuousStateDerivative", "rate")
    # At the start they may depend on any parameter: dependencies are left out, which FMI reads as "all".
    for e in exports.of("calculated", "output", "state", "rate"):
        ET.SubElement(parent, "InitialUnknown", {"valueReference": str(e.reference)})
    unknowns("EventIndicator", "indicator")
