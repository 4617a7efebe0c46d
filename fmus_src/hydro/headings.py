"""The excitation over heading: what the symmetry of the hull adds to a database's headings, and what they cover."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fmus_src.hydro.database import HydroDatabase, couplings

Array = npt.NDArray[np.float64]
Complex = npt.NDArray[np.complex128]

LARGEST_GAP = np.radians(46.0)  # between neighbouring headings
TOUCH = np.radians(0.01)  # headings closer than this are one
# Degrees of freedom that change sign in the mirror, and the heading's image.
PORT = np.array([1.0, -1.0, 1.0, -1.0, 1.0, -1.0])  # x-z plane: heading b -> -b
AFT = np.array([-1.0, 1.0, 1.0, 1.0, -1.0, -1.0])  # y-z plane: b -> pi - b


@dataclass(frozen=True)
class Headings:
    """Excitation at the headings of a database and at their images.

    Attributes:
        angle: rad, shape (m,), rising: from -pi to pi if `circle`, else the range that is covered.
        excitation: X(w, b), shape (n, m, 6), N/m and N.
        circle: every heading is covered, no gap above 45 deg.
        even: all gaps are equal (of a circle).
        note: what was mirrored or left out.
    """

    angle: Array
    excitation: Complex
    circle: bool
    even: bool
    note: str


def covered(database: HydroDatabase) -> Headings:
    """The headings that a database covers, about heading 0 (or the nearest to it).

    Where its own do not close the circle, they are mirrored at the planes in which the hull is symmetric: added mass
    and damping show it by couplings that vanish. Beyond a gap of 45 deg a heading is not covered.

    Raises:
        ValueError: a heading (0 and 360 deg, say) stands twice with different excitation.
    """
    angle, excitation = _united(database.name, database.heading, database.excitation)
    planes = []
    for plane, sign in (("x-z", PORT), ("y-z", AFT)):
        if _gaps(angle).max() > LARGEST_GAP and _symmetric(database, sign):
            image = -angle if plane == "x-z" else np.pi - angle
            both = np.r_[angle, image], np.concatenate([excitation, excitation * sign], axis=1)
            if (result := _united_or_none(*both)) is not None:
                angle, excitation = result
                planes.append(plane)
    note = f"headings mirrored at the planes {', '.join(planes)}" if planes else "headings as in the file"
    gaps = _gaps(angle)
    if gaps.max() <= LARGEST_GAP:
        return Headings(angle, excitation, True, bool(np.ptp(gaps) < TOUCH), note)
    # The run of neighbours around the heading nearest to zero.
    first = last = int(np.argmin(np.abs(angle)))
    while first > 0 and angle[first] - angle[first - 1] <= LARGEST_GAP:
        first -= 1
    while last < len(angle) - 1 and angle[last + 1] - angle[last] <= LARGEST_GAP:
        last += 1
    kept = slice(first, last + 1)
    low, high = np.degrees(angle[[first, last]])
    note += f"; covered: {low:g} to {high:g} deg" if first < last else f"; covered: {low:g} deg only"
    return Headings(angle[kept], excitation[:, kept], False, False, note)


def _united(name: str, angle: Array, excitation: Complex) -> tuple[Array, Complex]:
    result = _united_or_none(angle, excitation)
    if result is None:
        raise ValueError(f"hydro: {name}: a heading stands twice (as 0 and 360 deg, say) with different excitation")
    return result


def _united_or_none(angle: Array, excitation: Complex) -> tuple[Array, Complex] | None:
    """Headings in (-pi, pi], rising, each once; None if two that are one differ by more than 1 %."""
    turned = angle - 2.0 * np.pi * np.ceil((angle - np.pi - TOUCH / 2.0) / (2.0 * np.pi))
    order = np.argsort(turned, kind="stable")
    scale = np.maximum(np.abs(excitation).max(axis=(0, 1)), 1e-30)
    kept: list[int] = []
    for n in order:
        if kept and turned[n] - turned[kept[-1]] < TOUCH:
            if (np.abs(excitation[:, n] - excitation[:, kept[-1]]) / scale).max() > 0.01:
                return None
        else:
            kept.append(int(n))
    return turned[kept], excitation[:, kept]


def _gaps(angle: Array) -> Array:
    return np.diff(np.r_[angle, angle[0] + 2.0 * np.pi])


def _symmetric(database: HydroDatabase, sign: Array) -> bool:
    """Whether no coupling joins a degree of freedom that changes sign in the mirror to one that does not."""
    return not bool((couplings(database) & (np.multiply.outer(sign, sign) < 0.0)).any())
