"""Convergence of the coupling: errors of a system's runs with ever smaller steps, and the order at which they fall."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from cosim.errors import CosimError
from cosim.layout import ITERATED

MATCH = 1e-6  # s: rows this close in time are of the same instant


@dataclass(frozen=True)
class Scheme:
    """A way of stepping: algorithm, inputs over a step, whether steps are halved where a port's energy demands it."""

    algorithm: str
    extrapolation: str = "quadratic"
    halved: bool = False

    @property
    def label(self) -> str:
        """In words."""
        over = "" if self.algorithm in ITERATED else f", {self.extrapolation}"
        return f"{self.algorithm}{over}{', halved' if self.halved else ''}"

    def settings(self) -> dict[str, Any]:
        """Settings of a run."""
        chosen: dict[str, Any] = {"algorithm": self.algorithm, "extrapolation": self.extrapolation}
        return chosen if self.halved else chosen | {"energy_tolerance": 0.0}


SCHEMES = (
    Scheme("jacobi", "held"),
    Scheme("jacobi", "linear"),
    Scheme("gauss-seidel", "held"),
    Scheme("gauss-seidel", "linear"),
    Scheme("gauss-seidel", "quadratic"),
    Scheme("gauss-seidel", "quadratic", halved=True),
    Scheme("newton", halved=True),
)


def steps_of(coarsest: float, halvings: int) -> list[float]:
    """Communication steps of a study, s: `coarsest`, its half, its quarter, ..."""
    return [coarsest / 2**n for n in range(halvings + 1)]


def errors(frame: pd.DataFrame, reference: pd.DataFrame, channels: Sequence[str], transient: float) -> dict[str, float]:
    """Root mean square of the difference, as a share of the reference's standard deviation, by channel.

    Args:
        frame, reference: indexed by time, s; compared where both have rows, after the transient.

    Raises:
        CosimError: they share no rows.
    """
    ours, theirs = (np.round(f.index.to_numpy() / MATCH).astype(np.int64) for f in (frame, reference))
    _, a, b = np.intersect1d(ours, theirs, return_indices=True)
    late = reference.index.to_numpy()[b] >= transient - MATCH
    if not late.any():
        raise CosimError(f"no common instants after {transient:g} s: the recorded steps do not match")
    found = {}
    for name in channels:
        exact = reference[name].to_numpy()[b[late]]
        difference = frame[name].to_numpy()[a[late]] - exact
        found[name] = float(np.sqrt(np.mean(difference**2)) / np.std(exact))
    return found


def study(
    run: Callable[[Scheme, float], pd.DataFrame | None],
    reference: pd.DataFrame,
    schemes: Sequence[Scheme],
    steps: Sequence[float],
    channels: Sequence[str],
    transient: float,
) -> pd.DataFrame:
    """Errors of each scheme at each step.

    Args:
        run: results of a scheme with a step (s); None where it broke off.

    Returns:
        columns scheme, step (s), error (largest of the channels; inf where the run broke off), order (of the fall from
        the step before) and one per channel.
    """
    rows: list[dict[str, Any]] = []
    for scheme in schemes:
        before = np.nan
        for step in steps:
            frame = run(scheme, step)
            found = dict.fromkeys(channels, np.inf) if frame is None else errors(frame, reference, channels, transient)
            worst = max(found.values())
            order = np.log2(before / worst) if np.isfinite(before) and np.isfinite(worst) and worst > 0.0 else np.nan
            rows.append({"scheme": scheme.label, "step": step, "error": worst, "order": float(order), **found})
            before = worst
    return pd.DataFrame(rows)


def settled(table: pd.DataFrame) -> Mapping[str, float]:
    """Observed order of each scheme: the slope of the line through its finite errors, in logarithms."""
    slopes = {}
    for label, part in table.groupby("scheme", sort=False):
        fine = part[np.isfinite(part["error"]) & (part["error"] > 0.0)]
        enough = len(fine) > 1
        slopes[str(label)] = float(np.polyfit(np.log(fine["step"]), np.log(fine["error"]), 1)[0]) if enough else np.nan
    return slopes
