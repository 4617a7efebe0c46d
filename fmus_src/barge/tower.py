"""Kinematics of the tower's assumed modes, with the shortening of its axis that bending causes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca

from fmus_src.barge.dynamics import Frame, Point, rotation
from fmus_src.barge.turbine import Tower


@dataclass(frozen=True)
class TowerMotion:
    """Moving points of the tower.

    Attributes:
        points: the point masses, from the base up.
        top: the tower top, and `frame`, its rotation.
        deflection: fore-aft and side-to-side displacement of the top from the rigid tower, m, (2,).
    """

    points: list[Point]
    top: Point
    frame: Frame
    deflection: Any


def tower_motion(tower: Tower, coordinates: Any, rates: Any) -> TowerMotion:
    """Tower points for the relative coordinates, the first four of which are modal (2 fore-aft, 2 side-to-side)."""
    points = [_point(tower, k, coordinates, rates) for k in range(len(tower.height))]
    along, across = ca.SX(tower.fore_aft.shape[-1]), ca.SX(tower.side.shape[-1])
    return TowerMotion(
        points=points[:-1],
        top=points[-1],
        frame=_top_frame(tower, coordinates, rates),
        deflection=ca.vertcat(ca.dot(along, coordinates[:2]), ca.dot(across, coordinates[2:4])),
    )


def _point(tower: Tower, k: int, coordinates: Any, rates: Any) -> Point:
    """u_x = phi q, u_y = psi p, u_z = -1/2 (q' S q + p' S p): an inextensible axis to second order."""
    q, p = coordinates[:2], coordinates[2:4]
    q_rate, p_rate = rates[:2], rates[2:4]
    phi, psi = tower.fore_aft.shape[k], tower.side.shape[k]
    S_q, S_p = ca.SX(tower.fore_aft.shortening[k]), ca.SX(tower.side.shortening[k])
    down_q, down_p = S_q @ q, S_p @ p
    height = tower.base_height + tower.height[k] - 0.5 * (ca.dot(q, down_q) + ca.dot(p, down_p))
    partial = ca.SX(3, int(coordinates.numel()))
    partial[0, :2], partial[1, 2:4] = ca.SX(phi).T, ca.SX(psi).T
    partial[2, :2], partial[2, 2:4] = -down_q.T, -down_p.T
    return Point(
        r=ca.vertcat(ca.dot(ca.SX(phi), q), ca.dot(ca.SX(psi), p), height),
        partial=partial,
        bias=ca.vertcat(0, 0, -ca.dot(q_rate, S_q @ q_rate) - ca.dot(p_rate, S_p @ p_rate)),
    )


def _top_frame(tower: Tower, coordinates: Any, rates: Any) -> Frame:
    """The tower top turns with the slopes of its axis: first about y, then about the turned x axis."""
    slope_x, slope_y = ca.SX(tower.fore_aft.slope[-1]), ca.SX(tower.side.slope[-1])
    pitch, roll = ca.dot(slope_x, coordinates[:2]), -ca.dot(slope_y, coordinates[2:4])
    pitch_rate, roll_rate = ca.dot(slope_x, rates[:2]), -ca.dot(slope_y, rates[2:4])
    y_axis, x_axis = ca.SX([0, 1, 0]), rotation(1, pitch)[:, 0]
    partial = ca.SX(3, int(coordinates.numel()))
    partial[1, :2] = slope_x.T
    partial[:, 2:4] = -x_axis @ slope_y.T
    return Frame(
        axes=rotation(1, pitch) @ rotation(0, roll),
        partial=partial,
        rate=pitch_rate * y_axis + roll_rate * x_axis,
        bias=pitch_rate * roll_rate * ca.cross(y_axis, x_axis),
    )
