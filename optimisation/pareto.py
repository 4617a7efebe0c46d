"""Response against damper stroke: the designs that no other beats in both (NSGA-II, Deb et al. 2002)."""

from __future__ import annotations

import ctypes
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import fmi2Warning
from pymoo.util.nds.non_dominated_sorting import find_non_dominated

from optimisation.checkpoint import write_atomically
from optimisation.objective import FITNESS, TowerTopDeviation, design
from optimisation.search import Generation, search
from optimisation.strategies import default_population, make_strategy
from optimisation.tuning import OptimisationError, Request, bounds_of, run_search

Array = npt.NDArray[np.float64]

SAMPLE = 0.1  # s; a peak between samples is found by a parabola, to 2e-5 of it for the stiffest damper of eq. 14
STROKE = "largest_stroke"


class DeviationAndStroke(TowerTopDeviation):
    """Standard deviation of the tower-top displacement, and the largest displacement of any damper relative to its
    attachment, both in m: fitness of shape (n, 2). Arguments as `TowerTopDeviation`; stops end at their compression."""

    shape = (2,)
    initial_stroke = 0.0  # m, at the start of a decay: no design has less

    def _simulate(self, slave: Any) -> Any:
        present = [n.removesuffix(".active") for n, on in self.fixed.items() if n.endswith(".active") and on]
        references = [self._known[f"{name}.relative_displacement"].valueReference for name in present]
        samples = sampled(slave, references, np.linspace(0.0, self.horizon, max(1, round(self.horizon / SAMPLE)) + 1))
        self.initial_stroke = float(np.abs(samples[0]).max())
        deviation = float(slave.getReal([self._known[FITNESS].valueReference])[0])
        return np.array([deviation, max(peak(samples[:, j]) for j in range(len(present)))])


def sampled(slave: Any, references: Sequence[int], times: Array) -> Array:
    """Values of an initialised FMU's real variables at times, shape (times, variables), stepping from each to the next.

    The FMU's functions are called directly with arrays made once: FMPy's own calls take ten times as long as a step.

    Args:
        slave: FMPy's instance, at times[0].

    Raises:
        FMICallException: a call failed.
    """
    count, component = len(references), slave.component
    samples = np.empty((times.size, count))
    numbers, values = (ctypes.c_uint * count)(*references), samples.ctypes.data
    step = _function(slave, "fmi2DoStep", ctypes.c_double, ctypes.c_double, ctypes.c_int)
    get = _function(slave, "fmi2GetReal", ctypes.c_void_p, ctypes.c_size_t, ctypes.c_void_p)
    status, name = get(component, numbers, count, values), "fmi2GetReal"
    width, starts, lengths = samples.strides[0], times[:-1].tolist(), np.diff(times).tolist()
    for start, length in zip(starts, lengths, strict=True):
        if status > fmi2Warning:
            break
        status, name = step(component, start, length, 1), "fmi2DoStep"
        if status <= fmi2Warning:
            values += width
            status, name = get(component, numbers, count, values), "fmi2GetReal"
    if status > fmi2Warning:
        raise FMICallException(name, status)
    return samples


def _function(slave: Any, name: str, *arguments: Any) -> Any:
    """A function of the FMU without FMPy's wrapping."""
    function = slave.dll[name]
    function.restype, function.argtypes = ctypes.c_int, (ctypes.c_void_p, *arguments)
    return function


def peak(samples: Array) -> float:
    """Largest magnitude of an equally sampled signal, by a parabola through the largest sample and its neighbours."""
    x = np.abs(samples)
    i = int(np.argmax(x))
    if not 0 < i < x.size - 1:
        return float(x[i])
    slope, bend = (x[i + 1] - x[i - 1]) / 2, x[i - 1] - 2 * x[i] + x[i + 1]
    return float(x[i] - slope**2 / (2 * bend)) if bend < 0.0 else float(x[i])


@dataclass(frozen=True)
class Front:
    """Designs of which none is better in both objectives.

    Attributes:
        request: resolved.
        designs: a row per design, ascending in the standard deviation: the design variables by name, and the two
            objectives in m ("tower_top_displacement_std", "largest_stroke").
        optima: the same for the optimum of either objective alone, found by CMA-ES.
        history: one entry per generation; its best is the standard deviation's.
        initial_stroke: displacement at the start of the decay, m, below which no design comes: the dampers start at
            rest in the global frame, as in the paper, so the nacelle's 7.85 m from the centre of its rail.
        first_failure: message, or None.
    """

    request: Request
    designs: pd.DataFrame
    optima: pd.DataFrame
    history: tuple[Generation, ...]
    seconds: float
    initial_stroke: float
    first_failure: str | None = None


def pareto(
    request: Request,
    fmu: Path,
    *,
    workers: int = 1,
    progress: Callable[[Generation], None] | None = None,
    checkpoint: Path | None = None,
    resume: bool = False,
) -> Front:
    """Front of response against stroke; arguments and errors as `optimisation.tuning.optimise`."""
    request = replace(request, method="nsga2").resolved()
    task = request.task()
    names = [v.name for v in task.variables]
    fixed = dict(request.parameters) | task.switches
    with DeviationAndStroke(fmu, names, fixed, horizon=request.horizon, workers=workers) as objective:
        found = run_search(request, fmu, objective, progress=progress, checkpoint=checkpoint, resume=resume)
        usable = np.isfinite(found.values).all(axis=1)
        if not usable.any():
            raise OptimisationError(f"{request.damper}: all evaluations failed; the first: {objective.first_failure}")
        x, values = found.candidates[usable], found.values[usable]
        best = find_non_dominated(values)
        x, values = x[best], values[best]
        order = np.argsort(values[:, 0], kind="stable")
        designs = _frame(names, x[order], values[order])
        optima = _single_optima(request, fmu, objective, workers)
        failure, initial = objective.first_failure, objective.initial_stroke
    return Front(request, designs, optima, found.generations, found.seconds, initial, failure)


def _single_optima(request: Request, fmu: Path, objective: TowerTopDeviation, workers: int) -> pd.DataFrame:
    """Optimum of either objective alone, by CMA-ES; the response's needs no sampled motion, so it may take longer."""
    assert request.evaluations is not None
    lower, upper = bounds_of(request.task())
    population = default_population("cma-es", lower.size)

    def optimum(of: Callable[[Array], Array], evaluations: int) -> tuple[float, ...]:
        strategy = make_strategy("cma-es", lower, upper, population=population, seed=request.seed)
        return search(of, strategy, evaluations=evaluations).generations[-1].parameters

    with TowerTopDeviation(
        fmu, objective.names, objective.fixed, horizon=request.horizon, workers=workers
    ) as deviation:
        least_response = optimum(deviation, max(request.evaluations, 300))
    least_stroke = optimum(lambda x: objective(x)[:, 1], max(request.evaluations // 4, 100))
    x = np.array([least_response, least_stroke])
    return _frame(objective.names, x, objective(x))


def _frame(names: Sequence[str], x: Array, values: Array) -> pd.DataFrame:
    return pd.DataFrame(np.hstack([x, values]), columns=[*names, FITNESS, STROKE])


def write_front(front: Front, folder: Path) -> tuple[Path, Path]:
    """Write the front as pareto.csv (SI units) and, with optima and settings, result.json."""
    table, summary = folder / "pareto.csv", folder / "result.json"
    front.designs.to_csv(table, index=False)
    content = {
        "damper": front.request.damper,
        "method": front.request.method,
        "seed": front.request.seed,
        "designs": front.designs.to_dict("records"),
        "optima": front.optima.to_dict("records"),
        "initial_stroke": front.initial_stroke,
        "evaluations": front.history[-1].evaluations,
        "failures": front.history[-1].failures,
        "first_failure": front.first_failure,
        "seconds": front.seconds,
    }
    return table, write_atomically(summary, json.dumps(content, indent=2) + "\n")


def plot_front(front: Front, path: Path) -> Path:
    """Draw the front as PNG, with either objective's own optimum and the published design's place."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.0, 4.8), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    axes.plot(front.designs[STROKE], front.designs[FITNESS], "o", ms=4, color="tab:blue", label="Pareto front")
    for i, (marker, colour, label) in enumerate(
        (("*", "tab:red", "least response alone"), ("s", "tab:green", "least stroke alone"))
    ):
        row = front.optima.iloc[i]
        axes.plot(row[STROKE], row[FITNESS], marker, ms=11, color=colour, mec="black", ls="", label=label)
    if front.initial_stroke > 0.1 * front.designs[STROKE].min():
        label = f"stroke at the start, {front.initial_stroke:.2f} m"
        axes.axvline(front.initial_stroke, color="grey", ls=":", label=label)
    axes.set_xlabel("largest displacement of a damper relative to its attachment (m)")
    axes.set_ylabel("standard deviation of\ntower-top displacement (m)")
    task = design(front.request.damper)
    axes.set_title(f"{task.damper.upper()}: response against stroke, {len(front.designs)} designs")
    axes.grid(alpha=0.3)
    figure.legend(loc="outside lower center", ncols=2)
    figure.savefig(path, dpi=150)
    return path
