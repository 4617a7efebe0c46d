"""FMUs of FMI 3.0 under the master: alone, beside those of FMI 2.0, and foreign ones."""

from __future__ import annotations

import ctypes
import zipfile
from collections.abc import Callable, Mapping, Sequence
from ctypes import POINTER, c_double, c_int, c_size_t, c_void_p
from pathlib import Path
from typing import Any

import numpy as np
import pyssp_standard
import pytest
from lxml import etree

from cosim.archive import extract
from cosim.case import read_case
from cosim.cli.run import Changes, prepare
from cosim.errors import CosimError, RunFailed
from cosim.fmu import read_fmu
from cosim.instance import instantiate
from cosim.run import RunSettings, simulate
from cosim.ssp import read_package
from cosim.ssp_writer import write_package
from cosim.swap import NameRule, with_swapped
from cosim.system import ComponentInstance, Connection, StartValue, System
from fmus_src.component import Component
from fmus_src.export.build import build_fmu
from fmus_src.library import build_library, make

from .cosim_fmus import carried, mass, probe, two_masses
from .relay import TYPES, relay

RECORD = ("structure.position", "structure.velocity", "damper.position", "damper.force")


@pytest.fixture(scope="module")
def foreign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return relay(tmp_path_factory.mktemp("relay"))


@pytest.fixture(scope="module")
def both(fmu_folder: Path, built: Callable[[Component], Path]) -> dict[str, System]:
    """Two masses, each an FMU of that version: "23" has a structure of FMI 2.0 and a damper of FMI 3.0."""
    of = {
        (c, v): built(c()) if v == "2" else build_fmu(c(), fmu_folder, fmi="3") for c in (mass, carried) for v in "23"
    }
    return {a + b: two_masses(of[mass, a], of[carried, b]) for a in "23" for b in "23"}


def last(system: System, folder: Path, **settings: Any) -> np.ndarray[Any, np.dtype[np.float64]]:
    frame = simulate(system, RunSettings(stop=5.0, step=0.05, record=RECORD, **settings), folder).frame()
    return frame.to_numpy()


HELD = {"algorithm": "jacobi", "extrapolation": "held"}
ALGORITHMS = [{}, HELD, {"extrapolation": "linear"}, {"algorithm": "newton"}, {"algorithm": "iterated"}]


@pytest.mark.parametrize("settings", ALGORITHMS, ids=lambda s: "-".join(s.values()) or "default")
def test_both_versions_couple_alike(settings: dict[str, Any], both: dict[str, System], tmp_path: Path) -> None:
    """What FMI 2.0 gets as slopes, FMI 3.0 asks for within the step: the same polynomials, so the same numbers.

    Rounding alone differs (where the polynomial is evaluated), and grows no further than that in a damped coupling.
    """
    expected = last(both["22"], tmp_path / "22", **settings)
    assert np.ptp(expected[:, 0]) > 0.3
    for versions in ("33", "23", "32"):
        rows = last(both[versions], tmp_path / versions, **settings)
        if settings == HELD:
            assert np.array_equal(rows, expected), versions
        np.testing.assert_allclose(rows, expected, rtol=0.0, atol=1e-12)


def test_isolated_fmus_give_the_same_bits(both: dict[str, System], tmp_path: Path) -> None:
    apart = last(both["33"], tmp_path / "apart", isolate=("all",))
    assert np.array_equal(apart, last(both["33"], tmp_path / "here"))


def test_a_damper_of_fmi_3_in_the_place_of_ours(fmu_folder: Path, tmp_path: Path) -> None:
    """10 deg decay, stops hit and steps halved: arrays of three against three scalars each, by the same names.

    The stops amplify rounding: 1e-9 of the travel is a million times it, and a wrong sample or slope is far above.
    """
    damper = build_fmu(make("tmd"), fmu_folder, fmi="3")
    swap = tuple(f"{c}={damper}" for c in ("nacelle_damper", "platform_damper"))
    usual = prepare(read_case("decay10"), "mtmd", Changes(until=8.0), quiet=True)
    other = prepare(read_case("decay10"), "mtmd", Changes(until=8.0, swap=swap), quiet=True)
    ours = simulate(usual.system, usual.settings, tmp_path / "2")
    theirs = simulate(other.system, other.settings, tmp_path / "3")
    assert ours.frame()["NStC1_XQ"].abs().max() > 8.0
    assert theirs.ports.keys() == ours.ports.keys()
    for channel in ("PtfmPitch", "TwrBsMyt", "NStC1_XQ", "NStC1_XQD"):
        expected = ours.frame()[channel]
        assert np.abs(theirs.frame()[channel] - expected).max() < 1e-9 * np.abs(expected).max(), channel


def test_packages_hold_arrays_of_fmi_3(both: dict[str, System], foreign: Path, tmp_path: Path) -> None:
    """SSP 2.0 names an element by its array and indices; SSP 1.0 has no arrays. Read back, the run is the same bits."""
    start = {"in.Float64[2]": StartValue(-2.5), "in.Boolean[1]": StartValue(True), "in.UInt8[1]": StartValue(7)}
    parts = (*both["23"].components, ComponentInstance("a", foreign, start), ComponentInstance("b", foreign))
    wires = (*both["23"].connections, Connection("structure", "position", "a", "in.Float64[1]"))
    wires += tuple(Connection("a", f"out.{kind}", "b", f"in.{kind}") for kind in ("Float64", "Boolean", "UInt8"))
    system = System("arrays", parts, wires)
    record = ("structure.position", *(f"b.out.{t}[{i}]" for t in ("Float64", "Boolean", "UInt8") for i in (1, 2)))
    settings = RunSettings(stop=1.0, step=0.05, record=record)
    with pytest.raises(CosimError, match=r"a: in.Float64\[1\] is of an array .* SSP 1.0 cannot connect; use 2.0"):
        write_package(system, settings, tmp_path / "one.ssp")
    package = write_package(system, settings, tmp_path / "two.ssp", "2.0")
    schemas = Path(pyssp_standard.__file__).parent / "resources/ssp2"
    with zipfile.ZipFile(package) as archive:
        for name in archive.namelist():
            kind = {"ssd": "Description", "ssv": "ParameterValues"}.get(name.rpartition(".")[2])
            if kind:
                root = etree.fromstring(archive.read(name))
                etree.XMLSchema(etree.parse(str(schemas / f"SystemStructure{kind}.xsd"))).assertValid(root)
    again = read_package(package, tmp_path / "unpacked").system
    assert len(again.connections) == len(wires) + 3  # whole arrays of two
    expected = simulate(system, settings, tmp_path / "ours").frame()
    assert expected["b.out.Float64[2]"].iloc[-1] == -2.5
    assert expected["b.out.UInt8[1]"].iloc[-1] == 7
    assert simulate(again, settings, tmp_path / "again").frame().equals(expected)


@pytest.mark.slow
def test_the_coupled_model_runs_on_fmi_3(tmp_path: Path) -> None:
    """10 s of load case 4 with every FMU in version 3.0, arrays of 3 and 9 between them, beside the usual one.

    Held and exchanged at once (Jacobi), they are the same bits: only the interface differs.
    """
    case = read_case("lc4")
    stepping = {"algorithm": "jacobi", "extrapolation": "held", "energy_tolerance": 0.0}
    prepared = prepare(case, "mtmd", Changes(until=10.0, seed=2, stepping=stepping), quiet=True)
    names = sorted({c.fmu.stem for c in prepared.system.components})
    _, threes = build_library(names, fmi="3")
    folder = tmp_path / "fmus"
    folder.mkdir()
    for name in names:
        (folder / f"{name}.fmu").write_bytes(threes[name].read_bytes())
    changes = Changes(until=10.0, seed=2, fmus=folder, stepping=stepping)
    other = prepare(case, "mtmd", changes, quiet=True)
    assert {read_fmu(c.fmu).version for c in other.system.components} == {"3.0"}
    settings = {"quick": prepared, "three": other}
    frames = {n: simulate(p.system, p.settings, tmp_path / n).frame() for n, p in settings.items()}
    assert frames["quick"]["PtfmPitch"].std() > 0.0
    assert frames["three"].equals(frames["quick"])


def values_of(kind: str) -> tuple[float | bool, float | bool]:
    """Two values that the type holds exactly, the second its least."""
    if kind == "Boolean":
        return True, False
    if kind.startswith("Float"):
        return 0.1 if kind == "Float64" else 0.5, -3.25
    bits = min(int(kind.lstrip("UInt")), 53)
    return (2**bits - 1, 0) if kind.startswith("U") else (2 ** (bits - 1) - 1, -(2 ** (bits - 1)))


def test_every_type_passes_from_array_to_array(foreign: Path, tmp_path: Path) -> None:
    """Set in one FMU, through whole arrays into the next: the second has them after its step, to the last bit."""
    start = {f"in.{t}[{i + 1}]": StartValue(v) for t in TYPES for i, v in enumerate(values_of(t))}
    system = System(
        "relays",
        (ComponentInstance("a", foreign, start), ComponentInstance("b", foreign)),
        tuple(Connection("a", f"out.{t}", "b", f"in.{t}") for t in TYPES),
    )
    record = tuple(f"b.out.{t}[{i}]" for t in TYPES for i in (1, 2))
    frame = simulate(system, RunSettings(stop=1.0, step=0.1, record=record), tmp_path / "run").frame()
    assert frame.iloc[-1].tolist() == [float(v) for t in TYPES for v in values_of(t)]


@pytest.mark.parametrize("isolate", [(), ("all",)])
def test_a_wide_integer_does_not_wrap_in_fmi_2(isolate: tuple[str, ...], foreign: Path, tmp_path: Path) -> None:
    """It passes as it is where it fits, and ends the run where it has more than FMI 2.0's 32 bits."""
    for value in (-(2**31) + 1, 2**40):
        parts = (
            ComponentInstance("a", foreign, {"in.Int64[1]": StartValue(value)}),
            ComponentInstance("b", probe(tmp_path)),
        )
        system = System("two", parts, (Connection("a", "out.Int64[1]", "b", "count"),))
        settings = RunSettings(stop=0.4, step=0.1, record=("a.out.Int64[1]", "b.number"), isolate=isolate)
        if value < 2**31:
            rows = simulate(system, settings, tmp_path / f"{value}").frame()
            assert rows["a.out.Int64[1]"].iloc[-1] == value
            continue
        with pytest.raises(
            RunFailed, match=r"b.count = 1099511627776 at t = 0.1 s: does not fit an FMI integer of 32 bits"
        ):
            simulate(system, settings, tmp_path / f"{value}")


def test_whole_arrays_are_mapped(foreign: Path, tmp_path: Path) -> None:
    """The replaced FMU has the array under another name, and of single precision."""
    start = {"in.Float64[1]": StartValue(0.1), "in.Float64[2]": StartValue(-2.0)}
    parts = (ComponentInstance("a", foreign, start), ComponentInstance("b", foreign))
    wires = tuple(Connection("a", f"out.Float64[{i}]", "b", f"in.Float64[{i}]") for i in (1, 2))
    swapped = with_swapped(System("relays", parts, wires), "b", foreign, [NameRule("in.Float64", "in.Float32")])
    settings = RunSettings(stop=1.0, step=0.1, record=("b.out.Float32",))
    frame = simulate(swapped, settings, tmp_path / "run").frame()
    assert frame.iloc[-1].tolist() == [float(np.float32(0.1)), -2.0]
    with pytest.raises(CosimError, match=r"map b.in.Float64: the system has no such variable; did you mean"):
        with_swapped(System("relays", parts, wires), "b", foreign, [NameRule("in.Float64", "label")])


@pytest.mark.parametrize(("intermediate", "tolerance"), [(True, 1e-12), (False, 1e-12)])
def test_inputs_move_within_the_step(intermediate: bool, tolerance: float, built: Any, tmp_path: Path) -> None:
    """A body falls freely: x = t^2 / 2. Quadratic extrapolation is then exact, so the mean over each step is too,
    whether the FMU asks for its inputs within the step or is given their mean to hold."""
    system = System(
        "fall",
        (
            ComponentInstance("body", built(mass()), {"force": StartValue(1.0)}),
            ComponentInstance("relay", relay(tmp_path, intermediate=intermediate)),
        ),
        (Connection("body", "position", "relay", "in.Float64[1]"),),
    )
    assert read_fmu(system.components[1].fmu).interpolates == intermediate
    record = ("relay.mean", "relay.average[1]", "relay.level", "body.position")
    h = 0.1
    frame = simulate(system, RunSettings(stop=2.0, step=h, record=record), tmp_path / "run").frame()
    t = frame.index.to_numpy()[3:]
    exact = (t**3 - (t - h) ** 3) / (6.0 * h)
    np.testing.assert_allclose(frame["relay.mean[1]"].to_numpy()[3:], exact, rtol=0.0, atol=tolerance)
    assert set(frame["relay.mean[2]"].iloc[1:]) == {0.25}  # not connected: as it starts, though set with its neighbour
    assert frame["relay.average[1]"].equals(frame["relay.mean[1]"].rename("relay.average[1]"))
    # direct feed-through sees the end of the step
    np.testing.assert_allclose(frame["relay.level"].to_numpy(), frame["body.position"].to_numpy(), atol=1e-12)


@pytest.mark.parametrize(
    ("how", "words"),
    [
        (1, "fmi3DoStep returned fmi3Discard at t = 0.4 s: it asks to end the simulation at 0.5 s"),
        (2, "fmi3DoStep returned fmi3Discard at t = 0.4 s: it returned early, at 0.45 s"),
        (3, "fmi3DoStep returned fmi3Error at t = 0.4 s: 7 % too hot"),
    ],
)
@pytest.mark.parametrize("isolate", [(), ("all",)])
def test_failures_are_told_in_the_words_of_fmi_3(
    how: int, words: str, isolate: tuple[str, ...], foreign: Path, tmp_path: Path
) -> None:
    start = {"fail_at": StartValue(0.46), "how": StartValue(how), "label": StartValue("7 % too hot")}
    system = System("one", (ComponentInstance("relay", foreign, start),))
    settings = RunSettings(stop=1.0, step=0.1, record=("relay.mean[1]",), isolate=isolate)
    with pytest.raises(RunFailed) as failure:
        simulate(system, settings, tmp_path / "run")
    assert words in str(failure.value)


def test_an_isolated_fmu_may_crash(foreign: Path, tmp_path: Path) -> None:
    start = {"fail_at": StartValue(0.46), "how": StartValue(5)}
    system = System("one", (ComponentInstance("relay", foreign, start),))
    settings = RunSettings(stop=1.0, step=0.1, record=("relay.mean[1]",), isolate=("all",))
    with pytest.raises(RunFailed, match=r"the process of relay.fmu died .* at t = 0.4 s in fmi3DoStep"):
        simulate(system, settings, tmp_path / "run")


def test_inputs_refused_within_the_step_end_the_run(foreign: Path, tmp_path: Path, built: Any) -> None:
    """The FMU asks for inputs, refuses them, and says that its step went well: it did not."""
    start = {"fail_at": StartValue(0.46), "how": StartValue(6)}
    parts = (ComponentInstance("body", built(mass()), {"force": StartValue(1.0)}),)
    parts += (ComponentInstance("relay", foreign, start),)
    system = System("two", parts, (Connection("body", "position", "relay", "in.Float64[1]"),))
    with pytest.raises(RunFailed, match=r"relay: fmi3DoStep returned fmi3Error at t = 0.4 s"):
        simulate(system, RunSettings(stop=1.0, step=0.1, record=("relay.mean[1]",)), tmp_path / "run")


def derivative(path: Path, folder: Path, outputs: Sequence[str], inputs: Mapping[str, float]) -> list[float]:
    """Change of the outputs with the inputs, by the function that the kernel calls; after a call for all inputs, of
    which nothing is to be left."""
    fmu = read_fmu(path)
    one = instantiate("one", fmu, extract(path, folder), 0.0)
    one.enter_initialisation()
    one.exit_initialisation()
    member = one.member()
    function = ctypes.CFUNCTYPE(
        c_int, c_void_p, c_void_p, c_size_t, c_void_p, c_size_t, POINTER(c_double), POINTER(c_double)
    )(member["directional"] or 0)
    found = (c_double * len(outputs))()
    for seeds in ({v.name: 7.0 for v in fmu.variables.values() if v.causality == "input"}, inputs):
        sought, known = (np.array([fmu.variables[n].reference for n in names], np.uint32) for names in (outputs, seeds))
        places = sought.ctypes.data, len(sought), known.ctypes.data, len(known)
        assert function(member["instance"], *places, (c_double * len(seeds))(*seeds.values()), found) == 0
    one.free(terminate=True)
    return list(found)


def test_directional_derivatives_of_some_elements(fmu_folder: Path, tmp_path: Path) -> None:
    """Of outputs and inputs in any order, and of parts of their arrays: what FMI 2.0 gives for scalars."""
    outputs = ("moment[2]", "force[3]", "force[2]", "moment[3]")
    some = {"attachment.angular_acceleration[3]": 0.5, "attachment.specific_force[3]": -2.0}
    paths = {fmi: build_fmu(make("tmd"), fmu_folder, fmi=fmi) for fmi in ("2", "3")}
    of = {fmi: derivative(path, tmp_path / fmi, outputs, some) for fmi, path in paths.items()}
    assert of["3"] == of["2"]
    assert of["2"][1] != 0.0


def test_a_warning_is_kept(foreign: Path, tmp_path: Path) -> None:
    start = {"fail_at": StartValue(0.46), "how": StartValue(4)}
    system = System("one", (ComponentInstance("relay", foreign, start),))
    result = simulate(system, RunSettings(stop=1.0, step=0.1, record=("relay.mean[1]",)), tmp_path / "run")
    assert result.status == "completed"
    assert "relay: 100 % done" in result.warnings


def test_what_cannot_be_connected_or_set(foreign: Path, tmp_path: Path, built: Any) -> None:
    two = (ComponentInstance("a", foreign), ComponentInstance("b", foreign))
    settings = RunSettings(stop=1.0, step=0.1, record=("a.level",))

    def refused(system: System) -> str:
        with pytest.raises((CosimError, RunFailed)) as failure:
            simulate(system, settings, tmp_path / str(len(list(tmp_path.iterdir()))))
        return str(failure.value)

    assert "'in.Float64' is an array in relay.fmu" in refused(
        System("s", two, (Connection("a", "level", "b", "in.Float64"),))
    )
    assert "Integer cannot feed Boolean" in refused(System("s", two, (Connection("a", "out.Int8", "b", "in.Boolean"),)))
    length = {"length": StartValue(3)}
    assert "length = 3: is structuralParameter" in refused(System("s", (ComponentInstance("a", foreign, length),)))
    for kind, value, words in (
        ("Int8", 128, "128, of value reference 2, does not fit the type Int8"),
        ("Float32", 1e39, "1e+39, of value reference 1, does not fit the type Float32"),
        ("Int64", 2**53 + 1, "has more than 53 bits"),
    ):
        large = {f"in.{kind}[1]": StartValue(value)}
        assert words in refused(System("s", (ComponentInstance("a", foreign, large),)))
    assert "tick" not in read_fmu(foreign).variables
