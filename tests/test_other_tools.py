"""Our FMUs and packages in tools of others, and theirs in ours: Ecos, FMU Manipulation Toolbox, PythonFMU3.

Each test needs its tool (`pip install ecospy tbb fmu-manipulation-toolbox pythonfmu3`) and is left out without it.
"""

from __future__ import annotations

import ctypes
import logging
import os
import shutil
import subprocess
import sys
import sysconfig
import zipfile
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pandas as pd
import pytest

from cosim.case import read_case
from cosim.checks import check
from cosim.cli.run import Changes, prepare
from cosim.inspection import inspect
from cosim.run import RunSettings, simulate
from cosim.ssp_writer import write_package
from cosim.system import System
from cosim.validation import validate
from fmus_src.equations import derive
from fmus_src.export.build import build_fmu
from fmus_src.export.compiler import compile_shared
from fmus_src.export.exported import Exports
from fmus_src.export.model_description import model_description
from fmus_src.export.model_description3 import model_description3
from fmus_src.export.sources import COMPILED, source_files
from fmus_src.library import make

from .cosim_fmus import carried, mass

STEP, STOP = 0.0125, 5.0  # s
VECTORS = ("attachment.specific_force", "attachment.angular_velocity", "attachment.angular_acceleration")
SHOWN = (
    "barge.platform.rotation[2]", "nacelle_damper.displacement", "platform_damper.displacement",
    "nacelle_damper.force[1]",
)  # fmt: skip


@dataclass(frozen=True)
class Decay:
    """The 5 deg decay with two dampers, as our master steps it with inputs held over each step."""

    system: System
    settings: RunSettings
    frame: Any

    def package(self, folder: Path) -> Path:
        return write_package(self.system, self.settings, folder / "decay.ssp")


@pytest.fixture(scope="module")
def decay(tmp_path_factory: pytest.TempPathFactory) -> Decay:
    prepared = prepare(read_case("decay5"), "mtmd", Changes(until=STOP), quiet=True)
    settings = replace(
        prepared.settings, channels=(), record=SHOWN, decimation=1, algorithm="jacobi", extrapolation="held"
    )
    frame = simulate(prepared.system, settings, tmp_path_factory.mktemp("decay") / "ours").frame()
    assert frame["platform_damper.displacement"].abs().max() > 2.0
    return Decay(prepared.system, settings, frame)


def assert_same(theirs: Any, ours: Any) -> None:
    """Same FMUs, same calls, but for times: theirs are sums of steps, which differ from ours in the last bits.

    Measured: 1e-14 of the largest value over 60 s.
    """
    assert len(theirs) == len(ours)
    np.testing.assert_allclose(theirs, ours, rtol=0, atol=1e-11 * np.abs(ours).max())


# --- Ecos: FMI 2.0, FMI 3.0 without arrays, SSP 1.0 ---


@pytest.fixture
def ecos() -> Any:
    """Its binary wants libtbb.so.12, which the wheel `tbb` brings where the system has none."""
    with suppress(OSError):
        ctypes.CDLL(str(Path(sysconfig.get_path("data")) / "lib/libtbb.so.12"), mode=ctypes.RTLD_GLOBAL)
    try:
        import ecospy
    except (ImportError, OSError) as reason:
        pytest.skip(f"Ecos cannot be loaded: {reason}")
    ecospy.EcosLib.set_log_level("err")
    return ecospy


def stepped(simulation: Any, names: Sequence[str], steps: int) -> Any:
    rows = []
    for _ in range(steps):
        simulation.step(1)
        rows.append([simulation.get_real(name.replace(".", "::", 1)) for name in names])
    return np.array(rows)


@pytest.mark.parametrize("fmi", ["2", "3"])
def test_ecos_moves_a_damper(ecos: Any, fmi: str, fmu_folder: Path) -> None:
    """A free decay from 2 m. Of FMI 3.0 Ecos 0.7.2 knows scalars only: no array is read here."""
    fmu, names = build_fmu(make("tmd"), fmu_folder, fmi=fmi), ["displacement", "velocity"]
    with ecos.EcosSimulationStructure() as structure:
        structure.add_model("damper", str(fmu))
        structure.add_parameter_set("start", {"damper::initial_displacement": 2.0, "damper::k": 7000.0})
        with ecos.EcosSimulation(structure=structure, step_size=STEP) as simulation:
            assert simulation.init(parameter_set="start")
            rows = stepped(simulation, [f"damper.{n}" for n in names], 400)
            simulation.terminate()
    expected = fmpy.simulate_fmu(
        str(fmu), fmi_type="CoSimulation", stop_time=STOP, step_size=STEP, output_interval=STEP,
        start_values={"initial_displacement": 2.0, "k": 7000.0}, output=names,
    )  # fmt: skip
    for i, name in enumerate(names):
        assert_same(rows[:, i], expected[name][1:])


def test_ecos_runs_our_package(ecos: Any, decay: Decay, tmp_path: Path) -> None:
    package = decay.package(tmp_path)
    with ecos.EcosSimulation(ssp_path=str(package), step_size=STEP) as simulation:
        assert simulation.init(parameter_set="parameters")
        rows = stepped(simulation, SHOWN, round(STOP / STEP))
        simulation.terminate()
    for i, name in enumerate(SHOWN):
        assert_same(rows[:, i], decay.frame[name].to_numpy()[1:])


# --- FMU Manipulation Toolbox: checkers, and containers that step FMUs inside an FMU ---


@pytest.fixture
def toolbox() -> Iterator[None]:
    pytest.importorskip("fmu_manipulation_toolbox")
    logging.getLogger("fmu_manipulation_toolbox").setLevel(logging.CRITICAL)
    yield
    logging.getLogger("fmu_manipulation_toolbox").setLevel(logging.NOTSET)


@pytest.mark.parametrize("name", ["tmd", "servo", "hydro", "mooring"])
@pytest.mark.usefixtures("toolbox")
def test_the_toolbox_finds_nothing_in_our_descriptions(name: str, tmp_path: Path) -> None:
    """Its checks of schema and semantics (FMI 2.0.5, FMI 3.0.2), on a component with switches, one with samples, one
    with texts and one with implicit equations; a description without `guid` shows that they bite.
    """
    from fmu_manipulation_toolbox.checker import OperationGenericCheck, OperationSemanticCheck
    from fmu_manipulation_toolbox.operations import FMU

    def verdict(text: str, path: Path) -> tuple[str | None, list[str]]:
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("modelDescription.xml", text)
        schema, semantics = OperationGenericCheck(), OperationSemanticCheck()
        with FMU(str(path)) as fmu:
            fmu.apply_operation(schema)
            fmu.apply_operation(semantics)
        return schema.compliant_with_version, semantics.errors

    exports = Exports(derive(make(name)))
    two, three = model_description(exports, "{guid}", COMPILED["2"]), model_description3(exports, "{guid}")
    assert verdict(two, tmp_path / "two.fmu") == ("2.0", [])
    assert verdict(three, tmp_path / "three.fmu") == ("3.0", [])
    assert verdict(two.replace('guid="{guid}"', ""), tmp_path / "bad.fmu")[0] is None


def container(decay: Decay, folder: Path, fmi: int, with_arrays: bool) -> Path:
    """The decay as one FMU: FMI `fmi` outside; inside FMI 2.0, dampers FMI 3.0 if `with_arrays`."""
    from fmu_manipulation_toolbox.assembly import Assembly

    assembly = Assembly(decay.package(folder).name, default_step_size=STEP, fmu_directory=folder)
    root = assembly.root
    inside = dict(zip((c.name for c in decay.system.components), root.fmu_names_list, strict=True))
    for name, start in zip(inside, check(decay.system).start, strict=True):  # it reads no parameter sets
        for parameter, value in start.items():
            text = str(value).lower() if isinstance(value, bool) else str(value)
            root.add_start_value(inside[name], parameter, text)
    if with_arrays:
        shutil.copy(build_fmu(make("tmd"), folder, fmi="3"), folder / "decay.dir/tmd.fmu")
        dampers = {inside[n] for n in inside if n.endswith("_damper")}
        elements = [c for c in root.links if {c.from_port.fmu_name, c.to_port.fmu_name} & dampers]
        root.links = [c for c in root.links if c not in elements]
        ends = [(end.fmu_name, end.port_name.partition("[")[0]) for c in elements for end in (c.from_port, c.to_port)]
        for link in dict.fromkeys(zip(ends[::2], ends[1::2], strict=True)):
            root.add_link(*link[0], *link[1])  # whole arrays
    for i, name in enumerate(SHOWN[:3]):
        owner, _, variable = name.partition(".")
        root.add_output(inside[owner], variable, f"shown{i}")
    assembly.make_fmu(fmi_version=fmi)
    return folder / "decay.fmu"


@pytest.mark.parametrize(("fmi", "with_arrays"), [(2, False), (3, True)])
@pytest.mark.usefixtures("toolbox")
def test_a_container_computes_the_same(decay: Decay, tmp_path: Path, fmi: int, with_arrays: bool) -> None:
    """The system in one FMU of theirs: its master steps our FMUs in parallel, inputs held.

    With arrays the dampers are FMI 3.0, linked as whole vectors to the barge's elements `name[1]` of FMI 2.0.
    """
    path = container(decay, tmp_path, fmi, with_arrays)
    names = [f"shown{i}" for i in range(3)]
    rows = fmpy.simulate_fmu(str(path), stop_time=STOP, step_size=STEP, output_interval=STEP, output=names)
    for name, ours in zip(names, SHOWN, strict=False):
        assert_same(rows[name], decay.frame[ours].to_numpy())


@pytest.mark.usefixtures("toolbox")
def test_a_damper_comes_back_in_a_container(decay: Decay, tmp_path: Path) -> None:
    """Our damper in an FMU of theirs in our master: the same bits, since the container's step is the master's."""
    from fmu_manipulation_toolbox.assembly import Assembly, AssemblyNode

    own = next(c.fmu for c in decay.system.components if c.name == "nacelle_damper")
    shutil.copy(own, tmp_path / "tmd.fmu")
    assembly = Assembly(fmu_directory=tmp_path)
    assembly.root = AssemblyNode("packed.fmu", step_size=STEP, auto_parameter=True)
    assembly.root.add_fmu("tmd.fmu")
    assembly.make_fmu()
    packed = tmp_path / "packed.fmu"
    assert {f.name: f.status for f in validate(packed)}["smoke run"] == "ok"
    parameters = ("m", "k", "c", "stroke", "k_stop", "c_stop")
    rules = tuple(f"nacelle_damper.{n}=tmd.{n}" for n in parameters)
    changes = Changes(swap=(f"nacelle_damper={packed}",), map=rules, until=STOP)
    swapped = prepare(read_case("decay5"), "mtmd", changes, quiet=True).system
    frame = simulate(swapped, replace(decay.settings, record=SHOWN[::2]), tmp_path / "run").frame()
    for name in SHOWN[::2]:
        assert frame[name].tolist() == decay.frame[name].tolist()


# --- tools that compile the sources of all FMUs into one program (real-time and embedded targets) ---


@pytest.mark.parametrize("fmi", ["2", "3"])
def test_sources_of_two_fmus_go_into_one_program(fmi: str, tmp_path: Path) -> None:
    """FMI's functions under the standard's prefix; the linker would refuse any other name that both have."""
    sources = []
    for component in (mass(), carried()):
        name, folder = component.name, tmp_path / component.name
        folder.mkdir()
        for file, text in source_files(Exports(derive(component)), "{guid}", fmi).items():
            (folder / file).write_text(text)
        for file in COMPILED[fmi]:
            prefixed = tmp_path / f"{name}_{file}"
            prefixed.write_text(
                f"#define FMI{fmi}_FUNCTION_PREFIX {name}_\n"
                '#define FMI3_Export __attribute__((visibility("default")))\n'  # so that this test finds them
                f'#include "{name}/{file}"\n'
            )
            sources.append(prefixed)
    library = ctypes.CDLL(str(compile_shared(sources, tmp_path / "both.so")))
    for name in ("mass", "carried"):
        version = getattr(library, f"{name}_fmi{fmi}GetVersion")
        version.restype = ctypes.c_char_p
        assert version() == f"{fmi}.0".encode()


# --- PythonFMU3: a damper of FMI 3.0 in Python, with arrays, names and units of its own ---


@pytest.fixture(scope="module")
def theirs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("pythonfmu3")
    folder, source = tmp_path_factory.mktemp("pythonfmu3"), Path(__file__).with_name("foreign_damper3.py")
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
    words = [sys.executable, "-m", "pythonfmu3", "build", "-f", str(source), "-d", str(folder)]
    subprocess.run(words, check=True, capture_output=True, env=environment)
    return folder / "ForeignDamper3.fmu"


def test_a_damper_of_fmi_3_is_usable(theirs: Path) -> None:
    about = inspect(theirs)
    assert about["fmi"] == "3.0"
    assert list(about["interfaces"]) == ["CoSimulation"]
    findings = {f.name: f.status for f in validate(theirs)}
    assert findings.pop("state restored") == "skipped"  # it cannot save its state
    assert set(findings.values()) == {"ok"}


def course(names: Sequence[str], scales: Sequence[float]) -> Any:
    """Inputs of a damper in a body that pitches by 5 deg with 11.6 s: time, and a vector for each name."""
    t = np.arange(0.0, STOP, STEP)
    w = 2 * np.pi / 11.6
    rows = np.zeros(len(t), dtype=[("time", float), *((n, float, (3,)) for n in names)])
    rows["time"] = t
    rows[names[0]][:, 0], rows[names[0]][:, 2] = 2.5 * np.cos(w * t) * scales[0], 9.80665 * scales[0]
    rows[names[1]][:, 1] = -0.0873 * w * np.sin(w * t) * scales[1]
    rows[names[2]][:, 1] = -0.0873 * w**2 * np.cos(w * t) * scales[2]
    return rows


def test_a_damper_of_fmi_3_moves_as_ours(theirs: Path, fmu_folder: Path) -> None:
    """Held inputs; their Runge-Kutta of fourth order at 2 ms beside ours at 12.5 ms: (omega h)^4, 1e-9 (measured)."""
    degrees, ours = 180.0 / np.pi, build_fmu(make("tmd"), fmu_folder, fmi="3")
    options: dict[str, Any] = {
        "fmi_type": "CoSimulation", "stop_time": STOP, "step_size": STEP, "output_interval": STEP,
    }  # fmt: skip
    expected = fmpy.simulate_fmu(
        str(ours), input=course(VECTORS, (1.0, 1.0, 1.0)), output=["displacement", "force", "moment"], **options
    )
    pushed = course(("a", "w", "dw"), (1e3, degrees, degrees))
    with ProcessPoolExecutor(1, get_context("spawn")) as pool:  # their interpreter is none of this process
        rows = pool.submit(
            fmpy.simulate_fmu, str(theirs), input=pushed, output=["travel", "F", "M"], **options
        ).result()  # fmt: skip
    assert 5.0 < np.abs(expected["displacement"]).max() < 8.0  # no stop
    for a, b, unit in (("displacement", "travel", 1e-3), ("force", "F", 1e3), ("moment", "M", 1e3)):
        np.testing.assert_allclose(rows[b] * unit, expected[a], rtol=0, atol=1e-8 * np.abs(expected[a]).max())


def test_a_damper_of_fmi_3_in_our_system(theirs: Path, fowt: Callable[..., Any], tmp_path: Path) -> None:
    """Swapped in, arrays as a whole; inputs vary within our steps and are held over theirs: 1e-5 measured."""
    from .foreign_damper3 import NAMES

    maps = [word for name, other in NAMES.items() for word in ("--map", f"nacelle_damper.{name}={other}")]
    words = ["run", "decay5", "--damper", "mtmd", "--until", "3", "--energy-tolerance", "0"]
    # in a process of its own: an embedded interpreter in this one would be another test's concern
    swap = ["--swap", f"nacelle_damper={theirs}", "--isolate", "nacelle_damper", *maps]
    assert fowt(*words, *swap, "--out", "theirs").code == 0
    assert fowt(*words, "--out", "ours").code == 0
    ours, other = (pd.read_parquet(tmp_path / n / "results.parquet") for n in ("ours", "theirs"))
    for channel in ("NStC1_XQ", "PtfmPitch", "TTDspFA"):
        assert np.abs(other[channel] - ours[channel]).max() < 1e-4 * ours[channel].abs().max()
