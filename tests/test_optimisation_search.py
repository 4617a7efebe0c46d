"""Searches that can be continued: bit for bit after an abrupt end, and never on another problem's checkpoint."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest

from fmus_src.component import Component
from fmus_src.simplified.model import component
from optimisation import checkpoint as checkpoints
from optimisation.checkpoint import fmu_digest, read_checkpoint, resumed_record, write_checkpoint
from optimisation.polish import polish
from optimisation.search import Found, Record, search
from optimisation.strategies import Method, make_strategy
from optimisation.tuning import Request, optimise

from .conftest import Outcome

LOWER, UPPER = np.array([0.0, -2.0]), np.array([10.0, 2.0])


@pytest.fixture(scope="module")
def fmu(built: Callable[[Component], Path]) -> Path:
    return built(component())


def bowl(x: np.ndarray) -> np.ndarray:
    return np.asarray((x[:, 0] - 3.0) ** 2 + 5.0 * (x[:, 1] - 1.0) ** 2 - 7.0)


def two(x: np.ndarray) -> np.ndarray:
    """Two bowls: the best compromises lie on the line between their centres (2, 0) and (6, 0)."""
    return np.column_stack([(x[:, 0] - c) ** 2 + x[:, 1] ** 2 for c in (2.0, 6.0)])


def run(method: Method, objective: Callable[[np.ndarray], np.ndarray], evaluations: int, **options: Any) -> Found:
    strategy = make_strategy(method, LOWER, UPPER, population=12, seed=3)
    return search(objective, strategy, evaluations=evaluations, **options)


# the surrogate's own test is with the surrogate: it is for tens of evaluations
@pytest.mark.parametrize("method", [m for m in get_args(Method) if m != "surrogate"])
def test_a_search_continues_bit_for_bit(method: Method, tmp_path: Path) -> None:
    objective = two if method == "nsga2" else bowl
    file, problem = tmp_path / "checkpoint.npz", {"method": method}
    whole = run(method, objective, 600)
    # enough for CMA-ES to converge and restart with twice the population
    assert whole.generations[-1].evaluations > 500
    stopped = run(method, objective, 250, save=lambda r: write_checkpoint(file, problem, r))
    asked: list[int] = []

    def counting(x: np.ndarray) -> np.ndarray:
        asked.append(len(x))
        return objective(x)

    continued = run(method, counting, 600, record=resumed_record(file, problem))
    assert continued.generations == whole.generations
    assert np.array_equal(continued.candidates, whole.candidates)
    assert np.array_equal(continued.values, whole.values)
    # nothing is evaluated twice
    assert sum(asked) == whole.generations[-1].evaluations - stopped.generations[-1].evaluations


@pytest.mark.parametrize("method", ["ga", "de", "cma-es"])
def test_failed_evaluations_do_not_win_and_survive_a_checkpoint(method: Method, tmp_path: Path) -> None:
    def partly(x: np.ndarray) -> np.ndarray:
        return np.where(x[:, 0] < 5.0, np.nan, bowl(x))

    file = tmp_path / "checkpoint.npz"
    found = run(method, partly, 800, save=lambda r: write_checkpoint(file, {}, r))
    last = found.generations[-1]
    assert last.failures > 0
    assert last.parameters == pytest.approx((5.0, 1.0), abs=0.3)  # the edge of what can be evaluated
    values = np.concatenate(resumed_record(file, {}).values)
    assert int(np.isnan(values).sum()) == last.failures


def test_nsga2_finds_the_front_of_two_bowls() -> None:
    strategy = make_strategy("nsga2", LOWER, UPPER, population=40, seed=1)
    found = search(two, strategy, evaluations=2000)
    # sqrt f1 + sqrt f2 = 4 on the line of best compromises; 2 % after 50 generations
    assert np.sqrt(found.values).sum(axis=1) == pytest.approx(4.0, rel=0.02)
    assert found.values[:, 0].min() < 0.01
    assert found.values[:, 0].max() > 15.0


def killed_after_three_generations(words: list[str], folder: Path) -> None:
    command = [sys.executable, "-c", "from cosim.cli import main; main()", *words, "--out", folder.name]
    paths = os.pathsep.join([str(Path(__file__).parents[1]), os.environ.get("PYTHONPATH", "")])
    process = subprocess.Popen(command, cwd=folder.parent, env=os.environ | {"PYTHONPATH": paths})
    file = folder / "checkpoint.npz"
    deadline = time.monotonic() + 60.0
    try:
        while not (file.exists() and len(read_checkpoint(file)[1].candidates) >= 3):
            assert process.poll() is None, "the search ended before it could be killed"
            assert time.monotonic() < deadline
            time.sleep(0.02)
    finally:
        process.send_signal(signal.SIGKILL)
        process.wait()


def test_a_killed_command_resumes_to_the_same_result(fowt: Callable[..., Outcome], fmu: Path, tmp_path: Path) -> None:
    words = ["optimise", "mtmd", "--fmu", str(fmu), "--seed", "5", "--population", "30", "--generations", "25"]
    killed_after_three_generations([*words, "--workers", "1"], tmp_path / "killed")
    assert sorted(p.name for p in (tmp_path / "killed").iterdir() if p.suffix != ".partial") == ["checkpoint.npz"]

    kept = (tmp_path / "killed/checkpoint.npz").read_bytes()
    refused = fowt("optimise", "tmd-p", "--fmu", str(fmu), "--resume", "killed")
    assert refused.code == 1
    assert "checkpoint of another problem: damper tmd-p, there mtmd" in refused.err
    assert kept == (tmp_path / "killed/checkpoint.npz").read_bytes()
    assert fowt("optimise", "--fmu", str(fmu), "--resume", "killed").code == 0
    assert fowt(*words, "--out", "whole").code == 0
    results = [json.loads((tmp_path / name / "result.json").read_text()) for name in ("killed", "whole")]
    for result in results:
        del result["seconds"]
    assert results[0] == results[1]
    again = fowt("optimise", "--fmu", str(fmu), "--resume", "killed")
    assert "this search has ended" in again.err
    assert "is not empty" in fowt(*words, "--out", "whole").err


def test_an_interrupted_command_says_how_to_go_on(
    fowt: Callable[..., Outcome], fmu: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(path: Path, problem: Any, record: Record) -> None:
        write_checkpoint(path, problem, record)
        if len(record.candidates) == 2:
            raise KeyboardInterrupt

    monkeypatch.setattr("optimisation.tuning.write_checkpoint", interrupted)
    words = ("--fmu", str(fmu), "--population", "8", "--generations", "4")
    outcome = fowt("optimise", "tmd-p", *words, "--method", "de", "--out", "half")
    assert outcome.code == 130
    assert "continue with: fowt optimise --resume half" in outcome.err
    assert len(read_checkpoint(tmp_path / "half/checkpoint.npz")[1].candidates) == 2


def test_another_problem_is_refused_by_name(fmu: Path, tmp_path: Path) -> None:
    file = tmp_path / "checkpoint.npz"
    request = Request("tmd-p", population=8, generations=2, horizon=5.0)
    optimise("tmd-p", fmu, seed=1, population=8, generations=2, horizon=5.0, checkpoint=file)
    resumed_record(file, request.problem(fmu))
    for other, words in (
        (replace(request, damper="tmd-n"), "damper tmd-n, there tmd-p"),
        (replace(request, method="de"), "method de, there ga"),
        (replace(request, seed=2), "seed 2, there 1"),
        (replace(request, parameters={"I_t": 9e9}), "parameters I_t 9e\\+09, there by default"),
        (replace(request, bounds={"platform_damper.k": (0.0, 1e5)}), "bounds platform_damper.k 0:100000, there 0:2000"),
        (replace(request, generations=3), "generations 3, there 2"),
        (replace(request, horizon=6.0), "horizon 6, there 5"),
    ):
        with pytest.raises(ValueError, match=words):
            resumed_record(file, other.problem(fmu))
    with pytest.raises(ValueError, match=r"the FMU has another content$"):
        resumed_record(file, request.problem(fmu) | {"fmu": "0"})
    assert len(fmu_digest(fmu)) == 64


def test_a_checkpoint_of_another_algorithm_or_a_broken_one_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "checkpoint.npz"
    run("de", bowl, 60, save=lambda r: write_checkpoint(file, {}, r))
    with pytest.raises(ValueError, match=r"generation 1 of the checkpoint is not what cma .* proposes"):
        run("cma-es", bowl, 600, record=resumed_record(file, {}))
    file.write_bytes(file.read_bytes()[:300])
    with pytest.raises(ValueError, match="no checkpoint"):
        read_checkpoint(file)
    with pytest.raises(ValueError, match="nothing to resume"):
        read_checkpoint(tmp_path / "none.npz")


def test_a_crash_while_writing_leaves_the_former_checkpoint(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "checkpoint.npz"
    record = Record((np.ones((2, 2)),), (np.zeros((2, 1)),), {}, "x")
    write_checkpoint(file, {}, record)

    def crash(*_: Any) -> None:
        raise OSError("power cut")

    monkeypatch.setattr(checkpoints.os, "replace", crash)
    with pytest.raises(OSError, match="power cut"):
        write_checkpoint(file, {}, replace(record, candidates=(np.ones((2, 2)),) * 2, values=(np.zeros((2, 1)),) * 2))
    assert len(read_checkpoint(file)[1].candidates) == 1


@pytest.mark.parametrize(("method", "evaluations"), [("de", 400), ("cma-es", 250)])
def test_other_searches_reach_the_known_optimum(fmu: Path, method: Method, evaluations: int) -> None:
    found = optimise("tmd-p", fmu, seed=0, method=method, evaluations=evaluations)
    assert found.evaluations <= evaluations
    # 0.38394 m at 50,411 N/m and 11,267 N s/m, where gradient and Hessian say that it is the minimum (next test)
    assert found.fitness == pytest.approx(0.383935, abs=1e-4)


def test_polish_certifies_the_optimum_of_the_platform_damper(fmu: Path) -> None:
    found = optimise("tmd-p", fmu, seed=2, method="de", evaluations=160, local=True)
    optimum = found.local_optimum
    assert optimum is not None
    assert optimum.certified
    assert found.fitness < found.history[-1].best
    assert found.fitness == pytest.approx(0.3839352, abs=1e-7)
    assert found.parameters["platform_damper.k"] == pytest.approx(50_411, abs=2.0)
    assert found.parameters["platform_damper.c"] == pytest.approx(11_267, abs=2.0)


def test_polish_knows_bounds_kinks_and_saddles() -> None:
    start = np.array([4.0, 0.3])
    inner = polish(bowl, LOWER, UPPER, start)
    assert inner.parameters == pytest.approx((3.0, 1.0), abs=1e-4)
    # Hessian diag(2, 10) times ranges 10 and 4 squared: 200 and 160
    assert inner.curvature == pytest.approx(160.0, rel=1e-3)
    assert inner.certified
    edge = polish(bowl, np.array([4.0, -2.0]), UPPER, np.array([5.0, 0.0]))
    assert edge.parameters == pytest.approx((4.0, 1.0), abs=1e-4)
    assert edge.certified  # descent only across the bound
    kinked = polish(lambda x: np.abs(x[:, 0] - 3.0) + (x[:, 1] - 1.0) ** 2, LOWER, UPPER, start)
    assert kinked.parameters == pytest.approx((3.0, 1.0), abs=1e-3)
    assert not kinked.smooth
    assert "kink" in kinked.verdict
    saddle = polish(lambda x: (x[:, 0] - 3.0) ** 2 - 0.0 * x[:, 1], LOWER, UPPER, start)
    assert not saddle.certified  # flat in one direction: no strict minimum


def test_bad_bounds_get_one_line(fowt: Callable[..., Outcome], fmu: Path) -> None:
    for bounds, words in (
        ("platform_damper.k=5:2", "the lower bound comes first"),
        ("platform_damper.k=5", "write it as NAME=LOW:HIGH"),
        ("platform_damper.k=-5:100", "give 0 <= LOW < HIGH"),
        ("nacelle_damper.k=0:100", "tmd-p is tuned by platform_damper.k, platform_damper.c"),
    ):
        outcome = fowt("optimise", "tmd-p", "--fmu", str(fmu), "--bounds", bounds)
        assert outcome.code == 1
        assert outcome.err.count("error:") == 1
        assert words in outcome.err
    narrow = optimise("tmd-p", fmu, seed=0, population=8, generations=2, bounds={"platform_damper.k": (6e4, 7e4)})
    assert 6e4 <= narrow.parameters["platform_damper.k"] <= 7e4
