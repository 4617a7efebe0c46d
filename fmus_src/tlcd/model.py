"""Tuned liquid column damper: liquid in a U-tube that is fixed in a moving body (platform or nacelle).

Lagrange's equation of the liquid column in a body that moves and turns in any way; sources and equations in README.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca

from fmus_src.component import Component
from fmus_src.tmd.model import declare_attachment, stop_force, stop_switches


@dataclass(frozen=True)
class Column:
    """A U-tube in the body's x-z plane, its horizontal leg centred on the attachment, as symbols or numbers.

    The liquid's displacement w is the rise of its surface in the downwind (+x) leg, m; it falls as much in the other.

    Attributes:
        density: of liquid times cross-section of a vertical leg, kg/m.
        width: B, between the axes of the vertical legs, m.
        level: h, of the liquid at rest in them, above the axis of the horizontal leg, m.
        ratio: cross-section of the vertical legs over that of the horizontal leg.
    """

    density: Any
    width: Any
    level: Any
    ratio: Any

    @property
    def mass(self) -> Any:
        """All of the liquid, kg."""
        return self.density * (2 * self.level + self.width / self.ratio)

    @property
    def effective_length(self) -> Any:
        """Length of the uniform column of the same frequency, m: the natural frequency is sqrt(2 g / L_e)."""
        return 2 * self.level + self.ratio * self.width

    def first_moment(self, w: Any) -> Any:
        """Integral of r dm about the attachment, body frame, kg m, shape (3,)."""
        return self.density * ca.vertcat(self.width * w, 0, self.level**2 + w**2)

    def inertia(self, w: Any) -> Any:
        """Inertia tensor about the attachment, body frame, kg m2, shape (3, 3)."""
        B, h = self.width, self.level
        xx = B**2 * h / 2 + B**3 / (12 * self.ratio)  # of x^2
        zz = 2 * (h**3 + 3 * h * w**2) / 3
        xz = B * h * w
        rows = (ca.horzcat(zz, 0, -xz), ca.horzcat(0, xx + zz, 0), ca.horzcat(-xz, 0, xx))
        return self.density * ca.vertcat(*rows)

    @property
    def circulation(self) -> Any:
        """Angular momentum of the flow per unit of w', about the attachment, body frame, kg m, shape (3,)."""
        return self.density * ca.vertcat(0, -self.width * self.level, 0)


def component() -> Component:
    """A column of 200 t across the barge, tuned as README.md says."""
    c = Component("tlcd", "Tuned liquid column damper: a U-tube in the body's x-z plane, with closed ends")
    m = c.parameter("m", 200_000.0, unit="kg", min=1e-3, description="mass of the liquid")
    rho = c.parameter("rho", 1025.0, unit="kg/m3", min=1e-3, description="density of the liquid: sets the tube's size")
    B = c.parameter("B", 34.0, unit="m", min=1e-3, description="width between the axes of the vertical legs")
    h = c.parameter("h", 6.0, unit="m", min=1e-3, description="level of the liquid at rest above the horizontal leg")
    r = c.parameter(
        "ratio", 2.2, min=1e-3, description="cross-section of the vertical legs over that of the horizontal leg"
    )
    xi = c.parameter(
        "xi", 4.0, min=0.0, tunable=True, description="head-loss coefficient, of the velocity in the vertical legs"
    )
    stroke = c.parameter("stroke", 6.0, unit="m", min=0.0, description="rise to the leg's closed end, h at most")
    k_stop = c.parameter("k_stop", 2e7, unit="N/m", min=0.0, description="stiffness of a leg's end")
    c_stop = c.parameter("c_stop", 5e6, unit="N.s/m", min=0.0, description="damping of a leg's end")
    w_0 = c.parameter("initial_displacement", 0.0, unit="m", description="displacement at the start")
    gravity = c.parameter("gravity", 9.80665, unit="m/s2", min=0.0, description="of the calculated natural frequency")
    per_length = m / (2 * h + B / r)
    c.calculated("A", per_length / rho, unit="m2", description="cross-section of the vertical legs")
    c.calculated("L", B + 2 * h, unit="m", description="length of the liquid column")
    column = Column(c.calculated("mass_per_length", per_length, unit="kg/m", description="rho A"), B, h, r)
    c.calculated(
        "natural_frequency", ca.sqrt(2 * gravity / column.effective_length), unit="rad/s", description="undamped"
    )
    f, omega, alpha = declare_attachment(c, "")
    w = c.state("displacement", unit="m", start=w_0, description="rise of the liquid in the downwind leg")
    v = c.state("velocity", unit="m/s", description="its rate")

    # The tube cannot give more than it holds: with a leg drained, air would enter the horizontal leg.
    travel = ca.fmin(stroke, h)
    contact = c.switch("contact", stop_switches(w, v, travel))
    stop = stop_force(w, v, travel, k_stop, c_stop, contact)
    rate = acceleration(column, w, v, f, omega, alpha, xi, stop)
    c.derivative(w, v)
    c.derivative(v, rate)
    force, moment = loads(column, w, v, rate, f, omega, alpha)
    c.output("force", force, unit="N", nominal=1e4, description="force on the body at the attachment, body frame")
    c.output(
        "moment", moment, unit="N.m", nominal=1e5, description="moment on the body about the attachment, body frame"
    )
    c.output("stop_force", stop, unit="N", nominal=1e4, description="force of the tube's ends on the liquid")
    return c


def acceleration(column: Column, w: Any, v: Any, f: Any, omega: Any, alpha: Any, xi: Any, stop: Any) -> Any:
    """Second derivative of the displacement, m/s2: Lagrange's equation of the column.

    Args:
        w, v: displacement and its rate, m, m/s.
        f, omega, alpha: of the attachment, body frame: specific force (m/s2), angular velocity and acceleration.
        xi: head-loss coefficient; stop: force of the tube's ends on the liquid, N.
    """
    q = ca.SX.sym("w")
    spin = ca.gradient(ca.dot(omega, column.inertia(q) @ omega) / 2, q)
    sway = ca.jacobian(column.first_moment(q), q)
    centrifugal, lever = ca.substitute([spin, sway], [q], [w])
    loss = column.density * xi * ca.fabs(v) * v / 2
    generalised = stop - loss - ca.dot(lever, f) - ca.dot(column.circulation, alpha) + centrifugal
    return generalised / (column.density * column.effective_length)


def loads(column: Column, w: Any, v: Any, rate: Any, f: Any, omega: Any, alpha: Any) -> tuple[Any, Any]:
    """Force (N) and moment about the attachment (N m) on the body, body frame: the liquid's momentum, less its weight.

    Args:
        rate: second derivative of the displacement; others as in `acceleration`.
    """
    density, B = column.density, column.width
    S, J = column.first_moment(w), column.inertia(w)
    S_rate = density * ca.vertcat(B * v, 0, 2 * w * v)
    S_rate_2 = density * ca.vertcat(B * rate, 0, 2 * (w * rate + v**2))
    cross = ca.cross
    momentum = (
        column.mass * f + cross(alpha, S) + cross(omega, cross(omega, S)) + 2 * cross(omega, S_rate) + S_rate_2
    )  # fmt: skip
    q = ca.SX.sym("w")
    J_rate = ca.substitute(ca.reshape(ca.jacobian(ca.vec(column.inertia(q)), q), 3, 3), q, w) * v
    spin = J @ omega + column.circulation * v
    angular = cross(S, f) + J @ alpha + J_rate @ omega + column.circulation * rate + cross(omega, spin)
    return -momentum, -angular
