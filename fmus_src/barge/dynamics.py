"""Kane's equations of bodies carried by a moving platform, in the platform's body frame.

The acceleration of a point at r(e) from the platform reference point P is (Kane and Levinson 1985, sec. 2.7)

    a = a_P + alpha x r + omega x (omega x r) + 2 omega x (J e') + J e'' + J' e',      J = dr/de

with e the relative coordinates. `Balance` sums over bodies the mass matrix and the generalised forces for the speeds
(v_P, omega, e'), so that M [a_P; alpha; e''] = f. Every vector has platform-frame components.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import casadi as ca

from fmus_src.barge.elastic import ElasticInertia, Inertia, symmetric


@dataclass(frozen=True)
class RigidMotion:
    """Motion of a rigid body, with whatever part of its accelerations is known.

    Attributes:
        axes: direction cosines, v_platform = axes v_body, (3, 3).
        r: reference point of the body from the platform reference point, m, (3,); velocity: J e', relative, m/s.
        omega: absolute angular velocity, rad/s, (3,).
        specific_force: acceleration less gravity of the reference point, m/s2, (3,).
        alpha: absolute angular acceleration, rad/s2, (3,).
    """

    axes: Any
    r: Any
    velocity: Any
    omega: Any
    specific_force: Any
    alpha: Any

    def at(self, arm: Any) -> Any:
        """Specific force of the point at `arm` (platform axes, m), (3,)."""
        return self.specific_force + ca.cross(self.alpha, arm) + ca.cross(self.omega, ca.cross(self.omega, arm))

    def spinning(self, arm: Any, axis: Any, speed: Any, acceleration: Any = 0) -> RigidMotion:
        """A part, referred to the point at `arm`, that spins in this body about `axis` (all in platform axes).

        The axes stay those of this body; so does `velocity`, which nothing needs of such a part.
        """
        alpha = self.alpha + ca.cross(self.omega, axis) * speed + axis * acceleration
        return RigidMotion(self.axes, self.r + arm, self.velocity, self.omega + speed * axis, self.at(arm), alpha)

    def accelerated(self, a: Any, alpha: Any) -> RigidMotion:
        """The same with further acceleration of the reference point and angular acceleration."""
        return replace(self, specific_force=self.specific_force + a, alpha=self.alpha + alpha)


@dataclass(frozen=True)
class Joint:
    """How a carried body moves with the relative coordinates.

    Attributes:
        axes: direction cosines, v_platform = axes v_body, (3, 3).
        r: its reference point from the platform reference point, m, (3,).
        partial, turn: of the point's velocity and of the relative angular velocity with e', (3, n).
        bias, turn_bias: relative acceleration and angular acceleration without e'', (3,).
    """

    axes: Any
    r: Any
    partial: Any
    turn: Any
    bias: Any
    turn_bias: Any


@dataclass
class Load:
    """Force and moment on a body about a point; further loads are added where they act."""

    force: Any
    moment: Any

    def add(self, force: Any, moment: Any, arm: Any = None) -> None:
        """A force at `arm` from the point, and a moment."""
        self.force += force
        self.moment += moment if arm is None else moment + ca.cross(arm, force)


@dataclass(frozen=True)
class Accelerations:
    """a_P and alpha of the platform (platform frame) and e''."""

    point: Any
    angular: Any
    relative: Any


class Balance:
    """Mass matrix and generalised forces, summed over bodies. Of symmetric blocks the upper triangle counts.

    Args:
        omega: platform's angular velocity, rad/s, (3,).
        gravity: acceleration vector of gravity, m/s2, (3,).
        rates: e', (n,).
    """

    _SUMS = ("m_pp", "m_pw", "m_ww", "m_pe", "m_we", "m_ee", "f_p", "f_w", "f_e")

    def __init__(self, omega: Any, gravity: Any, rates: Any) -> None:
        n = int(rates.numel())
        self.omega, self.gravity, self.rates = omega, gravity, rates
        self.m_pp, self.m_pw, self.m_ww = (ca.SX(3, 3) for _ in range(3))
        self.m_pe, self.m_we, self.m_ee = ca.SX(3, n), ca.SX(3, n), ca.SX(n, n)
        self.f_p, self.f_w, self.f_e = ca.SX(3, 1), ca.SX(3, 1), ca.SX(n, 1)

    def copy(self) -> Balance:
        """An independent sum of the same bodies, to which more can be added."""
        other = Balance(self.omega, self.gravity, self.rates)
        for name in self._SUMS:
            setattr(other, name, ca.SX(getattr(self, name)))
        return other

    def known_motion(self, joint: Joint) -> RigidMotion:
        """Motion of a body as far as it follows from positions and velocities: without a_P, alpha and e''."""
        velocity, spin = joint.partial @ self.rates, joint.turn @ self.rates
        omega, r = self.omega, joint.r
        a = ca.cross(omega, ca.cross(omega, r) + 2 * velocity) + joint.bias - self.gravity
        alpha = ca.cross(omega, spin) + joint.turn_bias
        return RigidMotion(joint.axes, r, velocity, omega + spin, a, alpha)

    def motion(self, joint: Joint, known: RigidMotion, x: Accelerations) -> RigidMotion:
        """The whole motion of a body."""
        a = x.point + ca.cross(x.angular, joint.r) + joint.partial @ x.relative
        return known.accelerated(a, x.angular + joint.turn @ x.relative)

    def add_body(self, joint: Joint, inertia: Inertia, load: Load) -> None:
        """A body, with the load about its reference point less the inertial one of its known motion."""
        J, turn = joint.partial, joint.turn
        force = symmetric(inertia.linear) @ J + inertia.coupling @ turn
        moment = inertia.coupling.T @ J + symmetric(inertia.angular) @ turn
        at_p = inertia.about(joint.r)
        self.m_pp += at_p.linear
        self.m_pw += at_p.coupling
        self.m_ww += at_p.angular
        self.m_pe += force
        self.m_we += moment + ca.skew(joint.r) @ force
        self.m_ee += J.T @ force + turn.T @ moment
        self._add_load(joint, load)

    def add_spin(self, joint: Joint, ratios: dict[int, float], inertia: Load, own: Any, torque: Any) -> None:
        """Coordinates that spin a part of a body already added, each at its ratio of the part's speed.

        Args:
            inertia: force and moment on the body for a unit angular acceleration of the part; own: moment about the
                part's axis; torque: moment on the part about its axis, less the inertial one of the known motion.
        """
        on_e = joint.partial.T @ inertia.force + joint.turn.T @ inertia.moment
        on_p = inertia.moment + ca.cross(joint.r, inertia.force)
        for column, ratio in ratios.items():
            self.m_pe[:, column] += ratio * inertia.force
            self.m_we[:, column] += ratio * on_p
            self.m_ee[:, column] += ratio * on_e
            for row, other in ratios.items():
                self.m_ee[row, column] += ratio * other * own
            self.f_e[column] += ratio * torque

    def add_elastic(self, body: ElasticInertia, arm: Any, first: int) -> None:
        """A beam clamped to the platform at `arm`, whose modes are the relative coordinates from `first` on.

        The load is that of weight and the known motion.
        """
        omega = self.omega
        force, moment, modal = body.resistance(ca.cross(omega, ca.cross(omega, arm)) - self.gravity, ca.SX(3, 1))
        columns = slice(first, first + int(modal.numel()))
        at_p = body.rigid.about(arm)
        self.m_pp += at_p.linear
        self.m_pw += at_p.coupling
        self.m_ww += at_p.angular
        self.m_pe[:, columns] += body.linear
        self.m_we[:, columns] += body.angular + ca.skew(arm) @ body.linear
        self.m_ee[columns, columns] += body.modal
        self.f_p -= force
        self.f_w -= moment + ca.cross(arm, force)
        self.f_e[columns] -= modal

    def add_external(self, force: Any, moment: Any, generalised: Any) -> None:
        """A load at the platform reference point (platform frame) with its work on the relative coordinates, (n,)."""
        self.f_p += force
        self.f_w += moment
        self.f_e += generalised

    def add_internal(self, force: Any) -> None:
        """Generalised forces on e of springs, dampers and motors between the bodies, (n,)."""
        self.f_e += force

    def support(self, x: Accelerations) -> tuple[Any, Any]:
        """Force (N) and moment about the platform reference point (N.m) that the bodies pass to what carries them."""
        force = self.f_p - symmetric(self.m_pp) @ x.point - self.m_pw @ x.angular - self.m_pe @ x.relative
        moment = self.f_w - self.m_pw.T @ x.point - symmetric(self.m_ww) @ x.angular - self.m_we @ x.relative
        return force, moment

    def _add_load(self, joint: Joint, load: Load) -> None:
        self.f_p += load.force
        self.f_w += load.moment + ca.cross(joint.r, load.force)
        self.f_e += joint.partial.T @ load.force + joint.turn.T @ load.moment


@dataclass(frozen=True)
class Attitude:
    """Platform attitude by yaw, then pitch, then roll: R = Rz Ry Rx.

    Attributes:
        R: v_global = R v_platform, (3, 3).
        E: omega = E theta', theta = (roll, pitch, yaw), platform frame, (3, 3); bias: (dE/dt) theta', rad/s2.
        E_global, bias_global: the same with components in the global frame.
    """

    R: Any
    E: Any
    bias: Any
    E_global: Any
    bias_global: Any


def attitude(angles: Any, rates: Any) -> Attitude:
    """Attitude of the platform from roll, pitch, yaw (rad) and their rates (rad/s)."""
    roll, tilt, heading = (rotation(i, angles[i]) for i in range(3))
    x, y, z = ca.SX([1, 0, 0]), heading[:, 1], ca.SX([0, 0, 1])
    E = ca.sparsify(ca.horzcat(x, roll[1, :].T, (tilt @ roll)[2, :].T))
    E_global = ca.sparsify(ca.horzcat((heading @ tilt)[:, 0], y, z))
    R = heading @ tilt @ roll
    bias, bias_global = (ca.jtimes(matrix @ rates, angles, rates) for matrix in (E, E_global))
    # Derivatives in the turning and in the global frame differ by omega x omega = 0: one vector in two frames.
    return Attitude(R, E, bias, E_global, bias_global)


def solve(balance: Balance, att: Attitude, added_mass: Any, load: tuple[Any, Any], free: Any) -> Any:
    """Accelerations of the platform reference point (global), of the Euler angles and of e, (6 + n,).

    Args:
        added_mass: global frame, about the platform reference point, (6, 6).
        load: force and moment at the platform reference point, global, N, N.m.
        free: 1 for a free degree of freedom, 0 for one whose acceleration is zero, (6 + n,).
    """
    R, E, b, bias = att.R, att.E, balance, att.bias
    A = [[added_mass[3 * i : 3 * i + 3, 3 * j : 3 * j + 3] for j in range(2)] for i in range(2)]
    turned, slow = att.E_global, att.bias_global
    M_ww, M_pw = symmetric(b.m_ww), R @ b.m_pw
    force = load[0] - A[0][1] @ slow + R @ b.f_p - M_pw @ bias
    moment = turned.T @ (load[1] - A[1][1] @ slow) + E.T @ (b.f_w - M_ww @ bias)
    upper = [
        [R @ symmetric(b.m_pp) @ R.T + A[0][0], M_pw @ E + A[0][1] @ turned, R @ b.m_pe],
        [None, E.T @ M_ww @ E + turned.T @ A[1][1] @ turned, E.T @ b.m_we],
        [None, None, b.m_ee],
    ]
    M = ca.blockcat([[upper[min(i, j)][max(i, j)] if i <= j else upper[j][i].T for j in range(3)] for i in range(3)])
    return solve_symmetric(M, ca.vertcat(force, moment, b.f_e - b.m_we.T @ bias), free)


def solve_symmetric(M: Any, f: Any, free: Any) -> Any:
    """Solve M x = f for symmetric positive definite M by LDL' without pivoting; only the upper triangle is read.

    Where `free` is 0 the row and column are left out and x is 0: a pivot whose reciprocal is 0 eliminates nothing.
    """
    n = int(f.numel())
    M, y = ca.densify(ca.SX(M)), ca.densify(ca.SX(f))
    reciprocal, unit = [], ca.SX.zeros(n, n)
    for k in range(n):
        reciprocal.append(free[k] / M[k, k])
        for i in range(k + 1, n):
            unit[k, i] = M[k, i] * reciprocal[k]
        for i in range(k + 1, n):
            for j in range(i, n):
                M[i, j] -= unit[k, i] * M[k, j]
            y[i] -= unit[k, i] * y[k]
    x = ca.SX.zeros(n)
    for k in reversed(range(n)):
        x[k] = reciprocal[k] * y[k] - ca.dot(unit[k, k + 1 :], x[k + 1 :].T)
    return x


def rotation(axis: int, angle: Any) -> Any:
    """Rotation matrix about a coordinate axis (0, 1, 2)."""
    c, s = ca.cos(angle), ca.sin(angle)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    R = ca.SX(3, 3)
    R[axis, axis], R[i, i], R[j, j] = 1, c, c
    R[i, j], R[j, i] = -s, s
    return R
