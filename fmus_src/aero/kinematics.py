"""Motion of the blade stations: hub motion, spin, pitch and the blades' bending.

Frames. Shaft: x along the shaft, downwind; z up at rest; not rotating. Blade "c": z along the undeflected coned blade
outwards, x downwind, y completing a right-handed frame (towards the trailing edge); it does not pitch. Local: "c"
turned about y by the blade's out-of-plane slope, prebend included, in which momentum theory and sections work
(AeroDyn's frame without sweep, pitch and twist).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from fmus_src.aero.geometry import Rotor
from fmus_src.aero.stations import Layout, each
from fmus_src.barge.blade import BladeShapes
from fmus_src.component import Component


@dataclass(frozen=True)
class HubMotion:
    """Inputs that say how the hub and the blades move.

    Attributes:
        position, velocity: of the rotor apex, global, m, m/s.
        axes: columns: shaft axes in the global frame.
        angular_velocity: of the rotor, nacelle motion and spin, global, rad/s.
        azimuth, speed: rad, rad/s. pitch: of the blades, rad, (3,).
        deflection, rate: modal coordinates of each blade, m, m/s, (3,) each.
    """

    position: Any
    axes: Any
    velocity: Any
    angular_velocity: Any
    azimuth: Any
    speed: Any
    pitch: Any
    deflection: list[Any]
    rate: list[Any]


@dataclass(frozen=True)
class Place:
    """Constants of a station: distance from the root and quarter chord off the pitch axis (m), twist, mode shapes.

    `bent`: slope of the undeflected blade's axis, dx/dz.
    """

    arm: Any
    down: Any
    trail: Any
    cos_twist: Any
    sin_twist: Any
    bent: Any
    shape_x: Any
    shape_y: Any
    slope_x: Any
    slope_y: Any
    shortening: Any


PLACE = Layout(Place, shape_x=3, shape_y=3, slope_x=3, slope_y=3, shortening=9)


@dataclass(frozen=True)
class Blade:
    """Motion of a blade as a whole, "c" frame unless said otherwise.

    Attributes:
        apex: rotor apex, global. axes: blade axes in the global frame, column by column.
        velocity, omega: of the apex and the rotor. cos_pitch, sin_pitch. deflection, rate: modal coordinates.
    """

    apex: Any
    axes: Any
    velocity: Any
    omega: Any
    cos_pitch: Any
    sin_pitch: Any
    deflection: Any
    rate: Any


BLADE = Layout(Blade, apex=3, axes=9, velocity=3, omega=3, deflection=3, rate=3)


@dataclass(frozen=True)
class Motion:
    """Motion of a station, "c" frame unless said otherwise.

    Attributes:
        point: global, m. position: from the apex, m. velocity: m/s. radius: distance from the shaft, m.
        cos_cant, sin_cant: of the local frame's turn about y. turn: angular velocity about the span, rad/s.
        cos_angle, sin_angle: of twist + pitch + the turn that bending both ways brings.
        shape_x, shape_y, shape_z: displacement per modal coordinate at the present deflection.
    """

    point: Any
    position: Any
    velocity: Any
    radius: Any
    cos_cant: Any
    sin_cant: Any
    turn: Any
    cos_angle: Any
    sin_angle: Any
    shape_x: Any
    shape_y: Any
    shape_z: Any


MOTION = Layout(Motion, point=3, position=3, velocity=3, shape_x=3, shape_y=3, shape_z=3)


def declare_motion(c: Component, blades: int) -> HubMotion:
    """Declare the inputs."""
    position = c.input("hub.position", 3, unit="m", start=(-5.0, 0.0, 90.0), description="rotor apex, global frame")
    orientation = c.input(
        "hub.orientation", 9, start=(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0),
        description="direction cosines, row by row: its columns are the shaft frame's axes in the global frame",
    )  # fmt: skip
    velocity = c.input("hub.velocity", 3, unit="m/s", description="velocity of the rotor apex, global frame")
    angular = c.input(
        "hub.angular_velocity", 3, unit="rad/s", description="angular velocity of the nacelle without spin, global"
    )
    azimuth = c.input("rotor.azimuth", unit="rad", display_unit="deg", description="azimuth, 0: blade 1 up")
    speed = c.input(
        "rotor.speed", unit="rad/s", display_unit="rpm", description="rotor speed, clockwise looking downwind"
    )
    pitch = c.input("servo.pitch", 3, unit="rad", display_unit="deg", description="blade pitch, towards feather")
    modes = "of the modes flap 1, flap 2, edge 1"
    deflection = [
        c.input(f"blade{k}.deflection", 3, unit="m", description=f"modal coordinates {modes}, blade {k}")
        for k in range(1, blades + 1)
    ]
    rate = [
        c.input(f"blade{k}.deflection_rate", 3, unit="m/s", description=f"rates {modes}, blade {k}")
        for k in range(1, blades + 1)
    ]
    axes = ca.reshape(orientation, 3, 3).T
    spin = angular + speed * axes[:, 0]
    return HubMotion(position, axes, velocity, spin, azimuth, speed, pitch, deflection, rate)


def places(r: Rotor, shapes: BladeShapes) -> Any:
    """Constants of the stations of one blade, (PLACE.size, n)."""
    rows = [
        r.span[None], r.offset.T, np.cos(r.twist)[None], np.sin(r.twist)[None], np.tan(r.prebend)[None],
        shapes.shape[:, 0].T, shapes.shape[:, 1].T, shapes.slope[:, 0].T, shapes.slope[:, 1].T,
        shapes.shortening.reshape(-1, 9).T,
    ]  # fmt: skip
    return ca.DM(np.vstack(rows))


def radial_directions(r: Rotor, azimuth: Any) -> list[Any]:
    """Directions of the blades in the shaft frame's y-z plane, (2,) each."""
    angles = [azimuth + 2.0 * np.pi * k / r.blades for k in range(r.blades)]
    return [ca.vertcat(-ca.sin(a), ca.cos(a)) for a in angles]


def blade_motion(r: Rotor, m: HubMotion, index: int, radial: Any) -> Any:
    """Motion of blade `index`, counted from zero, as a column of BLADE."""
    outwards, across = ca.vertcat(0, radial), ca.vertcat(0, radial[1], -radial[0])
    cc, sc = np.cos(r.precone), np.sin(r.precone)
    shaft = ca.DM([1.0, 0.0, 0.0])
    axes = m.axes @ ca.horzcat(cc * shaft - sc * outwards, across, sc * shaft + cc * outwards)
    return BLADE.pack(
        Blade(
            apex=m.position,
            axes=ca.vec(axes),
            velocity=axes.T @ m.velocity,
            omega=axes.T @ m.angular_velocity,
            cos_pitch=ca.cos(m.pitch[index]),
            sin_pitch=ca.sin(m.pitch[index]),
            deflection=m.deflection[index],
            rate=m.rate[index],
        )
    )


def station_motion(r: Rotor, blades: Any, place: Any) -> Any:
    """Motion of stations, (MOTION.size, n).

    Args:
        blades: the blade of each station, (BLADE.size, n), or one column for all. place: (PLACE.size, n).
    """
    cc, sc = np.cos(r.precone), np.sin(r.precone)

    def motion(blade: Any, place: Any) -> list[Any]:
        b, s = BLADE.unpack(blade), PLACE.unpack(place)
        cp, sp, q = b.cos_pitch, b.sin_pitch, b.deflection
        shape_x, shape_y = cp * s.shape_x + sp * s.shape_y, cp * s.shape_y - sp * s.shape_x
        drawn_in = ca.reshape(s.shortening, 3, 3) @ q
        out_of_plane, in_plane = s.bent + ca.dot(s.slope_x, q), ca.dot(s.slope_y, q)
        slope, sweep = cp * out_of_plane + sp * in_plane, cp * in_plane - sp * out_of_plane
        # A beam that is bent both ways without torsion turns about its axis, in the frame that leaves its sweep out.
        cos_turn, sin_turn = ca.cos(0.5 * slope * sweep), -ca.sin(0.5 * slope * sweep)
        cos_angle, sin_angle = s.cos_twist * cp - s.sin_twist * sp, s.sin_twist * cp + s.cos_twist * sp
        position = ca.vertcat(
            s.down * cp + s.trail * sp + ca.dot(shape_x, q),
            s.trail * cp - s.down * sp + ca.dot(shape_y, q),
            r.hub_radius + s.arm - 0.5 * ca.dot(drawn_in, q),
        )
        bending = ca.vertcat(ca.dot(shape_x, b.rate), ca.dot(shape_y, b.rate), -ca.dot(drawn_in, b.rate))
        cos_cant = 1.0 / ca.sqrt(1.0 + slope**2)
        sin_cant = slope * cos_cant
        result = Motion(
            point=b.apex + ca.reshape(b.axes, 3, 3) @ position,
            position=position,
            velocity=b.velocity + ca.cross(b.omega, position) + bending,
            radius=ca.sqrt((cc * position[2] - sc * position[0]) ** 2 + position[1] ** 2),
            cos_cant=cos_cant,
            sin_cant=sin_cant,
            turn=sin_cant * b.omega[0] + cos_cant * b.omega[2],
            cos_angle=cos_angle * cos_turn - sin_angle * sin_turn,
            sin_angle=sin_angle * cos_turn + cos_angle * sin_turn,
            shape_x=shape_x,
            shape_y=shape_y,
            shape_z=-drawn_in,
        )
        return [MOTION.pack(result)]

    return each("station_motion", motion, blades, place)[0]
