"""One blade station at a sample: undisturbed flow, induction, section flow, forces. Columns of the layouts below."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca

from fmus_src.aero import momentum
from fmus_src.aero.dynamic_stall import Aerofoil, Attached, Flow, Separated, attached_flow, fade, separated_flow
from fmus_src.aero.kinematics import MOTION
from fmus_src.aero.polars import DRAG, LIFT, LIFT_SLOPE, MOMENT
from fmus_src.aero.stations import Layout

SAMPLE_TIME = 0.0125


@dataclass(frozen=True)
class Element(Aerofoil):
    """Constants of a station; those of its section come first.

    Attributes:
        aerofoil: 0 for a cylinder, else 1.
        inner: 0 at the first and last station, where Prandtl's factor is zero, else 1.
        tip, hub: distances for Prandtl's factor (`momentum.prandtl_factor`). ratio: r / R.
    """

    aerofoil: Any
    inner: Any
    tip: Any
    hub: Any
    ratio: Any


@dataclass(frozen=True)
class Undisturbed:
    """Relative wind without induction, local frame, m/s, and angle of attack with the quasi-steady induction, rad."""

    normal: Any
    tangential: Any
    alpha: Any


@dataclass(frozen=True)
class Wake:
    """Induced velocities, m/s: in equilibrium with the present wind, and behind the filters of dynamic inflow."""

    steady_axial: Any
    steady_tangential: Any
    axial_intermediate: Any
    axial: Any
    tangential_intermediate: Any
    tangential: Any


@dataclass(frozen=True)
class RotorState:
    """What all stations of a blade share.

    Attributes:
        tau: time constant of dynamic inflow, s. dynamic: 0 for a quasi-steady wake.
        skew: angle of the averaged relative wind to the shaft, rad. downwind: cosine of the azimuth from its direction.
        started: 0 at the first sample.
    """

    tau: Any
    dynamic: Any
    skew: Any
    downwind: Any
    started: Any


@dataclass(frozen=True)
class Section(Flow):
    """Flow with induction; the parts of attached flow come first.

    Attributes:
        un, ut: relative wind along x and y of the local frame, m/s. speed: m/s.
        alpha, alpha_34: angles of attack at a quarter and at three quarters of the chord, rad.
    """

    un: Any
    ut: Any
    speed: Any
    alpha: Any
    alpha_34: Any


@dataclass(frozen=True)
class StationFlow:
    """Columns of WAKE, SECTION and ATTACHED at a sample, of which the next sample needs the first and the last."""

    wake: Any
    section: Any
    attached: Any


ELEMENT, UNDISTURBED, WAKE, ROTOR_STATE, SECTION = (
    Layout(Element), Layout(Undisturbed), Layout(Wake), Layout(RotorState), Layout(Section)
)  # fmt: skip
ATTACHED, SEPARATED = Layout(Attached), Layout(Separated)
STATION_FLOW = Layout(StationFlow, wake=WAKE.size, section=SECTION.size, attached=ATTACHED.size)
#: Columns of `polars.tabulated` for the induction step, and for the forces.
INDUCTION_COLUMNS, FORCE_COLUMNS = (LIFT, LIFT_SLOPE), (LIFT, DRAG, MOMENT)


def undisturbed(axes: Any, motion: Any, wind: Any, old: Any) -> list[Any]:
    """Undisturbed flow, and the angle of attack at which the lift for the next induction step is looked up.

    Args:
        old: STATION_FLOW of the last sample.
    """
    m, w = MOTION.unpack(motion), WAKE.unpack(STATION_FLOW.unpack(old).wake)
    relative = ca.reshape(axes, 3, 3).T @ wind - m.velocity
    normal = m.cos_cant * relative[0] - m.sin_cant * relative[2]
    across, along = _chordwise(m, normal - w.steady_axial, relative[1] + w.steady_tangential)
    return [UNDISTURBED.pack(Undisturbed(normal, relative[1], ca.atan2(across, along)))]


def sections(element: Any, motion: Any, free: Any, static: Any, old: Any, state: Any) -> list[Any]:
    """STATION_FLOW now: wake one sample on, section flow, and attached flow of the unsteady model.

    At the first and last station axial induction is one and tangential induction none, as in AeroDyn.

    Args:
        static: INDUCTION_COLUMNS at the angle of attack of `undisturbed`. old: STATION_FLOW of the last sample.
    """
    before = STATION_FLOW.unpack(old)
    e, m, f, w, s = (
        ELEMENT.unpack(element), MOTION.unpack(motion), UNDISTURBED.unpack(free), WAKE.unpack(before.wake),
        ROTOR_STATE.unpack(state),
    )  # fmt: skip
    place = momentum.Place(f.normal, f.tangential, e.chord, m.radius, e.tip, e.hub)
    axial, tangential = momentum.induction_step(place, w.steady_axial, w.steady_tangential, static[0], static[1])
    s_axial, w_axial = momentum.oye_filter(axial, w.axial_intermediate, w.axial, s.tau, e.ratio, SAMPLE_TIME)
    s_around, w_around = momentum.oye_filter(
        tangential, w.tangential_intermediate, w.tangential, s.tau, e.ratio, SAMPLE_TIME
    )
    induced, around = ca.if_else(s.dynamic, w_axial, axial), ca.if_else(s.dynamic, w_around, tangential)
    induced *= momentum.skew_factor(induced, f.normal, s.skew, s.downwind, e.ratio)
    un, ut = e.inner * (f.normal - induced), f.tangential + e.inner * around
    speed = ca.sqrt(un**2 + ut**2 + 1e-12)
    across, along = _chordwise(m, un, ut)
    alpha, alpha_34 = ca.atan2(across, along), ca.atan2(across + 0.5 * e.chord * m.turn, along)
    flow, memory = attached_flow(e, ATTACHED.unpack(before.attached), s.started, alpha, speed, SAMPLE_TIME)
    section = Section(**vars(flow), un=un, ut=ut, speed=speed, alpha=alpha, alpha_34=alpha_34)
    later = Wake(axial, tangential, s_axial, w_axial, s_around, w_around)
    return [STATION_FLOW.pack(StationFlow(WAKE.pack(later), SECTION.pack(section), ATTACHED.pack(memory)))]


def forces(
    element: Any, motion: Any, flow: Any, old: Any, separated: Any, static: Any, lagged: Any, state: Any, switches: Any
) -> list[Any]:
    """Force and pitching moment per length, "c" frame, N/m and N; memory of separated flow.

    Args:
        flow, old: STATION_FLOW now and at the last sample. separated: SEPARATED at the last sample.
        static, lagged: FORCE_COLUMNS at the angle of attack of three quarters of the chord, and of the lagged flow.
        switches: whether dynamic stall is active; air density.
    """
    e, m, here, before = (
        ELEMENT.unpack(element), MOTION.unpack(motion), STATION_FLOW.unpack(flow), STATION_FLOW.unpack(old)
    )  # fmt: skip
    f, now = SECTION.unpack(here.section), ATTACHED.unpack(here.attached)
    memories = (ATTACHED.unpack(before.attached), SEPARATED.unpack(separated))
    lift, drag, memory = separated_flow(
        e, memories, ROTOR_STATE.unpack(state).started, f, now, f.alpha, (lagged[0], lagged[1])
    )
    share = switches[0] * e.aerofoil * fade(f.alpha, e.fade_from, e.cut_out)
    lift = static[0] + share * (lift - static[0])
    drag = static[1] + share * (drag - static[1])
    pressure = 0.5 * switches[1] * e.chord * f.speed
    normal = pressure * (lift * f.ut + drag * f.un)
    tangential = pressure * (drag * f.ut - lift * f.un)
    # Nose up is a positive turn about z: pitch to feather turns the other way.
    pitching = pressure * f.speed * e.chord * static[2]
    force = ca.vertcat(m.cos_cant * normal, tangential, -m.sin_cant * normal, pitching)
    return [force, SEPARATED.pack(memory)]


def _chordwise(m: Any, un: Any, ut: Any) -> tuple[Any, Any]:
    """Flow across and along the chord; the small constant keeps the angle's derivatives finite in still air."""
    return un * m.cos_angle - ut * m.sin_angle, ut * m.cos_angle + un * m.sin_angle + 1e-6
