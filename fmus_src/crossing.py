"""Where a switch changes within a step: located so that the step can end just past it. The C runtime does the same."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

MAX_CROSSINGS = 20  # within one step
_TOLERANCE = 1e-10  # of the step
_MAX_ITERATIONS = 60


def crossed(switches: Array, held: Flags, before: Array) -> Flags:
    """Switches whose sign is not the one held; what stays at zero, or returns to it, is let be."""
    return np.asarray(((switches > 0.0) != held) & (before != 0.0))


def locate(
    step: Callable[[float], tuple[Array, Array]], h: float, before: Array, end: tuple[Array, Array], held: Flags
) -> tuple[float, Array]:
    """Length of the step that ends just past the first crossing, and the state there (Illinois' method).

    Args:
        step: length, s -> state and switches' arguments after it.
        before: the arguments at the start; end: state and arguments after h, where one has crossed.
        held: the switches over the step.
    """
    y, s_b = end
    s_a, a, b, w_a, w_b, side, slow = before, 0.0, h, 1.0, 1.0, 0, 0
    tolerance = _TOLERANCE * h
    for _ in range(_MAX_ITERATIONS):
        which, width = crossed(s_b, held, before), b - a
        v_a, v_b = w_a * s_a[which], w_b * s_b[which]
        zero = a + width * float(np.min(v_a / (v_a - v_b)))
        if b - zero <= tolerance:
            break
        trial = zero + 0.5 * tolerance if slow < 3 else 0.5 * (a + b)
        y_trial, s_trial = step(trial)
        if crossed(s_trial, held, before).any():
            b, y, s_b, w_b = trial, y_trial, s_trial, 1.0
            w_a = 0.5 * w_a if side == 1 else w_a
            side = 1
        else:
            a, s_a, w_a = trial, s_trial, 1.0
            w_b = 0.5 * w_b if side == -1 else w_b
            side = -1
        slow = slow + 1 if b - a > 0.5 * width else 0
    return b, y
