"""The exporter: FMUs that agree with their Python definition, validate, and misuse of which is refused."""

from __future__ import annotations

import ctypes
import hashlib
import shutil
import subprocess
import zipfile
from collections.abc import Callable
from pathlib import Path

import casadi as ca
import fmpy
import fmpy.fmi2
import fmpy.validation
import numpy as np
import pytest
from fmpy.fmi1 import FMICallException

from fmus_src.component import Component
from fmus_src.equations import derive
from fmus_src.export import build
from fmus_src.export.exported import Exports
from fmus_src.export.sources import COMPILED, fmi_headers, source_files
from fmus_src.instance import Instance
from fmus_src.lookups import ImplicitLookup, LookupMemory
from fmus_src.tmd.model import component as tmd

from .conftest import every_feature
from .loaded import Loaded, initialised, refusal


@pytest.fixture(scope="module")
def feature_fmu(built: Callable[[Component], Path], tmp_path_factory: pytest.TempPathFactory) -> Loaded:
    return Loaded(built(every_feature()), tmp_path_factory.mktemp("feature"))


def outputs_of(fmu: Loaded) -> list[str]:
    return [v.name for v in fmu.description.modelVariables if v.causality == "output"]


def test_fmu_agrees_with_its_python_definition(feature_fmu: Loaded) -> None:
    names = outputs_of(feature_fmu)
    slave = initialised(feature_fmu)
    twin = Instance(every_feature())
    twin.initialise()
    for i in range(40):
        t = 0.03 * i
        u = {"u[1]": np.sin(t), "u[2]": 0.3 * np.cos(2 * t)}
        slope = {"u[1]": np.cos(t), "u[2]": -0.6 * np.sin(2 * t)}
        slave.setReal(feature_fmu.vr(*u), list(u.values()))
        slave.setRealInputDerivatives(feature_fmu.vr(*slope), [1, 1], list(slope.values()))
        slave.doStep(t, 0.03)
        twin.set(u)
        twin.set_slope(slope)
        twin.do_step(0.03)
        ours = twin.outputs()
        # The same operations in the same order; only the rounding of library functions and sums may differ.
        assert slave.getReal(feature_fmu.vr(*names)) == pytest.approx([ours[n] for n in names], rel=1e-11, abs=1e-11)
    assert twin.get("z") == 3 + 12  # twelve sample instants in 1.2 s
    slave.terminate()
    slave.freeInstance()


def test_validates_and_states_true_dependencies(feature_fmu: Loaded, fmu_folder: Path) -> None:
    assert fmpy.validation.validate_fmu(str(fmu_folder / "every_feature.fmu")) == []
    description = feature_fmu.description
    unknowns = (*description.outputs, *description.derivatives)
    every = {u.variable.name: [d.name for d in u.dependencies] for u in unknowns}
    depends = {name: [d for d in knowns if d.startswith("u[")] for name, knowns in every.items()}
    assert every["rotated[1]"] == ["x[1]", "x[2]"]
    assert depends["rotated[1]"] == []
    assert every["held[1]"] == []
    assert every["der(x[1])"] == ["u[1]", "u[2]", "x[1]"]
    assert depends["feedthrough[1]"] == ["u[1]", "u[2]"]
    assert depends["root[1]"] == ["u[1]"]
    assert depends["root[2]"] == ["u[2]"]
    assert depends["product[2]"] == ["u[2]"]
    listed = [v.name for v in description.modelVariables]
    assert "z" in listed
    assert "before[1]" not in listed
    assert all(v.description for v in description.modelVariables)


def test_directional_derivatives_equal_finite_differences(feature_fmu: Loaded) -> None:
    names = outputs_of(feature_fmu)
    at = {"u[1]": 0.42, "u[2]": -0.33}
    slave = initialised(feature_fmu)
    step = 1e-4
    for known in at:
        columns = []
        for shift in (-step, step):
            shifted = at | {known: at[known] + shift}
            slave.setReal(feature_fmu.vr(*shifted), list(shifted.values()))
            columns.append(np.array(slave.getReal(feature_fmu.vr(*names))))
        slave.setReal(feature_fmu.vr(*at), list(at.values()))
        exact = slave.getDirectionalDerivative(feature_fmu.vr(*names), feature_fmu.vr(known), [1.0])
        # Truncation step^2/6 times a third derivative of order one, and Newton's tolerance 1e-12 over the step: 1e-8.
        np.testing.assert_allclose(exact, (columns[1] - columns[0]) / (2 * step), rtol=0, atol=1e-7)
    slave.freeInstance()


def test_state_is_complete(feature_fmu: Loaded) -> None:
    """After a restore (from bytes too) the same steps give the same bits."""
    names = outputs_of(feature_fmu)
    slave = initialised(feature_fmu)

    def advance(begin: float) -> list[float]:
        for i in range(5):
            slave.setReal(feature_fmu.vr("u[1]", "u[2]"), [0.1 * i, 0.5])
            slave.doStep(begin + 0.07 * i, 0.07)
        return list(slave.getReal(feature_fmu.vr(*names)))

    advance(0.0)
    state = slave.getFMUstate()
    stored = slave.serializeFMUstate(state)
    first = advance(5 * 0.07)
    slave.setFMUstate(state)
    assert advance(5 * 0.07) == first
    other = initialised(feature_fmu)
    again = other.deSerializeFMUstate(stored)
    other.setFMUstate(again)
    slave, other = other, slave
    assert advance(5 * 0.07) == first
    other.freeFMUstate(state)
    slave.freeFMUstate(again)
    slave.freeInstance()
    other.freeInstance()


def test_instances_are_independent_and_reset_restarts(feature_fmu: Loaded) -> None:
    one, two = initialised(feature_fmu), initialised(feature_fmu, {"rate": 5.0})
    for i in range(10):
        one.doStep(0.1 * i, 0.1)
    for i in range(10):
        two.doStep(0.1 * i, 0.1)
    x = feature_fmu.vr("x[2]")
    # Five Runge-Kutta sub-steps' error of exp(-rate t): (rate h)^5/120 a step.
    assert one.getReal(x)[0] == pytest.approx(np.exp(-2.0), rel=1e-5)
    assert two.getReal(x)[0] == pytest.approx(np.exp(-5.0), rel=1e-3)
    before = one.getReal(x)
    one.reset()
    one.setupExperiment(startTime=0.0)
    one.enterInitializationMode()
    one.exitInitializationMode()
    for i in range(10):
        one.doStep(0.1 * i, 0.1)
    assert one.getReal(x) == before
    one.freeInstance()
    two.freeInstance()


def test_stops_agree_with_python_and_survive_a_restore(built: Callable[[Component], Path], tmp_path: Path) -> None:
    """A damper thrown from stop to stop: crossings are located alike, and from a state saved in contact."""
    fmu, twin = Loaded(built(tmd()), tmp_path), Instance(tmd())
    names, given = ["displacement", "velocity", "stop_force"], {"stroke": 0.5, "initial_displacement": 0.4}
    slave, push = initialised(fmu, given), fmu.vr("attachment.specific_force[1]")
    twin.set(given)
    twin.initialise()
    contacts, state = 0, None
    for i in range(120):
        u = 6.0 * np.sin(0.075 * i)
        slave.setReal(push, [u])
        twin.set({"attachment.specific_force[1]": u})
        slave.doStep(0.05 * i, 0.05)
        twin.do_step(0.05)
        values = slave.getReal(fmu.vr(*names))
        # A crossing is located to 1e-10 of a sub-step, within which rounding decides where: 1e-12 s of 1e6 N/s.
        assert values == pytest.approx([twin.get(n) for n in names], rel=1e-9, abs=1e-9)
        contacts += values[2] != 0.0
        if state is None and contacts == 3:
            state, after = slave.getFMUstate(), i + 1
    assert 10 < contacts < 110
    slave.setFMUstate(state)
    for i in range(after, 120):
        slave.setReal(push, [6.0 * np.sin(0.075 * i)])
        slave.doStep(0.05 * i, 0.05)
    assert slave.getReal(fmu.vr(*names)) == values
    slave.freeFMUstate(state)
    slave.freeInstance()


def test_a_switch_may_depend_on_a_lookup(built: Callable[[Component], Path], tmp_path: Path) -> None:
    c = Component("bend", "A slope that changes where twice the state is one", internal_step=0.1)
    x = c.state("x", start=1.0, description="state")
    c.derivative(x, -1 - 3 * c.switch("side", c.intermediate("twice", 2 * x) - 1))
    fmu, twin = Loaded(built(c), tmp_path), Instance(c)
    slave = initialised(fmu)
    twin.initialise()
    slave.doStep(0.0, 0.5)
    twin.do_step(0.5)
    # from 1 at -4 / s to 0.5 at 0.125 s, then at -1 / s; the crossing is located to 1e-10 of a step of 0.1 s
    assert slave.getReal(fmu.vr("x")) == pytest.approx([0.125], abs=1e-10)
    assert twin.get("x") == pytest.approx(0.125, abs=1e-10)
    slave.freeInstance()


@pytest.mark.parametrize(
    ("misuse", "words"),
    [
        (lambda s, f: s.setReal(f.vr("rate"), [-1.0]), "rate = -1 is outside its bounds 0 to 100"),
        (lambda s, f: s.setReal(f.vr("u[1]"), [float("nan")]), "u[1] = nan is not finite"),
        (lambda s, f: s.setReal(f.vr("matrix[1,1]"), [2.0]), "matrix[1,1] cannot be set after initialisation"),
        (lambda s, f: s.setReal(f.vr("scaled"), [2.0]), "computed by the FMU"),
        (lambda s, f: s.getReal([10_000]), "no such value reference: 10000"),
        (lambda s, f: s.getReal(f.vr("n")), "no such value reference"),
        (lambda s, f: s.doStep(0.5, 0.1), "called for 0.5 s, but the FMU is at 0 s"),
        (lambda s, f: s.doStep(0.0, 0.0), "step 0 s is not positive"),
        (lambda s, f: s.enterInitializationMode(), "called out of order"),
    ],
)
def test_misuse_is_refused_with_a_message(
    feature_fmu: Loaded, misuse: Callable[[fmpy.fmi2.FMU2Slave, Loaded], None], words: str
) -> None:
    slave = initialised(feature_fmu)
    feature_fmu.messages.clear()
    with pytest.raises(FMICallException):
        misuse(slave, feature_fmu)
    assert any(words in m for m in feature_fmu.messages), feature_fmu.messages
    slave.freeInstance()


def test_divergence_names_the_state(built: Callable[[Component], Path], tmp_path: Path) -> None:
    c = Component("runaway", "x' = x^2 blows up at t = 1")
    x = c.state("x", start=1.0, description="state")
    c.derivative(x, x**2)
    fmu = Loaded(built(c), tmp_path)
    slave = initialised(fmu)
    with pytest.raises(FMICallException):
        slave.doStep(0.0, 2.0)
    assert "state x" in fmu.messages[-1]
    assert "unstable" in fmu.messages[-1]
    slave.freeInstance()


def test_same_input_same_bytes_whatever_the_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    digests = set()
    for name in ("a", "b/with/a/longer/path"):
        monkeypatch.setattr(build, "user_cache_path", lambda _, n=name: tmp_path / n)
        fmu = build.build_fmu(tmd(), tmp_path / name / "out")
        digests.add(hashlib.sha256(fmu.read_bytes()).hexdigest())
    assert len(digests) == 1


def test_unchanged_components_come_from_the_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(build, "user_cache_path", lambda _: tmp_path / "cache")
    build.build_fmu(tmd(), tmp_path / "one")
    compiled = []
    monkeypatch.setattr(build, "compile_shared", lambda *a, **k: compiled.append(a))
    build.build_fmu(tmd(), tmp_path / "two")
    assert (tmp_path / "one/tmd.fmu").read_bytes() == (tmp_path / "two/tmd.fmu").read_bytes()
    assert compiled == []


@pytest.mark.skipif(shutil.which("ldd") is None, reason="needs ldd")
def test_needs_only_libc_and_libm(feature_fmu: Loaded) -> None:
    library = next((feature_fmu.folder / "binaries").rglob("every_feature.so"))
    listed = subprocess.run(["ldd", library], capture_output=True, text=True, check=True).stdout
    names = {line.split()[0].rsplit("/", 1)[-1].split(".")[0] for line in listed.splitlines()}
    assert names <= {"linux-vdso", "libc", "libm", "libdl", "libpthread", "ld-linux-x86-64"}, listed


def test_exports_fmi_functions_only(feature_fmu: Loaded) -> None:
    library = ctypes.CDLL(str(next((feature_fmu.folder / "binaries").rglob("every_feature.*"))))
    assert library.fmi2DoStep
    for internal in ("derivatives", "outputs", "model", "wind_box_open"):
        assert not hasattr(library, internal)


def started_with(fmu: Loaded, **experiment: float) -> fmpy.fmi2.FMU2Slave:
    slave = fmu.instance()
    slave.setupExperiment(**experiment)
    slave.enterInitializationMode()
    slave.exitInitializationMode()
    return slave


def test_refuses_steps_beyond_the_stop_time_and_from_no_time(feature_fmu: Loaded) -> None:
    """FMI 2.0.4, fmi2SetupExperiment: an FMU that is asked to compute past a defined stop time returns an error."""
    slave = started_with(feature_fmu, startTime=0.0, stopTime=0.3)
    for i in range(3):
        slave.doStep(0.1 * i, 0.1)  # to 0.30000000000000004
    assert "beyond the stop time 0.3" in refusal(feature_fmu, lambda: slave.doStep(0.3, 0.1))
    slave.freeInstance()
    for nowhere in (float("nan"), float("inf")):
        slave = initialised(feature_fmu)
        assert "but the FMU is at 0 s" in refusal(feature_fmu, lambda: slave.doStep(nowhere, 0.1))  # noqa: B023
        slave.freeInstance()


def test_after_the_end_it_can_be_read_only(feature_fmu: Loaded) -> None:
    """Terminated (and failed): values may be got, nothing may be set or stepped; reset starts again."""
    for misuse in (
        lambda s: s.doStep(0.1, 0.1),
        lambda s: s.setReal(feature_fmu.vr("u[1]"), [1.0]),
        lambda s: s.setReal(feature_fmu.vr("matrix[1,1]"), [2.0]),
        lambda s: s.setString(feature_fmu.vr("file"), ["wind.bts"]),
    ):
        slave = initialised(feature_fmu)
        slave.doStep(0.0, 0.1)
        at_end = slave.getReal(feature_fmu.vr("x[1]"))
        slave.terminate()
        assert slave.getReal(feature_fmu.vr("x[1]")) == at_end
        refusal(feature_fmu, lambda: misuse(slave))  # noqa: B023
        assert slave.getReal(feature_fmu.vr("x[1]")) == at_end  # a failed FMU is not set back to its start either
        refusal(feature_fmu, lambda: slave.setReal(feature_fmu.vr("matrix[1,1]"), [2.0]))  # noqa: B023
        slave.reset()
        slave.setupExperiment(startTime=0.0)
        slave.enterInitializationMode()
        slave.exitInitializationMode()
        slave.doStep(0.0, 0.1)
        assert slave.getReal(feature_fmu.vr("x[1]")) == at_end
        slave.freeInstance()


def test_booleans_are_zero_or_one_and_calculated_parameters_follow_tunable_ones(feature_fmu: Loaded) -> None:
    slave, twin = initialised(feature_fmu), Instance(every_feature())
    twin.initialise()
    slave.setReal(feature_fmu.vr("rate"), [5.0])
    twin.set({"rate": 5.0})
    assert slave.getReal(feature_fmu.vr("scaled_again")) == [15.0]
    assert twin.get("scaled_again") == 15.0
    of = {v.name: v for v in feature_fmu.description.modelVariables}
    assert of["scaled"].variability == "tunable"
    slave.reset()
    slave.setBoolean(feature_fmu.vr("on"), [7])
    assert slave.getBoolean(feature_fmu.vr("on")) == [1]
    slave.freeInstance()


def test_implicit_solution_recovers_from_a_jump() -> None:
    """Newton from the solution before fails across the jump; a fresh guess finds the root, as in C."""
    y, a = ca.SX.sym("y"), ca.SX.sym("a")
    # r = 1 + exp(y) at y < 0 has no root and at y = -50 no slope: no step from there reduces it.
    residual = ca.Function("r", [y, a], [ca.if_else(y < 0, 1 + ca.exp(y), y - a)])
    lookup = ImplicitLookup("jump", residual, ca.Function("g", [a], [a]), 1)
    memory = LookupMemory([])
    memory.solutions["jump"] = np.array([[-50.0]])
    assert lookup.evaluate(np.array([2.0]), memory) == pytest.approx([2.0])


def test_declarations_that_the_runtime_cannot_hold_are_refused() -> None:
    grid = np.zeros((1, 3, 1))
    c = Component("c", "Component")
    x = c.input("x", description="argument")
    c.table("one", grid, 0.0, 1.0, [0], x)
    for which, data, spacing in ([1], grid, 1.0), ([-1], grid, 1.0), ([0], grid[:, :1], 1.0), ([0], grid, 0.0):
        with pytest.raises(ValueError, match="table 'two'"):
            c.table("two", data, 0.0, spacing, which, x)
    with pytest.raises(ValueError, match="lookup 'one' is declared twice"):
        c.table("one", grid, 0.0, 1.0, [0], x)
    with pytest.raises(ValueError, match="must be above 0"):
        Component("c", "Component", internal_step=0.0)


def test_display_unit_with_an_offset() -> None:
    c = Component("warm", "A temperature")
    c.parameter("temperature", 293.15, unit="K", display_unit="degC", description="temperature")
    xml = build._content(c)["modelDescription.xml"].decode()
    assert '<DisplayUnit name="degC" factor="1.0" offset="-273.15"' in xml


DRIVERS = {"2": Path(__file__).parent / "runtime_cycle.c", "3": Path(__file__).parent / "runtime_cycle3.c"}


@pytest.mark.parametrize("fmi", ["2", "3"])
@pytest.mark.skipif(shutil.which("gcc") is None, reason="needs gcc with sanitizers")
def test_memory_is_clean_over_a_full_cycle(fmi: str, tmp_path: Path) -> None:
    """AddressSanitizer and UBSan over instantiate, run, save, restore, reset, free; leaks included."""
    for name, text in source_files(Exports(derive(every_feature())), "{test}", fmi).items():
        (tmp_path / name).write_text(text)
    program = tmp_path / "cycle"
    flags = ["-std=c99", "-g", "-O1", "-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-w"]
    sources = [str(DRIVERS[fmi]), *COMPILED[fmi]]
    made = subprocess.run(
        ["gcc", *flags, "-I.", *sources, "-lm", "-o", str(program)], cwd=tmp_path, capture_output=True, text=True
    )
    if made.returncode != 0 and "san" in made.stderr:
        pytest.skip("gcc has no sanitizer libraries")
    assert made.returncode == 0, made.stderr
    ran = subprocess.run([str(program)], cwd=tmp_path, capture_output=True, text=True)
    assert ran.returncode == 0, ran.stdout + ran.stderr
    assert "cycle complete" in ran.stdout


def test_sources_are_complete_for_any_compiler(built: Callable[[Component], Path], tmp_path: Path) -> None:
    """The archive's sources alone (FMI headers included) compile; binaries are not needed."""
    with zipfile.ZipFile(built(tmd())) as archive:
        archive.extractall(tmp_path)
    assert {p.name for p in (tmp_path / "sources").iterdir()} >= {*COMPILED["2"], "fmi2Functions.h", "equations.c"}
    from fmus_src.export.compiler import compile_shared

    made = compile_shared([Path(s) for s in COMPILED["2"]], tmp_path / "again.so", working_dir=tmp_path / "sources")
    assert made.stat().st_size > 10_000
    assert (fmi_headers() / "fmi2Functions.h").exists()


def test_loads_in_libcosim(built: Callable[[Component], Path]) -> None:
    libcosimpy = pytest.importorskip("libcosimpy")
    from libcosimpy.CosimExecution import CosimExecution
    from libcosimpy.CosimObserver import CosimObserver
    from libcosimpy.CosimSlave import CosimLocalSlave

    assert libcosimpy
    execution = CosimExecution.from_step_size(step_size=12_500_000)
    slave = execution.add_local_slave(CosimLocalSlave(fmu_path=str(built(every_feature())), instance_name="one"))
    observer = CosimObserver.create_last_value()
    assert execution.add_observer(observer)
    assert execution.simulate_until(target_time=1_000_000_000)
    reference = {
        v.name: v.valueReference for v in fmpy.read_model_description(str(built(every_feature()))).modelVariables
    }
    values = observer.last_real_values(slave, [reference["x[1]"], reference["x[2]"]])
    assert values == pytest.approx([3 * np.exp(-2.0), np.exp(-2.0)], rel=1e-6)
