"""Every mechanical port of the barge: force-like inputs and velocity-like outputs whose products are the power."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from fmus_src.barge.model import component
from fmus_src.equations import Equations, derive
from fmus_src.instance import Instance
from tests.barge_lagrange import G, System, lagrange
from tests.barge_states import accelerations, named, put, started, vector, violent

PITCH = (0.1, 0.35, -0.2)
LEVERS = {"nacelle_damper.attachment[1]": 2.0, "nacelle_damper.attachment[2]": -1.0,
          "nacelle_damper.attachment[3]": 91.0, "platform_damper.attachment[1]": 3.0,
          "platform_damper.attachment[2]": -2.0, "platform_damper.attachment[3]": 1.0}  # fmt: skip
AT_PLATFORM = ("platform.velocity", "platform.angular_velocity")
TOWER_MODES = "tower.deflection_rate"
# Of each port: its inputs, and the outputs that they work on.
PORTS = {
    "hydro": (("hydro.force", "hydro.moment"), AT_PLATFORM),
    "mooring": (("mooring.force", "mooring.moment"), AT_PLATFORM),
    "tower": (("tower.force", "tower.moment", "tower.modal_force"), (*AT_PLATFORM, TOWER_MODES)),
    "aero": (("aero.force", "aero.moment"), ("hub.velocity", "rotor")),
    **{f"blade{k}": ((f"blade{k}.modal_force",), (f"blade{k}.deflection_rate",)) for k in (1, 2, 3)},
    **{
        d: ((f"{d}.force", f"{d}.moment"), (f"{d}.velocity", f"{d}.angular_velocity"))
        for d in ("nacelle_damper", "platform_damper")
    },
    "generator": (("servo.generator_torque",), ("generator.speed",)),
}  # fmt: skip


@pytest.fixture(scope="module")
def equations() -> Equations:
    return derive(component())


@pytest.fixture(scope="module")
def exact() -> tuple[ca.Function, ca.Function]:
    return lagrange(System(PITCH))


@pytest.fixture
def moving(equations: Equations) -> Instance:
    values = LEVERS | named("servo.pitch", np.array(PITCH)) | {"dof.nacelle_yaw": 1.0, "hydro.force[3]": 6e7}
    instance = started(equations, values)
    put(instance, *violent(13))
    return instance


def flow(outputs: dict[str, float], name: str, size: int) -> np.ndarray:
    """The velocity-like output; the air's moment at the apex works on the nacelle's rotation and the rotor's spin."""
    if name == "rotor":
        shaft = np.array([outputs[f"hub.orientation[{i}]"] for i in (1, 4, 7)])
        return vector(outputs, "hub.angular_velocity") + outputs["rotor.speed"] * shaft
    if size == 1:
        return np.array([-outputs[name]])  # the generator's torque is positive against the rotation
    return np.array([outputs[f"{name}[{i + 1}]"] for i in range(size)])


@pytest.mark.parametrize("port", PORTS)
def test_power_of_a_port_is_its_force_times_its_velocity(moving: Instance, exact, port: str) -> None:
    """The mass matrix times what a port's loads add to the accelerations is their generalised force, whose power is
    the energy that they bring: in any state, with the mass matrix by Lagrange's equations."""
    q, qd = violent(13)
    inputs, outputs = PORTS[port]
    sizes = {v.name: v.size for v in moving.equations.variables}
    now, before = moving.outputs(), accelerations(moving)
    rng = np.random.default_rng(len(port))
    power, size = 0.0, 0.0
    for name, output in zip(inputs, outputs, strict=True):
        load = rng.uniform(-1, 1, sizes[name]) * (1e7 if "moment" in name else 1e6)
        moving.set({name: load[0]} if sizes[name] == 1 else {f"{name}[{i + 1}]": v for i, v in enumerate(load)})
        if name.startswith("hydro.force"):
            load[2] -= 6e7  # which the state before had already
        velocity = flow(now, output, sizes[name])
        power += float(load @ velocity)
        size += float(np.abs(load) @ np.abs(velocity))
    mass = np.asarray(exact[0](q, qd, 6e7)[0])
    gained = mass @ (accelerations(moving) - before)
    # Round-off of accelerations of up to 1e4 m/s2 times the largest inertia, 1e10 kg m2, against powers of 1e6 W.
    assert float(gained @ qd) == pytest.approx(power, abs=1e-7 * size + 1e-2)
    assert size > 1e3


@pytest.mark.parametrize("body", ["nacelle", "platform"])
def test_attachment_velocity_is_the_integral_of_the_specific_force(moving: Instance, body: str) -> None:
    """In the turning frame of the body: v' + omega x v = specific force + g."""
    x, rate, h = moving._values["x"].copy(), moving.derivative(), 1e-6
    port = f"{body}_damper"

    def at(state: np.ndarray, name: str) -> np.ndarray:
        moving.set_states(state)
        return vector(moving.outputs(), f"{port}.{name}")

    slope = (at(x + h * rate, "velocity") - at(x - h * rate, "velocity")) / (2 * h)
    absolute = slope + np.cross(at(x, "angular_velocity"), at(x, "velocity"))
    gravity = at(x, "specific_force") - absolute
    # Gravity alone is left, 9.81 m/s2 in some direction of the turned body; tolerances as of test_barge_motion.
    assert np.linalg.norm(gravity) == pytest.approx(G, abs=1e-6)
    resting = started(moving.equations, {"gravity": 0.0})
    assert vector(resting.outputs(), f"{port}.velocity") == pytest.approx([0, 0, 0], abs=1e-15)
