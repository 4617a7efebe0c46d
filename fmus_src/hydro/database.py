"""The hydrodynamic database of a platform: linear potential-flow coefficients about the PRP, SI units.

Conventions: time factor exp(+i w t), phases lead positive; incident wave eta = a cos(w t - k (x cos b + y sin b))
with heading b (0: along +x, downwind). Degrees of freedom 1..6: surge, sway, heave, roll, pitch, yaw, index 0..5.
"""

from __future__ import annotations

import json
import math
import re
import warnings
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Complex = npt.NDArray[np.complex128]

PACKAGED = {"closed": "barge.json", "moonpool": "barge_moonpool.json", "deep": "barge_deep.json"}
# What a file lacks: the ITI Energy barge's (Jonkman, NREL/TP-500-41958, 2007).
DEFAULTS = {"volume": 6000.0, "depth": 150.0, "density": 1025.0, "gravity": 9.80665}
OPTIONS = {"volume": "displaced_volume", "depth": "water_depth", "density": "water_density", "gravity": "gravity"}
EXAMPLES = {
    "displaced_volume": "6000 m3", "water_depth": "150 m; for deep water a large finite depth such as 1e5 m",
    "water_density": "1025 kg/m3", "gravity": "9.80665 m/s2", "unit_length": "1 m", "draft": "4 m",
}  # fmt: skip
# Heave added mass at infinite frequency over displaced mass: what a floating body's may be.
PLAUSIBLE = (0.01, 100.0)
# Of sqrt(ii jj): coefficients ij and ji further apart are refused (coarse panels reach 0.07), or stated.
NOT_RECIPROCAL, STATED = 0.10, 0.01
NEGLIGIBLE = 1e-3  # of sqrt(ii jj): a coupling below this at all frequencies is the panels' noise


@dataclass(frozen=True, eq=False)
class HydroDatabase:
    """Linear hydrodynamic coefficients of one rigid body.

    Attributes:
        name: "closed" box, open "moonpool" or closed in "deep" water of the package, or the name of a file.
        omega: angular frequency, rad/s, shape (n,), increasing.
        heading: wave heading, rad, shape (m,).
        added_mass: A(w), kg, kg m, kg m2, shape (n, 6, 6).
        added_mass_infinite: A at infinite frequency, shape (6, 6).
        damping: radiation damping B(w), N s/m, N s, N m s, shape (n, 6, 6).
        excitation: X(w, b), Froude-Krylov plus diffraction per metre of wave amplitude, N/m and N, shape (n, m, 6).
        stiffness: buoyancy and waterplane parts of the restoring matrix, N/m, N, N m, shape (6, 6).
        volume: displaced volume, m3. depth: water depth, m. density: kg/m3. gravity: m/s2.
        provenance: how it was computed or read, one statement a line.
    """

    name: str
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


def load(
    what: str | Path = "closed",
    *,
    volume: float | None = None,
    depth: float | None = None,
    density: float | None = None,
    gravity: float | None = None,
    unit_length: float = 1.0,
) -> HydroDatabase:
    """Load a database: of the package, or from a file.

    Args:
        what: "closed", "moonpool" or "deep"; or a path: a JSON file of this project, Capytaine's NetCDF (`.nc`), or
            WAMIT files by their common root, "DIR/Barge" (or one of them, "DIR/Barge.1").
        volume, depth, density, gravity: what the file lacks, m3, m, kg/m3, m/s2; default: the ITI Energy barge's. A
            figure that the file states is taken from it.
        unit_length: m, of the non-dimensional WAMIT coefficients (ULEN); other databases have none.

    Raises:
        ValueError: no such database, a file with missing or contradictory figures, or an argument that contradicts it.
    """
    given = {"volume": volume, "depth": depth, "density": density, "gravity": gravity}
    path = Path(what)
    positive("unit_length", unit_length)
    wamit = str(what) not in PACKAGED and path.suffix not in (".json", ".nc")
    if unit_length != 1.0 and not wamit:
        raise ValueError(f"hydro: unit_length {unit_length:g} is for WAMIT's files, not for {what}; leave it out")
    if str(what) in PACKAGED:
        result = _packaged(str(what))
        stated(path.name, {key: getattr(result, key) for key in DEFAULTS}, given)
        return result
    if path.suffix == ".json" and path.is_file():
        result = read(path)
        stated(path.name, {key: getattr(result, key) for key in DEFAULTS}, given)
    elif path.suffix == ".nc" and path.is_file():
        from fmus_src.hydro.capytaine_file import read_capytaine

        try:
            result = read_capytaine(path, given)
        except (ValueError, KeyError, IndexError, TypeError, AttributeError) as error:
            if str(error).startswith("hydro:"):
                raise
            reason = str(error).split("\n", 1)[0]
            raise ValueError(f"hydro: {path.name} is no Capytaine dataset of one body ({reason})") from None
    elif any(path.parent.glob(f"{_wamit_root(path).name}.[13]")):
        from fmus_src.hydro.wamit_file import read_wamit

        result = read_wamit(_wamit_root(path), given, unit_length)
    else:
        raise ValueError(
            f"hydro: there is no database '{what}'; choose one of {', '.join(PACKAGED)}, a .json or .nc file, or the "
            "root DIR/NAME of WAMIT's NAME.1, NAME.3 and NAME.hst"
        )
    return with_infinite(checked(result))


@cache
def _packaged(name: str) -> HydroDatabase:
    return checked(replace(read(Path(__file__).parent / "data" / PACKAGED[name]), name=name))


def _wamit_root(path: Path) -> Path:
    return path.with_suffix("") if path.suffix in (".1", ".3", ".hst") else path


def positive(option: str, value: float, file: str | None = None) -> float:
    """The value of an option (of a file, if one is named).

    Raises:
        ValueError: it is not above zero, or not finite.
    """
    if not (math.isfinite(value) and value > 0.0):
        place = f"{file}: " if file else ""
        raise ValueError(f"hydro: {place}{option} {value:g} must be a finite number above 0, e.g. {EXAMPLES[option]}")
    return value


def warn_of_scale(database: HydroDatabase) -> None:
    """Warn if the added mass is out of all proportion to the displaced mass, as with a wrong unit length."""
    ratio = float(database.added_mass_infinite[2, 2]) / (database.density * database.volume)
    if not PLAUSIBLE[0] <= ratio <= PLAUSIBLE[1]:
        warnings.warn(
            f"{database.name}: heave added mass at infinite frequency is {ratio:.3g} times the displaced mass; "
            "check unit_length and displaced_volume",
            stacklevel=3,
        )


def stated(file: str, found: dict[str, float], given: dict[str, float | None]) -> dict[str, float]:
    """Volume, depth, density and gravity: as the file has them, else as given, else the defaults.

    Raises:
        ValueError: one that is given contradicts the file's, or one is not above zero and finite.
    """
    result = {}
    for key, default in DEFAULTS.items():
        own, asked = found.get(key), given.get(key)
        if asked is not None:
            positive(OPTIONS[key], asked)
        if own is not None:
            positive(OPTIONS[key], own, file)
        if own is not None and asked is not None and not abs(own - asked) <= 1e-6 * abs(own):
            raise ValueError(f"hydro: {file} states {key} {own:g}, not {asked:g}; leave the option out")
        result[key] = own if own is not None else asked if asked is not None else default
    return result


def checked(database: HydroDatabase) -> HydroDatabase:
    """The database with reciprocal matrices.

    Raises:
        ValueError: naming what is wrong: frequencies that do not rise, values that are no numbers, matrices that are
            not reciprocal, negative damping, or a stiffness that the model has no place for.
    """
    d = database
    falls = np.flatnonzero(~(np.diff(d.omega) > 0.0))
    if len(d.omega) < 8 or len(falls) or not d.omega[0] > 0.0:
        where = f"they do not after {d.omega[falls[0]]:g} rad/s" if len(falls) else f"there are {len(d.omega)}"
        raise ValueError(f"hydro: {d.name}: eight or more frequencies must rise from above zero; {where}")
    for what in ("omega", "heading", "added_mass", "damping", "excitation", "stiffness"):
        bad = np.argwhere(~np.isfinite(getattr(d, what)))
        if len(bad):
            raise ValueError(f"hydro: {d.name}: {what.replace('_', ' ')} is no number at index {bad[0].tolist()}")
    negative = d.damping.diagonal(axis1=1, axis2=2).min(axis=0) + 0.02 * d.damping.diagonal(axis1=1, axis2=2).max(
        axis=0
    )
    if (negative < 0.0).any():
        worst = int(np.argmin(negative)) + 1
        raise ValueError(f"hydro: {d.name}: damping {worst}{worst} is negative by more than 2 % of its maximum")
    coupling = d.stiffness.copy()
    coupling[np.ix_([2, 3, 4], [2, 3, 4])] = 0.0
    if np.abs(coupling).max() > NEGLIGIBLE * np.abs(d.stiffness).max():
        i, j = divmod(int(np.argmax(np.abs(coupling))), 6)
        raise ValueError(
            f"hydro: {d.name}: stiffness {i + 1}{j + 1} is not zero; only heave, roll and pitch may restore"
        )
    notes = list(d.provenance)
    parts: dict[str, Any] = {}
    for key in ("added_mass", "damping"):
        matrices = getattr(d, key)
        scale = np.abs(matrices).max(axis=0).diagonal()
        parts[key], skew, pair = _reciprocal(d.name, key.replace("_", " "), matrices, scale)
        if skew > STATED:
            notes.append(
                f"{key.replace('_', ' ')} {pair} and {pair[::-1]} differ by {skew:.1%} of the diagonal: averaged"
            )
    infinite = d.added_mass_infinite
    scale = np.abs(d.added_mass).max(axis=0).diagonal()
    infinite, _, _ = _reciprocal(d.name, "infinite-frequency added mass", infinite[None], scale)
    return replace(d, **parts, added_mass_infinite=infinite[0], provenance=tuple(notes))


def with_infinite(database: HydroDatabase) -> HydroDatabase:
    """The database; an added mass at infinite frequency that it lacks (nan) follows from Ogilvie's relation.

    A_inf = A(w) + 1/w integral K(t) sin(w t) dt is the same at all frequencies: the mean over them is taken.
    """
    if np.isfinite(database.added_mass_infinite).all():
        return database
    from fmus_src.hydro.radiation import added_mass_difference

    found = database.added_mass - added_mass_difference(database, database.omega)
    scale = np.sqrt(np.maximum(found.mean(axis=0).diagonal(), 1e-30))
    spread = float((found.std(axis=0) / np.multiply.outer(scale, scale)).max())
    note = f"no infinite frequency in the file: A_inf from damping and added mass (Ogilvie), within {spread:.1%}"
    return replace(database, added_mass_infinite=found.mean(axis=0), provenance=(*database.provenance, note))


def couplings(database: HydroDatabase) -> npt.NDArray[np.bool_]:
    """Which degrees of freedom radiation couples, shape (6, 6): what is above the panels' noise at some frequency."""
    result = np.eye(6, dtype=bool)
    for matrix in (database.added_mass, database.damping):
        largest = np.abs(matrix).max(axis=0)
        scale = np.sqrt(np.multiply.outer(largest.diagonal(), largest.diagonal()))
        result |= largest > NEGLIGIBLE * scale
    return result


def read(path: Path) -> HydroDatabase:
    """Read a database written by `save`.

    Raises:
        ValueError: no JSON, or the file lacks an entry.
    """
    try:
        data: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, OSError, RecursionError) as error:
        raise ValueError(f"hydro: {path.name} is no JSON ({error}); write it anew with compute_database") from None
    try:
        omega, heading = np.array(data["omega"], dtype=float), np.radians(np.array(data["heading_deg"], dtype=float))
        excitation = np.zeros((len(omega), len(heading), 6), dtype=complex)
        for i in range(6):
            x = data["excitation"][str(i + 1)]
            excitation[:, :, i] = np.array(x["real"]).T + 1j * np.array(x["imag"]).T
        return HydroDatabase(
            name=data["name"],
            omega=omega,
            heading=heading,
            added_mass=_full(data["added_mass"], len(omega)),
            added_mass_infinite=_full(data["added_mass_infinite"], 1)[0],
            damping=_full(data["damping"], len(omega)),
            excitation=excitation,
            stiffness=_full(data["stiffness"], 1)[0],
            volume=float(data["volume"]),
            depth=float(data["depth"]),
            density=float(data["density"]),
            gravity=float(data["gravity"]),
            provenance=tuple(data["provenance"]),
        )
    except KeyError as missing:
        raise ValueError(f"hydro: {path.name} lacks {missing}; write it anew with compute_database") from None
    except (ValueError, TypeError, AttributeError, IndexError) as error:
        raise ValueError(f"hydro: {path.name}: lists of unlike length or no numbers ({error})") from None


def save(database: HydroDatabase, path: Path) -> None:
    """Write a database as text: five significant digits, one coefficient a line over all frequencies."""
    d = database
    data = {
        "name": d.name,
        "provenance": list(d.provenance),
        "units": "SI, about the PRP; exp(+i w t), lead positive; lists run over omega (rad/s)",
        "volume": d.volume, "depth": d.depth, "density": d.density, "gravity": d.gravity,
        "heading_deg": _digits(np.degrees(d.heading)),
        "stiffness": _entries(d.stiffness[None], 8),
        "omega": _digits(d.omega, 8),
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


def _reciprocal(name: str, what: str, matrices: Array, scale: Array) -> tuple[Array, float, str]:
    """Symmetric part of matrices (n, 6, 6), largest skew part over `scale` (6,) of the diagonal, and its pair."""
    root = np.sqrt(np.maximum(scale, 1e-30))
    skew = np.abs(matrices - np.swapaxes(matrices, 1, 2)).max(axis=0) / np.multiply.outer(root, root)
    i, j = sorted(divmod(int(np.argmax(skew)), 6))
    pair = f"{i + 1}{j + 1}"
    if skew[i, j] > NOT_RECIPROCAL:
        raise ValueError(
            f"hydro: {name}: {what} {pair} and {pair[::-1]} differ by {skew[i, j]:.0%} of the diagonal; "
            "they must be equal: are both in the file, and of one reference point?"
        )
    return np.asarray((matrices + np.swapaxes(matrices, 1, 2)) / 2.0), float(skew[i, j]), pair


def _entries(matrices: Array, digits: int = 5) -> dict[str, list[float]]:
    largest = np.abs(matrices).max(axis=0)
    return {f"{i + 1}{j + 1}": _digits(matrices[:, i, j], digits) for i, j in np.argwhere(largest > 0.0)}


def _full(entries: dict[str, list[float]], count: int) -> Array:
    result = np.zeros((count, 6, 6))
    for pair, values in entries.items():
        result[:, int(pair[0]) - 1, int(pair[1]) - 1] = values
    return result


def _rows(values: Array) -> list[list[float]]:
    return [_digits(column) for column in values.T]


def _digits(values: Array, digits: int = 5) -> list[float]:
    # Rounding noise of symmetry, ten orders below the largest value of the list, is written as zero.
    floor = 1e-7 * float(np.max(np.abs(values), initial=0.0))
    return [float(f"{v:.{digits}g}") if abs(v) > floor else 0.0 for v in values]


def _one_list_a_line(text: str) -> str:
    """Join the lines of innermost lists that `json.dumps(indent=...)` spreads."""
    return re.sub(r"\[([^\[\]]*)\]", lambda match: "[" + " ".join(match.group(1).split()) + "]", text)
