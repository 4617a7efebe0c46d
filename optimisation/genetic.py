"""Genetic algorithm with the operators of Wang et al. (2022), section 5, on pymoo.

Roulette-wheel selection, uniform crossover with probability 0.6, mutation with probability 0.01, elite kept. The paper
gives no encoding; these are the operators of the classical binary algorithm (Goldberg 1989), so each variable is a
Gray-coded bit string here and mutation flips single bits.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from pymoo.algorithms.soo.nonconvex.ga import GA
from pymoo.core.callback import Callback
from pymoo.core.problem import Problem
from pymoo.core.selection import Selection
from pymoo.operators.crossover.ux import UniformCrossover
from pymoo.operators.mutation.bitflip import BitflipMutation
from pymoo.operators.sampling.rnd import BinaryRandomSampling
from pymoo.optimize import minimize

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Operators:
    """Settings of the algorithm; the paper's by default.

    Attributes:
        population: individuals per generation.
        generations: number of generations, the random first one included.
        crossover: probability that a pair of parents is crossed.
        mutation: probability that a bit is flipped.
        bits: per variable; 16 resolve 200,000 N/m to 3 N/m.
    """

    population: int = 100
    generations: int = 50
    crossover: float = 0.6
    mutation: float = 0.01
    bits: int = 16

    def __post_init__(self) -> None:
        if self.population < 2 or self.generations < 1 or not 1 <= self.bits <= 32:
            raise ValueError("the search needs population >= 2, generations >= 1 and 1 to 32 bits per variable")
        if not (0.0 < self.crossover < 1.0 and 0.0 < self.mutation < 1.0):
            raise ValueError("probabilities of crossover and mutation must lie between 0 and 1")


@dataclass(frozen=True)
class Generation:
    """State after one generation.

    Attributes:
        number: counted from 1.
        best, mean: fitness of the best individual, and mean over the individuals with a finite fitness.
        parameters: variables of the best individual, shape (variables,).
        evaluations, failures: so far.
    """

    number: int
    best: float
    mean: float
    parameters: tuple[float, ...]
    evaluations: int
    failures: int


def search(
    objective: Callable[[Array], Array],
    lower: Array,
    upper: Array,
    *,
    seed: int,
    operators: Operators | None = None,
    progress: Callable[[Generation], None] | None = None,
) -> list[Generation]:
    """Minimise an objective; the same seed gives the same result.

    Args:
        objective: variables, shape (individuals, variables) -> fitness, shape (individuals,). An individual that cannot
            be evaluated gets inf or nan: it is never selected, and survives only while there is nothing better.
        lower, upper: bounds, shape (variables,).
        progress: called after each generation.

    Returns:
        one entry per generation; the last one holds the optimum.

    Raises:
        ValueError: the bounds are not finite and ascending.
    """
    operators = operators or Operators()
    lower, upper = np.asarray(lower, dtype=float), np.asarray(upper, dtype=float)
    if lower.shape != upper.shape or not np.all(np.isfinite(upper - lower)) or not np.all(lower < upper):
        raise ValueError("bounds of the search must be finite, with lower < upper for every variable")
    problem = _Encoded(objective, lower, upper, operators.bits)
    history = _History(problem, progress)
    algorithm = GA(
        pop_size=operators.population,
        sampling=BinaryRandomSampling(),
        selection=RouletteWheel(),
        crossover=UniformCrossover(prob=operators.crossover),
        mutation=BitflipMutation(prob=1.0, prob_var=operators.mutation),
        eliminate_duplicates=True,
        callback=history,
    )
    # without a copy: the algorithm refers to the objective, which may hold a loaded FMU
    minimize(problem, algorithm, ("n_gen", operators.generations), seed=seed, copy_algorithm=False)
    return history.generations


def roulette_shares(fitness: Array) -> Array:
    """Probability of selection of each individual, for a fitness to be minimised.

    Shares are proportional to the distance from the worst finite fitness (Goldberg's windowing), so that the fitness
    may have any sign and offset. Equal values get equal shares; a fitness that is not finite gets none, unless all are.
    """
    usable = np.isfinite(fitness)
    if not usable.any():
        return np.full(fitness.shape, 1.0 / fitness.size)
    merit = np.where(usable, fitness[usable].max() - np.where(usable, fitness, 0.0), 0.0)
    total = merit.sum()
    return merit / total if total > 0.0 else usable / usable.sum()


class RouletteWheel(Selection):
    """Fitness-proportionate selection, which pymoo lacks."""

    def _do(
        self, problem: Any, pop: Any, n_select: int, n_parents: int, *args: Any,
        random_state: Any = None, **kwargs: Any,
    ) -> npt.NDArray[np.int_]:  # fmt: skip
        shares = roulette_shares(pop.get("F")[:, 0])
        return np.asarray(random_state.choice(len(pop), size=(n_select, n_parents), p=shares))


def decode(bits: npt.NDArray[np.bool_], lower: Array, upper: Array) -> Array:
    """Variables, shape (individuals, variables), of Gray-coded bit strings, shape (individuals, variables * bits)."""
    count = bits.shape[1] // lower.size
    gray = bits.reshape(len(bits), lower.size, count)
    binary = np.bitwise_xor.accumulate(gray.astype(np.int64), axis=2)
    integer = binary @ (2 ** np.arange(count - 1, -1, -1, dtype=np.int64))
    return np.asarray(lower + (upper - lower) * (integer / (2**count - 1)))


class _Encoded(Problem):
    """The objective as pymoo sees it: over bit strings."""

    def __init__(self, objective: Callable[[Array], Array], lower: Array, upper: Array, bits: int) -> None:
        super().__init__(n_var=lower.size * bits, n_obj=1, xl=0, xu=1, vtype=bool)
        self.objective, self.lower, self.upper = objective, lower, upper
        self.evaluations = self.failures = 0

    def _evaluate(self, x: Any, out: dict[str, Any], *args: Any, **kwargs: Any) -> None:
        fitness = np.asarray(self.objective(decode(x, self.lower, self.upper)), dtype=float)
        self.evaluations += fitness.size
        self.failures += int((~np.isfinite(fitness)).sum())
        out["F"] = np.where(np.isfinite(fitness), fitness, np.inf)[:, None]


class _History(Callback):
    def __init__(self, problem: _Encoded, progress: Callable[[Generation], None] | None) -> None:
        super().__init__()
        self.problem, self.progress = problem, progress
        self.generations: list[Generation] = []

    def notify(self, algorithm: Any) -> None:
        fitness = algorithm.pop.get("F")[:, 0]
        first = int(np.argmin(fitness))
        finite = fitness[np.isfinite(fitness)]
        best = decode(algorithm.pop.get("X")[[first]], self.problem.lower, self.problem.upper)[0]
        generation = Generation(
            number=len(self.generations) + 1,
            best=float(fitness[first]),
            mean=float(finite.mean()) if finite.size else float("inf"),
            parameters=tuple(best.tolist()),
            evaluations=self.problem.evaluations,
            failures=self.problem.failures,
        )
        self.generations.append(generation)
        if self.progress is not None:
            self.progress(generation)
