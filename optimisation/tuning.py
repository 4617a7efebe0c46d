"""Tuning of a damper arrangement: a search driving the simplified model's FMU, with checkpoints."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any, Literal, Protocol

import numpy as np
import numpy.typing as npt

from optimisation.checkpoint import fmu_digest, resumed_record, write_checkpoint
from optimisation.distributed import DistributedDeviation
from optimisation.objective import DamperName, Design, TowerTopDeviation, design, with_bounds, with_variables
from optimisation.polish import polish
from optimisation.result import OptimisationResult
from optimisation.scenarios import How, Scenario
from optimisation.search import Found, Generation, Record, Strategy, search
from optimisation.strategies import INITIAL, Method, default_population, make_strategy
from optimisation.variables import checked_variables

Array = npt.NDArray[np.float64]
Objective = Literal["decay", "spectral", "coupled"]
BUDGET = 5000  # the paper's 50 generations of 100
SURROGATE_BUDGET = 60


class OptimisationError(RuntimeError):
    """No candidate could be evaluated."""


@dataclass(frozen=True)
class Request:
    """What is to be tuned and how; together with the FMU it determines the result.

    Attributes:
        damper: "tmd-n" (nacelle), "tmd-p" (platform) or "mtmd" (both).
        method: see `optimisation.strategies`.
        seed: of the random numbers.
        population, generations, evaluations: per generation, and largest numbers; None: the method's usual population,
            and 5000 evaluations or, if generations are given, as many as they take.
        parameters: values of other parameters by name, where they differ from the FMU's (table 3) or the load case's.
        bounds: other bounds than those of eq. 14, by name of the variable.
        horizon: length of the free decay, s.
        variables: bounds of further design variables, by name: any real parameter, such as a damper's mass or place.
        objective: "decay" (eq. 13, simplified model), or standard deviations in scenarios: "spectral" (linear models),
            "coupled" (co-simulation); see `optimisation.scenario_tuning`. What follows is for these two.
        scenarios, channels, aggregate: conditions, responses, and how they make one fitness.
        relative_to: label of the design that others are compared with; reference: its values by name, None for the
            label's own.
        starts: designs by label, in the order of the variables, that the surrogate begins with.
        until: end of each co-simulation, s; None: the load case's own.
        surrogate_prior: the linear models guide the surrogate.
    """

    damper: DamperName
    method: Method = "ga"
    seed: int = 1
    population: int | None = None
    generations: int | None = None
    evaluations: int | None = None
    parameters: Mapping[str, float] = field(default_factory=dict)
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    horizon: float = 100.0
    variables: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    objective: Objective = "decay"
    scenarios: tuple[Scenario, ...] = ()
    channels: tuple[str, ...] = ()
    aggregate: How = "worst"
    relative_to: str = "none"
    reference: Mapping[str, float] | None = None
    starts: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    until: float | None = None
    surrogate_prior: bool = False

    def task(self) -> Design:
        """Design variables with their bounds.

        Raises:
            ValueError: unknown damper, bad bounds, or a parameter that the search sets.
        """
        task = with_variables(with_bounds(design(self.damper), self.bounds), self.variables)
        clash = sorted(set(self.parameters) & {*(v.name for v in task.variables), *task.switches})
        if clash:
            raise ValueError(f"{self.damper}: '{clash[0]}' is set by the optimisation; leave it out of the parameters")
        return task

    def resolved(self) -> Request:
        """The request with its defaults filled in."""
        count = len(self.task().variables)
        population = self.population or default_population(self.method, count)
        evaluations, generations = self.evaluations, self.generations
        if self.method == "surrogate":  # whose first generation is larger
            first = max(INITIAL * count, len(self.starts) + 2)
            usual = SURROGATE_BUDGET if generations is None else first + (generations - 1) * population
            return replace(self, population=population, evaluations=evaluations or usual)
        if evaluations is None:
            evaluations = BUDGET if generations is None else population * generations
        if evaluations < population:
            raise ValueError(f"{evaluations} evaluations do not suffice for one generation of {population}: allow more")
        if generations is None and self.method != "cma-es":  # whose population grows
            generations = evaluations // population
        return replace(self, population=population, evaluations=evaluations, generations=generations)

    def problem(self, model: Path | Mapping[str, str]) -> dict[str, Any]:
        """What determines the result, as JSON: the identity of a checkpoint.

        Args:
            model: the simplified model's FMU, or digests of what the scenarios consist of, by label.
        """
        own = design(self.damper).variables
        bounds = {v.name: [v.lower, v.upper] for v in self.task().variables if v.name in {o.name for o in own}}
        content = {"fmu": fmu_digest(model)} if isinstance(model, Path) else {"models": dict(model)}
        return asdict(self.resolved()) | {"bounds": bounds} | content

    @classmethod
    def of_problem(cls, saved: Mapping[str, Any]) -> Request:
        """The request of a checkpoint's problem."""
        known = {f.name for f in fields(cls)}
        settings = {name: value for name, value in saved.items() if name in known}
        for name in ("bounds", "variables", "starts"):
            settings[name] = {key: tuple(value) for key, value in settings.get(name, {}).items()}
        settings["scenarios"] = tuple(Scenario(**scenario) for scenario in settings.get("scenarios", ()))
        settings["channels"] = tuple(settings.get("channels", ()))
        return cls(**settings)


def optimise(damper: DamperName, fmu: Path, *, seed: int, **options: Any) -> OptimisationResult:
    """`tune` with the fields of `Request` as keywords."""
    names = {f.name for f in fields(Request)}
    settings = {name: options.pop(name) for name in names & set(options)}
    return tune(Request(damper, seed=seed, **settings), fmu, **options)


def tune(
    request: Request,
    fmu: Path,
    *,
    workers: int = 1,
    dask: str | None = None,
    progress: Callable[[Generation], None] | None = None,
    checkpoint: Path | None = None,
    resume: bool = False,
    local: bool = False,
) -> OptimisationResult:
    """Find the stiffness and damping that minimise the tower-top displacement's standard deviation (eqs. 13, 14).

    Args:
        request: what to tune and how.
        fmu: the simplified model's FMU.
        workers: threads; dask: address of a Dask scheduler, whose workers evaluate instead; the result depends on
            neither.
        progress: called after each generation.
        checkpoint: file written after each generation; resume: continue from it.
        local: polish the best point found and certify it, see `refine`.

    Raises:
        ValueError: unknown damper, bad bounds, the FMU lacks a variable, or the checkpoint is of another problem.
        OptimisationError: every candidate failed; carries the first failure's message.
    """
    request = request.resolved()
    damper, task = request.damper, checked_variables(request.task(), lambda name: (fmu, name))
    names = tuple(v.name for v in task.variables)
    with _objective(request, fmu, workers, dask) as objective:
        found = run_search(request, fmu, objective, progress=progress, checkpoint=checkpoint, resume=resume)
        last = found.generations[-1]
        if not np.isfinite(last.best):
            raise OptimisationError(
                f"{damper}: all {last.evaluations} evaluations failed; the first: {objective.first_failure}"
            )
        failure = objective.first_failure
    result = OptimisationResult(
        damper=damper,
        method=request.method,
        fitness=last.best,
        parameters=dict(zip(names, last.parameters, strict=True)),
        history=found.generations,
        evaluations=last.evaluations,
        generations=last.number,
        seconds=found.seconds,
        seed=request.seed,
        undamped_fitness=undamped_fitness(fmu, request.parameters, horizon=request.horizon),
        bounds={v.name: (v.lower, v.upper) for v in task.variables},
        variables=task.variables,
        failures=last.failures,
        first_failure=failure,
    )
    return refine(result, request, fmu, workers=workers) if local else result


def refine(
    result: OptimisationResult,
    request: Request,
    fmu: Path,
    *,
    workers: int = 1,
    progress: Callable[[int, float], None] | None = None,
) -> OptimisationResult:
    """The result of `tune` with its design polished and certified, see `optimisation.polish`; arguments as there.

    It evaluates here in any case: a polish asks for a few designs at a time, too few for the way to a cluster.
    """
    task = request.task()
    with _objective(request, fmu, workers, None) as objective:
        start = np.array([result.parameters[v.name] for v in task.variables])
        optimum = polish(objective, *bounds_of(task), start, progress=progress)
    return replace(
        result,
        fitness=optimum.fitness,
        parameters=dict(zip(result.parameters, optimum.parameters, strict=True)),
        evaluations=result.evaluations + optimum.evaluations,
        local_optimum=optimum,
    )


def _objective(request: Request, fmu: Path, workers: int, dask: str | None) -> TowerTopDeviation | DistributedDeviation:
    task = request.task()
    names, fixed = [v.name for v in task.variables], dict(request.parameters) | task.switches
    if dask is not None:
        return DistributedDeviation(fmu, names, fixed, horizon=request.horizon, address=dask)
    return TowerTopDeviation(fmu, names, fixed, horizon=request.horizon, workers=workers)


def run_search(
    request: Request,
    fmu: Path,
    objective: TowerTopDeviation | DistributedDeviation,
    *,
    progress: Callable[[Generation], None] | None,
    checkpoint: Path | None,
    resume: bool,
) -> Found:
    """Search by a resolved request's method, saving after each generation, and continuing if asked to; raises as
    `optimise`."""
    assert request.population is not None
    lower, upper = bounds_of(request.task())
    options = {"limit": request.evaluations} if request.method == "surrogate" else {}
    strategy = make_strategy(request.method, lower, upper, population=request.population, seed=request.seed, **options)
    return continued_search(
        request, request.problem(fmu), objective, strategy, progress=progress, checkpoint=checkpoint, resume=resume
    )


class FailureKeeper(Protocol):
    """An objective that keeps the message of its first failure, or None."""

    first_failure: str | None

    def __call__(self, candidates: Array, /) -> Array:
        """Values of candidates, see `optimisation.search`."""


def continued_search(
    request: Request,
    problem: Mapping[str, Any],
    objective: FailureKeeper,
    strategy: Strategy,
    *,
    progress: Callable[[Generation], None] | None,
    checkpoint: Path | None,
    resume: bool,
) -> Found:
    """Search by a strategy, saving after each generation, and continuing if asked to; raises as `optimise`."""
    record: Record | None = None
    if resume:
        if checkpoint is None:
            raise ValueError("a search is resumed from a checkpoint: give one")
        record = resumed_record(checkpoint, problem)
        objective.first_failure = record.first_failure

    def save(done: Record) -> None:
        if checkpoint is not None:
            write_checkpoint(checkpoint, problem, replace(done, first_failure=objective.first_failure))

    assert request.evaluations is not None
    return search(
        objective,
        strategy,
        evaluations=request.evaluations,
        generations=request.generations,
        record=record,
        save=save,
        progress=progress,
    )


def bounds_of(task: Design) -> tuple[Array, Array]:
    """Lower and upper bounds of the design variables, shapes (variables,)."""
    return np.array([v.lower for v in task.variables]), np.array([v.upper for v in task.variables])


def undamped_fitness(fmu: Path, parameters: Mapping[str, float] | None = None, *, horizon: float = 100.0) -> float:
    """Fitness without any damper, m."""
    absent = {"nacelle_damper.active": 0.0, "platform_damper.active": 0.0}
    with TowerTopDeviation(fmu, (), dict(parameters or {}) | absent, horizon=horizon) as objective:
        value = float(objective(np.zeros((1, 0)))[0])
    return value if math.isfinite(value) else float("nan")
