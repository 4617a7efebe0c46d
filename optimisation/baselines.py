"""Classical tuning of a mass damper, and its transfer to the floating turbine's pitch mode.

Den Hartog, Mechanical Vibrations, 4th ed. 1956, section 3.3: harmonic force, undamped structure, equal peaks.
Warburton, Earthquake Eng. Struct. Dyn. 10 (1982) 381-401: white-noise force, undamped structure, least variance.
Sadek, Mohraz, Taylor, Chung, Earthquake Eng. Struct. Dyn. 26 (1997) 617-635: damped structure, equal modal damping.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.linalg import eigh

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Tuning:
    """Tuning of a damper on a structure of one degree of freedom.

    Attributes:
        frequency: the damper's natural frequency by the structure's.
        damping: the damper's damping ratio, c / (2 m omega_damper).
    """

    frequency: float
    damping: float


@dataclass(frozen=True)
class Primary:
    """A structure of one degree of freedom, as a damper sees it.

    Attributes:
        mass_ratio: the damper's mass by the structure's; frequency: of the structure alone, rad/s; damping: its ratio.
        damper_mass: kg.
    """

    mass_ratio: float
    frequency: float
    damping: float
    damper_mass: float


def den_hartog(mass_ratio: float) -> Tuning:
    """f = 1 / (1 + mu); zeta = sqrt(3 mu / (8 (1 + mu))), which is c / c_c = sqrt(3 mu / (8 (1 + mu)^3)) in his terms.

    Raises:
        ValueError: the mass ratio is not positive.
    """
    mu = _positive(mass_ratio)
    return Tuning(1 / (1 + mu), math.sqrt(3 * mu / (8 * (1 + mu))))


def warburton(mass_ratio: float) -> Tuning:
    """f = sqrt(1 + mu / 2) / (1 + mu); zeta = sqrt(mu (1 + 3 mu / 4) / (4 (1 + mu) (1 + mu / 2))).

    Raises:
        ValueError: the mass ratio is not positive.
    """
    mu = _positive(mass_ratio)
    return Tuning(math.sqrt(1 + mu / 2) / (1 + mu), math.sqrt(mu * (1 + 3 * mu / 4) / (4 * (1 + mu) * (1 + mu / 2))))


def sadek(mass_ratio: float, damping: float) -> Tuning:
    """f = (1 - beta sqrt(mu / (1 + mu))) / (1 + mu); zeta = beta / (1 + mu) + sqrt(mu / (1 + mu)).

    Args:
        damping: damping ratio beta of the structure.

    Raises:
        ValueError: the mass ratio is not positive, or the damping ratio not in 0..1.
    """
    mu = _positive(mass_ratio)
    if not 0.0 <= damping < 1.0:
        raise ValueError(f"damping ratio of the structure is {damping}: needs to be in 0..1")
    root = math.sqrt(mu / (1 + mu))
    return Tuning((1 - damping * root) / (1 + mu), damping / (1 + mu) + root)


def pitch_mode(values: Mapping[str, float], damper: str) -> Primary:
    """The barge's pitch mode as a damper of the simplified model sees it (Wang et al. 2022, eqs. 3-5).

    A damper at height h above the reference point is driven by the attachment's acceleration and, as its rail tilts, by
    gravity: m (h omega^2 + g) theta in harmonic motion. Near the mode's frequency it thus acts as a damper without
    gravity at the height h + g / omega^2, on a mode stiffened by m g (h + g / omega^2); for a barge's damper at its
    mass centre gravity is nearly all of the drive.

    Args:
        values: the model's parameters by name, SI.
        damper: "nacelle_damper" or "platform_damper".
    """
    mass, damping, stiffness = structure_matrices(values)
    squares, modes = eigh(stiffness, mass)
    omega_2, shape = float(squares[0]), modes[:, 0]  # modal mass 1
    index, sign = (0, 1.0) if damper == "nacelle_damper" else (1, -1.0)
    m, gravity = values[f"{damper}.m"], values["gravity"]
    arm = sign * values[f"{damper}.R"] + gravity / omega_2
    frequency = math.sqrt(omega_2 + m * gravity * arm * shape[index] ** 2)
    return Primary(
        mass_ratio=float(m * (arm * shape[index]) ** 2),
        frequency=frequency,
        damping=float(shape @ damping @ shape) / (2 * frequency),
        damper_mass=m,
    )


def structure_matrices(values: Mapping[str, float]) -> tuple[Array, Array, Array]:
    """Mass, damping and stiffness matrices of tower and barge angle without dampers (eqs. 3-5), SI, shapes (2, 2)."""
    v = values
    mass = np.diag([v["I_t"], v["I_p"]])
    damping = np.array([[v["d_t"], -v["d_t"]], [-v["d_t"], v["d_t"] + v["d_p"]]])
    tower = v["k_t"] - v["m_t"] * v["gravity"] * v["R_t"]
    barge = v["k_t"] + v["k_p"] + v["m_p"] * v["gravity"] * v["R_p"]
    return mass, damping, np.array([[tower, -v["k_t"]], [-v["k_t"], barge]])


def stiffness_and_damping(tuning: Tuning, primary: Primary) -> tuple[float, float]:
    """Spring stiffness, N/m, and damping, N s/m, of a damper with that tuning."""
    omega = tuning.frequency * primary.frequency
    return primary.damper_mass * omega**2, 2 * tuning.damping * primary.damper_mass * omega


def classical_designs(values: Mapping[str, float], damper: str) -> dict[str, tuple[float, float]]:
    """Stiffness (N/m) and damping (N s/m) of one damper by each of the three rules; arguments as `pitch_mode`."""
    primary = pitch_mode(values, damper)
    mu = primary.mass_ratio
    rules = {
        "Den Hartog (1956)": den_hartog(mu),
        "Warburton (1982)": warburton(mu),
        "Sadek et al. (1997)": sadek(mu, primary.damping),
    }
    return {name: stiffness_and_damping(rule, primary) for name, rule in rules.items()}


def _positive(mass_ratio: float) -> float:
    if not mass_ratio > 0.0:
        raise ValueError(f"mass ratio is {mass_ratio}: needs to be above 0")
    return mass_ratio
