"""`terminalsAndIcons/terminalsAndIcons.xml` of FMI 3.0: a terminal for each mechanical port.

A port is where two bodies touch: one gives the motion, the other the force. Members are named by their quantity, so
that by the matching rule "bus" two terminals connect what they have in common: the port `hydro` of the barge (takes
force, gives the platform's motion) and the port `platform` of the hydrodynamics (the other way round).
"""

from __future__ import annotations

from dataclasses import dataclass
from xml.etree import ElementTree as ET

from fmus_src.equations import Equations
from fmus_src.export.model_description import to_text
from fmus_src.export.model_description3 import VERSION

KIND = "_fowt-cosim_mechanical"  # FMI 3.0 has no kinds of its own; a tool's own begin with "_" and its name
FORCES = ("force", "moment", "modal_force")
MOTIONS = (
    "position", "rotation", "orientation", "velocity", "angular_velocity", "acceleration", "angular_acceleration",
    "specific_force", "deflection", "deflection_rate",
)  # fmt: skip
MORE = ("added_mass", "root_force", "root_moment")  # what goes with the forces and does no work
_SIDE, _HALF = 100.0, 5.0  # of the icon's square from -100 to 100, and of a terminal's mark


@dataclass(frozen=True)
class Terminal:
    """A mechanical port: `takes_force` on the side of the body, which gives the motion.

    Attributes:
        members: quantity -> name of the variable.
    """

    name: str
    takes_force: bool
    members: dict[str, str]


def terminals(equations: Equations) -> list[Terminal]:
    """The mechanical ports of a component, from the names of its inputs and outputs."""
    inputs, outputs = _by_place(equations, "input"), _by_place(equations, "output")
    places = equations.component.places
    found = []
    for prefix, quantities in inputs.items():
        if any(q in quantities for q in FORCES):
            motions = outputs.get(places.get(prefix, prefix), {})
            found.append(Terminal(prefix, True, _chosen(quantities, FORCES + MORE) | _chosen(motions, MOTIONS)))
    moving = [prefix for prefix, quantities in inputs.items() if any(q in quantities for q in MOTIONS)]
    for prefix, quantities in outputs.items():
        if any(q in quantities for q in FORCES):
            own = [f"{prefix}.attachment".lstrip("."), prefix]
            place = next((p for p in (*own, *moving[:1]) if p in moving), prefix)
            members = _chosen(quantities, FORCES + MORE) | _chosen(inputs.get(place, {}), MOTIONS)
            found.append(Terminal(place or equations.component.name, False, members))
    return found


def terminals_and_icons(equations: Equations) -> str:
    """The XML text."""
    root = ET.Element("fmiTerminalsAndIcons", {"fmiVersion": VERSION})
    graphics = ET.SubElement(root, "GraphicalRepresentation")
    square = {"x1": -_SIDE, "y1": -_SIDE, "x2": _SIDE, "y2": _SIDE}
    corners = {key: repr(value) for key, value in square.items()}
    ET.SubElement(graphics, "CoordinateSystem", corners | {"suggestedScalingFactorTo_mm": "0.1"})
    ET.SubElement(graphics, "Icon", corners)
    found = terminals(equations)
    parent = ET.SubElement(root, "Terminals") if found else root
    for side in (True, False):
        row = [t for t in found if t.takes_force is side]
        for i, terminal in enumerate(row):
            _write(parent, terminal, _SIDE * (1.0 - (2 * i + 1) / len(row)))
    return to_text(root)


def _write(parent: ET.Element, terminal: Terminal, height: float) -> None:
    role = "takes force, gives motion" if terminal.takes_force else "gives force, takes motion"
    element = ET.SubElement(parent, "Terminal", {
        "name": terminal.name, "matchingRule": "bus", "terminalKind": KIND, "description": f"mechanical port: {role}",
    })  # fmt: skip
    for quantity, variable in terminal.members.items():
        flow = "inflow" if terminal.takes_force else "outflow"  # of force and moment into this component
        kind = flow if quantity in FORCES else "signal"
        ET.SubElement(element, "TerminalMemberVariable", {
            "variableName": variable, "memberName": quantity, "variableKind": kind,
        })  # fmt: skip
    x = _SIDE if terminal.takes_force else -_SIDE
    box = {"x1": x - _HALF, "y1": height - _HALF, "x2": x + _HALF, "y2": height + _HALF}
    placed = {key: repr(value) for key, value in box.items()}
    ET.SubElement(element, "TerminalGraphicalRepresentation", {
        "defaultConnectionColor": "40 70 90", "defaultConnectionStrokeSize": "1.0", **placed, "iconBaseName": "port",
    })  # fmt: skip


def _by_place(equations: Equations, causality: str) -> dict[str, dict[str, str]]:
    """Variables by prefix ("" for none) and quantity, in order of declaration."""
    found: dict[str, dict[str, str]] = {}
    for v in equations.variables:
        if v.causality == causality:
            prefix, _, quantity = v.name.rpartition(".")
            found.setdefault(prefix, {})[quantity] = v.name
    return found


def _chosen(quantities: dict[str, str], names: tuple[str, ...]) -> dict[str, str]:
    return {q: quantities[q] for q in names if q in quantities}
