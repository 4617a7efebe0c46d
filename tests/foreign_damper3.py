"""A tuned mass damper as a colleague might hand it over in FMI 3.0: in Python, with arrays, own names and units.

PythonFMU3 makes the FMU of this file. The equations are those of fmus_src/tmd/model.py; here in m, kg, s and rad,
and at the ports in mm, t, kN and degrees.
"""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from pythonfmu3 import DefaultExperiment, Dimension, Float64, Fmi3Causality, Fmi3Slave, Fmi3Variability, Unit

DEG = np.pi / 180.0
INTERNAL_STEP = 2e-3  # s
UNITS: dict[str, dict[str, float]] = {
    "mm": {"factor": 1e-3, "m": 1}, "mm/s": {"factor": 1e-3, "m": 1, "s": -1},
    "mm/s2": {"factor": 1e-3, "m": 1, "s": -2}, "deg/s": {"factor": DEG, "rad": 1, "s": -1},
    "deg/s2": {"factor": DEG, "rad": 1, "s": -2}, "kN": {"factor": 1e3, "kg": 1, "m": 1, "s": -2},
    "kN.m": {"factor": 1e3, "kg": 1, "m": 2, "s": -2}, "t": {"factor": 1e3, "kg": 1},
    "kN/m": {"factor": 1e3, "kg": 1, "s": -2}, "kN.s/m": {"factor": 1e3, "kg": 1, "s": -1}, "s": {"s": 1},
}  # fmt: skip
# what the system calls a variable -> what this FMU calls it
NAMES = {
    "attachment.specific_force": "a", "attachment.angular_velocity": "w", "attachment.angular_acceleration": "dw",
    "force": "F", "moment": "M", "displacement": "travel", "velocity": "speed",
    "m": "mass", "k": "stiffness", "c": "damping",
}  # fmt: skip


class ForeignDamper3(Fmi3Slave):
    """Mass on a spring and a dashpot along x, with end stops, in a moving body."""

    description = "Tuned mass damper of a colleague"
    INPUTS: ClassVar = {"a": "mm/s2", "w": "deg/s", "dw": "deg/s2"}
    PARAMETERS: ClassVar = {
        "mass": (20.0, "t"), "stiffness": (6.302, "kN/m"), "damping": (1.598, "kN.s/m"), "stroke": (8000.0, "mm"),
        "stop_stiffness": (500.0, "kN/m"), "stop_damping": (500.0, "kN.s/m"),
    }  # fmt: skip

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self.default_experiment = DefaultExperiment(start_time=0.0, stop_time=60.0, step_size=0.0125)
        self.register_units([Unit(name, **base) for name, base in UNITS.items()])
        self.y, self.time = np.zeros(2), 0.0
        three = [Dimension(start="3")]
        continuous = Fmi3Variability.continuous
        self.register_variable(
            Float64("time", causality=Fmi3Causality.independent, variability=continuous, unit="s")
        )  # fmt: skip
        self.given = {"a": np.array([0.0, 0.0, 9806.65]), "w": np.zeros(3), "dw": np.zeros(3)}
        for name, unit in self.INPUTS.items():
            self.register_variable(Float64(
                name, causality=Fmi3Causality.input, variability=continuous, dimensions=three, unit=unit,
                getter=lambda n=name: self.given[n].tolist(), setter=lambda v, n=name: self._give(n, v),
            ))  # fmt: skip
        for i, (name, unit) in enumerate((("F", "kN"), ("M", "kN.m"))):
            self.register_variable(Float64(
                name, causality=Fmi3Causality.output, variability=continuous, dimensions=three, unit=unit,
                getter=lambda i=i: self.loads()[i].tolist(),
            ))  # fmt: skip
        for i, (name, unit) in enumerate((("travel", "mm"), ("speed", "mm/s"))):
            self.register_variable(Float64(
                name, causality=Fmi3Causality.output, variability=continuous, unit=unit,
                getter=lambda i=i: 1e3 * self.y[i],
            ))  # fmt: skip
        for name, (value, unit) in self.PARAMETERS.items():
            setattr(self, name, value)
            self.register_variable(
                Float64(name, causality=Fmi3Causality.parameter, variability=Fmi3Variability.tunable, unit=unit)
            )

    def _give(self, name: str, values: Any) -> None:
        self.given[name] = np.array(values, dtype=float)

    def axial(self, y: Any) -> float:
        """Force of spring, dashpot and stops on the damper, N."""
        x, v = y
        stroke = 1e-3 * self.stroke
        over = max(x - stroke, 0.0) + min(x + stroke, 0.0)
        stop = -self.stop_stiffness * over - (self.stop_damping * v if over * v > 0.0 else 0.0)
        return float(1e3 * (-self.stiffness * x - self.damping * v + stop))

    def rate(self, y: Any) -> Any:
        """Right-hand side of the equation of motion."""
        _, q, r = DEG * self.given["w"]
        return np.array([y[1], self.axial(y) / (1e3 * self.mass) - 1e-3 * self.given["a"][0] + (q**2 + r**2) * y[0]])

    def loads(self) -> tuple[Any, Any]:
        """Force (kN) and moment (kN m) on the body at the attachment."""
        r, v = np.array([self.y[0], 0.0, 0.0]), np.array([self.y[1], 0.0, 0.0])
        a, w, dw = 1e-3 * self.given["a"], DEG * self.given["w"], DEG * self.given["dw"]
        force = -self.mass * (a + np.cross(dw, r) + np.cross(w, np.cross(w, r)) + 2.0 * np.cross(w, v))
        force[0] = -1e-3 * self.axial(self.y)
        return force, np.cross(r, force)

    def do_step(self, current_time: float, step_size: float) -> bool:
        n = max(1, round(step_size / INTERNAL_STEP))
        h = step_size / n
        for _ in range(n):  # Runge-Kutta, fourth order
            k1 = self.rate(self.y)
            k2 = self.rate(self.y + h / 2 * k1)
            k3 = self.rate(self.y + h / 2 * k2)
            k4 = self.rate(self.y + h * k3)
            self.y = self.y + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        self.time = current_time + step_size
        return True
