"""FMI 3.0: the same numbers as FMI 2.0, arrays, terminals, and descriptions that validate."""

from __future__ import annotations

import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import fmpy
import fmpy.fmi3
import fmpy.validation
import numpy as np
import pytest
from fmpy.fmi1 import FMICallException
from lxml import etree

from fmus_src.component import Component
from fmus_src.equations import derive
from fmus_src.export import build
from fmus_src.export.build import build_fmu
from fmus_src.export.exported import Exports, derivative_unit
from fmus_src.export.model_description import model_description
from fmus_src.export.model_description3 import model_description3
from fmus_src.export.sources import COMPILED
from fmus_src.export.terminals import terminals, terminals_and_icons
from fmus_src.instance import simulate
from fmus_src.library import component_names, make
from fmus_src.mooring.model import component as mooring
from fmus_src.servo.model import component as servo
from fmus_src.simplified.model import component as simplified
from fmus_src.tmd.model import component as tmd

from .conftest import every_feature
from .cosim_fmus import mass
from .loaded import Loaded, initialised

LICENCE = Path(__file__).parents[1] / "LICENSE"


class Slave:
    """A co-simulation instance of FMI 3.0, in step mode."""

    def __init__(self, path: Path, folder: Path, values: dict[str, Any] | None = None) -> None:
        self.open(path, folder)
        self.start(values)

    def open(self, path: Path, folder: Path) -> None:
        self.description = fmpy.read_model_description(str(path))
        fmpy.extract(str(path), unzipdir=str(folder))
        self.variables = {v.name: v for v in self.description.modelVariables}
        self.messages: list[str] = []
        self.slave = fmpy.fmi3.FMU3Slave(
            guid=self.description.guid, unzipDirectory=str(folder), instanceName="one",
            modelIdentifier=self.description.coSimulation.modelIdentifier,
        )  # fmt: skip

    def start(self, values: dict[str, Any] | None = None, **options: Any) -> None:
        self.slave.instantiate(logMessage=fmpy.fmi3.fmi3LogMessageCallback(self._log), **options)
        for name, value in (values or {}).items():
            self.set(name, value)
        self.slave.enterInitializationMode(startTime=0.0)
        self.slave.exitInitializationMode()

    def _log(self, environment: Any, status: int, category: bytes, message: bytes) -> None:
        self.messages.append(message.decode())

    def set(self, name: str, value: Any) -> None:
        self.slave.setFloat64([self.variables[name].valueReference], np.ravel(value).tolist())

    def get(self, *names: str) -> list[float]:
        size = sum(int(np.prod(self.variables[n].shape, dtype=int)) for n in names)
        return list(self.slave.getFloat64([self.variables[n].valueReference for n in names], size))


COURSES: dict[str, tuple[Callable[[], Component], dict[str, Callable[[float], Any]]]] = {
    "every_feature": (every_feature, {"u": lambda t: [np.sin(t), 0.3 * np.cos(2 * t)]}),
    "tmd": (tmd, {"attachment.specific_force": lambda t: [9.0 * np.sin(1.5 * t), 0.1, 9.81]}),
    "servo": (servo, {"generator.speed": lambda t: 118.0 + 3.0 * t}),
    "simplified": (simplified, {}),
    "mooring": (
        mooring,
        {
            "platform.position": lambda t: [4 * np.sin(t), t, 0.2],
            "platform.rotation": lambda t: [0.02, 0.05 * np.cos(t), 0.1],
        },
    ),
}


@pytest.mark.parametrize("name", COURSES)
def test_co_simulation_gives_the_bits_of_fmi_2(name: str, fmu_folder: Path, tmp_path: Path) -> None:
    """One runtime under both: held inputs, the same steps, not one bit of difference."""
    define, inputs = COURSES[name]
    given = {"initial_displacement": 7.9} if name == "tmd" else {}
    two = Loaded(build_fmu(define(), fmu_folder), tmp_path / "2")
    slave = initialised(two, given)
    three = Slave(build_fmu(define(), fmu_folder, fmi="3"), tmp_path / "3", given)
    outputs = [v.name for v in three.description.modelVariables if v.causality in ("output", "local")]
    outputs = [n for n in outputs if not n.startswith("event_indicators.")]
    elements = [e.element_names() for e in Exports(derive(define())).all if e.variable.name in outputs]
    references = two.vr(*(n for names in elements for n in names))
    for i in range(60):
        t = 0.03 * i
        for variable, course in inputs.items():
            value = np.ravel(course(t)).tolist()
            first = three.variables[variable].valueReference
            slave.setReal(list(range(first, first + len(value))), value)  # FMI 2.0 counts on from the same reference
            three.set(variable, value)
        slave.doStep(t, 0.03)
        three.slave.doStep(t, 0.03)
        assert three.get(*outputs) == slave.getReal(references)
    three.slave.freeInstance()
    slave.freeInstance()


def test_asks_for_inputs_within_the_step(fmu_folder: Path, tmp_path: Path) -> None:
    """A mass of 1 kg under the force sin t, told only when asked: x = t - sin t, whatever the communication step.

    Runge-Kutta of fourth order with steps of 1 ms errs by about 1e-13; a force held over 0.5 s by a tenth.
    """
    one = Slave.__new__(Slave)
    one.open(build_fmu(mass(), fmu_folder, fmi="3"), tmp_path)
    force, asked = one.variables["force"].valueReference, []

    def update(environment: Any, time: float, may_set: bool, *flags: Any) -> None:
        assert may_set
        asked.append(time)
        one.slave.setFloat64([force], [np.sin(time)])

    one.start(
        intermediateUpdate=fmpy.fmi3.fmi3IntermediateUpdateCallback(update), requiredIntermediateVariables=[force]
    )
    for n in range(4):
        one.slave.doStep(0.5 * n, 0.5)
        assert 0.5 * n <= min(asked) < max(asked) == pytest.approx(0.5 * (n + 1), abs=1e-12)
        asked.clear()
    assert one.get("position") == pytest.approx([2.0 - np.sin(2.0)], abs=1e-11)
    assert one.get("force") == [np.sin(2.0)]
    one.slave.freeInstance()


def test_what_cannot_be_intermediate(fmu_folder: Path, tmp_path: Path) -> None:
    """Some importers name outputs too: they are not offered within the step. What does not exist is refused."""
    one = Slave.__new__(Slave)
    one.open(build_fmu(mass(), fmu_folder, fmi="3"), tmp_path)
    never = fmpy.fmi3.fmi3IntermediateUpdateCallback(lambda *a: pytest.fail("asked"))
    one.start(intermediateUpdate=never, requiredIntermediateVariables=[one.variables["position"].valueReference])
    one.set("force", 1.0)
    one.slave.doStep(0.0, 1.0)
    assert one.get("position") == pytest.approx([0.5], rel=1e-12)
    with pytest.raises(Exception, match="Failed to instantiate"):
        one.start(intermediateUpdate=never, requiredIntermediateVariables=[999])
    assert "no such value reference: 999" in one.messages[-1]
    with pytest.raises(Exception, match="Failed to instantiate"):
        one.start(requiredIntermediateVariables=[one.variables["force"].valueReference])
    assert "no callback to set them" in one.messages[-1]


def test_agrees_with_python(fmu_folder: Path) -> None:
    given = {"stroke": 0.5, "initial_displacement": 1.0}
    expected = simulate(tmd(), stop=2.0, step=0.05, parameters=given)
    fmu = build_fmu(tmd(), fmu_folder, fmi="3")
    names = ["displacement", "velocity", "force"]
    result = fmpy.simulate_fmu(
        str(fmu), fmi_type="CoSimulation", stop_time=2.0, output_interval=0.05, start_values=given, output=names
    )
    # located crossings differ within 1e-10 of a sub-step; see test_export.py
    np.testing.assert_allclose(result["displacement"], expected["displacement"], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(result["force"], expected[[f"force[{i}]" for i in (1, 2, 3)]], rtol=1e-9, atol=1e-3)


def test_arrays_are_arrays(fmu_folder: Path, tmp_path: Path) -> None:
    one = Slave(build_fmu(every_feature(), fmu_folder, fmi="3"), tmp_path)
    matrix, x = one.variables["matrix"], one.variables["x"]
    assert matrix.shape == (2, 2)
    assert matrix.start == "1.0 2.0 3.0 4.0"
    assert x.shape == one.variables["der(x)"].shape == (2,)
    assert one.variables["der(x)"].derivative is x
    assert one.variables["event_indicators.beyond"].shape == (2,)
    assert one.get("x", "rotated") == [3.0, 1.0, 5.0, 13.0]
    assert one.get("time") == [0.0]
    assert one.slave.getInt32([one.variables["n"].valueReference]) == [3]
    assert one.slave.getBoolean([one.variables["on"].valueReference]) == [True]
    assert one.slave.getString([one.variables["file"].valueReference]) in ([b""], [""])
    u, root = one.variables["u"].valueReference, one.variables["root"].valueReference
    one.set("u", [0.42, -0.33])
    y = np.array(one.get("root"))
    exact = one.slave.getDirectionalDerivative([root], [u], [1.0, 2.0], 2)
    # y^3 + y = a: dy = da / (3 y^2 + 1)
    assert exact == pytest.approx(np.array([1.0, 2.0]) / (3 * y**2 + 1), rel=1e-9)
    one.slave.freeInstance()


@pytest.mark.parametrize(
    ("misuse", "words"),
    [
        (lambda s: s.slave.getFloat64([s.variables["x"].valueReference], 1), "too few values: the array of x[1] has 2"),
        (lambda s: s.slave.getFloat64([s.variables["x"].valueReference], 3), "3 values for 2 elements"),
        (lambda s: s.slave.getFloat64([s.variables["x"].valueReference + 1], 1), "no such value reference"),
        (lambda s: s.set("matrix", [1.0, 2.0, 3.0, 4.5]), "matrix[1,1] cannot be set after initialisation"),
        (lambda s: s.slave.getUInt64([0]), "no variable of that type"),
        (lambda s: s.slave.doStep(0.5, 0.1), "called for 0.5 s, but the FMU is at 0 s"),
        (lambda s: s.slave.enterEventMode(), "this is a co-simulation instance"),
    ],
)
def test_misuse_is_refused_with_a_message(
    fmu_folder: Path, tmp_path: Path, misuse: Callable[[Slave], object], words: str
) -> None:
    one = Slave(build_fmu(every_feature(), fmu_folder, fmi="3"), tmp_path)
    with pytest.raises(FMICallException):
        misuse(one)
    assert any(words in m for m in one.messages), one.messages
    one.slave.freeInstance()


def test_state_is_complete(fmu_folder: Path, tmp_path: Path) -> None:
    one = Slave(build_fmu(every_feature(), fmu_folder, fmi="3"), tmp_path)

    def advance() -> list[float]:
        for i in range(5):
            one.set("u", [0.1 * i, 0.5])
            one.slave.doStep(0.35 + 0.07 * i, 0.07)
        return one.get("x", "z", "root", "held")

    for i in range(5):
        one.slave.doStep(0.07 * i, 0.07)
    state = one.slave.getFMUState()
    stored = one.slave.serializeFMUState(state)
    first = advance()
    one.slave.setFMUState(one.slave.deserializeFMUState(stored))
    assert advance() == first
    one.slave.setFMUState(state)
    one.slave.reset()
    one.slave.enterInitializationMode(startTime=0.0)
    one.slave.exitInitializationMode()
    assert one.get("x") == [3.0, 1.0]
    one.slave.freeInstance()


@pytest.mark.parametrize("name", component_names())
def test_every_component_validates(name: str, tmp_path: Path) -> None:
    """Descriptions of both versions against the schemas and FMPy's rules, without compiling anything."""
    component = make(name)
    exports = Exports(derive(component))
    (tmp_path / "modelDescription.xml").write_text(model_description(exports, "{guid}", COMPILED["2"]))
    assert fmpy.validation.validate_fmu(str(tmp_path)) == []
    (tmp_path / "modelDescription.xml").write_text(model_description3(exports, "{guid}"))
    assert fmpy.validation.validate_fmu(str(tmp_path)) == []
    document = etree.fromstring(terminals_and_icons(exports.equations).encode())
    schema = Path(fmpy.__file__).parent / "schema/fmi3/fmi3TerminalsAndIcons.xsd"
    etree.XMLSchema(file=str(schema)).assertValid(document)
    names = {e.variable.name for e in exports.all}
    assert {m.get("variableName") for m in document.iter("TerminalMemberVariable")} <= names


def test_archive_has_what_the_standard_asks_for(fmu_folder: Path) -> None:
    path = build_fmu(tmd(), fmu_folder, fmi="3")
    assert path.name == "tmd-fmi3.fmu"
    assert fmpy.validation.validate_fmu(str(path)) == []
    assert fmpy.supported_platforms(str(path))[0] == "c-code"
    with zipfile.ZipFile(path) as archive:
        names = set(archive.namelist())
        for image in ("icon", "port"):
            assert archive.read(f"terminalsAndIcons/{image}.png").startswith(b"\x89PNG")
            assert etree.fromstring(archive.read(f"terminalsAndIcons/{image}.svg")).tag.endswith("svg")
    assert {"documentation/index.html", "documentation/licenses/license.txt", "sources/buildDescription.xml"} <= names
    assert {f"sources/{name}" for name in (*COMPILED["3"], "fmi3Functions.h")} <= names
    assert not any("fmi2" in name for name in names)
    with pytest.raises(ValueError, match="no FMI version '4'"):
        build_fmu(tmd(), fmu_folder, fmi="4")


def test_an_fmu_says_whose_it_is_and_how_long_to_run() -> None:
    """The component's own author and terms, else this project's; the text of the licence travels with the code."""
    own = Component("own", "A model of someone else's", author="A. Colleague", copyright="", license="proprietary")
    own.output("one", own.sym(1), description="a constant")
    (project,) = (line for line in LICENCE.read_text().splitlines() if line.startswith("Copyright"))
    for fmi in ("2", "3"):
        for component, expected in (
            (tmd(), {"author": "fowt-cosim", "copyright": project, "license": "MIT"}),
            (own, {"author": "A. Colleague", "license": "proprietary"}),
        ):
            files = build._content(component, fmi)
            root = etree.fromstring(files["modelDescription.xml"])
            assert {k: root.get(k) for k in ("author", "copyright", "license") if k in root.attrib} == expected
            text = files["documentation/licenses/license.txt"].decode()
            assert f"Licence: {expected['license']}" in text
            assert text.endswith(LICENCE.read_text())
            experiment = root.find("DefaultExperiment").attrib  # some tools would stop at 1 s
            assert (experiment["stopTime"], experiment["stepSize"]) == ("60", "0.0125")


def test_terminals_are_the_mechanical_ports() -> None:
    """Ports that meet have the same members where they connect, one the force's giver, the other its taker."""
    of = {
        name: {t.name: t for t in terminals(derive(make(name)))} for name in ("barge", "hydro", "tmd", "mtmd", "aero")
    }
    pairs = [("hydro", "hydro", "platform"), ("nacelle_damper", "tmd", "attachment"), ("aero", "aero", "hub")]
    pairs += [("nacelle_damper", "mtmd", "unit1.attachment"), ("tower", "aero", "tower")]
    for port, other, place in pairs:
        taker, giver = of["barge"][port], of[other][place]
        assert taker.takes_force
        assert not giver.takes_force
        common = taker.members.keys() & giver.members.keys()
        assert {"force", "moment"} <= common
        assert common >= giver.members.keys()  # all that the giver's side needs is there
    assert of["barge"]["hydro"].members["velocity"] == "platform.velocity"
    assert of["barge"]["aero"].members["velocity"] == "hub.velocity"
    assert of["hydro"]["platform"].members["added_mass"] == "added_mass"
    assert terminals(derive(servo())) == []


def test_units_of_derivatives() -> None:
    expected = {"m": "m/s", "m/s": "m/s2", "m/s2": "m/s3", "1": "1/s", "rad/s": "rad/s2", "N.m/rad": "N.m/rad/s"}
    assert {u: derivative_unit(u) for u in expected} == expected


def test_versions_differ_in_guid(monkeypatch: pytest.MonkeyPatch) -> None:
    """A state or a token of one is none of the other."""
    two, three = (build._content(tmd(), fmi)["sources/model.c"] for fmi in ("2", "3"))
    assert two != three
