"""Tuning by standard deviations in scenarios: from linear models or from co-simulations of the full system."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from optimisation.checkpoint import resumed_record, write_checkpoint
from optimisation.objective import DamperName, Design
from optimisation.scenarios import How, ScenarioFitness
from optimisation.search import Generation, Record
from optimisation.strategies import Method, make_strategy
from optimisation.tuning import Objective, OptimisationError, Request, bounds_of, continued_search

if TYPE_CHECKING:
    from optimisation.surrogate import Accuracy

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Start:
    """A design that the search began with, and its fitness (inf: it failed)."""

    label: str
    parameters: dict[str, float]
    fitness: float


@dataclass(frozen=True)
class LeftOut:
    """Error of the surrogate's predictions of the better half of the designs, each left out in turn.

    Attributes:
        responses: RMS relative error, shape (scenarios, channels).
        fitness: RMS error; spread: standard deviation of the fitness among the designs.
        designs: their number.
    """

    responses: Array
    fitness: float
    spread: float
    designs: int


@dataclass(frozen=True)
class ScenarioResult:
    """Result of `tune_scenarios`; everything in it was evaluated by the objective, nothing guessed by a surrogate.

    Attributes:
        damper, method, objective, seed: of the request.
        task: variables with bounds and units.
        fitness: of the best design: its standard deviations by the reference's, see `optimisation.scenarios`.
        parameters: of the best design, by name.
        scenarios, channels: labels.
        deviations, reference: of the best design and of the one it is compared with, shape (scenarios, channels).
        relative_to, how: what it is compared with, and how.
        starts: designs that the search began with.
        designs, values: all that the search still knows (the surrogate: all), shapes (n, variables) and (n,).
        history: one entry per generation.
        evaluations, failures: designs evaluated, and those among them that failed in any scenario.
        seconds: wall time.
        first_failure: message, or None.
        left_out: error of the surrogate; None for other methods.
    """

    damper: DamperName
    method: Method
    objective: Objective
    seed: int
    task: Design
    fitness: float
    parameters: dict[str, float]
    scenarios: tuple[str, ...]
    channels: tuple[str, ...]
    deviations: Array
    reference: Array
    relative_to: str
    how: How
    starts: tuple[Start, ...]
    designs: Array
    values: Array
    history: tuple[Generation, ...]
    evaluations: int
    failures: int
    seconds: float
    first_failure: str | None
    left_out: LeftOut | None

    @property
    def ratios(self) -> Array:
        """Standard deviations by the reference's, shape (scenarios, channels)."""
        return self.deviations / self.reference

    @property
    def at_bound(self) -> tuple[str, ...]:
        """Parameters within 1 % of the range of a bound: the search space limits them, not the physics."""
        return tuple(
            v.name
            for v in self.task.variables
            if min(self.parameters[v.name] - v.lower, v.upper - self.parameters[v.name]) < 0.01 * (v.upper - v.lower)
        )


def tune_scenarios(
    request: Request,
    make_objective: Callable[[], ScenarioFitness],
    task: Design,
    models: Mapping[str, str],
    *,
    prior: Callable[[Array], Array] | None = None,
    progress: Callable[[Generation], None] | None = None,
    checkpoint: Path | None = None,
    resume: bool = False,
) -> ScenarioResult:
    """Minimise the fitness of a damper over scenarios.

    Args:
        request: what to tune and how.
        make_objective: makes the objective, see `optimisation.scenarios`. Called when the checkpoint is there, so that
            what it simulates (the reference) is not lost when it is broken off.
        task: `request.task()` with units, see `optimisation.variables`.
        models: digests of what the scenarios consist of, by label.
        prior: a cheap model of the responses, see `optimisation.surrogate`.
        progress, checkpoint, resume: see `optimisation.tuning.tune`.

    Raises:
        ValueError: bad bounds or starts, or the checkpoint is of another problem.
        OptimisationError: every design failed; carries the first failure's message.
    """
    request = request.resolved()
    lower, upper = bounds_of(task)
    starts = checked_starts(request, task)
    problem = request.problem(models)
    if checkpoint is not None:
        if resume:  # refuses another problem before anything is simulated
            resumed_record(checkpoint, problem)
        else:
            write_checkpoint(checkpoint, problem, Record())
    objective = make_objective()
    options: dict[str, Any] = {}
    if request.method == "surrogate":
        options = {"limit": request.evaluations, "starts": starts, "fitness": objective.fitness, "prior": prior}
    assert request.population is not None
    strategy = make_strategy(
        request.method, lower, upper, population=request.population, seed=request.seed, **options
    )  # fmt: skip
    found = continued_search(
        request, problem, objective, strategy, progress=progress, checkpoint=checkpoint, resume=resume
    )
    last = found.generations[-1]
    if not math.isfinite(last.best):
        raise OptimisationError(
            f"{request.damper}: all {last.evaluations} designs failed; the first: {objective.first_failure}"
        )
    names = [v.name for v in task.variables]
    shape = objective.reference.shape
    # stored or cheap, so that nothing is simulated again
    best = objective(np.array([last.parameters]))[0, 1:].reshape(shape)
    accuracy = strategy.accuracy() if hasattr(strategy, "accuracy") else None
    return ScenarioResult(
        damper=request.damper,
        method=request.method,
        objective=request.objective,
        seed=request.seed,
        task=task,
        fitness=last.best,
        parameters=dict(zip(names, last.parameters, strict=True)),
        scenarios=tuple(s.label for s in objective.scenarios),
        channels=objective.channels,
        deviations=best,
        reference=objective.reference,
        relative_to=request.relative_to,
        how=request.aggregate,
        starts=tuple(
            Start(label, dict(zip(names, x, strict=True)), float(f))
            for (label, x), f in zip(request.starts.items(), found.values[: len(starts), 0], strict=True)
        ),
        designs=found.candidates,
        values=found.values[:, 0],
        history=found.generations,
        evaluations=last.evaluations,
        failures=last.failures,
        seconds=found.seconds,
        first_failure=objective.first_failure,
        left_out=None if accuracy is None else _left_out(accuracy, shape),
    )


def _left_out(accuracy: Accuracy, shape: tuple[int, ...]) -> LeftOut:
    responses = np.array(accuracy.responses).reshape(shape)
    return LeftOut(responses, accuracy.fitness, accuracy.spread, accuracy.designs)


def checked_starts(request: Request, task: Design) -> Array:
    """The request's starts, shape (n, variables).

    Raises:
        ValueError: the method takes none, or one is outside the bounds.
    """
    if request.starts and request.method != "surrogate":
        raise ValueError(f"--start is for --method surrogate, not {request.method}: leave it out")
    starts = np.array(list(request.starts.values()), dtype=float).reshape(-1, len(task.variables))
    for label, x in zip(request.starts, starts, strict=True):
        for v, value in zip(task.variables, x, strict=True):
            if not v.lower <= value <= v.upper:
                raise ValueError(
                    f"start {label}: {v.name} = {value:g} is outside {v.lower:g}:{v.upper:g}; widen its bounds"
                )
    return starts
