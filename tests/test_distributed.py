"""The fitness on a Dask cluster, polish and Ctrl-C, parameters that no damper can help, strokes by direct calls."""

from __future__ import annotations

import json
import math
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmpy import read_model_description
from fmpy.fmi1 import FMICallException
from scipy.linalg import eigh

from fmus_src.component import Component
from fmus_src.simplified.model import component
from optimisation.baselines import structure_matrices
from optimisation.distributed import ClusterError, DistributedDeviation, Task, WorkerState
from optimisation.objective import TowerTopDeviation, design
from optimisation.pareto import sampled
from optimisation.stability import start_values, unstable_mode

from .conftest import Outcome

NAMES = [v.name for v in design("mtmd").variables]
SWITCHES = design("mtmd").switches


@pytest.fixture(scope="module")
def fmu(built: Callable[[Component], Path]) -> Path:
    return built(component())


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None,
        local_directory=str(tmp_path_factory.mktemp("dask")), silence_logs="CRITICAL",
    ) as found:  # fmt: skip
        yield found


def candidates(count: int) -> np.ndarray:
    return np.random.default_rng(0).uniform(0.0, 1.0, (count, 4)) * [v.upper for v in design("mtmd").variables]


def test_cluster_gives_the_same_values_also_when_a_worker_is_killed(fmu: Path, cluster: Any) -> None:
    x = candidates(400)
    with TowerTopDeviation(fmu, NAMES, SWITCHES) as local:
        expected = local(x)
    with DistributedDeviation(fmu, NAMES, SWITCHES, address=cluster.scheduler_address) as remote:
        assert np.array_equal(remote(x[:7]), expected[:7])
        assert remote(x[:0]).shape == (0,)
        victim = next(iter(remote._client.run(os.getpid).values()))
        found: list[np.ndarray] = []
        work = threading.Thread(target=lambda: found.append(remote(x)))
        work.start()
        time.sleep(0.1)
        os.kill(victim, signal.SIGKILL)
        work.join(60.0)
        assert np.array_equal(found[0], expected)
        assert remote.first_failure is None
    with DistributedDeviation(fmu, ["k_t"], horizon=1.0, address=cluster.scheduler_address) as remote:
        fitness = remote(np.array([[1e20], [3.31e10]]))
        assert np.isnan(fitness[0])
        assert fitness[1] > 0.0
        assert "k_t = 1e+20" in str(remote.first_failure)


def test_command_on_a_cluster_gives_the_local_result(
    fowt: Callable[..., Outcome], fmu: Path, cluster: Any, tmp_path: Path
) -> None:
    words = ("optimise", "tmd-p", "--fmu", str(fmu), "--population", "10", "--generations", "3")
    ran = fowt(*words, "--dask", cluster.scheduler_address, "--out", "remote")
    assert ran.code == 0, ran.err
    assert fowt(*words, "--out", "local").code == 0
    results = [json.loads((tmp_path / name / "result.json").read_text()) for name in ("remote", "local")]
    for result in results:
        del result["seconds"]
    assert results[0] == results[1]


def test_an_address_without_scheduler_gets_one_line(
    fowt: Callable[..., Outcome], fmu: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("distributed")
    monkeypatch.setattr("optimisation.distributed.CONNECT", 0.5)
    began = time.monotonic()
    for address in ("tcp://127.0.0.1:9", "nonsense"):
        ended = fowt("optimise", "tmd-p", "--fmu", str(fmu), "--dask", address, "--out", "x")
        assert ended.code == 1
        assert f"no Dask scheduler at {address}" in ended.err
        assert ended.err.count("error:") == 1
    assert time.monotonic() - began < 15.0
    assert list(tmp_path.iterdir()) == []
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(ClusterError, match=r'pip install "fowt-cosim\[dask\]"'):
        DistributedDeviation(fmu, NAMES, address="tcp://127.0.0.1:9")


def test_a_worker_unpacks_an_fmu_once_and_shares_no_instance_between_threads(fmu: Path, tmp_path: Path) -> None:
    worker, x = WorkerState(tmp_path), candidates(8)
    task = Task("digest", tuple(NAMES), tuple(sorted(SWITCHES.items())), 20.0)
    with TowerTopDeviation(fmu, NAMES, SWITCHES, horizon=20.0) as local:
        expected = local(x)
    found: dict[int, np.ndarray] = {}

    def chunk(i: int) -> None:
        found[i] = worker.evaluate(fmu.read_bytes(), task, x[i::4])[0]

    for _ in range(2):
        threads = [threading.Thread(target=chunk, args=(i,)) for i in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert all(np.array_equal(found[i], expected[i::4]) for i in range(4))
    assert [p.name for p in tmp_path.glob("*/*")] == ["digest"]


def test_ctrl_c_in_a_polish_keeps_the_result_of_the_search(
    fowt: Callable[..., Outcome], fmu: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: Any, progress: Callable[[int, float], None], **__: Any) -> None:
        progress(1, 0.4)
        raise KeyboardInterrupt

    monkeypatch.setattr("optimisation.tuning.polish", interrupted)
    words = ("optimise", "tmd-p", "--fmu", str(fmu), "--population", "10", "--generations", "2", "--polish")
    ended = fowt(*words, "--out", "kept")
    assert ended.code == 130
    assert "kept has the result of the search, not polished" in ended.err
    result = json.loads((tmp_path / "kept/result.json").read_text())
    assert result["local_optimum"] is None
    assert result["fitness"] == result["history"][-1]["best"]
    assert (tmp_path / "kept/tuned.ssv").exists()


def test_the_static_limit_is_where_the_stiffness_matrix_turns_singular(fmu: Path) -> None:
    values = start_values(read_model_description(str(fmu)))
    assert unstable_mode(values) is None
    tower = values["m_t"] * values["gravity"] * values["R_t"]
    # det K = 0: tower and barge in series against the weights of both
    limit = values["k_t"] * tower / (values["k_t"] - tower) - values["m_p"] * values["gravity"] * values["R_p"]
    assert np.linalg.det(structure_matrices(values | {"k_p": limit})[2]) == pytest.approx(0.0, abs=1e-6 * limit**2)
    assert unstable_mode(values | {"k_p": 1.001 * limit}) is None
    mode = unstable_mode(values | {"k_p": 0.5 * limit})
    assert mode is not None
    assert (mode.name, mode.frequency) == ("platform pitch", 0.0)
    growing = unstable_mode(values | {"d_p": -2e7})
    assert growing is not None
    mass, damping, stiffness = structure_matrices(values | {"d_p": -2e7})
    squares, shapes = eigh(stiffness, mass)
    assert (growing.name, growing.frequency) == ("platform pitch", pytest.approx(math.sqrt(squares[0]) / (2 * math.pi)))
    # modal damping; the modes' coupling through it is of second order in damping ratios of 1e-3
    assert growing.growth == pytest.approx(-shapes[:, 0] @ damping @ shapes[:, 0] / 2, rel=1e-4)
    tower_mode = unstable_mode(values | {"d_t": -1e8})
    assert tower_mode is not None
    assert tower_mode.name == "tower fore-aft"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("k_p=1e8", "platform pitch topples by 0.14 1/s; k_p = 1e+08 N m/rad must exceed 4.3e+08"),
        ("k_t=1e8", "tower fore-aft topples by 0.18 1/s; k_t = 1e+08 N m/rad must exceed 4.39e+08"),
        ("d_p=-1e8", "d_p = -1e+08 is outside its limits, 0 to inf"),
        ("platform_damper.k=-1", "platform_damper.k = -1 is outside its limits, 0 to inf"),
    ],
)
def test_an_unstable_structure_is_refused_by_its_mode(
    fowt: Callable[..., Outcome], fmu: Path, tmp_path: Path, change: str, message: str
) -> None:
    for command in ("optimise", "map"):
        ended = fowt(command, "tmd-n", "--fmu", str(fmu), "--set", change)
        assert ended.code == 1
        assert message in ended.err
        assert ended.err.count("error:") == 1
    assert list(tmp_path.glob("runs/*")) == []


def test_sampling_by_direct_calls_is_fmpys(fmu: Path) -> None:
    times = np.linspace(0.0, 20.0, 201)
    rows = []
    with TowerTopDeviation(fmu, NAMES, SWITCHES) as objective:
        slave = objective._slaves[0]
        references = [
            objective._known[f"{d}_damper.relative_displacement"].valueReference for d in ("nacelle", "platform")
        ]

        def start() -> None:
            slave.reset()
            slave.setupExperiment(startTime=0.0, stopTime=20.0)
            slave.enterInitializationMode()
            slave.exitInitializationMode()

        start()
        rows.append(slave.getReal(references))
        for i in range(200):
            slave.doStep(currentCommunicationPoint=times[i], communicationStepSize=times[i + 1] - times[i])
            rows.append(slave.getReal(references))
        start()
        assert np.array_equal(sampled(slave, references, times), np.array(rows))
        start()
        with pytest.raises(FMICallException, match="fmi2GetReal"):
            sampled(slave, [2**31], times)
        with pytest.raises(FMICallException, match="fmi2DoStep"):
            sampled(slave, references, np.array([0.0, math.nan]))
