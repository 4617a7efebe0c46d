"""A search as a loop of ask and tell, recorded by generation so that it can be continued after an abrupt end.

A search is a function of its seed and of the objective's values. The record therefore holds what was evaluated, and a
search continues by replaying it: the strategy is asked again, must propose the recorded candidates bit for bit, and is
told the recorded values. This restores any library's state exactly without knowing its internals.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Generation:
    """State after one generation.

    Attributes:
        number: counted from 1.
        best, mean: fitness of the best individual so far, and mean over the population's individuals with a finite
            fitness; of the first objective, if there are several.
        parameters: variables of the best individual, shape (variables,).
        evaluations, failures: so far.
    """

    number: int
    best: float
    mean: float
    parameters: tuple[float, ...]
    evaluations: int
    failures: int


class Strategy(Protocol):
    """A search algorithm by ask and tell; a function of its seed and of what it is told."""

    library: str

    def ask(self) -> Array:
        """Candidates to evaluate, shape (n, variables); none if the search has come to its end."""

    def recall(self, x: Array) -> Array:
        """As `ask`, where a record has `x` for the answer; proposes it again, or makes sure that it may be its own."""

    def tell(self, values: Array) -> None:
        """Values of the candidates, shape (n, values); inf where there is none. The objectives come first; what
        follows are responses that they were made of."""

    def population(self) -> tuple[Array, Array]:
        """Variables and values of the present population."""

    def random_state(self) -> dict[str, Any]:
        """State of the random numbers, as JSON."""


@dataclass(frozen=True)
class Record:
    """What a search has evaluated.

    Attributes:
        candidates, values: of each generation, shapes (n, variables) and (n, values); nan where there is no value.
        random_state: of the strategy after the last generation.
        library: the strategy's library and its version.
        seconds: spent so far.
        first_failure: message, or None.
    """

    candidates: tuple[Array, ...] = ()
    values: tuple[Array, ...] = ()
    random_state: dict[str, Any] | None = None
    library: str = ""
    seconds: float = 0.0
    first_failure: str | None = None


@dataclass(frozen=True)
class Found:
    """End of a search: its generations, and the last population's variables and values."""

    generations: tuple[Generation, ...]
    candidates: Array
    values: Array
    seconds: float


def search(
    objective: Callable[[Array], Array],
    strategy: Strategy,
    *,
    evaluations: int,
    generations: int | None = None,
    record: Record | None = None,
    save: Callable[[Record], None] | None = None,
    progress: Callable[[Generation], None] | None = None,
) -> Found:
    """Minimise an objective; the same strategy and seed give the same result, continued or not.

    Args:
        objective: variables, shape (individuals, variables) -> values, shape (individuals,) or (individuals, values),
            see `Strategy.tell`. An individual that cannot be evaluated gets inf or nan: it never wins.
        evaluations: largest number; no generation that would exceed it is begun.
        generations: largest number, the first one included.
        record: of a search to continue.
        save: called with the record after each generation, before `progress`.

    Raises:
        ValueError: the record is not of this strategy.
    """
    record = record or Record()
    began = time.perf_counter() - record.seconds
    candidates, values = list(record.candidates), list(record.values)
    history: list[Generation] = []
    while generations is None or len(history) < generations:
        count = history[-1].evaluations if history else 0
        number = len(history)
        x = strategy.recall(candidates[number]) if number < len(record.candidates) else strategy.ask()
        if len(x) == 0 or count + len(x) > evaluations:
            break
        if number < len(record.candidates):
            if not np.array_equal(x, candidates[number]):
                raise ValueError(_another(record, strategy, number + 1))
        else:
            found = np.asarray(objective(x), dtype=float)
            candidates.append(x)
            values.append(found.reshape(len(x), -1))
        strategy.tell(np.where(np.isfinite(values[number]).all(axis=1, keepdims=True), values[number], np.inf))
        history.append(_generation(history, candidates[number], values[number], strategy))
        if number + 1 == len(record.candidates) and strategy.random_state() != record.random_state:
            raise ValueError(_another(record, strategy, number + 1))
        if number >= len(record.candidates) and save is not None:
            seconds = time.perf_counter() - began
            save(Record(tuple(candidates), tuple(values), strategy.random_state(), strategy.library, seconds))
        if progress is not None:
            progress(history[-1])
    if not history:
        raise ValueError(f"{evaluations} evaluations do not suffice for one generation of {len(x)}: allow more")
    return Found(tuple(history), *strategy.population(), seconds=time.perf_counter() - began)


def _generation(history: list[Generation], x: Array, values: Array, strategy: Strategy) -> Generation:
    fitness = np.where(np.isfinite(values).all(axis=1), values[:, 0], np.inf)
    first = int(np.argmin(fitness))
    before = history[-1] if history else None
    better = before is None or fitness[first] < before.best
    population = strategy.population()[1]
    finite = population[np.isfinite(population).all(axis=1), 0]
    return Generation(
        number=len(history) + 1,
        best=float(fitness[first]) if before is None or better else before.best,
        mean=float(finite.mean()) if finite.size else float("inf"),
        parameters=tuple(x[first].tolist()) if before is None or better else before.parameters,
        evaluations=(before.evaluations if before else 0) + len(x),
        failures=(before.failures if before else 0) + int((~np.isfinite(fitness)).sum()),
    )


def _another(record: Record, strategy: Strategy, number: int) -> str:
    return (
        f"generation {number} of the checkpoint is not what {strategy.library} proposes (it was written with"
        f" {record.library}): continue with that version, or start anew"
    )
