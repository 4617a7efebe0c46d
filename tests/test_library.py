"""Every component of the package: valid FMUs that run elsewhere and agree with their Python definition."""

from __future__ import annotations

from pathlib import Path

import fmpy
import fmpy.validation
import numpy as np
import pytest

from cosim.cli.build import build, build_with_options
from cosim.errors import CosimError
from fmus_src.equations import derive
from fmus_src.instance import Instance
from fmus_src.library import _labels, build_library, build_variant, component_names, make, option_names

from .loaded import Loaded, initialised

NAMES = component_names()
STEP = 0.0125
STEPS = 20


@pytest.fixture(scope="session")
def library() -> dict[str, Path]:
    return build_library()[1]


def test_the_mission_s_components_are_there() -> None:
    assert set(NAMES) >= {"barge", "tmd", "mtmd", "aero", "hydro", "mooring", "servo", "simplified"}


@pytest.mark.parametrize("name", NAMES)
def test_description_is_valid_and_complete(library: dict[str, Path], name: str) -> None:
    assert fmpy.validation.validate_fmu(str(library[name])) == []
    description = fmpy.read_model_description(str(library[name]))
    assert not description.coSimulation.needsExecutionTool
    assert all(v.description for v in description.modelVariables)
    assert all(v.unit for v in description.modelVariables if v.type == "Real")


@pytest.mark.parametrize("name", NAMES)
def test_fmu_agrees_with_python(library: dict[str, Path], name: str, tmp_path: Path) -> None:
    """Both take the same steps under inputs that vary smoothly around their start values."""
    equations = derive(make(name))
    twin = Instance(equations)
    inputs = [(n, s) for v in equations.of("input") for n, s in zip(v.element_names(), v.start, strict=True)]
    scale = {"m": 0.5, "rad": 0.01, "m/s": 0.1, "rad/s": 0.01, "m/s2": 0.1, "rad/s2": 0.01, "N": 1e4, "N.m": 1e5}
    unit_of = {n: v.unit for v in equations.of("input") for n in v.element_names()}
    times = STEP * np.arange(STEPS + 1)
    signals = {
        n: start + scale.get(unit_of[n], 1.0) * np.sin((1.0 + 0.1 * i) * times) for i, (n, start) in enumerate(inputs)
    }
    outputs = [n for v in equations.of("output") for n in v.element_names()]
    twin.initialise()
    for i in range(STEPS):
        twin.set({n: s[i] for n, s in signals.items()})
        twin.set_slope({n: (s[i + 1] - s[i]) / STEP for n, s in signals.items()})
        twin.do_step(STEP)
    ours = np.array([twin.get(n) for n in outputs])

    fmu = Loaded(library[name], tmp_path)
    slave = initialised(fmu)
    references = fmu.vr(*signals)
    for i in range(STEPS):
        if references:
            slave.setReal(references, [s[i] for s in signals.values()])
            slopes = [(s[i + 1] - s[i]) / STEP for s in signals.values()]
            slave.setRealInputDerivatives(references, [1] * len(references), slopes)
        slave.doStep(times[i], STEP)
    theirs = np.array(slave.getReal(fmu.vr(*outputs)))
    slave.freeInstance()
    # The same algorithm; only the rounding of sums and library functions differs, relative to each output's own scale.
    nominal = np.array([v.nominal or 1.0 for v in equations.of("output") for _ in range(v.size)])
    scale_of = np.maximum(np.abs(ours), nominal)
    assert np.max(np.abs(theirs - ours) / scale_of) < 1e-9


@pytest.mark.parametrize("name", NAMES)
def test_loads_in_libcosim(library: dict[str, Path], name: str) -> None:
    pytest.importorskip("libcosimpy")
    from libcosimpy.CosimExecution import CosimExecution
    from libcosimpy.CosimSlave import CosimLocalSlave

    execution = CosimExecution.from_step_size(step_size=12_500_000)
    execution.add_local_slave(CosimLocalSlave(fmu_path=str(library[name]), instance_name="one"))
    assert execution.simulate_until(target_time=125_000_000)


@pytest.mark.parametrize(
    ("option", "value", "files"),
    [
        ("database", "deep", []),  # packaged, whatever lies here
        ("database", "./deep", ["deep"]),
        ("unit_length", 2.5, []),
        ("database", "folder", []),
        ("database", "Box", ["Box.1", "Box.3", "Box.hst"]),
        ("database", "Box.3", ["Box.1", "Box.3", "Box.hst"]),
        ("sea", Path("sea.csv"), ["sea.csv"]),
    ],
)
def test_only_files_that_an_option_means_are_its_content(
    option: str, value: object, files: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "gone").symlink_to(tmp_path / "nowhere")
    for name in ("deep", "2.5", "2.1", "Box.1", "Box.3", "Box.hst", "Box.out", "sea.csv", "folder/x"):
        (tmp_path / name).write_text(name)
    label = _labels({option: value})[0]
    assert ("sha256" in label) == bool(files)
    for path in (p for p in tmp_path.iterdir() if p.is_file()):
        path.write_text("changed")
        assert (_labels({option: value})[0] != label) == (path.name in files)
        path.write_text(path.name)


def test_bad_names_and_options_are_one_line(tmp_path: Path) -> None:
    with pytest.raises(CosimError, match="no component 'hydr'; did you mean 'hydro'") as expected:
        build_with_options("hydr", ["draft=5"])
    for ask in (lambda: build_variant("hydr", {"draft": 5}), lambda: make("hydr"), lambda: option_names("hydr")):
        with pytest.raises(ValueError, match="no component 'hydr'") as found:
            ask()
        assert str(found.value) == str(expected.value)
    with pytest.raises(ValueError, match="there is no database") as folder:
        build_variant("hydro", {"database": tmp_path})
    assert "\n" not in str(folder.value)
    for name in ("a/b", "a\\b"):
        with pytest.raises(CosimError, match="name of a file without a folder; --out names the folder"):
            build(["servo"], folder=tmp_path / "out", name=name)
    assert not (tmp_path / "out").exists()


def test_options_may_be_values_or_text() -> None:
    assert make("servo", {"sample_time": 0.01}).description == make("servo", {"sample_time": "0.01"}).description
