"""AeroDyn 15's files of a rotor: the primary file, the blade file and the polars (AirfoilInfo v1.01).

Formats: OpenFAST documentation, AeroDyn, "Input Files"; what a polar file leaves out is found as AeroDyn finds it
(`polars.constants_of_polar`). Lines are known by their names, not by their place, since versions differ in which they
have; `!`, `#` and `%` begin a comment, `@"FILE"` stands for the lines of a file beside. Taken over are the stations,
the polars and the constants of dynamic stall; what else the primary file says (wake, tower, environment) is the FMU's
own business.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from fmus_src.aero.aerodyn_lines import Line, following, lines_of, shown
from fmus_src.aero.geometry import BLADES, Rotor
from fmus_src.aero.polars import Polar, StallConstants, blended, constants_of_polar, is_constant

Array = npt.NDArray[np.float64]

_HEADER = ("interpord", "relthickness", "nondimarea", "numcoords", "bl_file", "numtabs")
_TABLE = ("re", "userprop", "ctrl", "incluadata", "numalf")
#: Names of a polar file's constants, what they are here, and their unit.
_CONSTANTS = {
    "alpha0": ("alpha_0", math.pi / 180.0), "c_nalpha": ("slope", 1.0), "cd0": ("drag_0", 1.0), "cn1": ("stall", 1.0),
    "cn2": ("negative_stall", 1.0), "t_p": ("T_p", 1.0), "t_f0": ("T_f", 1.0), "t_v0": ("T_v", 1.0),
    "t_vl": ("T_vl", 1.0), "st_sh": ("strouhal", 1.0), "a1": ("A1", 1.0), "a2": ("A2", 1.0), "b1": ("b1", 1.0),
    "b2": ("b2", 1.0), "filtcutoff": ("filter_cut_off", 1.0), "uacutout": ("cut_out", math.pi / 180.0),
    "uacutout_delta": ("fade_width", math.pi / 180.0),
}  # fmt: skip
_POSITIVE = ("t_p", "t_f0", "t_v0", "t_vl", "st_sh", "filtcutoff", "b1", "b2")
#: Constants of other models, of the moment, or found here from the polar.
_UNUSED = (
    "alpha1", "alpha2", "alphaupper", "alphalower", "eta_e", "c_lalpha", "b5", "a5", "s1", "s2", "s3", "s4", "cm0",
    "k0", "k1", "k2", "k3", "k1_hat", "x_cp_bar",
)  # fmt: skip
_BLADE = ("blspn", "blcrvac", "blswpac", "blcrvang", "bltwist", "blchord", "blafid")

_LARGEST = 20.0  # coefficient; rotational augmentation reaches a few


@dataclass(frozen=True)
class Layout:
    """What the primary file says of all polar files.

    Attributes:
        alpha, lift, drag, moment: columns from 1; 0: none. tables: which of several are used (AFTabMod, 1 to 3).
    """

    alpha: int = 1
    lift: int = 2
    drag: int = 3
    moment: int = 4
    tables: int = 1


@dataclass(frozen=True)
class Primary:
    """What the primary file says of the rotor; `unsteady`: share of the radius from and to which there is such flow."""

    layout: Layout
    polars: tuple[Path, ...]
    blade: Path
    unsteady: tuple[float, float] = (0.0, 1.0)


@dataclass(frozen=True, eq=False)
class _Table:
    """A table of a polar file: Reynolds number, user property, coefficients and constants."""

    reynolds: float
    user_property: float
    polar: Polar


def read_aerodyn(
    path: Path,
    *,
    hub_radius: float,
    precone: float,
    reynolds: float | None = None,
    user_property: float | None = None,
) -> Rotor:
    """A rotor from AeroDyn's primary file and the files that it names.

    Args:
        path: the primary file; its lines for the rotor suffice (`read_primary`).
        hub_radius, precone: m, rad, negative upwind: of the turbine, AeroDyn's files have neither.
        reynolds, user_property: where polar files have several tables, at which Reynolds number or user property they
            are to be used (linear in its logarithm, or in the property; held beyond the tables).

    Raises:
        ValueError: a file is missing or malformed: one line with file, line number and remedy.
    """
    primary = read_primary(path)
    columns = read_blade(primary.blade)
    number, span = columns["blafid"].astype(int).tolist(), columns["blspn"]
    outside = [i for i in number if not 1 <= i <= len(primary.polars)]
    if outside:
        raise ValueError(
            f"aero: {shown(primary.blade)}: BlAFID {outside[0]} where {shown(path)} names {len(primary.polars)} polars"
        )
    read = {i: read_tables(primary.polars[i - 1], primary.layout) for i in sorted(set(number))}
    several = max(len(tables) for tables in read.values()) > 1
    if not several and (reynolds, user_property) != (None, None):
        raise ValueError(f"aero: {shown(path)}: its polars have one table each; leave reynolds and user_property out")
    found = {i: _chosen(tables, primary, reynolds, user_property, path) for i, tables in read.items()}
    _warn_of_ends(list(found.values()))
    radius = (hub_radius + span) / (hub_radius + span[-1])
    low, high = primary.unsteady
    used = [(i, bool(low <= x <= high) and found[i].unsteady is not None) for i, x in zip(number, radius, strict=True)]
    kinds = list(dict.fromkeys(used))
    return Rotor(
        blades=BLADES,
        tip_radius=hub_radius + float(span[-1]),
        hub_radius=hub_radius,
        precone=precone,
        span=span,
        chord=columns["blchord"],
        twist=np.radians(columns["bltwist"]),
        offset=np.column_stack([columns["blcrvac"], columns["blswpac"]]),
        prebend=np.radians(columns["blcrvang"]),
        section=np.array([kinds.index(kind) for kind in used]),
        polars=tuple(found[i] if unsteady else replace(found[i], unsteady=None) for i, unsteady in kinds),
        name=path.name,
        note="the first of several tables of each polar"
        if several and (reynolds, user_property) == (None, None)
        else "",
    )


def files_of(path: Path) -> list[Path]:
    """All files of a rotor, the primary one first.

    Raises:
        ValueError: one is missing, or the primary file malformed.
    """
    primary = read_primary(path)
    found = dict.fromkeys([path, primary.blade])
    for polar in primary.polars:
        found |= dict.fromkeys([polar, *(line.path for line in lines_of(polar))])
    return list(found)


def read_primary(path: Path) -> Primary:
    """What AeroDyn's primary file says of the rotor; the names of its files are relative to its folder.

    Read are `AFTabMod`, `InCol_Alfa`, `InCol_Cl`, `InCol_Cd`, `InCol_Cm` (default: 1, and columns 1 to 4), `UseBlCm`,
    `UAStartRad`, `UAEndRad` (True, 0, 1), `NumAFfiles` with `AFNames`, and `ADBlFile(1)` to `(3)`: one file.

    Raises:
        ValueError: it is missing, or lacks one of these.
    """
    lines = list(lines_of(path))
    places = {line.name: i for i, line in reversed(list(enumerate(lines)))}

    def found(name: str) -> Line | None:
        return lines[places[name.lower()]] if name.lower() in places else None

    def whole(name: str, usual: int, low: int = 1, high: int = 100) -> int:
        line = found(name)
        return line.number_of(name, low, high) if line else usual

    def share(name: str, usual: float) -> float:
        line = found(name)
        return line.numbers(1, name)[0] if line else usual

    files, blade = found("AFNames"), found("ADBlFile(1)")
    if files is None or blade is None or found("NumAFfiles") is None:
        raise ValueError(
            f"aero: {shown(path)} lacks NumAFfiles, AFNames or ADBlFile(1); give the primary input file of AeroDyn 15"
        )
    moments = found("UseBlCm")
    layout = Layout(
        whole("InCol_Alfa", 1), whole("InCol_Cl", 2), whole("InCol_Cd", 3),
        whole("InCol_Cm", 4, low=0) if moments is None or moments.flag() else 0, whole("AFTabMod", 1, high=3),
    )  # fmt: skip
    count = whole("NumAFfiles", 0, high=10_000)
    names = lines[lines.index(files) :][:count]
    if len(names) < count:
        files.refuse(f"needs {count} names of polar files (NumAFfiles), one a line")
    others = [line.file for line in (found("ADBlFile(2)"), found("ADBlFile(3)")) if line]
    if any(other != blade.file for other in others):
        blade.refuse("this rotor's blades are alike; name one file for all")
    return Primary(
        layout, tuple(line.file for line in names), blade.file, (share("UAStartRad", 0.0), share("UAEndRad", 1.0))
    )


def read_blade(path: Path) -> dict[str, Array]:
    """Columns BlSpn, BlCrvAC, BlSwpAC, BlCrvAng, BlTwist, BlChord, BlAFID (in small letters) of a blade file, (n,).

    Raises:
        ValueError: a column or a row is missing, or a row malformed.
    """
    lines = lines_of(path)
    line = _found(lines, path, ("numblnds",))
    count = line.number_of("NumBlNds", 4, 10_000)
    head = following(lines, path, "the names of the columns")
    names = [word.lower() for word in head.words]
    missing = [name for name in _BLADE if name not in names]
    if missing:
        head.refuse(f"lacks the column {missing[0]}; give a blade file of AeroDyn 15")
    following(lines, path, "the units of the columns")
    width = 1 + max(names.index(name) for name in _BLADE)
    what = "BlSpn to BlAFID"
    rows = [following(lines, path, f"{count} rows").numbers(width, what) for _ in range(count)]
    table = np.array(rows)
    columns = {name: table[:, names.index(name)] for name in _BLADE}
    if np.any(columns["blafid"] != np.round(columns["blafid"])) or np.abs(columns["blafid"]).max() > 1e6:
        raise ValueError(f"aero: {shown(path)}: BlAFID must be whole numbers, the places of polars in AFNames")
    if np.abs(columns["blcrvang"]).max() >= 90.0:
        raise ValueError(f"aero: {shown(path)}: BlCrvAng must be below 90 deg; check the order of its columns")
    return columns


def read_tables(path: Path, layout: Layout = Layout()) -> list[_Table]:
    """The tables of a polar file (AirfoilInfo v1.01), with the constants of the unsteady model.

    Raises:
        ValueError: it is no such file, or one of its lines is malformed.
    """
    lines = lines_of(path)
    spline, count = False, 0
    while not count:
        line = _found(lines, path, _HEADER)
        if line.name == "interpord":
            spline = not line.is_default and line.number_of("InterpOrd", 1, 3) == 3
        elif line.name == "numcoords":
            for _ in range(line.number_of("NumCoords", 0, 100_000)):
                following(lines, path, "the coordinates")
        elif line.name == "numtabs":
            count = line.number_of("NumTabs", 1, 1000)
    return [_table(lines, path, layout, spline) for _ in range(count)]


def _table(lines: Iterator[Line], path: Path, layout: Layout, spline: bool) -> _Table:
    names = (*_TABLE, *_CONSTANTS, *_UNUSED)
    figures, given = {"re": math.nan, "userprop": 0.0}, dict[str, float]()
    while (line := _found(lines, path, names)).name != "numalf":
        if line.name in ("re", "userprop", "ctrl"):
            figures["re" if line.name == "re" else "userprop"] = line.numbers(1, line.words[1])[0]
        elif line.name in _CONSTANTS and not line.is_default:
            name, unit = _CONSTANTS[line.name]
            given[name] = line.numbers(1, line.words[1])[0] * unit
            if line.name in _POSITIVE and not given[name] > 0.0:
                line.refuse(f"{line.words[1]} must be above 0; or write Default")
    width = max(layout.alpha, layout.lift, layout.drag, layout.moment)
    count = line.number_of("NumAlf", 1, 100_000)
    rows = [following(lines, path, f"{count} rows (NumAlf)") for _ in range(count)]
    table = np.array([row.numbers(width, "a row of the polar") for row in rows])
    alpha = table[:, layout.alpha - 1]
    lift, drag = table[:, layout.lift - 1], table[:, layout.drag - 1]
    moment = table[:, layout.moment - 1] if layout.moment else np.zeros(count)
    if count < 3:  # constant, whatever the angle of attack
        alpha = np.array([-180.0, 180.0])
        lift, drag, moment = (np.repeat(column[:1], 2) for column in (lift, drag, moment))
    large = np.abs(np.column_stack([lift, drag, moment])).max(axis=1) > _LARGEST
    if large.any():
        rows[int(np.argmax(large))].refuse(f"a coefficient above {_LARGEST:g}; check InCol_Cl, InCol_Cd and InCol_Cm")
    rising = np.diff(alpha) > 0.0
    if not rising.all():
        rows[int(np.argmin(rising)) + 1].refuse("the angles of attack must rise")
    if abs(alpha[0] + 180.0) > 0.01 or abs(alpha[-1] - 180.0) > 0.01:
        raise ValueError(
            f"aero: {shown(path)}: its angles of attack go from {alpha[0]:g} to {alpha[-1]:g} deg; extend the polar to"
            " -180 and 180 deg (Viterna's method)"
        )
    polar = Polar(path.stem, np.radians(alpha), lift, drag, moment, spline=spline and count > 2)
    return _Table(figures["re"], figures["userprop"], replace(polar, unsteady=_unsteady(polar, given, path)))


def _unsteady(polar: Polar, given: dict[str, float], path: Path) -> StallConstants | None:
    """Constants of the unsteady model: the file's, and where it has none those of the polar; None: no such model."""
    known = dict(given)
    if is_constant(polar) or known.get("slope", 1.0) <= 0.0:
        return None
    cut_out = abs(known.get("cut_out", StallConstants.cut_out))
    width = abs(known.pop("fade_width", math.radians(5.0)))
    if "cut_out" in given or "fade_width" in given:
        known |= {"cut_out": cut_out, "fade_from": max(0.0, min(cut_out - width, cut_out - 1e-6))}
    if cut_out < 1e-6:
        return None
    found = constants_of_polar(polar, known)
    if found is not None and not found.negative_stall < found.stall:
        raise ValueError(
            f"aero: {shown(path)}: Cn2 {found.negative_stall:g} must be below Cn1 {found.stall:g},"
            " whether given or found from the polar; give both"
        )
    return found


def _chosen(
    tables: list[_Table], primary: Primary, reynolds: float | None, user_property: float | None, path: Path
) -> Polar:
    """The polar of a file's tables that is used."""
    if reynolds is not None and user_property is not None:
        raise ValueError("aero: reynolds and user_property exclude each other; give one")
    if len(tables) == 1:
        return tables[0].polar
    wanted = {2: "reynolds", 3: "user_property"}.get(primary.layout.tables)
    name = tables[0].polar.name
    if reynolds is None and user_property is None:
        if wanted is None:
            return tables[0].polar
        ends = (tables[0], tables[-1])
        low, high = (1e6 * t.reynolds if wanted == "reynolds" else t.user_property for t in ends)
        raise ValueError(
            f"aero: {shown(path)}: AFTabMod {primary.layout.tables}, and {name} has {len(tables)} tables; say where"
            f" they are to be used (option {wanted}, here {low:g} to {high:g})"
        )
    if reynolds is not None:
        if not 0.0 < reynolds < math.inf:
            raise ValueError(f"aero: reynolds {reynolds:g} must be a finite number above 0, e.g. 8e6")
        at = np.log(np.maximum([1e6 * t.reynolds for t in tables], 1e-3))
        x = math.log(reynolds)
    else:
        at, x = np.array([t.user_property for t in tables]), float(user_property or 0.0)
    if not np.all(np.diff(at) > 0.0) or not math.isfinite(x):
        kind = "Re" if reynolds is not None else "UserProp"
        raise ValueError(f"aero: {name}: {kind} must rise from table to table, each with its own, and be asked for")
    i = int(np.clip(np.searchsorted(at, x) - 1, 0, len(tables) - 2))
    weight = float(np.clip((x - at[i]) / (at[i + 1] - at[i]), 0.0, 1.0))
    if weight in (0.0, 1.0):
        return tables[i + int(weight)].polar
    return blended(tables[i].polar, tables[i + 1].polar, weight)


def _warn_of_ends(polars: list[Polar]) -> None:
    """Warn of polars whose coefficients differ between -180 and 180 deg, which are one angle."""
    open_ends = [
        p.name for p in polars if any(abs(c[0] - c[-1]) > 1e-3 for c in (p.lift, p.drag, p.moment))
    ]  # fmt: skip
    if open_ends:
        names = ", ".join(open_ends[:3]) + (f" and {len(open_ends) - 3} more" if len(open_ends) > 3 else "")
        warnings.warn(f"coefficients at -180 and 180 deg differ in {names}", stacklevel=4)


def _found(lines: Iterator[Line], path: Path, names: tuple[str, ...]) -> Line:
    """The next line, whose name must be one of these; a blade file's title lines are passed over."""
    while True:
        line = following(lines, path, {"numtabs": "NumTabs", "numalf": "NumAlf", "numblnds": "NumBlNds"}[_last(names)])
        if line.name in names:
            return line
        if "numblnds" not in names:
            line.refuse("not a line of an AirfoilInfo file v1.01 (AeroDyn 15); convert older ones first")


def _last(names: tuple[str, ...]) -> str:
    return next(name for name in ("numblnds", "numtabs", "numalf") if name in names)
