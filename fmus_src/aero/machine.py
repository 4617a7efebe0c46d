"""What the air meets: a rotor and the structure that carries it, each the 5-MW turbine's or another's."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fmus_src.aero import geometry
from fmus_src.aero.aerodyn_file import files_of, read_aerodyn
from fmus_src.aero.geometry import Rotor, read_rotor
from fmus_src.aero.tower import Tower, tower
from fmus_src.barge.blade import BladeShapes, mode_shapes
from fmus_src.barge.turbine import Turbine, load, nrel_5mw_barge

# Share of the blade's length by which the last station may miss the structure's tip.
_SAME = 0.01


@dataclass(frozen=True, eq=False)
class Machine:
    """A rotor on its structure.

    Attributes:
        shapes: modes of the blades at the rotor's stations. tower: as the air meets it.
        hub_height: of the undisplaced rotor apex above mean sea level, m.
        facts: what an FMU's description should say of it.
    """

    rotor: Rotor
    shapes: BladeShapes
    tower: Tower
    hub_height: float
    facts: tuple[str, ...] = ()


@dataclass(frozen=True)
class Figures:
    """What AeroDyn's files leave open.

    Attributes:
        hub_radius, precone_deg: m, deg, negative upwind; None: the structure's.
        reynolds, user_property: see `read_aerodyn`.
    """

    hub_radius: float | None = None
    precone_deg: float | None = None
    reynolds: float | None = None
    user_property: float | None = None


def machine(
    rotor: str | Path | Rotor | None = None, turbine: str | Path | Turbine | None = None, figures: Figures = Figures()
) -> Machine:
    """A rotor on a structure.

    Args:
        rotor: AeroDyn's primary file, or a folder of `blade.toml` and `sections.toml`; None: the NREL 5-MW turbine's.
        turbine: folder of the structure, as the barge component takes it; None: the NREL 5-MW turbine's.

    Raises:
        ValueError: a file is missing or malformed, or rotor, structure and figures do not fit together.
    """
    t = turbine if isinstance(turbine, Turbine) else load(Path(turbine)) if turbine else nrel_5mw_barge()
    own = rotor is None and turbine is None
    if isinstance(rotor, str | Path):
        r = _read(Path(rotor), t, turbine is None, figures)
    else:
        r = rotor or geometry.rotor()
        _refuse(figures, f"the rotor {r.name}")
    fits = abs(r.span[-1] - t.blade.length) <= _SAME * t.blade.length
    same_hub = abs(r.hub_radius - t.blade.hub_radius) < 1e-3 and abs(r.precone - t.cone) < 1e-4
    whose = "the turbine" if turbine else "the NREL 5-MW turbine"
    if turbine is not None and not (fits and same_hub):
        raise ValueError(
            f"aero: {r.name}: blades of {r.span[-1]:g} m, hub radius {r.hub_radius:g} m, cone"
            f" {math.degrees(r.precone):g} deg, where the turbine has {t.blade.length:g} m, {t.blade.hub_radius:g} m,"
            f" {math.degrees(t.cone):g} deg; give the turbine of this rotor"
        )
    if fits and same_hub:
        shapes = mode_shapes(t.blade, np.minimum(r.span, t.blade.length))
        bending = f"blade modes of {whose}"
    else:
        shapes, bending = _rigid(r.span.size), "blades rigid"
        warnings.warn(
            f"{r.name}: its blades are rigid in this FMU, since {whose} has others; lock the barge's"
            " (barge.dof.blade_flap_1, blade_flap_2 and blade_edge_1 = false), or give the option turbine=FOLDER",
            stacklevel=3,
        )
    about = f"rotor {r.name}, radius {r.tip_radius:.5g} m, {r.span.size} stations, {len(r.polars)} polars"
    facts = () if own else (*(f for f in (about, r.note, bending) if f), f"hub height {t.hub_height:g} m")
    return Machine(r, shapes, tower(t), t.hub_height, facts)


def rotor_files(path: Path) -> list[Path]:
    """Files of which a rotor consists, as `machine` takes it: their content is what a build depends on.

    Raises:
        ValueError: one is missing, or malformed.
    """
    if path.is_dir():
        return [path / "blade.toml", path / "sections.toml"]
    return files_of(_existing(path))


def _read(path: Path, t: Turbine, default: bool, figures: Figures) -> Rotor:
    if path.is_dir():
        _refuse(figures, f"the rotor in {path}")
        return read_rotor(path)
    hub, cone = figures.hub_radius, figures.precone_deg
    r = read_aerodyn(
        _existing(path),
        hub_radius=t.blade.hub_radius if hub is None else hub,
        precone=t.cone if cone is None else math.radians(cone),
        reynolds=figures.reynolds,
        user_property=figures.user_property,
    )
    if default and None in (hub, cone) and abs(r.span[-1] - t.blade.length) > _SAME * t.blade.length:
        raise ValueError(
            f"aero: {path.name}: AeroDyn's files have no hub radius and cone; give the options hub_radius and"
            " precone_deg (HubRad and PreCone(1) of ElastoDyn), or turbine=FOLDER"
        )
    return r


def _existing(path: Path) -> Path:
    if not path.is_file():
        raise ValueError(
            f"aero: there is no rotor '{path}'; give AeroDyn's primary file, or a folder of blade.toml, sections.toml"
        )
    return path


def _refuse(figures: Figures, whose: str) -> None:
    given = [name for name, value in vars(figures).items() if value is not None]
    if given:
        raise ValueError(f"aero: option {given[0]} is for AeroDyn's files; {whose} has its own, leave it out")


def _rigid(n: int) -> BladeShapes:
    return BladeShapes(np.zeros((n, 2, 3)), np.zeros((n, 2, 3)), np.zeros((n, 3, 3)))
