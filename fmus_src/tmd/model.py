"""Tuned mass damper that moves fore-aft in a moving body (nacelle or platform), with end stops.

Equations of relative motion in the body frame as Wang et al. (2022), eqs. 7-10, end stops eq. 6.
"""

from __future__ import annotations

from typing import Any

import casadi as ca

from fmus_src.component import Component


def component() -> Component:
    """One damper unit; its defaults are the paper's nacelle damper (table 4, TMD-N)."""
    c = Component("tmd", "Tuned mass damper moving along the body's x axis, with end stops")
    declare_unit(c, "", mass=20_000.0, stiffness=6302.0, damping=1598.0, stroke=8.0)
    return c


def declare_unit(c: Component, prefix: str, *, mass: float, stiffness: float, damping: float, stroke: float) -> None:
    """Declare one damper's variables (each name led by `prefix`) and equations in a component.

    Args:
        mass: kg; stiffness: N/m; damping: N s/m; stroke: m, travel to each stop.
    """
    n = prefix
    m = c.parameter(f"{n}m", mass, unit="kg", min=1e-3, description="damper mass")
    k = c.parameter(f"{n}k", stiffness, unit="N/m", min=0.0, description="spring stiffness", tunable=True)
    d = c.parameter(f"{n}c", damping, unit="N.s/m", min=0.0, description="viscous damping", tunable=True)
    limit = c.parameter(f"{n}stroke", stroke, unit="m", min=0.0, description="travel to each end stop")
    k_stop = c.parameter(f"{n}k_stop", 5e5, unit="N/m", min=0.0, description="stop stiffness")
    c_stop = c.parameter(f"{n}c_stop", 5e5, unit="N.s/m", min=0.0, description="stop damping")
    x_0 = c.parameter(f"{n}initial_displacement", 0.0, unit="m", description="displacement at the start")

    f, omega, alpha = declare_attachment(c, n)
    x = c.state(f"{n}displacement", unit="m", start=x_0, description="displacement relative to the attachment")
    v = c.state(f"{n}velocity", unit="m/s", description="velocity relative to the attachment")

    contact = c.switch(f"{n.replace('.', '_')}contact", stop_switches(x, v, limit))
    stop = stop_force(x, v, limit, k_stop, c_stop, contact)
    axial = -k * x - d * v + stop
    c.derivative(x, v)
    # eq. 7, x component: the centripetal term acts as a negative spring; Coriolis and Euler terms are transverse.
    c.derivative(v, axial / m - f[0] + (omega[1] ** 2 + omega[2] ** 2) * x)

    r = ca.vertcat(x, 0, 0)
    carried = f + ca.cross(alpha, r) + ca.cross(omega, ca.cross(omega, r)) + 2 * ca.cross(omega, ca.vertcat(v, 0, 0))
    force = ca.vertcat(-axial, -m * carried[1], -m * carried[2])
    c.output(f"{n}force", force, unit="N", nominal=1e4, description="force on the body at the attachment, body frame")
    c.output(
        f"{n}moment", ca.cross(r, force), unit="N.m", nominal=1e5,
        description="moment on the body about the attachment, body frame",
    )  # fmt: skip
    c.output(f"{n}stop_force", stop, unit="N", nominal=1e4, description="force of the end stop on the damper")


def declare_attachment(c: Component, prefix: str) -> tuple[Any, Any, Any]:
    """Declare a damper's inputs: specific force (m/s2), angular velocity and acceleration (rad/s, rad/s2), body frame.

    Returns:
        their symbols, three elements each.
    """
    return (
        c.input(
            f"{prefix}attachment.specific_force", 3, unit="m/s2", start=(0.0, 0.0, 9.80665),
            description="acceleration less gravity of the attachment point, body frame",
        ),
        c.input(
            f"{prefix}attachment.angular_velocity", 3, unit="rad/s",
            description="angular velocity of the body, body frame",
        ),
        c.input(
            f"{prefix}attachment.angular_acceleration", 3, unit="rad/s2",
            description="angular acceleration, body frame",
        ),
    )  # fmt: skip


def stop_switches(x: Any, v: Any, stroke: Any) -> Any:
    """Functions that are positive beyond either stop, and beyond it while moving further out, shape (4,)."""
    over, under = x - stroke, -x - stroke
    return ca.vertcat(over, ca.fmin(over, v), under, ca.fmin(under, -v))


def stop_force(x: Any, v: Any, stroke: Any, k_stop: Any, c_stop: Any, contact: Any) -> Any:
    """End-stop force on the damper, eq. 6: a spring beyond the stroke, and damping while moving further out.

    Args:
        contact: where `stop_switches` is positive.
    """
    beyond = contact[0] * (x - stroke) + contact[2] * (x + stroke)
    return -k_stop * beyond - c_stop * (contact[1] + contact[3]) * v
