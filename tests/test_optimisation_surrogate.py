"""The surrogate-assisted search on functions with known optima, and the judging of designs in scenarios."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from optimisation.checkpoint import resumed_record, write_checkpoint
from optimisation.coupled import SimulationFailed, StoredResponses
from optimisation.scenarios import Scenario, ScenarioFitness, aggregate
from optimisation.search import search
from optimisation.surrogate import Surrogate

LOWER, UPPER = np.array([-5.0, 0.0]), np.array([10.0, 15.0])


def branin(x: np.ndarray) -> np.ndarray:
    """Branin's function (Dixon and Szego 1978), raised to be positive throughout: three minima of 100.397887."""
    first = x[:, 1] - 5.1 / (4 * np.pi**2) * x[:, 0] ** 2 + 5 / np.pi * x[:, 0] - 6
    return np.asarray(110.0 + first**2 + 10 * (1 - 1 / (8 * np.pi)) * np.cos(x[:, 0]))


def three(x: np.ndarray) -> np.ndarray:
    """Three smooth responses after the largest of them, the fitness; its minimum is a kink where two are equal."""
    u = (x - LOWER) / (UPPER - LOWER)
    bowls = [b + ((u - c) ** 2).sum(axis=1) for b, c in ((0.5, np.array([0.3, 0.3])), (0.4, np.array([0.7, 0.6])))]
    responses = np.column_stack([*bowls, 0.6 + 0.2 * u[:, 0]])
    return np.column_stack([responses.max(axis=1), responses])


def worst(responses: np.ndarray) -> np.ndarray:
    return np.asarray(responses.max(axis=1))


def make(batch: int = 3, limit: int = 32, **options: Any) -> Surrogate:
    return Surrogate(LOWER, UPPER, batch=batch, seed=1, initial=8, limit=limit, **options)


def test_an_optimum_is_found_within_few_evaluations() -> None:
    found = search(branin, make(), evaluations=32)
    assert found.generations[-1].evaluations == 32  # the last batch is cut to the limit
    # the range is 300, the standard deviation 50; random search comes within 1 after some 500 evaluations
    assert found.generations[-1].best - 100.397887 < 0.05


def test_the_worst_of_responses_is_found_at_its_kink() -> None:
    strategy = make(batch=2, limit=24, fitness=worst)
    found = search(three, strategy, evaluations=24)
    # 0.6418 by a grid of 1,000 by 1,000
    assert found.generations[-1].best == pytest.approx(0.6418, abs=1e-3)
    accuracy = strategy.accuracy()
    assert accuracy is not None
    assert max(accuracy.responses) < 0.03


def test_a_cheap_model_saves_evaluations() -> None:
    """A prior that is wrong by a factor and a slope: its own optimum misses, the corrected one does not."""

    def prior(x: np.ndarray) -> np.ndarray:
        return np.asarray(three(x)[:, 1:] * (0.9 + 0.02 * x[:, :1]))

    def best(**options: Any) -> float:
        strategy = Surrogate(LOWER, UPPER, batch=1, seed=2, initial=3, limit=8, fitness=worst, **options)
        return search(three, strategy, evaluations=8).generations[-1].best

    corrected = best(prior=prior)
    assert corrected == pytest.approx(0.6418, abs=2e-3)
    assert corrected < best()


def test_a_cheap_model_is_asked_sparingly() -> None:
    """It takes 0.1 s a design where a simulation takes 20: some two hundred at first, some eighty a proposal after, and
    no design twice."""
    asked: list[bytes] = []

    def prior(x: np.ndarray) -> np.ndarray:
        asked.extend(row.tobytes() for row in x)
        return np.asarray(three(x)[:, 1:])

    strategy = make(batch=2, limit=12, fitness=worst, prior=prior)
    search(three, strategy, evaluations=12)
    assert len(set(asked)) == len(asked) < 250 + 100 * 4


def test_the_search_continues_to_the_same_record(tmp_path: Path) -> None:
    file = tmp_path / "checkpoint.npz"
    starts = np.array([[0.0, 5.0]])
    whole = search(branin, make(starts=starts, limit=20), evaluations=20)
    assert whole.candidates[0] == pytest.approx(starts[0])
    again = search(branin, make(starts=starts, limit=20), evaluations=20)
    assert np.array_equal(whole.candidates, again.candidates)
    search(
        branin, make(starts=starts, limit=20), evaluations=20, generations=3,
        save=lambda r: write_checkpoint(file, {}, r),
    )  # fmt: skip
    continued = search(branin, make(starts=starts, limit=20), evaluations=20, record=resumed_record(file, {}))
    assert np.array_equal(whole.candidates, continued.candidates)
    assert continued.generations == whole.generations


def test_where_the_cheap_model_has_no_value_a_prediction_is_of_the_design_alone() -> None:
    """The cheap model is not stable in half of the space: what it lacks must not come from the designs beside."""

    def prior(x: np.ndarray) -> np.ndarray:
        return np.where(x[:, :1] < 2.5, 1.1 * three(x)[:, 1:], np.nan)

    strategy = make(fitness=worst, prior=prior)
    search(three, strategy, evaluations=11)
    x = np.array([[0.0, 9.0], [8.0, 3.0], [4.0, 12.0]])
    assert np.isnan(prior(x)).any(axis=1).tolist() == [False, True, True]
    alone = np.vstack([strategy.predict(row[None]) for row in x])
    # rounding: matrix products of other shapes
    np.testing.assert_allclose(strategy.predict(x), alone, rtol=1e-12)
    everywhere = make(fitness=worst, prior=lambda x: np.full((len(x), 3), np.nan))
    search(three, everywhere, evaluations=11)
    without, (designs, values) = make(fitness=worst), everywhere.population()
    without.recall(designs)
    without.tell(values)
    # the same but for a constant, which the processes take out: to rounding, amplified by their hyperparameters' fit
    np.testing.assert_allclose(everywhere.predict(x), without.predict(x), rtol=1e-8)


def test_failing_designs_do_not_win() -> None:
    def partly(x: np.ndarray) -> np.ndarray:
        return np.where(x[:, 0] < 5.0, np.nan, branin(x))

    found = search(partly, make(), evaluations=32)
    assert found.generations[-1].failures > 0
    assert found.generations[-1].best - 100.397887 < 0.5  # one of the three minima can be evaluated


def test_a_variable_of_wide_range_is_scaled_by_its_root() -> None:
    search_ = Surrogate(np.array([0.0, 40.0, -5.0]), np.array([1e4, 60.0, 5.0]), batch=1, seed=0, initial=2)
    x = np.array([[100.0, 50.0, 0.0]])
    assert search_._encoded(x) == pytest.approx(np.array([[0.1, 0.5, 0.5]]))
    assert search_._decoded(search_._encoded(x)) == pytest.approx(x)


def test_aggregates() -> None:
    rng = np.random.default_rng(0)
    reference, weights = rng.uniform(1.0, 2.0, (3, 2)), np.array([[1.0], [2.0], [0.0]])
    designs = reference * rng.uniform(0.5, 1.5, (5, 3, 2))
    for how in ("mean", "worst", "worst-case"):
        assert aggregate(reference[None], reference, weights, how) == pytest.approx([1.0])
        # homogeneous in the design and in the reference, whatever the channels' units
        units = np.array([1.0, 1e6])
        scaled = aggregate(3.0 * designs * units, reference * units, weights, how)
        assert scaled == pytest.approx(3.0 * aggregate(designs, reference, weights, how))
    ratios = designs / reference
    assert aggregate(designs, reference, weights, "worst") == pytest.approx(ratios[:, :2].max(axis=(1, 2)))
    expected = (ratios[:, 0].mean(axis=1) + 2.0 * ratios[:, 1].mean(axis=1)) / 3.0
    assert aggregate(designs, reference, weights, "mean") == pytest.approx(expected)
    alone = np.ones_like(weights)  # each a load case of its own, and all of one: the worst, and the channels' means
    assert aggregate(designs, reference, alone, "worst-case") == pytest.approx(ratios.max(axis=(1, 2)))
    one = aggregate(designs, reference, alone, "worst-case", ["lc1"] * len(reference))
    assert one == pytest.approx(ratios.mean(axis=1).max(axis=1))
    designs[2, 2, 0] = np.nan  # even where it has no weight: that run broke off
    for how in ("mean", "worst", "worst-case"):
        assert np.isnan(aggregate(designs, reference, weights, how)).tolist() == [False, False, True, False, False]
    with pytest.raises(ValueError, match="not above 0"):
        aggregate(designs, 0.0 * reference, weights, "worst")
    with pytest.raises(ValueError, match="weights"):
        aggregate(designs, reference, 0.0 * weights, "mean")


SCENARIOS = (Scenario("lc1", 1), Scenario("lc1", 2, {"barge.x": 0.5}))


def stored(
    store: Path | None,
    done: list[tuple[float, int]],
    workers: int = 1,
    fails: Callable[[float], bool] = lambda _: False,
) -> StoredResponses:
    def simulate(values: Mapping[str, float], scenario: int, stopped: Callable[[], bool]) -> np.ndarray:
        if fails(values["k"]):
            raise SimulationFailed("state is not finite")
        done.append((values["k"], scenario))
        return np.array([values["k"] + scenario, values["c"] / 3.0])

    return StoredResponses(simulate, ("k", "c"), SCENARIOS, ("A", "B"), store=store, workers=workers)


def test_no_simulation_is_repeated_after_a_kill(tmp_path: Path) -> None:
    store, done = tmp_path / "simulations.jsonl", list[tuple[float, int]]()
    x = np.array([[1.0, 0.1], [2.0, 0.2]])
    first = stored(store, done, workers=3)(x)
    assert first.tolist() == [[[1.0, 0.1 / 3], [2.0, 0.1 / 3]], [[2.0, 0.2 / 3], [3.0, 0.2 / 3]]]
    assert len(done) == 4
    lines = store.read_text().splitlines()
    assert json.loads(lines[0])["std"].keys() == {"A", "B"}
    store.write_text("\n".join(lines[:3]) + '\n{"scenario": "lc1 see')  # torn by a kill
    done.clear()
    again = stored(store, done)
    assert np.array_equal(again(x), first)  # bit for bit, through the file
    assert len(done) == 1
    assert again.simulations == 4
    done.clear()
    assert np.array_equal(stored(store, done)(x), first)
    assert not done
    store.write_text("no line\n")
    with pytest.raises(ValueError, match=r"simulations.jsonl, line 1: is no finished simulation"):
        stored(store, done)


def test_a_failure_in_one_scenario_costs_the_design() -> None:
    responses = stored(None, [], fails=lambda k: k == 2.0)
    fitness = ScenarioFitness(responses, np.ones((2, 2)), SCENARIOS, ("A", "B"), "worst")
    values = fitness(np.array([[1.0, 0.1], [2.0, 0.2], [3.0, 0.3]]))
    assert values.shape == (3, 5)
    assert np.isnan(values).all(axis=1).tolist() == [False, True, False]
    assert values[[0, 2], 0].tolist() == [2.0, 4.0]
    assert fitness.first_failure == "lc1 seed 1: state is not finite at k = 2, c = 0.2"
    with pytest.raises(ValueError, match=r"lc1 seed 2, barge.x = 0.5: the reference's standard deviation of B is 0"):
        ScenarioFitness(responses, np.array([[1.0, 1.0], [1.0, 0.0]]), SCENARIOS, ("A", "B"), "worst")
