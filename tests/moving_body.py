"""A body that moves and turns in a prescribed way, and what a damper on it must obey there: momentum and energy."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
import numpy.typing as npt

from fmus_src.component import Component
from fmus_src.instance import Instance

Array = npt.NDArray[np.float64]

G = 9.80665
TIME = ca.SX.sym("t")
ATTACHMENT = ca.vertcat(ca.sin(TIME), 2 * ca.cos(0.7 * TIME), 0.5 * TIME**2)  # global frame, m
AXES = ("specific_force", "angular_velocity", "angular_acceleration")


def _about(axis: int, angle: Any) -> Any:
    i, j = (axis + 1) % 3, (axis + 2) % 3
    matrix = ca.SX.eye(3)
    matrix[i, i] = matrix[j, j] = ca.cos(angle)
    matrix[i, j], matrix[j, i] = -ca.sin(angle), ca.sin(angle)
    return matrix


ROTATION = _about(2, 0.4 * TIME) @ _about(1, 0.5 * ca.cos(TIME)) @ _about(0, 0.3 * ca.sin(1.3 * TIME))


@dataclass(frozen=True)
class Particles:
    """Point masses of a damper in the body frame, as expressions in its states.

    Attributes:
        masses: kg, (n,); positions, velocities: in the body, m and m/s, (3, n); both columns of expressions.
    """

    masses: list[Any]
    positions: list[Any]
    velocities: list[Any]


@dataclass(frozen=True)
class Balance:
    """Rates of momentum (N), of angular momentum about the global origin (N m) and of energy (W) of the particles.

    The first two are less what gravity gives; energy is kinetic and potential.
    """

    momentum: Array
    angular: Array
    power: float


def inputs_at(t: float) -> dict[str, float]:
    """A damper's inputs on the moving body at a time."""

    def rate(e: Any) -> Any:
        return ca.jacobian(e, TIME)

    spin = ROTATION.T @ ca.reshape(rate(ca.vec(ROTATION)), 3, 3)
    omega = ca.vertcat(spin[2, 1], spin[0, 2], spin[1, 0])
    specific = ROTATION.T @ (rate(rate(ATTACHMENT)) + ca.vertcat(0, 0, G))
    values = [f(t).full().ravel() for f in (ca.Function("f", [TIME], [e]) for e in (specific, omega, rate(omega)))]
    return {f"attachment.{n}[{i + 1}]": float(v[i]) for n, v in zip(AXES, values, strict=True) for i in range(3)}


def balance(
    particles: Particles, states: Any, rates: Any, extra_energy: Any, at: Mapping[str, Any]
) -> Balance:  # fmt: skip
    """What the particles' motion asks for.

    Args:
        states, rates: symbols of the damper's states, and their time derivatives as numbers in at["rates"].
        extra_energy: of springs and inerters, J, in the states.
        at: "t", "states", "rates": numbers.
    """

    def rate(e: Any) -> Any:
        return ca.jtimes(e, ca.vertcat(TIME, states), ca.vertcat(1, rates))

    momentum, angular, energy, gravity, torque = ca.SX.zeros(3), ca.SX.zeros(3), extra_energy, 0.0, 0.0
    for m, r, u in zip(particles.masses, particles.positions, particles.velocities, strict=True):
        place = ATTACHMENT + ROTATION @ r
        carried = ca.jacobian(ATTACHMENT, TIME) + ca.reshape(ca.jacobian(ca.vec(ROTATION), TIME), 3, 3) @ r
        speed = carried + ROTATION @ u
        weight = ca.vertcat(0, 0, -m * G)
        momentum += m * speed
        angular += m * ca.cross(place, speed)
        energy += m * (ca.dot(speed, speed) / 2 + G * place[2])
        gravity += weight
        torque += ca.cross(place, weight)
    out = [rate(momentum) - gravity, rate(angular) - torque, rate(energy)]
    f = ca.Function("balance", [TIME, states, rates], out)
    a, b, c = (v.full().ravel() for v in f(at["t"], at["states"], at["rates"]))
    return Balance(a, b, float(c[0]))


def on_the_body(component: Component, t: float, states: Array, parameters: Mapping[str, float]) -> tuple[Any, ...]:
    """The damper's rates of states, and its force and moment on the body in the global frame, about its origin.

    Returns:
        rates; force, N; moment about the global origin, N m; power at the attachment, W.
    """
    damper = Instance(component)
    damper.set(dict(parameters))
    damper.initialise()
    damper.set(inputs_at(t))
    damper.set_states(states)
    force, moment = (np.array([damper.get(f"{n}[{i}]") for i in (1, 2, 3)]) for n in ("force", "moment"))
    where = ca.Function("where", [TIME], [ATTACHMENT, ca.jacobian(ATTACHMENT, TIME), ROTATION])
    place, speed, rotation = (v.full() for v in where(t))
    omega = np.array([inputs_at(t)[f"attachment.angular_velocity[{i}]"] for i in (1, 2, 3)])
    power = float(rotation @ force @ speed.ravel() + moment @ omega)
    return damper.derivative(), rotation @ force, rotation @ moment + np.cross(place.ravel(), rotation @ force), power
