"""Outputs of the barge component: motions for the other components, displacements and section loads."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from fmus_src.barge.assembly import GENERATOR, TORSION, Loads, Motion, State, shaft_axis, shaft_rotation
from fmus_src.barge.dynamics import Frame, Point, rotation
from fmus_src.barge.parameters import Parameters
from fmus_src.barge.turbine import Turbine
from fmus_src.component import Component


def declare_outputs(c: Component, turbine: Turbine, p: Parameters, loads: Loads, state: State, motion: Motion) -> None:
    """Declare every output of the component."""
    _platform(c, state, motion)
    _attachment(c, "nacelle_damper", motion, motion.tower.frame, motion.nacelle_damper)
    _attachment(c, "platform_damper", motion, motion.platform, motion.platform_damper)
    _hub(c, turbine, p, state, motion)
    _tower(c, turbine, motion)
    _blade_roots(c, turbine, p, loads, state, motion)


def _platform(c: Component, state: State, motion: Motion) -> None:
    att, (_, alpha, _) = motion.attitude, motion.body_acceleration
    for name, value, unit, words in (
        ("position", state.position, "m", "displacement of the platform reference point"),
        ("velocity", state.velocity, "m/s", "velocity of the platform reference point"),
        ("angular_velocity", att.E @ state.angle_rates, "rad/s", "angular velocity of the platform"),
        ("acceleration", motion.acceleration[:3], "m/s2", "acceleration of the platform reference point"),
        ("angular_acceleration", att.R @ alpha, "rad/s2", "angular acceleration of the platform"),
    ):
        c.output(f"platform.{name}", value, unit=unit, description=f"{words}, global")
    c.output(
        "platform.rotation", state.angles, unit="rad", display_unit="deg",
        description="roll, pitch and yaw of the platform (applied in the order yaw, pitch, roll)",
    )  # fmt: skip


def _attachment(c: Component, port: str, motion: Motion, frame: Frame, point: Point) -> None:
    whole, acceleration, to_frame = motion.whole, motion.body_acceleration, frame.axes.T
    words = "nacelle" if port.startswith("nacelle") else "platform"
    c.output(
        f"{port}.specific_force", to_frame @ whole.point_acceleration(point, acceleration), unit="m/s2", nominal=10.0,
        description=f"acceleration less gravity of the attachment, {words} frame",
    )  # fmt: skip
    c.output(
        f"{port}.angular_velocity", to_frame @ (motion.omega + frame.rate), unit="rad/s",
        description=f"angular velocity of the {words}, {words} frame",
    )  # fmt: skip
    c.output(
        f"{port}.angular_acceleration", to_frame @ whole.angular_acceleration(frame, acceleration), unit="rad/s2",
        description=f"angular acceleration of the {words}, {words} frame",
    )  # fmt: skip


def _hub(c: Component, turbine: Turbine, p: Parameters, state: State, motion: Motion) -> None:
    R, frame, apex = motion.attitude.R, motion.tower.frame, motion.apex
    orientation = R @ frame.axes @ shaft_rotation(turbine)
    velocity = state.velocity + R @ (ca.cross(motion.omega, apex.r) + apex.partial @ state.relative_rates)
    e, rates = state.relative, state.relative_rates
    c.output("hub.position", state.position + R @ apex.r, unit="m", description="rotor apex, global")
    c.output(
        "hub.orientation", ca.vec(orientation.T),
        description="shaft frame (x along the shaft downwind, y left, z up), v_global = R v_shaft, row by row",
    )  # fmt: skip
    c.output("hub.velocity", velocity, unit="m/s", description="velocity of the rotor apex, global")
    c.output(
        "hub.angular_velocity", R @ (motion.omega + frame.rate), unit="rad/s",
        description="angular velocity of the nacelle (without the rotor's spin), global",
    )  # fmt: skip
    c.output(
        "rotor.azimuth", e[GENERATOR] + e[TORSION], unit="rad", display_unit="deg",
        description="rotor azimuth, not wrapped; 0: blade 1 up",
    )  # fmt: skip
    c.output(
        "rotor.speed", rates[GENERATOR] + rates[TORSION], unit="rad/s", display_unit="rpm",
        description="rotor speed relative to the nacelle, positive about the downwind shaft axis",
    )  # fmt: skip
    c.output(
        "generator.speed", p.gear_ratio * rates[GENERATOR], unit="rad/s", display_unit="rpm",
        description="generator speed, high-speed side",
    )  # fmt: skip


def _tower(c: Component, turbine: Turbine, motion: Motion) -> None:
    tower, above, acceleration = motion.tower, motion.above, motion.body_acceleration
    for i, name in enumerate(("FA", "SS")):
        words = ("fore-aft (x)", "side-to-side (y)")[i]
        c.output(
            f"TTDsp{name}", tower.deflection[i], unit="m",
            description=f"{words} displacement of the tower top from the rigid tower, platform frame",
        )  # fmt: skip
    force, about_prp = above.support(acceleration)
    moment = about_prp - ca.cross(ca.vertcat(0, 0, turbine.tower.base_height), force)
    for i, axis in enumerate("xyz"):
        c.output(
            f"TwrBsF{axis}t", force[i], unit="N", nominal=1e6,
            description=f"force along {axis} of tower and turbine on the platform at the tower base, platform frame",
        )  # fmt: skip
    for i, axis in enumerate("xyz"):
        c.output(
            f"TwrBsM{axis}t", moment[i], unit="N.m", nominal=1e8,
            description=f"moment about {axis} of tower and turbine on the platform at the tower base, platform frame",
        )  # fmt: skip
    top = above.point_acceleration(tower.top, acceleration) + above.gravity
    imu = above.point_acceleration(motion.imu, acceleration) + above.gravity
    c.output(
        "YawBrTAxp", ca.dot(tower.frame.axes[:, 0], top), unit="m/s2",
        description="fore-aft acceleration of the tower top, along its x axis",
    )  # fmt: skip
    c.output(
        "NcIMUTAxs", ca.dot(tower.frame.axes @ shaft_axis(turbine), imu), unit="m/s2",
        description="acceleration of the nacelle's accelerometer along the shaft",
    )  # fmt: skip


def _blade_roots(c: Component, turbine: Turbine, p: Parameters, loads: Loads, state: State, motion: Motion) -> None:
    """Root moments: air load less the inertia and weight of a straight rigid blade (z along it).

    An element at distance s from the root has specific force f_apex + (R_hub + s) (alpha x z + omega x (omega x z)).
    """
    above, acceleration = motion.above, motion.body_acceleration
    to_shaft = (motion.tower.frame.axes @ shaft_rotation(turbine)).T
    at_apex = to_shaft @ above.point_acceleration(motion.apex, acceleration)
    omega = to_shaft @ (motion.omega + motion.rotor.rate)
    alpha = to_shaft @ above.angular_acceleration(motion.rotor, acceleration)
    cone = rotation(1, np.radians(turbine.rotor["precone_deg"]))
    moments = []
    for k, (_, air) in enumerate(loads.blade_roots):
        azimuth = state.relative[GENERATOR] + state.relative[TORSION] + 2 * np.pi * k / 3
        to_blade = (rotation(0, azimuth) @ cone).T
        moments.append(air + _inertia_moment(p, to_blade @ at_apex, to_blade @ omega, to_blade @ alpha))
    for k, moment in enumerate(moments):
        for i, axis in enumerate("xy"):
            c.output(
                f"RootM{axis}c{k + 1}", moment[i], unit="N.m", nominal=1e7,
                description=f"moment about {axis} of blade {k + 1} on the hub at the blade root, coned blade frame",
            )  # fmt: skip


def _inertia_moment(p: Parameters, at_apex: Any, omega: Any, alpha: Any) -> Any:
    z = ca.SX([0, 0, 1])
    per_distance = ca.cross(alpha, z) + ca.cross(omega, ca.cross(omega, z))
    return -ca.cross(z, p.blade_first_moment * at_apex + p.blade_apex_moment * per_distance)
