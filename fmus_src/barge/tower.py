"""The tower's assumed modes: its inertia, and the motion of its top and of the nacelle on the yaw bearing.

Modes: two fore-aft (along x), then two side-to-side (along y), unit deflection at the top.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
import numpy.typing as npt
from numpy.polynomial import Polynomial

from fmus_src.barge.beam import quadrature
from fmus_src.barge.dynamics import Joint, rotation
from fmus_src.barge.elastic import BeamIntegrals, beam_integrals

Array = npt.NDArray[np.float64]

MODES = 4


@dataclass(frozen=True, eq=False)
class Bending:
    """Two bending modes of the tower in one direction.

    Attributes:
        shape, slope: at the top, (2,), 1 and 1/m; shortening: integrals of phi_i' phi_j' up to the top, (2, 2), 1/m.
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


@dataclass(frozen=True, eq=False)
class Tower:
    """The tower.

    Attributes:
        length: m; base_height: m above mean sea level.
        integrals: over the mass, distances from the base, modes in the order above.
        fore_aft, side: bending in the two directions.
    """

    length: float
    base_height: float
    integrals: BeamIntegrals
    fore_aft: Bending
    side: Bending


def read_tower(figures: dict[str, Any], table: dict[str, Array]) -> Tower:
    """A tower from the section [tower] of a turbine's figures and its table of stations."""
    length, fraction = figures["height"], table["height_fraction"]
    x, weight = quadrature(fraction)
    mass = np.interp(x, fraction, table["mass_density"]) * weight * length
    shape, shortening = np.zeros((x.size, 2, MODES)), np.zeros((x.size, MODES, MODES))
    directions = []
    for i, name in enumerate(("fore_aft", "side")):
        modes = [Polynomial([0.0, 0.0, *c]) for c in figures[name]]
        slopes, curvatures = [p.deriv() for p in modes], [p.deriv(2) for p in modes]
        squares = [[(p * q).integ() for q in slopes] for p in slopes]
        rigidity = np.interp(x, fraction, table[f"{name}_stiffness"]) * weight
        columns = slice(2 * i, 2 * i + 2)
        shape[:, i, columns] = np.array([p(x) for p in modes]).T
        shortening[:, columns, columns] = np.array([[p(x) for p in row] for row in squares]).transpose(2, 0, 1) / length
        directions.append(Bending(
            shape=np.array([p(1.0) for p in modes]),
            slope=np.array([p(1.0) for p in slopes]) / length,
            shortening=np.array([[p(1.0) for p in row] for row in squares]) / length,
            mass=np.einsum("n,ni,nj->ij", mass, shape[:, i, columns], shape[:, i, columns]),
            stiffness=np.array([[rigidity @ (p(x) * q(x)) for q in curvatures] for p in curvatures]) / length**3,
        ))  # fmt: skip
    integrals = beam_integrals(mass, x * length, shape, shortening)
    return Tower(length, figures["base_height"], integrals, *directions)


@dataclass(frozen=True)
class TowerTop:
    """The tower top.

    Attributes:
        axes: of the tower top (without yaw), platform frame, (3, 3).
        nacelle: how the nacelle, referred to the tower top, moves with the relative coordinates.
        deflection: fore-aft and side-to-side displacement from the rigid tower, m, (2,).
    """

    axes: Any
    nacelle: Joint
    deflection: Any


def tower_top(tower: Tower, coordinates: Any, rates: Any, yaw: int) -> TowerTop:
    """Motion of the tower top: u_x = phi q, u_y = psi p, u_z = -1/2 (q' S q + p' S p), turned by Ry(slope) Rx(slope).

    Args:
        coordinates, rates: e and e', of which the first four are the tower's; yaw: index of the nacelle yaw.
    """
    n = int(coordinates.numel())
    q, p, q_rate, p_rate = coordinates[:2], coordinates[2:4], rates[:2], rates[2:4]
    along, across = tower.fore_aft, tower.side
    fall_q, fall_p = ca.SX(along.shortening) @ q, ca.SX(across.shortening) @ p
    drop_rate_2 = ca.dot(q_rate, ca.SX(along.shortening) @ q_rate) + ca.dot(p_rate, ca.SX(across.shortening) @ p_rate)
    deflection = ca.vertcat(ca.dot(ca.SX(along.shape), q), ca.dot(ca.SX(across.shape), p))
    height = tower.base_height + tower.length - 0.5 * (ca.dot(q, fall_q) + ca.dot(p, fall_p))
    partial = ca.SX(3, n)
    partial[0, :2], partial[1, 2:4] = ca.SX(along.shape).T, ca.SX(across.shape).T
    partial[2, :2], partial[2, 2:4] = -fall_q.T, -fall_p.T
    axes, turn, turn_bias = _rotation(tower, coordinates, rates, yaw)
    nacelle = Joint(
        axes=axes @ rotation(2, coordinates[yaw]),
        r=ca.vertcat(deflection, height),
        partial=partial,
        turn=turn,
        bias=ca.vertcat(0, 0, -drop_rate_2),
        turn_bias=turn_bias,
    )
    return TowerTop(axes, nacelle, deflection)


def _rotation(tower: Tower, coordinates: Any, rates: Any, yaw: int) -> tuple[Any, Any, Any]:
    """Axes of the tower top; partial angular velocities and the angular acceleration without e'' of the nacelle.

    The top turns about y, then about the turned x axis; the nacelle about the top's z axis.
    """
    slope_x, slope_y = ca.SX(tower.fore_aft.slope), ca.SX(tower.side.slope)
    pitch, roll = rotation(1, ca.dot(slope_x, coordinates[:2])), rotation(0, -ca.dot(slope_y, coordinates[2:4]))
    pitch_rate, roll_rate = ca.dot(slope_x, rates[:2]), -ca.dot(slope_y, rates[2:4])
    axes, x_axis = pitch @ roll, pitch[:, 0]
    turn = ca.SX(3, int(coordinates.numel()))
    turn[1, :2] = slope_x.T
    turn[:, 2:4] = ca.sparsify(-x_axis @ slope_y.T)
    turn[:, yaw] = axes[:, 2]
    top_rate = ca.vertcat(0, pitch_rate, 0) + roll_rate * x_axis
    bias = pitch_rate * roll_rate * ca.cross(ca.SX([0, 1, 0]), x_axis) + rates[yaw] * ca.cross(top_rate, axes[:, 2])
    return axes, turn, bias
