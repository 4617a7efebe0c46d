"""How far the outcome of a search depends on its seed: the same search from several seeds, by each method."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from statistics import median

import pandas as pd

from optimisation.search import Generation
from optimisation.tuning import Request, refine, tune

CLOSE = 1e-3  # m: within a millimetre of the best known is as good


@dataclass(frozen=True)
class Trial:
    """One search from one seed, before or after its polish.

    Attributes:
        damper, method, seed: of the request.
        polished: whether the best design was polished.
        fitness: m.
        evaluations, seconds: of the search, and of the polish if there is one.
    """

    damper: str
    method: str
    seed: int
    polished: bool
    fitness: float
    evaluations: int
    seconds: float


def trials(
    request: Request,
    fmu: Path,
    *,
    workers: int = 1,
    polished: bool = True,
    progress: Callable[[Generation], None] | None = None,
) -> list[Trial]:
    """The search as it is and, if asked for, polished; arguments and errors as `optimisation.tuning.tune`."""
    found = tune(request, fmu, workers=workers, progress=progress)
    best = found.history[-1]
    plain = Trial(request.damper, request.method, request.seed, False, best.best, best.evaluations, found.seconds)
    if not polished:
        return [plain]
    began = time.perf_counter()
    fine = refine(found, request, fmu, workers=workers)
    seconds = found.seconds + time.perf_counter() - began
    return [plain, replace(plain, polished=True, fitness=fine.fitness, evaluations=fine.evaluations, seconds=seconds)]


def table(found: Sequence[Trial]) -> pd.DataFrame:
    """One row per trial, the attributes of `Trial` as columns."""
    return pd.DataFrame([asdict(t) for t in found])


def summary(found: Iterable[Trial]) -> pd.DataFrame:
    """What the seeds make of the outcome, one row per damper, method and polish.

    Returns:
        columns damper, method, polished, seeds (number), best, median, worst (fitness, m), close (seeds within a
        millimetre of the damper's best of all), evaluations, seconds (medians) and evaluations_per_second.
    """
    groups: dict[tuple[str, str, bool], list[Trial]] = {}
    for t in found:
        groups.setdefault((t.damper, t.method, t.polished), []).append(t)
    lowest = {d: min(t.fitness for k, g in groups.items() if k[0] == d for t in g) for d, _, _ in groups}
    rows = []
    for (damper, method, polished), group in groups.items():
        fitness = [t.fitness for t in group]
        rows.append({
            "damper": damper, "method": method, "polished": polished, "seeds": len(group),
            "best": min(fitness), "median": median(fitness), "worst": max(fitness),
            "close": sum(f <= lowest[damper] + CLOSE for f in fitness),
            "evaluations": int(median(t.evaluations for t in group)),
            "seconds": median(t.seconds for t in group),
            "evaluations_per_second": sum(t.evaluations for t in group) / sum(t.seconds for t in group),
        })  # fmt: skip
    return pd.DataFrame(rows)
