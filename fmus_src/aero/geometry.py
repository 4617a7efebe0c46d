"""Rotor geometry and section coefficients of the 5-MW turbine, from this folder's data files."""

from __future__ import annotations

import math
import tomllib
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

_DATA = Path(__file__).parent / "data"
#: Columns of the section tables.
LIFT, DRAG, MOMENT, LIFT_SLOPE = range(4)


@dataclass(frozen=True, eq=False)
class Rotor:
    """Rotor and blade aerodynamics; stations run from the blade root outwards.

    Attributes:
        blades: number of blades.
        tip_radius, hub_radius: along the blade, m.
        precone: rad, negative upwind.
        span: distance of the stations from the blade root, m (n,).
        chord: m (n,).
        twist: rad (n,), positive towards feather.
        offset: quarter-chord point off the pitch axis at zero pitch: downwind, towards the trailing edge, m (n, 2).
        section: index of each station's section in `section_tables` (n,).
    """

    blades: int
    tip_radius: float
    hub_radius: float
    precone: float
    span: Array
    chord: Array
    twist: Array
    offset: Array
    section: npt.NDArray[np.int_]

    @property
    def radius(self) -> Array:
        """Distance of the stations from the shaft, m (n,)."""
        return np.asarray((self.hub_radius + self.span) * math.cos(self.precone))

    @property
    def load_lumping(self) -> Array:
        """(n, n): from load per length at the stations to the equivalent forces there.

        Exact in force and moment for loads that vary linearly between stations.
        """
        matrix = np.zeros((self.span.size, self.span.size))
        for i, length in enumerate(np.diff(self.span)):
            matrix[i : i + 2, i : i + 2] += length / 6.0 * np.array([[2.0, 1.0], [1.0, 2.0]])
        return matrix

    @property
    def tip_distance(self) -> Array:
        """(B / 2) (R - r) / r at the stations (n,), for the tip loss."""
        return np.asarray(0.5 * self.blades * (self.tip_radius - self.hub_radius - self.span) / self.radius_along)

    @property
    def hub_distance(self) -> Array:
        """(B / 2) (r - R_hub) / R_hub at the stations (n,), for the hub loss."""
        return np.asarray(0.5 * self.blades * self.span / self.hub_radius)

    @property
    def radius_along(self) -> Array:
        """Distance of the stations from the apex along the blade, m (n,)."""
        return np.asarray(self.hub_radius + self.span)

    @property
    def area_weights(self) -> Array:
        """Weight of each station in an average over the rotor's area, summing to one over a blade (n,)."""
        weights = self.load_lumping @ self.radius
        return np.asarray(weights / weights.sum())


@cache
def rotor() -> Rotor:
    """The published rotor (data/blade.toml)."""
    d = tomllib.loads((_DATA / "blade.toml").read_text(encoding="utf-8"))
    names = list(_sections())
    return Rotor(
        blades=d["blades"],
        tip_radius=d["tip_radius"],
        hub_radius=d["hub_radius"],
        precone=math.radians(d["precone_deg"]),
        span=np.array(d["span"], dtype=float),
        chord=np.array(d["chord"], dtype=float),
        twist=np.radians(d["twist_deg"]),
        offset=np.column_stack([d["offset_downwind"], d["offset_trailing"]]),
        section=np.array([names.index(s) for s in d["section"]]),
    )


@cache
def section_tables(points_per_degree: int = 2) -> tuple[Array, float, float]:
    """Section coefficients on a uniform grid of angles of attack from -180 to 180 deg (data/sections.toml).

    Returns:
        data (sections, points, 4) with columns LIFT, DRAG, MOMENT, LIFT_SLOPE (1/rad); first angle and spacing, rad.
    """
    degrees = np.linspace(-180.0, 180.0, 360 * points_per_degree + 1)
    spacing = math.radians(1.0 / points_per_degree)
    tables = []
    for section in _sections().values():
        published = np.array([np.interp(degrees, section["alpha_deg"], section[k]) for k in ("lift", "drag", "moment")])
        tables.append(np.vstack([published, np.gradient(published[LIFT], spacing)]).T)
    return np.array(tables), -math.pi, spacing


def aerofoil_constants(r: Rotor) -> dict[str, Array]:
    """Constants of the unsteady model at the stations of one blade, (n,) each; harmless ones for cylinders."""
    sections = list(_sections().values())
    names = ("alpha_0_deg", "normal_force_slope", "drag_0", "stall_normal_force", "negative_stall_normal_force")
    cylinder = (0.0, 2.0 * math.pi, 0.0, 1.0, -1.0)
    rows = [[sections[s].get(n, o) for n, o in zip(names, cylinder, strict=True)] for s in r.section]
    alpha_0, slope, drag_0, stall, negative_stall = np.array(rows, dtype=float).T
    return {
        "aerofoil": np.array([float("normal_force_slope" in sections[s]) for s in r.section]),
        "alpha_0": np.radians(alpha_0), "slope": slope, "drag_0": drag_0, "stall": stall,
        "negative_stall": negative_stall,
    }  # fmt: skip


@cache
def _sections() -> dict[str, Any]:
    return tomllib.loads((_DATA / "sections.toml").read_text(encoding="utf-8"))
