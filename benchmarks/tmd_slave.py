"""The damper of fmus_src/tmd once more, as one writes it for PythonFMU: NumPy, no code generation."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt
from pythonfmu import Fmi2Causality, Fmi2Slave, Fmi2Variability, Real

Array = npt.NDArray[np.float64]
INTERNAL_STEP = 0.0125  # s


class PythonTmd(Fmi2Slave):
    """Tuned mass damper in a moving body, with end stops; equations and names as fmus_src/tmd/model.py."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self.m, self.k, self.c = 20_000.0, 6302.0, 1598.0
        self.stroke, self.k_stop, self.c_stop = 8.0, 5e5, 5e5
        self.y = np.zeros(2)
        self.specific_force = np.array([0.0, 0.0, 9.80665])
        self.angular_velocity = np.zeros(3)
        self.angular_acceleration = np.zeros(3)
        for name in ("m", "k", "c", "stroke", "k_stop", "c_stop"):
            variability = Fmi2Variability.tunable
            self.register_variable(Real(name, causality=Fmi2Causality.parameter, variability=variability))
        for name in ("specific_force", "angular_velocity", "angular_acceleration"):
            for i in range(3):
                self._register(f"attachment.{name}[{i + 1}]", Fmi2Causality.input, getattr(self, name), i)
        self.carried: Array | None = None
        for first, name in ((0, "force"), (3, "moment")):
            for i in range(3):
                getter = partial(self.output, first + i)
                self.register_variable(Real(f"{name}[{i + 1}]", causality=Fmi2Causality.output, getter=getter))
        self.register_variable(Real("displacement", causality=Fmi2Causality.output, getter=lambda: self.y[0]))

    def _register(self, name: str, causality: Any, array: Array, i: int) -> None:
        def put(value: float) -> None:
            array[i] = value
            self.carried = None

        self.register_variable(Real(name, causality=causality, getter=lambda: array[i], setter=put))

    def stop(self, x: float, v: float) -> float:
        """End-stop force on the damper, N."""
        over = max(x - self.stroke, 0.0) + min(x + self.stroke, 0.0)
        return -self.k_stop * over - (self.c_stop * v if over * v > 0.0 else 0.0)

    def axial(self, y: Array) -> float:
        """Force of spring, dashpot and stops on the damper, N."""
        return -self.k * y[0] - self.c * y[1] + self.stop(y[0], y[1])

    def rate(self, y: Array) -> Array:
        """Right-hand side of the equation of motion."""
        omega = self.angular_velocity
        turning = (omega[1] ** 2 + omega[2] ** 2) * y[0]
        return np.array([y[1], self.axial(y) / self.m - self.specific_force[0] + turning])

    def output(self, i: int) -> float:
        """Element of (force, moment); both are found once per change of state or input."""
        if self.carried is None:
            self.carried = self.load()
        return self.carried[i]

    def load(self) -> Array:
        """Force on the body at the attachment (N) and moment about it (N m), shape (6,)."""
        r, v = np.array([self.y[0], 0.0, 0.0]), np.array([self.y[1], 0.0, 0.0])
        omega, alpha = self.angular_velocity, self.angular_acceleration
        a = self.specific_force + np.cross(alpha, r) + np.cross(omega, np.cross(omega, r)) + 2 * np.cross(omega, v)
        force = np.array([-self.axial(self.y), -self.m * a[1], -self.m * a[2]])
        return np.concatenate([force, np.cross(r, force)])

    def do_step(self, current_time: float, step_size: float) -> bool:
        """Runge-Kutta steps of fourth order."""
        steps = max(1, int(np.ceil(step_size / INTERNAL_STEP - 1e-6)))
        h = step_size / steps
        for _ in range(steps):
            k1 = self.rate(self.y)
            k2 = self.rate(self.y + h / 2 * k1)
            k3 = self.rate(self.y + h / 2 * k2)
            k4 = self.rate(self.y + h * k3)
            self.y = self.y + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        self.carried = None
        return True
