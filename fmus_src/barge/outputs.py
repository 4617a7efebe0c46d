"""Outputs of the barge component: motions for the other components, displacements and section loads."""

from __future__ import annotations

from typing import Any

import casadi as ca

from fmus_src.barge.assembly import GENERATOR, TORSION, Loads, Motion, State
from fmus_src.barge.blade import blade_matrices
from fmus_src.barge.dynamics import RigidMotion
from fmus_src.barge.parameters import Parameters
from fmus_src.barge.turbine import Turbine
from fmus_src.component import Component


def declare_outputs(c: Component, turbine: Turbine, p: Parameters, loads: Loads, state: State, motion: Motion) -> None:
    """Declare every output of the component."""
    height = turbine.tower.base_height + turbine.tower.length
    nacelle_damper = motion.nacelle.axes @ (p.nacelle_damper_position - ca.vertcat(0, 0, height))
    _platform(c, state, motion)
    _attachment(c, "nacelle_damper", "nacelle", state, motion, motion.nacelle, nacelle_damper)
    _attachment(c, "platform_damper", "platform", state, motion, motion.platform, p.platform_damper_position)
    _hub(c, state, motion)
    _spin(c, p, state)
    _tower(c, turbine, p, state, motion)
    _sections(c, turbine, motion)
    _blades(c, turbine, loads, state, motion)


def _platform(c: Component, state: State, motion: Motion) -> None:
    R = motion.attitude.R
    for name, value, unit, words in (
        ("position", state.position, "m", "displacement of the platform reference point"),
        ("velocity", state.velocity, "m/s", "velocity of the platform reference point"),
        ("angular_velocity", R @ motion.platform.omega, "rad/s", "angular velocity of the platform"),
        ("acceleration", motion.acceleration[:3], "m/s2", "acceleration of the platform reference point"),
        ("angular_acceleration", R @ motion.platform.alpha, "rad/s2", "angular acceleration of the platform"),
    ):
        c.output(f"platform.{name}", value, unit=unit, description=f"{words}, global")
    c.output(
        "platform.rotation", state.angles, unit="rad", display_unit="deg",
        description="roll, pitch and yaw of the platform (applied in the order yaw, pitch, roll)",
    )  # fmt: skip


def _relative_velocity(motion: Motion, body: RigidMotion, arm: Any) -> Any:
    """Velocity of a body's point at `arm` relative to the platform reference point, platform axes, m/s.

    The platform turns the position of the body's reference point, the body (tower and yaw included) the arm.
    """
    return body.velocity + ca.cross(motion.platform.omega, body.r) + ca.cross(body.omega, arm)


def _attachment(c: Component, port: str, words: str, state: State, motion: Motion, body: RigidMotion, arm: Any) -> None:
    to_body = body.axes.T
    velocity = motion.attitude.R.T @ state.velocity + _relative_velocity(motion, body, arm)
    for name, value, unit, text in (
        ("velocity", velocity, "m/s", "velocity of the attachment"),
        ("specific_force", body.at(arm), "m/s2", "acceleration less gravity of the attachment"),
        ("angular_velocity", body.omega, "rad/s", f"angular velocity of the {words}"),
        ("angular_acceleration", body.alpha, "rad/s2", f"angular acceleration of the {words}"),
    ):
        nominal = 10.0 if name == "specific_force" else None
        c.output(f"{port}.{name}", to_body @ value, unit=unit, nominal=nominal, description=f"{text}, {words} frame")


def _hub(c: Component, state: State, motion: Motion) -> None:
    R, nacelle, arm = motion.attitude.R, motion.nacelle, motion.apex
    c.output("hub.position", state.position + R @ (nacelle.r + arm), unit="m", description="rotor apex, global")
    c.output(
        "hub.orientation", ca.vec((R @ motion.shaft).T),
        description="shaft frame (x along the shaft downwind, y left, z up), v_global = R v_shaft, row by row",
    )  # fmt: skip
    c.output(
        "hub.velocity", state.velocity + R @ _relative_velocity(motion, nacelle, arm), unit="m/s",
        description="velocity of the rotor apex, global",
    )  # fmt: skip
    c.output(
        "hub.angular_velocity", R @ nacelle.omega, unit="rad/s",
        description="angular velocity of the nacelle (without the rotor's spin), global",
    )  # fmt: skip


def _spin(c: Component, p: Parameters, state: State) -> None:
    e, rates = state.relative, state.relative_rates
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


def _tower(c: Component, turbine: Turbine, p: Parameters, state: State, motion: Motion) -> None:
    modes = "of the tower's modes fore-aft 1, 2, side-to-side 1, 2"
    c.output("tower.deflection", state.relative[:4], unit="m", description=f"deflections {modes}")
    c.output("tower.deflection_rate", state.relative_rates[:4], unit="m/s", description=f"rates {modes}")
    for i, name in enumerate(("FA", "SS")):
        words = ("fore-aft (x)", "side-to-side (y)")[i]
        c.output(
            f"TTDsp{name}", motion.tower.deflection[i], unit="m",
            description=f"{words} displacement of the tower top from the rigid tower, platform frame",
        )  # fmt: skip
    gravity = motion.attitude.R.T @ ca.vertcat(0, 0, -p.gravity)
    nacelle = motion.nacelle
    imu = nacelle.at(nacelle.axes @ ca.SX(turbine.nacelle["imu"])) + gravity
    c.output(
        "YawBrTAxp", ca.dot(motion.tower.axes[:, 0], nacelle.specific_force + gravity), unit="m/s2",
        description="fore-aft acceleration of the tower top, along its x axis",
    )  # fmt: skip
    c.output(
        "NcIMUTAxs", ca.dot(motion.shaft[:, 0], imu), unit="m/s2",
        description="acceleration of the nacelle's accelerometer along the shaft",
    )  # fmt: skip


def _sections(c: Component, turbine: Turbine, motion: Motion) -> None:
    """Loads of what is carried on what carries it: at the tower base, the yaw bearing and the rotor apex."""
    base, top_axes = ca.SX([0, 0, turbine.tower.base_height]), motion.tower.axes
    for port, suffix, point, axes, load, words in (
        ("TwrBs", "t", base, ca.SX.eye(3), motion.tower_base,
         "tower and turbine on the platform at the tower base, platform frame"),
        ("YawBr", "p", motion.nacelle.r, top_axes, motion.yaw_bearing,
         "nacelle and rotor on the tower top, frame of the tower top (without yaw)"),
    ):  # fmt: skip
        force, about_prp = load
        _vector(c, f"{port}F{{}}{suffix}", "xyz", axes.T @ force, "N", 1e6, f"force along {{}} of {words}")
        moment = axes.T @ (about_prp - ca.cross(point, force))
        _vector(c, f"{port}M{{}}{suffix}", "xyz", moment, "N.m", 1e8, f"moment about {{}} of {words}")
    force, moment = motion.rotor
    axis = motion.shaft[:, 0]
    c.output(
        "RotThrust", ca.dot(axis, force), unit="N", nominal=1e6,
        description="force of the rotor on the shaft along it, downwind: air, weight and inertia",
    )  # fmt: skip
    c.output(
        "RotTorq", ca.dot(axis, moment), unit="N.m", nominal=1e6,
        description="torsion moment of the low-speed shaft at the rotor: air, weight and inertia",
    )  # fmt: skip


def _blades(c: Component, turbine: Turbine, loads: Loads, state: State, motion: Motion) -> None:
    tip, radius = ca.SX(blade_matrices(turbine.blade).tip), turbine.blade.hub_radius
    for k, (q, rates) in enumerate(zip(state.blades, state.blade_rates, strict=True), start=1):
        of = f"of blade {k}"
        c.output(f"blade{k}.deflection", q, unit="m", description=f"deflections {of}: flap 1, flap 2, edge 1")
        c.output(f"blade{k}.deflection_rate", rates, unit="m/s", description=f"rates of the deflections {of}")
        to_coned = motion.pitch_turns[k - 1]
        bent = to_coned[:2, :2] @ tip @ q
        for name, value, words in (("OoP", bent[0], "out of plane (x)"), ("IP", bent[1], "in plane (y)")):
            c.output(f"{name}Defl{k}", value, unit="m", description=f"tip deflection {of} {words}, coned blade frame")
        air, air_moment = loads.blade_roots[k - 1]
        force, about_apex = (to_coned @ v for v in motion.roots[k - 1])
        moment = about_apex - ca.cross(ca.SX([0, 0, radius]), force)
        words = f"{of} on the hub at the blade root, coned blade frame"
        _vector(c, f"RootF{{}}c{k}", "xyz", force + air, "N", 1e6, f"force along {{}} {words}")
        _vector(c, f"RootM{{}}c{k}", "xy", moment + air_moment, "N.m", 1e7, f"moment about {{}} {words}")


def _vector(c: Component, name: str, axes: str, value: Any, unit: str, nominal: float, words: str) -> None:
    """Scalar outputs, one for each axis; its letter goes into name and description."""
    for i, axis in enumerate(axes):
        c.output(name.format(axis), value[i], unit=unit, nominal=nominal, description=words.format(axis))
