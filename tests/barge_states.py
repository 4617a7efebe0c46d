"""States and loads of the barge component for its tests, and a few ways to read it."""

from __future__ import annotations

import numpy as np

from fmus_src.barge.parameters import BLADE, PLATFORM, RELATIVE
from fmus_src.equations import Equations
from fmus_src.instance import Instance

SWITCHES = (*PLATFORM, *RELATIVE, *BLADE)
# Switch of each of the 22 coordinates.
NAMES = (*PLATFORM, *RELATIVE, *BLADE, *BLADE, *BLADE)
UNDAMPED = (
    {f"tower.{d}_damping[{i}]": 0.0 for d in ("fore_aft", "side") for i in (1, 2)}
    | {"blade.flap_damping[1]": 0.0, "blade.flap_damping[2]": 0.0, "blade.edge_damping": 0.0}
    | {"drivetrain.damping": 0.0, "nacelle.yaw_damping": 0.0}
)


def started(
    equations: Equations, values: dict[str, float] | None = None, free: tuple[str, ...] | None = None
) -> Instance:
    """An initialised instance with the switches named in `free` on; None: the defaults."""
    instance = Instance(equations)
    switches = {} if free is None else {f"dof.{n}": float(n in free) for n in SWITCHES}
    instance.set(switches | (values or {}))
    instance.initialise()
    return instance


def put(instance: Instance, coordinates: np.ndarray, rates: np.ndarray) -> None:
    """Set the 22 coordinates and rates; the platform's are stored first, then the others', rates after coordinates."""
    instance.set_states(np.concatenate([coordinates[:6], rates[:6], coordinates[6:], rates[6:]]))


def taken(instance: Instance) -> tuple[np.ndarray, np.ndarray]:
    x = instance._values["x"]
    return np.r_[x[:6], x[12:28]], np.r_[x[6:12], x[28:44]]


def accelerations(instance: Instance) -> np.ndarray:
    rate = instance.derivative()
    return np.concatenate([rate[6:12], rate[28:44]])


def vector(outputs: dict[str, float], name: str) -> np.ndarray:
    return np.array([outputs[f"{name}[{i}]"] for i in (1, 2, 3)])


def named(port: str, values: np.ndarray) -> dict[str, float]:
    return {f"{port}[{i}]": float(v) for i, v in enumerate(values, start=1)}


def violent(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """A state far from equilibrium: angles of half a radian, metres of deflection, all rates large."""
    rng = np.random.default_rng(seed)
    q = rng.uniform(-1, 1, 22) * [5, 5, 5, 0.6, 0.6, 0.6, 2, 0.1, 2, 0.1, 0.3, 3, 0.01, *[5, 0.5, 1] * 3]
    return q, rng.uniform(-1, 1, 22) * [3, 3, 3, 0.3, 0.3, 0.3, 2, 0.3, 2, 0.3, 0.1, 1.5, 0.05, *[5, 2, 2] * 3]
