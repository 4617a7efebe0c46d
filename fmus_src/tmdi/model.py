"""Tuned mass damper inerter: the damper of `fmus_src.tmd` with inerters between its mass and the body.

Two layouts of Hu and Chen (2015), applied to a barge-type turbine by Hu et al. (2018); see README.md.
"""

from __future__ import annotations

import casadi as ca

from fmus_src.component import Component
from fmus_src.tmd.model import declare_attachment, stop_force, stop_switches


def component() -> Component:
    """One damper unit; its defaults are the paper's nacelle damper (Wang et al. 2022, table 4) without inertance."""
    c = Component("tmdi", "Tuned mass damper inerter moving along the body's x axis, with end stops")
    m = c.parameter("m", 20_000.0, unit="kg", min=1e-3, description="damper mass")
    k = c.parameter("k", 6302.0, unit="N/m", min=0.0, description="spring stiffness", tunable=True)
    d = c.parameter("c", 1598.0, unit="N.s/m", min=0.0, description="viscous damping", tunable=True)
    b = c.parameter("b", 0.0, unit="kg", min=0.0, description="inertance between mass and body", tunable=True)
    b_s = c.parameter("b_s", 1000.0, unit="kg", min=1e-3, description="inertance of the series branch")
    k_s = c.parameter("k_s", 0.0, unit="N/m", min=0.0, description="spring of the series branch", tunable=True)
    d_s = c.parameter("c_s", 0.0, unit="N.s/m", min=0.0, description="dashpot of the series branch", tunable=True)
    limit = c.parameter("stroke", 8.0, unit="m", min=0.0, description="travel to each end stop")
    k_stop = c.parameter("k_stop", 5e5, unit="N/m", min=0.0, description="stop stiffness")
    c_stop = c.parameter("c_stop", 5e5, unit="N.s/m", min=0.0, description="stop damping")
    x_0 = c.parameter("initial_displacement", 0.0, unit="m", description="displacement at the start")
    f, omega, alpha = declare_attachment(c, "")
    x = c.state("displacement", unit="m", start=x_0, description="displacement relative to the attachment")
    v = c.state("velocity", unit="m/s", description="velocity relative to the attachment")
    y = c.state("branch.displacement", unit="m", start=x_0, description="of the series inerter's end, to the body")
    y_rate = c.state("branch.velocity", unit="m/s", description="its rate")

    contact = c.switch("contact", stop_switches(x, v, limit))
    stop = stop_force(x, v, limit, k_stop, c_stop, contact)
    branch = k_s * (x - y) + d_s * (v - y_rate)
    axial = -k * x - d * v + stop - branch
    # tmd's equation first, so that without inertance its very bits are left; m / (m + b): the inerter's share in it
    rate = (axial / m - f[0] + (omega[1] ** 2 + omega[2] ** 2) * x) * (m / (m + b))
    c.derivative(x, v)
    c.derivative(v, rate)
    c.derivative(y, y_rate)
    c.derivative(y_rate, branch / b_s)

    r = ca.vertcat(x, 0, 0)
    carried = f + ca.cross(alpha, r) + ca.cross(omega, ca.cross(omega, r)) + 2 * ca.cross(omega, ca.vertcat(v, 0, 0))
    force = ca.vertcat(b * rate - axial, -m * carried[1], -m * carried[2])
    c.output("force", force, unit="N", nominal=1e4, description="force on the body at the attachment, body frame")
    c.output(
        "moment", ca.cross(r, force), unit="N.m", nominal=1e5,
        description="moment on the body about the attachment, body frame",
    )  # fmt: skip
    c.output("stop_force", stop, unit="N", nominal=1e4, description="force of the end stop on the damper")
    return c
