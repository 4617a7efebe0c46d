"""Eight quasi-static catenary mooring lines with seabed contact and friction.

Elastic catenary of Jonkman (2007), NREL/TP-500-41958, chapter 2 (quasi-static mooring); the lines of the ITI Energy
barge are those of the same report. Inertia and drag of the lines are left out, hence their damping too.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import numpy.typing as npt

from fmus_src.component import Component

Array = npt.NDArray[np.float64]

GRAVITY = 9.80665
WATER_DEPTH = 150.0
# Anchors of the two lines of fairlead (20, 20, -4); the other corners follow by turns of 90 degrees.
CORNER_FAIRLEAD = (20.0, 20.0, -4.0)
CORNER_ANCHORS = ((386.92, 171.985, -WATER_DEPTH), (171.985, 386.95, -WATER_DEPTH))
# A line whose slack lies piled on the seabed is solved at the span that exceeds the slack one by this part of its
# length: its horizontal tension is then some 1e-5 of its weight instead of zero, and the equations stay regular.
SLACK_MARGIN = 1e-4


def component() -> Component:
    """Mooring of the ITI Energy barge: two lines per corner."""
    c = Component("mooring", "Quasi-static catenary mooring lines with seabed contact and friction")
    fairleads, anchors = layout()
    fairlead = c.parameter("fairlead", fairleads, unit="m", description="fairleads (line, xyz), platform frame")
    anchor = c.parameter("anchor", anchors, unit="m", description="anchors (line, xyz) on the seabed, global frame")
    length = c.parameter("unstretched_length", 473.312, unit="m", min=1.0, description="unstretched line length")
    diameter = c.parameter("diameter", 0.0809, unit="m", min=1e-3, description="diameter of the displaced water")
    density = c.parameter("mass_density", 130.403, unit="kg/m", min=1e-3, description="line mass per length, in air")
    stiffness = c.parameter("axial_stiffness", 589e6, unit="N", min=1e3, description="axial stiffness EA")
    friction = c.parameter("seabed_friction", 1.0, min=0.0, description="friction coefficient of line on seabed")
    water = c.parameter("water_density", 1025.0, unit="kg/m3", min=0.0, description="water density")
    weight = c.calculated(
        "weight_in_water", (density - water * ca.pi * diameter**2 / 4) * GRAVITY, unit="N/m",
        description="line weight per length in water; must be positive",
    )  # fmt: skip
    position = c.input("platform.position", 3, unit="m", description="platform reference point, global frame")
    angles = c.input(
        "platform.rotation", 3, unit="rad", display_unit="deg", description="roll, pitch, yaw; R = Rz Ry Rx"
    )

    arm = fairlead @ rotation_matrix(angles).T
    to_anchor = anchor - arm - ca.repmat(position.T, fairlead.shape[0], 1)
    span = ca.sqrt(to_anchor[:, 0] ** 2 + to_anchor[:, 1] ** 2)
    ones = ca.SX.ones(span.shape)
    rows = ca.horzcat(span, -to_anchor[:, 2], length * ones, weight * ones, stiffness * ones, friction * ones)
    solution = c.solve("line", catenary(), first_guess(), rows)
    h, v = (ca.exp(solution[:, i]) * weight * length for i in range(2))

    direction = to_anchor[:, :2] / ca.repmat(ca.fmax(span, 1e-6), 1, 2)
    pull = ca.horzcat(direction * ca.repmat(h, 1, 2), -v)
    resting = ca.fmax(length - v / weight, 0)
    held = ca.fmax(h - friction * weight * resting, 0)
    uplift = ca.fmax(weight * length - v, 0) - (weight * length - v)
    c.output("force", ca.sum1(pull).T, unit="N", nominal=1e5, description="force on the platform, global frame")
    c.output(
        "moment", ca.sum1(_cross(arm, pull)).T, unit="N.m", nominal=1e6,
        description="moment on the platform about its reference point, global frame",
    )  # fmt: skip
    c.output(
        "fairlead_tension", ca.sqrt(h**2 + v**2), unit="N", nominal=1e5, description="line tension at the fairleads"
    )
    c.output(
        "anchor_tension", ca.sqrt(held**2 + uplift**2), unit="N", nominal=1e5, description="line tension at the anchors"
    )
    return c


def layout() -> tuple[Array, Array]:
    """Fairleads (8, 3) in the platform frame and anchors (8, 3) in the global frame, m."""
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    turns = [np.linalg.matrix_power(turn, i) for i in range(4)]
    fairleads = [r @ CORNER_FAIRLEAD for r in turns for _ in CORNER_ANCHORS]
    anchors = [r @ a for r in turns for a in CORNER_ANCHORS]
    return np.array(fairleads), np.array(anchors)


def rotation_matrix(angles: Any) -> Any:
    """R = Rz(yaw) Ry(pitch) Rx(roll), from the platform frame to the global frame."""
    cx, cy, cz = (ca.cos(angles[i]) for i in range(3))
    sx, sy, sz = (ca.sin(angles[i]) for i in range(3))
    about_x = ca.vertcat(ca.horzcat(1, 0, 0), ca.horzcat(0, cx, -sx), ca.horzcat(0, sx, cx))
    about_y = ca.vertcat(ca.horzcat(cy, 0, sy), ca.horzcat(0, 1, 0), ca.horzcat(-sy, 0, cy))
    about_z = ca.vertcat(ca.horzcat(cz, -sz, 0), ca.horzcat(sz, cz, 0), ca.horzcat(0, 0, 1))
    return about_z @ about_y @ about_x


def catenary() -> ca.Function:
    """Equations of one line, as a function (y, a) -> r.

    y = (ln(H / wL), ln(V / wL)), H and V the horizontal and vertical tension at the fairlead, both positive.
    a = (horizontal span, height of the fairlead over the anchor, L, w, EA, friction coefficient), SI units.
    r = logarithms of the ratios, present over given, of span + height - L and of height; positive because no line is
    longer than its span and height together. In these terms the equations are almost linear both for slack lines (span
    excess ~ H) and for taut ones (stretch ~ H), so that Newton's method converges from far away.
    If V > wL the whole line hangs; else its lower part rests on the seabed and friction takes up tension there.
    """
    y, a = ca.SX.sym("y", 2), ca.SX.sym("a", 6)
    height, length, w, ea, friction = (a[i] for i in range(1, 6))
    h, v = ca.exp(y[0]) * w * length, ca.exp(y[1]) * w * length
    stretch = h * length / ea

    # Differences of asinh and of tensions are written as quotients: they would cancel for taut lines.
    anchor_v = ca.fmax(v - w * length, 0)
    tension, anchor_tension = _hypot(h, v), _hypot(h, anchor_v)
    steepness = (v**2 - anchor_v**2) / (v * anchor_tension + anchor_v * tension)
    hanging_x = h / w * ca.asinh(steepness) + stretch
    hanging_z = (v**2 - anchor_v**2) / (w * (tension + anchor_tension)) + (v - w * length / 2) * length / ea

    resting = length - v / w
    cb = ca.fmax(friction, 1e-9)
    free = resting - h / (cb * w)
    rub = cb * w / (2 * ea) * (free * ca.fmax(free, 0) - resting**2)
    beyond_x = h / w * ca.asinh(v / h) + stretch + rub  # span beyond the resting length
    sag = v**2 / (2 * ea * w) - h / w + h**2 / (w * (tension + v))  # height less the hanging length

    whole = v > w * length
    z = ca.if_else(whole, hanging_z, v / w + sag)
    excess = ca.if_else(whole, hanging_x + hanging_z - length, beyond_x + sag)
    ratios = ca.vertcat(excess / (_taut_span(a) + height - length), z / height)
    return ca.Function("catenary", [y, a], [ca.log(ratios)])


def first_guess() -> ca.Function:
    """First guess of y from a (see `catenary`), from the catenary parameter as Jonkman (2007), chapter 2."""
    a = ca.SX.sym("a", 6)
    height, length = a[1], a[2]
    span = _taut_span(a)
    excess = (length**2 - height**2) / span**2 - 1
    sag = ca.if_else(excess > 0, ca.sqrt(3 * ca.fmax(excess, 1e-4)), 0.2)
    h = span / (2 * sag * length)
    v = (height / ca.tanh(sag) + length) / (2 * length)
    return ca.Function("first_guess", [a], [ca.log(ca.vertcat(h, v))])


def _taut_span(a: Any) -> Any:
    """The horizontal span, but not below that at which the line hangs straight down and rests without tension."""
    height, length, w, ea = a[1], a[2], a[3], a[4]
    upright = 2 * height / (1 + ca.sqrt(1 + 2 * w * height / ea))
    return ca.fmax(a[0], length - upright + SLACK_MARGIN * length)


def _hypot(x: Any, y: Any) -> Any:
    return ca.sqrt(x**2 + y**2)


def _cross(a: Any, b: Any) -> Any:
    """Cross product of the rows of two (n, 3) matrices."""
    (ax, ay, az), (bx, by, bz) = ca.horzsplit(a), ca.horzsplit(b)
    return ca.horzcat(ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx)
