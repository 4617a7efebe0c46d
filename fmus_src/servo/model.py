"""Variable-speed torque and collective pitch controller of the NREL 5-MW turbine, in its barge version.

Structure and constants: Jonkman et al. (2009), NREL/TP-500-38060, section 7. The barge's pitch gains: Jonkman (2007),
NREL/TP-500-41958, whose closed loop has a natural frequency of 0.4 rad/s instead of the land-based 0.6 rad/s.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca

from fmus_src.component import Component

SAMPLE_TIME = 0.0125


@dataclass(frozen=True)
class TorqueLaw:
    """Symbols of the torque-speed curve: speeds in rad/s at the generator, torque in N m."""

    cut_in: Any
    region_2: Any
    region_2_end: Any
    rated: Any
    synchronous: Any
    k: Any
    slope_15: Any
    slope_25: Any
    power: Any
    region_3_pitch: Any
    torque_max: Any

    def torque(self, speed: Any, pitch: Any) -> Any:
        """Steady torque at a filtered speed and the pitch command (rad) in force; regions 1, 1.5, 2, 2.5, 3."""
        below_rated = self.slope_25 * (speed - self.synchronous)
        below_rated = ca.if_else(speed < self.region_2_end, self.k * speed**2, below_rated)
        below_rated = ca.if_else(speed < self.region_2, self.slope_15 * (speed - self.cut_in), below_rated)
        below_rated = ca.if_else(speed <= self.cut_in, 0, below_rated)
        region_3 = ca.logic_or(speed >= self.rated, pitch >= self.region_3_pitch)
        constant_power = self.power / ca.fmax(speed, 1e-3)
        return ca.fmin(ca.if_else(region_3, constant_power, below_rated), self.torque_max)


@dataclass(frozen=True)
class PitchLaw:
    """Symbols of the scheduled PI pitch control; angles in rad."""

    kp: Any
    ki: Any
    kk: Any
    low: Any
    high: Any
    rate_max: Any
    reference: Any

    def gain(self, pitch: Any) -> Any:
        """Gain correction at the pitch command in force."""
        return 1 / (1 + pitch / self.kk)

    def integral(self, pitch: Any) -> Any:
        """Integral of the speed error (rad) that holds this pitch at the reference speed."""
        return pitch / (self.gain(pitch) * self.ki)

    def step(self, speed: Any, integral: Any, pitch: Any, dt: float) -> tuple[Any, Any]:
        """Integral and pitch command after one sample."""
        error, gain = speed - self.reference, self.gain(pitch)
        scale = gain * self.ki
        integral = _limit(integral + error * dt, self.low / scale, self.high / scale)
        wanted = _limit(gain * self.kp * error + scale * integral, self.low, self.high)
        change = _limit(wanted - pitch, -self.rate_max * dt, self.rate_max * dt)
        return integral, _limit(pitch + change, self.low, self.high)


def component(sample_time: float = SAMPLE_TIME) -> Component:
    """The controller, sampled every `sample_time` (s).

    Raises:
        ValueError: the sample time is not positive.
    """
    if not sample_time > 0.0:
        raise ValueError(f"servo: sample_time {sample_time} s must be positive, e.g. {SAMPLE_TIME}")
    c = Component("servo", "Generator torque and blade pitch controller", sample_time=sample_time)
    measured = c.input("generator.speed", unit="rad/s", start=122.9096, description="generator speed, high-speed side")
    speed_0 = c.parameter(
        "initial_generator_speed", 122.9096, unit="rad/s", min=1e-3, description="filtered speed at the start"
    )
    pitch_0 = c.parameter(
        "initial_pitch", 0.0, unit="rad", display_unit="deg", description="pitch command at the start"
    )
    corner = c.parameter(
        "speed_filter_corner", 1.570796, unit="rad/s", min=1e-6, description="corner frequency of the speed filter"
    )
    torque_law, pitch_law = _torque_law(c), _pitch_law(c)
    torque_rate = c.parameter("torque_rate_max", 15_000.0, unit="N.m/s", min=0.0, description="torque rate limit")
    efficiency = c.parameter("generator_efficiency", 0.944, min=0.0, max=1.0, description="electric over shaft power")

    speed = c.sampled_state("filtered_speed", unit="rad/s", start=speed_0, description="filtered generator speed")
    torque = c.sampled_state(
        "torque_command", unit="N.m", nominal=1e4, start=torque_law.torque(speed_0, pitch_0),
        description="generator torque in force",
    )  # fmt: skip
    pitch = c.sampled_state(
        "pitch_command", unit="rad", display_unit="deg", start=pitch_0, description="collective pitch in force"
    )
    integral = c.sampled_state(
        "speed_error_integral", unit="rad", start=pitch_law.integral(pitch_0), description="integral of the speed error"
    )

    memory = ca.exp(-sample_time * corner)
    new_speed = (1 - memory) * measured + memory * speed
    # The torque region follows the pitch command in force, as does the gain correction: torque first, then pitch.
    change = torque_law.torque(new_speed, pitch) - torque
    new_integral, new_pitch = pitch_law.step(new_speed, integral, pitch, sample_time)
    c.update(speed, new_speed)
    c.update(torque, torque + _limit(change, -torque_rate * sample_time, torque_rate * sample_time))
    c.update(pitch, new_pitch)
    c.update(integral, new_integral)

    c.output("generator_torque", torque, unit="N.m", nominal=1e4, description="generator torque, high-speed side")
    c.output(
        "pitch", ca.repmat(pitch, 3, 1), unit="rad", display_unit="deg", description="pitch of each blade, to feather"
    )
    c.output("electrical_power", efficiency * torque * measured, unit="W", nominal=1e6, description="electrical power")
    return c


def _torque_law(c: Component) -> TorqueLaw:
    """Declare the constants of the torque-speed curve."""
    cut_in = c.parameter("cut_in_speed", 70.16224, unit="rad/s", min=0.0, description="speed between regions 1, 1.5")
    region_2 = c.parameter("region_2_speed", 91.21091, unit="rad/s", description="speed between regions 1.5 and 2")
    k = c.parameter("region_2_k", 2.332287, unit="N.m.s2/rad2", min=0.0, description="torque over speed^2, region 2")
    rated = c.parameter("rated_speed", 121.6805, unit="rad/s", description="speed between regions 2.5 and 3")
    power = c.parameter("rated_mechanical_power", 5_296_610.0, unit="W", description="shaft power in region 3")
    slip = c.parameter("slip_percent", 10.0, min=1e-3, description="generator slip in region 2.5, percent")
    pitch_3 = c.parameter(
        "region_3_min_pitch", 0.01745329, unit="rad", display_unit="deg", description="least pitch that keeps region 3"
    )
    torque_max = c.parameter("torque_max", 47_402.91, unit="N.m", min=0.0, description="torque limit")

    synchronous = c.calculated("synchronous_speed", rated / (1 + slip / 100), unit="rad/s", description="of region 2.5")
    slope_25 = power / rated / (rated - synchronous)
    # k w^2 = slope (w - synchronous), lower root; in this form it holds for k = 0 too.
    root = ca.sqrt(slope_25 * (slope_25 - 4 * k * synchronous))
    end = c.calculated(
        "region_2_end_speed", 2 * slope_25 * synchronous / (slope_25 + root), unit="rad/s",
        description="speed between regions 2 and 2.5",
    )  # fmt: skip
    slope_15 = k * region_2**2 / (region_2 - cut_in)
    return TorqueLaw(cut_in, region_2, end, rated, synchronous, k, slope_15, slope_25, power, pitch_3, torque_max)


def _pitch_law(c: Component) -> PitchLaw:
    """Declare the constants of the pitch control."""

    def angle(name: str, start: float, description: str) -> Any:
        return c.parameter(name, start, unit="rad", display_unit="deg", description=description)

    return PitchLaw(
        kp=c.parameter("pitch_kp", 0.01255121, unit="s", description="proportional gain at zero pitch"),
        ki=c.parameter("pitch_ki", 0.003586059, min=1e-9, description="integral gain at zero pitch"),
        kk=angle("pitch_kk", 0.1099965, "pitch at which the rotor's pitch sensitivity has doubled"),
        low=angle("pitch_min", 0.0, "least pitch"),
        high=angle("pitch_max", 1.570796, "greatest pitch"),
        rate_max=c.parameter(
            "pitch_rate_max", 0.1396263, unit="rad/s", display_unit="deg/s", min=0.0, description="pitch rate limit"
        ),
        reference=c.parameter(
            "reference_speed", 122.9096, unit="rad/s", description="generator speed that the pitch control holds"
        ),
    )


def _limit(x: Any, low: Any, high: Any) -> Any:
    return ca.fmin(ca.fmax(x, low), high)
