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
LIFT, DRAG, MOMENT, LIFT_CHANGE, DRAG_CHANGE = range(5)
_ATTACHED = math.radians(20.0)


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
        data (sections, points, 5) with columns LIFT, DRAG, MOMENT, LIFT_CHANGE, DRAG_CHANGE (what
        `attached_flow_change` adds to lift and drag); first angle and spacing, rad.
    """
    degrees = np.linspace(-180.0, 180.0, 360 * points_per_degree + 1)
    tables = []
    for section in _sections().values():
        published = np.array([np.interp(degrees, section["alpha_deg"], section[k]) for k in ("lift", "drag", "moment")])
        change = attached_flow_change(np.radians(degrees), published[LIFT], published[DRAG], section)
        tables.append(np.vstack([published, change]).T)
    return np.array(tables), -math.pi, math.radians(1.0 / points_per_degree)


def attached_flow_change(alpha: Array, lift: Array, drag: Array, section: dict[str, Any]) -> Array:
    """Change of lift and drag (2, n) by the steady state of OpenFAST's Beddoes-Leishman model (Gonzalez variant).

    That model takes a section's normal force as the attached-flow line C_n_alpha (alpha - alpha_0) times a separation
    factor of at most one, so wherever the polar lies above that line (by up to 10 % for the outer sections, whose
    polars include stall delay) the force is limited to it; the chord force likewise. Zero for sections without these
    parameters (cylinders) and beyond 20 deg, where flow is separated and the model follows the polar. The Mach number's
    influence on the slope (at most 3 %) is left out.
    """
    if "normal_force_slope" not in section:
        return np.zeros((2, alpha.size))
    sin, cos, drag_0 = np.sin(alpha), np.cos(alpha), section["drag_0"]
    attached = section["normal_force_slope"] * (alpha - math.radians(section["alpha_0_deg"]))
    normal = lift * cos + (drag - drag_0) * sin
    chordwise = lift * sin - (drag - drag_0) * cos
    same_sign = normal * attached > 0.0
    limited_normal = np.where(same_sign, np.sign(attached) * np.minimum(abs(normal), abs(attached)), normal)
    limited_chordwise = np.where(attached * alpha > 0.0, np.minimum(chordwise, attached * alpha), chordwise)
    new_lift = limited_normal * cos + limited_chordwise * sin
    new_drag = limited_normal * sin - limited_chordwise * cos + drag_0
    return np.where(abs(alpha) < _ATTACHED, [new_lift - lift, new_drag - drag], 0.0)


@cache
def _sections() -> dict[str, Any]:
    return tomllib.loads((_DATA / "sections.toml").read_text(encoding="utf-8"))
