"""Waves and potential flow on the barge: hydrostatics, radiation memory, wave excitation, viscous drag.

Linear theory about the mean position, as HydroDyn's (Jonkman, NREL/TP-500-41958, 2007, section 2.3); all loads at the
platform reference point (PRP) and in global axes. The force -A_inf * acceleration is NOT in the outputs: it belongs to
the barge's mass matrix (its parameter is `database.load(variant).added_mass_infinite`). Neither is the weight.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
import numpy.typing as npt

from fmus_src.component import Component
from fmus_src.hydro import excitation, waves
from fmus_src.hydro.database import HydroDatabase, load, wave_number
from fmus_src.hydro.radiation import radiation_model

Array = npt.NDArray[np.float64]

COMPONENTS = 360  # of the irregular sea
DRAFT = 4.0  # m, length of the drag member, from the keel to mean sea level
# Three Gauss points (position over the draft, share of it) integrate the drag over depth.
GAUSS = tuple((DRAFT * (-0.5 + 0.5 * x), 0.5 * w) for x, w in zip(*np.polynomial.legendre.leggauss(3), strict=True))


@dataclass(frozen=True)
class _Motion:
    """Inputs: position (m) and velocity (m/s) of the PRP, roll, pitch, yaw (rad), angular velocity (rad/s)."""

    position: Any
    rotation: Any
    velocity: Any
    angular_velocity: Any


@dataclass(frozen=True)
class _Train:
    """Loads and kinematics of a train of waves at time t: all linear in a cos(w t + e) and a sin(w t + e)."""

    elevation: Any
    loads: Any  # (6,), N and N m
    along: list[Any]  # horizontal water velocity along the heading at the Gauss points, m/s
    up: list[Any]  # vertical one


def component(variant: str = "closed", sea: waves.WaveComponents | None = None) -> Component:
    """The barge's hydrodynamics.

    Args:
        variant: database: "closed" box or open "moonpool".
        sea: a given sea (elevation at x = y = 0) in place of the irregular one from Hs, Tp, gamma and seed.

    Raises:
        ValueError: unknown variant, or a given sea outside the database's frequencies.
    """
    c = Component("hydro", "Waves, hydrostatics, radiation and viscous drag of the barge", symbols="MX")
    database = load(variant)
    heading = c.parameter("heading", 0.0, unit="rad", display_unit="deg", description="direction the waves travel to")
    irregular = _irregular(c, database, heading) if sea is None else _given(c, database, heading, sea)
    regular = _regular(c, database, heading)
    motion = _motion(c)
    static = _hydrostatics(c, database, motion)
    memory = _radiation(c, variant, motion)
    loads = static + memory + irregular.loads + regular.loads
    along = [a + b for a, b in zip(irregular.along, regular.along, strict=True)]
    up = [a + b for a, b in zip(irregular.up, regular.up, strict=True)]
    drag_force, drag_moment = _drag(c, database, motion, heading, along, up)
    c.output("force", loads[:3] + drag_force, unit="N", nominal=1e6, description="force on the barge, global frame")
    c.output(
        "moment", loads[3:] + drag_moment, unit="N.m", nominal=1e7,
        description="moment on the barge about the platform reference point, global frame",
    )  # fmt: skip
    c.output(
        "wave_elevation", irregular.elevation + regular.elevation, unit="m", description="wave elevation at x = y = 0"
    )
    return c


def _motion(c: Component) -> _Motion:
    return _Motion(
        c.input("platform.position", 3, unit="m", description="platform reference point, global frame"),
        c.input("platform.rotation", 3, unit="rad", display_unit="deg", description="roll, pitch, yaw; R = Rz Ry Rx"),
        c.input("platform.velocity", 3, unit="m/s", description="velocity of the reference point, global frame"),
        c.input("platform.angular_velocity", 3, unit="rad/s", description="angular velocity, global frame"),
    )


def _hydrostatics(c: Component, database: HydroDatabase, motion: _Motion) -> Any:
    """Buoyancy at rest and linear restoring; roll and pitch turn with the yawed barge, so that no work is gained."""
    weight = database.density * database.gravity
    volume = c.parameter(
        "displaced_volume", database.volume, unit="m3", min=0.0, description="displaced volume at rest"
    )
    heave = c.parameter(
        "heave_stiffness", database.stiffness[2, 2], unit="N/m", min=0.0, description="waterplane stiffness C33"
    )
    pitch = c.parameter(
        "pitch_stiffness", database.stiffness[4, 4], unit="N.m/rad",
        description="C44 = C55: waterplane and buoyancy parts, without the weight's",
    )  # fmt: skip
    cos, sin = ca.cos(motion.rotation[2]), ca.sin(motion.rotation[2])
    roll_moment, pitch_moment = -pitch * motion.rotation[0], -pitch * motion.rotation[1]
    return ca.vertcat(
        0, 0, weight * volume - heave * motion.position[2],
        cos * roll_moment - sin * pitch_moment, sin * roll_moment + cos * pitch_moment, 0,
    )  # fmt: skip


def _radiation(c: Component, variant: str, motion: _Motion) -> Any:
    """Radiation memory -c x of the fitted state-space model."""
    model = radiation_model(variant)
    active = c.parameter(
        "radiation_memory", 1.0, kind="boolean", description="0: infinite-frequency added mass only (no memory)"
    )
    # States are scaled to the order of a metre per second times a second.
    x = c.state("radiation_state", len(model.a), description="state of the radiation memory")
    a, b, out = (ca.sparsify(ca.DM(m)) for m in (model.a, model.b, model.c))
    velocity = ca.vertcat(motion.velocity, motion.angular_velocity)
    c.derivative(x, ca.mtimes(a, x) + ca.mtimes(b, velocity))
    return -active * ca.mtimes(out, x)


def _irregular(c: Component, database: HydroDatabase, heading: Any) -> _Train:
    """The JONSWAP sea."""
    hs = c.parameter("Hs", 4.0, unit="m", min=0.0, description="significant wave height; 0: still water")
    tp = c.parameter("Tp", 12.5, unit="s", min=4.0, max=25.0, description="peak period")
    gamma = c.parameter("gamma", 0.0, min=0.0, max=10.0, description="peak enhancement; 0: formula of IEC 61400-3")
    seed = c.parameter("seed", 1, kind="integer", min=0, max=2**31 - 1, description="seed of the random phases")
    omega, width = waves.frequency_cells(COMPONENTS)
    enhancement = ca.if_else(gamma > 0, ca.fmax(gamma, 1e-3), waves.peak_enhancement(hs, tp))
    amplitude = c.calculated(
        "wave.amplitude", waves.amplitudes(omega, width, hs, tp, enhancement), unit="m", internal=True,
        description="of the components",
    )  # fmt: skip
    phase = c.calculated(
        "wave.phase", waves.phases(seed, COMPONENTS), unit="rad", internal=True,
        description="e in cos(w t + e) at x = y = 0",
    )  # fmt: skip
    return _spectrum(c, database, heading, omega, amplitude, phase)


def _given(c: Component, database: HydroDatabase, heading: Any, sea: waves.WaveComponents) -> _Train:
    amplitude = c.parameter("wave.amplitude", sea.amplitude, unit="m", description="of the components")
    phase = c.parameter("wave.phase", sea.phase, unit="rad", description="e in cos(w t + e) at x = y = 0")
    return _spectrum(c, database, heading, sea.omega, amplitude, phase)


def _spectrum(c: Component, database: HydroDatabase, heading: Any, omega: Array, amplitude: Any, phase: Any) -> _Train:
    """Waves of frequencies known when the component is built."""
    angle = ca.DM(omega) * c.time + phase
    cosine, sine = amplitude * ca.cos(angle), amplitude * ca.sin(angle)
    # Summing the waves into the spline's basis first takes four products a wave instead of twelve, and few parameters.
    basis = ca.sparsify(ca.DM(excitation.spline_basis(database, omega).toarray().T))
    cosine_sums, sine_sums = ca.mtimes(basis, cosine), ca.mtimes(basis, sine)
    loads = []
    for dof, name in enumerate(excitation.DOFS):
        sum_over_heading = excitation.harmonics(dof, heading, len(database.heading))
        points = excitation.control_points(database, dof)
        real, imag = (
            c.calculated(
                f"wave.{name}_{part}", ca.mtimes(ca.DM(values), sum_over_heading), unit="N/m" if dof < 3 else "N",
                internal=True,
                description=f"{part} part of the {name} excitation (lead positive): spline over frequency",
            )
            for part, values in (("real", points.real), ("imaginary", points.imag))
        )  # fmt: skip
        loads.append(ca.dot(real, cosine_sums) - ca.dot(imag, sine_sums))
    k = ca.DM(wave_number(omega, database.depth, database.gravity))
    along, up = [], []
    for z, _ in GAUSS:
        horizontal, vertical = waves.depth_profiles(k, z, database.depth)
        along.append(ca.dot(ca.DM(omega) * horizontal, cosine))
        up.append(-ca.dot(ca.DM(omega) * vertical, sine))
    return _Train(ca.sum1(cosine), ca.vertcat(*loads), along, up)


def _regular(c: Component, database: HydroDatabase, heading: Any) -> _Train:
    """A regular wave added to the sea."""
    amplitude = c.parameter("regular_wave.amplitude", 0.0, unit="m", min=0.0, description="0: no regular wave")
    period = c.parameter(
        "regular_wave.period", 12.5, unit="s", min=2.1, max=125.0, description="period of the regular wave"
    )
    phase = c.parameter("regular_wave.phase", 0.0, unit="rad", description="e in cos(w t + e) at x = y = 0")
    omega = 2.0 * ca.pi / period
    terms: list[Any] = []
    for dof in range(6):
        sum_over_heading = excitation.harmonics(dof, heading, len(database.heading))
        real, imag = excitation.at_frequency(database, dof, omega)
        terms += [ca.dot(real, sum_over_heading), ca.dot(imag, sum_over_heading)]
    per_metre = c.calculated(
        "regular_wave.excitation", ca.vertcat(*terms),
        description="real and imaginary parts of the excitation per metre of amplitude, surge to yaw, N/m and N",
    )  # fmt: skip
    k = c.calculated(
        "regular_wave.number", waves.dispersion(omega, database.depth, database.gravity), unit="rad/m",
        description="wave number",
    )  # fmt: skip
    angle = omega * c.time + phase
    cosine, sine = amplitude * ca.cos(angle), amplitude * ca.sin(angle)
    loads = ca.vertcat(*[per_metre[2 * i] * cosine - per_metre[2 * i + 1] * sine for i in range(6)])
    profiles = [waves.depth_profiles(k, z, database.depth) for z, _ in GAUSS]
    return _Train(
        cosine, loads, [omega * h * cosine for h, _ in profiles], [-omega * v * sine for _, v in profiles]
    )  # fmt: skip


def _drag(
    c: Component, database: HydroDatabase, motion: _Motion, heading: Any, along: list[Any], up: list[Any]
) -> tuple[Any, Any]:
    """Morison drag on a vertical circular member: force (3,) and moment about the PRP (3,).

    Only the relative velocity normal to the member counts (Jonkman 2007, eq. 2-28), with the water's at the undisplaced
    position.
    """
    coefficient = c.parameter("drag_coefficient", 1.0, min=0.0, description="transverse drag coefficient", tunable=True)
    diameter = c.parameter("drag_diameter", 45.1352, unit="m", min=0.0, description="diameter of the drag member")
    factor = 0.5 * database.density * coefficient * diameter * DRAFT
    sines, cosines = ca.sin(motion.rotation), ca.cos(motion.rotation)
    # Third column of Rz Ry Rx: the platform's z axis.
    axis = ca.vertcat(
        cosines[2] * sines[1] * cosines[0] + sines[2] * sines[0],
        sines[2] * sines[1] * cosines[0] - cosines[2] * sines[0],
        cosines[1] * cosines[0],
    )
    force, moment = ca.MX.zeros(3), ca.MX.zeros(3)
    for (z, share), horizontal, vertical in zip(GAUSS, along, up, strict=True):
        arm = z * axis
        water = ca.vertcat(ca.cos(heading) * horizontal, ca.sin(heading) * horizontal, vertical)
        relative = water - motion.velocity - ca.cross(motion.angular_velocity, arm)
        normal = relative - ca.dot(relative, axis) * axis
        # The small term keeps the derivative finite where the relative velocity vanishes.
        part = factor * share * ca.sqrt(ca.sumsqr(normal) + 1e-12) * normal
        force += part
        moment += ca.cross(arm, part)
    return force, moment
