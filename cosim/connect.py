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

from cosim.errors import CosimError
from cosim.fmu import read_fmu
from cosim.ssp_writer import write_ssd
from cosim.system import ComponentInstance, Connection, Port, System

FLOWS = {"force": ("velocity", "position"), "moment": ("angular_velocity", "")}


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


def _find_ports(fmus: Mapping[str, Path], connections: Sequence[Connection]) -> tuple[Port, ...]:
    """Mechanical ports: forces and moments that a component takes, each with the velocity that it has there.

    That of `P.force` is its output `P.velocity`; failing that, `Q.velocity`, where the component that gives the force
    takes `Q.position` or another quantity of Q. A force with one element that varies has all its elements in the port:
    what a damper of today leaves at zero, another in its place need not.
    """
    varying = {
        (c.target, _array(c.input)) for c in connections
        if read_fmu(fmus[c.source]).variables[c.output].variability != "discrete"
    }  # fmt: skip
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
            if place is not None and (name, _array(c.input)) in varying:
                moved = f"{place}.{position}{index}"
                pairs[prefix].append((c.input, f"{place}.{flow}{index}", moved if moved in outputs else ""))
        ports += [Port(prefix, name, tuple(found)) for prefix, found in pairs.items()]
    return tuple(ports)


def _array(variable: str) -> str:
    return variable.partition("[")[0]


def _of(path: Path, causality: str) -> list[str]:
    return [v.name for v in read_fmu(path).variables.values() if v.causality == causality]


def _public_names(component: str, variable: str, known: Mapping[str, str]) -> list[str]:
    """Names by which others know `component.variable`."""
    full = f"{component}.{variable}"
    return [public + full[len(prefix) :] for prefix, public in known.items() if full.startswith(f"{prefix}.")]


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
