"""The tower's mode shapes at any height, for loads that act along it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from numpy.polynomial import Polynomial

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class TowerShapes:
    """The modes of one direction at n heights; r = (x or y displacement, ..., height - 1/2 q' S q).

    Attributes:
        shape: displacement, (n, 2). slope: its derivative along the tower, 1/m, (n, 2).
        shortening: S, integrals of phi_i' phi_j' from the base, 1/m, (n, 2, 2).
    """

    shape: Array
    slope: Array
    shortening: Array


@dataclass(frozen=True, eq=False)
class TowerAxis:
    """The undeflected tower and its modes, two fore-aft and two side-to-side ones.

    Attributes:
        length: m; base_height: above the platform reference point, m.
        coefficients: c_2..c_6 of the shapes sum c_k x^k over the height fraction x, (4, 5).
    """

    length: float
    base_height: float
    coefficients: Array

    def shapes(self, direction: int, fraction: Array) -> TowerShapes:
        """The two modes of a direction (0: fore-aft, 1: side-to-side) at height fractions (n,)."""
        modes = [Polynomial([0.0, 0.0, *c]) for c in self.coefficients[2 * direction : 2 * direction + 2]]
        slopes = [p.deriv() for p in modes]
        products = [[(p * q).integ()(fraction) for q in slopes] for p in slopes]
        return TowerShapes(
            shape=np.array([p(fraction) for p in modes]).T,
            slope=np.array([p(fraction) for p in slopes]).T / self.length,
            shortening=np.array(products).transpose(2, 0, 1) / self.length,
        )


def read_tower_axis(figures: dict[str, Any]) -> TowerAxis:
    """The axis from the section [tower] of a turbine's figures."""
    return TowerAxis(figures["height"], figures["base_height"], np.array([*figures["fore_aft"], *figures["side"]]))
