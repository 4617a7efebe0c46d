"""Damped and forced oscillations of a record: least squares fits of

    x(t) = c + sum_j (a_j cos w_j t + b_j sin w_j t) + sum_k exp(-zeta_k w_k t) (A_k cos wd_k t + B_k sin wd_k t)

with given forcing frequencies w_j, and wd_k = w_k sqrt(1 - zeta_k^2). The amplitudes follow linearly from w_k and
zeta_k, so that these alone are searched for (variable projection; Golub and Pereyra, Inverse Problems 19, 2003).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

Array = npt.NDArray[np.float64]

FREQUENCY_RANGE = 1.3  # a mode is searched within this factor of where it is said to be
DAMPING_RANGE = (-0.1, 0.9)
STARTS = (0.005, 0.05, 0.2)  # damping ratios to begin with: the search for one mode has several minima


@dataclass(frozen=True)
class Mode:
    """A damped mode: natural frequency, Hz (damped frequency / sqrt(1 - damping_ratio^2)); amplitude at the start."""

    frequency: float
    damping_ratio: float
    amplitude: float


@dataclass(frozen=True)
class Oscillations:
    """What a fit found.

    Attributes:
        modes: in the order they were asked for.
        forced: complex amplitudes X at the forcing frequencies: Re(X exp(i w t)), t being the record's own time.
        explained: share of the record's variance.
    """

    modes: tuple[Mode, ...]
    forced: tuple[complex, ...]
    explained: float


def fit_oscillations(
    time: Array, values: Array, near: Sequence[float] = (), forced: Sequence[float] = ()
) -> Oscillations:
    """Fit damped modes and forced oscillations.

    Args:
        time, values: shape (n,).
        near: about where the modes are, Hz; the one of interest first, then every other of some size in the record.
        forced: forcing frequencies, Hz.

    Raises:
        ValueError: the record is constant, holds fewer than two periods of what is of interest, or no such mode.
    """
    if not np.ptp(values) > 0.0:
        raise ValueError("does not move")
    length = time[-1] - time[0]
    for f in (*near, *forced):
        if length * f < 2.0 and f in (*near[:1], *forced):
            raise ValueError(f"{length:g} s hold fewer than two periods of {f:g} Hz")
        if 2.0 * f * length > time.size:
            raise ValueError(f"is sampled too coarsely for {f:g} Hz")
    elapsed = time - time[0]
    found = _best(elapsed, values, near, forced)
    coefficients, residual = _project(elapsed, values, found, forced)
    pairs = coefficients[1:].reshape(-1, 2)
    k = len(near)
    modes = tuple(
        Mode(float(f), float(z), float(math.hypot(*pair)))
        for f, z, pair in zip(found[:k], found[k:], pairs[len(forced) :], strict=True)
    )
    turns = (complex(a, -b) * np.exp(-2j * np.pi * f * time[0]) for f, (a, b) in zip(forced, pairs, strict=False))
    return Oscillations(modes, tuple(complex(x) for x in turns), 1.0 - float(residual.var() / values.var()))


def _best(elapsed: Array, values: Array, near: Sequence[float], forced: Sequence[float]) -> Array:
    """Frequencies and damping ratios of the best fit whose first mode lies within its range, not at an end of it."""
    if not near:
        return np.zeros(0)
    fits = [_search(elapsed, values, np.r_[near, [z] * len(near)], forced) for z in STARTS]
    inside = [
        fit for fit in fits
        if near[0] / FREQUENCY_RANGE * 1.001 < fit[0][0] < near[0] * FREQUENCY_RANGE * 0.999
        and fit[0][len(near)] < DAMPING_RANGE[1] - 0.001
    ]  # fmt: skip
    if not inside:
        raise ValueError(f"no mode within a factor of {FREQUENCY_RANGE:g} of {near[0]:g} Hz")
    return min(inside, key=lambda fit: fit[1])[0]


def _search(elapsed: Array, values: Array, begin: Array, forced: Sequence[float]) -> tuple[Array, float]:
    count = begin.size // 2
    low = np.r_[begin[:count] / FREQUENCY_RANGE, [DAMPING_RANGE[0]] * count]
    high = np.r_[begin[:count] * FREQUENCY_RANGE, [DAMPING_RANGE[1]] * count]
    scale = float(values.std())
    result = least_squares(
        lambda p: _project(elapsed, values, p, forced)[1] / scale, begin, bounds=(low, high),
        x_scale=np.r_[0.01 * begin[:count], np.full(count, 0.01)], xtol=1e-10, ftol=1e-12, gtol=1e-12,
    )  # fmt: skip
    return result.x, float(result.cost)


def _project(elapsed: Array, values: Array, parameters: Array, forced: Sequence[float]) -> tuple[Array, Array]:
    """Amplitudes of the best fit for these frequencies and damping ratios, and what is left of the record."""
    count = parameters.size // 2
    columns = [np.ones_like(elapsed)]
    for f in forced:
        angle = 2.0 * np.pi * f * elapsed
        columns += [np.cos(angle), np.sin(angle)]
    for f, zeta in zip(parameters[:count], parameters[count:], strict=True):
        omega = 2.0 * np.pi * f
        envelope = np.exp(-zeta * omega * elapsed)
        angle = omega * math.sqrt(1.0 - zeta**2) * elapsed
        columns += [envelope * np.cos(angle), envelope * np.sin(angle)]
    basis = np.column_stack(columns)
    coefficients: Array = np.linalg.lstsq(basis, values, rcond=None)[0].astype(np.float64)
    return coefficients, np.asarray(values - basis @ coefficients, dtype=np.float64)
