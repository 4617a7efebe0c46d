"""The shaker: a rigid mass when held, and otherwise a damper that is forced to the same motion."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from fmus_src.equations import derive
from fmus_src.instance import Instance
from fmus_src.shaker.model import component
from fmus_src.tmd.model import component as damper

INPUTS = {
    "attachment.specific_force": (0.7, -0.3, 9.6),
    "attachment.angular_velocity": (0.05, -0.11, 0.07),
    "attachment.angular_acceleration": (0.02, 0.09, -0.04),
}
FLAT = {f"{name}[{i + 1}]": value for name, values in INPUTS.items() for i, value in enumerate(values)}


def _shaker(**parameters: float) -> Instance:
    instance = Instance(component(lines=60))
    instance.set({"period": 60.0, "f_high": 0.7, "f_low": 0.05, **parameters, **FLAT})
    instance.initialise()
    return instance


def test_a_held_mass_is_a_rigid_one() -> None:
    outputs = _shaker(m=3e4).outputs()
    expected = -3e4 * np.array(INPUTS["attachment.specific_force"])
    assert [outputs[f"force[{i}]"] for i in (1, 2, 3)] == pytest.approx(expected, rel=1e-14)  # rounding
    assert [outputs[f"moment[{i}]"] for i in (1, 2, 3)] == [0.0, 0.0, 0.0]


def test_it_loads_the_body_as_a_damper_in_the_same_motion() -> None:
    """A damper whose spring gives just the force for the prescribed acceleration: same forces and moments."""
    shaker = _shaker(m=3e4, amplitude=1.3)
    shaker.do_step(3.7)
    s, v, t = shaker.get("displacement"), shaker.get("velocity"), shaker.time
    h = 1e-3
    ahead, behind = _shaker(amplitude=1.3), _shaker(amplitude=1.3)
    ahead.do_step(t + h)
    behind.do_step(t - h)
    acceleration = (ahead.get("velocity") - behind.get("velocity")) / (2 * h)
    f, omega = (np.array(INPUTS[f"attachment.{n}"]) for n in ("specific_force", "angular_velocity"))
    spring = -3e4 * (acceleration + f[0] - (omega[1] ** 2 + omega[2] ** 2) * s) / s

    equations = derive(damper())
    twin = Instance(equations)
    twin.set({"m": 3e4, "k": spring, "c": 0.0, "stroke": 100.0, **FLAT})
    twin.initialise()
    twin.set_states(np.array([s, v]))
    ours, theirs = shaker.outputs(), twin.outputs()
    for name in [f"{q}[{i}]" for q in ("force", "moment") for i in (1, 2, 3)]:
        # the central difference errs by (w h)^2 / 6 = 3e-6 of the acceleration, up to 0.7 Hz
        assert ours[name] == pytest.approx(theirs[name], rel=1e-5, abs=1e-6), name
    assert float(ca.norm_2(twin.derivative()[1] - acceleration)) < 1e-9 * 3e4


def test_its_motion_has_the_stated_deviation_and_band() -> None:
    equations = derive(component(lines=60))
    instance = Instance(equations)
    instance.set({"period": 60.0, "amplitude": 0.3, "f_low": 0.1, "f_high": 0.5})
    instance.initialise()
    times = np.arange(240) * 0.25
    s, v = np.empty_like(times), np.empty_like(times)
    for i, now in enumerate(times):
        instance.time = now + 60.0  # risen
        s[i], v[i] = instance.get("displacement"), instance.get("velocity")
    spectrum, frequency = np.abs(np.fft.rfft(s)) ** 2, np.fft.rfftfreq(len(s), 0.25)
    assert s.std() == pytest.approx(0.3, rel=1e-12)  # sines over whole periods: exact
    outside = (frequency < 0.1 - 1e-9) | (frequency > 0.5 + 1e-9)
    assert spectrum[outside].sum() < 1e-20 * spectrum.sum()
    rates = 2j * np.pi * frequency * np.fft.rfft(s)
    assert np.fft.rfft(v) == pytest.approx(rates, abs=1e-9)


def test_no_lines_is_refused() -> None:
    with pytest.raises(ValueError, match="0 lines asked for"):
        component(lines=0)
