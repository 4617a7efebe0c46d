"""The damper unit against closed forms and Newton's law."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from fmus_src.component import Component
from fmus_src.equations import derive
from fmus_src.instance import Instance, simulate
from fmus_src.tmd.model import component, stop_force, stop_switches

FORCE = "attachment.specific_force"


def _coarse() -> Component:
    """The damper with a longer internal step: enough for smooth motion, and quick."""
    c = component()
    c.internal_step = 0.05
    return c


def test_free_decay() -> None:
    m, k, c, x0 = 20_000.0, 6302.0, 1598.0, 2.0
    run = simulate(_coarse(), stop=15.0, step=0.05, parameters={"initial_displacement": x0})
    t = run.index.to_numpy()
    decay = c / (2 * m)
    omega = np.sqrt(k / m - decay**2)
    exact = x0 * np.exp(-decay * t) * (np.cos(omega * t) + decay / omega * np.sin(omega * t))
    # RK4 errs by (omega h)^5 / 120 = 1e-10 of the amplitude in each of 300 steps
    assert run["displacement"].to_numpy() == pytest.approx(exact, abs=1e-7)
    assert run["force[1]"].to_numpy() == pytest.approx(k * exact + c * run["velocity"].to_numpy(), abs=1e-2)


def test_steady_response_to_harmonic_acceleration_of_the_attachment() -> None:
    m, natural, ratio, omega, amplitude = 2e4, 2.0, 0.4, 1.6, 0.5
    parameters = {"m": m, "k": m * natural**2, "c": 2 * ratio * natural * m}
    run = simulate(
        _coarse(), stop=18.0, step=0.05, parameters=parameters,
        inputs=lambda t: {f"{FORCE}[1]": amplitude * np.sin(omega * t)},
    )  # fmt: skip
    transfer = -amplitude / (natural**2 - omega**2 + 2j * ratio * natural * omega)
    late = run[run.index > 14.0]  # the transient has decayed to exp(-11)
    exact = np.imag(transfer * np.exp(1j * omega * late.index.to_numpy()))
    # inputs are linear over a step: (omega h)^2 / 12 = 5e-4 of the amplitude
    assert late["displacement"].to_numpy() == pytest.approx(exact, abs=8e-4 * abs(transfer))


@pytest.mark.parametrize(
    ("x", "v", "expected"),
    [
        (7.9, 3.0, 0.0),
        (-7.9, -3.0, 0.0),
        (8.2, -1.0, -1e5),  # returning: spring only
        (8.2, 1.0, -1e5 - 5e5),  # moving out: spring and damping
        (-8.2, 1.0, 1e5),
        (-8.2, -1.0, 1e5 + 5e5),
        (8.2, 0.0, -1e5),
    ],
)
def test_stop_force_law(x: float, v: float, expected: float) -> None:
    contact = stop_switches(ca.DM(x), ca.DM(v), 8.0) > 0
    assert float(stop_force(x, v, 8.0, 5e5, 5e5, contact)) == pytest.approx(expected, abs=1e-6)


def test_stop_turns_the_damper_back_and_takes_its_energy() -> None:
    """Against the closed form of free flight, contact and flight back, with the order of convergence."""
    m, stop, stroke = 20_000.0, 5e5, 8.0
    arrival, begin, end = 1.8, 7.81, 1.6  # 0.9 s at 2 m/s2 from 7 m, then free for 1.6 s
    # moving out against the stop it is overdamped: m y'' + c y' + k y = 0, up to the turning point
    fast, slow = np.roots([m, stop, stop])
    turn = np.log(fast / slow) / (slow - fast)
    travel = arrival / (slow - fast) * (np.exp(slow * turn) - np.exp(fast * turn))
    # back only the spring acts, for a quarter of its period: the damper leaves with the spring's energy
    natural = np.sqrt(stop / m)
    leaving = -travel * natural
    flight = end - (stroke - begin) / arrival - turn - 0.5 * np.pi / natural
    exact = np.array([stroke + leaving * flight, leaving])
    errors = []
    for step in (0.05, 0.025, 0.0125):
        c = component()
        c.internal_step = step
        damper = Instance(c)
        damper.set({"k": 0.0, "c": 0.0, "initial_displacement": 7.0})
        damper.initialise()
        damper.set({f"{FORCE}[1]": -2.0})
        damper.do_step(0.9)
        damper.set({f"{FORCE}[1]": 0.0})
        damper.do_step(end)
        errors.append(np.abs([damper.get("displacement"), damper.get("velocity")] - exact))
    # (25 1/s * 0.0125 s)^5 / 120 = 2e-5 of the contact in each of some ten steps; 1e-5 m or m/s as found
    assert errors[2] == pytest.approx([0.0, 0.0], abs=2e-5)
    # fourth order; a step across contact would leave the first. The coarser steps are larger still than their limit
    assert np.all(errors[0] / errors[1] > 2.0**3.8)
    assert np.all(errors[1] / errors[2] > 2.0**3.8)


@pytest.mark.parametrize("speed", [0.0, 1e-9, 3.0])
def test_a_damper_that_starts_on_its_stop(speed: float) -> None:
    """Its contact function is zero: the sign taken is that of the motion that follows."""
    damper = Instance(component())
    damper.set({"k": 0.0, "c": 0.0, "initial_displacement": 8.0, f"{FORCE}[1]": -1.0})
    damper.initialise()
    damper.set_states(np.array([8.0, speed]))
    damper.do_step(0.1)  # before it turns back
    # m y'' + c y' + k y = m (1 m/s2)
    fast, slow = np.roots([20_000.0, 5e5, 5e5])
    rest = 20_000.0 / 5e5
    a = (speed + slow * rest) / (fast - slow)
    exact = 8.0 + rest + a * np.exp(fast * 0.1) - (rest + a) * np.exp(slow * 0.1)
    # (25 1/s * 0.0125 s)^5 / 120 = 2e-5 of speed / 25 1/s, in some eight steps
    assert damper.get("displacement") == pytest.approx(exact, abs=1e-6 + 1e-5 * speed)


def test_a_damper_held_against_its_stop_comes_to_rest() -> None:
    """Velocity crosses zero again and again, ever smaller: k_stop y = m (1 m/s2) in the end."""
    damper = Instance(_coarse())
    damper.set({"k": 0.0, "c": 0.0, "initial_displacement": 8.2, f"{FORCE}[1]": -1.0})
    damper.initialise()
    damper.do_step(30.0)
    assert damper.get("displacement") == pytest.approx(8.0 + 20_000.0 / 5e5, abs=1e-9)
    assert damper.get("velocity") == pytest.approx(0.0, abs=1e-9)


def test_at_rest_the_weight_is_carried() -> None:
    damper = Instance(component())
    damper.set({"initial_displacement": 1.5})
    damper.initialise()
    assert damper.get("force[1]") == pytest.approx(1.5 * 6302.0)
    assert damper.get("force[3]") == pytest.approx(-20_000 * 9.80665)
    # the weight at x = 1.5 m pitches the body nose down, positive about y
    assert damper.get("moment[2]") == pytest.approx(1.5 * 20_000 * 9.80665)
    assert damper.derivative()[1] == pytest.approx(-1.5 * 6302.0 / 20_000)


@pytest.mark.parametrize("axis", ["attachment.angular_velocity[2]", "attachment.angular_velocity[3]"])
def test_constant_rotation_is_a_negative_spring(axis: str) -> None:
    spin = np.sqrt(6302.0 / 20_000)
    damper = Instance(component())
    damper.set({axis: spin, "initial_displacement": 2.0})
    damper.initialise()
    assert damper.derivative()[1] == pytest.approx(0.0, abs=1e-12)  # the spring just holds it
    damper.set({axis: 2 * spin})
    assert damper.derivative()[1] == pytest.approx(3 * spin**2 * 2.0)


def test_rotation_about_its_own_axis_does_nothing() -> None:
    damper = Instance(component())
    damper.set({"attachment.angular_velocity[1]": 3.0, "initial_displacement": 2.0})
    damper.initialise()
    assert damper.derivative()[1] == pytest.approx(-2.0 * 6302.0 / 20_000)


def test_force_on_the_body_is_newtons_law_in_the_inertial_frame() -> None:
    """Differentiating the damper's path twice in the inertial frame gives the force, whatever the body does."""
    t, x, v, rail = (ca.SX.sym(n) for n in ("t", "x", "v", "rail"))
    attachment = ca.vertcat(ca.sin(t), 2 * ca.cos(0.7 * t), 0.5 * t**2)
    rotation = _rotation(0.3 * ca.sin(1.3 * t), 0.5 * ca.cos(t), 0.4 * t)
    gravity = ca.vertcat(0, 0, -9.80665)

    def rate(expression: ca.SX) -> ca.SX:
        """Time derivative along the motion: x' = v, v' = rail."""
        return ca.jtimes(expression, ca.vertcat(t, x, v), ca.vertcat(1, v, rail))

    spin = rotation.T @ rate(rotation)  # body frame
    omega = ca.vertcat(spin[2, 1], spin[0, 2], spin[1, 0])
    inputs = ca.vertcat(rotation.T @ (rate(rate(attachment)) - gravity), omega, rate(omega))
    path = attachment + rotation @ ca.vertcat(x, 0, 0)
    kinematics = ca.Function("kinematics", [t, x, v, rail], [inputs, rotation.T @ (rate(rate(path)) - gravity)])

    damper = Instance(component())
    damper.initialise()
    damper._values["x"][:] = 1.2, -0.7
    u, _ = kinematics(0.9, 1.2, -0.7, 0.0)  # the inputs do not depend on the damper
    names = [n for variable in derive(component()).of("input") for n in variable.element_names()]
    damper.set(dict(zip(names, u.full().ravel().tolist(), strict=True)))
    acceleration = damper.derivative()[1]
    _, relative = kinematics(0.9, 1.2, -0.7, acceleration)
    force = np.array([damper.get(f"force[{i}]") for i in (1, 2, 3)])
    assert force == pytest.approx(-20_000.0 * relative.full().ravel(), rel=1e-10)
    moment = np.array([damper.get(f"moment[{i}]") for i in (1, 2, 3)])
    assert moment == pytest.approx(np.cross([1.2, 0.0, 0.0], force), rel=1e-12)


def _rotation(a: ca.SX, b: ca.SX, c: ca.SX) -> ca.SX:
    def about(axis: int, angle: ca.SX) -> ca.SX:
        i, j = (axis + 1) % 3, (axis + 2) % 3
        matrix = ca.SX.eye(3)
        matrix[i, i] = matrix[j, j] = ca.cos(angle)
        matrix[i, j], matrix[j, i] = -ca.sin(angle), ca.sin(angle)
        return matrix

    return about(2, c) @ about(1, b) @ about(0, a)
