"""Identification of the simplified model from free decays (Wang et al. 2022, section 4, eqs. 11-12).

Levenberg-Marquardt on the weighted squared errors of platform pitch and tower-top displacement, with exact derivatives;
and what the records can tell about the unknowns at all: singular values, standard errors, correlations.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

Array = npt.NDArray[np.float64]

CHANNELS = ("PtfmPitch", "TTDspFA")
LONGEST_SPACING = 0.25  # s: eight samples in a period of the tower's mode
SHORTEST = 30.0  # s: some three periods of pitch
WINDOWS = ((0.25, 1e-2), (1.0, 1e-8))  # share of the records, relative tolerance of cost and steps
# A direction of the unknowns whose effect is this much below the strongest one's: noise of one part in a thousand
# in the channels moves it by tens of per cent.
SINGULAR = 1e-3
CORRELATED = 25.0  # s, over which residuals are taken as correlated: two periods of pitch


class IdentificationError(RuntimeError):
    """The search did not end in a usable set."""


@dataclass(frozen=True)
class Unknown:
    """One unknown with the paper's figures (table 3), in `unit`."""

    name: str
    unit: str
    first_guess: float
    paper: float


UNKNOWNS = (
    Unknown("I_p", "kg.m2", 2.00e9, 4.42e9),
    Unknown("k_p", "N.m/rad", 1.50e9, 4.47e9),
    Unknown("d_p", "N.m.s/rad", 5.00e7, 1.34e8),
    Unknown("I_t", "kg.m2", 2.50e9, 1.07e10),
    Unknown("k_t", "N.m/rad", 1.00e10, 3.31e10),
    Unknown("d_t", "N.m.s/rad", 2.50e7, 3.87e7),
)


@dataclass(frozen=True, eq=False)
class Decay:
    """A record of a free decay, equally spaced in time, released at rest at its first sample.

    Attributes:
        label: for messages and tables.
        spacing: s.
        values: PtfmPitch in deg and TTDspFA in m, shape (samples, 2).
        settings: the simplified model's parameters for this record (dampers, initial angles), by name.

    Raises:
        ValueError: too short or too coarse a record, a value that is not finite, or a channel that does not move.
    """

    label: str
    spacing: float
    values: Array
    settings: Mapping[str, float]

    def __post_init__(self) -> None:
        length = self.spacing * (len(self.values) - 1)
        if length < SHORTEST:
            raise ValueError(f"{self.label}: a record of {length:g} s is too short; give at least {SHORTEST:g} s")
        if self.spacing > LONGEST_SPACING:
            raise ValueError(
                f"{self.label}: samples every {self.spacing:g} s are too coarse; give one at least"
                f" every {LONGEST_SPACING:g} s"
            )
        for channel, column in zip(CHANNELS, self.values.T, strict=True):
            if not np.all(np.isfinite(column)):
                at = self.spacing * int(np.argmin(np.isfinite(column)))
                raise ValueError(f"{self.label}: {channel} {at:g} s after the first sample is not finite")
            if not np.ptp(column) > 0.0:
                raise ValueError(f"{self.label}: {channel} does not move; give a record of a free decay")

    @property
    def scale(self) -> Array:
        """Standard deviation of each channel, by which residuals are divided: eq. 12's weights, shape (2,)."""
        return np.asarray(self.values.std(axis=0))

    def first(self, share: float) -> Decay:
        """The first part of the record, not below the shortest that can be used."""
        count = max(int(share * len(self.values)), int(np.ceil(SHORTEST / self.spacing)) + 1)
        return Decay(self.label, self.spacing, self.values[:count], self.settings)


# (decay, {unknown: value}, with derivatives) -> channels (samples, 2), derivatives (samples, 2, 6) to the unknowns
Model = Callable[[Decay, Mapping[str, float], bool], tuple[Array, Array]]


@dataclass(frozen=True)
class Fit:
    """How one set of values reproduces one record.

    Attributes:
        residual_rms: root mean square error of each channel, in its unit.
        r2: share of each channel's variance that is explained.
        model: the channels as computed, shape (samples, 2).
        fitted: whether the record took part in the identification.
    """

    decay: Decay
    residual_rms: dict[str, float]
    r2: dict[str, float]
    model: Array
    fitted: bool


@dataclass(frozen=True)
class Identification:
    """Result of `identify`; arrays are in the order of `UNKNOWNS`.

    Attributes:
        values: identified, by name.
        standard_errors: relative, by name; the residuals' correlation in time is accounted for.
        correlation: of the estimates' logarithms, shape (6, 6).
        singular_values: of the scaled Jacobian (channels over their standard deviations, by the root of the number of
            samples; unknowns by their logarithms), descending, shape (6,).
        weak_direction: unit vector of logarithms that changes the records least, shape (6,).
        cost: mean squared weighted error; evaluations: simulations of all records.
    """

    values: dict[str, float]
    standard_errors: dict[str, float]
    correlation: Array
    singular_values: Array
    weak_direction: Array
    cost: float
    evaluations: int

    @property
    def identifiable(self) -> bool:
        """Whether each direction of the unknowns is fixed by the records."""
        return bool(self.singular_values[-1] > SINGULAR * self.singular_values[0])

    @property
    def weakness(self) -> str:
        """The weak direction in words."""
        names = [u.name for u in UNKNOWNS]
        largest = np.abs(self.weak_direction).max()
        moved = {n: d for n, d in zip(names, self.weak_direction, strict=True) if abs(d) > 0.3 * largest}
        together = len({d > 0.0 for d in moved.values()}) == 1
        if len(moved) == len(names) and together:
            what = "all six together: their common scale"
        elif together:
            what = " and ".join(moved) + " together" * (len(moved) > 1)
        else:
            sign = np.sign(next(iter(moved.values())))
            what = ", ".join(f"{n} {'up' if sign * d > 0.0 else 'down'}" for n, d in moved.items())
        fixed = "is fixed" if self.identifiable else "is not fixed"
        weakest = self.singular_values[-1] / self.singular_values[0]
        return f"{what} {fixed} by these records (singular value {weakest:.1e} of the largest)"


def identify(
    model: Model, decays: Sequence[Decay], *, start: Mapping[str, float] | None = None,
    progress: Callable[[int, float], None] | None = None,
) -> Identification:  # fmt: skip
    """Fit the six unknowns to one or more records.

    The unknowns are the logarithms of value over start, so that values stay positive and are scaled alike. The fit is
    made on ever longer beginnings of the records: a frequency that is a little off is lost by a
    period at the end of a long record, which makes local minima.

    Args:
        start: first guesses (default: the paper's).
        progress: called after each evaluation with its number and the mean squared weighted error.

    Raises:
        IdentificationError: the model diverges at the first guesses, or the search runs away or does not converge.
    """
    names = [u.name for u in UNKNOWNS]
    guess = np.array([(start or {}).get(u.name, u.first_guess) for u in UNKNOWNS])
    count, z = 0, np.zeros(len(names))

    def values(z: Array) -> dict[str, float]:
        return dict(zip(names, (guess * np.exp(z)).tolist(), strict=True))

    def residuals(z: Array, parts: Sequence[Decay]) -> Array:
        nonlocal count
        count += 1
        try:
            r = np.concatenate([_weighted(model(d, values(z), False)[0] - d.values, d) for d in parts])
        except (FloatingPointError, OverflowError):
            r = np.full(sum(d.values.size for d in parts), np.inf)
        if progress is not None:
            progress(count, float(r @ r))
        # a step that diverges is one that Levenberg-Marquardt takes back, provided that it is given a number
        return np.nan_to_num(np.clip(r, -1e6, 1e6), nan=1e6)

    def slopes(z: Array, parts: Sequence[Decay]) -> Array:
        return np.vstack([_scaled_jacobian(model, d, values(z)) for d in parts])

    for share, tolerance in WINDOWS:
        parts = [d.first(share) for d in decays]
        if np.abs(residuals(z, parts)).max() >= 1e6:
            at = ", ".join(f"{n} = {v:.3g}" for n, v in values(z).items())
            raise IdentificationError(f"{parts[0].label}: the simplified model diverges from {at}; start elsewhere")
        found = least_squares(
            residuals, z, slopes, args=(parts,), method="lm", xtol=tolerance, ftol=tolerance, gtol=1e-14, max_nfev=100
        )
        z = found.x
        if np.abs(z).max() > np.log(1e3):
            name = names[int(np.argmax(np.abs(z)))]
            raise IdentificationError(
                f"{parts[0].label}: the search runs away ({name} = {values(z)[name]:.3g});"
                " is the record a decay of this turbine, and with this damper?"
            )
    if found.status == 0:
        raise IdentificationError(f"{decays[0].label}: no convergence within {found.nfev} evaluations; start elsewhere")
    return _assess(values(z), [_scaled_jacobian(model, d, values(z)) for d in decays],
                   [_weighted(model(d, values(z), False)[0] - d.values, d) for d in decays], decays, count)  # fmt: skip


def assess_fit(model: Model, decay: Decay, values: Mapping[str, float], *, fitted: bool) -> Fit:
    """How well a set of values reproduces a record; R2 as `fowt verify` takes it."""
    y = model(decay, values, False)[0]
    error = y - decay.values
    about = decay.values - decay.values.mean(axis=0)
    rms, r2 = np.sqrt((error**2).mean(axis=0)), 1.0 - (error**2).sum(axis=0) / (about**2).sum(axis=0)
    return Fit(
        decay,
        dict(zip(CHANNELS, rms.tolist(), strict=True)),
        dict(zip(CHANNELS, r2.tolist(), strict=True)),
        y,
        fitted,
    )


def _weighted(error: Array, decay: Decay) -> Array:
    """Residuals of eq. 12, (2 * samples,): divided so that their sum of squares is a mean over samples."""
    return np.asarray((error / decay.scale / np.sqrt(len(error))).ravel())


def _scaled_jacobian(model: Model, decay: Decay, values: Mapping[str, float]) -> Array:
    """Derivatives of the weighted residuals to the logarithms of the unknowns, shape (2 * samples, 6)."""
    slopes = model(decay, values, True)[1] * np.array([values[u.name] for u in UNKNOWNS])
    scale = decay.scale[None, :, None] * np.sqrt(len(slopes))
    return np.asarray((slopes / scale).reshape(-1, len(UNKNOWNS)))


def _assess(
    values: dict[str, float],
    jacobians: Sequence[Array],
    residuals: Sequence[Array],
    decays: Sequence[Decay],
    count: int,
) -> Identification:
    """Identifiability at the solution: covariance A^-1 M A^-1 with A = J'J and M the residuals' correlated scores."""
    names = [u.name for u in UNKNOWNS]
    _, singular, v = np.linalg.svd(np.vstack(jacobians), full_matrices=False)
    inverse = (v.T / singular**2) @ v
    middle = sum(_scores(j, r, d.spacing) for j, r, d in zip(jacobians, residuals, decays, strict=True))
    covariance = inverse @ middle @ inverse
    sigma = np.sqrt(np.diag(covariance))
    return Identification(
        values=values,
        standard_errors=dict(zip(names, sigma.tolist(), strict=True)),
        correlation=covariance / np.outer(sigma, sigma) if np.all(sigma > 0.0) else np.eye(len(names)),
        singular_values=singular,
        weak_direction=v[-1],
        cost=float(sum(r @ r for r in residuals)),
        evaluations=count,
    )


def _scores(jacobian: Array, residual: Array, spacing: float) -> Array:
    """Covariance of J'r with residuals correlated over some time: Newey and West (1987), Bartlett's weights."""
    scores = (jacobian * residual[:, None]).reshape(-1, len(CHANNELS), len(UNKNOWNS)).sum(axis=1)
    lags = min(int(CORRELATED / spacing), len(scores) // 4)
    size = 2 * len(scores)
    spectrum = np.fft.rfft(scores, n=size, axis=0)
    # autocovariances at all lags at once: the transform of the cross-spectra
    covariances = np.fft.irfft(spectrum[:, :, None] * spectrum[:, None, :].conj(), n=size, axis=0)[: lags + 1]
    weights = 1.0 - np.arange(lags + 1) / (lags + 1)
    total = np.einsum("l,lij->ij", weights, covariances)
    return np.asarray(total + total.T - covariances[0])
