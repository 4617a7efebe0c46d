"""Four-degree-of-freedom model of the barge turbine with a nacelle and a platform damper, for damper optimisation.

Wang et al. (2022), eqs. 1-6. The equations of motion follow from the energies by differentiation (Lagrange), so that
stiffness, mass and damping matrices are symmetric by construction; the platform rows of the printed eq. 5 are not.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import casadi as ca

from fmus_src.component import Component
from fmus_src.tmd.model import stop_force, stop_switches

# The stops' damping, 25 1/s on the nacelle's damper, sets the step: README.md says what it costs in accuracy.
INTERNAL_STEP = 0.016


@dataclass(frozen=True)
class Damper:
    """Symbols of one damper.

    Attributes:
        prefix: of its variables' names.
        m, k, c, stroke, k_stop, c_stop: kg, N/m, N s/m, m, N/m, N s/m.
        active: 1, or 0 if the damper is absent.
        height: of the attachment above the reference point, m; negative below.
    """

    prefix: str
    m: Any
    k: Any
    c: Any
    stroke: Any
    k_stop: Any
    c_stop: Any
    active: Any
    height: Any


@dataclass(frozen=True)
class Structure:
    """Symbols of the barge (p) and the tower with its rotor-nacelle assembly (t); table 3.

    Attributes:
        I_p, I_t: moments of inertia about the reference point, kg m2 (the barge's with its added mass).
        k_p, k_t: stiffness of hydrostatics and mooring, and of the tower's hinge, N m/rad.
        d_p, d_t: damping of the same, N m s/rad.
        m_p, m_t: masses, kg.
        R_p, R_t: mass centres, m: the barge's below, the tower's above the reference point.
        gravity: m/s2.
    """

    I_p: Any
    k_p: Any
    d_p: Any
    I_t: Any
    k_t: Any
    d_t: Any
    m_p: Any
    m_t: Any
    R_p: Any
    R_t: Any
    gravity: Any


def component() -> Component:
    """The model with the parameters of the paper's tables 1, 3 and 4 (MTMD), free from 5 deg of pitch."""
    c = Component(
        "simplified", "Barge turbine with two tuned mass dampers, four degrees of freedom", internal_step=INTERNAL_STEP
    )  # fmt: skip
    s = _declare_structure(c)
    nacelle = _declare_damper(
        c, "nacelle_damper.", m=20_000.0, k=7653.0, d=4013.0, stroke=8.0, R=90.0, sign=1,
        where="above the reference point",
    )  # fmt: skip
    platform = _declare_damper(
        c, "platform_damper.", m=200_000.0, k=52_597.0, d=11_911.0, stroke=18.0, R=0.281, sign=-1,
        where="below the reference point",
    )  # fmt: skip
    reaction = c.parameter(
        "stop_reaction", 1, kind="boolean",
        description="end stops push back on the structure; false: they act on the damper alone",
    )  # fmt: skip
    top = c.parameter("hub_height", 90.0, unit="m", min=0.0, description="height of the tower-top displacement")

    five = math.radians(5.0)
    tower_0, platform_0 = (
        c.parameter(n, five, unit="rad", display_unit="deg", description=f"{d} at the start, from the vertical")
        for n, d in (("initial_tower_angle", "tower angle"), ("initial_platform_pitch", "platform pitch"))
    )
    nacelle_0, barge_0 = (
        c.parameter(f"{d.prefix}initial_displacement", 0.0, unit="m", description="at the start, in the global frame")
        for d in (nacelle, platform)
    )
    q, v = _declare_motion(c, tower_0, platform_0, nacelle_0, barge_0)

    mass, damping, stiffness = matrices(s, nacelle, platform)
    # What depends on parameters only is evaluated once, not in every stage of the integration.
    mobility = _once(c, "mobility", ca.inv(mass))
    acceleration = -(_once(c, "stiffness", mobility @ stiffness) @ q + _once(c, "damping", mobility @ damping) @ v)
    for damper, angle, x in ((nacelle, 0, 2), (platform, 1, 3)):
        name = damper.prefix
        relative, speed = q[x] - damper.height * q[angle], v[x] - damper.height * v[angle]
        switches = damper.active * stop_switches(relative, speed, damper.stroke)  # an absent damper meets no stop
        contact = c.switch(f"{name.replace('.', '_')}contact", switches)
        stop = stop_force(relative, speed, damper.stroke, damper.k_stop, damper.c_stop, contact)
        arm = _once(c, f"{name}stop_arm", reaction * damper.height * mobility[angle, angle])
        acceleration[x] += mobility[x, x] * stop
        acceleration[angle] -= arm * stop
        c.output(
            f"{name}relative_displacement", damper.active * relative, unit="m",
            description="displacement relative to the attachment, as limited by the stroke",
        )  # fmt: skip
        c.output(f"{name}stop_force", stop, unit="N", nominal=1e4, description="force of the end stop on the damper")
    for i in range(4):
        c.derivative(q[i], v[i])
        c.derivative(v[i], acceleration[i])
    _declare_fitness(c, top * (q[0] - q[1]))
    return c


def _once(c: Component, name: str, expression: Any) -> Any:
    """An expression in parameters, possibly sparse, as internal calculated parameters."""
    values = c.calculated(name, ca.vertcat(*expression.nonzeros()), description="coefficients", internal=True)
    return ca.SX(expression.sparsity(), values)


def energies(s: Structure, nacelle: Damper, platform: Damper, q: Any, v: Any) -> tuple[Any, Any, Any]:
    """Kinetic energy and potential (eq. 3), and Rayleigh's dissipation function (eq. 4), at small angles.

    A damper slides along its body's x axis, so its height is h cos(theta) - (x - h sin(theta)) tan(theta), where h is
    the attachment's height: eq. 3, with one sign convention for both dampers.

    Args:
        q: tower angle, platform angle (rad, from the vertical), nacelle damper, platform damper (m, in the global
            frame); v: their rates.

    Returns:
        T and V in J (V not yet linearised), D in W (dissipated power is 2 D).
    """
    kinetic = (s.I_t * v[0] ** 2 + s.I_p * v[1] ** 2) / 2
    potential = (
        (s.k_t * (q[0] - q[1]) ** 2 + s.k_p * q[1] ** 2) / 2
        + s.m_t * s.gravity * s.R_t * ca.cos(q[0])
        - s.m_p * s.gravity * s.R_p * ca.cos(q[1])
    )
    dissipation = (s.d_t * (v[0] - v[1]) ** 2 + s.d_p * v[1] ** 2) / 2
    for damper, angle, x in ((nacelle, 0, 2), (platform, 1, 3)):
        h, sine = damper.height, ca.sin(q[angle])
        kinetic += damper.m * v[x] ** 2 / 2
        height = h * ca.cos(q[angle]) - (q[x] - h * sine) * ca.tan(q[angle])
        spring = damper.k * (q[x] - h * sine) ** 2 / 2
        potential += damper.active * (spring + damper.m * s.gravity * height)
        dissipation += damper.active * damper.c * (v[x] - h * v[angle]) ** 2 / 2
    return kinetic, potential, dissipation


def matrices(s: Structure, nacelle: Damper, platform: Damper) -> tuple[Any, Any, Any]:
    """Mass, damping and stiffness matrices of the motion about the upright position.

    The mass matrix is diagonal, as all coordinates are absolute; an absent damper keeps its mass there, coupled to
    nothing, so that the matrix stays regular.

    Returns:
        three symmetric 4 x 4 matrices in the order of `energies`.
    """
    q, v = ca.SX.sym("q", 4), ca.SX.sym("v", 4)
    kinetic, potential, dissipation = energies(s, nacelle, platform, q, v)
    stiffness = ca.substitute(ca.hessian(potential, q)[0], q, ca.SX.zeros(4))
    return ca.hessian(kinetic, v)[0], ca.hessian(dissipation, v)[0], stiffness


def _declare_structure(c: Component) -> Structure:
    def positive(name: str, start: float, unit: str, description: str) -> Any:
        return c.parameter(name, start, unit=unit, min=0.0, nominal=start, description=description)

    return Structure(
        I_p=positive("I_p", 4.42e9, "kg.m2", "barge's moment of inertia in pitch, with added mass"),
        k_p=positive("k_p", 4.47e9, "N.m/rad", "stiffness of barge pitch: waterplane, buoyancy and mooring"),
        d_p=positive("d_p", 1.34e8, "N.m.s/rad", "damping of barge pitch"),
        I_t=positive("I_t", 1.07e10, "kg.m2", "moment of inertia of tower and rotor-nacelle assembly"),
        k_t=positive("k_t", 3.31e10, "N.m/rad", "stiffness of the tower's hinge"),
        d_t=positive("d_t", 3.87e7, "N.m.s/rad", "damping of the tower's hinge"),
        m_p=positive("m_p", 5_452_000.0, "kg", "barge mass"),
        m_t=positive("m_t", 697_460.0, "kg", "mass of tower and rotor-nacelle assembly"),
        R_p=positive("R_p", 0.281, "m", "barge's mass centre below the reference point"),
        R_t=positive("R_t", 64.20, "m", "mass centre of tower and rotor-nacelle assembly above the reference point"),
        gravity=positive("gravity", 9.80665, "m/s2", "gravitational acceleration"),
    )


def _declare_damper(
    c: Component, prefix: str, *, m: float, k: float, d: float, stroke: float, R: float, sign: int, where: str
) -> Damper:
    mass = c.parameter(f"{prefix}m", m, unit="kg", min=1e-3, description="damper mass")
    stiffness = c.parameter(f"{prefix}k", k, unit="N/m", min=0.0, description="spring stiffness")
    damping = c.parameter(f"{prefix}c", d, unit="N.s/m", min=0.0, description="viscous damping")
    limit = c.parameter(f"{prefix}stroke", stroke, unit="m", min=0.0, description="travel to each end stop")
    k_stop = c.parameter(f"{prefix}k_stop", 5e5, unit="N/m", min=0.0, description="stop stiffness")
    c_stop = c.parameter(f"{prefix}c_stop", 5e5, unit="N.s/m", min=0.0, description="stop damping")
    distance = c.parameter(f"{prefix}R", R, unit="m", description=f"distance of the attachment {where}")
    active = c.parameter(f"{prefix}active", 1, kind="boolean", description="false: there is no such damper")
    return Damper(prefix, mass, stiffness, damping, limit, k_stop, c_stop, active, sign * distance)


def _declare_motion(c: Component, tower_0: Any, platform_0: Any, nacelle_0: Any, barge_0: Any) -> tuple[Any, Any]:
    """Generalised coordinates (eq. 2) and their rates, all absolute."""
    angle: dict[str, Any] = {"unit": "rad", "display_unit": "deg", "nominal": 0.1}
    rate: dict[str, Any] = {"unit": "rad/s", "nominal": 0.05}
    q = ca.vertcat(
        c.state("tower_angle", start=tower_0, description="tower angle from the vertical", **angle),
        c.state("platform_pitch", start=platform_0, description="platform pitch from the vertical", **angle),
        c.state(
            "nacelle_damper.displacement", unit="m", start=nacelle_0, description="displacement in the global frame"
        ),
        c.state(
            "platform_damper.displacement", unit="m", start=barge_0, description="displacement in the global frame"
        ),
    )
    v = ca.vertcat(
        c.state("tower_angular_velocity", description="rate of the tower angle", **rate),
        c.state("platform_pitch_rate", description="rate of the platform pitch", **rate),
        c.state("nacelle_damper.velocity", unit="m/s", description="velocity in the global frame"),
        c.state("platform_damper.velocity", unit="m/s", description="velocity in the global frame"),
    )
    return q, v


def _declare_fitness(c: Component, displacement: Any) -> None:
    """Running mean and standard deviation of the tower-top displacement since the start: eq. 13."""
    span = c.state("averaging_time", unit="s", description="time since the start")
    first = c.state("tower_top_displacement_integral", unit="m.s", description="integral of the displacement")
    second = c.state("tower_top_displacement_square_integral", unit="m2.s", description="integral of its square")
    c.derivative(span, 1.0)
    c.derivative(first, displacement)
    c.derivative(second, displacement**2)

    started = span > 0.0
    divisor = ca.if_else(started, span, 1.0)
    mean = ca.if_else(started, first / divisor, displacement)
    # rounding may leave a variance slightly below zero
    deviation = ca.if_else(started, ca.sqrt(ca.fmax(second / divisor - mean**2, 0.0)), 0.0)
    c.output("tower_top_displacement", displacement, unit="m", description="fore-aft, relative to the tower's base")
    c.output("tower_top_displacement_mean", mean, unit="m", description="mean of the displacement since the start")
    c.output(
        "tower_top_displacement_std", deviation, unit="m",
        description="standard deviation of the displacement since the start (eq. 13)",
    )  # fmt: skip
