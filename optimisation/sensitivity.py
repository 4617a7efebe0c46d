"""Map of the fitness over two design variables, with the optimum, the published design and classical tunings."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd
from fmpy import read_model_description

from optimisation.baselines import classical_designs
from optimisation.objective import FITNESS, DesignVariable, TowerTopDeviation, design, with_bounds
from optimisation.polish import LocalOptimum, polish
from optimisation.stability import start_values

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Mark:
    """A design in the map: x and y in the variables' units, fitness in m."""

    label: str
    x: float
    y: float
    fitness: float


@dataclass(frozen=True)
class FitnessMap:
    """The fitness over two variables.

    Attributes:
        x, y: variables; values at `x_values`, shape (nx,), and `y_values`, shape (ny,).
        fitness: m, shape (ny, nx); nan where the simulation failed.
        held: the other design variables by name.
        optimum: lowest point in the plane, polished from the lowest of the map.
        marks: the optimum, the published design, classical tunings; with their own fitness in this plane.
        failures: evaluations without a finite fitness; first_failure: its message.
    """

    damper: str
    x: DesignVariable
    y: DesignVariable
    x_values: Array
    y_values: Array
    fitness: Array
    held: dict[str, float]
    optimum: LocalOptimum
    marks: tuple[Mark, ...]
    failures: int
    first_failure: str | None


def fitness_map(
    damper: str,
    fmu: Path,
    x: str,
    y: str,
    *,
    points: int = 41,
    held: Mapping[str, float] | None = None,
    parameters: Mapping[str, float] | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    horizon: float = 100.0,
    workers: int = 1,
    progress: Callable[[int], None] | None = None,
) -> FitnessMap:
    """Evaluate the fitness on a grid over two design variables.

    Args:
        damper, fmu, parameters, bounds, horizon, workers: see `optimisation.tuning.optimise`.
        x, y: names of the variables.
        points: along either.
        held: values of the other design variables; table 4's by default.
        progress: called with the number of points done, after each row.

    Raises:
        ValueError: unknown damper or variable, or fewer than 3 points.
    """
    task = with_bounds(design(damper), bounds or {})
    variables = {v.name: v for v in task.variables}
    for name in (x, y, *(held or {})):
        if name not in variables:
            raise ValueError(f"no design variable '{name}' of {damper}: there are {', '.join(variables)}")
    if x == y or points < 3:
        raise ValueError("a map needs two different variables and at least 3 points along either")
    published = dict(zip(variables, task.paper_parameters, strict=True))
    others = {n: v for n, v in (published | dict(held or {})).items() if n not in (x, y)}
    fixed = dict(parameters or {}) | task.switches | others
    lower, upper = (np.array([getattr(variables[n], side) for n in (x, y)]) for side in ("lower", "upper"))
    x_values, y_values = (np.linspace(lower[i], upper[i], points) for i in (0, 1))
    with TowerTopDeviation(fmu, (x, y), fixed, horizon=horizon, workers=workers) as objective:
        rows = []
        for row, value in enumerate(y_values):
            rows.append(objective(np.column_stack([x_values, np.full(points, value)])))
            if progress is not None:
                progress((row + 1) * points)
        fitness = np.array(rows)
        if not np.isfinite(fitness).any():
            raise ValueError(f"{damper}: all {fitness.size} evaluations failed; the first: {objective.first_failure}")
        lowest = np.unravel_index(np.nanargmin(fitness), fitness.shape)
        optimum = polish(objective, lower, upper, np.array([x_values[lowest[1]], y_values[lowest[0]]]))
        published_here = all(value == published[name] for name, value in others.items())
        label = "Wang et al. (2022), table 4" + ("" if published_here else ", in this plane")
        places = {label: (published[x], published[y])} | _classical(fmu, fixed, x, y)
        values = objective(np.array(list(places.values())))
        failure = objective.first_failure
    marks = [Mark("optimum in this plane", optimum.parameters[0], optimum.parameters[1], optimum.fitness)]
    marks += [Mark(n, *xy, float(f)) for (n, xy), f in zip(places.items(), values, strict=True)]
    failures = int((~np.isfinite(fitness)).sum())
    return FitnessMap(
        damper,
        variables[x],
        variables[y],
        x_values,
        y_values,
        fitness,
        others,
        optimum,
        tuple(marks),
        failures,
        failure,
    )


def _classical(fmu: Path, fixed: Mapping[str, float], x: str, y: str) -> dict[str, tuple[float, float]]:
    """Classical tunings, if x and y are stiffness and damping of one damper."""
    (place, first), (other, second) = x.split("."), y.split(".")
    if place != other or {first, second} != {"k", "c"}:
        return {}
    values = start_values(read_model_description(str(fmu)))
    designs = classical_designs(values | dict(fixed), place)
    return {n: (k, c) if first == "k" else (c, k) for n, (k, c) in designs.items()}


def write_csv(found: FitnessMap, path: Path) -> Path:
    """Write the grid as a table of three columns, SI units."""
    x, y = np.meshgrid(found.x_values, found.y_values)
    columns = {found.x.name: x.ravel(), found.y.name: y.ravel(), FITNESS: found.fitness.ravel()}
    pd.DataFrame(columns).to_csv(path, index=False)
    return path


def plot_map(found: FitnessMap, path: Path) -> Path:
    """Draw the map as PNG, contours denser towards the optimum."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.0, 5.6), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    lowest, highest = min(np.nanmin(found.fitness), found.optimum.fitness), np.nanmax(found.fitness)
    levels = lowest + (highest - lowest) * np.linspace(0.0, 1.0, 25) ** 2
    drawn = axes.contourf(found.x_values, found.y_values, found.fitness, levels=levels, cmap="viridis_r")
    axes.contour(found.x_values, found.y_values, found.fitness, levels=levels, colors="white", linewidths=0.4)
    figure.colorbar(drawn, ax=axes, label="standard deviation of tower-top displacement (m)", format="%.3f")
    styles = (("*", "tab:red"), ("o", "tab:orange"), ("s", "white"), ("D", "tab:cyan"), ("^", "tab:pink"))
    for mark, (marker, colour) in zip(found.marks, styles, strict=False):
        axes.plot(
            mark.x, mark.y, marker, color=colour, mec="black", ms=14 if marker == "*" else 8, ls="", clip_on=False,
            zorder=5, label=f"{mark.label}: {mark.fitness:.4f} m",
        )  # fmt: skip
    axes.set_xlim(found.x_values[0], found.x_values[-1])
    axes.set_ylim(found.y_values[0], found.y_values[-1])
    axes.set_xlabel(f"{found.x.name} ({found.x.unit.replace('.', ' ')})")
    axes.set_ylabel(f"{found.y.name} ({found.y.unit.replace('.', ' ')})")
    held = ", ".join(f"{n} = {v:.5g}" for n, v in found.held.items())
    axes.set_title(f"{found.damper.upper()}" + (f" at {held}" if held else ""), fontsize=10)
    figure.legend(loc="outside lower center", ncols=2, fontsize=9)
    figure.savefig(path, dpi=150)
    return path
