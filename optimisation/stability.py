"""Parameters that an optimisation is to refuse: outside the FMU's limits, or of a structure that is unstable."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from optimisation.baselines import structure_matrices

STRUCTURE = ("I_p", "k_p", "d_p", "I_t", "k_t", "d_t", "m_p", "m_t", "R_p", "R_t", "gravity")
GROWTH = 1e-9  # 1/s: below it a mode counts as undamped


@dataclass(frozen=True)
class UnstableMode:
    """A mode of tower and barge without dampers that grows.

    Attributes:
        name: "platform pitch" (tower and barge tilt together) or "tower fore-aft" (the tower tilts on the barge).
        growth: 1/s.
        frequency: Hz; 0 if it topples without oscillating.
    """

    name: str
    growth: float
    frequency: float


def start_values(description: Any) -> dict[str, float]:
    """Defaults of an FMU's real parameters by name, SI; `description` as FMPy reads it."""
    return {
        v.name: float(v.start)
        for v in description.modelVariables
        if v.causality == "parameter" and v.type == "Real" and v.start is not None
    }


def unstable_mode(values: Mapping[str, float]) -> UnstableMode | None:
    """The fastest growing mode of tower and barge without dampers (Wang et al. 2022, eqs. 3-5), or None.

    Args:
        values: the simplified model's parameters by name, SI.
    """
    mass, damping, stiffness = structure_matrices(values)
    inverse = np.diag(1.0 / np.diag(mass))
    system = np.block([[np.zeros((2, 2)), np.eye(2)], [-inverse @ stiffness, -inverse @ damping]])
    roots, shapes = np.linalg.eig(system)
    fastest = int(np.argmax(roots.real))
    if roots[fastest].real <= GROWTH:
        return None
    tower, barge = shapes[:2, fastest]
    name = "tower fore-aft" if abs(tower - barge) > abs(barge) else "platform pitch"
    return UnstableMode(name, float(roots[fastest].real), float(abs(roots[fastest].imag)) / (2 * math.pi))


def check_parameters(description: Any, parameters: Mapping[str, float]) -> None:
    """Refuse parameters of the simplified model's FMU with which no damper can be judged.

    Args:
        description: of the FMU, as FMPy reads it; parameters: values that differ from its defaults, SI.

    Raises:
        ValueError: a value is outside the FMU's limits, or the structure without dampers is unstable; names the mode.
    """
    limits = {v.name: (v.min, v.max) for v in description.modelVariables if v.type == "Real"}
    for name, value in parameters.items():
        low, high = (-math.inf if side is None else float(side) for side in limits.get(name, (None, None)))
        high = math.inf if high == -math.inf else high
        if not low <= value <= high:
            raise ValueError(f"{name} = {value:g} is outside its limits, {low:g} to {high:g}")
    values = start_values(description) | dict(parameters)
    if not all(name in values for name in STRUCTURE) or not min(values["I_p"], values["I_t"]) > 0.0:
        return  # another model's FMU has no such structure to judge
    mode = unstable_mode(values)
    if mode is not None:
        raise ValueError(f"the structure is unstable without dampers: {_words(mode, values)}")


def _words(mode: UnstableMode, v: Mapping[str, float]) -> str:
    if mode.frequency > 0.0:
        return (
            f"{mode.name} at {mode.frequency:.3g} Hz grows by {mode.growth:.2g} 1/s;"
            f" damping is d_p = {v['d_p']:.3g}, d_t = {v['d_t']:.3g} N m s/rad"
        )
    tower = v["m_t"] * v["gravity"] * v["R_t"]
    if v["k_t"] <= tower:
        return f"{mode.name} topples by {mode.growth:.2g} 1/s; k_t = {v['k_t']:.3g} N m/rad must exceed {tower:.3g}"
    needed = v["k_t"] * tower / (v["k_t"] - tower) - v["m_p"] * v["gravity"] * v["R_p"]
    return f"{mode.name} topples by {mode.growth:.2g} 1/s; k_p = {v['k_p']:.3g} N m/rad must exceed {needed:.3g}"
