"""Figures of the turbine and barge (`data/`), and the constants of the tower that follow from them."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from numpy.polynomial import Polynomial

Array = npt.NDArray[np.float64]

DATA = Path(__file__).parent / "data"

# Point masses of the tower: Gauss quadrature with as many points is exact for the product of two mode shapes.
TOWER_POINTS = 7


@dataclass(frozen=True)
class Bending:
    """Two bending modes of the tower in one direction, unit deflection at the top.

    Attributes:
        shape, slope: of the point masses and, last, the tower top; shapes (TOWER_POINTS + 1, 2), 1 and 1/m.
        shortening: integrals of phi_i' phi_j' from the base; shape (TOWER_POINTS + 1, 2, 2), 1/m.
        mass: integrals of mu phi_i phi_j over the bare tower, (2, 2), kg.
        stiffness: integrals of EI phi_i'' phi_j'', (2, 2), N/m.
    """

    shape: Array
    slope: Array
    shortening: Array
    mass: Array
    stiffness: Array

    @property
    def bare_frequency(self) -> Array:
        """Frequency of each shape alone without tower-top mass and gravity, Hz, (2,)."""
        return np.asarray(np.sqrt(np.diag(self.stiffness) / np.diag(self.mass)) / (2 * np.pi))

    @property
    def damping(self) -> Array:
        """Modal damping at unit damping ratio, (2, 2), N.s/m: C_ij = K_ij / (pi f_j) as ElastoDyn."""
        return np.asarray(self.stiffness / (np.pi * self.bare_frequency))


@dataclass(frozen=True)
class Tower:
    """The tower as point masses at fixed heights with assumed bending modes.

    Attributes:
        height: of the point masses and, last, the tower top above the base, m, (TOWER_POINTS + 1,).
        mass: point masses, kg, (TOWER_POINTS,).
        base_height: m above mean sea level.
    """

    height: Array
    mass: Array
    base_height: float
    fore_aft: Bending
    side: Bending


@dataclass(frozen=True)
class Turbine:
    """Everything that defines the structure.

    Attributes:
        platform, nacelle, rotor, blade, drivetrain: figures of the sections of `data/turbine.toml`.
        damping_ratio: of the tower's modes.
        tower: constants of the tower.
    """

    platform: dict[str, Any]
    nacelle: dict[str, Any]
    rotor: dict[str, Any]
    blade: dict[str, Any]
    drivetrain: dict[str, Any]
    damping_ratio: float
    tower: Tower


@cache
def nrel_5mw_barge() -> Turbine:
    """The NREL 5-MW turbine on the ITI Energy barge."""
    return load(DATA)


def load(folder: Path) -> Turbine:
    """Read `turbine.toml` and `tower.csv` of a folder.

    Raises:
        ValueError: a section is missing from the TOML file, or the table's stations do not run from 0 to 1.
    """
    figures = tomllib.loads((folder / "turbine.toml").read_text(encoding="utf-8"))
    sections = ("platform", "nacelle", "rotor", "blade", "drivetrain")
    for section in ("tower", *sections):
        if section not in figures:
            raise ValueError(f"{folder / 'turbine.toml'}: section [{section}] is missing")
    return Turbine(
        **{section: figures[section] for section in sections},
        damping_ratio=figures["tower"]["damping_ratio"],
        tower=_tower(figures["tower"], _stations(folder / "tower.csv")),
    )


def _tower(figures: dict[str, Any], table: dict[str, Array]) -> Tower:
    length, fraction = figures["height"], table["height_fraction"]
    s, weight = _quadrature(fraction)
    line_mass = np.interp(s, fraction, table["mass_density"]) * weight * length
    points, masses = _gauss(s, line_mass, TOWER_POINTS)

    def bending(coefficients: list[list[float]], stiffness: Array) -> Bending:
        shapes = [Polynomial([0.0, 0.0, *c]) for c in coefficients]
        at = np.append(points, 1.0)
        slopes, curvatures = [p.deriv() for p in shapes], [p.deriv(2) for p in shapes]
        rigidity = np.interp(s, fraction, stiffness) * weight
        return Bending(
            shape=np.array([p(at) for p in shapes]).T,
            slope=np.array([p(at) for p in slopes]).T / length,
            shortening=np.array([[(p * q).integ()(at) for q in slopes] for p in slopes]).transpose(2, 0, 1) / length,
            mass=np.array([[np.sum(line_mass * p(s) * q(s)) for q in shapes] for p in shapes]),
            stiffness=np.array([[np.sum(rigidity * p(s) * q(s)) for q in curvatures] for p in curvatures]) / length**3,
        )  # fmt: skip

    return Tower(
        height=np.append(points, 1.0) * length,
        mass=masses,
        base_height=figures["base_height"],
        fore_aft=bending(figures["fore_aft"], table["fore_aft_stiffness"]),
        side=bending(figures["side"], table["side_stiffness"]),
    )


def _stations(file: Path) -> dict[str, Array]:
    """Columns of a table by name; its first column is the fraction of the length."""
    with file.open(encoding="utf-8") as lines:
        rows = [line.strip().split(",") for line in lines if line.strip() and not line.startswith("#")]
    values = np.array(rows[1:], dtype=float)
    if values[0, 0] != 0.0 or values[-1, 0] != 1.0 or np.any(np.diff(values[:, 0]) <= 0.0):
        raise ValueError(f"{file}: column '{rows[0][0]}' must increase from 0 to 1")
    return dict(zip(rows[0], values.T, strict=True))


def _quadrature(stations: Array) -> tuple[Array, Array]:
    """Abscissae and weights on [0, 1], exact for polynomials of degree 15 between the stations."""
    x, w = np.polynomial.legendre.leggauss(8)
    left, width = stations[:-1, None], np.diff(stations)[:, None]
    return (left + width * (x + 1) / 2).ravel(), (width * w / 2).ravel()


def _gauss(abscissae: Array, weights: Array, count: int) -> tuple[Array, Array]:
    """Gauss quadrature of a discrete measure (Golub and Welsch 1969): `count` points, exact to degree 2 count - 1."""
    total = weights.sum()
    vector, previous = np.sqrt(weights / total), np.zeros_like(weights)
    diagonal: list[float] = []
    beside: list[float] = []
    basis = [vector]
    for _ in range(count):
        following = abscissae * vector
        diagonal.append(float(vector @ following))
        following -= diagonal[-1] * vector + (beside[-1] if beside else 0.0) * previous
        for done in basis:  # keeps the Lanczos vectors orthogonal to round-off
            following -= done * (done @ following)
        beside.append(float(np.linalg.norm(following)))
        previous, vector = vector, following / beside[-1]
        basis.append(vector)
    nodes, vectors = np.linalg.eigh(np.diag(diagonal) + np.diag(beside[:-1], 1) + np.diag(beside[:-1], -1))
    return nodes, total * vectors[0] ** 2
