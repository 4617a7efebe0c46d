"""The benchmarks: contenders agree, and the results are complete. How fast anything is depends on the machine."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from benchmarks.__main__ import main
from benchmarks.contenders import others, own, run_own, same_algorithm_name
from benchmarks.measure import difference
from benchmarks.systems import chain, shell


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> dict:
    out = tmp_path_factory.mktemp("benchmarks") / "out"
    assert main(["--quick", "--only", "stepping", "--only", "fitness", "--out", str(out)]) == 0
    assert (out / "benchmarks.png").read_bytes().startswith(b"\x89PNG")
    return json.loads((out / "results.json").read_text())


def test_masters_agree_on_the_light_system(results: dict) -> None:
    part = results["benchmarks"]["stepping"]["chain"]
    agreement = part["agreement"]
    assert set(agreement["difference"]) == set(others())
    # the same binaries, inputs and algorithm: rounding of the communication time only
    assert max(agreement["difference"].values()) < 1e-9 < agreement["tolerance"]
    assert all(agreement["agrees"].values())


def test_the_objective_is_that_of_the_equations_by_scipy(results: dict) -> None:
    agreement = results["benchmarks"]["fitness"]["agreement"]
    # SciPy at rtol 1e-6 against a fixed step of 0.0125 s: measured 1e-5
    assert agreement["difference"]["scipy solve_ivp"] < 1e-4


def test_results_are_complete(results: dict) -> None:
    assert results["quick"]
    assert results["repeats"] == 1
    assert {"processor", "cpus", "system", "versions", "measured"} <= set(results["machine"])
    part = results["benchmarks"]["stepping"]["chain"]
    # every algorithm is there, measured or refused with a reason: that of a system without ports cannot be adaptive
    assert set(part["contenders"]) | set(part["failures"]) == set(own()) | set(others())
    assert all(why.startswith("CosimError") for why in part["failures"].values())
    assert part["reference"] == same_algorithm_name()
    for contender in part["contenders"].values():
        for key in ("step_seconds", "cpu_step_seconds", "total_seconds", "ratio", "cpu_ratio"):
            assert 0.0 <= contender[key]["min"] <= contender[key]["median"] <= contender[key]["max"] < math.inf
        assert contender["peak_memory"] > 1e6 or math.isnan(contender["peak_memory"])


def test_the_chain_is_that_of_its_equations(tmp_path: Path) -> None:
    """The driven chain, as one linear system: x'' = K x + D x' + F sin(omega t)."""
    from scipy.integrate import solve_ivp

    case = chain(tmp_path / "chain", 20.0)
    n = len(case.components)
    coupling = np.diag(-2.0 * np.ones(n)) + np.diag(np.ones(n - 1), 1) + np.diag(np.ones(n - 1), -1)

    def rate(t: float, y: np.ndarray) -> np.ndarray:
        force = np.zeros(n)
        force[0] = math.sin(0.7 * t)
        return np.concatenate([y[n:], coupling @ (y[:n] + 0.1 * y[n:]) + force])

    exact = solve_ivp(rate, (0.0, 20.0), np.zeros(2 * n), rtol=1e-9, atol=1e-12).y[:n, -1]
    run = run_own(case, 20.0, algorithm="gauss-seidel", extrapolation="linear")
    reached = np.array([run.series[name][-1] for name in case.compared])
    # second order in the step: (omega h)^2 = 6e-4 at the chain's highest frequency of 2 rad/s
    np.testing.assert_allclose(reached, exact, atol=6e-4 * np.abs(exact).max())


def test_the_shell_has_the_connections_and_no_content(tmp_path: Path) -> None:
    real = chain(tmp_path / "real", 1.0)
    empty = shell(real, tmp_path / "shell")
    assert empty.components == real.components
    for run in (own()[same_algorithm_name()], *others().values()):
        sample = run(empty, 1.0)
        assert set(sample.series) == set(real.compared)
        assert not np.any(list(sample.series.values()))


def test_the_pythonfmu_damper_is_ours(tmp_path: Path) -> None:
    pytest.importorskip("pythonfmu")
    from benchmarks.python_fmu import cases

    samples = [run_own(c, 2.0, algorithm="jacobi", extrapolation="held") for c in cases(tmp_path, 2.0)]
    # the same equations, inputs and Runge-Kutta steps, in another order of operations
    assert difference(*samples) < 1e-9


def test_an_unknown_benchmark_and_a_used_folder_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "mine.txt").touch()
    for arguments in (["--only", "everything"], ["--out", str(tmp_path)]):
        with pytest.raises(SystemExit):
            main(arguments)
    assert "is not empty" in capsys.readouterr().err
