"""Response of a coupled system with any springs and dashpots in its dampers, from runs with its masses held and moved.

With the transforms and gains of `optimisation.receptance`, springs k and dashpots c give

    s = -(p^2 M + p C + K + M G_as)^-1 M a0,    y = y0 + G_ys s

and standard deviations are those of the histories that belong to these transforms, as a co-simulation would state them.

End stops act contact by contact in time, see `optimisation.impacts`. (Equivalent springs by statistical linearisation
were ten times faster and, where stops are hit rarely, wrong by up to 17 % in the ratio of two designs, against 1 %.)
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from optimisation.impacts import FAR, Stops, with_impacts
from optimisation.receptance import LinearModel

Array = npt.NDArray[np.float64]
Complex = npt.NDArray[np.complexfloating[Any, Any]]

STOP = 5e5  # N/m and N s/m: default of the stops' stiffness and damping


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
        records = model.histories(_respond(model, *values))[0].T
        step = model.step * model.length / (2 * len(model.p))
        time: Array = model.start + step * np.arange(len(records), dtype=float)
        return time, records

    def _evaluate(self, candidates: npt.ArrayLike) -> tuple[Array, Array]:
        stiffness, damping, stops = self._split(candidates)
        count = len(self.channels)
        both: list[Any] = []
        for model in self.models:
            with np.errstate(invalid="ignore"):  # candidates of nan
                variance = model.histories(_respond(model, stiffness, damping, stops)).var(axis=-1)
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


def _respond(model: LinearModel, stiffness: Array, damping: Array, stops: Stops) -> Complex:
    """Transforms of channels and displacements, (n, C + D, F), of dampers (n, D); nan where one is negative."""
    count, p, mass = len(model.channels), model.p, model.masses
    own = mass[:, None] * p**2 + damping[..., None] * p + stiffness[..., None]  # (n, D, F)
    driven = np.moveaxis(mass[:, None] * model.gain[:, count:], 0, -1)  # (D, D, F)
    moved = _solve(own, driven, -mass[:, None] * model.base[:, count:].T)
    bad = np.any((stiffness < 0.0) | (damping < 0.0) | ~np.isfinite(stiffness + damping), axis=1)
    moved[bad] = np.nan
    for i in np.flatnonzero(~bad):
        limits = Stops(stops.stroke[i], stops.stiffness[i], stops.damping[i])
        moved[i] = with_impacts(model, moved[i], stiffness[i], damping[i], limits)
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
