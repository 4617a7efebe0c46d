"""Response of a coupled system with any springs and dashpots in its dampers, from runs with its masses held and moved.

With the transforms and gains of `optimisation.receptance`, springs k and dashpots c give

    s = -(p^2 M + p C + K + M G_as)^-1 M a0,    y = y0 + G_ys s

and standard deviations are those of the histories that belong to these transforms, as a co-simulation would state them.

End stops act as an equivalent spring and dashpot of each damper (statistical linearisation: Roberts and Spanos, Random
Vibration and Statistical Linearization, 1990, ch. 4-5): with Gaussian displacement s (mean mu) and velocity v, the
force f(s, v) is replaced by k_eq (s - mu) + c_eq v + E[f] of least mean square error,

    k_eq = E[(s - mu) f] / sigma_s^2,    c_eq = E[v f] / sigma_v^2.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.special import ndtr

from optimisation.receptance import LinearModel

Array = npt.NDArray[np.float64]
Complex = npt.NDArray[np.complexfloating[Any, Any]]

STEPS = 60  # of the iteration for the stops
RELAXATION = 0.25  # the stops' stiffness goes with a power of 4 or so of the stroke's deviation
STROKE_BAND = 0.25  # Hz: of the motion that the stops see
SETTLED = 0.05  # relative error of the stops' stiffness and damping; of the response it is a hundredth of that
STOP = 5e5  # N/m and N s/m: default of the stops' stiffness and damping
FAR = 1e9  # m: stroke without stops


@dataclass(frozen=True)
class Stops:
    """End stops of one or many dampers: travel, m, stiffness, N/m, and damping while moving out, N s/m."""

    stroke: Array
    stiffness: Array
    damping: Array


def linearised_stops(stops: Stops, mean: Array, displacement: Array, velocity: Array) -> tuple[Array, Array, Array]:
    """Equivalent stiffness, damping and mean force of end stops (eq. 6 of Wang et al. 2022) in Gaussian motion.

    Args:
        mean: of the displacement, m. displacement, velocity: standard deviations, m and m/s.
    """
    sigma = np.maximum(displacement, 1e-9)
    over, under = (stops.stroke - mean) / sigma, (stops.stroke + mean) / sigma
    beyond_over, beyond_under = ndtr(-over), ndtr(-under)
    density_over, density_under = _density(over), _density(under)
    outward = velocity / np.sqrt(2.0 * np.pi)  # E[max(v, 0)]
    beyond = beyond_over + beyond_under
    stiffness = stops.stiffness * beyond + stops.damping * outward * (density_over + density_under) / sigma
    damping = 0.5 * stops.damping * beyond
    spring = sigma * ((density_over - over * beyond_over) - (density_under - under * beyond_under))
    force = stops.stiffness * spring + stops.damping * outward * (beyond_over - beyond_under)
    return stiffness, damping, force


def _density(x: Array) -> Array:
    result: Array = np.exp(-0.5 * x**2) / np.sqrt(2.0 * np.pi)
    return result


class SpectralResponse:
    """Standard deviations of channels and strokes for springs and dashpots, in every scenario.

    Example:
        >>> response = SpectralResponse(models, ["nacelle_damper.k", "nacelle_damper.c"], {})      # doctest: +SKIP
        >>> response(np.array([[7653.0, 4013.0]]))                                                 # doctest: +SKIP

    Args:
        models: one for each scenario, of the same channels and dampers.
        variables: DAMPER.k, DAMPER.c (N/m, N s/m), DAMPER.stroke (m), in the order of a candidate's values.
        fixed: values of others. Without a DAMPER.stroke there are no stops; DAMPER.k_stop, DAMPER.c_stop: 5e5 if not
            given. DAMPER.m may be given, but must be the models'; further names are passed over.

    Raises:
        ValueError: no model, models that do not fit each other, or a name that means nothing here or has no value.
    """

    def __init__(self, models: Sequence[LinearModel], variables: Sequence[str], fixed: Mapping[str, float]) -> None:
        if not models:
            raise ValueError("no linear models; make some with 'fowt linearise'")
        first = models[0]
        for model in models:
            same = [(d.name, d.mass) for d in model.dampers] == [(d.name, d.mass) for d in first.dampers]
            if model.channels != first.channels or not same:
                raise ValueError(
                    f"the linear models '{first.label}' and '{model.label}' differ in channels, dampers or masses: "
                    "make them with the same options"
                )
        self.models = tuple(models)
        self.channels = first.channels
        self.labels = tuple(m.label for m in models)
        self.variables = tuple(variables)
        dampers = first.dampers
        self._names = tuple(f"{d.name}.{q}" for d in dampers for q in ("k", "c", "stroke", "k_stop", "c_stop"))
        start = np.array([[np.nan, np.nan, FAR, STOP, STOP] for _ in dampers])
        masses = {f"{d.name}.m": d.mass for d in dampers}
        for name in variables:
            if name not in self._names:
                raise ValueError(f"variable '{name}' is fixed in a linear model; it has {', '.join(self._names)}")
        known = dict(zip(self._names, start.ravel().tolist(), strict=True))
        for name, value in fixed.items():
            if name in masses and abs(value - masses[name]) > 1e-9 * masses[name]:
                raise ValueError(
                    f"{name} = {value:g} kg, but the linear models were made with {masses[name]:g} kg: make them anew"
                )
            if name in known:
                known[name] = value
        self._start = np.array([known[n] for n in self._names])
        for name in self._names:
            if not np.isfinite(known[name]) and name not in variables:
                raise ValueError(f"{name} is neither a variable nor given: give its value")
        self._columns = [self._names.index(n) for n in variables]

    def __call__(self, candidates: npt.ArrayLike) -> Array:
        """Standard deviations of the channels, (n, scenarios, C), of candidates (n, variables); nan where it fails."""
        return self._evaluate(candidates)[0]

    def strokes(self, candidates: npt.ArrayLike) -> Array:
        """Standard deviations of the dampers' displacements, m, (n, scenarios, D)."""
        return self._evaluate(candidates)[1]

    def histories(self, candidate: npt.ArrayLike, scenario: int = 0) -> tuple[Array, Array]:
        """Time, s, and histories of channels and displacements of one candidate, (n,) and (n, C + D)."""
        model = self.models[scenario]
        values = self._split(np.atleast_2d(np.asarray(candidate, dtype=float)))
        records = model.histories(_respond(model, *_with_stops(model, *values), channels=True))[0].T
        step = model.step * model.length / (2 * len(model.p))
        time: Array = model.start + step * np.arange(len(records), dtype=float)
        return time, records

    def _evaluate(self, candidates: npt.ArrayLike) -> tuple[Array, Array]:
        values = self._split(candidates)
        count = len(self.channels)
        both: list[Any] = []
        for model in self.models:
            settled = _with_stops(model, *values)
            with np.errstate(invalid="ignore"):  # candidates of nan
                variance = model.histories(_respond(model, *settled, channels=True)).var(axis=-1)
            variance[:, :count] += model.rest
            both.append(np.sqrt(variance))
        deviations: Any = np.stack(both, axis=1)
        return deviations[:, :, :count], deviations[:, :, count:]

    def _split(self, candidates: npt.ArrayLike) -> tuple[Array, Array, Stops]:
        values = np.asarray(candidates, dtype=float)
        if values.ndim != 2 or values.shape[1] != len(self.variables):
            raise ValueError(f"candidates have shape {values.shape}; expected (n, {len(self.variables)})")
        full = np.tile(self._start, (len(values), 1))
        full[:, self._columns] = values
        full = full.reshape(len(values), len(self.models[0].dampers), 5)
        return full[:, :, 0], full[:, :, 1], Stops(full[:, :, 2], full[:, :, 3], full[:, :, 4])


def _respond(model: LinearModel, stiffness: Array, damping: Array, mean: Array, *, channels: bool) -> Complex:
    """Transforms of channels (if asked for) and displacements, (n, C + D, F).

    Args:
        stiffness, damping: (n, D); mean: stiffness against the mean displacement, (n, D), taken at frequency 0.
    """
    count, p, mass = len(model.channels), model.p, model.masses
    own = mass[:, None] * p**2 + damping[..., None] * p + stiffness[..., None]  # (n, D, F)
    own[..., 0] += mean - stiffness
    driven = np.moveaxis(mass[:, None] * model.gain[:, count:], 0, -1)  # (D, D, F)
    moved = _solve(own, driven, -mass[:, None] * model.base[:, count:].T)
    if not channels:
        return moved
    carried = np.einsum("fcd,ndf->ncf", model.gain[:, :count], moved, optimize=True)
    return np.concatenate([model.base[:, :count].T + carried, moved], axis=1)


def _solve(own: Complex, driven: Complex, right: Complex) -> Complex:
    """(diag(own) + driven) x = right at each frequency: (n, D, F), (D, D, F), (D, F); written out for D of 1 and 2."""
    if len(right) == 1:
        single: Complex = right / (own + driven[0])
        return single
    if len(right) == 2:
        a, d = own[:, 0] + driven[0, 0], own[:, 1] + driven[1, 1]
        b, c = driven[0, 1], driven[1, 0]
        determinant = a * d - b * c
        return np.stack([(d * right[0] - b * right[1]) / determinant, (a * right[1] - c * right[0]) / determinant], 1)
    matrix = np.moveaxis(own, -1, 1)[..., None] * np.eye(len(right)) + np.moveaxis(driven, -1, 0)
    solved: Complex = np.linalg.solve(matrix, np.broadcast_to(right.T[..., None], (*matrix.shape[:-1], 1)))
    return np.moveaxis(solved[..., 0], 1, -1)


def _with_stops(model: LinearModel, stiffness: Array, damping: Array, stops: Stops) -> tuple[Array, Array, Array]:
    """Stiffness, damping and stiffness against the mean with the stops' own added, each (n, D); nan if negative."""
    bad = np.any((stiffness < 0.0) | (damping < 0.0) | ~np.isfinite(stiffness + damping), axis=1)
    extra = np.zeros((3, *stiffness.shape))  # k_eq, c_eq, and of the mean
    open_ = np.flatnonzero(~bad)
    slow = _lowest(model)
    for _ in range(STEPS):
        if not len(open_):
            break
        k_eq, c_eq, k_mean = extra[:, open_]
        k, c = stiffness[open_], damping[open_]
        moved = _respond(slow, k + k_eq, c + c_eq, k + k_mean, channels=False)
        history, velocity = slow.histories(moved), slow.histories(moved * slow.p)
        mean, sigma = history.mean(axis=-1), history.std(axis=-1)
        limits = Stops(*(q[open_] for q in (stops.stroke, stops.stiffness, stops.damping)))
        new_k, new_c, force = linearised_stops(limits, mean, sigma, velocity.std(axis=-1))
        against = np.maximum(force / np.where(np.abs(mean) > 1e-9, mean, np.inf), 0.0)
        new = np.stack([new_k, new_c, against])
        now, wanted = np.log1p(extra[:, open_]), np.log1p(new)
        extra[:, open_] = np.expm1(now + RELAXATION * (wanted - now))
        open_ = open_[np.any(np.abs(wanted - now) > SETTLED, axis=(0, 2))]
    stiffness = np.where(bad[:, None], np.nan, stiffness)
    return stiffness + extra[0], damping + extra[1], stiffness + extra[2]


def _lowest(model: LinearModel) -> LinearModel:
    """The model below the frequencies that move its masses far, in single precision: it is for the iteration only."""
    kept = max(16, int(np.count_nonzero(model.frequencies <= STROKE_BAND)))
    p, base, gain = (q[:kept].astype(np.complex64) for q in (model.p, model.base, model.gain))
    return replace(model, p=p, base=base, gain=gain)
