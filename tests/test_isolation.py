"""FMUs in their own processes: crashes and hangs become one-line errors, results stay the same to the last bit."""

from __future__ import annotations

import ctypes
import json
import os
import select
import subprocess
import sys
import zipfile
from collections.abc import Callable, Iterator
from ctypes import c_double, c_int, c_size_t, c_uint, c_void_p
from pathlib import Path

import fmpy
import numpy as np
import pytest

from cosim.errors import CosimError, RunFailed
from cosim.fmu import read_fmu
from cosim.isolation import IsolatedInstance, native
from cosim.layout import Algorithm
from cosim.recording import read_results
from cosim.run import RunSettings, simulate
from cosim.system import ComponentInstance, Connection, StartValue, System
from fmus_src.component import Component
from fmus_src.export.compiler import compile_shared

from .conftest import Outcome
from .cosim_fmus import carried, mass, probe, two_masses

ALL = ("*",)
# the faults of isolation_probe.c
FAULTS = ("none", "null", "exit", "hang", "error", "abort", "initialisation", "fatal", "get")
# a process that writes to address 0 is ended by a signal; Windows has none but names the exception
CRASH = "access violation" if sys.platform == "win32" else "SIG(SEGV|BUS|TRAP|ILL)"
LOST = r"the process of faulty\.fmu"
XML = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="faulty" guid="faulty">
<CoSimulation modelIdentifier="faulty" canHandleVariableCommunicationStepSize="true"
 canGetAndSetFMUstate="true" canBeInstantiatedOnlyOncePerProcess="true" providesDirectionalDerivative="true"/>
<ModelVariables>
<ScalarVariable name="u" valueReference="0" causality="input"><Real start="1"/></ScalarVariable>
<ScalarVariable name="x" valueReference="1" causality="output" initial="exact"><Real start="0"/></ScalarVariable>
<ScalarVariable name="fault_at" valueReference="2" causality="parameter" variability="fixed"><Real start="1e9"/>
</ScalarVariable>
<ScalarVariable name="gain" valueReference="3" causality="parameter" variability="fixed"><Real start="1"/>
</ScalarVariable>
<ScalarVariable name="fault" valueReference="0" causality="parameter" variability="fixed"><Integer start="0"/>
</ScalarVariable>
</ModelVariables>
<ModelStructure><Outputs><Unknown index="2" dependencies=""/></Outputs></ModelStructure>
</fmiModelDescription>
"""


@pytest.fixture(scope="module")
def faulty_fmu(fmu_folder: Path) -> Path:
    """The FMU of isolation_probe.c; it refuses to be instantiated twice in a process."""
    name = f"faulty{fmpy.sharedLibraryExtension}"
    headers = Path(fmpy.__file__).parent / "c-code"
    library = compile_shared([Path(__file__).with_name("isolation_probe.c")], fmu_folder / name, [headers])
    path = fmu_folder / "faulty.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", XML)
        archive.write(library, f"binaries/{fmpy.platform}/{name}")
    return path


def faulty(fmu: Path, fault: str) -> System:
    start = {"u": 1.0, "fault": FAULTS.index(fault), "fault_at": 0.05}
    return System("faulty", (ComponentInstance("valve", fmu, {k: StartValue(v) for k, v in start.items()}),))


@pytest.fixture
def instance(faulty_fmu: Path, tmp_path: Path) -> Iterator[IsolatedInstance]:
    folder = Path(fmpy.extract(str(faulty_fmu), str(tmp_path / "unpacked")))
    made = IsolatedInstance("valve", read_fmu(faulty_fmu), folder, 0.0)
    yield made
    made.free(terminate=False)


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ("null", rf"{LOST} died \({CRASH}\) at t = 0\.05 s in fmi2DoStep; it last printed 'a line on stdout at .*'"),
        ("exit", rf"{LOST} ended \(exit code 3\) at t = 0\.05 s in fmi2DoStep; it last printed 'a line on stdout .*'"),
        ("hang", rf"{LOST} did not answer within 1 s at t = 0\.05 s in fmi2DoStep; it last printed 'a line .*'"),
        ("error", r"fmi2DoStep returned fmi2Error at t = 0\.05 s: the valve is jammed"),
        ("fatal", r"fmi2DoStep returned fmi2Fatal at t = 0\.05 s; the FMU gave no reason"),
        ("abort", rf"{LOST} .* 0\.05 s in fmi2DoStep: pressure lost; it last printed '.* failed: pressure > 0'"),
        ("get", rf"{LOST} died \({CRASH}\) at t = 0 s in fmi2GetReal; it last printed 'a line on stdout at t = 0 s'"),
        ("initialisation", rf"{LOST} died \({CRASH}\) at t = 0 s in fmi2ExitInitializationMode"),
    ],
)  # fmt: skip
def test_a_fault_ends_the_run_with_one_line_and_not_the_program(
    faulty_fmu: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str], fault: str, words: str
) -> None:
    timeout = 1.0 if fault == "hang" else 60.0
    settings = RunSettings(stop=1.0, step=0.01, record=ALL, isolate=("valve",), call_timeout=timeout)
    with pytest.raises(RunFailed, match=rf"^valve: {words}$"):
        simulate(faulty(faulty_fmu, fault), settings, tmp_path / "run")
    assert json.loads((tmp_path / "run" / "run.json").read_text())["status"] == "failed"
    if "0.05" in words.replace("\\", ""):  # steps of 0.01 s until then; x = t
        kept = read_results(tmp_path / "run")["valve.x"]
        np.testing.assert_allclose(kept, np.arange(6) * 0.01, atol=1e-15)
    assert capfd.readouterr() == ("", "")  # what the FMU printed does not disturb the progress bars


def test_a_fault_is_found_in_a_component_that_nothing_is_read_from(faulty_fmu: Path, tmp_path: Path) -> None:
    """Its status comes a few steps late, or at the end of the run, but with the time of the failed step."""
    whole = faulty(faulty_fmu, "error")
    system = System("sink", (*whole.components, ComponentInstance("other", faulty_fmu)))
    for stop in (0.07, 1.0):
        settings = RunSettings(stop=stop, step=0.01, record=("other.x",), isolate=("valve",))
        with pytest.raises(RunFailed, match=r"^valve: fmi2DoStep returned fmi2Error at t = 0\.05 s: the valve is"):
            simulate(system, settings, tmp_path / f"run-{stop}")


@pytest.mark.parametrize(
    ("algorithm", "isolate"), [("gauss-seidel", ("damper", "b")), ("jacobi", ("structure", "a")), ("newton", ("all",))]
)
def test_results_are_the_same_to_the_last_bit(
    built: Callable[[Component], Path], fmu_folder: Path, tmp_path: Path, algorithm: Algorithm, isolate: tuple[str, ...]
) -> None:
    """FMUs that take slopes, keep states and differentiate; one that holds its inputs; integers and booleans."""
    system = two_masses(built(mass()), built(carried()))
    if algorithm != "newton":  # the probe cannot repeat a step
        foreign = probe(fmu_folder)
        links = (
            Connection("structure", "velocity", "a", "u", convert_units=False),
            Connection("a", "number", "b", "count"),
            Connection("b", "number", "a", "count"),
            Connection("a", "open", "b", "gate"),
        )
        probes = (ComponentInstance("a", foreign), ComponentInstance("b", foreign))
        system = System("mixed", (*system.components, *probes), (*system.connections, *links))
    frames = [
        simulate(
            system,
            RunSettings(stop=1.0, step=0.01, algorithm=algorithm, record=ALL, isolate=isolated),
            tmp_path / f"run{len(isolated)}",
        ).frame()
        for isolated in ((), isolate)
    ]
    assert frames[0]["structure.position"].abs().max() > 0.1
    assert frames[0].equals(frames[1])


def test_an_fmu_that_works_only_once_per_process_can_be_used_twice(faulty_fmu: Path, tmp_path: Path) -> None:
    system = System("two", (ComponentInstance("a", faulty_fmu), ComponentInstance("b", faulty_fmu)))
    with pytest.raises(CosimError, match=r"faulty\.fmu can be instantiated only once, but a and b use it"):
        simulate(system, RunSettings(stop=0.1, step=0.01, record=ALL), tmp_path / "no")
    last = simulate(system, RunSettings(stop=0.1, step=0.01, record=ALL, isolate=("b",)), tmp_path / "run").last
    assert last["a.x"] == last["b.x"] == pytest.approx(0.1)


def test_an_fmu_that_cannot_be_instantiated_says_why(faulty_fmu: Path, tmp_path: Path) -> None:
    folder = Path(fmpy.extract(str(faulty_fmu), str(tmp_path / "unpacked")))
    fmu = read_fmu(faulty_fmu)
    (folder / fmu.binary).write_bytes(b"no library")
    made = IsolatedInstance("valve", fmu, folder, 0.0)
    try:
        with pytest.raises(RunFailed, match=r"^valve: faulty\.fmu cannot be loaded: "):
            made.enter_initialisation()
    finally:
        made.free(terminate=False)


def test_unknown_components_and_timeouts_are_refused(faulty_fmu: Path, tmp_path: Path) -> None:
    system = faulty(faulty_fmu, "none")
    for settings, words in (
        (RunSettings(stop=0.1, step=0.01, record=ALL, isolate=("valv",)), "did you mean 'valve'"),
        (RunSettings(stop=0.1, step=0.01, record=ALL, call_timeout=0.0), "call timeout 0 s must be positive"),
    ):
        with pytest.raises(CosimError, match=words):
            simulate(system, settings, tmp_path / "run")


def test_states_and_directional_derivatives_cross_the_process(instance: IsolatedInstance) -> None:
    """x' = gain u: a step from a restored state repeats it; the derivative along (u: 2) is twice the gain."""
    instance.set({"gain": 3.0, "u": 0.5})
    instance.enter_initialisation()
    instance.exit_initialisation()
    dll, c = native.library(), instance.member()["instance"]
    assert c is not None
    component, x_reference, u_reference = c_void_p(c), (c_uint * 1)(1), (c_uint * 1)(0)

    def x() -> float:
        value = (c_double * 1)()
        assert dll.proxy_fmi2GetReal(component, x_reference, c_size_t(1), value) == 0
        return float(value[0])

    def step(time: float) -> None:
        assert dll.proxy_fmi2DoStep(component, c_double(time), c_double(0.1), c_int(0)) == 0

    states = [c_void_p(), c_void_p()]
    assert dll.proxy_fmi2GetFMUstate(component, ctypes.byref(states[0])) == 0
    step(0.0)
    once = x()
    assert once == 3.0 * 0.5 * 0.1
    assert dll.proxy_fmi2GetFMUstate(component, ctypes.byref(states[1])) == 0
    assert states[0].value != states[1].value
    for state, expected in ((states[0], 0.0), (states[1], once), (states[0], 0.0)):
        assert dll.proxy_fmi2SetFMUstate(component, state) == 0
        assert x() == expected
    step(0.0)
    assert x() == once
    for state in states:
        assert dll.proxy_fmi2FreeFMUstate(component, ctypes.byref(state)) == 0
        assert state.value is None
    derivative = (c_double * 1)()
    arguments = (x_reference, c_size_t(1), u_reference, c_size_t(1), (c_double * 1)(2.0), derivative)
    assert dll.proxy_fmi2GetDirectionalDerivative(component, *arguments) == 0
    assert derivative[0] == 6.0


@pytest.mark.skipif(not hasattr(os, "pidfd_open"), reason="needs Linux to watch a process that is not a child")
def test_the_process_ends_with_its_parent_even_while_the_fmu_hangs(faulty_fmu: Path, tmp_path: Path) -> None:
    folder = Path(fmpy.extract(str(faulty_fmu), str(tmp_path / "unpacked")))
    program = f"""
from pathlib import Path
from cosim.fmu import read_fmu
from cosim.layout import Algorithm
from cosim.isolation import IsolatedInstance, native
from ctypes import c_double, c_int, c_void_p
i = IsolatedInstance("valve", read_fmu(Path({str(faulty_fmu)!r})), Path({str(folder)!r}), 0.0)
i.set({{"fault": {FAULTS.index("hang")}, "fault_at": 0.0}})
print(i._process.pid, flush=True)
native.library().proxy_fmi2DoStep(c_void_p(i.member()["instance"]), c_double(0.0), c_double(0.1), c_int(0))
native.library().channel_synchronise(i._channel)
"""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    with subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, env=environment) as parent:
        assert parent.stdout is not None
        descriptor = os.pidfd_open(int(parent.stdout.readline()))
        try:
            assert not select.select([descriptor], [], [], 0.3)[0]  # it hangs
            parent.kill()
            assert select.select([descriptor], [], [], 10.0)[0]  # it looks once a second
        finally:
            os.close(descriptor)


def test_call_timeout(fowt: Callable[..., Outcome], faulty_fmu: Path, tmp_path: Path) -> None:
    values = {"u": 1.0, "fault": FAULTS.index("hang"), "fault_at": 0.05}
    words = [w for n, v in values.items() for w in ("--set", f"valve.{n}={v}")]
    ssp = tmp_path / "valve.ssp"
    with zipfile.ZipFile(ssp, "w") as package:
        package.write(faulty_fmu, "resources/faulty.fmu")
        package.writestr("SystemStructure.ssd", SSD)
    ended = fowt("run", "valve.ssp", *words, "--isolate", "valve", "--call-timeout", "1", "--format", "json")
    assert ended.code == 1
    assert "valve: the process of faulty.fmu did not answer within 1 s at t = 0.05 s" in json.loads(ended.out)["error"]
    for wrong, message in (
        (("--call-timeout", "1"), "--call-timeout is for components in processes of their own: add --isolate"),
        (("--call-timeout", "-1", "--isolate", "valve"), "call timeout -1 s must be positive"),
    ):
        assert message in fowt("run", "valve.ssp", *wrong).err


SSD = """<?xml version="1.0"?><ssd:SystemStructureDescription
 xmlns:ssd="http://ssp-standard.org/SSP1/SystemStructureDescription" version="1.0" name="valve">
<ssd:System name="valve"><ssd:Elements><ssd:Component name="valve" source="resources/faulty.fmu"/></ssd:Elements>
</ssd:System>
<ssd:DefaultExperiment startTime="0" stopTime="1"/></ssd:SystemStructureDescription>"""
