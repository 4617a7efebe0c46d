"""Momentum theory, loss factors, dynamic inflow and blade data of the rotor model."""

from __future__ import annotations

from functools import cache

import casadi as ca
import numpy as np
import pytest
from scipy import signal

from fmus_src.aero.geometry import rotor, section_tables
from fmus_src.aero.momentum import (
    OYE_K,
    SKEW_CONSTANT,
    Place,
    induction_step,
    momentum_thrust,
    oye_filter,
    oye_time_constant,
    prandtl_factor,
    skew_factor,
)
from fmus_src.aero.polars import DRAG, LIFT, LIFT_SLOPE


def value(expression: object) -> float:
    return float(ca.DM(expression))


def thrust_coefficient(a: float, loss: float = 1.0, wind: float = 8.0) -> float:
    """C_T = 4 (thrust per area over 2 rho) / V^2."""
    return 4.0 * value(momentum_thrust(wind, a * wind, loss)[0]) / wind**2


def test_betz_limit() -> None:
    a = np.linspace(0.01, 0.4, 391)
    power = np.array([thrust_coefficient(x) * (1.0 - x) for x in a])
    assert power.max() == pytest.approx(16.0 / 27.0, rel=1e-4)  # grid of a: 1e-3
    assert a[power.argmax()] == pytest.approx(1.0 / 3.0, abs=1e-3)


@pytest.mark.parametrize("loss", [1.0, 0.7, 0.3])
def test_high_thrust_branch_is_buhls_parabola(loss: float) -> None:
    """Joins 4 F a (1 - a) at a = 0.4 in value and slope and ends at C_T = 2 for a = 1 (Buhl 2005)."""
    h = 1e-5
    assert thrust_coefficient(0.4, loss) == pytest.approx(0.96 * loss, rel=1e-9)
    above = (thrust_coefficient(0.4 + h, loss) - thrust_coefficient(0.4, loss)) / h
    assert above == pytest.approx(4.0 * loss * 0.2, abs=1e-3)  # second difference h * C_T'' / 2
    assert thrust_coefficient(1.0, loss) == pytest.approx(2.0, rel=1e-9)
    for a in (0.2, 0.7):
        slope = value(momentum_thrust(8.0, 8.0 * a, loss)[1])
        rise = value(momentum_thrust(8.0, 8.0 * a + h, loss)[0] - momentum_thrust(8.0, 8.0 * a - h, loss)[0])
        assert slope == pytest.approx(rise / (2 * h), rel=1e-6)  # rounding of 1e-16 * 16 / h


def test_prandtl_factor() -> None:
    r, sine = rotor().radius[10], 0.12
    tip, hub = 1.5 * (63.0 - r) / r, 1.5 * (r - 1.5) / 1.5
    expected = (2.0 / np.pi) ** 2 * np.arccos(np.exp(-tip / sine)) * np.arccos(np.exp(-hub / sine))
    assert value(prandtl_factor(sine, tip, hub)) == pytest.approx(expected, rel=1e-12)
    assert value(prandtl_factor(-sine, tip, hub)) == pytest.approx(expected, rel=1e-12)
    # Far from both ends nothing is lost, and at the tip all.
    assert value(prandtl_factor(sine, 20.0, 20.0)) == pytest.approx(1.0, abs=1e-9)
    assert value(prandtl_factor(sine, 0.0, 20.0)) < 1e-3


@cache
def induction() -> ca.Function:
    """One sample of a section with a lift slope of 6: normal wind, induced velocities -> induced velocities."""
    V, w, t = (ca.SX.sym(name) for name in "Vwt")
    alpha = ca.atan2(V - w, 60.0 + t)
    place = Place(V, 60.0, 3.0, 45.0, 1.0, 40.0)
    return ca.Function("induction", [V, w, t], list(induction_step(place, w, t, 6.0 * alpha, 6.0)))


def settled(normal: float, samples: int = 60) -> tuple[float, float, float]:
    """Axial and tangential induced velocity after some samples from none, and what the axial balance lacks."""
    w, t = 0.0, 0.0
    for _ in range(samples):
        w, t = (float(x) for x in induction()(normal, w, t))
    un, ut = normal - w, 60.0 + t
    speed = np.hypot(un, ut)
    loss = value(prandtl_factor(un / speed, 1.0, 40.0))
    load = 3.0 * 3.0 / (8.0 * np.pi * 45.0) * speed * 6.0 * np.arctan2(un, ut) * ut
    sign = np.sign(normal)
    return w, t, value(momentum_thrust(abs(normal), sign * w, loss)[0]) - sign * load


@pytest.mark.parametrize("normal", [14.0, 9.0, 4.0, 1.0, -6.0])
def test_newton_steps_reach_the_balance_of_momentum(normal: float) -> None:
    """From no induction, light to heavily loaded (below 7 m/s: a > 0.4), and with the wind from behind."""
    w, _, residual = settled(normal)
    assert abs(residual) < 1e-9 * normal**2
    assert 0.0 < w / normal < 1.5
    assert (w / normal > 0.4) == (abs(normal) < 7.0)


def test_one_step_a_sample_follows_gusts() -> None:
    """2 m/s within 3 s: the induced velocity lags its equilibrium in proportion to the sample time, by 1e-4 m/s."""

    def lag(dt: float) -> float:
        (w, t, _), largest = settled(11.0), 0.0
        for n in range(round(3.0 / dt)):
            wind = 11.0 + 2.0 * np.sin(2.0 * np.pi * (n + 1) * dt / 3.0)
            w, t = (float(x) for x in induction()(wind, w, t))
            if n % 16 == 0:
                largest = max(largest, abs(w - settled(wind)[0]))
        return largest

    assert lag(0.0125) < 2e-4
    assert lag(0.0125) / lag(0.00625) == pytest.approx(2.0, rel=0.1)


def test_wind_from_behind_mirrors_the_induction() -> None:
    ahead, behind = settled(6.0), settled(-6.0)
    # The blade's lift turns with the wind: the same axial flow mirrored, the same swirl.
    assert behind[0] == pytest.approx(-ahead[0], rel=1e-9)
    assert behind[1] == pytest.approx(ahead[1], rel=1e-9)


def test_skewed_wake() -> None:
    """Pitt and Peters: none at the hub or across, as much less upwind as more downwind; 30 deg at a = 1/3."""
    chi = (1.0 + 0.6 / 3.0) * np.radians(30.0)
    expected = SKEW_CONSTANT * np.tan(0.5 * chi) * 0.8
    for downwind in (-1.0, 0.0, 1.0):
        got = value(skew_factor(3.0, 9.0, np.radians(30.0), downwind, 0.8))
        assert got == pytest.approx(1.0 + expected * downwind, rel=1e-3)  # 1e-3 m/s beside the wind
    assert value(skew_factor(3.0, 9.0, 0.0, 1.0, 1.0)) == pytest.approx(1.0)


def test_oye_filter_is_hansens_transfer_function_to_second_order() -> None:
    """Eqs. 9.15-9.16: (1 + k tau_1 s) / ((1 + tau_1 s) (1 + tau_2 s)), here after a unit step."""
    tau_1, ratio = 6.0, 0.5
    tau_2 = (0.39 - 0.26 * ratio**2) * tau_1

    def error(h: float) -> float:
        s = w = 0.0
        path = []
        for _ in range(round(20.0 / h)):
            s, w = (value(x) for x in oye_filter(1.0, s, w, tau_1, ratio, h))
            path.append(w)
        denominator = np.polymul([tau_1, 1.0], [tau_2, 1.0])
        response = signal.TransferFunction([0.6 * tau_1, 1.0], denominator)
        exact = signal.step(response, T=h * np.arange(len(path) + 1))[1][1:]
        return float(np.abs(np.array(path) - exact).max())

    assert error(0.1) < 1e-4
    assert error(0.2) / error(0.1) == pytest.approx(4.0, rel=0.05)


def test_oye_filter_keeps_an_equilibrium() -> None:
    s, w = oye_filter(2.5, (1.0 - OYE_K) * 2.5, 2.5, 5.0, 0.7, 0.0125)
    assert (value(s), value(w)) == pytest.approx(((1.0 - OYE_K) * 2.5, 2.5))


def test_oye_time_constant() -> None:
    """Hansen eq. 9.18 at a = 0.3, R = 63 m, V = 8 m/s; slow wind and heavy induction are bounded."""
    assert value(oye_time_constant(8.0, 0.3, 63.0)) == pytest.approx(1.1 / 0.61 * 63.0 / 8.0)
    assert value(oye_time_constant(0.0, 3.0, 63.0)) == pytest.approx(1.1 / 0.35 * 63.0)


def test_blade_data() -> None:
    """Figures of NREL/TP-500-38060: 61.5 m blade, largest chord 4.652 m, root twist 13.308 deg, solidity."""
    r = rotor()
    assert (r.blades, r.tip_radius, r.hub_radius) == (3, 63.0, 1.5)
    assert r.span[-1] == pytest.approx(61.5, abs=1e-3)
    assert r.chord.max() == 4.652
    assert np.degrees(r.twist[0]) == pytest.approx(13.308)
    assert (np.diff(r.radius) > 0).all()
    assert (np.diff(r.twist) <= 0).all()
    assert r.area_weights.sum() == pytest.approx(1.0)


def test_lumped_loads_are_exact_for_piecewise_linear_loads() -> None:
    r = rotor()
    load = np.random.default_rng(1).normal(size=r.span.size)
    fine = np.linspace(0.0, r.span[-1], 400_001)
    density = np.interp(fine, r.span, load)
    lumped = r.load_lumping @ load
    # Trapezoidal rule on 400,000 intervals: kinks between nodes leave about 1e-5.
    assert lumped.sum() == pytest.approx(np.trapezoid(density, fine), abs=1e-4)
    assert r.span @ lumped == pytest.approx(np.trapezoid(density * fine, fine), abs=1e-2)


def test_section_tables_hold_the_published_polars() -> None:
    data, first, spacing = section_tables()
    assert first == pytest.approx(-np.pi)
    assert data.shape[1] == 721
    alpha = np.degrees(first + spacing * np.arange(721))
    outer = data[rotor().section[-1]]
    at = {round(a, 6): row for a, row in zip(alpha, outer, strict=True)}
    # NACA 64-618 with stall delay: published points at 0, 5 and 90 deg.
    assert (at[0.0][LIFT], at[5.0][LIFT], at[90.0][LIFT]) == pytest.approx((0.442, 1.011, 0.053))
    assert (at[0.0][DRAG], at[90.0][DRAG]) == pytest.approx((0.0052, 1.4565))
    cylinder = data[rotor().section[0]]
    assert (cylinder[:, LIFT] == 0.0).all()
    assert (cylinder[:, DRAG] == 0.5).all()
    # The two ends of the circle are one angle, but for the slope, which differs by side.
    assert data[:, 0, :LIFT_SLOPE] == pytest.approx(data[:, -1, :LIFT_SLOPE], abs=1e-12)
    between = np.diff(outer[:, LIFT]) / spacing
    assert outer[1:-1, LIFT_SLOPE] == pytest.approx(0.5 * (between[1:] + between[:-1]))
