"""The floating turbine by Lagrange's equations, an independent form of the barge component's equations of motion.

From positions, rotation matrices and the elements of tower and blades alone: every rate is a derivative by CasADi.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np

from fmus_src.barge.blade import DATA, blade_structure, mode_shapes
from fmus_src.barge.turbine import nrel_5mw_barge

G = 9.80665
N = 22  # 6 of the platform, 2 fore-aft, 2 side-to-side, yaw, generator, torsion, 3 x (2 flap, 1 edge)
TILT, CONE = np.radians(5.0), np.radians(-2.5)
HUB_MASS, HUB_INERTIA, GEAR, GENERATOR = 56780.0, 115926.0, 97.0, 534.116
NACELLE, YAW_INERTIA = 240000.0, 2607890.0 - 240000.0 * 1.9**2


def turn(axis: int, angle: Any) -> Any:
    c, s = ca.cos(angle), ca.sin(angle)
    rows = {
        0: [[1, 0, 0], [0, c, -s], [0, s, c]],
        1: [[c, 0, s], [0, 1, 0], [-s, 0, c]],
        2: [[c, -s, 0], [s, c, 0], [0, 0, 1]],
    }
    return ca.blockcat(rows[axis])


@dataclass(frozen=True)
class Elements:
    """Mass elements of a beam: mass (n,), distance from the origin (n,), shapes (n, 2, k), shortening (n, k, k)."""

    mass: np.ndarray
    distance: np.ndarray
    shape: np.ndarray
    shortening: np.ndarray

    def position(self, q: Any) -> Any:
        """(3, n) in the beam's frame."""
        across = [ca.DM(self.shape[:, i, :]) @ q for i in range(2)]
        k = self.shape.shape[2]
        drop = sum(
            (ca.DM(self.shortening[:, i, j]) * (q[i] * q[j]) / 2 for i in range(k) for j in range(k)),
            ca.MX.zeros(self.mass.size, 1),
        )
        return ca.horzcat(*across, ca.DM(self.distance) - drop).T

    def kinetic(self) -> ca.Function:
        """T(v, omega, q, q') to second order in (q, q'): Taylor's polynomial in a factor on both."""
        k = self.shape.shape[2]
        v, w, q, qd, eps = (ca.MX.sym(n, size) for n, size in zip("vwqde", (3, 3, k, k, 1), strict=True))
        rho = self.position(eps * q)
        relative = ca.reshape(ca.jtimes(ca.vec(self.position(q)), q, qd), 3, self.mass.size)
        relative = ca.Function("relative", [q, qd], [relative])(eps * q, eps * qd)
        velocity = ca.repmat(v, 1, self.mass.size) + ca.skew(w) @ rho + relative
        T = ca.dot(ca.repmat(ca.DM(self.mass).T, 3, 1), velocity**2) / 2
        first = ca.jacobian(T, eps)
        terms = ca.Function("terms", [v, w, q, qd, eps], [T, first, ca.jacobian(first, eps)])
        a, b, c = terms(v, w, q, qd, 0.0)
        return ca.Function("kinetic", [v, w, q, qd], [a + b + c / 2])


def tower_elements() -> Elements:
    table = np.loadtxt(DATA / "tower.csv", delimiter=",", skiprows=2)
    x, weight = gauss(table[:, 0])
    figures = tomllib.loads((DATA / "turbine.toml").read_text(encoding="utf-8"))["tower"]
    shape, shortening = np.zeros((x.size, 2, 4)), np.zeros((x.size, 4, 4))
    for i, name in enumerate(("fore_aft", "side")):
        modes = [np.polynomial.Polynomial([0, 0, *c]) for c in figures[name]]
        for a, p in enumerate(modes):
            shape[:, i, 2 * i + a] = p(x)
            for b, r in enumerate(modes):
                shortening[:, 2 * i + a, 2 * i + b] = (p.deriv() * r.deriv()).integ()(x) / 87.6
    mass = np.interp(x, table[:, 0], table[:, 1]) * weight * 87.6
    return Elements(mass, x * 87.6, shape, shortening)


def blade_elements() -> Elements:
    blade = blade_structure()
    s, weight = gauss(blade.span)
    mass = blade.mass_factor * np.interp(s, blade.span, blade.mass_density) * weight
    shapes = mode_shapes(blade, s)
    return Elements(mass, 1.5 + s, shapes.shape, shapes.shortening)


def gauss(breaks: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Seven Gauss points between neighbouring breaks: exact for a linear mass times two shapes."""
    x, w = np.polynomial.legendre.leggauss(7)
    half = np.diff(breaks)[:, None] / 2
    return (breaks[:-1, None] + half * (x + 1)).ravel(), (half * w).ravel()


@dataclass
class Body:
    """A body with axes A at r: T(v, omega) in its own axes, and its first mass moment about r in its own axes."""

    r: Any
    A: Any
    mass: float
    moment: Any
    kinetic: Callable[[Any, Any], Any]


@dataclass
class System:
    """Bodies and energies as functions of the coordinates; `pitch`: of the blades."""

    pitch: tuple[float, float, float] = (0.0, 0.0, 0.0)
    q: Any = field(default_factory=lambda: ca.MX.sym("q", N))
    qd: Any = field(default_factory=lambda: ca.MX.sym("qd", N))
    qdd: Any = field(default_factory=lambda: ca.MX.sym("qdd", N))

    def __post_init__(self) -> None:
        q, qd, tower = self.q, self.qd, nrel_5mw_barge().tower
        self.origin, self.R = q[:3], turn(2, q[5]) @ turn(1, q[4]) @ turn(0, q[3])
        a, b = q[6:8], q[8:10]
        S, Z = ca.DM(tower.fore_aft.shortening), ca.DM(tower.side.shortening)
        drop = (ca.bilin(S, a, a) + ca.bilin(Z, b, b)) / 2
        across = ca.dot(ca.DM(tower.fore_aft.shape), a), ca.dot(ca.DM(tower.side.shape), b)
        slopes = ca.dot(ca.DM(tower.fore_aft.slope), a), ca.dot(ca.DM(tower.side.slope), b)
        self.top = self.origin + self.R @ ca.vertcat(*across, 87.6 - drop)
        self.top_axes = self.R @ turn(1, slopes[0]) @ turn(0, -slopes[1])
        self.nacelle = self.top_axes @ turn(2, q[10])
        self.shaft = self.nacelle @ turn(1, ca.MX(TILT))
        self.apex = self.top + self.nacelle @ ca.vertcat(0, 0, 1.96256) - 5.0191 * self.shaft[:, 0]
        azimuth = q[11] + q[12]
        coned = [self.shaft @ turn(0, azimuth + 2 * np.pi * k / 3) @ turn(1, ca.MX(CONE)) for k in range(3)]
        self.blade_axes = [A @ turn(2, ca.MX(-p)) for A, p in zip(coned, self.pitch, strict=True)]
        self.coned = coned
        self.modes = [(q[13 + 3 * k : 16 + 3 * k], qd[13 + 3 * k : 16 + 3 * k]) for k in range(3)]

        zero = ca.DM.zeros(3)
        self.elements = blade_elements()
        self.blades = [
            self._beam(self.elements, self.apex, A, *m) for A, m in zip(self.blade_axes, self.modes, strict=True)
        ]
        self.rotor = [
            *self.blades,
            Body(self.apex, self.shaft, HUB_MASS, zero, lambda v, w: HUB_MASS * ca.sumsqr(v) / 2),
            Body(self.apex, self.shaft @ turn(0, azimuth), 0, zero, lambda v, w: HUB_INERTIA * w[0] ** 2 / 2),
        ]
        center = self.top + self.nacelle @ ca.vertcat(1.9, 0, 1.75)

        def nacelle_energy(v: Any, w: Any) -> Any:
            return (NACELLE * ca.sumsqr(v) + YAW_INERTIA * w[2] ** 2) / 2

        self.carried = [
            *self.rotor,
            Body(center, self.nacelle, NACELLE, zero, nacelle_energy),
            Body(self.apex, self.shaft @ turn(0, GEAR * q[11]), 0, zero, lambda v, w: GENERATOR * w[0] ** 2 / 2),
        ]  # fmt: skip
        self.above = [*self.carried, self._beam(tower_elements(), self.origin, self.R, q[6:10], qd[6:10])]
        inertia = ca.DM([726.9e6, 726.9e6, 1453.9e6])
        keel = self.origin + self.R @ ca.vertcat(0, 0, -0.281768)
        self.platform = Body(
            keel, self.R, 5.452e6, zero, lambda v, w: (5.452e6 * ca.sumsqr(v) + ca.dot(inertia, w**2)) / 2
        )  # fmt: skip

    @staticmethod
    def _beam(elements: Elements, r: Any, A: Any, q: Any, qd: Any) -> Body:
        kinetic = elements.kinetic()
        moment = elements.position(q) @ ca.DM(elements.mass)
        return Body(r, A, float(elements.mass.sum()), moment, lambda v, w: kinetic(v, w, q, qd))

    def rate(self, value: Any) -> Any:
        return ca.jtimes(value, self.q, self.qd)

    def second_rate(self, value: Any) -> Any:
        """Derivative of something that depends on q and q'."""
        return ca.jtimes(value, self.q, self.qd) + ca.jtimes(value, self.qd, self.qdd)

    def spin(self, A: Any) -> Any:
        """Angular velocity of a body with axes A, in its own axes."""
        S = A.T @ ca.reshape(self.rate(ca.vec(A)), 3, 3)
        return ca.vertcat(S[2, 1], S[0, 2], S[1, 0])

    def kinetic_energy(self) -> Any:
        return sum(b.kinetic(b.A.T @ self.rate(b.r), self.spin(b.A)) for b in [*self.above, self.platform])

    def potential_energy(self) -> Any:
        q, t = self.q, nrel_5mw_barge()
        V = sum(G * (b.mass * b.r[2] + (b.A @ b.moment)[2]) for b in [*self.above, self.platform])
        V += 867.637e6 * q[12] ** 2 / 2 + 9.02832e9 * q[10] ** 2 / 2
        for K, mode in ((t.tower.fore_aft.stiffness, q[6:8]), (t.tower.side.stiffness, q[8:10])):
            V += ca.bilin(ca.DM(K), mode, mode) / 2
        return V + sum(ca.bilin(ca.DM(blade_stiffness()), mode, mode) / 2 for mode, _ in self.modes)

    def load_about(self, point: Any, bodies: list[Body]) -> tuple[Any, Any]:
        """What the bodies pass on: weight less the rates of linear and of angular momentum, global frame."""
        gravity = ca.DM([0, 0, -G])
        force, moment = ca.MX.zeros(3), ca.MX.zeros(3)
        for b in bodies:
            v, w = ca.MX.sym("v", 3), ca.MX.sym("w", 3)
            arguments = [self.q, self.qd, v, w]
            T = b.kinetic(v, w)
            momenta = ca.Function("momenta", arguments, [ca.gradient(T, v), ca.gradient(T, w)])
            linear, angular = momenta(self.q, self.qd, b.A.T @ self.rate(b.r), self.spin(b.A))
            p = b.A @ linear
            own = b.mass * gravity - self.second_rate(p)
            force += own
            about_origin = self.second_rate(ca.cross(b.r, p) + b.A @ angular)
            moment += ca.cross(b.mass * b.r + b.A @ b.moment, gravity) - about_origin
        return force, moment - ca.cross(point, force)


def blade_stiffness() -> np.ndarray:
    """Integrals of EI phi_i'' phi_j'' by Gauss points between the stations."""
    blade = blade_structure()
    s, weight = gauss(blade.span)
    bending = [np.polynomial.Polynomial([0, 0, *c]).deriv(2)(s / 61.5) / 61.5**2 for c in blade.coefficients]
    flap, edge = (np.interp(s, blade.span, EI) * weight for EI in (blade.flap_stiffness, blade.edge_stiffness))
    K = np.zeros((3, 3))
    K[:2, :2] = [[flap @ (a * b) for b in bending[:2]] for a in bending[:2]]
    K[2, 2] = edge @ bending[2] ** 2
    return K


def lagrange(system: System) -> tuple[ca.Function, ca.Function]:
    """(q, q', lift) -> M and generalised forces; and -> energy. Undamped, with a constant upward force at the PRP."""
    q, qd, lift = system.q, system.qd, ca.MX.sym("lift")
    T, V = system.kinetic_energy(), system.potential_energy() - lift * system.q[2]
    momentum = ca.gradient(T, qd)
    M = ca.jacobian(momentum, qd)
    force = ca.gradient(T - V, q) - ca.jtimes(momentum, q, qd)
    return ca.Function("system", [q, qd, lift], [M, force]), ca.Function("energy", [q, qd, lift], [T + V])
