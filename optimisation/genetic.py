"""Genetic algorithm with the operators of Wang et al. (2022), section 5, on pymoo.

Roulette-wheel selection, uniform crossover with probability 0.6, mutation with probability 0.01, elite kept. The paper
gives no encoding; these are the operators of the classical binary algorithm (Goldberg 1989), so each variable is a
Gray-coded bit string here and mutation flips single bits.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from pymoo.algorithms.soo.nonconvex.ga import GA
from pymoo.core.selection import Selection
from pymoo.operators.crossover.ux import UniformCrossover
from pymoo.operators.mutation.bitflip import BitflipMutation
from pymoo.operators.sampling.rnd import BinaryRandomSampling

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Operators:
    """Settings of the algorithm; the paper's by default.

    Attributes:
        population: individuals per generation.
        crossover: probability that a pair of parents is crossed.
        mutation: probability that a bit is flipped.
        bits: per variable; 16 resolve 200,000 N/m to 3 N/m.
    """

    population: int = 100
    crossover: float = 0.6
    mutation: float = 0.01
    bits: int = 16

    def __post_init__(self) -> None:
        if self.population < 2 or not 1 <= self.bits <= 32:
            raise ValueError("the search needs population >= 2 and 1 to 32 bits per variable")
        if not (0.0 < self.crossover < 1.0 and 0.0 < self.mutation < 1.0):
            raise ValueError("probabilities of crossover and mutation must lie between 0 and 1")


def algorithm(operators: Operators) -> GA:
    """The algorithm as pymoo has it, over bit strings."""
    return GA(
        pop_size=operators.population,
        sampling=BinaryRandomSampling(),
        selection=RouletteWheel(),
        crossover=UniformCrossover(prob=operators.crossover),
        mutation=BitflipMutation(prob=1.0, prob_var=operators.mutation),
        eliminate_duplicates=True,
    )


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
