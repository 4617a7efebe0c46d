"""The bodies of the floating turbine assembled into equations of motion."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from fmus_src.barge.dynamics import Attitude, Balance, Frame, Point, attitude, rotation, solve
from fmus_src.barge.parameters import RELATIVE, Parameters
from fmus_src.barge.tower import TowerMotion, tower_motion
from fmus_src.barge.turbine import Turbine

GENERATOR, TORSION = RELATIVE.index("generator"), RELATIVE.index("drivetrain")


@dataclass(frozen=True)
class Loads:
    """Inputs: (force, moment) pairs, frames as in README.md, and the generator torque (high-speed side)."""

    hydro: tuple[Any, Any]
    mooring: tuple[Any, Any]
    aero: tuple[Any, Any]
    blade_roots: list[tuple[Any, Any]]
    nacelle_damper: tuple[Any, Any]
    platform_damper: tuple[Any, Any]
    generator_torque: Any


@dataclass(frozen=True)
class State:
    """Platform position and velocity (global), Euler angles and rates; relative coordinates and rates in groups."""

    position: Any
    velocity: Any
    angles: Any
    angle_rates: Any
    coordinates: list[Any]
    coordinate_rates: list[Any]

    @property
    def relative(self) -> Any:
        """All relative coordinates e in the order RELATIVE, (n,)."""
        return ca.vertcat(*self.coordinates)

    @property
    def relative_rates(self) -> Any:
        """e', (n,)."""
        return ca.vertcat(*self.coordinate_rates)


@dataclass(frozen=True)
class Motion:
    """The assembled system at an instant.

    Attributes:
        acceleration: (v_P', theta'', e''), (6 + n,); mass_matrix: of the free degrees of freedom.
        attitude: of the platform; omega: its angular velocity, body frame.
        body_acceleration: a_P, alpha (body frame) and e''.
        above: all that the tower base carries, with its loads; whole: the same with the platform.
        tower: its motion; rotor: rotation of the rotor with its spin.
        apex, nacelle_damper, imu: points of the nacelle; platform_damper: point of the platform.
    """

    acceleration: Any
    mass_matrix: Any
    attitude: Attitude
    omega: Any
    body_acceleration: tuple[Any, Any, Any]
    above: Balance
    whole: Balance
    tower: TowerMotion
    rotor: Frame
    apex: Point
    nacelle_damper: Point
    imu: Point
    platform: Frame
    platform_damper: Point


def equations_of_motion(turbine: Turbine, p: Parameters, loads: Loads, state: State) -> Motion:
    """Assemble the bodies and solve for the accelerations."""
    att = attitude(state.angles, state.angle_rates)
    to_body = att.R.T
    omega = to_body @ att.E @ state.angle_rates
    e, rates = state.relative, state.relative_rates
    n = int(e.numel())
    tower = tower_motion(turbine.tower, e, rates)
    frame, shaft = tower.frame, shaft_axis(turbine)
    ratio = p.gear_ratio
    rotor = frame.spinning(shaft, {GENERATOR: 1.0, TORSION: 1.0}, rates)
    generator = frame.spinning(shaft, {GENERATOR: ratio}, rates)
    apex = frame.point(tower.top, ca.SX(apex_offset(turbine)))
    attachment = p.nacelle_damper_position - ca.vertcat(0, 0, turbine.tower.base_height + turbine.tower.height[-1])
    nacelle_damper = frame.point(tower.top, attachment)

    above = Balance(omega, to_body @ ca.vertcat(0, 0, -p.gravity), rates)
    for point, mass in zip(tower.points, turbine.tower.mass, strict=True):
        above.add_mass(point, float(mass))
    above.add_mass(frame.point(tower.top, p.nacelle_center), p.nacelle_mass)
    above.add_inertia(frame, ca.vertcat(0, 0, p.nacelle_inertia))
    above.add_mass(frame.point(apex, shaft * p.rotor_center), p.rotor_mass)
    above.add_axisymmetric(rotor, shaft, p.rotor_axial_inertia, p.rotor_diametral_inertia)
    above.add_axisymmetric(generator, shaft, p.generator_inertia, 0)
    above.add_force(apex, to_body @ loads.aero[0])
    above.add_moment(rotor, to_body @ loads.aero[1])
    above.add_force(nacelle_damper, frame.axes @ loads.nacelle_damper[0])
    above.add_moment(frame, frame.axes @ loads.nacelle_damper[1])
    above.add_internal(_internal_forces(p, loads, e, rates))

    whole = above.copy()
    platform = Frame(ca.SX.eye(3), ca.SX(3, n), ca.SX.zeros(3), ca.SX.zeros(3))
    fixed = [Point(r, ca.SX(3, n), ca.SX.zeros(3)) for r in (p.platform_center, p.platform_damper_position)]
    whole.add_mass(fixed[0], p.platform_mass)
    whole.add_inertia(platform, p.platform_inertia)
    whole.add_force(fixed[1], loads.platform_damper[0])
    whole.add_moment(platform, loads.platform_damper[1])
    at_prp = (loads.hydro[0] + loads.mooring[0], loads.hydro[1] + loads.mooring[1])
    acceleration, mass_matrix = solve(whole, att, p.added_mass, at_prp, p.free)
    alpha = to_body @ (att.E @ acceleration[3:6] + att.bias)
    return Motion(
        acceleration=acceleration, mass_matrix=mass_matrix, attitude=att, omega=omega,
        body_acceleration=(to_body @ acceleration[:3], alpha, acceleration[6:]),
        above=above, whole=whole, tower=tower, rotor=rotor, apex=apex, nacelle_damper=nacelle_damper,
        imu=frame.point(tower.top, ca.SX(turbine.nacelle["imu"])), platform=platform, platform_damper=fixed[1],
    )  # fmt: skip


def shaft_rotation(turbine: Turbine) -> Any:
    """Axes of the shaft (x downwind along it, y left, z up) in the nacelle, (3, 3)."""
    return rotation(1, -np.radians(turbine.rotor["shaft_tilt_deg"]))


def shaft_axis(turbine: Turbine) -> Any:
    """Unit vector along the shaft, downwind, nacelle frame, (3,)."""
    return shaft_rotation(turbine)[:, 0]


def apex_offset(turbine: Turbine) -> Any:
    """Rotor apex from the tower top, nacelle frame, m, (3,)."""
    shaft_origin = ca.SX([0, 0, turbine.nacelle["tower_top_to_shaft"]])
    return shaft_origin + turbine.rotor["overhang"] * shaft_axis(turbine)


def _internal_forces(p: Parameters, loads: Loads, e: Any, rates: Any) -> Any:
    """Generalised forces of tower bending, generator torque, and drivetrain torsion.

    The generator's torque works on the high-speed shaft's speed relative to the nacelle, so that its reaction on
    the nacelle needs no term of its own.
    """
    q, p_side, torsion = e[:2], e[2:4], e[TORSION]
    return ca.vertcat(
        -p.stiffness_fore_aft @ q - p.damping_fore_aft @ rates[:2],
        -p.stiffness_side @ p_side - p.damping_side @ rates[2:4],
        -p.gear_ratio * loads.generator_torque,
        -p.shaft_stiffness * torsion - p.shaft_damping * rates[TORSION],
    )
