"""SSP packages: ours in other masters, others in ours."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from lxml import etree

from cosim.archive import entry_names, sha256
from cosim.case import read_case
from cosim.checks import check
from cosim.cli.run import Changes, prepare
from cosim.errors import CosimError
from cosim.run import RunSettings, simulate
from cosim.ssp import read_package, read_parameters
from cosim.ssp_writer import VERSIONS, write_package
from cosim.system import ComponentInstance, Connection, System, with_parameters
from fmus_src.component import Component
from tests.conftest import Outcome

from .cosim_fmus import carried, mass, two_masses
from .foreign_damper import NAMES, foreign_damper

STEP = 1 / 64  # s: a sum of such steps has no rounding, so that all masters call the FMUs at the same times
JACOBI: dict[str, Any] = {"algorithm": "jacobi", "extrapolation": "held"}


def pushed() -> Component:
    """m x'' = force + amplitude sin(omega t): all zero at the start."""
    c = Component("pushed", "Mass pushed by a harmonic force", internal_step=1e-3)
    m = c.parameter("m", 1.0, unit="kg", description="mass")
    amplitude = c.parameter("amplitude", 0.0, unit="N", description="of the force")
    force = c.input("force", unit="N", description="force")
    x, v = c.state("x", unit="m", description="position"), c.state("v", unit="m/s", description="velocity")
    c.derivative(x, v)
    c.derivative(v, (force + amplitude * c.sym.sin(3.0 * c.time)) / m)
    c.output("position", x, unit="m", description="position")
    return c


@pytest.fixture(scope="module")
def pair(built: Callable[[Component], Path]) -> System:
    components = ComponentInstance("structure", built(pushed())), ComponentInstance("damper", built(carried()))
    connections = (
        Connection("structure", "position", "damper", "point"), Connection("damper", "force", "structure", "force"),
    )  # fmt: skip
    values = {"structure.amplitude": 2.5, "structure.m": 3.0, "damper.k": 7.0, "damper.m": 0.5}
    return with_parameters(System("pair", components, connections), values)


@pytest.fixture(scope="module")
def decay(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, System, RunSettings]:
    """The 10 deg decay with two dampers as a package."""
    prepared = prepare(read_case("decay10"), "mtmd", Changes(until=1.0), quiet=True)
    path = tmp_path_factory.mktemp("packages") / "decay.ssp"
    return write_package(prepared.system, prepared.settings, path), prepared.system, prepared.settings


def by_fmpy(path: Path, steps: int, step: float, begin: dict[str, float] | None = None) -> Any:
    """FMPy's SSP simulation. It applies no parameter bindings, so its own reader's sets are handed to it.

    Booleans as numbers: FMPy takes the text "false" for true.

    Args:
        begin: values of connected inputs at the start, which FMPy would set to zero.
    """
    import fmpy.ssp.simulation as ssp
    from fmpy.ssp.ssd import read_ssd

    parameters = [
        SimpleNamespace(name=f"{component.name}.{p.name}", value={"true": 1.0, "false": 0.0}.get(p.value, p.value))
        for component in read_ssd(str(path)).system.elements
        for bound in component.parameterBindings for values in bound.parameterValues for p in values.parameters
    ]  # fmt: skip
    assert parameters
    usual = ssp.instantiate_fmu

    def instantiate(component: Any, *rest: Any) -> None:
        parameter_set = SimpleNamespace(parameters=[*rest[-1].parameters, *first])
        usual(component, *rest[:-1], parameter_set)
        for connector in component.connectors:
            connector.value = (begin or {}).get(f"{component.name}.{connector.name}", 0.0)

    first = [SimpleNamespace(name=n, value=v) for n, v in (begin or {}).items()]
    if begin:
        ssp.instantiate_fmu = instantiate
    try:
        return ssp.simulate_ssp(
            str(path), stop_time=(steps - 0.5) * step, step_size=step,
            parameter_set=SimpleNamespace(parameters=parameters),
        )  # fmt: skip
    finally:
        ssp.instantiate_fmu = usual


def by_libcosim(path: Path, steps: int, step: float, names: list[str]) -> dict[str, list[float]]:
    """libcosim's loader and fixed-step master, the step being that of the package's annotation."""
    pytest.importorskip("libcosimpy")
    from libcosimpy.CosimEnums import CosimVariableType
    from libcosimpy.CosimExecution import CosimExecution
    from libcosimpy.CosimLogging import CosimLogLevel, log_output_level
    from libcosimpy.CosimObserver import CosimObserver

    log_output_level(CosimLogLevel.ERROR)
    execution = CosimExecution.from_ssp_file(str(path))
    observer = CosimObserver.create_time_series(steps + 1)
    execution.add_observer(observer)
    places = {}
    for name in names:
        owner, _, variable = name.partition(".")
        slave = execution.slave_index_from_instance_name(owner)
        references = {v.name.decode(): v.reference for v in execution.slave_variables(slave)}
        places[name] = slave, references[variable]
        observer.start_time_series(*places[name], CosimVariableType.REAL)
    assert execution.simulate_until(round(steps * step * 1e9))
    return {n: observer.time_series_real_samples(*at, 1, steps)[2] for n, at in places.items()}


def test_other_masters_compute_the_same_to_the_last_bit(pair: System, tmp_path: Path) -> None:
    """FMPy and libcosim, from the package alone: the same FMUs called with the same numbers at the same times."""
    names, steps = ["structure.position", "damper.force"], 320
    settings = RunSettings(stop=steps * STEP, step=STEP, record=tuple(names), **JACOBI)
    path = write_package(pair, settings, tmp_path / "pair.ssp")
    ours = simulate(pair, settings, tmp_path / "ours").frame()
    assert ours["structure.position"].abs().max() > 0.5
    fmpy_rows, libcosim = by_fmpy(path, steps, STEP), by_libcosim(path, steps, STEP, names)
    for name in names:
        assert fmpy_rows[name].tolist() == ours[name].to_list()[1:]
        assert libcosim[name] == ours[name].to_list()[1:]


def test_other_masters_agree_on_a_load_case(decay: tuple[Path, System, RunSettings], tmp_path: Path) -> None:
    """The turbine with two dampers; the dampers' transverse inertia closes an algebraic loop at the start.

    What each master leaves of that loop is far below its tolerance of 1e-5 (measured differences: 1e-12 of the largest
    value); FMPy gets our start values of the inputs, since it would start them at zero.
    """
    path, system, settings = decay
    names = ["barge.platform.rotation[2]", "nacelle_damper.force[1]", "platform_damper.force[1]", "hydro.force[3]"]
    inputs = {f"{c.target}.{c.input}": f"{c.source}.{c.output}" for c in system.connections}
    chosen = replace(settings, channels=(), record=(*names, *inputs.values()), decimation=1, **JACOBI)
    frame = simulate(system, chosen, tmp_path / "ours").frame()
    begin = {taken: float(frame[given].iloc[0]) for taken, given in inputs.items()}
    libcosim = by_libcosim(path, 80, 0.0125, names)
    rows = by_fmpy(path, 80, 0.0125, begin)
    for name in names:
        expected = frame[name].to_numpy()[1:]
        scale = np.abs(expected).max()
        np.testing.assert_allclose(libcosim[name], expected, atol=1e-9 * scale, rtol=0)
        np.testing.assert_allclose(rows[name], expected, atol=1e-9 * scale, rtol=0)


@pytest.mark.parametrize("version", VERSIONS)
def test_packages_are_valid_and_give_the_same_run(
    decay: tuple[Path, System, RunSettings], version: Any, tmp_path: Path
) -> None:
    """Against the schemas of SSP 1.0 and 2.0 that pyssp-standard brings; then run again, to the last bit."""
    import pyssp_standard

    _, system, settings = decay
    theirs = foreign_damper(tmp_path)
    rules = [f"nacelle_damper.{a}={b}" for a, b in NAMES.items()]
    changes = Changes(swap=(f"nacelle_damper={theirs}",), map=rules, until=1.0)
    system = prepare(read_case("decay10"), "mtmd", changes, quiet=True).system
    path = write_package(system, settings, tmp_path / "x.ssp", version)
    schemas = Path(pyssp_standard.__file__).parent / "resources" / ("ssp2" if version == "2.0" else "")
    kinds = {".ssd": "Description", ".ssv": "ParameterValues", ".ssm": "ParameterMapping"}
    seen = set()
    with zipfile.ZipFile(path) as package:
        for name in package.namelist():
            kind = kinds.get(Path(name).suffix)
            if kind:
                schema = etree.XMLSchema(etree.parse(str(schemas / f"SystemStructure{kind}.xsd")))
                root = etree.fromstring(package.read(name))
                schema.assertValid(root)
                assert root.get("version") == version
                seen.add(kind)
    assert seen == set(kinds.values())
    plain = write_package(system, settings, tmp_path / "plain.ssp", version, mappings=False)
    assert not any(n.endswith(".ssm") for n in entry_names(plain))
    assert check(read_package(plain, tmp_path / "plain").system).start == check(system).start
    found = read_package(path, tmp_path / "unpacked")
    assert (found.stop, found.step, found.record_every) == (1.0, settings.step, settings.decimation)
    assert check(found.system).start == check(system).start
    ours = simulate(system, settings, tmp_path / "ours").frame()
    again = simulate(found.system, replace(settings, channels=found.outputs), tmp_path / "again").frame()
    pd.testing.assert_frame_equal(ours, again, check_exact=True)


def test_the_same_system_gives_the_same_bytes(decay: tuple[Path, System, RunSettings], tmp_path: Path) -> None:
    path, system, settings = decay
    again = write_package(system, settings, tmp_path / "decay.ssp")
    assert again.read_bytes() == path.read_bytes()
    with pytest.raises(CosimError, match="exists; choose another name"):
        write_package(system, settings, again)


def test_export_and_run_from_the_command_line(fowt: Callable[..., Outcome], tmp_path: Path) -> None:
    """Export, run, the same numbers as the load case itself; the package's hash is in run.json."""
    short = ("decay10", "--damper", "tmd-p", "--until", "2")
    assert fowt("export", *short, "--out", "case.ssp").code == 0
    assert fowt("run", "case.ssp", "--out", "package").code == 0
    assert fowt("run", *short, "--out", "case").code == 0
    frames = [pd.read_parquet(tmp_path / n / "results.parquet") for n in ("package", "case")]
    pd.testing.assert_frame_equal(*frames, check_exact=True)
    about = json.loads((tmp_path / "package/run.json").read_text())["settings"]["about"]
    assert about == {"package": "case.ssp", "package_sha256": sha256(tmp_path / "case.ssp")}
    refused = fowt("run", "case.ssp", "--damper", "mtmd")
    assert refused.code == 1
    assert "--damper is for load cases" in refused.err


NAMESPACES = " ".join(
    f'xmlns:{short}="http://ssp-standard.org/SSP1/SystemStructure{long}"'
    for short, long in {
        "ssd": "Description", "ssc": "Common", "ssv": "ParameterValues", "ssm": "ParameterMapping",
    }.items()
)  # fmt: skip


def foreign(folder: Path, fmus: dict[str, Path], text: str, **files: str) -> Path:
    """A package as another tool may write it."""
    path = folder / "foreign.ssp"
    with zipfile.ZipFile(path, "w") as package:
        package.writestr("SystemStructure.ssd", text)
        for name, content in files.items():
            package.writestr(f"extra/{name.replace('__', '.')}", content)
        for fmu in fmus.values():
            package.write(fmu, f"resources/{fmu.name}")
    return path


NESTED = f"""<ssd:SystemStructureDescription {NAMESPACES} version="2.0" name="foreign"><ssd:System name="outer">
<ssd:Connectors><ssd:Connector name="swing" kind="output"><ssc:Float64 unit="mm"/></ssd:Connector>
<ssd:Connector name="heaviness" kind="parameter"/></ssd:Connectors>
<ssd:ParameterBindings>
 <ssd:ParameterBinding source="extra/set.ssv"><ssd:ParameterMapping source="extra/map.ssm"/></ssd:ParameterBinding>
</ssd:ParameterBindings>
<ssd:Elements>
 <ssd:Component name="structure" source="resources/mass.fmu"/>
 <ssd:System name="inner">
  <ssd:Connectors><ssd:Connector name="at" kind="input"/><ssd:Connector name="back" kind="output"/></ssd:Connectors>
  <ssd:Elements><ssd:Component name="damper" source="resources/carried.fmu"/></ssd:Elements>
  <ssd:Connections>
   <ssd:Connection startConnector="at" endElement="damper" endConnector="point"/>
   <ssd:Connection startElement="damper" startConnector="force" endConnector="back">
    <ssc:LinearTransformation factor="2"/></ssd:Connection>
  </ssd:Connections>
 </ssd:System>
</ssd:Elements>
<ssd:Connections>
 <ssd:Connection startElement="structure" startConnector="position" endElement="inner" endConnector="at"/>
 <ssd:Connection startElement="inner" startConnector="back" endElement="structure" endConnector="force">
  <ssc:LinearTransformation factor="0.5"/></ssd:Connection>
 <ssd:Connection startElement="structure" startConnector="position" endConnector="swing"/>
 <ssd:Connection startConnector="heaviness" endElement="inner" endConnector="weight"/>
</ssd:Connections></ssd:System>
<ssd:Units><ssc:Unit name="mm"><ssc:BaseUnit m="1" factor="1e-3"/></ssc:Unit></ssd:Units>
<ssd:DefaultExperiment startTime="0" stopTime="3"/></ssd:SystemStructureDescription>"""
# the inner system's connector of the parameter m, which the outer one's "heaviness" feeds
NESTED = NESTED.replace(
    '<ssd:Connector name="at" kind="input"/>',
    '<ssd:Connector name="at" kind="input"/><ssd:Connector name="weight" kind="parameter"/>',
).replace(
    '<ssd:Connection startConnector="at"',
    '<ssd:Connection startConnector="weight" endElement="damper" endConnector="m"/><ssd:Connection startConnector="at"',
)
SET = f"""<ssv:ParameterSet {NAMESPACES} version="2.0" name="x"><ssv:Parameters>
<ssv:Parameter name="tons"><ssv:Float64 value="5e-4" unit="tonne"/></ssv:Parameter>
<ssv:Parameter name="stretch"><ssv:Float64 value="500" unit="mm"/></ssv:Parameter>
<ssv:Parameter name="unused"><ssv:Int32 value="3"/></ssv:Parameter></ssv:Parameters>
<ssv:Units><ssc:Unit name="tonne"><ssc:BaseUnit kg="1" factor="1000"/></ssc:Unit>
<ssc:Unit name="mm"><ssc:BaseUnit m="1" factor="1e-3"/></ssc:Unit></ssv:Units></ssv:ParameterSet>"""
MAP = f"""<ssm:ParameterMapping {NAMESPACES} version="2.0"><ssm:MappingEntry source="tons" target="heaviness"/>
<ssm:MappingEntry source="stretch" target="inner.damper.x_0"><ssc:LinearTransformation factor="2"/></ssm:MappingEntry>
</ssm:ParameterMapping>"""


@pytest.fixture(scope="module")
def fmus(built: Callable[[Component], Path]) -> dict[str, Path]:
    return {"mass": built(mass()), "carried": built(carried())}


def test_a_nested_package_of_another_tool_is_the_flat_system(fmus: dict[str, Path], tmp_path: Path) -> None:
    """SSP 2.0 with a system in a system, own connectors, a mapping with a factor and units: the two masses again."""
    found = read_package(foreign(tmp_path, fmus, NESTED, set__ssv=SET, map__ssm=MAP), tmp_path / "unpacked")
    assert {c.name for c in found.system.components} == {"structure", "inner.damper"}
    assert any("parameters that the mapping does not name are not used: unused" in n for n in found.system.notes)
    start = check(found.system).start[1]
    assert start == {"m": pytest.approx(0.5, rel=1e-15), "x_0": pytest.approx(1.0, rel=1e-15)}
    settings = RunSettings(stop=3.0, step=0.05, channels=found.outputs, record=("*.position",))
    ours = simulate(found.system, settings, tmp_path / "nested").frame()
    flat_settings = RunSettings(stop=3.0, step=0.05, record=("*.position",))
    flat = simulate(two_masses(fmus["mass"], fmus["carried"]), flat_settings, tmp_path / "flat").frame()
    # a factor of 2 and one of 1/2 round nothing
    assert ours["inner.damper.position"].to_list() == flat["damper.position"].to_list()
    np.testing.assert_allclose(ours["swing"], 1000.0 * flat["structure.position"], rtol=1e-14)


def test_a_foreign_package_runs_with_all_outputs(
    fowt: Callable[..., Outcome], fmus: dict[str, Path], tmp_path: Path
) -> None:
    """No step, no named outputs: a note on the step, and every output is recorded."""
    text = NESTED.replace(
        '<ssd:Connection startElement="structure" startConnector="position" endConnector="swing"/>', ""
    )
    path = foreign(tmp_path, fmus, text, set__ssv=SET, map__ssm=MAP)
    ran = fowt("run", str(path), "--set", "inner.damper.k=2", "--out", "run")
    assert ran.code == 0, ran.err
    assert "says no step: 0.0125 s are used" in ran.err
    frame = pd.read_parquet(tmp_path / "run/results.parquet")
    assert {"structure.position", "inner.damper.force"} < set(frame.columns)
    assert frame["Time"].iloc[-1] == 3.0
    assert json.loads((tmp_path / "run/run.json").read_text())["components"]["inner.damper"]["start"]["k"] == 2.0


PLACES = {
    "fmu": "resources/mass.fmu",
    "set": "extra/set.ssv",
    "loop": 'startElement="damper" startConnector="force"',
    "offset": 'factor="0.5"',
    "kind": '<ssd:Component name="structure"',
    "transformation": '<ssc:LinearTransformation factor="0.5"/>',
    "system": '<ssd:System name="inner">',
    "binding": "<ssd:ParameterBinding ",
    "mapping": "<ssd:ParameterMapping ",
}
TWICE = PLACES["transformation"]


def nested(**changes: str) -> str:
    text = NESTED
    for place, new in changes.items():
        text = text.replace(PLACES[place], new + (PLACES[place] if place == "system" else ""))
    assert text != NESTED
    return text


BAD = [
    (nested(fmu="../outside.fmu"), "source '../outside.fmu' leads out of the package"),
    (nested(fmu="/etc/passwd"), "source '/etc/passwd' leads out of the package"),
    (nested(fmu="%2e%2e/%2e%2e/x.fmu"), "leads out of the package"),
    (nested(fmu="http://elsewhere/x.fmu"), "is no path relative to the file"),
    (nested(set="extra/../../set.ssv"), "leads out of the package"),
    (nested(fmu="resources/none.fmu"), "component 'structure': none.fmu is not in"),
    (nested(loop='startConnector="back"'), "connector 'inner.back' feeds itself"),
    (nested(offset='factor="0.5" offset="1"'), "goes through systems with an offset"),
    (nested(offset='factor="half"'), "LinearTransformation: could not convert"),
    (
        nested(kind='<ssd:Component type="application/x-ssp-package" name="structure"'),
        "is of the kind application/x-ssp",
    ),
    (nested(kind='<ssd:Component implementation="ModelExchange" name="structure"'), "is of the kind ModelExchange"),
    (nested(offset='factor="nan"'), "inner.back: LinearTransformation: factor nan, offset 0 are not finite"),
    (nested(transformation=f"{TWICE}{TWICE}"), "inner.back: has 2 transformations; keep one"),
    (nested(transformation="<ssc:BooleanMappingTransformation/>"), "BooleanMappingTransformation is not supported"),
    (
        nested(system='<ssd:SignalDictionaryReference name="bus" dictionary="d"/>'),
        "SignalDictionaryReference 'bus' is not supported; use components and systems only",
    ),
    (nested(binding='<ssd:ParameterBinding type="text/csv" '), "a ParameterBinding is of the type text/csv; only"),
    (nested(binding='<ssd:ParameterBinding sourceBase="component" '), "sourceBase='component' is not supported"),
    (nested(mapping='<ssd:ParameterMapping type="text/csv" '), "a ParameterMapping is of the type text/csv; only"),
    (
        nested(mapping="<ssd:ParameterValues><ssv:ParameterSet/></ssd:ParameterValues><ssd:ParameterMapping "),
        "has both the source 'extra/set.ssv' and ParameterSet; keep one",
    ),
    (nested(system='<ssd:System name="s"/>' * 2001), "component 's' appears twice"),
    (nested(system="".join(f'<ssd:System name="s{i}"/>' for i in range(2001))), "has more than 2000 components"),
]
BAD_FILES = [
    (SET.replace("stretch", "tons"), MAP, "extra/set.ssv: parameter 'tons' appears twice; keep one"),
    (SET.replace('Int32 value="3"', 'Enumeration value="blue"'), MAP, "'blue': is neither a number nor an item"),
    (SET, MAP.replace("heaviness", "inner.damper.x_0"), "two entries have the target 'inner.damper.x_0'; keep one"),
    (SET, MAP.replace('factor="2"', 'factor="1e999"'), "extra/map.ssm: stretch: LinearTransformation: factor inf"),
]


@pytest.mark.parametrize(("values", "mapping", "words"), BAD_FILES)
def test_bad_parameters_are_refused(
    fmus: dict[str, Path], tmp_path: Path, values: str, mapping: str, words: str
) -> None:
    """The line names the file by its place in the package, not by where it was unpacked."""
    path = foreign(tmp_path, fmus, NESTED, set__ssv=values, map__ssm=mapping)
    with pytest.raises(CosimError) as refused:
        read_package(path, tmp_path / "unpacked")
    assert words in str(refused.value)
    assert "foreign.ssp" in str(refused.value)
    assert "unpacked" not in str(refused.value)


def test_what_is_passed_over_is_said(fmus: dict[str, Path], tmp_path: Path) -> None:
    """Connections that lead nowhere, other variants of the system, unknown versions: the run warns of each."""
    quiet = read_package(foreign(tmp_path, fmus, NESTED, set__ssv=SET, map__ssm=MAP), tmp_path / "quiet").system
    assert len(quiet.notes) == 1  # on the parameter that no mapping names
    text = NESTED.replace('endElement="inner" endConnector="at"', 'endElement="inner" endConnector="att"')
    text = text.replace('version="2.0" name="foreign"', 'version="3.0" name="foreign"')
    path = foreign(tmp_path, fmus, text, set__ssv=SET, map__ssm=MAP)
    with zipfile.ZipFile(path, "a") as package:
        package.writestr("WithoutDamper.ssd", NESTED)
    notes = " / ".join(read_package(path, tmp_path / "unpacked").system.notes)
    for words in (
        "the connection of structure.position to 'att' of inner leads nowhere and is not used",
        "only SystemStructure.ssd is used, not WithoutDamper.ssd",
        "says version '3.0'; is read as SSP 2.0",
    ):
        assert words in notes


def test_a_text_names_a_file_as_it_stands(fmus: dict[str, Path], tmp_path: Path) -> None:
    """Sources are URIs, with %20 for a blank; the texts of parameters are not."""
    text = '<ssv:String value="50%25 of.bts"/>'
    values = SET.replace('<ssv:Int32 value="3"/>', text)
    (tmp_path / "set.ssv").write_text(values)
    assert read_parameters(tmp_path / "set.ssv")["unused"].value == "50%25 of.bts"
    (tmp_path / "50% of.bts").write_text("another")
    assert read_parameters(tmp_path / "set.ssv")["unused"].value == "50%25 of.bts"
    (tmp_path / "50%25 of.bts").write_text("x")
    assert read_parameters(tmp_path / "set.ssv")["unused"].value == str(tmp_path / "50%25 of.bts")
    (tmp_path / "set of.ssv").write_text(values)
    path = foreign(
        tmp_path, fmus, NESTED.replace("extra/set.ssv", "extra/s%65t.ssv"), set__ssv=values, map__ssm=MAP
    )  # fmt: skip
    assert len(read_package(path, tmp_path / "unpacked").system.components) == 2


@pytest.mark.parametrize(("text", "words"), BAD)
def test_bad_packages_are_refused(fmus: dict[str, Path], tmp_path: Path, text: str, words: str) -> None:
    path = foreign(tmp_path, fmus, text, set__ssv=SET, map__ssm=MAP)
    with pytest.raises(CosimError) as refused:
        read_package(path, tmp_path / "unpacked")
    assert words in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_file_outside_a_package_is_not_found_by_a_text(fmus: dict[str, Path], tmp_path: Path) -> None:
    """A text parameter that names a file elsewhere is refused, so that a package cannot have it read."""
    (tmp_path / "secret").write_text("x")
    values = SET.replace('<ssv:Float64 value="5e-4" unit="tonne"/>', '<ssv:String value="../../secret"/>')
    path = foreign(tmp_path, fmus, NESTED, set__ssv=values, map__ssm=MAP)
    with pytest.raises(CosimError, match="leads out of the package"):
        read_package(path, tmp_path / "unpacked")


def test_an_archive_that_is_no_package_is_refused(tmp_path: Path) -> None:
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w") as package:
        package.writestr("other.ssd", "<x/>")
    (tmp_path / "x.ssp").write_bytes(content.getvalue())
    with pytest.raises(CosimError, match=r"has no SystemStructure.ssd; is it an SSP package"):
        read_package(tmp_path / "x.ssp", tmp_path / "unpacked")
