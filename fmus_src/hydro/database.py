"""The hydrodynamic database of the barge: linear potential-flow coefficients about the PRP, SI units.

Conventions: time factor exp(+i w t), phases lead positive; incident wave eta = a cos(w t - k (x cos b + y sin b))
with heading b (0: along +x, downwind). Degrees of freedom 1..6: surge, sway, heave, roll, pitch, yaw, index 0..5.
"""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Complex = npt.NDArray[np.complex128]

VARIANTS = {"closed": "barge.json", "moonpool": "barge_moonpool.json"}


@dataclass(frozen=True)
class HydroDatabase:
    """Linear hydrodynamic coefficients of a square barge.

    Attributes:
        variant: "closed" box or open "moonpool".
        omega: angular frequency, rad/s, shape (n,), increasing.
        heading: wave heading, rad, shape (m,), from 0 to pi/2.
        added_mass: A(w), kg, kg m, kg m2, shape (n, 6, 6).
        added_mass_infinite: A at infinite frequency, shape (6, 6).
        damping: radiation damping B(w), N s/m, N s, N m s, shape (n, 6, 6).
        excitation: X(w, b), Froude-Krylov plus diffraction per metre of wave amplitude, N/m and N, shape (n, m, 6).
        stiffness: buoyancy and waterplane parts of the restoring matrix, N/m, N, N m, shape (6, 6).
        volume: displaced volume, m3. depth: water depth, m. density: kg/m3. gravity: m/s2.
        provenance: how it was computed, one statement a line.
    """

    variant: str
    omega: Array
    heading: Array
    added_mass: Array
    added_mass_infinite: Array
    damping: Array
    excitation: Complex
    stiffness: Array
    volume: float
    depth: float
    density: float
    gravity: float
    provenance: tuple[str, ...]


def coefficient_pairs() -> list[tuple[int, int]]:
    """Index pairs of added mass and damping that are not zero by the symmetry of a square barge."""
    return [(0, 0), (0, 4), (4, 0), (4, 4), (1, 1), (1, 3), (3, 1), (3, 3), (2, 2), (5, 5)]


@cache
def load(variant: str = "closed") -> HydroDatabase:
    """Load a database of the package.

    Raises:
        ValueError: unknown variant.
    """
    if variant not in VARIANTS:
        raise ValueError(f"hydro: variant '{variant}' is unknown; choose one of {', '.join(VARIANTS)}")
    return read(Path(__file__).parent / "data" / VARIANTS[variant])


def read(path: Path) -> HydroDatabase:
    """Read a database written by `save`.

    Raises:
        ValueError: the file lacks an entry.
    """
    data: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    try:
        omega, heading = np.array(data["omega"]), np.radians(data["heading_deg"])
        excitation = np.zeros((len(omega), len(heading), 6), dtype=complex)
        for i in range(6):
            x = data["excitation"][str(i + 1)]
            excitation[:, :, i] = np.array(x["real"]).T + 1j * np.array(x["imag"]).T
        return HydroDatabase(
            variant=data["variant"],
            omega=omega,
            heading=heading,
            added_mass=_full(data["added_mass"], len(omega)),
            added_mass_infinite=_full(data["added_mass_infinite"], 1)[0],
            damping=_full(data["damping"], len(omega)),
            excitation=excitation,
            stiffness=np.diag(data["stiffness_diagonal"]),
            volume=data["volume"],
            depth=data["depth"],
            density=data["density"],
            gravity=data["gravity"],
            provenance=tuple(data["provenance"]),
        )
    except KeyError as missing:
        raise ValueError(f"hydro: {path.name} lacks {missing}; write it anew with compute_database") from None


def save(database: HydroDatabase, path: Path) -> None:
    """Write a database as text: five significant digits, one coefficient a line over all frequencies."""
    d = database
    data = {
        "variant": d.variant,
        "provenance": list(d.provenance),
        "units": "SI, about the PRP; exp(+i w t), lead positive; lists run over omega (rad/s)",
        "volume": d.volume, "depth": d.depth, "density": d.density, "gravity": d.gravity,
        "heading_deg": _digits(np.degrees(d.heading)),
        "stiffness_diagonal": [float(f"{v:.8g}") for v in np.diag(d.stiffness)],
        "omega": _digits(d.omega),
        "added_mass_infinite": _entries(d.added_mass_infinite[None]),
        "added_mass": _entries(d.added_mass),
        "damping": _entries(d.damping),
        "excitation": {
            str(i + 1): {"real": _rows(d.excitation[:, :, i].real), "imag": _rows(d.excitation[:, :, i].imag)}
            for i in range(6)
        },
    }  # fmt: skip
    text = json.dumps(data, indent=1)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(_one_list_a_line(text) + "\n", encoding="utf-8")


def wave_number(omega: Array, depth: float, gravity: float) -> Array:
    """Wave number k, 1/m, of the dispersion relation w^2 = g k tanh(k h), by Newton's method; any shape."""
    target = np.asarray(omega, dtype=float) ** 2 * depth / gravity
    x = np.where(target > 1.0, target, np.sqrt(target))
    for _ in range(30):
        t = np.tanh(x)
        x = x - (x * t - target) / (t + x * (1.0 - t * t))
    return np.asarray(x / depth)


def _entries(matrices: Array) -> dict[str, list[float]]:
    return {f"{i + 1}{j + 1}": _digits(matrices[:, i, j]) for i, j in coefficient_pairs()}


def _full(entries: dict[str, list[float]], count: int) -> Array:
    result = np.zeros((count, 6, 6))
    for pair, values in entries.items():
        result[:, int(pair[0]) - 1, int(pair[1]) - 1] = values
    return result


def _rows(values: Array) -> list[list[float]]:
    return [_digits(column) for column in values.T]


def _digits(values: Array) -> list[float]:
    # Rounding noise of symmetry, ten orders below the largest value of the list, is written as zero.
    floor = 1e-7 * float(np.max(np.abs(values), initial=0.0))
    return [float(f"{v:.5g}") if abs(v) > floor else 0.0 for v in values]


def _one_list_a_line(text: str) -> str:
    """Join the lines of innermost lists that `json.dumps(indent=...)` spreads."""
    return re.sub(r"\[([^\[\]]*)\]", lambda match: "[" + " ".join(match.group(1).split()) + "]", text)
