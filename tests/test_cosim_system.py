"""Systems from SSP files, changes to them, and the checks before a run: each mistake is one clear line."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import trapezoid

from cosim.case import case_folder, read_case
from cosim.checks import check
from cosim.cli.run import Changes, prepare
from cosim.errors import CosimError
from cosim.fmu import read_fmu
from cosim.graph import algebraic_loops, step_order
from cosim.run import simulate
from cosim.ssp import read_parameters, read_system
from cosim.ssp_writer import write_ssd
from cosim.swap import NameRule, with_swapped
from cosim.system import (
    ComponentInstance,
    Connection,
    Port,
    StartValue,
    System,
    Value,
    with_parameters,
    without,
)
from fmus_src.component import Component
from fmus_src.library import build_library

from .cosim_fmus import carried, mass, probe, two_masses

SSP = "http://ssp-standard.org/SSP1/SystemStructure"
NAMESPACES = (
    f'xmlns:ssd="{SSP}Description" xmlns:ssc="{SSP}Common" xmlns:ssv="{SSP}ParameterValues" version="1.0" name="x"'
)
PARAMETERS = f"""<ssv:ParameterSet {NAMESPACES}><ssv:Parameters>{{}}</ssv:Parameters>
<ssv:Units><ssc:Unit name="lb"><ssc:BaseUnit kg="1" factor="0.45359237"/></ssc:Unit></ssv:Units></ssv:ParameterSet>"""


def real(name: str, value: float, unit: str = "") -> str:
    attribute = f'unit="{unit}"' if unit else ""
    return f'<ssv:Parameter name="{name}"><ssv:Real value="{value}" {attribute}/></ssv:Parameter>'


@pytest.fixture(scope="module")
def fmus(fmu_folder: Path, built: Callable[[Component], Path]) -> dict[str, Path]:
    return {"mass": built(mass()), "carried": built(carried()), "probe": probe(fmu_folder)}


@pytest.fixture
def write(tmp_path: Path) -> Callable[..., Path]:
    def write(body: str = "", bindings: str = "", inner: str = "", elements: str = "", head: str = "") -> Path:
        """An SSD with a probe each as `a` (with bindings `inner`) and `b`."""
        components = elements or (
            f'<ssd:Component name="a" source="resources/probe.fmu">{inner}</ssd:Component>'
            '<ssd:Component name="b" source="probe.fmu"/>'
        )
        text = (
            f'<?xml version="1.0"?>{head}<ssd:SystemStructureDescription {NAMESPACES}><ssd:System name="s">{bindings}'
            f"<ssd:Elements>{components}</ssd:Elements><ssd:Connections>{body}</ssd:Connections></ssd:System>"
            "</ssd:SystemStructureDescription>"
        )
        (tmp_path / "system.ssd").write_text(text)
        return tmp_path / "system.ssd"

    return write


def connection(start: str = "a", output: str = "through", end: str = "b", inner: str = "", more: str = "") -> str:
    return (
        f'<ssd:Connection startElement="{start}" startConnector="{output}" endElement="{end}" endConnector="u" {more}>'
        f"{inner}</ssd:Connection>"
    )


def binding(inside: str = "", attributes: str = "") -> str:
    one = f"<ssd:ParameterBinding {attributes}>{inside}</ssd:ParameterBinding>"
    return f"<ssd:ParameterBindings>{one}</ssd:ParameterBindings>"


def inline(parameters: str) -> str:
    return f"<ssd:ParameterValues>{PARAMETERS.format(parameters)}</ssd:ParameterValues>"


def test_a_system_is_read_with_parameters_inline_and_in_files(
    write: Callable[..., Path], fmus: dict[str, Path], tmp_path: Path
) -> None:
    """The set bound to the system wins over the component's; units are converted to the FMU's."""
    (tmp_path / "wind.bts").write_text("wind")
    (tmp_path / "set.ssv").write_text(
        PARAMETERS.format(
            real("slope", 3.0) + '<ssv:Parameter name="label"><ssv:String value="wind.bts"/></ssv:Parameter>'
        )
    )
    ssd = write(
        connection(inner='<ssc:LinearTransformation factor="2" offset="1"/>', more='suppressUnitConversion="true"'),
        bindings=binding(inline(real("a.mass", 2.0, "lb") + real("a.slope", 4.0))),
        inner=binding(attributes='source="set.ssv"'),
    )
    system = read_system(ssd, [fmus["probe"].parent])
    assert [c.fmu for c in system.components] == [fmus["probe"]] * 2
    checked = check(system)
    label = str((tmp_path / "wind.bts").resolve())
    assert checked.start[0]["mass"] == pytest.approx(0.90718474, rel=1e-15)
    assert (checked.start[0]["slope"], checked.start[0]["label"]) == (4.0, label)
    assert (checked.links[0].factor, checked.links[0].offset) == (2.0, 1.0)


def test_the_ssps_of_another_writer_are_read(fmus: dict[str, Path], tmp_path: Path) -> None:
    """A parameter set and a structure written by pyssp_standard."""
    from pyssp_standard.ssv import SSV

    with SSV(tmp_path / "other.ssv", "w") as ssv:
        ssv.add_parameter("a.mass", "Real", value=500.0, unit="g")
        ssv.add_unit("g", {"kg": "1", "factor": "0.001"})
    values = read_parameters(tmp_path / "other.ssv")
    system = with_parameters(System("s", (ComponentInstance("a", fmus["probe"]),)), values)
    assert check(system).start[0]["mass"] == pytest.approx(0.5, rel=1e-15)


DTD = '<!DOCTYPE x [<!ENTITY e SYSTEM "file:///etc/hostname">]>'
BAD_FILES = [
    ({"elements": '<ssd:Component name="a" source="none.fmu"/>'}, r"component 'a': none.fmu is not in .*build it"),
    ({"elements": '<ssd:Component name="a"/>'}, "component 'a' has no source"),
    ({"elements": '<ssd:SignalDictionaryReference name="d"/>'}, "SignalDictionaryReference 'd' is not supported"),
    ({"elements": '<ssd:Component name="a" source="probe.fmu"/>' * 2}, "component 'a' appears twice"),
    ({"inner": binding(attributes='source="lost.ssv"')}, r"lost.ssv: cannot be read \(no such file\)"),
    ({"inner": binding(inline("") + "<ssd:ParameterMapping/>")}, "ParameterMapping has neither source nor"),
    ({"inner": binding(attributes='source="http://elsewhere/x.ssv"')}, "is no path relative to the file"),
    ({"inner": binding(attributes='source="x.ssv" sourceBase="component"')}, "sourceBase='component' is not supported"),
    ({"inner": binding(inline(real("mass", 1.0, "furlong")))}, "parameter 'mass' = '1.0': unknown unit 'furlong'"),
    ({"bindings": binding(inline(real("c.mass", 1.0)))}, "'c.mass': no component 'c'"),
    ({"body": connection(inner='<ssc:IntegerMappingTransformation/>')}, "only LinearTransformation is"),
    ({"head": DTD}, "declares a document type; remove it"),
    ({"elements": "<open>"}, "cannot be read"),
]  # fmt: skip


@pytest.mark.parametrize(("parts", "words"), BAD_FILES)
def test_bad_files_are_refused(
    write: Callable[..., Path], fmus: dict[str, Path], parts: dict[str, str], words: str
) -> None:
    with pytest.raises(CosimError, match=words) as refused:
        read_system(write(**parts), [fmus["probe"].parent])
    assert "\n" not in str(refused.value)


def test_inputs_fed_from_outside_are_noted(write: Callable[..., Path], fmus: dict[str, Path]) -> None:
    loose = '<ssd:Connection startConnector="y" endElement="a" endConnector="u"/>'
    system = read_system(write(loose), [fmus["probe"].parent])
    assert system.connections == ()
    assert "a.u to the system's own connector 'y'" in system.notes[0]


def wired(fmus: dict[str, Path], *connections: Connection, **start: Value) -> System:
    values = {n: StartValue(v) for n, v in start.items()}
    components = (
        ComponentInstance("m", fmus["mass"]),
        ComponentInstance("p", fmus["probe"], values),
        ComponentInstance("c", fmus["carried"]),
    )
    return System("s", components, connections)


BAD_CONNECTIONS = [
    (Connection("x", "position", "p", "u"), "no component 'x'"),
    (Connection("m", "positon", "p", "u"), "did you mean 'position'"),
    (Connection("m", "position", "p", "you"), "p: no variable 'you' in probe.fmu"),
    (Connection("m", "force", "p", "u"), "force is no output but input; connect an output"),
    (Connection("m", "position", "p", "integral"), "integral is no input but output; connect to an input"),
    (Connection("m", "position", "p", "u"), "unit 'm' cannot be converted to 'deg'"),
    (Connection("m", "position", "p", "gate"), "Real cannot feed Boolean"),
    (Connection("p", "open", "p", "count"), "Boolean cannot feed Integer"),
    (Connection("p", "label", "p", "u"), "text cannot be connected"),
]


@pytest.mark.parametrize(("bad", "words"), BAD_CONNECTIONS)
def test_bad_connections_are_refused(fmus: dict[str, Path], bad: Connection, words: str) -> None:
    with pytest.raises(CosimError) as refused:
        check(wired(fmus, bad))
    assert words in str(refused.value)
    assert "\n" not in str(refused.value)


def test_two_sources_of_one_input_are_refused(fmus: dict[str, Path]) -> None:
    twice = (Connection("m", "position", "c", "point"), Connection("c", "position", "c", "point"))
    with pytest.raises(CosimError, match=r"c.point has two sources: m.position -> c.point and c.position -> c.point"):
        check(wired(fmus, *twice))


BAD_VALUES = [
    ({"masss": 1.0}, "p: no variable 'masss' in probe.fmu; did you mean 'mass'?"),
    ({"mass": 11.0}, "p.mass = 11.0: 11 kg is above its maximum 10"),
    ({"mass": -1.0}, "p.mass = -1.0: -1 kg is below its minimum 0"),
    ({"mass": math.inf}, "p.mass = inf: is not finite"),
    ({"mass": "heavy"}, "p.mass = heavy: is no Real"),
    ({"fail_status": 1.5}, "p.fail_status = 1.5: is no Integer"),
    ({"gate": 2}, "p.gate = 2: is no Boolean"),
    ({"label": 3}, "p.label = 3: is no String"),
    ({"through": 3.0}, "p.through = 3.0: is output and cannot be set"),
]


@pytest.mark.parametrize(("start", "words"), BAD_VALUES)
def test_bad_start_values_are_refused(fmus: dict[str, Path], start: dict[str, Value], words: str) -> None:
    with pytest.raises(CosimError) as refused:
        check(wired(fmus, **start))
    assert words in str(refused.value)


def test_changes_leave_the_original_alone(fmus: dict[str, Path]) -> None:
    system = two_masses(fmus["mass"], fmus["carried"])
    assert [c.name for c in without(system, "damper").components] == ["structure"]
    assert without(system, "damper").connections == ()
    tuned = with_parameters(system, {"damper.k": 4.0})
    assert check(tuned).start[1]["k"] == 4.0
    rules = [NameRule("point", "u"), NameRule("force", "through")]
    swapped = with_swapped(tuned, "damper", fmus["probe"], rules)
    assert swapped.component("damper").fmu == fmus["probe"]
    assert swapped.notes == ("damper: probe.fmu has no k, m, x_0: left out of its start values",)
    assert "k" not in system.component("damper").start
    for change in (lambda: without(system, "dampr"), lambda: with_swapped(system, "dampr", fmus["probe"])):
        with pytest.raises(CosimError, match="no component 'dampr'; did you mean 'damper'"):
            change()


def test_unconnected_inputs_are_listed_with_their_values(fmus: dict[str, Path]) -> None:
    warnings = check(wired(fmus, Connection("m", "position", "c", "point"), u=3.0)).warnings
    assert "p: not connected, start value used: u = 3.0, count = 0, gate = false" in warnings
    assert not any(w.startswith("c:") for w in warnings)


def test_the_structure_goes_first_and_no_loop_is_claimed(fmus: dict[str, Path]) -> None:
    """Whatever the order in the file: the damper's force follows the structure's position directly, not vice versa."""
    system = two_masses(fmus["mass"], fmus["carried"])
    backwards = System("s", system.components[::-1], system.connections)
    assert step_order(check(system)) == (0, 1)
    assert step_order(check(backwards)) == (1, 0)
    assert step_order(check(backwards), ["damper"]) == (0, 1)
    assert algebraic_loops(check(system)) == []


def test_a_loop_through_one_component_is_found(fmus: dict[str, Path]) -> None:
    checked = check(wired(fmus, Connection("p", "through", "p", "u")))
    (loop,) = algebraic_loops(checked)
    assert loop.path in ("p.through -> p.u -> p.through", "p.u -> p.through -> p.u")
    assert loop.inputs == {(1, "u")}


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda p: None, "No such file or directory; build it"),
        (lambda p: p.write_bytes(b"not a zip"), "cannot be read"),
        (lambda p: _archive(p, 'fmiVersion="3.0" modelName="x" instantiationToken="x"'), "cannot be read"),
        (lambda p: _archive(p, 'fmiVersion="2.0" modelName="x" guid="x"', "<ModelExchange modelIdentifier='x'/>"),
         "is model exchange; export it as FMI 2.0 or 3.0 for co-simulation"),
        (lambda p: _archive(p, 'fmiVersion="2.0" modelName="x" guid="x"', "<CoSimulation modelIdentifier='x'/>"),
         "has no binaries/.*; build it for this platform"),
    ],
)  # fmt: skip
def test_unusable_fmus_are_refused(tmp_path: Path, make: Callable[[Path], None], words: str) -> None:
    path = tmp_path / "bad.fmu"
    make(path)
    with pytest.raises(CosimError, match=words) as refused:
        read_fmu(path)
    assert str(path) in str(refused.value)
    assert "\n" not in str(refused.value)


def _archive(path: Path, attributes: str, kind: str = "") -> None:
    import zipfile

    text = (
        f"<fmiModelDescription {attributes}>{kind}<ModelVariables>"
        '<ScalarVariable name="y" valueReference="0"><Real/></ScalarVariable>'
        "</ModelVariables><ModelStructure/></fmiModelDescription>"
    )
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", text)


def test_shipped_systems_are_valid_ssp() -> None:
    """Against the schema of SSP 1.0 that FMPy brings: other tools refuse what is not."""
    from fmpy import ssp
    from lxml import etree

    schema = etree.XMLSchema(etree.parse(str(Path(ssp.__file__).parent / "schema" / "SystemStructureDescription.xsd")))
    files = sorted(case_folder().glob("*.ssd"))
    assert len(files) >= 3
    for file in files:
        schema.assertValid(etree.parse(str(file)))


def test_mechanical_ports_are_found_written_and_read(fmus: dict[str, Path], tmp_path: Path) -> None:
    """The barge's ports: where a force comes in, the velocity there, and the position of which it is the rate."""
    system = read_system(case_folder() / "barge.ssd", [build_library()[0]])
    ports = {p.name: p for p in system.ports}
    assert set(ports) == {"hydro", "mooring", "nacelle_damper", "platform_damper"}
    assert ("mooring.force[3]", "platform.velocity[3]", "platform.position[3]") in ports["mooring"].pairs
    assert ("nacelle_damper.moment[2]", "nacelle_damper.angular_velocity[2]", "") in ports["nacelle_damper"].pairs
    assert read_system(write_ssd(system, tmp_path / "again.ssd"), [build_library()[0]]).ports == system.ports
    assert without(system, "barge").ports == ()
    quantities = {e.rpartition(".")[2] for e, _, _ in ports["platform_damper"].pairs}
    assert quantities == {f"{q}[{i}]" for q in ("force", "moment") for i in (1, 2, 3)}


def test_all_of_a_liquid_column_does_work_at_its_port(tmp_path: Path) -> None:
    """Its moment about the body's x axis too, which our other dampers leave at zero.

    What the port's energy loses without that pair is the work of that moment: by the trapezium rule over the steps
    here, by Simpson's within them there, which differ by less than 1 %.
    """
    prepared = prepare(read_case("lc4"), "tlcd-p", Changes(until=8.0), quiet=True)
    names = ("platform_damper.moment[1]", "barge.platform_damper.angular_velocity[1]")
    settings = replace(prepared.settings, record=names, decimation=1)
    less = replace(
        prepared.system,
        ports=tuple(
            replace(p, pairs=tuple(q for q in p.pairs if q[0] != names[0])) for p in prepared.system.ports
        ),
    )  # fmt: skip
    whole, part = (
        simulate(s, settings, tmp_path / n) for s, n in ((prepared.system, "whole"), (less, "part"))
    )  # fmt: skip
    frame = whole.frame()
    work = trapezoid(np.abs(frame[names[0]] * frame[names[1]]), dx=settings.step)
    assert work > 10.0
    crossed = [r.ports["platform_damper"]["crossed"] for r in (whole, part)]
    assert crossed[0] - crossed[1] == pytest.approx(work, rel=0.01)
    assert check(prepare(read_case("lc4"), "mtmd", Changes(until=8.0), quiet=True).system).warnings == ()


@pytest.mark.parametrize(
    ("port", "words"),
    [
        (Port("p", "q", (("force", "velocity", ""),)), "port 'p': no component 'q'"),
        (Port("p", "m", (("position", "velocity", ""),)), "position must be an input of m, velocity an output"),
        (Port("p", "m", (("force", "position", ""),)), r"force \(N\) times position \(m\) is no power in W"),
    ],
)
def test_ports_that_make_no_power_are_refused(fmus: dict[str, Path], port: Port, words: str) -> None:
    system = System("s", (ComponentInstance("m", fmus["mass"]),), ports=(port,))
    with pytest.raises(CosimError, match=words):
        check(system)
