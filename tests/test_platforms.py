"""One machine builds for five platforms; what can be run here gives the same numbers; sources rebuild elsewhere."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path

import fmpy
import fmpy.build
import numpy as np
import pytest
from platformdirs import user_cache_path

from fmus_src.export.build import build_fmu
from fmus_src.export.platforms import PLATFORMS, native_platform, platforms_named
from fmus_src.export.sources import fmi_headers
from fmus_src.export.universal import universal
from fmus_src.tmd.model import component as tmd

from .binaries import read_library
from .conftest import Outcome

VERSIONS = pytest.mark.parametrize("fmi", ["2", "3"])
SYSTEM = {
    "linux": {"libc.so.6", "libm.so.6"},
    "windows": {"KERNEL32.dll", "api-ms-win-crt-*"},
    "macos": {"/usr/lib/libSystem.B.dylib"},
}
LINKERS_OWN = {"__dso_handle", "_mh_dylib_header"}  # marks in every library of macOS
ARM_LIBRARIES = Path("/usr/aarch64-linux-gnu")  # Debian's libc6-arm64-cross


@pytest.fixture(scope="module")
def everywhere(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The damper for all platforms, unpacked, by version of FMI."""
    folder = tmp_path_factory.mktemp("everywhere")
    unpacked = {}
    for fmi in ("2", "3"):
        with zipfile.ZipFile(build_fmu(tmd(), folder, fmi=fmi, platforms=platforms_named(["all"]))) as archive:
            archive.extractall(folder / fmi)
        unpacked[fmi] = folder / fmi
    return unpacked


@VERSIONS
def test_five_platforms_in_one_fmu(fmi: str, everywhere: dict[str, Path]) -> None:
    """Each library is of its processor, exports the functions of FMI and no other, and needs the system only."""
    folder = everywhere[fmi] / "binaries"
    headers = (fmi_headers() / f"fmi{fmi}Functions.h").read_text()
    for p in PLATFORMS.values():
        system, _, processor = p.name.partition("-")
        found = {x.processor: x for x in read_library(folder / (p.fmi2 if fmi == "2" else p.fmi3) / f"tmd{p.suffix}")}
        library = found[processor]
        assert len(found) == (2 if (system, fmi) == ("macos", "2") else 1)  # FMI 2.0 has one folder for both: universal
        assert {f"fmi{fmi}DoStep", f"fmi{fmi}SetContinuousStates", f"fmi{fmi}GetEventIndicators"} <= library.exports
        names = library.exports - LINKERS_OWN
        assert all(name.startswith(f"fmi{fmi}") and f" {name};" in headers for name in names), names
        needs = {"api-ms-win-crt-*" if n.startswith("api-ms-win-crt-") else n for n in library.needs}
        assert needs <= SYSTEM[system]
        assert library.signed or (system, processor) != ("macos", "aarch64")  # Apple's processors run no other
    assert sum(1 for f in folder.rglob("*") if f.is_file()) == (4 if fmi == "2" else 5)


def test_every_function_of_the_standard_is_there(everywhere: dict[str, Path]) -> None:
    for fmi, folder in (("2", "linux64"), ("3", "x86_64-linux")):
        lines = (fmi_headers() / f"fmi{fmi}Functions.h").read_text().splitlines()
        declared = {line.split()[-1].rstrip(";") for line in lines if line.strip().startswith(f"FMI{fmi}_Export")}
        assert len(declared) > 40
        (library,) = read_library(everywhere[fmi] / "binaries" / folder / "tmd.so")
        assert library.exports == declared


def drive(fmi: str, everywhere: dict[str, Path], target: str, folder: Path, *runner: str, **environment: str) -> object:
    """Numbers that a program of the target's own prints, which loads the library; shape (100, 9)."""
    p = PLATFORMS[target]
    suffix = ".exe" if target.startswith("windows") else ""
    program = folder / f"driver-{target}{suffix}"
    source = str(Path(__file__).with_name("platform_driver.c"))
    compiler = [sys.executable, "-m", "ziglang", "cc", "-std=c99", "-O1", "-target", p.compiler_target]
    libraries = [] if suffix else ["-ldl"]
    subprocess.run([*compiler, f"-I{fmi_headers()}", source, *libraries, "-o", str(program)], check=True)
    description = fmpy.read_model_description(str(everywhere[fmi]))
    reference = {v.name: v.valueReference for v in description.modelVariables}
    names = ("force", "moment", "stop_force", "displacement", "velocity")
    first = [reference.get(name, reference.get(f"{name}[1]")) for name in names]
    start = first[0]
    read = range(start, start + 9) if fmi == "2" else first
    push = reference.get("attachment.specific_force", reference.get("attachment.specific_force[1]"))
    library = everywhere[fmi] / "binaries" / (p.fmi2 if fmi == "2" else p.fmi3) / f"tmd{p.suffix}"
    words = [library, fmi, description.guid, reference["initial_displacement"], push, 9, *read]
    ran = subprocess.run(
        [*runner, str(program), *map(str, words)], capture_output=True, text=True, timeout=300, check=False,
        env=os.environ | environment,
    )  # fmt: skip
    assert ran.returncode == 0, ran.stdout[-500:] + ran.stderr[-500:]
    return np.array([line.split() for line in ran.stdout.splitlines()], dtype=float)


@pytest.fixture(scope="module")
def here(everywhere: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> object:
    return drive("2", everywhere, native_platform().name, tmp_path_factory.mktemp("here"))


@VERSIONS
@pytest.mark.skipif(shutil.which("wine") is None, reason="needs Wine")
def test_windows_library_under_wine(fmi: str, everywhere: dict[str, Path], here: object, tmp_path: Path) -> None:
    """Bit for bit: the damper's equations are sums and products, which IEEE 754 rounds alike everywhere."""
    prefix = user_cache_path("fowt-cosim", ensure_exists=True) / "wine"  # kept: making one takes a minute
    settings = {"WINEPREFIX": str(prefix), "WINEDEBUG": "-all", "DISPLAY": "", "WINEDLLOVERRIDES": "mscoree,mshtml="}
    found = drive(fmi, everywhere, "windows-x86_64", tmp_path, shutil.which("wine") or "", **settings)
    np.testing.assert_array_equal(found, here)


@VERSIONS
@pytest.mark.skipif(
    shutil.which("qemu-aarch64-static") is None or not ARM_LIBRARIES.exists(), reason="needs qemu and an ARM libc"
)
def test_arm_library_under_qemu(fmi: str, everywhere: dict[str, Path], here: object, tmp_path: Path) -> None:
    runner = ("qemu-aarch64-static", "-L", str(ARM_LIBRARIES))
    np.testing.assert_array_equal(drive(fmi, everywhere, "linux-aarch64", tmp_path, *runner), here)


@VERSIONS
def test_both_versions_by_a_c_importer(fmi: str, everywhere: dict[str, Path], here: object, tmp_path: Path) -> None:
    values = np.asarray(here)
    assert (values[:, 6] != 0.0).any()  # it met a stop
    np.testing.assert_array_equal(drive(fmi, everywhere, native_platform().name, tmp_path), values)


def run_in(folder: Path, fmi: str) -> object:
    options = {"start_values": {"initial_displacement": 8.5}, "stop_time": 1.0, "output_interval": 0.05}
    return fmpy.simulate_fmu(str(folder), fmi_type="CoSimulation", output=["displacement", "stop_force"], **options)


@VERSIONS
@pytest.mark.skipif(shutil.which("gcc") is None, reason="needs gcc")
def test_sources_rebuild_with_a_plain_compiler(fmi: str, everywhere: dict[str, Path], tmp_path: Path) -> None:
    """`gcc` with the files that the description names, nothing else."""
    folder = tmp_path / "tmd"
    shutil.copytree(everywhere[fmi], folder)
    expected = run_in(folder, fmi)
    library = folder / "binaries" / ("linux64" if fmi == "2" else "x86_64-linux") / "tmd.so"
    shutil.rmtree(folder / "binaries")
    library.parent.mkdir(parents=True)
    (configuration,) = fmpy.read_model_description(str(folder)).buildConfigurations
    files = configuration.sourceFileSets[0].sourceFiles
    command = ["gcc", "-O2", "-shared", "-fPIC", "-o", str(library), *files, "-lm"]
    subprocess.run(command, cwd=folder / "sources", check=True, capture_output=True)
    found = run_in(folder, fmi)
    # Another compiler may order sums differently: rounding, magnified by the stop.
    np.testing.assert_allclose(found["displacement"], expected["displacement"], rtol=1e-10)


@VERSIONS
@pytest.mark.skipif(shutil.which("cmake") is None or shutil.which("gcc") is None, reason="needs CMake and a compiler")
def test_sources_rebuild_with_fmpy(fmi: str, everywhere: dict[str, Path], tmp_path: Path) -> None:
    """As `fmpy compile` does, by CMake."""
    folder = tmp_path / "tmd"
    shutil.copytree(everywhere[fmi], folder)
    expected = run_in(folder, fmi)
    shutil.rmtree(folder / "binaries")
    build = tmp_path / "build"
    build.mkdir()
    fmpy.build.build_platform_binary(folder, build)
    found = run_in(folder, fmi)
    np.testing.assert_allclose(found["displacement"], expected["displacement"], rtol=1e-10)


def test_platforms_by_name() -> None:
    assert platforms_named([]) == platforms_named(["native"]) == (native_platform(),)
    assert platforms_named(["all"]) == tuple(PLATFORMS.values())
    two = platforms_named(["windows-x86_64", "linux-aarch64", "windows-x86_64"])
    assert [p.name for p in two] == ["linux-aarch64", "windows-x86_64"]
    with pytest.raises(ValueError, match="no platform 'windows'"):
        platforms_named(["windows"])
    with pytest.raises(ValueError, match="not a 64-bit Mach-O"):
        universal([b"\x7fELF" + bytes(60)])


def test_build_command(fowt: Callable[..., Outcome]) -> None:
    """Both versions for all platforms, and one line where a word is wrong."""
    built = fowt("build", "tmd", "--fmi", "2,3", "--platform", "all", "--out", "made")
    assert built.code == 0, built.err
    with zipfile.ZipFile("made/tmd.fmu") as two, zipfile.ZipFile("made/tmd-fmi3.fmu") as three:
        assert {"binaries/win64/tmd.dll", "binaries/linux64/tmd.so"} <= set(two.namelist())
        assert {"binaries/x86_64-windows/tmd.dll", "binaries/x86_64-linux/tmd.so"} <= set(three.namelist())
    named = fowt("build", "tmd", "--fmi", "3", "--name", "mine", "--format", "json")
    assert '"tmd": "fmus/mine.fmu"' in named.out
    wrong = fowt("build", "tmd", "--platform", "amiga")
    assert wrong.code == 1
    assert "--platform amiga: no platform 'amiga': there are linux-x86_64" in wrong.err
    assert "--fmi 1: give 2, 3 or 2,3" in fowt("build", "tmd", "--fmi", "1").err
