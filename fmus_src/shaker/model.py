"""A damper's mass moved along its rail as prescribed: what measures how a structure responds to its dampers.

Forces on the body as those of `tmd` (Wang et al. 2022, eqs. 7-10) with the relative displacement given in time; an
amplitude of zero holds the mass still.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from fmus_src.component import Component
from fmus_src.hydro.waves import phases


def component(lines: int = 420) -> Component:
    """A mass moved by a sum of sines ("multisine"): same inputs and outputs as `tmd`.

    Args:
        lines: number of frequencies, n / period for n = 1 ... lines; those within the band are used.

    Raises:
        ValueError: fewer than one line.
    """
    if lines < 1:
        raise ValueError(f"shaker: {lines} lines asked for; give one or more")
    c = Component("shaker", "Mass moved along the body's x axis by a sum of sines, to measure the body's response")
    m = c.parameter("m", 20_000.0, unit="kg", min=1e-3, description="mass")
    f = c.input(
        "attachment.specific_force", 3, unit="m/s2", start=(0.0, 0.0, 9.80665),
        description="acceleration less gravity of the attachment point, body frame",
    )  # fmt: skip
    omega = c.input("attachment.angular_velocity", 3, unit="rad/s", description="angular velocity, body frame")
    alpha = c.input("attachment.angular_acceleration", 3, unit="rad/s2", description="angular acceleration, body frame")
    x, v, a = _motion(c, lines)

    r = ca.vertcat(x, 0, 0)
    # m times the acceleration less gravity of the mass: with Euler, centripetal and Coriolis terms (eq. 7)
    carried = f + ca.cross(alpha, r) + ca.cross(omega, ca.cross(omega, r)) + 2 * ca.cross(omega, ca.vertcat(v, 0, 0))
    force = -m * (carried + ca.vertcat(a, 0, 0))
    c.output("force", force, unit="N", nominal=1e4, description="force on the body at the attachment, body frame")
    c.output(
        "moment", ca.cross(r, force), unit="N.m", nominal=1e5,
        description="moment on the body about the attachment, body frame",
    )  # fmt: skip
    c.output("displacement", x, unit="m", description="displacement relative to the attachment")
    c.output("velocity", v, unit="m/s", description="velocity relative to the attachment")
    return c


def _motion(c: Component, lines: int) -> tuple[Any, Any, Any]:
    """Displacement, velocity and acceleration: sines of random phase, of amplitudes as 1 / frequency, from rest."""
    amplitude = c.parameter(
        "amplitude", 0.0, unit="m", min=0.0,
        description="standard deviation of the displacement once risen; 0: the mass is held",
    )  # fmt: skip
    low = c.parameter("f_low", 0.02, unit="Hz", min=0.0, description="lowest frequency")
    high = c.parameter("f_high", 0.7, unit="Hz", min=0.0, description="highest frequency")
    period = c.parameter("period", 600.0, unit="s", min=1e-3, description="time after which the motion repeats")
    seed = c.parameter("seed", 1, kind="integer", min=0, max=2**31 - 1, description="seed of the phases")
    rise = c.parameter("rise", 5.0, unit="s", min=1e-3, description="time in which the motion rises to 1 - 1/e")
    number = ca.DM(np.arange(1.0, lines + 1.0))
    frequency = number / period
    # Of equal velocity, so that low frequencies, where structures are soft, do not drown in high ones.
    share = ca.if_else(frequency >= low, ca.if_else(frequency <= high, 1.0 / number, 0.0), 0.0)
    scale = ca.sqrt(2.0 / ca.fmax(ca.sumsqr(share), 1e-30))
    height = c.calculated("height", amplitude * scale * share, unit="m", internal=True, description="of each sine")
    phase = c.calculated("phase", phases(seed, lines), unit="rad", internal=True, description="of each sine")
    rate = c.calculated("rate", 2.0 * ca.pi * frequency, unit="rad/s", internal=True, description="of each sine")
    angle = rate * c.time + phase
    cosine, sine = height * ca.cos(angle), height * ca.sin(angle)
    x, v, a = ca.sum1(cosine), -ca.dot(rate, sine), -ca.dot(rate**2, cosine)
    # It starts from rest at the centre: a start with a jump would give the mass momentum that no force accounts for.
    late = c.time / rise
    fade = ca.exp(-(late**2))
    risen, slope, curvature = 1.0 - fade, 2.0 * late * fade / rise, (2.0 - 4.0 * late**2) * fade / rise**2
    return risen * x, risen * v + slope * x, risen * a + 2.0 * slope * v + curvature * x
