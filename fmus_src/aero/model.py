"""Rotor aerodynamics: blade elements, momentum theory with dynamic inflow, turbulent or steady wind.

Sources: Hansen, "Aerodynamics of Wind Turbines", 2nd ed. (2008), chapters 6 and 9; treatment of stations, skewed wake
and three-quarter-chord angle of attack as AeroDyn (Moriarty & Hansen, NREL/TP-500-36881, 2005; OpenFAST documentation).

Frames. Shaft: x along the shaft, downwind; z up at rest; not rotating. Blade ("c"): z along the blade axis outwards, x
downwind, y completing a right-handed frame (towards the trailing edge), coned but not pitched.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from fmus_src.aero.geometry import DRAG, DRAG_CHANGE, LIFT, LIFT_CHANGE, MOMENT, Rotor, rotor, section_tables
from fmus_src.aero.momentum import OYE_K, momentum_velocity, oye_rates, oye_time_constants, prandtl_factor
from fmus_src.component import Component

REFERENCE_HEIGHT = 90.0
#: Glauert / Pitt-Peters constant of the skewed wake.
SKEW_CONSTANT = 15.0 * np.pi / 32.0


def component() -> Component:
    """The rotor of the 5-MW turbine."""
    c = Component(
        "aero",
        "Rotor aerodynamics by blade-element momentum theory with dynamic inflow",
        internal_step=0.0125,
    )
    r = rotor()
    motion = _declare_motion(c)
    density = c.parameter("air_density", 1.225, unit="kg/m3", min=0.0, description="air density")
    limit = c.parameter(
        "attached_flow_limit", 1.0, min=0.0, max=1.0,
        description="1: section forces limited to the attached-flow line as in OpenFAST; 0: published polars",
    )  # fmt: skip
    blades = [_blade(r, motion, b) for b in range(r.blades)]
    points = ca.vertcat(*[b.points for b in blades], motion.position.T)
    wind = _wind(c, points)
    wake = _declare_wake(c, r)

    mean = _RotorMean.of(r, motion, blades, wind, wake)
    flows = [_flow(r, motion, b, wind[_rows(r, i), :], wake, i, mean) for i, b in enumerate(blades)]
    coefficients = _coefficients(c, r, flows, limit)
    loads = [
        _loads(r, b, f, coefficients[_rows(r, i), :], density)
        for i, (b, f) in enumerate(zip(blades, flows, strict=True))
    ]
    _declare_wake_rates(c, r, flows, coefficients, wake, mean)
    _declare_outputs(c, motion, blades, loads, wind, mean)
    return c


@dataclass(frozen=True)
class _Motion:
    position: Any
    axes: Any  # columns: shaft axes in the global frame
    velocity: Any
    angular_velocity: Any  # rotor: nacelle motion and spin, global
    azimuth: Any
    speed: Any
    pitch: Any


@dataclass(frozen=True)
class _Blade:
    """Kinematics of one blade; vectors over the stations, "c" frame unless said otherwise."""

    axes: Any  # columns: blade axes in the global frame
    radial: Any  # blade direction in the shaft frame's y-z plane
    points: Any  # (n, 3) global
    positions: Any  # (n, 3) from the apex
    velocity_x: Any
    velocity_y: Any
    omega_z: Any
    cos_angle: Any  # of twist + pitch
    sin_angle: Any


@dataclass(frozen=True)
class _Wake:
    """Filter states at the inner stations of every blade (stations x blades,)."""

    axial_intermediate: Any
    axial: Any
    tangential_intermediate: Any
    tangential: Any
    time_factor: Any


@dataclass(frozen=True)
class _Flow:
    """Flow at one blade's stations: undisturbed and with induction, relative to the moving blade."""

    normal: Any
    induced: Any
    un: Any
    ut: Any
    speed: Any
    alpha: Any


def _rows(r: Rotor, blade: int) -> slice:
    return slice(blade * r.span.size, (blade + 1) * r.span.size)


def _declare_motion(c: Component) -> _Motion:
    position = c.input("hub.position", 3, unit="m", start=(-5.0, 0.0, 90.0), description="rotor apex, global frame")
    orientation = c.input(
        "hub.orientation", 9, start=(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0),
        description="direction cosines, row by row: its columns are the shaft frame's axes in the global frame",
    )  # fmt: skip
    velocity = c.input("hub.velocity", 3, unit="m/s", description="velocity of the rotor apex, global frame")
    angular = c.input(
        "hub.angular_velocity",
        3,
        unit="rad/s",
        description="angular velocity of the nacelle without spin, global frame",
    )
    azimuth = c.input("rotor.azimuth", unit="rad", display_unit="deg", description="azimuth, 0: blade 1 up")
    speed = c.input(
        "rotor.speed", unit="rad/s", display_unit="rpm", description="rotor speed, clockwise looking downwind"
    )
    pitch = c.input("servo.pitch", 3, unit="rad", display_unit="deg", description="blade pitch, towards feather")
    axes = ca.reshape(orientation, 3, 3).T
    return _Motion(position, axes, velocity, angular + speed * axes[:, 0], azimuth, speed, pitch)


def _blade(r: Rotor, m: _Motion, index: int) -> _Blade:
    angle = m.azimuth + 2.0 * np.pi * index / r.blades
    cos, sin = ca.cos(angle), ca.sin(angle)
    radial, across = ca.vertcat(0, -sin, cos), ca.vertcat(0, cos, sin)
    cc, sc = np.cos(r.precone), np.sin(r.precone)
    shaft = ca.vertcat(1, 0, 0)
    axes = m.axes @ ca.horzcat(cc * shaft - sc * radial, across, sc * shaft + cc * radial)

    cp, sp = ca.cos(m.pitch[index]), ca.sin(m.pitch[index])
    down, trail = r.offset[:, 0], r.offset[:, 1]
    positions = ca.horzcat(down * cp + trail * sp, trail * cp - down * sp, r.hub_radius + r.span)
    omega = axes.T @ m.angular_velocity
    hub = axes.T @ m.velocity
    x, y, z = (positions[:, i] for i in range(3))
    ct, st = np.cos(r.twist), np.sin(r.twist)
    return _Blade(
        axes=axes,
        radial=ca.vertcat(-sin, cos),
        points=ca.repmat(m.position.T, r.span.size, 1) + positions @ axes.T,
        positions=positions,
        velocity_x=hub[0] + omega[1] * z - omega[2] * y,
        velocity_y=hub[1] + omega[2] * x - omega[0] * z,
        omega_z=omega[2],
        cos_angle=ct * cp - st * sp,
        sin_angle=st * cp + ct * sp,
    )


def _wind(c: Component, points: Any) -> Any:
    """Wind at the points, global frame, m/s (n, 3): the box in `wind_file`, or steady wind if none is named."""
    file = c.string_parameter("wind_file", description="TurbSim .bts file; empty: steady wind")
    speed = c.parameter("wind_speed", 8.0, unit="m/s", description="steady wind at 90 m", tunable=True)
    shear = c.parameter("shear_exponent", 0.2, min=0.0, max=1.0, description="power-law exponent of the steady wind")
    turbulent, loaded = c.field("wind", file, points)
    height = ca.fmax(points[:, 2], 0.1)
    steady = (1.0 - loaded) * speed * ca.exp(shear * ca.log(height / REFERENCE_HEIGHT))
    return ca.horzcat(turbulent[:, 0] + steady, turbulent[:, 1], turbulent[:, 2])


def _declare_wake(c: Component, r: Rotor) -> _Wake:
    n = (r.span.size - 2) * r.blades
    factor = c.parameter(
        "wake_time_factor",
        1.0,
        min=0.02,
        description="scale of the wake's time constants; small: quasi-steady",
    )
    start = c.parameter(
        "initial_induced_velocity",
        2.0,
        unit="m/s",
        description="axial induced velocity at the start, everywhere",
    )
    where = "at the inner stations of each blade in turn"
    return _Wake(
        axial_intermediate=c.state(
            "wake.axial_intermediate", n, unit="m/s", start=(1.0 - OYE_K) * start, nominal=1.0,
            description=f"intermediate state of the axial induced velocity {where}",
        ),
        axial=c.state(
            "wake.axial", n, unit="m/s", start=start, nominal=1.0, description=f"axial induced velocity {where}"
        ),
        tangential_intermediate=c.state(
            "wake.tangential_intermediate", n, unit="m/s", nominal=0.1,
            description=f"intermediate state of the tangential induced velocity {where}",
        ),
        tangential=c.state(
            "wake.tangential", n, unit="m/s", nominal=0.1, description=f"tangential induced velocity {where}"
        ),
        time_factor=factor,
    )  # fmt: skip


@dataclass(frozen=True)
class _RotorMean:
    """Area averages over the rotor, shaft frame."""

    wind: Any  # undisturbed wind along the shaft
    normal: Any  # the same relative to the hub
    induction: Any
    skew: Any  # tan(chi / 2) times the downwind direction in the rotor plane (2,)

    @staticmethod
    def of(r: Rotor, m: _Motion, blades: list[_Blade], wind: Any, wake: _Wake) -> _RotorMean:
        weights = np.tile(r.area_weights, r.blades) / r.blades
        average = m.axes.T @ (weights[None, :] @ wind[:-1, :]).T
        relative = average - m.axes.T @ m.velocity
        inner = np.tile(r.area_weights[1:-1], r.blades)
        induced = ca.dot(inner / inner.sum(), wake.axial)
        through = ca.fmax(relative[0] - induced, 0.0)
        plane = relative[1:3]
        # tan(chi/2) = sin / (1 + cos); the wake's direction includes the mean induction.
        skew = plane / (ca.sqrt(through**2 + ca.sumsqr(plane) + 1e-4) + through)
        return _RotorMean(average[0], relative[0], induced / ca.fmax(relative[0], 1.0), skew)


def _flow(r: Rotor, m: _Motion, b: _Blade, wind: Any, wake: _Wake, index: int, mean: _RotorMean) -> _Flow:
    """Relative flow. At the first and last station, where Prandtl's factor is zero, axial induction is one and
    tangential induction none, as in AeroDyn."""
    inner = slice(index * (r.span.size - 2), (index + 1) * (r.span.size - 2))
    induced = wake.axial[inner]
    normal = wind @ b.axes[:, 0] - b.velocity_x
    tangential = wind @ b.axes[:, 1] - b.velocity_y
    # Larger induction on the downwind side of a rotor in oblique flow (Pitt and Peters, as in AeroDyn).
    skew = 1.0 + SKEW_CONSTANT * ca.dot(mean.skew, b.radial) * r.radius[1:-1] / r.radius[-1]
    un = ca.vertcat(0, normal[1:-1] - induced * skew, 0)
    ut = tangential + ca.vertcat(0, wake.tangential[inner], 0)
    # Angle of attack at three quarters of the chord: the section turns about its span at omega_z (coned rotor).
    across = un * b.cos_angle - ut * b.sin_angle + 0.5 * r.chord * b.omega_z
    along = ut * b.cos_angle + un * b.sin_angle
    # The small constants keep derivatives finite in still air.
    return _Flow(normal[1:-1], induced, un, ut, ca.sqrt(un**2 + ut**2 + 1e-12), ca.atan2(across, along + 1e-6))


def _coefficients(c: Component, r: Rotor, flows: list[_Flow], limit: Any) -> Any:
    """Lift, drag and moment coefficients at all stations (n, 3)."""
    data, first, spacing = section_tables()
    which = np.tile(r.section, r.blades).tolist()
    found = c.table("sections", data, first, spacing, which, ca.vertcat(*[f.alpha for f in flows]))
    lift = found[:, LIFT] + limit * found[:, LIFT_CHANGE]
    drag = found[:, DRAG] + limit * found[:, DRAG_CHANGE]
    return ca.horzcat(lift, drag, found[:, MOMENT])


@dataclass(frozen=True)
class _Loads:
    """Aerodynamic load of one blade, "c" frame: resultant and moment about the blade root."""

    force: Any
    root_moment: Any


def _loads(r: Rotor, b: _Blade, f: _Flow, coefficients: Any, density: Any) -> _Loads:
    lift, drag, moment = (coefficients[:, i] for i in range(3))
    pressure = 0.5 * density * r.chord * f.speed
    lumping = ca.sparsify(ca.DM(r.load_lumping))
    fx = lumping @ (pressure * (lift * f.ut + drag * f.un))
    fy = lumping @ (pressure * (drag * f.ut - lift * f.un))
    # Nose up is a positive turn about z: pitch to feather turns the other way.
    mz = lumping @ (pressure * f.speed * r.chord * moment)
    x, y, arm = b.positions[:, 0], b.positions[:, 1], b.positions[:, 2] - r.hub_radius
    root_moment = ca.vertcat(-ca.dot(arm, fy), ca.dot(arm, fx), ca.sum1(mz) + ca.dot(x, fy) - ca.dot(y, fx))
    return _Loads(ca.vertcat(ca.sum1(fx), ca.sum1(fy), 0), root_moment)


def _declare_wake_rates(
    c: Component, r: Rotor, flows: list[_Flow], coefficients: Any, wake: _Wake, mean: _RotorMean
) -> None:
    radius = r.radius[1:-1]
    solidity = r.blades * r.chord[1:-1] / (8.0 * np.pi * radius)
    tau_1, tau_2 = oye_time_constants(mean.normal, mean.induction, radius, r.radius[-1], wake.time_factor)
    axial, tangential = [], []
    for i, f in enumerate(flows):
        lift = coefficients[_rows(r, i), 0][1:-1]
        un, ut, speed = f.un[1:-1], f.ut[1:-1], f.speed[1:-1]
        loss = prandtl_factor(ca.fabs(un) / speed, radius, r.radius[-1], r.radius[0], r.blades)
        # Hansen eqs. 9.10-9.11: induced velocity in equilibrium with the present lift; drag induces none.
        bound = solidity * speed * lift / momentum_velocity(f.normal, f.induced, loss)
        axial.append(bound * ut)
        tangential.append(bound * un)
    tau_2 = ca.repmat(ca.vertcat(tau_2), r.blades, 1)
    rates = oye_rates(ca.vertcat(*axial), wake.axial_intermediate, wake.axial, tau_1, tau_2)
    c.derivative(wake.axial_intermediate, rates.intermediate)
    c.derivative(wake.axial, rates.induced)
    rates = oye_rates(ca.vertcat(*tangential), wake.tangential_intermediate, wake.tangential, tau_1, tau_2)
    c.derivative(wake.tangential_intermediate, rates.intermediate)
    c.derivative(wake.tangential, rates.induced)


def _declare_outputs(
    c: Component, m: _Motion, blades: list[_Blade], loads: list[_Loads], wind: Any, mean: _RotorMean
) -> None:
    root = ca.vertcat(0, 0, rotor().hub_radius)
    forces = [b.axes @ load.force for b, load in zip(blades, loads, strict=True)]
    moments = [b.axes @ (load.root_moment + ca.cross(root, load.force)) for b, load in zip(blades, loads, strict=True)]
    force, moment = sum(forces[1:], forces[0]), sum(moments[1:], moments[0])
    torque = ca.dot(m.axes[:, 0], moment)
    c.output("force", force, unit="N", nominal=1e5, description="rotor force at the apex, global frame")
    c.output("moment", moment, unit="N.m", nominal=1e6, description="rotor moment about the apex, global frame")
    for i, load in enumerate(loads, start=1):
        c.output(
            f"blade{i}.root_force", load.force, unit="N", nominal=1e5,
            description=f"aerodynamic force of blade {i}, coned unpitched blade frame",
        )  # fmt: skip
        c.output(
            f"blade{i}.root_moment", load.root_moment, unit="N.m", nominal=1e6,
            description=f"aerodynamic moment about the root of blade {i}, coned unpitched blade frame",
        )  # fmt: skip
    c.output("thrust", ca.dot(m.axes[:, 0], force), unit="N", nominal=1e5, description="force along the shaft")
    c.output("torque", torque, unit="N.m", nominal=1e6, description="moment about the shaft")
    c.output("power", torque * m.speed, unit="W", nominal=1e6, description="aerodynamic power")
    c.output("wind_speed_hub", wind[-1, 0], unit="m/s", description="wind along X at the hub")
    c.output("rotor_averaged_wind", mean.wind, unit="m/s", description="wind along the shaft, area average")
