"""Unsteady aerofoil: steady limit, attached flow against closed forms and Theodorsen, separation and hysteresis."""

from __future__ import annotations

from functools import cache

import casadi as ca
import numpy as np
import pytest
from scipy.special import hankel2

from fmus_src.aero import dynamic_stall as stall
from fmus_src.aero.dynamic_stall import Aerofoil, Attached, Separated, attached_flow, separated_flow
from fmus_src.aero.geometry import aerofoil_constants, rotor, section_tables
from fmus_src.aero.polars import DRAG, LIFT
from fmus_src.aero.stations import Layout

OUTER = 15  # a station of NACA 64-618, 2.3 m chord
THICK = 6  # DU 99-W-350
ATTACHED, SEPARATED = Layout(Attached), Layout(Separated)


@cache
def constants(station: int) -> dict[str, float]:
    r = rotor()
    every = {name: float(v[station]) for name, v in aerofoil_constants(r).items() if name != "aerofoil"}
    return every | {"chord": float(r.chord[station])}


@cache
def polar(station: int) -> tuple[np.ndarray, np.ndarray]:
    """Angles (n,) and coefficients (n, columns)."""
    data, first, spacing = section_tables()
    return first + spacing * np.arange(data.shape[1]), data[rotor().section[station]]


def run(station: int, alpha: np.ndarray, speed: float, dt: float) -> dict[str, np.ndarray]:
    """The sampled model over a history of the angle of attack: lift, drag and its memory at every sample."""
    s = Aerofoil(**{name: ca.SX(value) for name, value in constants(station).items()})
    grid, data = polar(station)
    tables = [ca.interpolant("t", "linear", [grid], data[:, column]) for column in (LIFT, DRAG)]
    old, angle = ca.SX.sym("old", ATTACHED.size + SEPARATED.size + 1), ca.SX.sym("alpha")
    memory = ATTACHED.unpack(old[: ATTACHED.size]), SEPARATED.unpack(old[ATTACHED.size : -1])
    flow, attached = attached_flow(s, memory[0], old[-1], angle, speed, dt)
    first = ca.Function("first", [old, angle], [flow.alpha_lagged])
    static = ca.SX.sym("static", 2)
    lift, drag, separated = separated_flow(s, memory, old[-1], flow, attached, angle, (static[0], static[1]))
    new = ca.vertcat(ATTACHED.pack(attached), SEPARATED.pack(separated), 1.0)
    second = ca.Function("second", [old, angle, static], [new, ca.vertcat(lift, drag)])
    z, a = ca.MX.sym("z", old.numel()), ca.MX.sym("a")
    lagged = first(z, a)
    step = ca.Function("step", [z, a], second(z, a, ca.vertcat(*[t(lagged) for t in tables])))
    history, coefficients = (m.full() for m in step.mapaccum(alpha.size)(np.zeros(old.numel()), alpha[None]))
    names = [*ATTACHED.sizes, *SEPARATED.sizes]
    return {"lift": coefficients[0], "drag": coefficients[1], **dict(zip(names, history, strict=False))}


def mach(speed: float) -> float:
    return speed / stall.SPEED_OF_SOUND


def at_rest(station: int, alpha: np.ndarray, speed: float) -> tuple[np.ndarray, np.ndarray]:
    """Lift and drag coefficients that Gonzalez' variant has at rest: those of the polar, with the normal force at most
    on the line of attached flow C_n = slope (alpha - alpha_0) / beta, and the chord force at most C_n alpha."""
    c, (grid, data) = constants(station), polar(station)
    lift, drag = (np.interp(alpha, grid, data[:, column]) for column in (LIFT, DRAG))
    normal = lift * np.cos(alpha) + (drag - c["drag_0"]) * np.sin(alpha)
    chordwise = lift * np.sin(alpha) - (drag - c["drag_0"]) * np.cos(alpha)
    line = c["slope"] / np.sqrt(1.0 - mach(speed) ** 2) * (alpha - c["alpha_0"])
    assert (alpha > 0.0).all()
    assert (chordwise > -stall.CHORD_OFFSET * line * alpha).all(), "below this the variant mirrors the chord force"
    normal, chordwise = np.minimum(normal, line), np.minimum(chordwise, line * alpha)
    return (
        normal * np.cos(alpha) + chordwise * np.sin(alpha),
        normal * np.sin(alpha) - chordwise * np.cos(alpha) + c["drag_0"],
    )


@pytest.mark.parametrize("station", [OUTER, THICK])
def test_held_angle_gives_the_polar_or_the_line_of_attached_flow(station: int) -> None:
    """Kirchhoff's factor is found from the polar and put back, so that at rest nothing else is left of the model."""
    speed, angles = 50.0, np.radians([2.0, 5.0, 8.0, 12.0, 18.0, 25.0])
    runs = [run(station, np.full(2000, alpha), speed, 0.0125) for alpha in angles]
    lift, drag = at_rest(station, angles, speed)
    assert [r["lift"][-1] for r in runs] == pytest.approx(lift, abs=1e-6)  # 1e-9 in the model's quotients
    assert [r["drag"][-1] for r in runs] == pytest.approx(drag, abs=1e-6)
    assert [r["lift"][0] for r in runs] == pytest.approx(lift, abs=1e-6)  # the first sample is taken as steady
    grid, data = polar(station)
    unlike_the_polar = np.abs(lift - np.interp(angles, grid, data[:, LIFT])) > 1e-3
    assert 0 < unlike_the_polar.sum() < angles.size


def response(k: float, quantity: str, speed: float = 17.0, per_cycle: int = 2000) -> tuple[complex, float]:
    """Complex ratio of a force (or "alpha", the low-passed angle) to a small oscillation of the angle of attack at
    reduced frequency k = omega c / (2 U), over its eighth cycle; and the sample time."""
    c = constants(OUTER)
    dt = np.pi * c["chord"] / (k * speed) / per_cycle
    phase = 2.0 * np.pi * np.arange(8 * per_cycle) / per_cycle
    amplitude = np.radians(0.1)
    alpha = c["alpha_0"] + np.radians(2.0) + amplitude * np.sin(phase)
    got = run(OUTER, alpha, speed, dt)[quantity][-per_cycle:]
    basis = np.exp(-1j * phase[-per_cycle:])
    return 2j * np.mean((got - got.mean()) * basis) / amplitude, dt


def indicial(k: float, speed: float) -> tuple[complex, complex]:
    """Closed forms: the low-pass on the angle of attack, and potential flow's circulatory and impulsive normal force
    per angle of attack behind it (NREL/TP-5000-66347, eqs. 1.10 to 1.18, as transfer functions of s = i omega)."""
    c, M = constants(OUTER), mach(speed)
    beta_2 = 1.0 - M**2
    low_pass = 1.0 / (1.0 + 1j * k / stall.FILTER_CUT_OFF)
    lag = sum(A * 1j * k / (1j * k + b * beta_2) for A, b in ((stall.A1, stall.B1), (stall.A2, stall.B2)))
    q = 2j * k  # dimensionless rate c alpha' / U
    weight = stall.A1 * stall.B1 + stall.A2 * stall.B2
    T_alpha, T_q = (
        0.75 * c["chord"] / stall.SPEED_OF_SOUND / (1.0 - M + factor * c["slope"] * M**2 * np.sqrt(beta_2) * weight)
        for factor in (0.5, 1.0)
    )
    omega = 2.0 * k * speed / c["chord"]
    impulsive = 4.0 * T_alpha / M * speed / c["chord"] * q * low_pass / (1.0 + 1j * omega * T_alpha)
    impulsive -= T_q / M * 1j * omega * q * low_pass / (1.0 + 1j * omega * T_q)
    return low_pass, c["slope"] / np.sqrt(beta_2) * (1.0 - lag) + impulsive


@pytest.mark.parametrize("k", [0.02, 0.05, 0.1, 0.3])
def test_attached_flow_follows_the_indicial_closed_form(k: float) -> None:
    speed = 17.0  # Mach 0.05
    low_pass, normal_force = indicial(k, speed)
    got, _ = response(k, "alpha")
    # 2000 samples a cycle: half a sample's lag is 1.6e-3 rad.
    assert got == pytest.approx(low_pass, abs=2e-3)
    got, _ = response(k, "N_potential")
    assert got == pytest.approx(low_pass * normal_force, rel=5e-3)
    beta_2 = 1.0 - mach(speed) ** 2
    for name, A, b in (("X3", stall.A1, stall.B1), ("X4", stall.A2, stall.B2)):  # of the pitch rate, eq. 1.16
        deficiency = A * 1j * k / (1j * k + b * beta_2) * 2j * k * low_pass**2
        assert response(k, name)[0] == pytest.approx(deficiency, rel=5e-3, abs=1e-6)


@pytest.mark.parametrize("k", [0.02, 0.05, 0.1])
def test_attached_flow_is_near_theodorsens(k: float) -> None:
    """Theodorsen's lift in plunge over the steady one, C(k) + i k / 2, against the model's of the low-passed angle.

    Within 0.1 and 3 degrees: Beddoes' constants were fitted to compressible indicial functions, and their impulsive
    force at low Mach number, 6 i k / 2 pi from matching the first instant, is twice the added mass of incompressible
    flow.
    """
    lift_deficiency = hankel2(1, k) / (hankel2(1, k) + 1j * hankel2(0, k))
    exact = lift_deficiency + 0.5j * k
    slope = constants(OUTER)["slope"] / np.sqrt(1.0 - mach(17.0) ** 2)
    got = response(k, "N_potential")[0] / response(k, "alpha")[0] / slope
    assert abs(got - exact) < 0.1
    assert abs(got) < 1.0
    assert np.angle(got) == pytest.approx(np.angle(exact), abs=np.radians(3.0))
    assert np.angle(got) < 0.0  # the shed wake outweighs the added mass


def loop(
    station: int, mean: float, amplitude: float, k: float, cycles: int = 3, speed: float = 50.0
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Angle and what `run` gives over the last cycle of a large oscillation, degrees, at 0.0125 s."""
    omega = 2.0 * k * speed / constants(station)["chord"]
    per_cycle = round(2.0 * np.pi / omega / 0.0125)
    phase = 2.0 * np.pi * np.arange(cycles * per_cycle + 1) / per_cycle
    alpha = np.radians(mean + amplitude * np.sin(phase))
    got = run(station, alpha, speed, 0.0125)
    return alpha[-per_cycle - 1 :], {name: v[-per_cycle - 1 :] for name, v in got.items()}


def test_deep_stall_loop_turns_clockwise_about_the_static_lift() -> None:
    """Separation comes late and goes late: more lift than static on the way up, less on the way down."""
    alpha, got = loop(OUTER, 15.0, 8.0, 0.05)
    grid, data = polar(OUTER)
    excess = got["lift"] - np.interp(alpha, grid, data[:, LIFT])
    rising = np.gradient(alpha) > 0
    middle = np.abs(alpha - np.radians(15.0)) < np.radians(4.0)
    assert excess[rising & middle].min() > 0.05
    assert excess[~rising & middle].max() < -0.05
    assert np.trapezoid(got["lift"], alpha) > 0.05  # clockwise
    assert got["lift"].max() > data[:, LIFT].max() + 0.2  # the leading-edge vortex
    assert got["N_vortex"].max() > 0.1
    assert got["f"].min() < 0.3


def test_separation_is_twice_as_fast_in_leading_edge_stall_and_half_as_fast_after_it() -> None:
    """Eqs. 1.36-1.37 with T_f = 3 / sigma semi-chords, sigma from the lagged normal force of the sample before."""
    _, got = loop(OUTER, 15.0, 8.0, 0.05)
    lagged, ds = got["N_lagged"], 2.0 * 50.0 * 0.0125 / constants(OUTER)["chord"]
    stalled, growing = lagged[1:] > constants(OUTER)["stall"], np.diff(lagged) > 0.0
    assert set(got["sigma"]) == {0.5, 1.0, 2.0}
    assert (got["sigma"][1:][stalled & growing] == 2.0).all()
    assert (got["sigma"][1:][~stalled & ~growing] == 0.5).all()
    half = np.exp(-0.5 * ds * got["sigma"][:-1] / 3.0)
    expected = got["D_f"][:-1] * half**2 + np.diff(got["f"]) * half
    assert got["D_f"][1:] == pytest.approx(expected, abs=1e-12)


def test_stalled_section_sheds_vortices_at_the_strouhal_number() -> None:
    """Eq. 1.54: past stall a new vortex starts T_VL + T_sh after the last, T_sh = 2 (1 - f'') / 0.19 semi-chords.
    The angle creeps up, for the model sheds anew only while the lagged normal force grows."""
    speed, dt = 50.0, 0.0025
    ds = 2.0 * speed * dt / constants(OUTER)["chord"]
    got = run(OUTER, np.radians(np.linspace(16.0, 24.0, 2500)), speed, dt)
    assert (got["N_lagged"] > constants(OUTER)["stall"]).all()
    shed = np.flatnonzero(np.diff(got["tau"]) < 0.0) + 1
    assert shed.size > 8
    separated = 1.0 - (got["f"] - got["D_f"])[shed[1:]]
    assert separated.min() > 0.4
    # To the sample in which it comes.
    assert np.diff(shed) * ds == pytest.approx(11.0 + 2.0 * separated / 0.19, abs=1.01 * ds)


def test_slow_oscillation_through_stall_is_steady() -> None:
    """The loop closes in proportion to the frequency."""

    def widest(k: float) -> float:
        alpha, got = loop(THICK, 14.0, 5.0, k, cycles=2)
        return float(np.abs(got["lift"] - at_rest(THICK, alpha, 50.0)[0]).max())

    coarse, fine = widest(0.004), widest(0.001)
    assert fine < 0.03
    assert fine < 0.4 * coarse


def test_attached_oscillation_sheds_no_vortex() -> None:
    _, got = loop(OUTER, 0.0, 2.0, 0.05)
    assert (got["tau"] == 0.0).all()  # so that the little that separates at the trailing edge feeds none


def test_model_fades_into_the_polars_between_40_and_45_degrees() -> None:
    angles = np.radians([0.0, 39.9, 42.5, 45.0, 90.0, -42.5])
    assert np.array([float(ca.DM(stall.fade(a))) for a in angles]) == pytest.approx([1.0, 1.0, 0.5, 0.0, 0.0, 0.5])
