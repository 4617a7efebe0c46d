"""The rotor component in the tests: settings, its FMU run sample by sample, and its internal states."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from fmus_src.equations import Equations
from fmus_src.instance import Instance

from .loaded import Loaded

RPM = np.pi / 30.0
STEP = 0.0125
UPRIGHT = np.eye(3)
TILT = np.radians(5.0)  # shaft axis downwards going downwind
TILTED = np.array([[np.cos(TILT), 0.0, np.sin(TILT)], [0.0, 1.0, 0.0], [-np.sin(TILT), 0.0, np.cos(TILT)]])

Settings = dict[str, float | str]


def settings(
    *,
    wind: float,
    speed: float,
    pitch: float = 0.0,
    shear: float = 0.0,
    axes: np.ndarray = UPRIGHT,
    **more: float | str,
) -> Settings:
    """Parameters and inputs by scalar name; further names with "__" for "."."""
    return {
        **{f"hub.orientation[{k + 1}]": v for k, v in enumerate(axes.ravel())},
        **{f"servo.pitch[{k}]": pitch for k in (1, 2, 3)},
        "wind_speed": wind,
        "shear_exponent": shear,
        "rotor.speed": speed,
        "initial_induced_velocity": 0.2 * wind,
        **{name.replace("__", "."): value for name, value in more.items()},
    }


def vector(values: Mapping[str, float], name: str, size: int = 3) -> np.ndarray:
    return np.array([values[f"{name}[{k}]"] for k in range(1, size + 1)])


def first_sample(aero: Equations, given: Settings) -> Instance:
    i = Instance(aero)
    i.set(given)
    i.initialise()
    return i


class Run:
    """An instance of the FMU."""

    def __init__(self, fmu: Loaded, given: Settings) -> None:
        self.fmu, self.time, self.samples = fmu, 0.0, 0
        self.slave = fmu.instance()
        self.slave.setupExperiment(startTime=0.0)
        kinds = {v.name: v.type for v in fmu.description.modelVariables}
        for name, value in given.items():
            setter = {"String": self.slave.setString, "Boolean": self.slave.setBoolean, "Real": self.slave.setReal}
            setter[kinds[name]](fmu.vr(name), [value])
        self.azimuth, self.speed = float(given.get("rotor.azimuth", 0.0)), float(given["rotor.speed"])
        self.names = [v.name for v in fmu.description.modelVariables if v.causality == "output"]
        self.slave.enterInitializationMode()
        self.slave.exitInitializationMode()

    def outputs(self) -> dict[str, float]:
        return dict(zip(self.names, self.slave.getReal(self.fmu.vr(*self.names)), strict=True))

    def set(self, values: Mapping[str, float]) -> None:
        self.slave.setReal(self.fmu.vr(*values), list(values.values()))

    def sample(self, *, turning: bool = True) -> None:
        """One sample on, at which the blades stand where the speed has turned them (or where they stood)."""
        if turning:
            self.azimuth += self.speed * STEP
            self.set({"rotor.azimuth": self.azimuth})
        self.slave.doStep(self.samples * STEP, STEP)
        self.samples += 1

    def settle(self, seconds: float, *, turning: bool = False) -> dict[str, float]:
        for _ in range(round(seconds / STEP)):
            self.sample(turning=turning)
        return self.outputs()

    def mean_over_a_third_turn(self, *names: str) -> np.ndarray:
        """After the first third: three blades repeat everything after a third of a turn."""
        samples = round(2.0 * np.pi / 3.0 / self.speed / STEP)
        rows = []
        for n in range(2 * samples):
            self.sample()
            if n >= samples:
                rows.append(self.slave.getReal(self.fmu.vr(*names)))
        return np.array(rows).mean(axis=0)


def internal_references(equations: Equations, name: str) -> list[int]:
    """Value references of a variable that the FMU does not list."""
    first = 0
    for v in equations.variables:
        if v.name == name:
            return list(range(first, first + v.size))
        first += v.size
    raise KeyError(name)
