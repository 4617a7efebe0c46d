"""Interleaved repeats, each contender in a process of its own; medians, ratios and agreement."""

from __future__ import annotations

import multiprocessing
import statistics
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.case import Case, Sample
from benchmarks.contenders import Run

Result = dict[str, Any]
Note = Callable[[str], None]
WARM_UP = 0.25  # simulated s


@dataclass(frozen=True)
class Settings:
    """How to measure.

    Attributes:
        folder: for systems and other scratch files.
        repeats: rounds; in each, every contender runs once.
        quick: short runs, and all algorithms of one master in one process (their peak memory is then a common one).
        note: called with what is being done.
    """

    folder: Path
    repeats: int
    quick: bool
    note: Note


def interleave(
    runs: Mapping[str, Callable[[], Sample]],
    settings: Settings,
    warm_up: Mapping[str, Callable[[], Sample]] | None = None,
) -> tuple[dict[str, list[Sample]], Result]:
    """Run the contenders in turn, `repeats` times.

    Args:
        warm_up: run once before, and not counted: imports, compiled code and files are then at hand.

    Returns:
        samples by contender, and the message of each contender that failed (it is left out from then on).
    """
    samples: dict[str, list[Sample]] = {name: [] for name in runs}
    failures: Result = {}
    with ExitStack() as stack:
        pools: dict[str, ProcessPoolExecutor] = {}

        def pool(name: str) -> ProcessPoolExecutor:
            key = name.split()[0] if settings.quick else name
            if key not in pools:
                context = multiprocessing.get_context("spawn")
                pools[key] = stack.enter_context(ProcessPoolExecutor(1, mp_context=context))
            return pools[key]

        for repeat in range(0 if warm_up else 1, settings.repeats + 1):
            for name in (n for n in runs if n not in failures):
                settings.note(f"round {repeat} of {settings.repeats}: {name}")
                try:
                    if repeat:
                        samples[name].append(pool(name).submit(runs[name]).result())
                    elif warm_up:
                        pool(name).submit(warm_up[name]).result()
                except Exception as error:  # whatever another tool raises, or a process that has died
                    failures[name] = f"{type(error).__name__}: {error}".splitlines()[0]
    return {n: s for n, s in samples.items() if n not in failures}, failures


def spread(values: Sequence[float]) -> dict[str, float]:
    """Median, least and largest value."""
    return {"median": statistics.median(values), "min": min(values), "max": max(values)}


def compare(
    case: Case, runs: Mapping[str, Run], reference: str, settings: Settings, *, stop: float, tolerance: float = 0.0
) -> Result:
    """Measure contenders on one system.

    Args:
        reference: the contender to which the others are related, in each round.
        tolerance: contenders not named "fowt ..." must agree with the reference within this share of a series' range;
            0: nothing is compared.

    Returns:
        `contenders`: per contender `step_seconds`, `cpu_step_seconds`, `total_seconds`, `ratio` and `cpu_ratio` (each
        median, min, max) and `peak_memory` in B; `agreement`: largest difference of each, as a share of the range.
    """
    bound = {name: Bound(run, case, stop) for name, run in runs.items()}
    warm_up = {name: Bound(run, case, WARM_UP) for name, run in runs.items()}
    samples, failures = interleave(bound, settings, warm_up)
    if reference not in samples:
        raise RuntimeError(f"{case.name}: {reference} failed: {failures.get(reference)}")
    base = samples[reference]
    contenders = {
        name: {
            "step_seconds": spread([s.per_step for s in taken]),
            "cpu_step_seconds": spread([s.cpu_per_step for s in taken]),
            "total_seconds": spread([s.total_seconds for s in taken]),
            "ratio": spread([s.per_step / b.per_step for s, b in zip(taken, base, strict=True)]),
            "cpu_ratio": spread([s.cpu_per_step / b.cpu_per_step for s, b in zip(taken, base, strict=True)]),
            "peak_memory": taken[0].peak_memory,
            "component_step_seconds": {
                c: statistics.median(s.component_seconds[c] for s in taken) * case.step / stop
                for c in taken[0].component_seconds
            },
        }
        for name, taken in samples.items()
    }
    result: Result = {
        "system": case.description, "components": len(case.components), "step": case.step, "stop": stop,
        "steps": round(stop / case.step), "reference": reference, "contenders": contenders, "failures": failures,
    }  # fmt: skip
    if tolerance:
        compared = [n for n in samples if n != reference and not n.startswith("fowt ")]
        differences = {n: difference(base[0], samples[n][0]) for n in compared}
        result["agreement"] = {
            "tolerance": tolerance, "variables": list(case.compared), "difference": differences,
            "agrees": {n: d <= tolerance for n, d in differences.items()},
        }  # fmt: skip
    return result


def difference(reference: Sample, other: Sample) -> float:
    """Largest difference of any compared series at any communication point, as a share of the series' range."""
    worst = 0.0
    for name, values in reference.series.items():
        theirs = other.series[name]
        if len(theirs) != len(values):
            return float("inf")
        extent = max(values) - min(values)
        gap = max(abs(a - b) for a, b in zip(values, theirs, strict=True))
        worst = max(worst, gap / extent if extent else (0.0 if gap == 0.0 else float("inf")))
    return worst


@dataclass(frozen=True)
class Bound:
    """A contender with its system and simulated time: can be sent to another process."""

    run: Run
    case: Case
    stop: float

    def __call__(self) -> Sample:
        return self.run(self.case, self.stop)
