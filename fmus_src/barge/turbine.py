"""Figures of the turbine and barge (`data/`), and the constants of tower and blades that follow from them."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from fmus_src.barge.beam import stations
from fmus_src.barge.blade import DATA, Blade, read_blade
from fmus_src.barge.tower import Tower, read_tower

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Turbine:
    """Everything that defines the structure.

    Attributes:
        platform, nacelle, rotor, drivetrain: figures of the sections of `data/turbine.toml`.
        damping_ratio: of the tower's modes.
        tower, blade: the flexible members.
    """

    platform: dict[str, Any]
    nacelle: dict[str, Any]
    rotor: dict[str, Any]
    drivetrain: dict[str, Any]
    damping_ratio: float
    tower: Tower
    blade: Blade

    @property
    def cone(self) -> float:
        """Precone, rad, negative upwind."""
        return float(np.radians(self.rotor["precone_deg"]))

    @property
    def shaft_axis(self) -> Array:
        """Unit vector along the shaft, downwind, nacelle frame, (3,)."""
        tilt = np.radians(self.rotor["shaft_tilt_deg"])
        return np.array([np.cos(tilt), 0.0, np.sin(tilt)])

    @property
    def shaft_frame(self) -> Array:
        """Axes of the shaft (x downwind along it, y left, z up) in the nacelle, (3, 3)."""
        x, y = self.shaft_axis, np.array([0.0, 1.0, 0.0])
        return np.column_stack([x, y, np.cross(x, y)])

    @property
    def apex(self) -> Array:
        """Rotor apex from the tower top, nacelle frame, m, (3,)."""
        return np.array([0.0, 0.0, self.nacelle["tower_top_to_shaft"]]) + self.rotor["overhang"] * self.shaft_axis


@cache
def nrel_5mw_barge() -> Turbine:
    """The NREL 5-MW turbine on the ITI Energy barge."""
    return load(DATA)


def load(folder: Path) -> Turbine:
    """Read `turbine.toml`, `tower.csv` and `blade.csv` of a folder.

    Raises:
        ValueError: a section is missing from the TOML file, or a table's stations do not run from 0 to 1.
    """
    figures = tomllib.loads((folder / "turbine.toml").read_text(encoding="utf-8"))
    sections = ("platform", "nacelle", "rotor", "drivetrain")
    for section in ("tower", "blade", *sections):
        if section not in figures:
            raise ValueError(f"{folder / 'turbine.toml'}: section [{section}] is missing")
    return Turbine(
        **{section: figures[section] for section in sections},
        damping_ratio=figures["tower"]["damping_ratio"],
        tower=read_tower(figures["tower"], stations(folder / "tower.csv")),
        blade=read_blade(figures, folder / "blade.csv"),
    )
