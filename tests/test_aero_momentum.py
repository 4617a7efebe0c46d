"""Momentum theory, loss factors, dynamic inflow and blade data of the rotor model."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from scipy import signal

from fmus_src.aero.geometry import (
    DRAG,
    DRAG_CHANGE,
    LIFT,
    LIFT_CHANGE,
    attached_flow_change,
    rotor,
    section_tables,
)
from fmus_src.aero.momentum import OYE_K, momentum_velocity, oye_rates, oye_time_constants, prandtl_factor


def thrust_coefficient(a: float, loss: float = 1.0, wind: float = 8.0) -> float:
    """C_T = 4 a (F U*) / V."""
    return 4.0 * a * float(ca.DM(momentum_velocity(wind, a * wind, loss))) / wind


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


def test_momentum_is_symmetric_in_the_direction_of_the_wind() -> None:
    for a in (-0.2, 0.2, 0.7, 1.5):
        forward = float(ca.DM(momentum_velocity(9.0, a * 9.0, 0.8)))
        assert float(ca.DM(momentum_velocity(-9.0, -a * 9.0, 0.8))) == pytest.approx(forward, rel=1e-12)


def test_prandtl_factor() -> None:
    r, sine = rotor().radius[10], 0.12
    tip, hub = (np.exp(-1.5 * x / sine) for x in ((63.0 - r) / r, (r - 1.5) / 1.5))
    expected = (2.0 / np.pi) ** 2 * np.arccos(tip) * np.arccos(hub)
    assert float(ca.DM(prandtl_factor(sine, r, 63.0, 1.5, 3))) == pytest.approx(expected, rel=1e-12)
    # Very many blades leave no loss inside, and the loss is complete at the tip.
    assert float(ca.DM(prandtl_factor(sine, 61.0, 63.0, 1.5, 1000))) == pytest.approx(1.0, abs=1e-9)
    assert float(ca.DM(prandtl_factor(sine, 63.0, 63.0, 1.5, 3))) < 0.021


def test_oye_filter_is_hansens_transfer_function() -> None:
    """Eqs. 9.15-9.16: (1 + k tau_1 s) / ((1 + tau_1 s) (1 + tau_2 s)), here after a unit step."""
    tau_1, tau_2, h = 6.0, 1.7, 0.01
    y = w = 0.0
    path = [0.0]
    for _ in range(2000):  # trapezoidal rule by two passes: second order in h
        first = oye_rates(1.0, y, w, tau_1, tau_2)
        second = oye_rates(1.0, y + h * first.intermediate, w + h * first.induced, tau_1, tau_2)
        y += 0.5 * h * (first.intermediate + second.intermediate)
        w += 0.5 * h * (first.induced + second.induced)
        path.append(w)
    denominator = np.polymul([tau_1, 1.0], [tau_2, 1.0])
    t, exact = signal.step(signal.TransferFunction([OYE_K * tau_1, 1.0], denominator), T=np.arange(2001) * h)
    assert np.array(path) == pytest.approx(exact, abs=1e-5)
    assert t[-1] > 3 * tau_1


def test_oye_time_constants() -> None:
    """Hansen eqs. 9.18-9.19 at a = 0.3, R = 63 m, V = 8 m/s; slow wind and heavy induction are bounded."""
    tau_1, tau_2 = oye_time_constants(8.0, 0.3, np.array([0.0, 63.0]), 63.0, 1.0)
    assert float(ca.DM(tau_1)) == pytest.approx(1.1 / 0.61 * 63.0 / 8.0)
    assert np.asarray(ca.DM(tau_2)).ravel() == pytest.approx([0.39 * float(ca.DM(tau_1)), 0.13 * float(ca.DM(tau_1))])
    slow, _ = oye_time_constants(0.0, 3.0, np.array([0.0]), 63.0, 1.0)
    assert float(ca.DM(slow)) == pytest.approx(1.1 / 0.35 * 63.0)


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
    # The two ends of the circle are one angle.
    assert data[:, 0] == pytest.approx(data[:, -1], abs=1e-12)


def test_attached_flow_limit() -> None:
    """Normal force never above 2 pi-like line of slope 6; unchanged below it, beyond 20 deg and for cylinders."""
    alpha = np.radians(np.linspace(-40.0, 40.0, 161))
    section = {"normal_force_slope": 6.0, "alpha_0_deg": -4.0, "drag_0": 0.0}
    steep, drag = 7.0 * np.sin(alpha + np.radians(4.0)), np.zeros_like(alpha)
    lift_change, drag_change = attached_flow_change(alpha, steep, drag, section)
    normal = (steep + lift_change) * np.cos(alpha) + drag_change * np.sin(alpha)
    inside = np.abs(alpha) < np.radians(19.9)
    line = 6.0 * np.abs(alpha + np.radians(4.0))
    assert (np.abs(normal)[inside] <= line[inside] + 1e-12).all()
    assert np.abs(normal[80] / line[80]) == pytest.approx(1.0)
    assert (lift_change[~inside] == 0.0).all()
    assert (drag_change[~inside] == 0.0).all()
    gentle = attached_flow_change(alpha, 5.0 * (alpha + np.radians(4.0)), drag, section)
    assert np.abs(gentle[:, inside]).max() < 1e-12
    data, _, _ = section_tables()
    assert not data[rotor().section[0]][:, [LIFT_CHANGE, DRAG_CHANGE]].any()
