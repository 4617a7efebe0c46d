"""Tables of distributed figures along a beam (tower, blade), and quadrature over them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

# Gauss points between two stations: exact for polynomials of degree 15.
NODES = 8


def stations(file: Path) -> dict[str, Array]:
    """Columns of a table by name; its first column is the fraction of the length.

    Raises:
        ValueError: the first column does not increase from 0 to 1.
    """
    with file.open(encoding="utf-8") as lines:
        rows = [line.strip().split(",") for line in lines if line.strip() and not line.startswith("#")]
    values = np.array(rows[1:], dtype=float)
    if values[0, 0] != 0.0 or values[-1, 0] != 1.0 or np.any(np.diff(values[:, 0]) <= 0.0):
        raise ValueError(f"{file}: column '{rows[0][0]}' must increase from 0 to 1")
    return dict(zip(rows[0], values.T, strict=True))


def quadrature(breaks: Array) -> tuple[Array, Array]:
    """Abscissae and weights, (NODES * intervals,) each, exact for polynomials of degree 15 between the breaks."""
    x, w = np.polynomial.legendre.leggauss(NODES)
    left, width = breaks[:-1, None], np.diff(breaks)[:, None]
    return (left + width * (x + 1) / 2).ravel(), (width * w / 2).ravel()


def cumulative(breaks: Array, values: Array) -> tuple[Array, Array]:
    """Integral from the first break of a function given at the abscissae of `quadrature(breaks)`.

    Args:
        breaks: (m + 1,); values: (NODES * m, ...).

    Returns:
        the integral at the same abscissae (from the interpolating polynomial of degree 7), and at the breaks.
    """
    x, w = np.polynomial.legendre.leggauss(NODES)
    monomials = np.vander(x, NODES + 1, increasing=True)
    powers = np.arange(1, NODES + 1)
    primitive = (monomials[:, 1:] - (-1.0) ** powers) / powers
    within = primitive @ np.linalg.inv(monomials[:, :-1])
    half = np.diff(breaks) / 2
    at = values.reshape(half.size, NODES, -1)
    pieces = half[:, None] * np.einsum("j,mjk->mk", w, at)
    at_breaks = np.vstack([np.zeros_like(pieces[:1]), np.cumsum(pieces, axis=0)])
    at_nodes = at_breaks[:-1, None, :] + half[:, None, None] * np.einsum("ij,mjk->mik", within, at)
    return at_nodes.reshape(values.shape), at_breaks.reshape(-1, *values.shape[1:])
