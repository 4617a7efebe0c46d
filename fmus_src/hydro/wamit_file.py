"""WAMIT's output files: NAME.1 (added mass, damping), NAME.3 (excitation), NAME.hst (stiffness).

Format and non-dimensional form: WAMIT user manual (v7), chapter 4; L is the unit length ULEN, k the sum over both
indices of 1 for a displacement and 2 for a rotation:

    A = rho L^(k+1) A'    B = rho w L^(k+1) B'    X = rho g a L^(1+i) X'    C = rho g L^k C'

(i is 1 for a force, 2 for a moment.) The first column is the period in s: 0 stands for infinite frequency, a negative
one for zero frequency. Time factor exp(+i w t), phases lead positive, headings the way the waves travel, about WAMIT's
body axes (XBODY must put them at the PRP): as in this project. A file's .hst is taken to be without the weight, as
HydroDyn wants it.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from fmus_src.hydro.database import HydroDatabase, stated

Array = npt.NDArray[np.float64]
Complex = npt.NDArray[np.complex128]

RANK = np.array([1, 1, 1, 2, 2, 2])


def read_wamit(root: Path, given: dict[str, float | None], unit_length: float = 1.0) -> HydroDatabase:
    """Read root.1, root.3 and root.hst.

    Args:
        given: volume, depth, density and gravity, of which WAMIT's files have none; None: `database.DEFAULTS`.
        unit_length: L, m.

    Returns:
        the database; its added mass at infinite frequency is nan if the file has no such row.

    Raises:
        ValueError: a missing file, a row that is missing or no row of numbers.
    """
    figures = stated(root.name, {}, given)
    omega, added_mass, damping, infinite = _radiation(root.with_name(root.name + ".1"))
    heading, excitation = _excitation(root.with_name(root.name + ".3"), omega)
    power = np.add.outer(RANK, RANK)
    mass = figures["density"] * unit_length ** (power + 1.0)
    weight = figures["density"] * figures["gravity"]
    return HydroDatabase(
        name=root.name,
        omega=omega,
        heading=np.radians(heading),
        added_mass=added_mass * mass,
        added_mass_infinite=infinite * mass,
        damping=damping * mass * omega[:, None, None],
        excitation=excitation * weight * unit_length ** (RANK + 1.0),
        stiffness=_stiffness(root.with_name(root.name + ".hst")) * weight * unit_length**power,
        provenance=(
            f"WAMIT files {root.name}.1, .3, .hst; unit length {unit_length:g} m, "
            + ", ".join(f"{key} {value:g}" for key, value in figures.items()),
        ),
        **figures,
    )


def _radiation(path: Path) -> tuple[Array, Array, Array, Array]:
    """Frequencies rising, A' and B' (n, 6, 6), and A' at infinite frequency (nan if it has no row)."""
    rows = _rows(path, (4, 5))
    pairs = sorted({(int(r[1]), int(r[2])) for r in rows})
    periods = sorted({r[0] for r in rows if r[0] > 0.0}, reverse=True)
    place = {period: n for n, period in enumerate(periods)}
    added_mass, damping = np.zeros((2, len(periods), 6, 6))
    infinite = np.full((6, 6), np.nan)
    seen: set[tuple[float, int, int]] = set()
    for r in rows:
        i, j = _dof(path, r[1]), _dof(path, r[2])
        if (r[0], i, j) in seen:
            raise ValueError(f"hydro: {path.name}: period {r[0]:g} s, pair {i + 1} {j + 1} stands twice")
        seen.add((r[0], i, j))
        if r[0] > 0.0:
            if len(r) < 5:
                raise ValueError(f"hydro: {path.name}: period {r[0]:g} s, pair {i + 1} {j + 1} has no damping")
            added_mass[place[r[0]], i, j], damping[place[r[0]], i, j] = r[3], r[4]
        elif r[0] == 0.0:
            infinite = np.nan_to_num(infinite)
            infinite[i, j] = r[3]
    for period in [*periods, *([0.0] if np.isfinite(infinite).all() else [])]:
        for i, j in pairs:
            if (period, i - 1, j - 1) not in seen:
                raise ValueError(f"hydro: {path.name}: period {period:g} s lacks the pair {i} {j}")
    return 2.0 * np.pi / np.array(periods), added_mass, damping, infinite


def _excitation(path: Path, omega: Array) -> tuple[Array, Complex]:
    """Headings in degrees, rising, and X' (n, m, 6) at the frequencies of the radiation."""
    rows = _rows(path, (7,))
    headings = sorted({r[1] for r in rows})
    result = np.full((len(omega), len(headings), 6), np.nan + 0j)
    column = {heading: n for n, heading in enumerate(headings)}
    for r in rows:
        if r[0] <= 0.0:
            continue
        n = int(np.argmin(np.abs(omega - 2.0 * np.pi / r[0])))
        if abs(omega[n] * r[0] / (2.0 * np.pi) - 1.0) > 1e-4:
            raise ValueError(f"hydro: {path.name}: period {r[0]:g} s is not in {path.stem}.1")
        result[n, column[r[1]], _dof(path, r[2])] = r[5] + 1j * r[6]
    missing = np.argwhere(np.isnan(result.real))
    if len(missing):
        n, m, i = missing[0]
        raise ValueError(
            f"hydro: {path.name}: period {2 * np.pi / omega[n]:g} s, heading {headings[m]:g} deg lacks mode {i + 1}"
        )
    return np.array(headings), result


def _stiffness(path: Path) -> Array:
    result = np.zeros((6, 6))
    for r in _rows(path, (3,)):
        result[_dof(path, r[0]), _dof(path, r[1])] = r[2]
    return result


def _dof(path: Path, value: float) -> int:
    if value not in (1.0, 2.0, 3.0, 4.0, 5.0, 6.0):
        raise ValueError(f"hydro: {path.name}: mode {value:g} is not one of 1 to 6 (one rigid body)")
    return int(value) - 1


def _rows(path: Path, lengths: tuple[int, ...]) -> list[list[float]]:
    """Rows of numbers of one of the lengths."""
    if not path.is_file():
        raise ValueError(f"hydro: there is no file '{path}'; WAMIT's .1, .3 and .hst belong together")
    rows = []
    for number, line in enumerate(path.read_text(encoding="ascii", errors="replace").splitlines(), 1):
        if not line.strip():
            continue
        try:
            row = [float(word) for word in line.replace("D", "E").split()]
        except ValueError:
            row = []
        if len(row) in lengths:
            rows.append(row)
        elif rows or number > 1:  # the first line may be a title
            wanted = " or ".join(str(n) for n in lengths)
            raise ValueError(f"hydro: {path.name}, line {number}: needs {wanted} numbers: '{line.strip()[:60]}'")
    return rows
