"""Local refinement of a design and the evidence that it is a local optimum.

The fitness is a smooth function of the design as long as the same stops are hit in the same order, since contacts are
located in time; where that order changes it has a kink. So a gradient method with finite differences goes first, a
derivative-free one second, and the certificate says whether the fitness is smooth at the point found.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.optimize import minimize

Array = npt.NDArray[np.float64]

# Steps relative to the variables' ranges. The fitness is known to about 1e-10 m, so that differences over 2e-3 of a
# range have errors near 1e-7 in gradients and 1e-4 in curvatures.
STEP = 1e-3
GRADIENT = 1e-4  # m per range: a gradient below it changes the fitness by less than 0.1 mm over the whole range
DIRECTIONS = 64
MARGIN = 1e-6  # of the range: closer to a bound is at it


@dataclass(frozen=True)
class LocalOptimum:
    """A polished design and what speaks for it.

    Attributes:
        fitness: of the design; gain: below that of the design it started from; in the objective's unit.
        parameters: of the design, shape (variables,).
        gradient: largest component of the projected gradient, unit of the fitness per range of a variable.
        curvature: smallest eigenvalue of the Hessian over the variables between their bounds, unit of the fitness per
            range squared; nan if every variable is at a bound.
        kink: largest jump of the one-sided derivatives along a variable, same unit as gradient.
        rise: smallest change of the fitness among many directions into the search space, over 1e-4 of the range.
        evaluations: of the objective.
    """

    fitness: float
    gain: float
    parameters: tuple[float, ...]
    gradient: float
    curvature: float
    kink: float
    rise: float
    evaluations: int

    @property
    def smooth(self) -> bool:
        """Whether the fitness is differentiable there, as far as differences tell."""
        return self.kink < 20 * GRADIENT

    @property
    def certified(self) -> bool:
        """Whether the conditions of a local minimum hold: of first and second order where the fitness is smooth, no
        descent in any direction tried where it has a kink."""
        if not self.smooth:
            return self.rise > 0.0
        return self.gradient < GRADIENT and not self.curvature <= 0.0

    @property
    def verdict(self) -> str:
        """In words."""
        if not self.smooth:
            found = (
                "the lowest of its surroundings, at a kink of the fitness (stops)" if self.certified else "uncertain"
            )
            return f"{found}: rises by at least {self.rise:.1e} m over 1e-4 of the range in {DIRECTIONS} directions"
        found = "a local optimum" if self.certified else "no local optimum"
        return f"{found}: projected gradient {self.gradient:.1e} m per range, least curvature {self.curvature:.2g} m"


def polish(
    objective: Callable[[Array], Array],
    lower: Array,
    upper: Array,
    start: Array,
    *,
    progress: Callable[[int, float], None] | None = None,
) -> LocalOptimum:
    """Minimise locally between bounds from a start, and examine the point reached.

    Args:
        objective: designs, shape (n, variables) -> fitness, shape (n,).
        lower, upper, start: shape (variables,).
        progress: called with the number of evaluations and the least fitness so far, after each call of the objective.
    """
    count, least = 0, np.inf
    span = upper - lower

    def fitness(z: Array) -> Array:
        nonlocal count, least
        values = np.asarray(objective(lower + span * np.clip(z, 0.0, 1.0)), dtype=float)
        values = np.where(np.isfinite(values), values, np.inf)
        count, least = count + len(z), min(least, float(values.min()))
        if progress is not None:
            progress(count, least)
        return values

    def single(z: Array) -> float:
        return float(fitness(z[None])[0])

    z = np.clip((start - lower) / span, 0.0, 1.0)
    begun = best = single(z)
    box = [(0.0, 1.0)] * z.size
    for step in (STEP, STEP / 10):
        found = minimize(
            single, z, jac=lambda x, h=step: _gradient(fitness, x, h), bounds=box, method="L-BFGS-B",
            options={"maxiter": 50, "ftol": 1e-14, "gtol": GRADIENT / 100},
        )  # fmt: skip
        if found.fun < best:
            z, best = np.clip(found.x, 0.0, 1.0), float(found.fun)
    found = minimize(
        single, z, bounds=box, method="Nelder-Mead",
        options={"initial_simplex": _simplex(z, STEP), "xatol": 1e-7, "fatol": 1e-11, "maxfev": 150 * z.size},
    )  # fmt: skip
    if found.fun < best:
        z, best = np.clip(found.x, 0.0, 1.0), float(found.fun)
    gradient, curvature, kink = _examine(fitness, z)
    ways = np.random.default_rng(0).normal(size=(DIRECTIONS, z.size))
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    inside = np.clip(z + STEP / 10 * ways, 0.0, 1.0) == z + STEP / 10 * ways
    rise = float(fitness(z + STEP / 10 * np.where(inside, ways, -ways)).min() - best)
    # exactly the values that the fitness was computed with
    parameters = tuple((lower + span * z).tolist())
    return LocalOptimum(best, begun - best, parameters, gradient, curvature, kink, rise, count)


def _gradient(fitness: Callable[[Array], Array], z: Array, step: float) -> Array:
    """Central differences, one-sided at a bound."""
    shifts = step * np.eye(z.size)
    points = np.clip(np.concatenate([z + shifts, z - shifts]), 0.0, 1.0)
    values = fitness(points)
    widths = np.diag(points[: z.size] - points[z.size :])
    return np.asarray((values[: z.size] - values[z.size :]) / widths)


def _simplex(z: Array, size: float) -> Array:
    """A simplex within 0..1 with a corner at z."""
    inward = np.where(z + size <= 1.0, size, -size)
    return np.vstack([z, z + np.diag(inward)])


def _examine(fitness: Callable[[Array], Array], z: Array) -> tuple[float, float, float]:
    """Projected gradient, smallest curvature of the free variables, and kink, by differences."""
    here = float(fitness(z[None])[0])
    low, high = z <= MARGIN, z >= 1.0 - MARGIN
    free = np.flatnonzero(~(low | high))
    # a step that stays within the bounds on either side
    step = np.minimum(STEP, np.minimum(z, 1.0 - z))
    gradient = np.zeros(z.size)
    kink = 0.0
    for i in range(z.size):
        unit = np.eye(z.size)[i]
        if i in free:
            h = step[i]
            after, before, after_2, before_2 = fitness(z + unit * np.array([[h], [-h], [h / 2], [-h / 2]]))
            # Richardson: the third derivative's share is removed
            gradient[i] = (4 * (after_2 - before_2) / h - (after - before) / (2 * h)) / 3
            # jump of the one-sided derivatives, extrapolated to a vanishing step: zero for a smooth function
            kink = max(
                kink, float(abs(2 * (after_2 + before_2 - 2 * here) / (h / 2) - (after + before - 2 * here) / h))
            )
        else:
            h = STEP if low[i] else -STEP
            near, far = fitness(z + unit * np.array([[h / 2], [h]]))
            slope = (4 * near - far - 3 * here) / h
            gradient[i] = min(slope, 0.0) if low[i] else max(slope, 0.0)
    curvature = float(np.linalg.eigvalsh(_hessian(fitness, z, free, step)).min()) if free.size else float("nan")
    return float(np.abs(gradient).max()), curvature, kink


def _hessian(fitness: Callable[[Array], Array], z: Array, free: npt.NDArray[np.intp], step: Array) -> Array:
    """Hessian over the free variables by central differences."""
    hessian = np.zeros((free.size, free.size))
    for a, i in enumerate(free):
        for b, j in enumerate(free[: a + 1]):
            u, w = np.eye(z.size)[i] * step[i] / 2, np.eye(z.size)[j] * step[j] / 2
            corners = fitness(np.array([z + u + w, z + u - w, z - u + w, z - u - w]))
            hessian[a, b] = hessian[b, a] = (corners @ [1.0, -1.0, -1.0, 1.0]) / (step[i] * step[j])
    return hessian
