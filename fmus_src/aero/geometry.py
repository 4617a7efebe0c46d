"""Rotor geometry, stations and sections: the 5-MW turbine's, or another's from a folder of the same form."""

from __future__ import annotations

import math
import tomllib
from dataclasses import dataclass, fields
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from fmus_src.aero.polars import CYLINDER, Polar, StallConstants, tabulated

Array = npt.NDArray[np.float64]

_DATA = Path(__file__).parent / "data"
BLADES = 3
_BLADE = ("span", "chord", "twist_deg", "offset_downwind", "offset_trailing", "section")
_CONSTANTS = {
    "alpha_0_deg": "alpha_0", "normal_force_slope": "slope", "drag_0": "drag_0", "stall_normal_force": "stall",
    "negative_stall_normal_force": "negative_stall",
}  # fmt: skip


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
        prebend: slope of the undeflected blade's axis out of the rotor's plane, rad (n,), positive downwind.
        section: index of each station's section in `polars` (n,).
        polars: of the sections.
        name: what it was read from; note: what a reader should know of it.
    """

    blades: int
    tip_radius: float
    hub_radius: float
    precone: float
    span: Array
    chord: Array
    twist: Array
    offset: Array
    prebend: Array
    section: npt.NDArray[np.int_]
    polars: tuple[Polar, ...]
    name: str = "NREL 5-MW"
    note: str = ""

    def __post_init__(self) -> None:
        if self.blades != BLADES:
            raise ValueError(f"aero: {self.name}: {self.blades} blades; this rotor has {BLADES}")
        if self.span.size < 4 or self.span[0] < 0.0 or not np.all(np.diff(self.span) > 0.0):
            raise ValueError(f"aero: {self.name}: give 4 or more stations whose span rises from 0 or more")
        if not np.all(self.chord > 0.0):
            raise ValueError(f"aero: {self.name}: chord must be above 0 at every station")
        if not 0.0 < self.hub_radius < math.inf:
            raise ValueError(f"aero: {self.name}: hub_radius {self.hub_radius:g} m must be a finite number above 0")
        if not abs(self.precone) < 0.5 * math.pi:
            raise ValueError(f"aero: {self.name}: precone of {math.degrees(self.precone):g} deg; give less than 90 deg")
        if not self.tip_radius >= self.hub_radius + self.span[-1]:
            raise ValueError(f"aero: {self.name}: tip_radius {self.tip_radius:g} m is within the last station")

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
        slope = np.tan(0.5 * (self.prebend[1:] + self.prebend[:-1]))
        for i, length in enumerate(np.diff(self.span) * np.sqrt(1.0 + slope**2)):
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
    """The published rotor (data/blade.toml, data/sections.toml)."""
    return read_rotor(_DATA, Rotor.name)


def read_rotor(folder: Path, name: str | None = None) -> Rotor:
    """A rotor from `blade.toml` and `sections.toml` of a folder, in the form of this package's own (`data/`).

    Raises:
        ValueError: a file or an entry is missing, or of the wrong kind.
    """
    d, sections = _read(folder / "blade.toml"), _read(folder / "sections.toml")
    try:
        names = list(dict.fromkeys(d["section"]))  # in the order of their first station
        columns = {key: np.array(d[key], dtype=float) for key in _BLADE if key != "section"}
        if {len(d[key]) for key in _BLADE} != {len(d["span"])}:
            raise ValueError(f"{', '.join(_BLADE)} must have as many entries as there are stations")
        return Rotor(
            blades=d["blades"],
            tip_radius=float(d["tip_radius"]),
            hub_radius=float(d["hub_radius"]),
            precone=math.radians(d["precone_deg"]),
            span=columns["span"],
            chord=columns["chord"],
            twist=np.radians(columns["twist_deg"]),
            offset=np.column_stack([columns["offset_downwind"], columns["offset_trailing"]]),
            prebend=np.radians(np.array(d.get("prebend_deg", [0.0] * len(d["span"])), dtype=float)),
            section=np.array([names.index(s) for s in d["section"]]),
            polars=tuple(_polar(section, sections[section]) for section in names),
            name=name or folder.name,
        )
    except KeyError as error:
        raise ValueError(f"aero: {folder}: blade.toml or sections.toml lacks {error}") from None
    except (TypeError, ValueError) as error:
        text = str(error)
        raise ValueError(text if text.startswith("aero:") else f"aero: {folder / 'blade.toml'}: {text}") from None


def section_tables(r: Rotor | None = None, points_per_degree: int = 2) -> tuple[Array, float, float]:
    """Coefficients of a rotor's sections (default: the published one's), see `polars.tabulated`."""
    return _tables(r or rotor(), points_per_degree)


@cache
def _tables(r: Rotor, points_per_degree: int) -> tuple[Array, float, float]:
    return tabulated(r.polars, points_per_degree)


def aerofoil_constants(r: Rotor) -> dict[str, Array]:
    """Constants of the unsteady model at the stations of one blade, (n,) each; harmless ones where it has none."""
    own = [r.polars[s].unsteady for s in r.section]
    names = [f.name for f in fields(StallConstants)]
    return {
        "aerofoil": np.array([float(u is not None) for u in own]),
        **{name: np.array([getattr(u or CYLINDER, name) for u in own]) for name in names},
    }


def _polar(name: str, section: dict[str, Any]) -> Polar:
    alpha, lift, drag, moment = (np.array(section[key], dtype=float) for key in ("alpha_deg", "lift", "drag", "moment"))
    if not lift.size == drag.size == moment.size == alpha.size or not np.all(np.diff(alpha) > 0.0):
        raise ValueError(f"aero: section {name}: alpha_deg must rise, and lift, drag and moment have as many entries")
    unsteady = None
    if "normal_force_slope" in section:
        known = {field: float(section[key]) for key, field in _CONSTANTS.items()}
        unsteady = StallConstants(**(known | {"alpha_0": math.radians(known["alpha_0"])}))
    return Polar(name, np.radians(alpha), lift, drag, moment, unsteady)


def _read(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        why = error.strerror if isinstance(error, OSError) else str(error).splitlines()[0]
        raise ValueError(
            f"aero: {path} cannot be read ({why}); a rotor's folder has blade.toml and sections.toml; of AeroDyn give"
            " the primary file"
        ) from None
