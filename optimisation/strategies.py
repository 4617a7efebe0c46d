"""Search algorithms by ask and tell: genetic algorithm, differential evolution and NSGA-II of pymoo, CMA-ES of cma."""

from __future__ import annotations

import math
import warnings
from typing import Any, Literal

import cma
import numpy as np
import numpy.typing as npt
import pymoo
from pymoo.algorithms.moo.nsga2 import NSGA2
from pymoo.algorithms.soo.nonconvex.de import DE
from pymoo.core.problem import Problem
from pymoo.termination.max_gen import MaximumGenerationTermination

from optimisation import genetic
from optimisation.search import Strategy

Array = npt.NDArray[np.float64]
Method = Literal["ga", "de", "cma-es", "surrogate", "nsga2"]

# NSGA-II measures crowding by differences, which infinity would spoil; every failure is dominated all the same
WORST = 1e30
INITIAL = 4  # designs per variable before the surrogate proposes any


def default_population(method: Method, variables: int) -> int:
    """The paper's 100 for genetic algorithms, 20 per variable for DE, 4 + 3 ln n (Hansen 2016) for CMA-ES, and 4, which
    keep a few cores busy, for the surrogate."""
    usual = {"ga": 100, "nsga2": 100, "de": 20 * variables, "cma-es": 4 + int(3 * math.log(variables)), "surrogate": 4}
    return usual[method]


def make_strategy(
    method: Method, lower: Array, upper: Array, *, population: int, seed: int, **options: Any
) -> Strategy:
    """A search algorithm at its start.

    Args:
        method: "ga" (Wang et al. 2022), "de" (Storn and Price 1997), "cma-es" (Hansen 2016), "surrogate" (Jones et al.
            1998), or "nsga2" (Deb et al. 2002) for two objectives.
        population: per generation; of the surrogate, designs proposed at once.
        options: of the surrogate: `limit`, `starts`, `fitness`, `prior`, see `optimisation.surrogate`.
        lower, upper: bounds, shape (variables,).

    Raises:
        ValueError: the bounds are not finite and ascending, or the population is too small.
    """
    lower, upper = np.asarray(lower, dtype=float), np.asarray(upper, dtype=float)
    if lower.shape != upper.shape or not np.all(np.isfinite(upper - lower)) or not np.all(lower < upper):
        raise ValueError("bounds of the search must be finite, with lower < upper for every variable")
    least = {"ga": 2, "de": 4, "cma-es": 3, "surrogate": 1, "nsga2": 4}[method]
    if population < least:
        raise ValueError(f"a search by {method} needs population >= {least}, not {population}")
    if method == "surrogate":
        from optimisation.surrogate import Surrogate

        # a cheap model to correct needs few designs to begin with
        initial = lower.size + 1 if options.get("prior") else INITIAL * lower.size
        return Surrogate(lower, upper, batch=population, seed=seed, initial=initial, **options)
    if method == "cma-es":
        return CovarianceMatrix(lower, upper, population, seed)
    if method == "ga":
        operators = genetic.Operators(population=population)
        return Evolution(genetic.algorithm(operators), lower, upper, seed, bits=operators.bits)
    if method == "de":
        # best/1 with the weights of Storn and Price; dithering keeps small populations from collapsing
        return Evolution(DE(pop_size=population, variant="DE/best/1/bin", CR=0.9, F=0.6), lower, upper, seed)
    return Evolution(NSGA2(pop_size=population), lower, upper, seed, objectives=2)


class Evolution:
    """An evolutionary algorithm of pymoo, over bit strings (if `bits` are given) or the variables scaled to 0..1."""

    def __init__(
        self, algorithm: Any, lower: Array, upper: Array, seed: int, *, bits: int | None = None, objectives: int = 1
    ) -> None:
        self.library = f"pymoo {pymoo.__version__}"
        self._lower, self._upper, self._bits, self._objectives = lower, upper, bits, objectives
        kind = {"vtype": bool} if bits else {}
        problem = Problem(n_var=lower.size * (bits or 1), n_obj=objectives, xl=0, xu=1, **kind)
        self._algorithm = algorithm
        # the loop that asks counts generations; the algorithm itself is never to end
        algorithm.setup(problem, termination=MaximumGenerationTermination(2**62), seed=seed)
        self._asked: Any = None

    def ask(self) -> Array:
        """See `Strategy`."""
        self._asked = self._algorithm.ask()
        if self._asked is None:  # no individual is new any more
            return np.empty((0, self._lower.size))
        return self._decoded(self._asked.get("X"))

    def recall(self, x: Array) -> Array:
        """See `Strategy`: the library's state follows from asking again."""
        return self.ask()

    def tell(self, values: Array) -> None:
        """See `Strategy`."""
        values = values[:, : self._objectives]
        self._asked.set("F", np.minimum(values, WORST) if self._objectives > 1 else values)
        for individual in self._asked:
            individual.evaluated.update({"F", "G", "H"})
        self._algorithm.tell(infills=self._asked)

    def population(self) -> tuple[Array, Array]:
        """See `Strategy`."""
        values = self._algorithm.pop.get("F")
        return self._decoded(self._algorithm.pop.get("X")), np.where(values < WORST, values, np.inf)

    def random_state(self) -> dict[str, Any]:
        """See `Strategy`."""
        return dict(self._algorithm.random_state.bit_generator.state)

    def _decoded(self, x: Any) -> Array:
        if self._bits:
            return genetic.decode(x, self._lower, self._upper)
        return np.asarray(self._lower + (self._upper - self._lower) * x, dtype=float)


class CovarianceMatrix:
    """CMA-ES over the variables scaled to 0..1, restarted with twice the population when it has converged (IPOP)."""

    def __init__(self, lower: Array, upper: Array, population: int, seed: int) -> None:
        self.library = f"cma {cma.__version__}"
        self._lower, self._upper, self._size = lower, upper, population
        self._random = np.random.default_rng(seed)
        self._start(np.full(lower.size, 0.5))
        self._asked: list[Array] = []
        self._values = np.empty((0, 1))

    def ask(self) -> Array:
        """See `Strategy`."""
        if self._strategy.stop():
            self._size *= 2
            self._start(self._random.random(self._lower.size))
        self._asked = self._strategy.ask()
        return self._scaled()

    def recall(self, x: Array) -> Array:
        """See `Strategy`: the library's state follows from asking again."""
        return self.ask()

    def tell(self, values: Array) -> None:
        """See `Strategy`."""
        self._values = values
        fitness = values[:, 0]
        finite = fitness[np.isfinite(fitness)]
        # only the order counts; a failure comes last
        last = float(finite.max() + 1.0) if finite.size else 1.0
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            self._strategy.tell(self._asked, np.where(np.isfinite(fitness), fitness, last).tolist())

    def population(self) -> tuple[Array, Array]:
        """See `Strategy`."""
        return self._scaled(), self._values

    def random_state(self) -> dict[str, Any]:
        """See `Strategy`."""
        return dict(self._random.bit_generator.state)

    def _start(self, centre: Array) -> None:
        options = {  # verbose -10: silent, and no file that controls it
            "bounds": [0.0, 1.0], "popsize": self._size, "verbose": -10, "verb_log": 0,
            "seed": np.nan, "randn": lambda *shape: self._random.standard_normal(shape), "tolx": 1e-6, "tolfun": 1e-8,
        }  # fmt: skip
        # a standard deviation of a quarter of the range is Hansen's advice
        self._strategy = cma.CMAEvolutionStrategy(centre, 0.25, options)

    def _scaled(self) -> Array:
        return self._lower + (self._upper - self._lower) * np.clip(np.array(self._asked), 0.0, 1.0)
