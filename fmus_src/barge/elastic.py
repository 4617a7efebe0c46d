"""Inertia of rigid bodies and of slender elastic beams, about a point of theirs and in their own axes.

A beam is described by assumed modes q about its straight axis z: its element at distance s is at

    rho = s z + U(s) q - 1/2 (q' S(s) q) z

with U the displacements across the axis and S the shortening (the axis does not stretch). The kinetic energy of
T(v, omega, q', q) is kept to second order in (q, q'), exactly; the equations of motion are Hamel's for that energy
(Boltzmann-Hamel equations in the quasi-velocities v and omega), so that energy and momentum are conserved exactly,
gyroscopic, Coriolis and centrifugal terms included. The integrals over the beam are taken once.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Inertia:
    """Force and moment that accelerating a body takes: F = linear a + coupling alpha, M = coupling' a + angular alpha.

    Attributes:
        linear: kg, (3, 3); coupling: kg.m, (3, 3); angular: kg.m2, (3, 3). Only the upper triangles of the symmetric
            `linear` and `angular` are meant.
    """

    linear: Any
    coupling: Any
    angular: Any

    def __add__(self, other: Inertia) -> Inertia:
        return Inertia(self.linear + other.linear, self.coupling + other.coupling, self.angular + other.angular)

    def turned(self, axes: Any) -> Inertia:
        """The same in the axes of v = axes v_body."""
        return Inertia(
            axes @ symmetric(self.linear) @ axes.T,
            axes @ self.coupling @ axes.T,
            axes @ symmetric(self.angular) @ axes.T,
        )

    def about(self, arm: Any) -> Inertia:
        """About the point from which the present one is at `arm`, m, (3,)."""
        cross = ca.skew(arm)
        coupling = self.coupling - symmetric(self.linear) @ cross
        return Inertia(self.linear, coupling, self.angular + cross @ coupling + (cross @ self.coupling).T)

    def load(self, a: Any, alpha: Any) -> tuple[Any, Any]:
        """Force and moment for an acceleration of the point and an angular acceleration."""
        force = symmetric(self.linear) @ a + self.coupling @ alpha
        return force, self.coupling.T @ a + symmetric(self.angular) @ alpha


def point_inertia(mass: Any, arm: Any) -> Inertia:
    """A point mass (kg) at `arm` (m) from the point of reference."""
    cross = ca.skew(arm)
    return Inertia(mass * ca.SX.eye(3), -mass * cross, -mass * (cross @ cross))


def disc_inertia(inertia: Any, axis: Any) -> Inertia:
    """A body that resists rotation about one axis (unit vector) only, kg.m2."""
    return Inertia(ca.SX(3, 3), ca.SX(3, 3), inertia * (axis @ axis.T))


@dataclass(frozen=True, eq=False)
class BeamIntegrals:
    """Integrals over the mass of a beam with k modes; x and y are the directions of U's rows.

    Attributes:
        mass, first, second: of 1, s, s^2; kg, kg.m, kg.m2.
        shape, moment: of U and s U, (2, k).
        xx, yy, xy: of U_x' U_x, U_y' U_y and the symmetric part of U_x' U_y, (k, k).
        spin: of U_y' U_x - U_x' U_y, antisymmetric, (k, k).
        drop, drop_moment: of S and s S, (k, k).
    """

    mass: Any
    first: Any
    second: Any
    shape: Any
    moment: Any
    xx: Any
    yy: Any
    xy: Any
    spin: Any
    drop: Any
    drop_moment: Any

    def scaled(self, factor: Any) -> BeamIntegrals:
        """Those of a beam whose mass is multiplied by a factor."""
        return BeamIntegrals(**{name: factor * ca.SX(value) for name, value in vars(self).items()})

    @property
    def modal(self) -> Any:
        """Modal mass matrix, (k, k)."""
        return self.xx + self.yy


def beam_integrals(mass: Array, distance: Array, shape: Array, shortening: Array) -> BeamIntegrals:
    """Integrals as sums over n mass elements.

    Args:
        mass: kg, (n,); distance: s, m, (n,); shape: U, (n, 2, k); shortening: S, 1/m, (n, k, k).
    """

    def total(values: Array, power: int = 0) -> Any:
        return ca.sparsify(ca.DM(np.tensordot(mass * distance**power, values, axes=(0, 0))))

    x, y = shape[:, 0, :], shape[:, 1, :]
    xy = np.einsum("ni,nj->nij", x, y)
    yx = xy.transpose(0, 2, 1)
    return BeamIntegrals(
        mass=float(mass.sum()),
        first=float(mass @ distance),
        second=float(mass @ distance**2),
        shape=total(shape),
        moment=total(shape, 1),
        xx=total(np.einsum("ni,nj->nij", x, x)),
        yy=total(np.einsum("ni,nj->nij", y, y)),
        xy=total((xy + yx) / 2),
        spin=total(yx - xy),
        drop=total(shortening),
        drop_moment=total(shortening, 1),
    )


@dataclass(frozen=True)
class ElasticInertia:
    """A beam at an instant, about its origin and in its axes.

    Attributes:
        rigid: with the modes held; linear, angular: force and moment that modal accelerations take, (3, k);
        modal: modal mass, (k, k); force, moment, modal_force: inertial terms without accelerations.
    """

    rigid: Inertia
    linear: Any
    angular: Any
    modal: Any
    force: Any
    moment: Any
    modal_force: Any

    def resistance(self, a: Any, alpha: Any) -> tuple[Any, Any, Any]:
        """Force, moment and modal forces that the motion takes but for modal accelerations."""
        force, moment = self.rigid.load(a, alpha)
        modal = self.linear.T @ a + self.angular.T @ alpha
        return force + self.force, moment + self.moment, modal + self.modal_force


def elastic_inertia(b: BeamIntegrals, q: Any, rates: Any, omega: Any) -> ElasticInertia:
    """The beam deflected by q and vibrating at q', in a frame that turns at omega (rad/s, frame's axes).

    With d = integral of rho, W = integral of rho rho', J = tr(W) 1 - W and h = integral of rho x rho_q q', the inertial
    terms are  omega x (omega x d) + 2 omega x d' + d'',  omega x (J omega + h) + J' omega  and, for mode i,
    1/2 tr((omega x)^2 dW/dq_i) + 2 omega . (integral of rho_q q' x rho_qi).
    """
    xx, yy, xy, fall, pull = (A @ q for A in (b.xx, b.yy, b.xy, b.drop, b.drop_moment))
    d = ca.vertcat(b.shape @ q, b.first - 0.5 * ca.dot(q, fall))
    d_rate = ca.vertcat(b.shape @ rates, -ca.dot(rates, fall))
    across, across_rate = b.moment @ q, b.moment @ rates

    def products(v: Any, linear: Any, factor: float, constant: Any) -> Any:
        pairs = [factor * ca.dot(v, w) for w in (xx, yy, xy, pull)]
        return _second_moments(pairs[0], pairs[1], pairs[2], linear, constant - pairs[3])

    J, J_rate = products(q, across, 1.0, b.second), products(rates, across_rate, 2.0, 0.0)
    linear = ca.vertcat(b.shape, -fall.T)
    angular = ca.vertcat(-b.moment[1, :], b.moment[0, :], (b.spin @ q).T)
    K = ca.skew(omega) @ ca.skew(omega)
    centrifugal = K[0, 0] * xx + K[1, 1] * yy + 2 * K[0, 1] * xy - K[2, 2] * pull + b.moment.T @ K[:2, 2]
    return ElasticInertia(
        rigid=Inertia(b.mass * ca.SX.eye(3), -ca.skew(d), J),
        linear=linear,
        angular=angular,
        modal=b.modal,
        force=K @ d + 2 * ca.cross(omega, d_rate) - ca.vertcat(0, 0, ca.dot(rates, b.drop @ rates)),
        moment=ca.cross(omega, J @ omega + angular @ rates) + J_rate @ omega,
        modal_force=centrifugal + 2 * omega[2] * (b.spin @ rates),
    )


def _second_moments(xx: Any, yy: Any, xy: Any, across: Any, zz: Any) -> Any:
    """J = tr(W) 1 - W from the elements of W."""
    xz, yz = across[0], across[1]
    return ca.blockcat([[yy + zz, -xy, -xz], [-xy, xx + zz, -yz], [-xz, -yz, xx + yy]])


def symmetric(matrix: Any) -> Any:
    """A symmetric matrix from its upper triangle, which saves half the work."""
    return ca.triu2symm(ca.triu(matrix))
