"""The tower in the wind: its influence on the flow at the blades, and the drag of the air on it.

Both follow AeroDyn (Moriarty & Hansen, NREL/TP-500-36881, 2005; OpenFAST documentation, "Tower influence models" and
"Tower drag loads"). Platform frame: axes of the platform, origin at the platform reference point, which the tower's
undeflected axis passes through. The tower's air inputs and loads refer to that point.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from fmus_src.aero.loads import HeldOutputs
from fmus_src.aero.stations import Layout, each, either
from fmus_src.barge.tower_shapes import TowerAxis
from fmus_src.barge.turbine import Turbine, nrel_5mw_barge
from fmus_src.component import Component

STRIPS = 8
#: Largest deficit in the shadow: none of the models holds in the reversed flow close behind the tower.
LARGEST_DEFICIT = 0.5


@dataclass(frozen=True)
class Tower:
    """Tower figures: undeflected axis and modes, diameters (m), drag coefficient."""

    axis: TowerAxis
    base_diameter: float
    top_diameter: float
    drag_coefficient: float


def tower(turbine: Turbine | None = None) -> Tower:
    """The tower of a turbine (default: the 5-MW turbine's) as the air meets it.

    Raises:
        ValueError: the turbine's figures lack its diameters.
    """
    t = turbine or nrel_5mw_barge()
    names = ("base_diameter", "top_diameter", "drag_coefficient")
    for name in names:
        if not float(t.tower_air.get(name, 0.0)) > 0.0:
            raise ValueError(f"aero: turbine.toml: [tower] needs {name}, above 0, of the tower as the air meets it")
    return Tower(t.tower_axis, *(float(t.tower_air[name]) for name in names))


@dataclass(frozen=True)
class Support:
    """Motion of platform and tower.

    Attributes:
        position: of the platform reference point, global, m.
        axes: of the platform in the global frame, column by column.
        velocity, omega: of that point and of the platform, platform frame, m/s, rad/s.
        deflection, rate: of the modes fore-aft 1, 2, side-to-side 1, 2, m, m/s.
    """

    position: Any
    axes: Any
    velocity: Any
    omega: Any
    deflection: Any
    rate: Any


SUPPORT = Layout(Support, position=3, axes=9, velocity=3, omega=3, deflection=4, rate=4)


@dataclass(frozen=True)
class Strip:
    """Constants of a strip: height, m; modes, their slopes, 1/m, and shortening, 1/m; diameter and length, m."""

    height: Any
    fore_aft: Any
    side: Any
    fore_aft_slope: Any
    side_slope: Any
    fore_aft_shortening: Any
    side_shortening: Any
    diameter: Any
    length: Any


STRIP = Layout(
    Strip, fore_aft=2, side=2, fore_aft_slope=2, side_slope=2, fore_aft_shortening=4, side_shortening=4
)  # fmt: skip


@dataclass(frozen=True)
class StripMotion:
    """Motion of a strip.

    Attributes:
        point: global, m. position, velocity: platform frame, m, m/s. direction: unit vector along the tower there.
        drawn_in: fall of the strip per metre of modal coordinate.
    """

    point: Any
    position: Any
    velocity: Any
    direction: Any
    drawn_in: Any


STRIP_MOTION = Layout(StripMotion, point=3, position=3, velocity=3, direction=3, drawn_in=4)


@dataclass(frozen=True)
class Air:
    """Parameters: air density, kg/m3; the tower's drag coefficient; whether it disturbs the wind, and feels drag."""

    density: Any
    drag_coefficient: Any
    influence: Any
    drag: Any


def declare_air(c: Component, t: Tower) -> Air:
    """Declare the parameters."""
    return Air(
        density=c.parameter("air_density", 1.225, unit="kg/m3", min=0.0, description="air density"),
        drag_coefficient=c.parameter(
            "tower_drag_coefficient", t.drag_coefficient, min=0.0, description="drag coefficient of the tower's section"
        ),
        influence=c.parameter(
            "tower_influence", 0.0, kind="boolean",
            description="whether the blades meet the flow around the tower and its shadow",
        ),
        drag=c.parameter(
            "tower_drag", 0.0, kind="boolean", description="whether the air loads the tower; 0: tower loads are zero"
        ),
    )  # fmt: skip


def declare_support(c: Component) -> Any:
    """Declare the inputs; returns a column of SUPPORT."""
    position = c.input("platform.position", 3, unit="m", description="displacement of the platform reference point")
    rotation = c.input(
        "platform.rotation", 3, unit="rad", display_unit="deg",
        description="roll, pitch and yaw of the platform (applied in the order yaw, pitch, roll)",
    )  # fmt: skip
    velocity = c.input(
        "platform.velocity", 3, unit="m/s", description="velocity of the platform reference point, global"
    )
    angular = c.input("platform.angular_velocity", 3, unit="rad/s", description="of the platform, global")
    modes = "of the modes fore-aft 1, 2, side-to-side 1, 2"
    deflection = c.input("tower.deflection", 4, unit="m", description=f"modal coordinates {modes}")
    rate = c.input("tower.deflection_rate", 4, unit="m/s", description=f"rates {modes}")
    axes = _rotation(rotation)
    return SUPPORT.pack(Support(position, ca.vec(axes), axes.T @ velocity, axes.T @ angular, deflection, rate))


def _rotation(angles: Any) -> Any:
    """Rz(yaw) Ry(pitch) Rx(roll)."""
    sr, sp, sy = ca.vertsplit(ca.sin(angles))
    cr, cp, cy = ca.vertsplit(ca.cos(angles))
    return ca.vertcat(
        ca.horzcat(cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr),
        ca.horzcat(sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr),
        ca.horzcat(-sp, cp * sr, cp * cr),
    )


def strips(t: Tower, count: int = STRIPS) -> Any:
    """Constants of Gauss' points along the tower, (STRIP.size, count)."""
    x, weight = np.polynomial.legendre.leggauss(count)
    fraction = 0.5 * (x + 1.0)
    fore_aft, side = (t.axis.shapes(direction, fraction) for direction in (0, 1))
    rows = [
        (t.axis.base_height + t.axis.length * fraction)[None], fore_aft.shape.T, side.shape.T, fore_aft.slope.T,
        side.slope.T, fore_aft.shortening.reshape(-1, 4).T, side.shortening.reshape(-1, 4).T,
        (t.base_diameter + (t.top_diameter - t.base_diameter) * fraction)[None], 0.5 * t.axis.length * weight[None],
    ]  # fmt: skip
    return ca.DM(np.vstack(rows))


def strip_motion(support: Any, constants: Any) -> Any:
    """Motion of the strips, (STRIP_MOTION.size, n).

    Args:
        support: column of SUPPORT. constants: (STRIP.size, n).
    """

    def motion(support: Any, strip: Any) -> list[Any]:
        b, s = SUPPORT.unpack(support), STRIP.unpack(strip)
        q, p, q_rate, p_rate = b.deflection[:2], b.deflection[2:], b.rate[:2], b.rate[2:]
        fall_q = ca.reshape(s.fore_aft_shortening, 2, 2) @ q
        fall_p = ca.reshape(s.side_shortening, 2, 2) @ p
        fall = 0.5 * (ca.dot(q, fall_q) + ca.dot(p, fall_p))
        position = ca.vertcat(ca.dot(s.fore_aft, q), ca.dot(s.side, p), s.height - fall)
        bending = ca.vertcat(
            ca.dot(s.fore_aft, q_rate), ca.dot(s.side, p_rate), -ca.dot(fall_q, q_rate) - ca.dot(fall_p, p_rate)
        )
        along = ca.vertcat(ca.dot(s.fore_aft_slope, q), ca.dot(s.side_slope, p), 1.0)
        result = StripMotion(
            point=b.position + ca.reshape(b.axes, 3, 3) @ position,
            position=position,
            velocity=b.velocity + ca.cross(b.omega, position) + bending,
            direction=along / ca.norm_2(along),
            drawn_in=ca.vertcat(fall_q, fall_p),
        )
        return [STRIP_MOTION.pack(result)]

    return each("strip_motion", motion, support, constants)[0]


def drag(t: Tower, air: Air, support: Any, motion: Any, wind: Any) -> Any:
    """Drag of the air across the tower: f = 1/2 rho C_d D |V| V per length, V the relative wind normal to the tower.

    Args:
        support: column of SUPPORT. motion: of the strips, columns of STRIP_MOTION. wind: there, global, m/s, (3, n).

    Returns:
        (10,): force and moment about the platform reference point, global, N, N m; work per metre of each mode, N.
    """

    def load(support: Any, strip: Any, motion: Any, wind: Any, pressure: Any) -> list[Any]:
        b, s, m = SUPPORT.unpack(support), STRIP.unpack(strip), STRIP_MOTION.unpack(motion)
        axes = ca.reshape(b.axes, 3, 3)
        relative = axes.T @ wind - m.velocity
        across = relative - ca.dot(relative, m.direction) * m.direction
        force = pressure * s.diameter * s.length * ca.sqrt(ca.sumsqr(across)) * across
        modal = ca.vertcat(s.fore_aft * force[0], s.side * force[1]) - m.drawn_in * force[2]
        return [ca.vertcat(axes @ force, axes @ ca.cross(m.position, force), modal)]

    return either(
        "tower_drag", air.drag, (support, motion, wind, 0.5 * air.density * air.drag_coefficient),
        lambda support, *rest: ca.sum2(each("tower_strip", load, support, strips(t, int(wind.shape[1])), *rest)[0]),
        lambda *_: ca.MX(10, 1),
    )  # fmt: skip


def declare_loads(held: HeldOutputs, load: Any) -> None:
    """Declare the tower's loads, (10,) of `drag`, as outputs."""
    where = "of the air on the tower about the platform reference point, global"
    held("tower.force", load[:3], "N", f"force {where}", 1e4)
    held("tower.moment", load[3:6], "N.m", f"moment {where}", 1e6)
    modes = "work of the air on the tower per metre of the modes fore-aft 1, 2, side-to-side 1, 2"
    held("tower.modal_force", load[6:], "N", modes, 1e4)


def disturbed(t: Tower, air: Air, support: Any, points: Any, wind: Any) -> Any:
    """Wind at points with the tower's influence if that is switched on, global, m/s, (3, n).

    Around the tower potential flow of a cylinder, downwind of it also Powles' shadow, from the wind at the point
    relative to the tower at that height. Above the top it fades over one radius, as in AeroDyn. That the bent tower
    leans is neglected.

    Args:
        support: column of SUPPORT. points: global, m, (3, n). wind: there, without the tower.
    """

    def influence(support: Any, coefficient: Any, point: Any, wind: Any) -> list[Any]:
        b = SUPPORT.unpack(support)
        axes = ca.reshape(b.axes, 3, 3)
        at = axes.T @ (point - b.position)
        height = (at[2] - t.axis.base_height) / t.axis.length
        x = ca.fmin(ca.fmax(height, 0.0), 1.0)
        centre, rate = _bent(t.axis, x, b.deflection), _bent(t.axis, x, b.rate)
        radius = 0.5 * (t.base_diameter + (t.top_diameter - t.base_diameter) * x)
        place = ca.vertcat(centre, t.axis.base_height + t.axis.length * x)
        relative = (axes.T @ wind - b.velocity - ca.cross(b.omega, place))[:2] - rate
        speed = ca.sqrt(ca.sumsqr(relative) + 1e-12)
        e = relative / speed
        beyond = ca.fmin(ca.fmax(height - x, 0.0) * t.axis.length / radius, 1.0)
        from_axis = (at[:2] - centre) / radius
        u, v = tower_flow(ca.dot(e, from_axis), e[0] * from_axis[1] - e[1] * from_axis[0], beyond, coefficient)
        change = speed * ca.vertcat(u * e[0] - v * e[1], u * e[1] + v * e[0], 0.0)
        return [wind + axes @ change]

    return either(
        "disturbed_wind", air.influence, (support, air.drag_coefficient, points, wind),
        lambda *given: each("tower_influence", influence, *given)[0],
        lambda support, coefficient, points, wind: wind,
    )  # fmt: skip


def tower_flow(x: Any, y: Any, beyond: Any, drag_coefficient: Any) -> tuple[Any, Any]:
    """Change of the wind along and across its direction, over its speed.

    Potential flow: u = (y^2 - x^2) / d^4, v = -2 x y / d^4, d^2 = x^2 + y^2 (Burton et al., "Wind Energy Handbook",
    section 3.12; Moriarty & Hansen). Shadow (Powles): u = -C_d / sqrt(d) cos^2(pi/2 y / sqrt(d)) for x > 0,
    |y| < sqrt(d).

    Args:
        x, y: downwind of the tower's axis and across, in tower radii; within the tower d = 1 is used.
        beyond: height above the top, in radii, 0 to 1; x and y are stretched by 1 / cos(pi/2 beyond), at 1 infinitely.
    """
    stretch = 1.0 / ca.fmax(ca.cos(0.5 * np.pi * beyond), 1e-9)
    x, y = x * stretch, y * stretch
    squared = ca.fmax(x**2 + y**2, 1.0)
    width = ca.sqrt(ca.sqrt(squared))
    across = y / width
    deficit = ca.fmin(drag_coefficient / width * ca.cos(0.5 * np.pi * across) ** 2, LARGEST_DEFICIT)
    shadow = ca.if_else(ca.logic_and(x > 0.0, ca.fabs(across) < 1.0), deficit, 0.0)
    return (y**2 - x**2) / squared**2 - shadow, -2.0 * x * y / squared**2


def _bent(axis: TowerAxis, x: Any, coordinates: Any) -> Any:
    """Fore-aft and side displacement at height fraction x for modal coordinates (or rates)."""
    powers = ca.vertcat(*[x**k for k in range(2, 2 + axis.coefficients.shape[1])])
    shapes = ca.DM(axis.coefficients) @ powers
    return ca.vertcat(ca.dot(shapes[:2], coordinates[:2]), ca.dot(shapes[2:], coordinates[2:]))
