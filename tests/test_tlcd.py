"""The liquid column damper against closed forms, Newton's and Euler's laws, and the conservation of energy."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from fmus_src.component import Component
from fmus_src.instance import Instance, simulate
from fmus_src.tlcd.model import Column, component
from fmus_src.tmd.model import component as tmd

from .moving_body import G, Particles, balance, on_the_body

M, RHO, B, H, RATIO, XI = 200_000.0, 1025.0, 34.0, 6.0, 1.7, 10.0
DENSITY = M / (2 * H + B / RATIO)
LENGTH = 2 * H + RATIO * B
NATURAL = np.sqrt(2 * G / LENGTH)
GIVEN = {"m": M, "B": B, "h": H, "ratio": RATIO, "xi": XI, "stroke": H}
FORCE = "attachment.specific_force"


def _coarse() -> Component:
    c = component()
    c.internal_step = 0.05
    return c


def test_natural_frequency_is_that_of_a_column_of_twice_its_length() -> None:
    """Without losses the column in a body at rest is exactly linear: w'' + 2 g / L_e w = 0."""
    run = simulate(_coarse(), stop=12.0, step=0.1, parameters=GIVEN | {"xi": 0.0, "initial_displacement": 4.0})
    exact = 4.0 * np.cos(NATURAL * run.index.to_numpy())
    # RK4 errs by (omega h)^5 / 120 = 1e-10 of the amplitude in each of 240 steps
    assert run["displacement"].to_numpy() == pytest.approx(exact, abs=1e-6)
    damper = Instance(component())
    damper.set(GIVEN)
    damper.initialise()
    assert damper.get("natural_frequency") == pytest.approx(NATURAL, rel=1e-14)
    assert damper.get("A") * RHO * (2 * H + B / RATIO) == pytest.approx(M, rel=1e-14)


def test_energy_goes_into_the_head_loss_only() -> None:
    run = simulate(_coarse(), stop=15.0, step=0.05, parameters=GIVEN | {"initial_displacement": 4.0})
    w, v = run["displacement"].to_numpy(), run["velocity"].to_numpy()
    energy = DENSITY * (LENGTH * v**2 / 2 + G * w**2)
    power = DENSITY * XI * np.abs(v) ** 3 / 2
    lost = np.sum((power[1:] + power[:-1]) / 2) * 0.05
    assert lost > 0.2 * energy[0]
    # the trapezoidal sum over 1.3 periods errs by (3 omega h)^2 / 12 = 5e-4 at most, less over whole half periods
    assert energy[0] - energy[-1] == pytest.approx(lost, rel=5e-4)


@pytest.mark.parametrize("angle", [0.05, -0.3])
def test_in_a_tilted_body_the_surface_is_level(angle: float) -> None:
    """Both surfaces at one height: the downwind leg, which dips, is filled by B tan(angle) / 2."""
    damper = Instance(component())
    damper.set(GIVEN)
    damper.initialise()
    damper.set({f"{FORCE}[1]": -G * np.sin(angle), f"{FORCE}[3]": G * np.cos(angle)})
    damper.set_states(np.array([B * np.tan(angle) / 2, 0.0]))
    assert damper.derivative() == pytest.approx([0.0, 0.0], abs=1e-14)


def test_off_its_level_the_column_turns_the_body() -> None:
    """Weight off the middle pitches the body by rho A B w g; the flow that it sets off, accelerated, reacts."""
    damper = Instance(component())
    damper.set(GIVEN)
    damper.initialise()
    w = 0.5
    damper.set_states(np.array([w, 0.0]))
    flow = -2 * G / LENGTH * w  # w''
    assert damper.derivative()[1] == pytest.approx(flow, rel=1e-13)
    assert damper.get("force[1]") == pytest.approx(-DENSITY * B * flow, rel=1e-12)
    assert damper.get("force[3]") == pytest.approx(-M * G - 2 * DENSITY * w * flow, rel=1e-12)
    assert damper.get("moment[2]") == pytest.approx(DENSITY * B * (w * G + H * flow), rel=1e-12)


def particles(w: ca.SX, v: ca.SX) -> Particles:
    """The liquid as points at Gauss's abscissae, four in each leg: exact for what is of degree 7 in position."""
    nodes, weights = np.polynomial.legendre.leggauss(4)
    masses, places, velocities = [], [], []
    for node, weight in zip(nodes, weights, strict=True):
        masses.append(DENSITY / RATIO * B / 2 * weight)
        places.append(ca.vertcat(B / 2 * node, 0, 0))
        velocities.append(ca.vertcat(RATIO * v, 0, 0))
        for side in (1, -1):
            height = H + side * w
            masses.append(DENSITY * height / 2 * weight)
            places.append(ca.vertcat(side * B / 2, 0, height / 2 * (1 + node)))
            velocities.append(ca.vertcat(0, 0, side * v))
    return Particles(masses, places, velocities)


def test_force_moment_and_power_are_those_of_the_flowing_liquid() -> None:
    """Whatever the body does: Newton's and Euler's law, and the power at the port equals energy's rate plus loss.

    The energy balance holds only if the column's own equation is right too, so this is Lagrange's equation as well.
    """
    states, rates = ca.SX.sym("x", 2), ca.SX.sym("rates", 2)
    for t, x in ((0.9, (1.2, -0.7)), (2.3, (-3.1, 1.9))):
        given, force, moment, power = on_the_body(component(), t, np.array(x), GIVEN)
        at = {"t": t, "states": x, "rates": given}
        asked = balance(particles(states[0], states[1]), states, rates, 0.0, at)
        assert force == pytest.approx(-asked.momentum, rel=1e-10)
        assert moment == pytest.approx(-asked.angular, rel=1e-9)
        loss = DENSITY * XI * abs(x[1]) ** 3 / 2
        assert power == pytest.approx(-asked.power - loss, rel=1e-9, abs=1e-9 * abs(asked.power))


def test_in_a_body_that_does_not_turn_it_is_a_mass_damper() -> None:
    """Of mass m_h^2 / M, m_h = rho A B, M = rho A L_e; the rest of the liquid goes with the body."""
    m_h, inertia = DENSITY * B, DENSITY * LENGTH
    mass = m_h**2 / inertia

    def given(t: float) -> dict[str, float]:
        return {f"{FORCE}[1]": 0.3 * float(np.sin(0.6 * t)) + 0.1}

    liquid = simulate(_coarse(), stop=10.0, step=0.05, parameters=GIVEN | {"xi": 0.0}, inputs=given)
    c = tmd()
    c.internal_step = 0.05
    solid = simulate(
        c, stop=10.0, step=0.05, parameters={"m": mass, "k": mass * NATURAL**2, "c": 0.0, "stroke": 1e9}, inputs=given
    )
    rest = np.array([-(M - mass) * given(t)[f"{FORCE}[1]"] for t in liquid.index])
    assert liquid["displacement"].to_numpy() == pytest.approx(m_h / inertia * solid["displacement"].to_numpy())
    assert np.ptp(liquid["displacement"]) > 1.0
    # the same equations: rounding only
    assert liquid["force[1]"].to_numpy() == pytest.approx(solid["force[1]"].to_numpy() + rest, rel=1e-9, abs=1e-4)


def test_liquid_stays_in_its_tube() -> None:
    """Closed ends, and no leg runs dry, whatever travel is asked for; what the ends take, they do not give back."""
    damper = Instance(_coarse())
    damper.set(GIVEN | {"stroke": 100.0, "h": 3.0, "xi": 0.0})
    damper.initialise()
    damper.set({f"{FORCE}[1]": 4.0})  # pushes the liquid upwind by more than the leg holds
    lowest = 0.0
    for _ in range(120):
        damper.do_step(0.05)
        lowest = min(lowest, damper.get("displacement"))
    inertia = M / (2 * 3.0 + B / RATIO) * (2 * 3.0 + RATIO * B)
    arrival = np.sqrt(2 * 4.0 * B / (2 * 3.0 + RATIO * B) * 3.0)
    # overshoot of an undamped stop is above that of the damped one; the liquid does get there
    assert -3.0 - arrival * np.sqrt(inertia / 2e7) - 0.1 < lowest < -3.0
    assert damper.get("displacement") == pytest.approx(-3.0, abs=0.1)
    assert damper.get("stop_force") > 0.0


def test_inertia_of_the_liquid_at_rest_is_that_of_three_rods() -> None:
    column = Column(DENSITY, B, H, RATIO)
    legs, bottom = DENSITY * H, DENSITY * B / RATIO
    x = 2 * legs * B**2 / 4 + bottom * B**2 / 12
    z = 2 * legs * H**2 / 3
    assert np.array(ca.DM(column.inertia(0.0))) == pytest.approx(np.diag([z, x + z, x]), rel=1e-12)
    assert float(column.mass) == pytest.approx(2 * legs + bottom) == pytest.approx(M)
