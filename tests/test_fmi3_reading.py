"""Descriptions of FMI 3.0 that are unusual or wrong: what the master takes from them, or in which words it refuses."""

from __future__ import annotations

import zipfile
from collections.abc import Callable
from pathlib import Path

import fmpy
import pytest

from cosim.checks import check
from cosim.errors import CosimError
from cosim.fmu import elements, read_fmu
from cosim.inspection import inspect
from cosim.recording import select_channels
from cosim.system import ComponentInstance, Connection, StartValue, System
from cosim.validation import validate
from fmus_src.export.build import build_fmu
from fmus_src.tmd.model import component as tmd

Described = Callable[..., Path]


def real(name: str, reference: str, causality: str = "input", attributes: str = 'start="1"', inside: str = "") -> str:
    attributes = f'name="{name}" valueReference="{reference}" causality="{causality}" {attributes}'
    return f"<Float64 {attributes}>{inside}</Float64>"


def dimensions(*lengths: int) -> str:
    return "".join(f'<Dimension start="{n}"/>' for n in lengths)


@pytest.fixture
def described(tmp_path: Path) -> Described:
    """An FMU with these variables, and a file in place of its binary: it is read, not run."""

    def make(*variables: str, outputs: str = "", capabilities: str = "", name: str = "x") -> Path:
        path = tmp_path / f"{name}.fmu"
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("modelDescription.xml", f"""<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="x" instantiationToken="x">
<CoSimulation modelIdentifier="x" {capabilities}/>
<ModelVariables><Float64 name="time" valueReference="0" causality="independent"/>{"".join(variables)}</ModelVariables>
<ModelStructure>{outputs}</ModelStructure></fmiModelDescription>""")  # fmt: skip
            archive.writestr(f"binaries/{fmpy.platform_tuple}/x{fmpy.sharedLibraryExtension}", b"")
        return path

    return make


def test_elements_are_in_the_order_of_their_indices() -> None:
    """Not in that of the description, or of the alphabet; members of records are none."""
    assert elements(["x[10]", "x[2]", "x[1]", "x[1].y", "xx[3]", "x"], "x") == ["x[1]", "x[2]", "x[10]"]
    assert elements(["m[2,1]", "m[1,2]", "m[1,10]", "m[i]"], "m") == ["m[1,2]", "m[1,10]", "m[2,1]"]


def test_arrays_meet_element_by_element(described: Described) -> None:
    """A description may list scalars named as elements in any order: x[1] still feeds x[1]."""
    names = [f"y[{i}]" for i in (10, *range(2, 10), 1)]
    scalars = described(
        *(real(n, str(k + 1), "output", "") for k, n in enumerate(names)), name="scalars",
        outputs="".join(f'<Output valueReference="{k + 1}"/>' for k in range(10)),
    )  # fmt: skip
    array = described(real("u", "1", inside=dimensions(10)))
    parts = ComponentInstance("a", scalars), ComponentInstance("b", array)
    links = check(System("s", parts, (Connection("a", "y", "b", "u"),))).links
    assert [(k.output.name, k.input.name) for k in links] == [(f"y[{i}]", f"u[{i}]") for i in range(1, 11)]


def test_an_array_is_recorded_by_its_name(described: Described) -> None:
    system = check(System("s", (ComponentInstance("a", described(real("u", "1", inside=dimensions(2, 2)))),)))
    channels, _ = select_channels(system, (), ["a.u"])
    assert [c.name for c in channels] == ["a.u[1,1]", "a.u[1,2]", "a.u[2,1]", "a.u[2,2]"]


def test_references_are_numbers_however_they_are_written(described: Described) -> None:
    """The schema's unsigned integers may have zeros before them; the input is still one that moves within the step."""
    path = described(
        real("u", "007", attributes='start="1" intermediateUpdate="true"'),
        capabilities='providesIntermediateUpdate="true"',
    )
    assert read_fmu(path).interpolates


def test_matrices_are_row_by_row(described: Described) -> None:
    """As FMI 3.0 stores them: the number of an element is its place in what the FMU is given."""
    variables = read_fmu(described(real("m", "1", inside=dimensions(2, 3)))).variables
    names = sorted((v.reference, n) for n, v in variables.items() if n != "time")
    assert [n for _, n in names] == [f"m[{i},{j}]" for i in (1, 2) for j in (1, 2, 3)]


@pytest.mark.parametrize("kind", ["Float64", "Float32"])
def test_derivatives_and_updates_are_for_all_inputs_or_none(described: Described, kind: str) -> None:
    """Derivatives pass as 64-bit numbers; an input that cannot move within the step leaves all to be held."""
    moving = real("u", "1", attributes='start="1" intermediateUpdate="true"')
    other = moving.replace('"u"', '"v"').replace('"1" caus', '"2" caus').replace("Float64", kind)
    yes = 'providesDirectionalDerivatives="true" providesIntermediateUpdate="true"'
    fmu = read_fmu(described(moving, other, capabilities=yes))
    assert (fmu.differentiates, fmu.interpolates) == (kind == "Float64", True)
    held = other.replace(' intermediateUpdate="true"', "")
    assert not read_fmu(described(moving, held, capabilities=yes, name="held")).interpolates


def test_bounds_of_unsigned_integers_hold(described: Described) -> None:
    path = described('<UInt8 name="n" valueReference="1" causality="parameter" start="2" min="1" max="4"/>')
    assert (read_fmu(path).variables["n"].min, read_fmu(path).variables["n"].max) == (1.0, 4.0)
    with pytest.raises(CosimError, match=r"a.n = 5: 5 is above its maximum 4"):
        check(System("s", (ComponentInstance("a", path, {"n": StartValue(5)}),)))


@pytest.mark.parametrize(
    ("variables", "words"),
    [
        ([real("u", "1", attributes='start="1 2"', inside=dimensions(3))], "u has 2 start values for 3 elements"),
        ([real("u", "1", attributes='start="1 2 3 4"', inside=dimensions(3))], "u has 4 start values for 3 elements"),
        ([real("u", "1", inside=dimensions(2)), real("u[1]", "2")], r"two variables are called u\[1\]"),
        ([real("u", "1", inside=dimensions(10**9, 10**9))], "u: more than 100000 elements"),
    ],
)
def test_contradictions_are_refused(described: Described, variables: list[str], words: str) -> None:
    with pytest.raises(CosimError, match=words):
        read_fmu(described(*variables))


def test_an_array_is_not_taken_for_a_scalar(described: Described) -> None:
    path = described(real("gain", "1", "parameter", inside=dimensions(2)))
    part = ComponentInstance("a", path, {"gain": StartValue(1.0)})
    with pytest.raises(CosimError, match=r"a: 'gain' is an array in x.fmu; name an element, as gain\[1\]"):
        check(System("s", (part,)))


def test_two_names_of_one_input_take_one_source(described: Described) -> None:
    alias = described(real("u", "1", inside='<Alias name="v"/>'), real("w", "2"))
    source = described(real("y", "1", "output", ""), outputs='<Output valueReference="1"/>', name="source")
    parts = ComponentInstance("a", source), ComponentInstance("b", alias)
    wires = tuple(Connection("a", "y", "b", n) for n in ("u", "v"))
    with pytest.raises(CosimError, match=r"b.v has two sources"):
        check(System("s", parts, wires))
    (warning,) = check(System("s", parts, wires[:1])).warnings
    assert warning.endswith("start value used: w = 1")


def test_an_fmu_with_aliases_is_usable(fmu_folder: Path, tmp_path: Path) -> None:
    """Ours, with second names for an input and an output, both arrays: no check counts these twice."""
    path = tmp_path / "aliased.fmu"
    with zipfile.ZipFile(build_fmu(tmd(), fmu_folder, fmi="3")) as ours, zipfile.ZipFile(path, "w") as theirs:
        for name in ours.namelist():
            content = ours.read(name)
            if name == "modelDescription.xml":
                for array, other in ((b"force", b"pull"), (b"attachment.specific_force", b"field")):
                    start = content.index(b'<Float64 name="' + array + b'"')
                    end = content.index(b"</Float64>", start)
                    content = content[:end] + b'<Alias name="' + other + b'"/>' + content[end:]
            theirs.writestr(name, content)
    assert [f"{f.name}: {f.detail}" for f in validate(path) if f.status != "ok"] == []
    types = {v["name"]: v["type"] for v in inspect(path)["variables"]}
    assert (types["pull"], types["m"]) == ("Float64[3]", "Float64")
