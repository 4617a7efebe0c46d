"""Controller: torque curve, filter, limits, gain scheduling, closed loop, published ratings."""

import numpy as np
import pytest

from fmus_src.equations import derive
from fmus_src.instance import Instance
from fmus_src.servo.model import component

DT = 0.0125
REFERENCE, RATED, POWER = 122.9096, 121.6805, 5_296_610.0
KP, KI, KK = 0.01255121, 0.003586059, 0.1099965
DRIVETRAIN_INERTIA = 43_784_725.0  # kg m2, low-speed side, NREL/TP-500-38060, section 7.3
PITCH_SENSITIVITY = -25.52e6  # W/rad at zero pitch, the fitted line of the same section
GEAR = 97.0


@pytest.fixture(scope="module")
def equations():
    return derive(component())


def start(equations, speed, pitch=0.0, **parameters):
    servo = Instance(equations)
    servo.set({"initial_generator_speed": speed, "initial_pitch": pitch, "generator.speed": speed, **parameters})
    servo.initialise()
    return servo


def advance(servo, speed, steps):
    """Hold the measured speed for a number of samples; the outputs after each."""
    servo.set({"generator.speed": speed})
    rows = []
    for _ in range(steps):
        servo.do_step(DT)
        rows.append([servo.get(n) for n in ("generator_torque", "pitch[1]", "filtered_speed", "speed_error_integral")])
    return np.array(rows)


def steady_torque(equations, speed, pitch=0.0):
    return start(equations, speed, pitch).get("generator_torque")


def test_torque_curve_in_every_region(equations):
    rated_torque, synchronous = POWER / RATED, RATED / 1.1
    assert steady_torque(equations, 60.0) == 0.0
    assert steady_torque(equations, 80.0) == pytest.approx(
        2.332287 * 91.21091**2 * (80 - 70.16224) / (91.21091 - 70.16224)
    )
    assert steady_torque(equations, 100.0) == pytest.approx(2.332287 * 100.0**2)
    middle = rated_torque * (120.5 - synchronous) / (RATED - synchronous)
    assert steady_torque(equations, 120.5) == pytest.approx(middle)
    for speed in (RATED, 125.0, 140.0):
        assert steady_torque(equations, speed) * speed == pytest.approx(POWER)


def test_torque_curve_is_continuous(equations):
    servo = start(equations, 100.0)
    end_of_2 = servo.get("region_2_end_speed")
    assert 91.21091 < end_of_2 < RATED
    assert end_of_2 == pytest.approx(119.0, abs=0.05)  # 1136.5 rpm: regions 2 and 2.5 meet just below rated speed
    for speed in (70.16224, 91.21091, end_of_2, RATED):
        below, above = (steady_torque(equations, speed * (1 + e)) for e in (-1e-7, 1e-7))
        assert below == pytest.approx(above, abs=0.1)  # the steepest region rises by 3.9 kN m s/rad


def test_published_ratings(equations):
    """NREL/TP-500-38060: rated torque 43,093.55 N m at 1173.7 rpm, 5 MW electric."""
    servo = start(equations, 1173.7 * np.pi / 30)
    assert servo.get("generator_torque") == pytest.approx(43_093.55, abs=0.1)
    assert servo.get("electrical_power") == pytest.approx(5e6, rel=1e-5)


def test_pitch_keeps_region_3_below_rated_speed(equations):
    degree = np.pi / 180
    assert steady_torque(equations, 118.0, 1.01 * degree) == pytest.approx(POWER / 118.0)
    assert steady_torque(equations, 118.0, 0.99 * degree) == pytest.approx(2.332287 * 118.0**2)
    assert steady_torque(equations, 100.0, 2 * degree) == 47_402.91  # torque limit


def test_power_is_torque_times_measured_speed(equations):
    servo = start(equations, REFERENCE, 0.1)
    servo.set({"generator.speed": 130.0})  # the torque in force does not know yet
    assert servo.get("electrical_power") == pytest.approx(0.944 * POWER / REFERENCE * 130.0)


def test_filter_step_response_is_exact(equations):
    servo = start(equations, 100.0)
    speed = advance(servo, 110.0, 40)[:, 2]
    time = DT * np.arange(1, 41)
    np.testing.assert_allclose(speed, 110.0 - 10.0 * np.exp(-1.570796 * time), rtol=1e-12)


def test_torque_rate_is_limited(equations):
    servo = start(equations, 80.0, speed_filter_corner=1e4)  # no filter: the wanted torque jumps
    torque = np.append(servo.get("generator_torque"), advance(servo, 119.0, 200)[:, 0])
    np.testing.assert_allclose(np.diff(torque)[:100], 15_000.0 * DT, rtol=1e-9)
    assert torque[-1] == pytest.approx(2.332287 * 119.0**2, rel=2e-3)
    falling = advance(servo, 60.0, 10)[:, 0]
    np.testing.assert_allclose(np.diff(falling), -15_000.0 * DT, rtol=1e-9)


def test_pitch_rate_is_limited_and_pitch_saturates(equations):
    servo = start(equations, REFERENCE, speed_filter_corner=1e4)
    pitch = np.append(0.0, advance(servo, 1000.0, 1000)[:, 1])
    np.testing.assert_allclose(np.diff(pitch)[:50], 8.0 * np.pi / 180 * DT, rtol=1e-6)  # 8 deg/s
    assert pitch[-1] == pytest.approx(1.570796)


def test_integral_does_not_wind_up(equations):
    """Long below rated speed, the integral rests at its lower limit, and pitch acts as soon as the speed exceeds it."""
    servo = start(equations, 100.0, speed_filter_corner=1e4)
    assert np.all(advance(servo, 100.0, 400)[:, 3] == 0.0)
    pitch = advance(servo, REFERENCE + 1.0, 1)[0, 1]
    assert pitch == pytest.approx(min(KP + KI * DT, 0.1396263 * DT))
    servo = start(equations, 300.0, 1.570796, speed_filter_corner=1e4)
    limit = servo.get("speed_error_integral")
    assert limit == pytest.approx(1.570796 / KI * (1 + 1.570796 / KK))
    assert np.all(advance(servo, 300.0, 50)[:, 3] <= limit * (1 + 1e-12))


@pytest.mark.parametrize("pitch", [0.0, 0.1, 0.3])
def test_gain_scheduling(equations, pitch):
    """At rest at the reference the command stays; a small error acts through GK = 1 / (1 + pitch / KK)."""
    servo = start(equations, REFERENCE, pitch, speed_filter_corner=1e4)
    assert advance(servo, REFERENCE, 20)[-1, 1] == pytest.approx(pitch, abs=1e-12)
    error = 1e-3
    change = advance(servo, REFERENCE + error, 1)[0, 1] - pitch
    assert change == pytest.approx(error * (KP + KI * DT) / (1 + pitch / KK), rel=1e-6)


def test_gains_follow_from_the_published_design():
    """kp = 2 I W zeta w / (N (-dP/dpitch)), ki = I W w^2 / (N (-dP/dpitch)), with w = 0.4 rad/s, zeta = 0.7."""
    speed = 12.1 * np.pi / 30
    scale = DRIVETRAIN_INERTIA * speed / (GEAR * -PITCH_SENSITIVITY)
    # The published sensitivity has four digits.
    assert 2 * 0.7 * 0.4 * scale == pytest.approx(KP, rel=1e-3)
    assert 0.4**2 * scale == pytest.approx(KI, rel=1e-3)


def closed_loop(equations, pitch_0, speed_error, seconds, sensitivity, **parameters):
    """Generator speed (rad/s) of a rigid drivetrain whose aerodynamic power is linear in the pitch angle."""
    given = {"initial_pitch": pitch_0, **parameters}
    p = np.array([given.get(v.name, v.start[0]) for v in equations.of("parameter")])
    k = equations.calculate(p)
    z = equations.initial(p, k)[1]
    rotor_speed, speed, history = REFERENCE / GEAR, REFERENCE + speed_error, []
    for _ in range(round(seconds / DT)):
        torque, pitch = equations.outputs(0, [], z, speed, p, k, []).full().ravel()[:2]
        power = POWER + sensitivity * (pitch - pitch_0)
        speed += DT * GEAR * (power / rotor_speed - GEAR * torque) / DRIVETRAIN_INERTIA
        z = equations.update(0, [], z, speed, p, k, [])
        history.append(speed)
    return np.array(history)


def test_closed_loop_has_the_design_frequency_and_damping(equations):
    """A rotor of one mass oscillates as designed: 0.4 rad/s, 0.7, less the constant-power law's negative damping."""
    pitch_0 = 0.2
    # The command solves pitch (1 + pitch / KK) = PI(error), thus the small-signal gain is 1 / (1 + 2 pitch / KK).
    sensitivity = PITCH_SENSITIVITY * (1 + 2 * pitch_0 / KK)
    speed = closed_loop(equations, pitch_0, 0.1, 12.0, sensitivity, speed_filter_corner=1e4)
    omega = REFERENCE / GEAR
    scale = -PITCH_SENSITIVITY * GEAR / (DRIVETRAIN_INERTIA * omega)
    damping = scale * KP - POWER / omega**2 / DRIVETRAIN_INERTIA
    frequency = np.sqrt(scale * KI)
    assert frequency == pytest.approx(0.4, rel=1e-3)
    t = DT * np.arange(1, speed.size + 1)
    root = np.sqrt(frequency**2 - damping**2 / 4)
    wave = np.cos(root * t) - damping / 2 / root * np.sin(root * t)
    expected = 0.1 * np.exp(-damping / 2 * t) * wave
    # One sample of delay (0.0125 s of a 15.7 s period) and the quadratic terms leave 1 % of the first error.
    np.testing.assert_allclose(speed - REFERENCE, expected, atol=1.5e-3)


def test_speed_returns_to_the_reference_with_the_filter(equations):
    pitch_0 = 0.2
    speed = closed_loop(equations, pitch_0, 6.0, 60.0, PITCH_SENSITIVITY * (1 + pitch_0 / KK))
    assert speed.max() < REFERENCE * 1.08
    assert np.abs(speed[-400:] - REFERENCE).max() < 0.05  # within 1 % of the first error after a minute


def test_outputs_hold_between_samples(equations):
    servo = start(equations, 100.0)
    servo.set({"generator.speed": 110.0})
    servo.do_step(DT / 2)
    assert servo.get("filtered_speed") == 100.0
    servo.do_step(DT / 2)
    assert servo.get("filtered_speed") > 100.0


def test_bad_sample_time_is_named():
    with pytest.raises(ValueError, match="sample_time 0"):
        component(sample_time=0.0)
