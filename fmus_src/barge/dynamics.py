"""Kane's equations of bodies carried by a moving platform, in the platform's body frame.

The acceleration of a point at r(e) from the platform reference point P is (Kane and Levinson 1985, sec. 2.7)

    a = a_P + alpha x r + omega x (omega x r) + 2 omega x (J e') + J e'' + J' e',      J = dr/de

with e the relative coordinates (tower modes, drivetrain; blade modes may join). `Balance` sums over bodies the
mass matrix and the generalised forces for the speeds (v_P, omega, e'), so that M [a_P; alpha; e''] = f.
Every vector has body-frame components.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca


@dataclass(frozen=True)
class Point:
    """A material point carried by the platform.

    Attributes:
        r: position from the platform reference point, m, (3,).
        partial: dr/de, (3, n).
        bias: (d/dt dr/de) e', the relative acceleration without e'', m/s2, (3,).
    """

    r: Any
    partial: Any
    bias: Any


@dataclass(frozen=True)
class Frame:
    """Rotation of a body relative to the platform.

    Attributes:
        axes: direction cosines, v_platform = axes v_body, (3, 3).
        partial: d(relative angular velocity)/de', (3, n).
        rate: relative angular velocity, rad/s, (3,).
        bias: relative angular acceleration in the platform frame without e'', rad/s2, (3,).
    """

    axes: Any
    partial: Any
    rate: Any
    bias: Any

    def point(self, origin: Point, offset: Any) -> Point:
        """The point of the body at `offset` (body axes, m) from `origin`, another point of the body."""
        arm = self.axes @ offset
        return Point(
            r=origin.r + arm,
            partial=origin.partial - skew(arm) @ self.partial,
            bias=origin.bias + ca.cross(self.bias, arm) + ca.cross(self.rate, ca.cross(self.rate, arm)),
        )

    def spinning(self, axis: Any, columns: dict[int, float], rates: Any) -> Frame:
        """The frame of a part that spins in this body about `axis` (body axes) at sum of columns[i] * e'[i].

        The axes stay those of this body: the part is axisymmetric.
        """
        s = self.axes @ axis
        spin, partial = ca.SX(0), ca.SX(self.partial)
        for column, ratio in columns.items():
            spin += ratio * rates[column]
            partial[:, column] += ratio * s
        return Frame(self.axes, partial, self.rate + spin * s, self.bias + ca.cross(self.rate, s) * spin)


class Balance:
    """Mass matrix and generalised forces, summed over bodies.

    Args:
        omega: platform's angular velocity, rad/s, (3,).
        gravity: acceleration vector of gravity, m/s2, (3,).
        rates: e', (n,).
    """

    def __init__(self, omega: Any, gravity: Any, rates: Any) -> None:
        n = int(rates.numel())
        self.omega, self.gravity, self.rates = omega, gravity, rates
        self._centripetal = skew(omega) @ skew(omega)
        self.mass = ca.SX(0)
        self.first_moment = ca.SX.zeros(3)
        self.m_pe, self.m_we = ca.SX(3, n), ca.SX(3, n)
        self._m_ww, self.m_ee = ca.SX.zeros(3, 3), ca.SX(n, n)
        self.f_p, self.f_w, self.f_e = ca.SX.zeros(3), ca.SX.zeros(3), ca.SX.zeros(n)

    def copy(self) -> Balance:
        """An independent sum of the same bodies, to which more can be added."""
        other = Balance(self.omega, self.gravity, self.rates)
        for name in ("mass", "first_moment", "m_pe", "m_we", "_m_ww", "m_ee", "f_p", "f_w", "f_e"):
            setattr(other, name, ca.SX(getattr(self, name)))
        return other

    @property
    def m_ww(self) -> Any:
        """Inertia about the platform reference point, kg.m2, (3, 3); from the upper triangle, which saves work."""
        return ca.triu2symm(ca.triu(self._m_ww))

    def specific_force_bias(self, point: Point) -> Any:
        """Acceleration of a point less gravity, without the terms in a_P, alpha and e'', m/s2, (3,)."""
        coriolis = 2 * ca.cross(self.omega, point.partial @ self.rates)
        return self._centripetal @ point.r + coriolis + point.bias - self.gravity

    def add_mass(self, point: Point, mass: Any) -> None:
        """A point mass, kg, with its weight."""
        moment, weighted = mass * point.r, mass * point.partial
        self.mass += mass
        self.first_moment += moment
        self.m_pe += weighted
        self.m_we += skew(moment) @ point.partial
        products = point.r @ moment.T
        self._m_ww += ca.trace(products) * ca.SX.eye(3) - products
        self.m_ee += point.partial.T @ weighted
        self.add_force(point, -mass * self.specific_force_bias(point))

    def add_inertia(self, frame: Frame, inertia: Any) -> None:
        """Rotational inertia about a body's mass centre: principal inertias along the frame's axes, kg.m2, (3,)."""
        axes, tensor = frame.axes, ca.diag(inertia)
        partial = axes.T @ frame.partial
        total = axes.T @ (self.omega + frame.rate)
        bias = axes.T @ self._angular_bias(frame)
        torque = tensor @ bias + ca.cross(total, tensor @ total)
        self._add_rotation(axes, tensor @ axes.T, tensor @ partial, partial, torque)

    def add_axisymmetric(self, frame: Frame, axis: Any, axial: Any, diametral: Any) -> None:
        """Rotational inertia of a body of revolution about its mass centre, kg.m2; axis in the frame's axes."""
        s = frame.axes @ axis
        difference = axial - diametral
        total = self.omega + frame.rate
        bias = self._angular_bias(frame)
        # I = diametral 1 + difference s s'; of omega x (I omega) only the part along s remains.
        torque = diametral * bias + difference * (s * ca.dot(s, bias) + ca.dot(s, total) * ca.cross(total, s))
        weighted = diametral * frame.partial + (difference * s) @ (s.T @ frame.partial)
        tensor = diametral * ca.SX.eye(3) + (difference * s) @ s.T
        self._add_rotation(ca.SX.eye(3), tensor, weighted, frame.partial, torque)

    def add_force(self, point: Point, force: Any) -> None:
        """A force at a point, N."""
        self.f_p += force
        self.f_w += ca.cross(point.r, force)
        self.f_e += point.partial.T @ force

    def add_moment(self, frame: Frame, moment: Any) -> None:
        """A moment on a body, N.m."""
        self.f_w += moment
        self.f_e += frame.partial.T @ moment

    def add_internal(self, force: Any) -> None:
        """Generalised forces on e of springs, dampers and motors between the bodies, (n,)."""
        self.f_e += force

    def point_acceleration(self, point: Point, accelerations: tuple[Any, Any, Any]) -> Any:
        """Specific force (acceleration less gravity) at a point, m/s2, (3,).

        Args:
            accelerations: a_P, alpha, e''.
        """
        a_p, alpha, relative = accelerations
        return a_p + ca.cross(alpha, point.r) + point.partial @ relative + self.specific_force_bias(point)

    def angular_acceleration(self, frame: Frame, accelerations: tuple[Any, Any, Any]) -> Any:
        """Absolute angular acceleration of a body, rad/s2, (3,)."""
        return accelerations[1] + frame.partial @ accelerations[2] + self._angular_bias(frame)

    def support(self, accelerations: tuple[Any, Any, Any]) -> tuple[Any, Any]:
        """Force (N) and moment about the platform reference point (N.m) that the bodies pass to what carries them."""
        a_p, alpha, relative = accelerations
        force = self.f_p - self.mass * a_p - ca.cross(alpha, self.first_moment) - self.m_pe @ relative
        moment = self.f_w - ca.cross(self.first_moment, a_p) - self.m_ww @ alpha - self.m_we @ relative
        return force, moment

    def _angular_bias(self, frame: Frame) -> Any:
        return ca.cross(self.omega, frame.rate) + frame.bias

    def _add_rotation(self, axes: Any, tensor: Any, weighted: Any, partial: Any, torque: Any) -> None:
        """Add I_ww = axes tensor, I_we = axes weighted, I_ee = partial' weighted, and the bias torque."""
        self._m_ww += axes @ tensor
        self.m_we += axes @ weighted
        self.m_ee += partial.T @ weighted
        self.f_w -= axes @ torque
        self.f_e -= partial.T @ torque


@dataclass(frozen=True)
class Attitude:
    """Platform attitude by yaw, then pitch, then roll: R = Rz Ry Rx.

    Attributes:
        R: v_global = R v_body, (3, 3).
        E: omega_global = E theta', theta = (roll, pitch, yaw), (3, 3).
        bias: (dE/dt) theta', rad/s2, global, (3,).
    """

    R: Any
    E: Any
    bias: Any


def attitude(angles: Any, rates: Any) -> Attitude:
    """Attitude of the platform from roll, pitch, yaw (rad) and their rates (rad/s)."""
    heading, tilt = rotation(2, angles[2]), rotation(1, angles[1])
    pitch_axis = heading[:, 1]
    E = ca.horzcat(heading @ tilt[:, 0], pitch_axis, ca.SX([0, 0, 1]))
    return Attitude(heading @ tilt @ rotation(0, angles[0]), E, ca.jtimes(E @ rates, angles, rates))


def solve(balance: Balance, att: Attitude, added_mass: Any, load: tuple[Any, Any], free: Any) -> tuple[Any, Any]:
    """Accelerations of the platform reference point (global), of the Euler angles and of e.

    Args:
        added_mass: global frame, about the platform reference point, (6, 6).
        load: force and moment at the platform reference point, global, N, N.m.
        free: 1 for a free degree of freedom, 0 for one whose acceleration is zero, (6 + n,).

    Returns:
        (v_P', theta'', e'') as a column (6 + n,), and the mass matrix of the free system, (6 + n, 6 + n).
    """
    R, E, b = att.R, att.E, balance
    E_body = R.T @ E
    bias = R.T @ att.bias
    M_pw = R @ -skew(b.first_moment)
    A = [[added_mass[3 * i : 3 * i + 3, 3 * j : 3 * j + 3] for j in range(2)] for i in range(2)]
    force = load[0] - A[0][1] @ att.bias + R @ b.f_p - M_pw @ bias
    moment = E.T @ (load[1] - A[1][1] @ att.bias) + E_body.T @ (b.f_w - b.m_ww @ bias)
    upper = [
        [b.mass * ca.SX.eye(3) + A[0][0], M_pw @ E_body + A[0][1] @ E, R @ b.m_pe],
        [None, E_body.T @ b.m_ww @ E_body + E.T @ A[1][1] @ E, E_body.T @ b.m_we],
        [None, None, b.m_ee],
    ]
    M = ca.blockcat([[upper[min(i, j)][max(i, j)] if i <= j else upper[j][i].T for j in range(3)] for i in range(3)])
    f = ca.vertcat(force, moment, b.f_e - b.m_we.T @ bias)
    M = M * (free @ free.T) + ca.diag(1 - free)
    return solve_symmetric(M, free * f), M


def solve_symmetric(M: Any, f: Any) -> Any:
    """Solve M x = f for symmetric positive definite M by LDL' without pivoting; only the upper triangle is read."""
    D, LT, order = ca.ldl(M, False)
    return ca.ldl_solve(f, D, LT, order)


def skew(v: Any) -> Any:
    """Matrix of the cross product v x."""
    return ca.skew(v)


def rotation(axis: int, angle: Any) -> Any:
    """Rotation matrix about a coordinate axis (0, 1, 2)."""
    c, s = ca.cos(angle), ca.sin(angle)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    R = ca.SX(3, 3)
    R[axis, axis], R[i, i], R[j, j] = 1, c, c
    R[i, j], R[j, i] = -s, s
    return R
