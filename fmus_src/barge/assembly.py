"""The bodies of the floating turbine assembled into equations of motion."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca

from fmus_src.barge.dynamics import Accelerations, Attitude, Balance, Joint, Load, RigidMotion, attitude, solve
from fmus_src.barge.elastic import Inertia, disc_inertia, elastic_inertia, point_inertia
from fmus_src.barge.parameters import RELATIVE, Parameters
from fmus_src.barge.rotor import BladeMotion, blade_axes, blade_motion, rotor_body
from fmus_src.barge.tower import MODES, TowerTop, tower_top
from fmus_src.barge.turbine import Turbine

YAW, GENERATOR, TORSION = (RELATIVE.index(name) for name in ("nacelle_yaw", "generator", "drivetrain"))


@dataclass(frozen=True)
class Loads:
    """Inputs: (force, moment) pairs, frames as in README.md.

    Attributes:
        tower: of the air on the tower; tower_modal: its modal forces, (4,).
        blade_roots: air load about each blade root; modal: air's modal forces of each blade, (3,).
        generator_torque: high-speed side; pitch: of the blades towards feather, (3,); added_mass: (6, 6).
    """

    hydro: tuple[Any, Any]
    mooring: tuple[Any, Any]
    aero: tuple[Any, Any]
    tower: tuple[Any, Any]
    tower_modal: Any
    blade_roots: list[tuple[Any, Any]]
    modal: list[Any]
    nacelle_damper: tuple[Any, Any]
    platform_damper: tuple[Any, Any]
    generator_torque: Any
    pitch: Any
    added_mass: Any


@dataclass(frozen=True)
class State:
    """Platform position and velocity (global), Euler angles and rates; relative coordinates and blade modes.

    Attributes:
        groups, group_rates: of the relative coordinates, in the order RELATIVE; blades, blade_rates: (3,) each.
    """

    position: Any
    velocity: Any
    angles: Any
    angle_rates: Any
    groups: list[Any]
    group_rates: list[Any]
    blades: list[Any]
    blade_rates: list[Any]

    @property
    def relative(self) -> Any:
        """All relative coordinates e in the order RELATIVE, (n,)."""
        return ca.vertcat(*self.groups)

    @property
    def relative_rates(self) -> Any:
        """e', (n,)."""
        return ca.vertcat(*self.group_rates)


@dataclass(frozen=True)
class Motion:
    """The assembled system at an instant.

    Attributes:
        acceleration: (v_P', theta'', e''), (6 + n,); blade_accelerations: q'' of each blade, (3,).
        attitude: of the platform; platform: its motion; nacelle: its motion, at the tower top.
        tower: motion of the tower's top; apex: the rotor apex from the tower top, platform axes.
        shaft: axes of the shaft frame, platform frame, (3, 3).
        yaw_bearing, tower_base: force and moment about the platform reference point on what is below.
        rotor: force and moment about the apex that the rotor passes to the shaft, platform axes.
        roots: force and moment about the apex of each blade on the hub, less the air's, its pitched frame.
        pitch_turns: v_coned = pitch_turn v_pitched of each blade, (3, 3).
    """

    acceleration: Any
    blade_accelerations: list[Any]
    attitude: Attitude
    platform: RigidMotion
    nacelle: RigidMotion
    tower: TowerTop
    apex: Any
    shaft: Any
    yaw_bearing: tuple[Any, Any]
    tower_base: tuple[Any, Any]
    rotor: tuple[Any, Any]
    roots: list[tuple[Any, Any]]
    pitch_turns: list[Any]


@dataclass(frozen=True)
class _Rotor:
    """Hub and blades: the nacelle's and the hub's known motion; inertia and load about the apex."""

    nacelle: RigidMotion
    hub: RigidMotion
    arm: Any
    shaft: Any
    blades: list[BladeMotion]
    inertia: Inertia
    load: Load

    @property
    def axis(self) -> Any:
        return self.shaft[:, 0]


def equations_of_motion(turbine: Turbine, p: Parameters, loads: Loads, state: State) -> Motion:
    """Assemble the bodies and solve for the accelerations."""
    att = attitude(state.angles, state.angle_rates)
    omega = att.E @ state.angle_rates
    e, rates = state.relative, state.relative_rates
    tower = tower_top(turbine.tower, e, rates, YAW)
    top = Balance(omega, att.R.T @ ca.vertcat(0, 0, -p.gravity), rates)
    rotor = _rotor(turbine, p, loads, state, top.known_motion(tower.nacelle), att)
    _add_nacelle(turbine, p, loads, tower.nacelle, rotor, top)
    top.add_internal(_internal_forces(p, loads, e, rates))
    above = top.copy()
    base = ca.SX([0, 0, turbine.tower.base_height])
    above.add_elastic(elastic_inertia(turbine.tower.integrals, e[:MODES], rates[:MODES], omega), base, 0)
    on_tower = ca.vertcat(loads.tower_modal, ca.SX(int(e.numel()) - MODES, 1))
    above.add_external(att.R.T @ loads.tower[0], att.R.T @ loads.tower[1], on_tower)
    whole = above.copy()
    ground = _add_platform(p, loads, whole)
    at_prp = (loads.hydro[0] + loads.mooring[0], loads.hydro[1] + loads.mooring[1])
    acceleration = solve(whole, att, loads.added_mass, at_prp, p.free)
    x = Accelerations(att.R.T @ acceleration[:3], att.E @ acceleration[3:6] + att.bias, acceleration[6:])
    return _motion(
        att, tower, rotor, (top, above), whole.motion(ground, whole.known_motion(ground), x), x, acceleration
    )


def _rotor(turbine: Turbine, p: Parameters, loads: Loads, state: State, nacelle: RigidMotion, att: Attitude) -> _Rotor:
    shaft = nacelle.axes @ ca.SX(turbine.shaft_frame)
    axis, arm = shaft[:, 0], nacelle.axes @ ca.SX(turbine.apex)
    e, rates = state.relative, state.relative_rates
    hub = nacelle.spinning(arm, axis, rates[GENERATOR] + rates[TORSION])
    blades = [
        blade_motion(p.blade, *of_blade)
        for of_blade in zip(
            blade_axes(shaft, e[GENERATOR] + e[TORSION], turbine.cone, loads.pitch),
            [hub] * len(state.blades), state.blades, state.blade_rates, loads.modal, strict=True,
        )
    ]  # fmt: skip
    inertia, load = rotor_body(blades)
    inertia += point_inertia(p.hub_mass, ca.SX(3, 1)) + disc_inertia(p.hub_inertia, axis)
    load.add(-p.hub_mass * hub.specific_force, -_disc_torque(p.hub_inertia, axis, hub))
    load.add(att.R.T @ loads.aero[0], att.R.T @ loads.aero[1])
    return _Rotor(nacelle, hub, arm, shaft, blades, inertia, load)


def _add_nacelle(turbine: Turbine, p: Parameters, loads: Loads, joint: Joint, rotor: _Rotor, top: Balance) -> None:
    """Nacelle, generator and rotor as one body at the tower top, with the rotor's and the generator's spin."""
    nacelle, axes, axis = rotor.nacelle, rotor.nacelle.axes, rotor.axis
    center, upright = axes @ p.nacelle_center, axes[:, 2]
    generator = nacelle.spinning(rotor.arm, axis, p.gear_ratio * top.rates[GENERATOR])
    generator_torque = _disc_torque(p.generator_inertia, axis, generator)
    inertia = point_inertia(p.nacelle_mass, center) + disc_inertia(p.nacelle_inertia, upright)
    inertia += disc_inertia(p.generator_inertia, axis) + rotor.inertia.about(rotor.arm)
    load = Load(ca.SX(3, 1), -_disc_torque(p.nacelle_inertia, upright, nacelle) - generator_torque)
    load.add(-p.nacelle_mass * nacelle.at(center), 0, center)
    load.add(rotor.load.force, rotor.load.moment, rotor.arm)
    attachment = p.nacelle_damper_position - ca.vertcat(0, 0, turbine.tower.base_height + turbine.tower.length)
    load.add(axes @ loads.nacelle_damper[0], axes @ loads.nacelle_damper[1], axes @ attachment)
    top.add_body(joint, inertia, load)

    force, moment = rotor.inertia.load(ca.SX(3, 1), axis)
    reaction = Load(ca.SX(3, 1), ca.SX(3, 1))
    reaction.add(force, moment, rotor.arm)
    spin = {GENERATOR: 1.0, TORSION: 1.0}
    top.add_spin(joint, spin, reaction, ca.dot(axis, moment), ca.dot(axis, rotor.load.moment))
    reaction = Load(ca.SX(3, 1), p.generator_inertia * axis)
    top.add_spin(joint, {GENERATOR: p.gear_ratio}, reaction, p.generator_inertia, -ca.dot(axis, generator_torque))


def _add_platform(p: Parameters, loads: Loads, whole: Balance) -> Joint:
    n = int(whole.rates.numel())
    joint = Joint(ca.SX.eye(3), ca.SX(3, 1), ca.SX(3, n), ca.SX(3, n), ca.SX(3, 1), ca.SX(3, 1))
    known, center = whole.known_motion(joint), p.platform_center
    inertia = point_inertia(p.platform_mass, center)
    spin = p.platform_inertia * whole.omega
    load = Load(ca.SX(3, 1), -ca.cross(whole.omega, spin))
    load.add(-p.platform_mass * known.at(center), 0, center)
    load.add(*loads.platform_damper, p.platform_damper_position)
    inertia += Inertia(ca.SX(3, 3), ca.SX(3, 3), ca.diag(p.platform_inertia))
    whole.add_body(joint, inertia, load)
    return joint


def _motion(
    att: Attitude, tower: TowerTop, rotor: _Rotor, sections: tuple[Balance, Balance], platform: RigidMotion,
    x: Accelerations, acceleration: Any,
) -> Motion:  # fmt: skip
    """Motions and section loads for the accelerations found."""
    top, above = sections
    nacelle = top.motion(tower.nacelle, rotor.nacelle, x)
    speed_rate = x.relative[GENERATOR] + x.relative[TORSION]
    a = nacelle.at(rotor.arm) - rotor.hub.specific_force
    alpha = nacelle.alpha - rotor.nacelle.alpha + rotor.axis * speed_rate
    force, moment = rotor.inertia.load(a, alpha)
    return Motion(
        acceleration=acceleration,
        blade_accelerations=[blade.accelerations(a, alpha) for blade in rotor.blades],
        attitude=att, platform=platform, nacelle=nacelle, tower=tower, apex=rotor.arm,
        shaft=rotor.shaft, yaw_bearing=top.support(x), tower_base=above.support(x),
        rotor=(rotor.load.force - force, rotor.load.moment - moment),
        roots=[blade.on_hub(a, alpha) for blade in rotor.blades],
        pitch_turns=[blade.pitch_turn for blade in rotor.blades],
    )  # fmt: skip


def _disc_torque(inertia: Any, axis: Any, motion: RigidMotion) -> Any:
    """Rate of angular momentum of a body that resists rotation about one axis only."""
    along = ca.dot(axis, motion.omega)
    return inertia * (axis * ca.dot(axis, motion.alpha) + along * ca.cross(motion.omega, axis))


def _internal_forces(p: Parameters, loads: Loads, e: Any, rates: Any) -> Any:
    """Generalised forces of tower bending, yaw drive, generator torque, and drivetrain torsion.

    The generator's torque works on the high-speed shaft's speed relative to the nacelle, so that its reaction on
    the nacelle needs no term of its own.
    """
    q, p_side = e[:2], e[2:4]
    return ca.vertcat(
        -p.stiffness_fore_aft @ q - p.damping_fore_aft @ rates[:2],
        -p.stiffness_side @ p_side - p.damping_side @ rates[2:4],
        -p.yaw_stiffness * e[YAW] - p.yaw_damping * rates[YAW],
        -p.gear_ratio * loads.generator_torque,
        -p.shaft_stiffness * e[TORSION] - p.shaft_damping * rates[TORSION],
    )
