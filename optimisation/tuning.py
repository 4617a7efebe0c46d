"""Tuning of a damper arrangement: the genetic algorithm driving the simplified model's FMU."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from optimisation.genetic import Generation, Operators, search
from optimisation.objective import DamperName, TowerTopDeviation, design
from optimisation.result import OptimisationResult


class OptimisationError(RuntimeError):
    """No candidate could be evaluated."""


def optimise(
    damper: DamperName,
    fmu: Path,
    *,
    seed: int,
    population: int = 100,
    generations: int = 50,
    parameters: Mapping[str, float] | None = None,
    horizon: float = 100.0,
    workers: int = 1,
    progress: Callable[[Generation], None] | None = None,
) -> OptimisationResult:
    """Find the stiffness and damping that minimise the tower-top displacement's standard deviation (eqs. 13, 14).

    Args:
        damper: "tmd-n" (nacelle), "tmd-p" (platform) or "mtmd" (both).
        fmu: the simplified model's FMU.
        parameters: values of its other parameters by name, where they differ from its defaults (table 3).
        horizon: length of the free decay, s.
        workers: threads; the result does not depend on it.
        progress: called after each generation.

    Raises:
        ValueError: unknown damper, or the FMU lacks a variable.
        OptimisationError: every candidate failed; carries the first failure's message.
    """
    began = time.perf_counter()
    task = design(damper)
    names = tuple(v.name for v in task.variables)
    clash = sorted(set(parameters or {}) & {*names, *task.switches})
    if clash:
        raise ValueError(f"{damper}: '{clash[0]}' is set by the optimisation; leave it out of the parameters")
    fixed = dict(parameters or {}) | task.switches
    with TowerTopDeviation(fmu, names, fixed, horizon=horizon, workers=workers) as objective:
        history = search(
            objective,
            np.array([v.lower for v in task.variables]),
            np.array([v.upper for v in task.variables]),
            seed=seed,
            operators=Operators(population=population, generations=generations),
            progress=progress,
        )
        failure = objective.first_failure
    last = history[-1]
    if not np.isfinite(last.best):
        raise OptimisationError(f"{damper}: all {last.evaluations} evaluations failed; the first: {failure}")
    return OptimisationResult(
        damper=damper,
        fitness=last.best,
        parameters=dict(zip(names, last.parameters, strict=True)),
        history=tuple(history),
        evaluations=last.evaluations,
        generations=last.number,
        seconds=time.perf_counter() - began,
        seed=seed,
        undamped_fitness=undamped_fitness(fmu, parameters, horizon=horizon),
        failures=last.failures,
        first_failure=failure,
    )


def undamped_fitness(fmu: Path, parameters: Mapping[str, float] | None = None, *, horizon: float = 100.0) -> float:
    """Fitness without any damper, m."""
    absent = {"nacelle_damper.active": 0.0, "platform_damper.active": 0.0}
    with TowerTopDeviation(fmu, (), dict(parameters or {}) | absent, horizon=horizon) as objective:
        return float(objective(np.zeros((1, 0)))[0])
