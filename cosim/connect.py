"""Connect FMUs by the names of their ports, and write the system as SSP 1.0 structure description (.ssd).

    python -m cosim.connect -o cases/barge.ssd barge=fmus/barge.fmu hydro=fmus/hydro.fmu ...

The rule: an input `other.quantity` takes the output `quantity` of the component `other`; else the output of the same
name of any other component; and `attachment.quantity` of component A takes the output `A.quantity`.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from lxml import etree

from cosim.errors import CosimError
from cosim.fmu import FmuVariable, read_fmu
from cosim.ssp import PORTS
from cosim.system import ComponentInstance, Connection, Port, System
from fmus_src.units import Unit

_SSD = "http://ssp-standard.org/SSP1/SystemStructureDescription"
FLOWS = {"force": ("velocity", "position"), "moment": ("angular_velocity", "")}
_SSC = "http://ssp-standard.org/SSP1/SystemStructureCommon"


def connect(fmus: Mapping[str, Path], ports: Mapping[str, str] | None = None) -> System:
    """A system of named FMUs, connected by the names of their ports.

    Args:
        ports: port prefix of a component -> the name others know it by, such as
            {"mtmd.unit1": "nacelle_damper"}.

    Raises:
        CosimError: an input could take several outputs.
    """
    known = dict(ports or {}) | {name: name for name in fmus}
    outputs: dict[str, list[tuple[str, str]]] = {}
    for name, path in fmus.items():
        for variable in _of(path, "output"):
            outputs.setdefault(variable, []).append((name, variable))
            for public in _public_names(name, variable, known):
                outputs.setdefault(public, []).append((name, variable))
    connections = []
    for name, path in fmus.items():
        for variable in _of(path, "input"):
            wanted = [variable, *(p.replace(".attachment.", ".") for p in _public_names(name, variable, known))]
            sources = {s for w in wanted for s in outputs.get(w, []) if s[0] != name}
            if len(sources) > 1:
                listed = " or ".join(sorted(".".join(s) for s in sources))
                raise CosimError(f"{name}.{variable}: could take {listed}; connect it by hand in the .ssd")
            connections += [Connection(source, output, name, variable) for source, output in sources]
    components = tuple(ComponentInstance(name, path) for name, path in fmus.items())
    return System("system", components, tuple(connections), ports=_find_ports(fmus, connections))


def write_ssd(system: System, path: Path) -> Path:
    """Write a system; sources are `resources/NAME.fmu`, connectors are those connected."""
    root = etree.Element(
        f"{{{_SSD}}}SystemStructureDescription",
        {"version": "1.0", "name": path.stem},
        nsmap={"ssd": _SSD, "ssc": _SSC},
    )
    element = etree.SubElement(root, f"{{{_SSD}}}System", name=path.stem)
    elements = etree.SubElement(element, f"{{{_SSD}}}Elements")
    units: dict[str, Unit] = {}
    for component in system.components:
        item = etree.SubElement(
            elements, f"{{{_SSD}}}Component", name=component.name, source=f"resources/{component.fmu.name}"
        )
        used = _connectors(system, component)
        connectors = etree.SubElement(item, f"{{{_SSD}}}Connectors") if used else None  # the schema wants one at least
        for variable, kind in used:
            connector = etree.SubElement(connectors, f"{{{_SSD}}}Connector", name=variable.name, kind=kind)
            typed = etree.SubElement(connector, f"{{{_SSC}}}{variable.type}")
            if variable.unit is not None:
                typed.set("unit", variable.unit.name)
                units[variable.unit.name] = variable.unit
    connections = etree.SubElement(element, f"{{{_SSD}}}Connections") if system.connections else None
    for c in system.connections:
        etree.SubElement(connections, f"{{{_SSD}}}Connection", startElement=c.source, startConnector=c.output,
                         endElement=c.target, endConnector=c.input)  # fmt: skip
    _write_ports(element, system.ports)
    _write_units(root, units)
    etree.SubElement(root, f"{{{_SSD}}}DefaultExperiment", startTime="0.0")
    etree.indent(root)
    path.write_bytes(etree.tostring(root, xml_declaration=True, encoding="UTF-8") + b"\n")
    return path


def _find_ports(fmus: Mapping[str, Path], connections: Sequence[Connection]) -> tuple[Port, ...]:
    """Mechanical ports: forces and moments that a component takes, each with the velocity that it has there.

    That of `P.force` is its output `P.velocity`; failing that, `Q.velocity`, where the component that gives the force
    takes `Q.position` or another quantity of Q.
    """
    ports = []
    for name, path in fmus.items():
        outputs, pairs = set(_of(path, "output")), defaultdict[str, list[tuple[str, str, str]]](list)
        for c in connections:
            prefix, dot, quantity = c.input.rpartition(".")
            flow, position = FLOWS.get(quantity.partition("[")[0], ("", ""))
            if c.target != name or not flow or not dot:
                continue
            index = quantity[quantity.find("[") :] if "[" in quantity else ""
            taken = [k.output.rpartition(".")[0] for k in connections if (k.source, k.target) == (name, c.source)]
            places = dict.fromkeys([prefix, *taken])
            place = next((p for p in places if f"{p}.{flow}{index}" in outputs), None)
            if place is not None and read_fmu(fmus[c.source]).variables[c.output].variability != "discrete":
                moved = f"{place}.{position}{index}"
                pairs[prefix].append((c.input, f"{place}.{flow}{index}", moved if moved in outputs else ""))
        ports += [Port(prefix, name, tuple(found)) for prefix, found in pairs.items()]
    return tuple(ports)


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


def _of(path: Path, causality: str) -> list[str]:
    return [v.name for v in read_fmu(path).variables.values() if v.causality == causality]


def _public_names(component: str, variable: str, known: Mapping[str, str]) -> list[str]:
    """Names by which others know `component.variable`."""
    full = f"{component}.{variable}"
    return [public + full[len(prefix) :] for prefix, public in known.items() if full.startswith(f"{prefix}.")]


def _connectors(system: System, component: ComponentInstance) -> list[tuple[FmuVariable, str]]:
    name, used = component.name, []
    for variable in read_fmu(component.fmu).variables.values():
        if any(c.target == name and c.input == variable.name for c in system.connections):
            used.append((variable, "input"))
        elif any(c.source == name and c.output == variable.name for c in system.connections):
            used.append((variable, "output"))
    return used


def _write_units(root: Any, units: Mapping[str, Unit]) -> None:
    if not units:
        return
    parent = etree.SubElement(root, f"{{{_SSD}}}Units")
    for name in sorted(units):
        element = etree.SubElement(parent, f"{{{_SSC}}}Unit", name=name)
        base = {b: str(e) for b, e in units[name].exponents}
        if units[name].factor != 1.0:
            base["factor"] = repr(units[name].factor)
        etree.SubElement(element, f"{{{_SSC}}}BaseUnit", base)


def main(arguments: Sequence[str] | None = None) -> None:
    """Command line; see the module's documentation."""
    parser = argparse.ArgumentParser(description="Connect FMUs by the names of their ports.")
    parser.add_argument("fmus", nargs="+", metavar="NAME=FILE.fmu")
    parser.add_argument("-o", "--out", type=Path, required=True, help="the .ssd to write")
    parser.add_argument("--port", action="append", default=[], metavar="COMPONENT.PORT=NAME")
    options = parser.parse_args(arguments)
    fmus = {name: Path(file) for name, file in (f.split("=", 1) for f in options.fmus)}
    ports = dict(p.split("=", 1) for p in options.port)
    write_ssd(connect(fmus, ports), options.out)


if __name__ == "__main__":
    main()
