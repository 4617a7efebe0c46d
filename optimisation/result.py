"""What an optimisation found, and the files it leaves: result.json, a tuned parameter set (.ssv), a picture."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

from optimisation.genetic import Generation
from optimisation.objective import DamperName, design

BASE_UNITS = {"N/m": {"kg": 1, "s": -2}, "N.s/m": {"kg": 1, "s": -1}}


@dataclass(frozen=True)
class OptimisationResult:
    """Result of `optimise`.

    Attributes:
        damper: arrangement.
        fitness: standard deviation of the tower-top displacement, m.
        parameters: by name, in N/m and N s/m.
        history: one entry per generation.
        evaluations: simulations run; failures: those that gave no finite fitness.
        generations: number run.
        seconds: wall time.
        seed: of the random numbers.
        undamped_fitness: without any damper, m.
        first_failure: message, or None.
    """

    damper: DamperName
    fitness: float
    parameters: dict[str, float]
    history: tuple[Generation, ...]
    evaluations: int
    generations: int
    seconds: float
    seed: int
    undamped_fitness: float
    failures: int = 0
    first_failure: str | None = None

    @property
    def at_bound(self) -> tuple[str, ...]:
        """Parameters within 1 % of the range of a bound of eq. 14: the search space limits them, not the physics."""
        limits = {v.name: v for v in design(self.damper).variables}
        return tuple(
            name
            for name, value in self.parameters.items()
            if min(value - limits[name].lower, limits[name].upper - value)
            < 0.01 * (limits[name].upper - limits[name].lower)
        )

    @property
    def converged_at(self) -> int:
        """First generation whose best fitness is within 1 mm of the final one."""
        return next(g.number for g in self.history if g.best <= self.fitness + 1e-3)


def write_json(result: OptimisationResult, path: Path) -> Path:
    """Write fitness, parameters, counts and history as JSON; SI units."""
    content = {
        "damper": result.damper,
        "fitness": result.fitness,
        "parameters": result.parameters,
        "evaluations": result.evaluations,
        "failures": result.failures,
        "first_failure": result.first_failure,
        "generations": result.generations,
        "converged_at": result.converged_at,
        "at_bound": list(result.at_bound),
        "undamped_fitness": result.undamped_fitness,
        "paper_fitness": design(result.damper).paper_fitness,
        "seed": result.seed,
        "seconds": result.seconds,
        "history": [
            {"generation": g.number, "best": g.best, "mean": g.mean, "evaluations": g.evaluations}
            for g in result.history
        ],
    }
    path.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
    return path


def write_ssv(result: OptimisationResult, path: Path) -> Path:
    """Write the tuned parameters as an SSP 1.0 parameter set.

    Its names serve the simplified model and the coupled system alike ("nacelle_damper.k", ...).
    """
    from pyssp_standard.ssv import SSV

    units = {v.name: v.unit for v in design(result.damper).variables}
    with SSV(path, mode="w") as parameter_set:
        parameter_set.ssv_elem.name = f"tuned_{result.damper.replace('-', '_')}"
        for name, value in result.parameters.items():
            parameter_set.add_parameter(name, "Real", value=value, unit=units[name])
        for unit in dict.fromkeys(units.values()):
            parameter_set.add_unit(unit, BASE_UNITS[unit])
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
    axes.set_title(f"{result.damper.upper()}: best {result.fitness:.4f} m after {result.evaluations} evaluations")
    axes.grid(alpha=0.3)
    figure.legend(loc="outside lower center", ncols=2)
    figure.savefig(path, dpi=150)
    return path
