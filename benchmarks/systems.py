"""The systems that are stepped: a chain of masses, load case 4 with two dampers, and its shell without physics."""

from __future__ import annotations

import itertools
import shutil
import tempfile
import zipfile
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import fmpy
from lxml import etree

from benchmarks.case import Case, Value
from cosim.checks import check
from cosim.run import RunSettings, simulate
from cosim.ssp_writer import write_ssd
from cosim.system import ComponentInstance, Connection, System, with_parameters
from fmus_src.component import Component
from fmus_src.export.build import build_fmu
from fmus_src.export.compiler import compile_shared

STEP = 0.0125  # s
MASSES = 8
_SSD = "http://ssp-standard.org/SSP1/SystemStructureDescription"
_SSC = "http://ssp-standard.org/SSP1/SystemStructureCommon"
_OSP = "http://opensimulationplatform.com/SSP/OSPAnnotations"
_SSV = "http://ssp-standard.org/SSP1/SystemStructureParameterValues"


def chain_mass() -> Component:
    """A mass between two neighbours, m x'' = k (x_l + x_r - 2 x) + c (x_l' + x_r' - 2 x') + F sin(omega t)."""
    c = Component("chain_mass", "Mass on springs and dampers to its two neighbours, driven by a harmonic force")
    m = c.parameter("m", 1.0, unit="kg", min=1e-6, description="mass")
    k = c.parameter("k", 1.0, unit="N/m", min=0.0, description="stiffness to each neighbour")
    d = c.parameter("c", 0.1, unit="N.s/m", min=0.0, description="damping to each neighbour")
    force = c.parameter("force", 0.0, unit="N", description="amplitude of the driving force")
    omega = c.parameter("omega", 0.7, unit="rad/s", description="angular frequency of the driving force")
    sides = [
        (
            c.input(f"{side}.displacement", unit="m", description=f"displacement of the {side} neighbour"),
            c.input(f"{side}.velocity", unit="m/s", description=f"velocity of the {side} neighbour"),
        )
        for side in ("left", "right")
    ]
    x = c.state("x", unit="m", description="displacement")
    v = c.state("v", unit="m/s", description="velocity")
    pull = sum(k * (x_s - x) + d * (v_s - v) for x_s, v_s in sides)
    c.derivative(x, v)
    c.derivative(v, (pull + force * c.sym.sin(omega * c.time)) / m)
    c.output("displacement", x, unit="m", description="displacement")
    c.output("velocity", v, unit="m/s", description="velocity")
    return c


def chain(folder: Path, stop: float) -> Case:
    """Eight masses in a row between two walls, the first one driven: cheap FMUs, so that the master's cost shows."""
    with tempfile.TemporaryDirectory() as scratch:
        fmu = build_fmu(chain_mass(), Path(scratch))
        names = [f"mass{i}" for i in range(1, MASSES + 1)]
        connections = [
            Connection(source, quantity, target, f"{side}.{quantity}")
            for left, right in itertools.pairwise(names)
            for source, target, side in ((left, right, "left"), (right, left, "right"))
            for quantity in ("displacement", "velocity")
        ]
        system = System("chain", tuple(ComponentInstance(n, fmu) for n in names), tuple(connections))
        system = with_parameters(system, {"mass1.force": 1.0})
        compared = tuple(f"{n}.displacement" for n in names)
        return write_case("chain", f"{MASSES} masses on springs", system, folder, compared, stop)


def load_case(folder: Path, stop: float, longest: float | None = None) -> Case:
    """Load case 4 with two dampers: the whole turbine, seven FMUs.

    Args:
        longest: simulated time that the wind must last, s (default: the load case's).
    """
    from cosim.case import read_case
    from cosim.cli.run import Changes, prepare

    case = read_case("lc4")
    system = prepare(case, "mtmd", Changes(until=longest), quiet=True).system
    compared = (
        "barge.platform.position[1]", "barge.platform.position[3]", "barge.platform.rotation[2]",
        "barge.tower.deflection[1]", "barge.rotor.speed", "aero.force[1]", "nacelle_damper.force[1]",
        "platform_damper.force[1]",
    )  # fmt: skip
    return write_case("lc4", "load case 4 with two dampers", system, folder, compared, stop)


def shell(case: Case, folder: Path) -> Case:
    """The same FMUs, connections and variables, but every FMI function returns at once: what is left is the master."""
    (folder / "resources").mkdir(parents=True)
    headers = Path(fmpy.__file__).parent / "c-code"
    suffix = fmpy.sharedLibraryExtension
    library = compile_shared([Path(__file__).with_name("noop.c").resolve()], folder / f"noop{suffix}", [headers])
    for fmu in sorted((case.folder / "resources").glob("*.fmu")):
        identifier = fmpy.read_model_description(str(fmu)).coSimulation.modelIdentifier
        with zipfile.ZipFile(fmu) as real, zipfile.ZipFile(folder / "resources" / fmu.name, "w") as empty:
            empty.writestr("modelDescription.xml", real.read("modelDescription.xml"))
            empty.write(library, f"binaries/{fmpy.platform}/{identifier}{suffix}")
    shutil.copy(case.folder / "SystemStructure.ssd", folder)
    archive = _pack(folder)
    initial = {component: dict.fromkeys(values, 0.0) for component, values in case.initial.items()}
    description = f"{case.description}, FMUs without content"
    return replace(case, description=description, folder=folder, archive=archive, initial=initial)


def write_case(
    name: str, description: str, system: System, folder: Path, compared: Iterable[str], stop: float, step: float = STEP
) -> Case:
    """Put a system into a folder as SSP, with its start values as parameter bindings and its FMUs in resources/."""
    (folder / "resources").mkdir(parents=True)
    for fmu in {c.fmu for c in system.components}:
        shutil.copy(fmu, folder / "resources")
    checked = check(system)
    start = dict(zip(checked.names, (dict(s) for s in checked.start), strict=True))
    ssd = write_ssd(system, folder / "SystemStructure.ssd")
    _annotate(ssd, start, step)
    with tempfile.TemporaryDirectory() as scratch:
        sources = sorted({f"{c.source}.{c.output}" for c in system.connections})
        settings = RunSettings(stop=step, step=step, record=tuple(sources))
        first = simulate(system, settings, Path(scratch) / "first").frame().iloc[0]
    initial: dict[str, dict[str, float]] = {c.name: {} for c in system.components}
    for link, c in zip(checked.links, system.connections, strict=True):
        initial[c.target][c.input] = link.factor * float(first[f"{c.source}.{c.output}"]) + link.offset
    return Case(
        name=name, description=description, folder=folder, archive=_pack(folder), components=checked.names,
        start=start, initial=initial, compared=tuple(compared), step=step, stop=stop,
    )  # fmt: skip


def _annotate(ssd: Path, start: dict[str, dict[str, Value]], step: float) -> None:
    """Add parameter bindings, and libcosim's own annotation of its step size and of no extra threads."""
    tree = etree.parse(str(ssd))
    parent = etree.SubElement(tree.find(f".//{{{_SSD}}}DefaultExperiment"), f"{{{_SSD}}}Annotations")
    annotation = etree.SubElement(
        parent, f"{{{_SSC}}}Annotation", {"type": "com.opensimulationplatform"}, nsmap={"osp": _OSP}
    )
    algorithm = etree.SubElement(annotation, f"{{{_OSP}}}Algorithm")  # libcosim takes no attribute here, xmlns neither
    etree.SubElement(algorithm, f"{{{_OSP}}}FixedStepAlgorithm", baseStepSize=repr(step), numWorkerThreads="0")
    for component in tree.iterfind(f".//{{{_SSD}}}Component"):
        values = start[component.get("name")]
        if not values:
            continue
        binding = etree.SubElement(
            etree.SubElement(component, f"{{{_SSD}}}ParameterBindings"), f"{{{_SSD}}}ParameterBinding"
        )
        parent = etree.SubElement(binding, f"{{{_SSD}}}ParameterValues")
        values_set = etree.SubElement(
            parent, f"{{{_SSV}}}ParameterSet", {"version": "1.0", "name": component.get("name")}, nsmap={"ssv": _SSV}
        )
        parameters = etree.SubElement(values_set, f"{{{_SSV}}}Parameters")
        for name, value in values.items():
            parameter = etree.SubElement(parameters, f"{{{_SSV}}}Parameter", name=name)
            kind = {bool: "Boolean", int: "Integer", float: "Real", str: "String"}[type(value)]
            text = str(value).lower() if isinstance(value, bool) else str(value)
            etree.SubElement(parameter, f"{{{_SSV}}}{kind}", value=text)
    tree.write(str(ssd), xml_declaration=True, encoding="UTF-8")


def _pack(folder: Path) -> Path:
    archive = folder / "system.ssp"
    with zipfile.ZipFile(archive, "w") as package:
        package.write(folder / "SystemStructure.ssd", "SystemStructure.ssd")
        for fmu in sorted((folder / "resources").glob("*.fmu")):
            package.write(fmu, f"resources/{fmu.name}")
    return archive
