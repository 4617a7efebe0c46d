"""The genetic algorithm: its operators, and its behaviour on functions with a known minimum."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest
from pymoo.core.population import Population
from scipy.stats import chisquare

from optimisation.genetic import Operators, RouletteWheel, decode, roulette_shares
from optimisation.search import Generation, search
from optimisation.strategies import make_strategy

LOWER, UPPER = np.array([0.0, -2.0]), np.array([10.0, 2.0])


def bowl(x: np.ndarray) -> np.ndarray:
    return np.asarray((x[:, 0] - 3.0) ** 2 + 5.0 * (x[:, 1] - 1.0) ** 2 - 7.0)


def genetic_search(
    objective: Callable[[np.ndarray], np.ndarray], seed: int, population: int = 100, generations: int = 25
) -> list[Generation]:
    strategy = make_strategy("ga", LOWER, UPPER, population=population, seed=seed)
    return list(search(objective, strategy, evaluations=population * generations, generations=generations).generations)


def run(seed: int, **settings: int) -> list[Generation]:
    return genetic_search(bowl, seed, **settings)


def test_roulette_shares_of_a_minimised_fitness() -> None:
    # distance from the worst: 3, 2, 1, 0 of 6; an offset or a negative fitness changes nothing
    for offset in (0.0, -100.0, 1e3):
        assert roulette_shares(np.array([1.0, 2.0, 3.0, 4.0]) + offset) == pytest.approx([3 / 6, 2 / 6, 1 / 6, 0.0])
    assert roulette_shares(np.full(5, -2.5)) == pytest.approx(np.full(5, 0.2))
    # one that could not be evaluated never becomes a parent, unless there are no others
    assert roulette_shares(np.array([1.0, np.inf, 2.0, np.nan])) == pytest.approx([1.0, 0.0, 0.0, 0.0])
    assert roulette_shares(np.array([4.0, np.inf, 4.0])) == pytest.approx([0.5, 0.0, 0.5])
    assert roulette_shares(np.array([np.inf, np.nan])) == pytest.approx([0.5, 0.5])


def test_roulette_wheel_draws_with_these_shares() -> None:
    fitness = np.array([-5.0, -1.0, 0.0, 2.0, 4.0, 4.5])
    population = Population.new("X", np.arange(6.0)[:, None], "F", fitness[:, None])
    parents = RouletteWheel().do(
        None, population, 20_000, 2, to_pop=False, random_state=np.random.default_rng(5)
    )  # fmt: skip
    assert parents.shape == (20_000, 2)
    counts = np.bincount(parents.ravel(), minlength=6)
    shares = roulette_shares(fitness)
    assert counts[shares == 0.0].sum() == 0
    drawn = shares > 0.0
    # one in a thousand correct wheels fails this; the seed is fixed
    assert chisquare(counts[drawn], 40_000 * shares[drawn]).pvalue > 1e-3


def test_gray_code_covers_the_bounds_evenly_with_single_bit_steps() -> None:
    codes = ((np.arange(16)[:, None] >> np.arange(3, -1, -1)) & 1).astype(bool)
    x = decode(codes, np.array([1.0]), np.array([4.0]))[:, 0]
    assert np.sort(x) == pytest.approx(np.linspace(1.0, 4.0, 16))
    ordered = codes[np.argsort(x)]
    assert np.all((ordered[1:] ^ ordered[:-1]).sum(axis=1) == 1)


def test_finds_the_minimum_of_a_bowl() -> None:
    last = run(seed=1)[-1]
    # 100 x 25 evaluations; within 1 % of each range
    assert last.parameters == pytest.approx((3.0, 1.0), abs=0.04)
    assert last.best == pytest.approx(-7.0, abs=0.01)
    assert last.evaluations == 2500


def test_same_seed_same_run_other_seed_other_run() -> None:
    assert run(seed=4, generations=6) == run(seed=4, generations=6)
    assert run(seed=4, generations=6) != run(seed=5, generations=6)


def test_the_elite_is_kept() -> None:
    history = run(seed=2, population=8, generations=30)
    best = [g.best for g in history]
    assert len(best) == 30
    assert all(b <= a for a, b in pairwise(best))
    assert all(g.best <= g.mean for g in history)
    assert best[-1] < best[0]


def test_equal_fitness_everywhere_is_no_error() -> None:
    history = genetic_search(lambda x: np.full(len(x), 0.4), seed=0, population=10, generations=4)
    assert [g.best for g in history] == [0.4] * 4


def test_failed_evaluations_are_counted_and_do_not_win() -> None:
    def partly(x: np.ndarray) -> np.ndarray:
        return np.where(x[:, 0] < 5.0, np.nan, bowl(x))

    history = genetic_search(partly, seed=3, population=30, generations=12)
    # half of the first, random generation fails: 15 +- 3 standard deviations
    assert 7 <= history[0].failures <= 23
    assert history[-1].failures > history[0].failures
    assert np.isfinite(history[-1].mean)
    assert history[-1].parameters == pytest.approx((5.0, 1.0), abs=0.25)  # the edge of what can be evaluated


def test_bad_settings_are_refused() -> None:
    with pytest.raises(ValueError, match="lower < upper"):
        make_strategy("ga", UPPER, LOWER, population=10, seed=0)
    with pytest.raises(ValueError, match="population >= 2"):
        Operators(population=1)
    with pytest.raises(ValueError, match="between 0 and 1"):
        Operators(mutation=0.0)
