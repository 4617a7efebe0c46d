"""What an optimisation found, and the files it leaves: result.json, a tuned parameter set (.ssv), a picture."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from optimisation.checkpoint import write_atomically
from optimisation.objective import DamperName, DesignVariable, design
from optimisation.polish import LocalOptimum
from optimisation.search import Generation
from optimisation.strategies import Method


@dataclass(frozen=True)
class OptimisationResult:
    """Result of `optimise`.

    Attributes:
        damper: arrangement.
        method: of the search.
        fitness: standard deviation of the tower-top displacement, m.
        parameters: by name, in N/m and N s/m.
        history: one entry per generation.
        evaluations: simulations run; failures: those that gave no finite fitness.
        generations: number run.
        seconds: wall time of the search.
        seed: of the random numbers.
        undamped_fitness: without any damper, m.
        bounds: of the search, by name; variables: the same with units (none: those of eq. 14).
        first_failure: message, or None.
        local_optimum: what the polish found, or None.
    """

    damper: DamperName
    method: Method
    fitness: float
    parameters: dict[str, float]
    history: tuple[Generation, ...]
    evaluations: int
    generations: int
    seconds: float
    seed: int
    undamped_fitness: float
    bounds: dict[str, tuple[float, float]]
    variables: tuple[DesignVariable, ...] = ()
    failures: int = 0
    first_failure: str | None = None
    local_optimum: LocalOptimum | None = None

    @property
    def at_bound(self) -> tuple[str, ...]:
        """Parameters within 1 % of the range of a bound: the search space limits them, not the physics."""
        return tuple(
            name
            for name, value in self.parameters.items()
            if min(value - self.bounds[name][0], self.bounds[name][1] - value)
            < 0.01 * (self.bounds[name][1] - self.bounds[name][0])
        )

    @property
    def converged_at(self) -> int:
        """First generation whose best fitness is within 1 mm of the last one's."""
        return next(g.number for g in self.history if g.best <= self.history[-1].best + 1e-3)


def write_json(result: OptimisationResult, path: Path) -> Path:
    """Write fitness, parameters, counts and history as JSON; SI units."""
    content = {
        "damper": result.damper,
        "method": result.method,
        "fitness": result.fitness,
        "parameters": result.parameters,
        "evaluations": result.evaluations,
        "failures": result.failures,
        "first_failure": result.first_failure,
        "generations": result.generations,
        "converged_at": result.converged_at,
        "bounds": {name: list(limits) for name, limits in result.bounds.items()},
        "at_bound": list(result.at_bound),
        "local_optimum": _certificate(result.local_optimum),
        "undamped_fitness": result.undamped_fitness,
        "paper_fitness": design(result.damper).paper_fitness,
        "seed": result.seed,
        "seconds": result.seconds,
        "history": [
            {"generation": g.number, "best": g.best, "mean": g.mean, "evaluations": g.evaluations}
            for g in result.history
        ],
    }
    # nan and inf, which a failed generation's mean may be, are no JSON
    return write_atomically(path, json.dumps(plain(content), indent=2, allow_nan=False) + "\n")


def _certificate(optimum: LocalOptimum | None) -> dict[str, Any] | None:
    if optimum is None:
        return None
    found = asdict(optimum)
    del found["parameters"]
    return found | {"smooth": optimum.smooth, "certified": optimum.certified}


def plain(value: Any) -> Any:
    """The value as JSON can have it: None for numbers that are not finite."""
    if isinstance(value, dict):
        return {k: plain(v) for k, v in value.items()}
    if isinstance(value, list):
        return [plain(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def write_ssv(result: OptimisationResult, path: Path) -> Path:
    """Write the tuned parameters as an SSP 1.0 parameter set.

    Its names serve the simplified model and the coupled system alike ("nacelle_damper.k", ...).
    """
    return write_design(result.damper, result.parameters, result.variables or design(result.damper).variables, path)


def write_design(damper: str, parameters: Mapping[str, float], variables: Sequence[DesignVariable], path: Path) -> Path:
    """Write values of design variables as an SSP 1.0 parameter set."""
    from pyssp_standard.ssv import SSV

    units = {v.name: v.unit or None for v in variables}
    with SSV(path, mode="w") as parameter_set:
        parameter_set.ssv_elem.name = f"tuned_{damper.replace('-', '_')}"
        for name, value in parameters.items():
            parameter_set.add_parameter(name, "Real", value=value, unit=units[name])
        for unit, base in {v.unit: dict(v.base) for v in variables if v.unit}.items():
            parameter_set.add_unit(unit, base)
    return path


def plot_convergence(result: OptimisationResult, path: Path) -> Path:
    """Draw best and mean fitness over the generations as PNG, beside the published optimum (the paper's figure 6)."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.0, 4.6), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    number = [g.number for g in result.history]
    axes.plot(number, [g.mean for g in result.history], color="tab:grey", label="mean of the population")
    axes.plot(number, [g.best for g in result.history], color="tab:blue", marker=".", label="best individual")
    paper = design(result.damper).paper_fitness
    axes.axhline(paper, color="tab:red", linestyle="--", label=f"Wang et al. (2022), table 4: {paper:.4f} m")
    axes.axhline(
        result.undamped_fitness, color="black", linestyle=":", label=f"no damper: {result.undamped_fitness:.4f} m"
    )
    axes.set_xlabel("generation")
    axes.set_ylabel("standard deviation of\ntower-top displacement (m)")
    axes.set_title(
        f"{result.damper.upper()}: best {result.fitness:.4f} m after {result.evaluations} evaluations ({result.method})"
    )
    axes.grid(alpha=0.3)
    figure.legend(loc="outside lower center", ncols=2)
    figure.savefig(path, dpi=150)
    return path
