"""Unsteady aerofoil aerodynamics: the Beddoes-Leishman model in Gonzalez' variant, sampled.

Sources: Leishman & Beddoes, J. Am. Helicopter Soc. 34 (1989) 3-17; Gonzalez, "Improvement of a Beddoes-Leishman model"
(2014) as documented in Damiani & Hayman, "The Unsteady Aerodynamics Module for FAST 8", NREL/TP-5000-66347 (2019),
whose equation numbers are given. Scalar expressions for one station; normal force N and chord force C are
coefficients. Indicial responses are advanced from sample to sample by

    Y_n = Y_(n-1) exp(-dt / T) + (x_n - x_(n-1)) exp(-dt / 2 T).

The pitching moment is the static one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

SPEED_OF_SOUND = 335.0
# The source's values of what a section may have its own of (`polars.StallConstants`); T_V = 2 T_F.
A1, A2, B1, B2 = 0.3, 0.7, 0.14, 0.53
T_P, T_F, T_VL, STROUHAL = 1.7, 3.0, 11.0, 0.19
#: Reduced frequency of the low-pass on the angle of attack.
FILTER_CUT_OFF = 0.5
#: Gonzalez' offset of the chord force's separation factor, which lets it change sign.
CHORD_OFFSET = 0.2
#: The model fades into the static coefficients between these angles of attack, rad.
FADE = (np.radians(40.0), np.radians(45.0))
LEAST_SPEED = 1.0
#: Linearised compressible flow ends below the speed of sound; a runaway rotor keeps the value here.
LARGEST_MACH = 0.9


@dataclass(frozen=True)
class Aerofoil:
    """Constants of a section: those of `polars.StallConstants`, and its chord, m."""

    alpha_0: Any
    slope: Any
    drag_0: Any
    stall: Any
    negative_stall: Any
    T_p: Any
    T_f: Any
    T_v: Any
    T_vl: Any
    strouhal: Any
    A1: Any
    A2: Any
    b1: Any
    b2: Any
    filter_cut_off: Any
    fade_from: Any
    cut_out: Any
    chord: Any


@dataclass(frozen=True)
class Attached:
    """Attached flow at a sample; what the next sample needs of it. K: rates, X and D: deficiencies, as in the source.

    Attributes:
        alpha: low-passed angle of attack, rad. q: its dimensionless rate; q_filtered: the same, low-passed.
        N_potential, N_lagged: normal force of potential flow, and behind the pressure's lag.
    """

    alpha: Any
    q: Any
    q_filtered: Any
    K_alpha: Any
    K_q: Any
    K1_alpha: Any
    K1_q: Any
    X1: Any
    X2: Any
    X3: Any
    X4: Any
    D_p: Any
    N_potential: Any
    N_lagged: Any


@dataclass(frozen=True)
class Separated:
    """Separation and vortex at a sample; what the next sample needs of it.

    Attributes:
        f, f_chord: static separation factors of normal and chord force. N_vortex: normal force of the vortex.
        tau: dimensionless time the vortex has travelled. sigma: factor on the rate of separation.
    """

    f: Any
    D_f: Any
    f_chord: Any
    D_f_chord: Any
    vortex_feed: Any
    N_vortex: Any
    tau: Any
    sigma: Any


@dataclass(frozen=True)
class Flow:
    """Parts of the attached flow's normal force, with what they are made of.

    Attributes:
        ds: distance travelled in a sample, semi-chords. slope: of the normal force at this Mach number, 1/rad.
        circulatory, impulsive, turning: normal force coefficients.
        alpha_lagged: angle of attack at which the static coefficients say how far the flow separates, rad.
    """

    ds: Any
    slope: Any
    circulatory: Any
    impulsive: Any
    turning: Any
    alpha_lagged: Any


def attached_flow(s: Aerofoil, old: Attached, started: Any, alpha: Any, speed: Any, dt: float) -> tuple[Flow, Attached]:
    """Potential flow and the lagged angle of attack.

    Args:
        started: 0 at the first sample, which is taken as steady, else 1.
        alpha: angle of attack at a quarter chord, rad.
        speed: relative to the section, m/s; at least LEAST_SPEED is used.
        dt: sample time, s.
    """
    U = ca.fmax(speed, LEAST_SPEED)
    M = ca.fmin(U / SPEED_OF_SOUND, LARGEST_MACH)
    squared = 1.0 - M**2
    beta = ca.sqrt(squared)
    slope = s.slope / beta
    ds = 2.0 * U * dt / s.chord

    keep = ca.exp(-2.0 * dt * s.filter_cut_off * U / s.chord)
    alpha_old = _if(started, old.alpha, alpha)
    filtered = keep * alpha_old + (1.0 - keep) * alpha
    change = filtered - alpha_old
    q = change / dt * s.chord / U
    q_old, q_filtered_old = _if(started, old.q, q), _if(started, old.q_filtered, q)
    q_filtered = keep * q_filtered_old + (1.0 - keep) * q
    K_alpha = q_filtered * U / s.chord
    K_q = keep * old.K_q + (1.0 - keep) * (q - q_old) / dt

    weight = s.A1 * s.b1 + s.A2 * s.b2
    impulse_alpha = 0.75 * s.chord / SPEED_OF_SOUND / (1.0 - M + 0.5 * s.slope * M**2 * beta * weight)
    impulse_q = 0.75 * s.chord / SPEED_OF_SOUND / (1.0 - M + s.slope * M**2 * beta * weight)
    K1_alpha = _indicial(old.K1_alpha, K_alpha - old.K_alpha, dt / impulse_alpha)  # 1.18
    K1_q = _indicial(old.K1_q, K_q - old.K_q, dt / impulse_q)  # 1.19
    impulsive = (4.0 * impulse_alpha * (K_alpha - K1_alpha) - impulse_q * (K_q - K1_q)) / M

    fade_1, fade_2 = ca.exp(-0.5 * ds * squared * s.b1), ca.exp(-0.5 * ds * squared * s.b2)
    turn = q_filtered - q_filtered_old
    X1, X2 = (x * e**2 + a * change * e for x, e, a in ((old.X1, fade_1, s.A1), (old.X2, fade_2, s.A2)))  # 1.15
    X3, X4 = (x * e**2 + a * turn * e for x, e, a in ((old.X3, fade_1, s.A1), (old.X4, fade_2, s.A2)))  # 1.16
    effective = filtered - s.alpha_0 - X1 - X2  # 1.14
    circulatory = slope * effective
    turning = 0.5 * slope * q_filtered - X3 - X4
    potential = circulatory + impulsive
    D_p = _indicial(old.D_p, potential - _if(started, old.N_potential, potential), ds / s.T_p)  # 1.35
    lagged = potential - D_p
    flow = Flow(ds, slope, circulatory, impulsive, turning, lagged / slope + s.alpha_0)
    return flow, Attached(
        filtered, q, q_filtered, K_alpha, K_q, K1_alpha, K1_q, X1, X2, X3, X4, D_p, potential, lagged
    )  # fmt: skip


def separated_flow(
    s: Aerofoil, old: tuple[Attached, Separated], started: Any, flow: Flow, now: Attached, alpha: Any,
    static: tuple[Any, Any],
) -> tuple[Any, Any, Separated]:  # fmt: skip
    """Lift and drag coefficients after trailing-edge separation and vortex shedding, and what to remember.

    Args:
        alpha: angle of attack now, rad.
        static: lift and drag coefficients at `flow.alpha_lagged`.
    """
    before = old[1]
    lagged = flow.alpha_lagged
    normal = static[0] * ca.cos(lagged) + (static[1] - s.drag_0) * ca.sin(lagged)
    chordwise = static[0] * ca.sin(lagged) - (static[1] - s.drag_0) * ca.cos(lagged)
    line = flow.slope * (lagged - s.alpha_0)
    f = ca.fmin(((3.0 * ca.sqrt(ca.fmax(_ratio(normal, line), 0.0)) - 1.0) / 2.0) ** 2, 1.0)  # 1.32, Gonzalez
    limit = 1.0 + CHORD_OFFSET
    ratio = ca.fmin(ca.fmax(_ratio(chordwise, line * lagged) + CHORD_OFFSET, -limit), limit)
    f_chord = ratio**2
    slow, slow_vortex = ca.exp(-0.25 * flow.ds / s.T_f), ca.exp(-0.5 * flow.ds / s.T_v)
    half = _if(before.sigma > 1.5, slow**4, _if(before.sigma < 0.75, slow, slow**2))
    D_f = _decayed(before.D_f, f - _if(started, before.f, f), half)  # 1.36
    D_f_chord = _decayed(before.D_f_chord, f_chord - _if(started, before.f_chord, f_chord), slow**2)
    f2, f2_chord = ca.fmax(f - D_f, 0.0), ca.fmax(f_chord - D_f_chord, 0.0)

    loss = ((1.0 + 2.0 * ca.sqrt(f2)) / 3.0) ** 2  # 1.39
    vortex_feed = flow.circulatory * (1.0 - loss)  # 1.50
    gone = ca.logic_and(before.tau > s.T_vl, now.K_alpha * (now.alpha - s.alpha_0) > 0)
    grown = _decayed(before.N_vortex, vortex_feed - before.vortex_feed, slow_vortex)  # 1.47
    N_vortex = _if(started, ca.fmax(_if(gone, before.N_vortex * slow_vortex**4, grown), 0.0), 0.0)
    N = flow.impulsive + flow.turning + flow.circulatory * loss + _if(before.tau > 0, N_vortex, 0.0)
    C = flow.circulatory * alpha * (ca.sqrt(f2_chord) - CHORD_OFFSET)  # 1.40
    cos, sin = ca.cos(alpha), ca.sin(alpha)
    lift, drag = N * cos + C * sin, N * sin - C * cos + s.drag_0
    sigma, tau = _vortex(s, old, flow.ds, now.N_lagged, f2)
    return lift, drag, Separated(f, D_f, f_chord, D_f_chord, vortex_feed, N_vortex, tau, sigma)


def fade(alpha: Any, low: Any = FADE[0], high: Any = FADE[1]) -> Any:
    """Share of the model in the coefficients, 1 up to moderate angles of attack and 0 in deep stall.

    Args:
        low, high: angles of attack between which it falls, rad.
    """
    return ca.fmin(ca.fmax((high - ca.fabs(alpha)) / (high - low), 0.0), 1.0)


def _vortex(s: Aerofoil, old: tuple[Attached, Separated], ds: Any, lagged: Any, f2: Any) -> tuple[Any, Any]:
    """Factor on the rate of separation (2, 1 or 0.5), and the vortex' travelled time, for the next sample."""
    tau = old[1].tau
    leading_edge = ca.logic_or(lagged > s.stall, lagged < s.negative_stall)
    growing = ca.fabs(lagged) > ca.fabs(old[0].N_lagged)
    over_chord = ca.logic_and(tau <= s.T_vl, tau > 0)
    fast = ca.logic_and(growing, ca.logic_or(leading_edge, over_chord))
    slow = ca.logic_and(ca.logic_not(growing), ca.logic_not(leading_edge))
    sigma = _if(fast, 2.0, _if(slow, 0.5, 1.0))
    shed = s.T_vl + 2.0 * (1.0 - f2) / s.strouhal  # 1.54
    idle = ca.logic_and(ca.logic_not(leading_edge), ca.logic_not(over_chord))
    ended = ca.logic_and(ca.logic_not(growing), ca.logic_or(tau < 1e-4, tau + ds > 2.0 * s.T_vl))
    later = tau + ds
    later = _if(ca.logic_and(later >= shed, growing), later - shed, later)
    return sigma, _if(ca.logic_or(idle, ended), 0.0, later)


def _indicial(old: Any, change: Any, time: Any) -> Any:
    return _decayed(old, change, ca.exp(-0.5 * time))


def _decayed(old: Any, change: Any, half: Any) -> Any:
    """An indicial response one sample on, with its decay over half a sample."""
    return old * half**2 + change * half


def _ratio(a: Any, b: Any) -> Any:
    """a / b, finite where both vanish."""
    return a / (b + ca.if_else(b < 0, -1e-9, 1e-9))


def _if(condition: Any, yes: Any, no: Any) -> Any:
    return ca.if_else(condition, yes, no)
