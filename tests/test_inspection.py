"""`fowt inspect` and `fowt validate`: facts as they are, and a verdict on each way in which an FMU can be wrong."""

from __future__ import annotations

import json
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path

import fmpy
import pytest

from cosim.archive import sha256
from cosim.case import read_case
from cosim.cli.run import Changes, prepare
from cosim.inspection import inspect
from cosim.run import RunSettings
from cosim.ssp_writer import write_package
from cosim.system import ComponentInstance, System
from cosim.validation import validate
from fmus_src.component import Component
from fmus_src.tmd.model import component as tmd
from tests.conftest import Outcome

from .foreign_damper import description, foreign_damper


@pytest.fixture(scope="module")
def theirs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return foreign_damper(tmp_path_factory.mktemp("foreign"))


def test_inspect_shows_what_is_there(fowt: Callable[..., Outcome], theirs: Path) -> None:
    facts = json.loads(fowt("inspect", str(theirs), "--format", "json").out)
    assert (facts["fmi"], facts["platforms"], facts["runs_here"]) == ("2.0", [fmpy.platform], True)
    assert facts["sha256"] == sha256(theirs)
    assert facts["interfaces"]["CoSimulation"]["canGetAndSetFMUstate"] is True
    assert "canInterpolateInputs" not in facts["interfaces"]["CoSimulation"]
    variables = {v["name"]: v for v in facts["variables"]}
    assert len(variables) == 24
    assert variables["stroke"] == {
        "name": "stroke", "causality": "parameter", "variability": "tunable", "type": "Real", "unit": "mm",
        "start": "8000.0", "description": "",
    }  # fmt: skip
    shown = fowt("inspect", str(theirs)).out
    for words in ("FMI 2.0, CoSimulation", "stop_stiffness", "kN.s/m", sha256(theirs)):
        assert words in shown


def test_inspect_loads_no_binary(theirs: Path, tmp_path: Path) -> None:
    """Nor does it need one: the binary here is no library at all, and for another machine."""
    path = tmp_path / "x.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", description())
        archive.writestr("binaries/riscv64-haiku/foreign_damper.so", b"no library")
        archive.writestr("sources/x.c", b"")
    facts = inspect(path)
    assert (facts["platforms"], facts["runs_here"], facts["sources"]) == (["riscv64-haiku"], False, ["sources/x.c"])
    findings = {f.name: f for f in validate(path)}
    assert findings["platform"].status == "fail"
    assert "has riscv64-haiku; its sources can be compiled" in findings["platform"].detail
    assert findings["trials"].status == "skipped"


def test_inspect_shows_a_package(fowt: Callable[..., Outcome], tmp_path: Path) -> None:
    prepared = prepare(read_case("decay10"), "tmd-n", Changes(until=5.0), quiet=True)
    path = write_package(prepared.system, prepared.settings, tmp_path / "x.ssp", "2.0")
    facts = json.loads(fowt("inspect", str(path), "--format", "json").out)
    assert (facts["ssp"], facts["stop"], facts["step"]) == ("2.0", 5.0, 0.0125)
    assert facts["components"]["nacelle_damper"]["parameters"]["stroke"] == "8.0 m"
    assert facts["components"]["nacelle_damper"]["fmu"] == "resources/tmd.fmu"
    assert "nacelle_damper: resources/tmd.fmu (FMI 2.0; " in fowt("inspect", str(path)).out


def test_good_fmus_pass(fowt: Callable[..., Outcome], theirs: Path, built: Callable[[Component], Path]) -> None:
    """Ours, with FMI's slopes and serialisation, and the one by hand."""
    outcome = fowt("validate", str(theirs))
    assert outcome.code == 0, outcome.out
    assert "usable" in outcome.out
    passed = json.loads(fowt("validate", str(built(tmd())), "--format", "json").out)
    assert passed["passed"]
    assert {f["status"] for f in passed["findings"]} == {"ok"}
    assert len(passed["findings"]) == 13


def test_several_files_and_packages_are_judged_one_by_one(
    fowt: Callable[..., Outcome], theirs: Path, built: Callable[[Component], Path], tmp_path: Path
) -> None:
    """Exit code 1 if any fails; of a package its structure, and each of its FMUs by its worst finding."""
    system = System("pair", (ComponentInstance("a", theirs), ComponentInstance("b", built(tmd()))))
    path = write_package(system, RunSettings(stop=1.0), tmp_path / "pair.ssp")
    good = fowt("validate", str(theirs), str(built(tmd())), str(path))
    assert good.code == 0, good.out
    assert good.out.count(": usable") == 3
    assert "a: not connected, start value used" in good.out
    (tmp_path / "bad.fmu").write_bytes(b"no archive")
    outcome = fowt("validate", str(theirs), "bad.fmu", "--format", "json")
    report = json.loads(outcome.out)
    assert (outcome.code, report["passed"], [f["passed"] for f in report["files"]]) == (1, False, [True, False])
    with zipfile.ZipFile(path) as old, zipfile.ZipFile(tmp_path / "worse.ssp", "w") as new:
        for name in old.namelist():
            new.writestr(name, old.read(name) if not name.endswith("tmd.fmu") else b"no archive")
    worse = json.loads(fowt("validate", "worse.ssp", "--format", "json").out)
    assert not worse["passed"]
    assert worse["findings"][-1]["name"] == "structure"
    assert "FMU resources/tmd.fmu: cannot be read" in worse["findings"][-1]["detail"]
    missing = fowt("validate", str(theirs), "none.fmu")
    assert missing.code == 1
    assert "none.fmu: no such file" in missing.err


# a process that writes to address 0 is ended by a signal; Windows has none but names the exception
CRASH = "access violation" if sys.platform == "win32" else "the process of the FMU died (SIG"
# what goes wrong where the environment variable FAULT names it
STEP, LOOP = "for (int i = 0; i < n; i++) { /*", "p[HEAT] = d->heat;"
CHANGES = {
    "typedef struct {": (
        'static int fault(const char *name) { const char *f = getenv("FAULT"); return f && !strcmp(f, name); }\n'
        "typedef struct {"
    ),
    STEP: (
        'static double all; if (t > 0.1 && fault("crash")) *(volatile int *)(size_t)(t < 0) = 1;'
        ' while (t > 0.1 && fault("hang")) fabs(t); if (t > 0.1 && fault("error")) return fmi2Error;'
        f' if (fault("nan")) d->heat = NAN; if (fault("global")) d->heat = all += 1.0; {STEP}'
    ),
    LOOP: f'{LOOP} static damper *last; if (fault("leak") && last && last != d) p[HEAT] = 1.0; last = d;',
    "memcpy(d->real, values, sizeof values);": (
        'memcpy(d->real, values, sizeof values); if (fault("start")) d->real[MASS] = 21.0;'
    ),
    "((damper *)c)->real[r[i]] = v[i];": 'if (r[i] != DAMPING || !fault("set")) ((damper *)c)->real[r[i]] = v[i];',
    "fmi2Reset(fmi2Component c) { start(c);": 'fmi2Reset(fmi2Component c) { if (!fault("reset")) start(c);',
    "memcpy(c, s, sizeof(damper));": 'if (!fault("state")) memcpy(c, s, sizeof(damper));',
}
# a process that writes to address 0 is ended by a signal; Windows has none but names the exception
CRASH = "access violation" if sys.platform == "win32" else "the process of the FMU died (SIG"
FAULTS = {
    "crash": ("smoke run", CRASH),
    "hang": ("smoke run", "did not answer within 5 s"),
    "error": ("smoke run", "fmi2DoStep failed with status 3"),
    "nan": ("smoke run", "heat = nan at t = "),
    "start": ("start values", "mass starts at 21, not at 20"),
    "set": ("memory of set values", "damping was set to 2.1"),
    "reset": ("reset restarts", "after a reset it is not as new"),
    "state": ("state restored", "after its state was restored it goes elsewhere"),
    "global": ("repeats itself", "a second run of the same differs: heat"),
    "leak": ("instances apart", "another instance beside it changes it: heat"),
}


@pytest.fixture(scope="module")
def faulty(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return foreign_damper(tmp_path_factory.mktemp("faulty"), CHANGES)


@pytest.mark.parametrize("fault", FAULTS)
def test_each_fault_is_found_and_named(faulty: Path, fault: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A crash or a hang too: it ends the trials, not this program."""
    monkeypatch.setenv("FAULT", fault)
    name, words = FAULTS[fault]
    findings = {f.name: f for f in validate(faulty, timeout=5.0 if fault == "hang" else 60.0)}
    assert findings[name].status == "fail"
    assert words in findings[name].detail
    assert "\n" not in findings[name].detail
    assert findings["description"].status == "ok"


def test_faults_of_the_description_are_found(fowt: Callable[..., Outcome], theirs: Path, tmp_path: Path) -> None:
    with zipfile.ZipFile(theirs) as archive:
        content = {n: archive.read(n) for n in archive.namelist()}
    text = content["modelDescription.xml"].decode()

    def findings(old: str, new: str) -> dict[str, str]:
        path = tmp_path / "x.fmu"
        with zipfile.ZipFile(path, "w") as archive:
            for name, data in content.items():
                archive.writestr(name, text.replace(old, new) if name == "modelDescription.xml" else data)
        outcome = fowt("validate", str(path), "--format", "json")
        assert outcome.code == (0 if json.loads(outcome.out)["passed"] else 1)
        return {f["name"]: f"{f['status']} {f['detail']}" for f in json.loads(outcome.out)["findings"]}

    assert findings('causality="output"', 'causality="outptu"')["description"].startswith("fail")
    assert findings('name="a_y"', 'name="a_x"')["description"].startswith("fail")
    units = findings('<Unit name="mm/s2"><BaseUnit m="1" s="-2" factor="1e-3"/></Unit>', '<Unit name="mm/s2"/>')
    assert units["units"].startswith("ok")  # its name says it
    lost = findings('"kN.m"', '"furlong"')
    assert lost["units"].startswith("ok")  # defined by base units, whatever its name
    twice = findings('valueReference="1"', 'valueReference="0"')
    assert twice["causality"] == "fail inputs a_x and a_y have one value reference"
    assert fowt("validate", str(tmp_path / "none.fmu")).code == 1
