"""Files that an FMU brings itself: found whatever the importer calls its folder, and wherever it was started."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from platformdirs import user_cache_path

from cosim.archive import entry_names
from cosim.errors import CosimError
from cosim.fmu import read_fmu
from cosim.resources import NOTE, finds_resources, with_resources
from cosim.run import RunSettings, simulate
from cosim.ssp import read_package
from cosim.ssp_writer import write_package
from cosim.system import ComponentInstance, System, with_parameters
from fmus_src.aero.turbsim_file import WindBox, write_box
from fmus_src.component import Component
from fmus_src.export.build import RESOURCES_NOTE, build_fmu
from fmus_src.export.platforms import PLATFORMS, Platform, native_platform
from fmus_src.export.sources import fmi_headers

from .cosim_fmus import carried, mass
from .foreign_damper import foreign_damper
from .test_export_wind import wind_probe
from .test_ssp_package import by_fmpy, by_libcosim

OWN, OTHER = 11.0, 7.0  # m/s
WINE = pytest.param("windows-x86_64", marks=pytest.mark.skipif(shutil.which("wine") is None, reason="needs Wine"))


def wind(path: Path, speed: float) -> Path:
    """A box of steady wind; 16-bit numbers hold its speed within 1e-3 m/s."""
    path.parent.mkdir(parents=True, exist_ok=True)
    velocity = np.zeros((8, 2, 2, 3), dtype=np.float32)
    velocity[..., 0] = speed
    tower = np.zeros((8, 0, 3), dtype=np.float32)
    box = WindBox(
        velocity=velocity, dt=1.0, dy=20.0, dz=20.0, z_bottom=40.0, hub_height=50.0, mean_speed=speed, periodic=True,
        tower=tower,
    )  # fmt: skip
    write_box(box, path)
    return path


def told(fmi: str, platform: Platform, folder: Path, text: str, resources: list[str], guid: str = "") -> list[str]:
    """What the FMU says for each folder of resources that a C importer names, started in `folder`."""
    fmu = folder / "fmu"
    if not fmu.is_dir():
        with zipfile.ZipFile(build_fmu(wind_probe(), folder, fmi=fmi, platforms=[platform])) as archive:
            archive.extractall(fmu)
    windows = platform.name.startswith("windows")
    driver = folder / f"driver{'.exe' if windows else ''}"
    if not driver.exists():
        source = str(Path(__file__).with_name("resources_driver.c"))
        compiler = [sys.executable, "-m", "ziglang", "cc", "-std=c99", "-O1", "-target", platform.compiler_target]
        libraries = [] if windows else ["-ldl"]
        subprocess.run([*compiler, f"-I{fmi_headers()}", source, *libraries, "-o", str(driver)], check=True)
    description = fmpy.read_model_description(str(fmu))
    reference = {v.name: v.valueReference for v in description.modelVariables}
    place = platform.fmi2 if fmi == "2" else platform.fmi3
    library = fmu / "binaries" / place / f"wind_probe{platform.suffix}"
    token = guid or (description.guid if fmi == "2" else description.instantiationToken)
    words = [str(driver), str(library), fmi, token, str(reference["file"]), text, str(reference["u"]), *resources]
    prefix = user_cache_path("fowt-cosim", ensure_exists=True) / "wine"  # kept: making one takes a minute
    settings = {"WINEPREFIX": str(prefix), "WINEDEBUG": "-all", "DISPLAY": "", "WINEDLLOVERRIDES": "mscoree,mshtml="}
    ran = subprocess.run(
        [*(["wine"] if windows else []), *words], capture_output=True, text=True, timeout=300, check=True, cwd=folder,
        env=os.environ | (settings if windows else {}),
    )  # fmt: skip
    return ran.stdout.splitlines()


def speeds(lines: list[str]) -> list[float | None]:
    return [None if "cannot be opened; check the path" in line else round(float(line), 2) for line in lines]


@pytest.mark.parametrize("platform", [native_platform().name, WINE])
def test_a_uri_of_fmi_2_in_all_its_forms(platform: str, tmp_path: Path) -> None:
    """RFC 8089: with and without authority, percent-encoded UTF-8; some importers give a plain path instead."""
    folder = tmp_path / "50% of the w\u00fcnd #1" / "resources"
    wind(folder / "wind.bts", OWN)
    windows = platform.startswith("windows")
    uri = folder.as_uri().replace("file:///", "file:///Z:/") if windows else folder.as_uri()  # Wine's name for /
    path = uri.removeprefix("file://")
    good = [uri, f"{uri}/", f"file:{path}", f"file://localhost{path}", uri.replace("%C3%BC", "%c3%bc")]
    good += [] if windows else [str(folder), f"{folder}/", f"file://{folder}"]  # a stray % stands for itself
    bad = [f"file://{path[:-1]}%00", "", "file://", f"{uri}/wind.bts", "x" * 5000]
    bad += [] if windows else [f"file://elsewhere{path}"]
    found = speeds(told("2", PLATFORMS[platform], tmp_path, "wind.bts", [*good, *bad]))
    assert found == [OWN] * len(good) + [None] * len(bad)


@pytest.mark.parametrize("platform", [native_platform().name, WINE])
def test_a_path_of_fmi_3(platform: str, tmp_path: Path) -> None:
    """The native form, with its final separator (FMI 3.0, resourcePath) or without."""
    wind(tmp_path / "a blank" / "resources" / "sub" / "wind.bts", OWN)
    folder = str(tmp_path / "a blank" / "resources")
    if platform.startswith("windows"):
        folder = "Z:" + folder.replace("/", "\\")
    separator = "\\" if platform.startswith("windows") else "/"
    found = told("3", PLATFORMS[platform], tmp_path, "sub/wind.bts", [folder, folder + separator, ""])
    assert speeds(found) == [OWN, OWN, None]


def test_its_own_files_come_first(tmp_path: Path) -> None:
    """A file of that name where the importer was started is another; a full path is what it says."""
    wind(tmp_path / "own" / "wind.bts", OWN)
    other = wind(tmp_path / "wind.bts", OTHER)
    folders = [(tmp_path / "own").as_uri(), ""]
    assert speeds(told("2", native_platform(), tmp_path, "wind.bts", folders)) == [OWN, OTHER]
    assert speeds(told("2", native_platform(), tmp_path, "./wind.bts", folders)) == [OWN, OTHER]
    assert speeds(told("2", native_platform(), tmp_path, str(other), folders)) == [OTHER, OTHER]


def test_a_guid_may_be_lengthened_by_a_plus_only(tmp_path: Path) -> None:
    wind(tmp_path / "wind.bts", OWN)
    assert speeds(told("2", native_platform(), tmp_path, "wind.bts", [""])) == [OWN]
    guid = fmpy.read_model_description(str(tmp_path / "fmu")).guid
    assert speeds(told("2", native_platform(), tmp_path, "wind.bts", [""], f"{guid}+1f")) == [OWN]
    for wrong in (f"{guid}1", guid[:-1], f"+{guid}", "+"):
        assert "the guid is not this FMU's" in told("2", native_platform(), tmp_path, "wind.bts", [""], wrong)[0]


@pytest.mark.parametrize("fmi", ["2", "3"])
def test_a_copy_with_files_runs_from_anywhere(fmi: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By FMPy. Copies with other files have other guids, since libcosim unpacks one FMU of each only."""
    assert NOTE == RESOURCES_NOTE
    plain = build_fmu(wind_probe(), tmp_path, fmi=fmi)
    guids = []
    for speed in (OWN, OTHER):
        made = with_resources(plain, {"wind.bts": wind(tmp_path / f"{speed}.bts", speed)})
        assert made == with_resources(plain, {"wind.bts": tmp_path / f"{speed}.bts"})
        copy = tmp_path / f"{speed}.fmu"
        copy.write_bytes(made)
        assert set(entry_names(copy)) == {*entry_names(plain), "resources/wind.bts"}
        monkeypatch.chdir(tmp_path.parent)
        rows = fmpy.simulate_fmu(
            str(copy), start_values={"file": "wind.bts"}, output=["u"], stop_time=1.0, fmi_type="CoSimulation",
            validate=True,
        )  # fmt: skip
        np.testing.assert_allclose(rows["u"], speed, atol=1e-3)
        md = fmpy.read_model_description(str(copy))
        guids.append(md.guid if fmi == "2" else md.instantiationToken)
    assert len({*guids}) == 2


def test_only_fmus_that_say_so_are_given_files(tmp_path: Path, built: Callable[[Component], Path]) -> None:
    theirs = foreign_damper(tmp_path)
    assert not finds_resources(theirs)
    assert not finds_resources(built(mass()))  # takes no text
    assert finds_resources(built(wind_probe()))
    with pytest.raises(CosimError, match="does not look for files in its resources"):
        with_resources(theirs, {"wind.bts": wind(tmp_path / "wind.bts", OWN)})
    with pytest.raises(CosimError, match=r"none.bts: cannot be read \(No such file"):
        with_resources(built(wind_probe()), {"wind.bts": tmp_path / "none.bts"})


def test_a_package_runs_from_anywhere_in_any_tool(
    built: Callable[[Component], Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two uses of one FMU with winds of one name, in ours, libcosim and FMPy: each has its own wind."""
    fmu = built(wind_probe())
    names = ["left.u", "right.u"]
    system = System("winds", tuple(ComponentInstance(n, fmu) for n in ("left", "right")))
    files = {n: wind(tmp_path / n / "wind.bts", v) for n, v in (("left", OWN), ("right", OTHER))}
    system = with_parameters(system, {f"{n}.file": str(f) for n, f in files.items()})
    settings = RunSettings(stop=1.0, step=0.125, record=("*.u",))
    path = write_package(system, settings, tmp_path / "winds.ssp")
    shutil.rmtree(tmp_path / "left")
    shutil.rmtree(tmp_path / "right")
    elsewhere = tmp_path / "elsewhere"
    wind(elsewhere / "wind.bts", 3.0)
    monkeypatch.chdir(elsewhere)
    found = read_package(path, tmp_path / "unpacked")
    assert {n for n in entry_names(found.system.components[0].fmu) if n.endswith(".bts")} == {
        "resources/wind.bts", "resources/right-wind.bts",
    }  # fmt: skip
    ours = simulate(found.system, settings, tmp_path / "ours").frame()
    rows = by_libcosim(path, 8, 0.125, names)
    for name, speed in zip(names, (OWN, OTHER), strict=True):
        np.testing.assert_allclose(ours[name], speed, atol=1e-3)
        assert rows[name] == ours[name].to_list()[1:]
    _set_texts_too(monkeypatch)
    # FMPy reads connected variables only: that its instances open their files is what is seen here
    assert len(by_fmpy(path, 8, 0.125)) == 8
    broken = tmp_path / "broken.ssp"
    _without(path, broken, "resources/right-wind.bts")
    with pytest.raises(fmpy.fmi1.FMICallException, match="failed with status 3"):
        by_fmpy(broken, 8, 0.125)


def _set_texts_too(monkeypatch: pytest.MonkeyPatch) -> None:
    """FMPy's SSP simulation sets no text; its FMUs do."""
    import fmpy.ssp.simulation as ssp

    usual = ssp.set_value

    def set_value(component: Any, name: str, value: str) -> None:
        variable = component.variables[name]
        if variable.type == "String":
            component.fmu.setString([variable.valueReference], [value])
        else:
            usual(component, name, value)

    monkeypatch.setattr(ssp, "set_value", set_value)


def _without(package: Path, target: Path, name: str) -> None:
    """The package with an entry of its FMU left out."""
    with zipfile.ZipFile(package) as old, zipfile.ZipFile(target, "w") as new:
        for entry in old.namelist():
            data = old.read(entry)
            if entry.endswith(".fmu"):
                inner = target.with_name("inner.fmu")
                inner.write_bytes(data)
                with zipfile.ZipFile(inner) as fmu, zipfile.ZipFile(target.with_name("less.fmu"), "w") as less:
                    assert name in fmu.namelist()
                    for part in fmu.namelist():
                        if part != name:
                            less.writestr(part, fmu.read(part))
                data = target.with_name("less.fmu").read_bytes()
            new.writestr(entry, data)


def test_a_file_that_the_fmu_has_stays_there(built: Callable[[Component], Path], tmp_path: Path) -> None:
    """An FMU that brings its wind is exported as it is, though there is another file of that name here."""
    copy = tmp_path / "probe.fmu"
    copy.write_bytes(with_resources(built(wind_probe()), {"wind.bts": wind(tmp_path / "own.bts", OWN)}))
    system = with_parameters(System("one", (ComponentInstance("probe", copy),)), {"probe.file": "wind.bts"})
    path = write_package(system, RunSettings(stop=1.0), tmp_path / "one.ssp")
    found = read_package(path, tmp_path / "unpacked").system
    assert read_fmu(found.components[0].fmu).sha256 == read_fmu(copy).sha256
    assert found.components[0].start["file"].value == "wind.bts"


@pytest.mark.parametrize(
    "name", ["aux", "CON", "nul.left", "com1", "a/b", "..", "x" * 300, "\u00fc" * 200, "r\u00f6m."]
)
def test_any_name_of_a_component_can_be_packed(name: str, built: Callable[[Component], Path], tmp_path: Path) -> None:
    """Files are named after components: on Windows `aux.ssv` is a device, whatever follows the dot."""
    system = System("odd", (ComponentInstance(name, built(mass())), ComponentInstance("x", built(carried()))))
    system = with_parameters(system, {f"{name}.x_0": 0.5, "x.m": 2.0})
    found = read_package(write_package(system, RunSettings(stop=1.0), tmp_path / "odd.ssp"), tmp_path / "unpacked")
    assert [c.name for c in found.system.components] == [name, "x"]
    assert found.system.components[0].start["x_0"].value == 0.5


def test_names_that_differ_in_case_only_do_not_collide(built: Callable[[Component], Path], tmp_path: Path) -> None:
    names = ["Mass", "mass", "MASS", "m\u00e4ss", "M\u00c4SS"]
    system = System("alike", tuple(ComponentInstance(n, built(mass())) for n in names))
    system = with_parameters(system, {f"{n}.x_0": 0.1 * i for i, n in enumerate(names)})
    found = read_package(write_package(system, RunSettings(stop=1.0), tmp_path / "x.ssp"), tmp_path / "unpacked")
    assert [c.start["x_0"].value for c in found.system.components] == [0.1 * i for i in range(len(names))]
