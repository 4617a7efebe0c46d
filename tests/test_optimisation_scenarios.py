"""`fowt optimise` over scenarios, end to end, and design variables beyond stiffness and damping."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
import types
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.progress import Progress

from cosim.cli.scenario_options import parsed_scenarios
from cosim.cli.scenarios import CoupledRuns, _prior, linear_models
from cosim.errors import CosimError
from cosim.ssp import read_parameters
from fmus_src.component import Component
from fmus_src.simplified.model import component
from optimisation.checkpoint import read_checkpoint
from optimisation.receptance import Damper, LinearModel
from optimisation.scenario_tuning import tune_scenarios
from optimisation.scenarios import ScenarioFitness
from optimisation.tuning import Request, optimise

from .conftest import Outcome

# the simplified model as a system of one FMU: the machinery of a co-simulation in a hundredth of its time
TINY = ("--objective", "coupled", "--cases", "decay5-simplified,decay10-simplified", "--until", "20")


@pytest.fixture(scope="module")
def fmu(built: Callable[[Component], Path]) -> Path:
    return built(component())


def result(folder: Path) -> dict[str, Any]:
    content = json.loads((folder / "result.json").read_text())
    del content["seconds"]
    return dict(content)


def test_the_best_is_what_a_run_of_it_gives(fowt: Callable[..., Outcome], tmp_path: Path) -> None:
    words = ("optimise", "tmd-p", *TINY, "--evaluations", "10", "--start", "tmd-p", "--out", "found")
    outcome = fowt(*words)
    assert outcome.code == 0, outcome.err
    found = result(tmp_path / "found")
    ratios = [r for s in found["scenarios"] for r in s["ratio"].values()]
    assert found["fitness"] == max(ratios)
    assert found["fitness"] <= found["starts"][0]["fitness"]  # the published design is one of those evaluated
    assert len((tmp_path / "found/simulations.jsonl").read_text().splitlines()) == 2 * (10 + 1)
    assert (tmp_path / "found/convergence.png").stat().st_size > 10_000
    tuned = fowt("run", "decay10-simplified", "--damper", "tmd-p", "--ssv", "found/tuned.ssv", "--until", "20",
                 "--out", "run")  # fmt: skip
    assert tuned.code == 0, tuned.err
    summary = json.loads((tmp_path / "run/summary.json").read_text())
    assert found["scenarios"][1]["std"] == {c: summary[c]["std"] for c in ("PtfmPitch", "TTDspFA")}
    assert not list(tmp_path.glob("runs"))


def test_a_killed_search_resumes_to_the_same_result(fowt: Callable[..., Outcome], tmp_path: Path) -> None:
    words = ["optimise", "tmd-p", *TINY, "--evaluations", "10", "--population", "2", "--workers", "1"]
    words += ["--relative-to", "tmd-p"]
    command = [sys.executable, "-c", "from cosim.cli import main; main()", *words, "--out", "killed"]
    paths = os.pathsep.join([str(Path(__file__).parents[1]), os.environ.get("PYTHONPATH", "")])
    process = subprocess.Popen(command, cwd=tmp_path, env=os.environ | {"PYTHONPATH": paths})
    store = tmp_path / "killed/simulations.jsonl"
    deadline = time.monotonic() + 60.0
    try:
        # in the midst of the first designs: no generation is complete
        while not (store.exists() and store.read_bytes().count(b"\n") >= 6):
            assert process.poll() is None, "the search ended before it could be killed"
            assert time.monotonic() < deadline
            time.sleep(0.01)
    finally:
        process.send_signal(signal.SIGKILL)
        process.wait()
    before = store.read_bytes().count(b"\n")
    refused = fowt("optimise", "--resume", "killed", "--objective", "coupled", "--channels", "PtfmPitch")
    assert refused.code == 1
    assert "checkpoint of another problem: channels PtfmPitch, there PtfmPitch:TTDspFA" in refused.err
    assert store.read_bytes().count(b"\n") == before
    assert fowt("optimise", "--resume", "killed").code == 0
    assert fowt(*words, "--out", "whole").code == 0
    assert result(tmp_path / "killed") == result(tmp_path / "whole")


def test_a_load_case_in_wind_and_waves(fowt: Callable[..., Outcome]) -> None:
    words = ("--objective", "coupled", "--cases", "lc1", "--seeds", "1,2", "--until", "1", "--evaluations", "2")
    outcome = fowt("optimise", "mtmd", *words, "--variable", "nacelle_damper.m=10000:40000", "--format", "json")
    assert outcome.code == 0, outcome.err
    found = json.loads(outcome.out)
    assert [s["scenario"] for s in found["scenarios"]] == ["lc1 seed 1", "lc1 seed 2"]
    first, second = (s["reference"]["PtfmPitch"] for s in found["scenarios"])
    assert first != second
    assert 10000 <= found["parameters"]["nacelle_damper.m"] <= 40000


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--cases", "lc44"), "no load case 'lc44'; did you mean 'lc4'?"),
        ((), "name load cases, such as --cases lc1,lc4"),
        (("--cases", "lc1", "--seeds", "x"), "--seeds x: 'x' is no seed; write whole numbers from 0"),
        (("--cases", "decay5", "--seeds", "1"), "decay5 has no random wind or sea"),
        (("--cases", "lc1=-1", "--until", "1"), "a weight is at least 0"),
        (("--cases", "lc1", "--channels", "PtfmPich"), "lc1: no channel 'PtfmPich'; did you mean 'PtfmPitch'?"),
        (("--cases", "decay5", "--until", "1", "--channels", "PtfmPitch,NStC1_XQ"), "not there with damper 'none'"),
        (("--cases", "lc1", "--until", "-1"), "stop -1 s must be finite"),
        (("--cases", "lc1", "--relative-to", "nothing"), "no damper arrangement 'nothing'"),
        (("--cases", "lc1", "--relative-to", "none.ssv"), "--relative-to none.ssv: neither a parameter set file"),
        (("--cases", "lc1", "--start", "tmd-n"), "--start tmd-n: has no value of platform_damper.k"),
        (("--cases", "lc1", "--start", "mtmd", "--bounds", "nacelle_damper.k=1:2"), "nacelle_damper.k = 7653 is"),
        (("--cases", "lc1", "--method", "ga", "--start", "mtmd"), "--start is for --method surrogate, not ga"),
        (("--cases", "lc1", "--variable", "nacelle_damper.R=1:90"), "tmd.fmu has no real parameter 'R'"),
        (("--cases", "lc1", "--variable", "mast.m=1:9"), "no component 'mast'"),
        (("--cases", "lc1", "--variable", "nacelle_damper.m=0:9"), "tmd.fmu needs at least 0.001 kg"),
        (("--cases", "lc1", "--variable", "nacelle_damper.m=9:0"), "the lower bound comes first"),
        (("--cases", "lc1", "--vary", "barge.x=1,y"), "barge.x: 'y' is no finite number"),
        (("--cases", "lc1", "--set", "nacelle_damper.k=3"), "'nacelle_damper.k' is set by the optimisation"),
        (("--cases", "lc1", "--polish"), "--polish refines the free decay's optimum only"),
        (("--cases", "lc1", "--models", "nowhere"), "--models nowhere: no linear models"),
    ],
)  # fmt: skip
def test_a_mistake_gets_one_line(
    fowt: Callable[..., Outcome], tmp_path: Path, words: tuple[str, ...], message: str
) -> None:
    outcome = fowt("optimise", "mtmd", "--objective", "coupled", *words)
    assert outcome.code == 1
    assert outcome.err.count("error:") == 1
    assert message in outcome.err
    assert not list(tmp_path.glob("runs/*/result.json"))


def test_designs_that_break_off_are_counted(fowt: Callable[..., Outcome], tmp_path: Path) -> None:
    """A spring far beyond what the integration step resolves."""
    words = ("--cases", "decay5-simplified", "--until", "5", "--channels", "TTDspFA", "--evaluations", "8")
    outcome = fowt(
        "optimise", "tmd-n", "--objective", "coupled", *words, "--bounds", "nacelle_damper.k=0:1e10", "--format", "json"
    )
    assert outcome.code == 0, outcome.err
    assert json.loads(outcome.out)["failures"] > 0
    assert "designs failed and were penalised; the first: decay5-simplified: " in " ".join(outcome.err.split())
    all_fail = fowt("optimise", "tmd-n", "--objective", "coupled", *words, "--bounds", "nacelle_damper.k=1e12:2e12")
    assert all_fail.code == 1
    assert "all 8 designs failed; the first: decay5-simplified: " in all_fail.err


class FakeModel:
    """A linear model of two channels whose deviations are known."""

    channels = ("PtfmPitch", "TTDspFA")
    dampers = (types.SimpleNamespace(name="platform_damper"),)

    def __init__(self, label: str) -> None:
        self.label, self.about = label, {"case": label}

    @classmethod
    def load(cls, path: Path) -> FakeModel:
        return cls(path.stem)


class FakeResponse:
    def __init__(self, models: list[FakeModel], variables: list[str], fixed: dict[str, float]) -> None:
        assert fixed.keys().isdisjoint(variables)
        self.channels, self._models, self._variables = FakeModel.channels, models, list(variables)
        self._fixed = fixed

    def __call__(self, x: np.ndarray) -> np.ndarray:
        names = [f"platform_damper.{n}" for n in "kc"]
        k, c = (
            x[:, self._variables.index(n)] if n in self._variables else np.full(len(x), self._fixed[n]) for n in names
        )
        distance = (k / 5e4 - 1.0) ** 2 + (c / 1e4 - 1.0) ** 2
        return np.stack(
            [np.stack([1.0 + (i + 1) * distance, 0.5 + distance], axis=1) for i in range(len(self._models))], 1
        )


def test_linear_models_as_the_objective_and_as_a_guide(
    fowt: Callable[..., Outcome], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, content in (("receptance", {"LinearModel": FakeModel}), ("spectral", {"SpectralResponse": FakeResponse})):
        monkeypatch.setitem(sys.modules, f"optimisation.{name}", types.SimpleNamespace(**content))  # type: ignore[arg-type]
    folder = tmp_path / "models"
    folder.mkdir()
    for label in ("decay5-simplified", "decay10-simplified"):
        (folder / f"{label}.npz").write_text(label)
    words = ("optimise", "tmd-p", "--objective", "spectral", "--models", "models", "--format", "json")
    outcome = fowt(*words, "--method", "cma-es", "--evaluations", "300", "--out", "spectral")
    assert outcome.code == 0, outcome.err
    found = json.loads(outcome.out)
    # table 4's 53,565 and 13,839 have a distance of 0.15244: 1 by 1.15244 and 0.5 by 0.65244 for the first model
    assert found["relative_to"] == "tmd-p"
    assert found["fitness"] == pytest.approx(1.0 / 1.15244, abs=1e-4)
    assert found["parameters"]["platform_damper.k"] == pytest.approx(5e4, rel=0.01)
    refused = fowt(*words, "--relative-to", "none")
    assert "linear models have dampers: compare with tmd-p or a .ssv file" in refused.err
    assert "platform_damper, mtmd nacelle_damper and platform_damper" in fowt(*("optimise", "mtmd"), *words[2:]).err
    (folder / "decay5-simplified.npz").write_text("of other runs")
    assert "this search has ended" in fowt("optimise", "--resume", "spectral").err
    (tmp_path / "spectral/result.json").unlink()
    assert "name their folder (--models FOLDER)" in fowt("optimise", "--resume", "spectral").err
    assert (
        "the model of decay5-simplified is another"
        in fowt("optimise", "--resume", "spectral", "--models", "models").err
    )
    guided = fowt("optimise", "tmd-p", *TINY, "--models", "models", "--evaluations", "5", "--format", "json")
    assert guided.code == 0, guided.err
    assert json.loads(guided.out)["evaluations"] == 5


def model(folder: Path, case: str, seed: int, values: tuple[str, ...], pitch: float) -> None:
    """A linear model as `fowt linearise` leaves it, on which dampers have no effect: its STD of pitch is given."""
    words = ["", *values][-1].replace("[", "").replace("]", "")
    label = f"{case}-seed{seed}" + (f"-{words}" if words else "")
    time = np.arange(0.0, 20.0, 0.5)
    LinearModel(
        label, ("PtfmPitch", "TTDspFA"), ("deg", "m"), (Damper("platform_damper", 2e5, "s", "a"),),
        p=0.1 + 2j * np.pi * np.arange(len(time) // 2) / 20.0, base=np.zeros((len(time) // 2, 3), complex),
        gain=np.zeros((len(time) // 2, 3, 1), complex), rest=np.array([pitch, 0.5]) ** 2, step=0.5, length=len(time),
        start=0.0, stop=19.5, about={"case": case, "seed": seed, "damper": "tmd-p", "set": list(values)},
    ).save(folder / f"linear-{label}.npz")  # fmt: skip


def test_each_scenario_is_guided_by_its_own_linear_model(tmp_path: Path) -> None:
    """Cases with and without chance, seeds, a varied parameter: by what a model was made from, not by its label."""
    inertia, stiff = "barge.platform.inertia[2]", "barge.nacelle.yaw_stiffness=1e9"
    given = [("lc1", s, v, 10.0 * s + i) for s in (1, 2) for i, v in enumerate(((), *((f"{inertia}={x}",) for x in
             ("1.33e9", "1.45e9", "1590000000"))))] + [("decay5", 1, (), 5.0), ("lc3", 1, (stiff,), 7.0)]  # fmt: skip
    for case, seed, values, pitch in given:
        model(tmp_path, case, seed, values, pitch)
    models = linear_models(tmp_path)

    def prior(cases: str, seeds: str | None, *vary: str, **more: Any) -> np.ndarray:
        scenarios = parsed_scenarios(cases, seeds, vary)
        request = Request("tmd-p", scenarios=scenarios, channels=("PtfmPitch",), objective="coupled", **more)
        return _prior(request, models)[0](np.array([[5e4, 1e4]]))[0]

    # the models' own, rounding of a square root apart
    np.testing.assert_allclose(prior("decay5,lc1", None), [5.0, 10.0])
    np.testing.assert_allclose(prior("lc1", "2,1", f"{inertia}=1.59e9,1.33e9"), [23.0, 21.0, 13.0, 11.0])
    np.testing.assert_allclose(prior("lc3", "1", parameters={"barge.nacelle.yaw_stiffness": 1e9}), [7.0])
    np.testing.assert_allclose(prior("lc1", "1", parameters={"platform_damper.stroke": 9.0}), [10.0])
    for wrong, label in (
        (("lc1", "3"), "lc1 seed 3"),
        (("lc1", "1", f"{inertia}=1.5e9"), f"lc1 seed 1, {inertia} = 1.5e+09"),
        (("lc3", "1"), "lc3 seed 1"),  # its model has another stiffness
        (("lc1", "1", "platform_damper.stroke=9,10"), "lc1 seed 1, platform_damper.stroke = 9"),
    ):
        with pytest.raises(CosimError, match=f"--models: none of '{re.escape(label)}'; name a folder with one"):
            prior(*wrong)
    model(tmp_path, "decay5", 2, (), 5.0)
    models = linear_models(tmp_path)
    with pytest.raises(
        CosimError, match=r"--models: 2 \(linear-decay5-seed1.npz, linear-decay5-seed2.npz\) of 'decay5'"
    ):
        prior("decay5", None)


def test_the_progress_bar_never_goes_back(fowt: Callable[..., Outcome], monkeypatch: pytest.MonkeyPatch) -> None:
    """Two scenarios of ten designs and of the reference are 22 from the start; a search of linear models alike."""
    shown: list[tuple[float, float]] = []

    class Bar(Progress):
        def update(self, *words: Any, **options: Any) -> None:
            super().update(*words, **options)
            shown.append((self.tasks[0].completed, self.tasks[0].total or 0.0))

    monkeypatch.setattr("cosim.cli.optimise_report.count_progress", lambda *_, **__: Bar(disable=True))
    done = fowt("optimise", "tmd-p", *TINY, "--evaluations", "10", "--start", "tmd-p", "--workers", "1")
    assert done.code == 0, done.err
    assert shown == sorted(shown)
    assert {total for _, total in shown} == {22.0}
    assert {n for n, _ in shown} >= {*map(float, range(1, 23))}


def test_the_checkpoint_is_there_before_the_objective_is_made(tmp_path: Path) -> None:
    """Making the objective may take minutes (its reference is simulated); another problem is refused before."""
    request = Request("tmd-p", method="surrogate", objective="coupled", channels=("PtfmPitch",))
    file, made = tmp_path / "checkpoint.npz", []

    def broken() -> ScenarioFitness:
        made.append(read_checkpoint(file)[0]["seed"])
        raise KeyboardInterrupt

    for resume in (False, True):
        with pytest.raises(KeyboardInterrupt):
            tune_scenarios(request, broken, request.task(), {}, checkpoint=file, resume=resume)
    assert made == [1, 1]
    with pytest.raises(ValueError, match="is a checkpoint of another problem: seed 2, there 1"):
        tune_scenarios(replace(request, seed=2), broken, request.task(), {}, checkpoint=file, resume=True)
    assert made == [1, 1]


def test_what_the_reference_costs_is_kept_whatever_happens_to_it(
    fowt: Callable[..., Outcome], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The second scenario of the reference fails for a full disk; afterwards the search goes on with the first."""
    words = ("optimise", "tmd-p", *TINY, "--evaluations", "6", "--workers", "1")
    real, calls = CoupledRuns._simulate, 0

    def full_disk(self: CoupledRuns, *given: Any) -> np.ndarray:
        nonlocal calls
        calls += 1
        if calls == 2:
            raise OSError("no space left")
        return real(self, *given)

    monkeypatch.setattr(CoupledRuns, "_simulate", full_disk)
    assert "no space left" in fowt(*words, "--out", "kept").err
    assert {p.name for p in (tmp_path / "kept").iterdir()} == {"checkpoint.npz", "simulations.jsonl"}
    calls = 2
    assert fowt("optimise", "--resume", "kept").code == 0
    assert calls - 2 == 2 * (6 + 1) - 1  # all but the one that had finished
    assert fowt(*words, "--out", "whole").code == 0
    assert result(tmp_path / "kept") == result(tmp_path / "whole")


def test_a_heavier_damper_does_better(fowt: Callable[..., Outcome], fmu: Path, tmp_path: Path) -> None:
    words = ("--fmu", str(fmu), "--method", "cma-es", "--evaluations", "200", "--format", "json")
    outcome = fowt("optimise", "tmd-p", *words, "--variable", "platform_damper.m=100000:400000", "--out", "heavy")
    assert outcome.code == 0, outcome.err
    found = json.loads(outcome.out)
    fixed = optimise("tmd-p", fmu, seed=1, method="cma-es", evaluations=150)
    assert found["fitness"] < fixed.fitness - 0.01
    # the classical tunings agree: the optimum's response falls with the mass ratio, so that its bound is the optimum
    assert found["parameters"]["platform_damper.m"] == pytest.approx(4e5, rel=0.02)
    written = read_parameters(tmp_path / "heavy/tuned.ssv")["platform_damper.m"]
    assert written.unit is not None
    assert (written.value, written.unit.name) == (found["parameters"]["platform_damper.m"], "kg")
    for variable, message in (
        ("platform_damper.mass=1:2", "has no real parameter 'platform_damper.mass'; did you mean 'platform_damper.m'?"),
        ("platform_damper.active=0:1", "tmd-p sets it"),
        ("platform_damper.m=-1:2", "simplified.fmu needs at least 0.001 kg"),
    ):
        assert message in " ".join(fowt("optimise", "tmd-p", "--fmu", str(fmu), "--variable", variable).err.split())


def test_options_of_another_objective_are_refused(fowt: Callable[..., Outcome]) -> None:
    assert "--cases is for --objective coupled, not decay" in fowt("optimise", "mtmd", "--cases", "lc1").err
    spectral = fowt("optimise", "mtmd", "--objective", "spectral")
    assert "name the folder of linear models" in spectral.err
