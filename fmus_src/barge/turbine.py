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
from fmus_src.barge.tower_shapes import TowerAxis, read_tower_axis

Array = npt.NDArray[np.float64]

#: Files of a turbine's folder.
FILES = ("turbine.toml", "tower.csv", "blade.csv")
#: What only the air needs to know of the tower.
TOWER_AIR = ("base_diameter", "top_diameter", "drag_coefficient")


@dataclass(frozen=True)
class Turbine:
    """Everything that defines the structure.

    Attributes:
        platform, nacelle, rotor, drivetrain: figures of the sections of `data/turbine.toml`.
        damping_ratio: of the tower's modes.
        tower, blade: the flexible members.
        tower_axis: the tower's modes, for loads along it. tower_air: TOWER_AIR as far as given, m, m, -.
    """

    platform: dict[str, Any]
    nacelle: dict[str, Any]
    rotor: dict[str, Any]
    drivetrain: dict[str, Any]
    damping_ratio: float
    tower: Tower
    blade: Blade
    tower_axis: TowerAxis
    tower_air: dict[str, Any]

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

    @property
    def hub_height(self) -> float:
        """Height of the rotor apex above mean sea level at rest, m, to a centimetre."""
        return round(float(self.tower.base_height + self.tower.length + self.apex[2]), 2)


@cache
def nrel_5mw_barge() -> Turbine:
    """The NREL 5-MW turbine on the ITI Energy barge."""
    return load(DATA)


def load(folder: Path) -> Turbine:
    """Read `turbine.toml`, `tower.csv` and `blade.csv` of a folder.

    Raises:
        ValueError: a file, a section or an entry is missing, or a table's stations do not run from 0 to 1.
    """
    try:
        figures = _checked(folder, _figures(folder))
        return Turbine(
            **{section: figures[section] for section in ("platform", "nacelle", "rotor", "drivetrain")},
            damping_ratio=figures["tower"]["damping_ratio"],
            tower=read_tower(figures["tower"], stations(folder / "tower.csv")),
            blade=read_blade(figures, folder / "blade.csv"),
            tower_axis=read_tower_axis(figures["tower"]),
            tower_air={name: figures["tower"][name] for name in TOWER_AIR if name in figures["tower"]},
        )
    except OSError as error:
        raise ValueError(f"barge: {error.filename} cannot be read; a turbine's folder has {', '.join(FILES)}") from None
    except tomllib.TOMLDecodeError as error:
        raise ValueError(f"barge: {folder / 'turbine.toml'}: {error}") from None
    except KeyError as error:
        raise ValueError(f"barge: {folder}: tower.csv or blade.csv has no column {error}") from None


def _figures(folder: Path) -> dict[str, Any]:
    return tomllib.loads((folder / "turbine.toml").read_text(encoding="utf-8"))


def _checked(folder: Path, figures: dict[str, Any]) -> dict[str, Any]:
    """The figures, if they have every section and entry that this package's own have.

    Raises:
        ValueError: one is missing.
    """
    for section, entries in _figures(DATA).items():
        if section not in figures:
            raise ValueError(f"{folder / 'turbine.toml'}: section [{section}] is missing")
        missing = [name for name in entries if name not in figures[section] and name not in TOWER_AIR]
        if missing:
            raise ValueError(f"{folder / 'turbine.toml'}: [{section}] lacks {missing[0]}")
    return figures
