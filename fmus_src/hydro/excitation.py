"""Excitation coefficients between the database's frequencies and headings.

Over heading: where the headings (with their images in the hull's planes of symmetry) go round the circle in even
steps, trigonometric sums that are exact at all of them; else linear interpolation between neighbours. Over frequency
the coefficients of these sums are cubic splines.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
import numpy.typing as npt
from scipy.interpolate import BSpline, make_interp_spline

from fmus_src.hydro.database import HydroDatabase
from fmus_src.hydro.headings import Headings

Array = npt.NDArray[np.float64]
Complex = npt.NDArray[np.complex128]

DOFS = ("surge", "sway", "heave", "roll", "pitch", "yaw")
SMALLEST = 2e-6  # of the excitation's maximum: terms that vanish by symmetry are left out


@dataclass(frozen=True)
class HeadingSum:
    """Excitation of one degree of freedom as a sum over functions of the heading.

    Attributes:
        terms: the functions: ("cos", m), ("sin", m) of m times the heading; or ("hat", j), one at heading j, zero at
            its neighbours and linear between.
        coefficients: shape (n, terms), N/m or N.
    """

    terms: tuple[tuple[str, int], ...]
    coefficients: Complex


def heading_sum(headings: Headings, dof: int) -> HeadingSum:
    """The sum of a degree of freedom (0 to 5); it has one term at least."""
    values = headings.excitation[:, :, dof]
    m = len(headings.angle)
    if not (headings.circle and headings.even):
        return HeadingSum(tuple(("hat", j) for j in range(m)), values)
    terms = [("cos", h) for h in range(m // 2 + 1)] + [("sin", h) for h in range(1, (m - 1) // 2 + 1)]
    basis = np.column_stack([getattr(np, function)(h * headings.angle) for function, h in terms])
    coefficients = np.asarray(np.linalg.lstsq(basis, values.T, rcond=None)[0].T)
    largest = np.abs(coefficients).max(axis=0)
    kept = np.flatnonzero(largest > SMALLEST * np.abs(values).max())
    kept = kept if len(kept) else np.array([0])
    return HeadingSum(tuple(terms[k] for k in kept), coefficients[:, kept])


def functions(terms: tuple[tuple[str, int], ...], headings: Headings, heading: Any) -> Any:
    """Values of a sum's functions at a heading in rad; symbolic, a column of shape (terms,)."""
    apply = {"cos": ca.cos, "sin": ca.sin}
    return ca.vertcat(*[_hat(headings, j, heading) if f == "hat" else apply[f](j * heading) for f, j in terms])


def control_points(database: HydroDatabase, coefficients: Complex) -> Complex:
    """Control points of the cubic splines over frequency of coefficients (n, terms), same shape."""
    return np.asarray(make_interp_spline(database.omega, coefficients, k=3).c)


def spline_basis(database: HydroDatabase, omega: Array) -> Any:
    """Values of the spline's basis functions (four are not zero) at frequencies in rad/s: sparse, (len(omega), n).

    Raises:
        ValueError: a frequency is outside the database's range.
    """
    low, high = database.omega[0], database.omega[-1]
    if np.min(omega) < low or np.max(omega) > high:
        raise ValueError(f"hydro: wave frequencies must be between {low:g} and {high:g} rad/s, the database's range")
    knots = make_interp_spline(database.omega, database.omega, k=3).t
    return BSpline.design_matrix(omega, knots, 3)


def at_frequency(database: HydroDatabase, name: str, coefficients: Complex, omega: Any) -> tuple[Any, Any]:
    """Real and imaginary parts of coefficients (n, terms) at one symbolic frequency, two columns of shape (terms,)."""
    columns = np.hstack([coefficients.real, coefficients.imag])
    spline = ca.interpolant(f"excitation_{name}", "bspline", [database.omega.tolist()], columns.ravel().tolist())
    result = spline(omega)
    terms = coefficients.shape[1]
    return result[:terms], result[terms:]


def _hat(headings: Headings, j: int, heading: Any) -> Any:
    """One at heading j and zero at its neighbours; symbolic."""
    angle, m = headings.angle, len(headings.angle)
    if m == 1:
        return ca.MX(1.0)
    distance = heading - angle[j]
    if headings.circle:
        distance -= 2.0 * ca.pi * ca.floor((distance + ca.pi) / (2.0 * ca.pi))
    before = np.mod(angle[j] - angle[j - 1], 2.0 * np.pi)
    after = np.mod(angle[(j + 1) % m] - angle[j], 2.0 * np.pi)
    return ca.fmax(0.0, ca.fmin(1.0 + distance / before, 1.0 - distance / after))
