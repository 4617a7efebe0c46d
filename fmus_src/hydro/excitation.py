"""Excitation coefficients between the database's frequencies and headings.

Over heading they are trigonometric sums with the symmetries of the barge, exact at the seven headings of the first
quadrant: surge and pitch in cos((2m+1) b), heave in cos(2m b), sway and roll in sin((2m+1) b), yaw in sin(2m b). Over
frequency the coefficients of these sums are cubic splines.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import numpy.typing as npt
from scipy.interpolate import BSpline, make_interp_spline

from fmus_src.hydro.database import HydroDatabase

Array = npt.NDArray[np.float64]
Complex = npt.NDArray[np.complex128]

DOFS = ("surge", "sway", "heave", "roll", "pitch", "yaw")
# Per degree of freedom: sine or cosine, first multiple of the heading (it rises by two).
HARMONICS = (("cos", 1), ("sin", 1), ("cos", 0), ("sin", 1), ("cos", 1), ("sin", 2))


def harmonics(dof: int, heading: Any, headings: int) -> Any:
    """Values of the sum's functions at a heading in rad; symbolic, a column of shape (terms,)."""
    function, multiples = _terms(dof, headings)
    apply = ca.cos if function == "cos" else ca.sin
    return ca.vertcat(*[apply(m * heading) for m in multiples])


def coefficients(database: HydroDatabase, dof: int) -> Complex:
    """Coefficients of the sum at the database's frequencies, N or N m per metre, shape (n, terms)."""
    function, multiples = _terms(dof, len(database.heading))
    angles = np.multiply.outer(database.heading, multiples)
    basis = np.cos(angles) if function == "cos" else np.sin(angles)
    return np.asarray(np.linalg.lstsq(basis, database.excitation[:, :, dof].T, rcond=None)[0].T)


def control_points(database: HydroDatabase, dof: int) -> Complex:
    """Control points of the cubic splines over frequency of the coefficients, shape (n, terms)."""
    return np.asarray(make_interp_spline(database.omega, coefficients(database, dof), k=3).c)


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


def at_frequency(database: HydroDatabase, dof: int, omega: Any) -> tuple[Any, Any]:
    """Real and imaginary parts of the coefficients at one symbolic frequency, two columns of shape (terms,)."""
    values = coefficients(database, dof)
    columns = np.hstack([values.real, values.imag])
    spline = ca.interpolant(f"excitation_{DOFS[dof]}", "bspline", [database.omega.tolist()], columns.ravel().tolist())
    result = spline(omega)
    return result[: values.shape[1]], result[values.shape[1] :]


def _terms(dof: int, headings: int) -> tuple[str, list[int]]:
    function, first = HARMONICS[dof]
    # A term that vanishes at 0 or at 90 deg leaves that heading to no unknown.
    counts = {("cos", 0): headings, ("cos", 1): headings - 1, ("sin", 1): headings - 1, ("sin", 2): headings - 2}
    return function, [first + 2 * m for m in range(counts[function, first])]
