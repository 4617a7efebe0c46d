"""Polars of blade sections and the constants of their unsteady model, published or found from the polar."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline

from fmus_src.aero import dynamic_stall

Array = npt.NDArray[np.float64]

#: Columns of the section tables.
LIFT, DRAG, MOMENT, LIFT_SLOPE = range(4)
# Angle of attack (rad) up to which the unsteady constants are looked for.
_RANGE = math.radians(20.0)
# Half-width of the smoothing of the normal force's slope, rad; share of the slope down to which flow is attached;
# separation factor at which the leading edge separates.
_SMOOTHING, _ATTACHED, _CRITICAL = math.radians(2.0), 0.9, 0.7


@dataclass(frozen=True)
class StallConstants:
    """Constants of the unsteady model of a section; defaults as in the source of `dynamic_stall`.

    Attributes:
        alpha_0: angle of no lift, rad. slope: of the normal force in attached flow, 1/rad. drag_0: drag at no lift.
        stall, negative_stall: normal force at which the leading edge separates.
        T_p, T_f, T_v, T_vl: dimensionless times of pressure lag, separation, vortex decay and vortex travel.
        strouhal: of vortex shedding. A1, A2, b1, b2: of the circulatory indicial response.
        filter_cut_off: reduced frequency of the low-pass on the angle of attack.
        fade_from, cut_out: angles of attack between which the model fades into the static coefficients, rad.
    """

    alpha_0: float
    slope: float
    drag_0: float
    stall: float
    negative_stall: float
    T_p: float = dynamic_stall.T_P
    T_f: float = dynamic_stall.T_F
    T_v: float = 2.0 * dynamic_stall.T_F
    T_vl: float = dynamic_stall.T_VL
    strouhal: float = dynamic_stall.STROUHAL
    A1: float = dynamic_stall.A1
    A2: float = dynamic_stall.A2
    b1: float = dynamic_stall.B1
    b2: float = dynamic_stall.B2
    filter_cut_off: float = dynamic_stall.FILTER_CUT_OFF
    fade_from: float = float(dynamic_stall.FADE[0])
    cut_out: float = float(dynamic_stall.FADE[1])


#: Harmless ones, for sections without an unsteady model.
CYLINDER = StallConstants(0.0, 2.0 * math.pi, 0.0, 1.0, -1.0)


@dataclass(frozen=True, eq=False)
class Polar:
    """Static coefficients of a section.

    Attributes:
        name: of the section.
        alpha: angle of attack, rad (n,), rising from -pi to pi.
        lift, drag, moment: coefficients (n,); moment about the quarter chord, nose up.
        unsteady: constants of the unsteady model; None: the coefficients are always the static ones.
        spline: whether a natural cubic spline lies between the points, not straight lines.
    """

    name: str
    alpha: Array
    lift: Array
    drag: Array
    moment: Array
    unsteady: StallConstants | None = None
    spline: bool = False

    def at(self, alpha: Array) -> Array:
        """Columns LIFT, DRAG, MOMENT at angles of attack (m,), rad: (m, 3)."""
        columns = np.column_stack([self.lift, self.drag, self.moment])
        if self.spline:
            return np.asarray(CubicSpline(self.alpha, columns, bc_type="natural")(alpha))
        return np.column_stack([np.interp(alpha, self.alpha, column) for column in columns.T])


def tabulated(polars: tuple[Polar, ...], points_per_degree: int = 2) -> tuple[Array, float, float]:
    """Coefficients on a uniform grid of angles of attack from -180 to 180 deg.

    Returns:
        data (sections, points, 4) with columns LIFT, DRAG, MOMENT, LIFT_SLOPE (1/rad); first angle and spacing, rad.
    """
    alpha = np.radians(np.linspace(-180.0, 180.0, 360 * points_per_degree + 1))
    spacing = math.radians(1.0 / points_per_degree)
    tables = [p.at(alpha) for p in polars]
    data = np.array([np.column_stack([t, np.gradient(t[:, LIFT], spacing)]) for t in tables])
    return data, -math.pi, spacing


def blended(low: Polar, high: Polar, weight: float) -> Polar:
    """Between two polars of a section: coefficients and constants linear in `weight`, 0 to 1."""
    angles = np.union1d(low.alpha, high.alpha)
    lift, drag, moment = ((1.0 - weight) * low.at(angles) + weight * high.at(angles)).T
    a, b = low.unsteady, high.unsteady
    mixed = None
    if a is not None and b is not None:
        values = {f.name: (getattr(a, f.name), getattr(b, f.name)) for f in fields(StallConstants)}
        mixed = StallConstants(**{name: (1.0 - weight) * x + weight * y for name, (x, y) in values.items()})
    return replace(low, alpha=angles, lift=lift, drag=drag, moment=moment, unsteady=mixed)


def is_constant(polar: Polar) -> bool:
    """Whether the coefficients do not depend on the angle of attack (a cylinder)."""
    return all(np.ptp(column) < 1e-9 for column in (polar.lift, polar.drag, polar.moment))


def constants_of_polar(polar: Polar, given: dict[str, float]) -> StallConstants | None:
    """Constants of the unsteady model, as AeroDyn 15 finds those that a file leaves out (`AirfoilInfo`).

    Flow counts as attached from the least drag on, both ways, while the slope of the normal force, smoothed over
    2 deg, keeps 90 % of its largest value; beyond, the line of attached flow and the polar give Kirchhoff's separation
    factor f, and the leading edge separates where f falls to 0.7.

    Args:
        given: those of `StallConstants` that are known.

    Returns:
        None if there is no attached flow: the coefficients are constant, or lift falls with the angle of attack.
    """
    near = np.abs(polar.alpha) <= _RANGE
    if is_constant(polar) or near.sum() < 4:
        return None
    alpha = polar.alpha
    least = int(np.flatnonzero(near)[np.argmin(polar.drag[near])])
    drag_0 = given.get("drag_0", float(polar.drag[least]))
    normal = polar.lift * np.cos(alpha) + (polar.drag - drag_0) * np.sin(alpha)
    middle, slope = 0.5 * (alpha[1:] + alpha[:-1]), _smoothed_slope(alpha, normal)
    inside = np.abs(middle) <= _RANGE
    steepest = float(slope[inside].max())
    if given.get("slope", steepest) <= 0.0:
        return None
    upper, lower = (_end_of_attached_flow(alpha, middle, slope, least, way) for way in (1, -1))
    lift_slope = float((np.diff(polar.lift) / np.diff(alpha))[inside].max())
    centre = 0.5 * (lower + upper)
    alpha_0 = centre - float(np.interp(centre, alpha, polar.lift)) / lift_slope if lift_slope > 0.0 else 0.0
    found = {
        "alpha_0": alpha_0, "slope": steepest, "drag_0": drag_0,
        "stall": _critical(alpha, normal, upper, lower, 1),
        "negative_stall": _critical(alpha, normal, upper, lower, -1),
    }  # fmt: skip
    return StallConstants(**(found | given))


def _smoothed_slope(alpha: Array, normal: Array) -> Array:
    """Slope of the normal force between the points, smoothed by a triweight kernel, 1/rad (n - 1,)."""
    raw, middle = np.diff(normal) / np.diff(alpha), 0.5 * (alpha[1:] + alpha[:-1])
    weight = np.clip(1.0 - ((middle[:, None] - middle) / _SMOOTHING) ** 2, 0.0, None) ** 3
    return np.asarray(weight @ raw / weight.sum(axis=1))


def _end_of_attached_flow(alpha: Array, middle: Array, slope: Array, least: int, way: int) -> float:
    """Angle of attack, upwards (way 1) or downwards (-1) from that of least drag, up to which flow is attached."""
    end, steepest = float(alpha[least]), float(np.interp(alpha[least], middle, slope))
    i = least if way > 0 else least - 1
    while 0 <= i < middle.size and abs(middle[i]) <= _RANGE:
        steepest = max(steepest, float(slope[i]))
        if slope[i] < _ATTACHED * steepest:
            break
        end, i = float(middle[i]), i + way
    return end


def _critical(alpha: Array, normal: Array, upper: float, lower: float, way: int) -> float:
    """Normal force where the separation factor falls to 0.7 above `upper` (way 1) or below `lower` (-1)."""
    end = upper if way > 0 else lower
    at = np.interp([lower, upper], alpha, normal)
    start = int(np.argmin(np.abs(alpha - end)))
    inner = min(max(start - way, 0), alpha.size - 1)
    rate = (normal[start] - normal[inner]) / (alpha[start] - alpha[inner]) if inner != start else 0.0
    beyond = alpha[alpha > end] if way > 0 else alpha[alpha < end][::-1]
    attached = np.interp(end, alpha, normal) + max(rate, 1e-6) * (beyond - end) - at.mean()
    ratio = (np.interp(beyond, alpha, normal) - at.mean()) / np.where(np.abs(attached) < 1e-9, 1e-9, attached)
    f = np.minimum((2.0 * np.sqrt(np.maximum(ratio, 0.25)) - 1.0) ** 2, 1.0)
    below = np.flatnonzero(f < _CRITICAL)
    if below.size == 0:
        return float(normal.max() if way > 0 else normal.min())
    i = int(below[0])
    first, f_first = (end, 1.0) if i == 0 else (float(beyond[i - 1]), float(f[i - 1]))
    share = (f_first - _CRITICAL) / (f_first - float(f[i]))
    return float(np.interp(first + share * (float(beyond[i]) - first), alpha, normal))
