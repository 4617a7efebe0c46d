"""Turbulent wind boxes and the TurbSim full-field binary file (``.bts``).

File format: TurbSim User's Guide v2.00 (Jonkman 2014), appendix D. Sampling follows OpenFAST's InflowWind
(``IfW_FlowField.f90``, ``FlowField_IO.f90``); :meth:`WindBox.sample` states each rule and the two departures.
"""

from __future__ import annotations

import math
import os
import struct
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NoReturn

import numpy as np
from numpy.typing import ArrayLike, NDArray

_HEADER: Final = struct.Struct("<h4i6f6fi")
_ID_ONE_PASS: Final = 7
_ID_PERIODIC: Final = 8
_MAX_TEXT: Final = 4096
_MAX_GRID_POINTS: Final = 1_000_000
#: Positions this fraction of a cell outside the grid still count as on its edge (InflowWind's GridTol).
GRID_TOLERANCE: Final = 1e-3


class WindRangeError(ValueError):
    """A position or time at which a wind box holds no wind."""


@dataclass(frozen=True, eq=False)
class WindBox:
    """A turbulent wind field on a vertical grid normal to the mean wind, carried past the turbine unchanged.

    Attributes:
        velocity: wind velocity m/s, float32 (nt, nz, ny, 3): components along X (downwind), Y (left, looking
            downwind) and Z (up); rows upwards from ``z_bottom``, columns from y = -width/2 to +width/2.
        dt: time step, s.
        dy, dz: grid spacing, m.
        z_bottom: height of the lowest row above mean sea level, m.
        hub_height: reference height, m.
        mean_speed: speed at which the field is carried downwind (mean wind at hub height), m/s.
        periodic: the field repeats after ``nt * dt`` (file identifier 8; 7 = it ends).
        tower: velocity below the grid at y = 0, float32 (nt, n_tower, 3), downwards from ``z_bottom``.
        description: text stored with the file.
    """

    velocity: NDArray[np.float32]
    dt: float
    dy: float
    dz: float
    z_bottom: float
    hub_height: float
    mean_speed: float
    periodic: bool
    tower: NDArray[np.float32]
    description: str = ""

    def __post_init__(self) -> None:
        shape = self.velocity.shape
        if len(shape) != 4 or shape[3] != 3 or min(shape) < 1 or min(shape[1:3]) < 2 or shape[0] < 2:
            raise ValueError(f"wind box: velocity has shape {shape}; give (nt >= 2, nz >= 2, ny >= 2, 3)")
        if self.tower.ndim != 3 or self.tower.shape[0] != shape[0] or self.tower.shape[2] != 3:
            raise ValueError(f"wind box: tower has shape {self.tower.shape}; give ({shape[0]}, n_tower, 3)")
        for name in ("dt", "dy", "dz", "mean_speed", "hub_height"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise ValueError(f"wind box: {name} is {value}; give a finite value above zero")
        if not (math.isfinite(self.z_bottom) and self.z_bottom >= 0.0):
            raise ValueError(f"wind box: z_bottom is {self.z_bottom}; give a height of at least 0 m")

    @property
    def y(self) -> NDArray[np.float64]:
        """Lateral grid coordinates, m (ny,)."""
        ny = self.velocity.shape[2]
        return np.asarray((np.arange(ny) - 0.5 * (ny - 1)) * self.dy)

    @property
    def z(self) -> NDArray[np.float64]:
        """Heights of the grid rows, m (nz,)."""
        return np.asarray(self.z_bottom + np.arange(self.velocity.shape[1]) * self.dz, dtype=float)

    @property
    def time_offset(self) -> float:
        """Box time seen at x = 0 at simulation time 0, s.

        Half the grid width ahead for a box that ends, so that a rotor smaller than the grid finds wind at
        t = 0 wherever its blades are; 0 for a periodic box (InflowWind's ``InitXPosition``).
        """
        half_width = 0.5 * (self.velocity.shape[2] - 1) * self.dy
        return 0.0 if self.periodic else half_width / self.mean_speed

    @property
    def last_time(self) -> float:
        """Simulation time up to which the box holds wind at x = 0, s (infinite if periodic)."""
        return math.inf if self.periodic else (self.velocity.shape[0] - 1) * self.dt - self.time_offset

    def sample(self, t: float, points: ArrayLike) -> NDArray[np.float64]:
        """Wind velocity at ``points`` (n, 3) m, global frame, at simulation time ``t`` s: (n, 3) m/s.

        Trilinear in box time, y and z with Taylor's frozen turbulence: the point x sees box time
        ``t - x / mean_speed + time_offset``. At z <= 0 the wind is zero. Below the grid: the tower points at
        y = 0, linear to zero between the lowest of them and the sea, if the box has any; otherwise the
        lowest row. Departures from InflowWind: a periodic box wraps any number of times and also before its
        start; below a grid without tower points InflowWind stops.

        Raises:
            WindRangeError: beyond the sides or the top of the grid, or outside the time a box that does not
                repeat covers.
        """
        p = np.asarray(points, dtype=float)
        if p.ndim != 2 or p.shape[1] != 3:
            raise ValueError(f"wind box: points have shape {p.shape}; give (n, 3)")
        i0, i1, ft = self._time_cells(t - p[:, 0] / self.mean_speed + self.time_offset, t)
        fz_grid = (p[:, 2] - self.z_bottom) / self.dz
        on_tower = (fz_grid < -GRID_TOLERANCE) & (self.tower.shape[1] > 0)
        _, nz, ny, _ = self.velocity.shape
        k, fz = _cells(np.maximum(fz_grid, 0.0), nz, "z", p[:, 2], (self.z_bottom, self.z[-1]))
        fy_grid = np.where(on_tower, 0.0, p[:, 1] / self.dy + 0.5 * (ny - 1))
        j, fy = _cells(fy_grid, ny, "y", p[:, 1], (self.y[0], self.y[-1]))

        def plane(i: NDArray[np.intp]) -> NDArray[np.float64]:
            v = self.velocity
            low = v[i, k, j] * (1.0 - fy)[:, None] + v[i, k, j + 1] * fy[:, None]
            high = v[i, k + 1, j] * (1.0 - fy)[:, None] + v[i, k + 1, j + 1] * fy[:, None]
            return np.asarray(low * (1.0 - fz)[:, None] + high * fz[:, None])

        wind = plane(i0) * (1.0 - ft)[:, None] + plane(i1) * ft[:, None]
        if on_tower.any():
            column = self._tower_column(p[on_tower, 2], i0[on_tower], i1[on_tower], ft[on_tower])
            wind[on_tower] = column
        wind[p[:, 2] <= 0.0] = 0.0
        return wind

    def _time_cells(
        self, time: NDArray[np.float64], t: float
    ) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.float64]]:
        nt = self.velocity.shape[0]
        s = time / self.dt
        if not np.isfinite(s).all():
            raise WindRangeError(f"wind box: time {t} s or a position is not finite; give finite values")
        if self.periodic:
            s = np.mod(s, nt)
            first = np.minimum(s.astype(np.intp), nt - 1)
            return first, (first + 1) % nt, s - first
        outside = (s < -GRID_TOLERANCE) | (s > nt - 1 + GRID_TOLERANCE)
        if outside.any():
            seen = float(time[outside][0])
            raise WindRangeError(
                f"wind box: at simulation time {t:g} s box time {seen:g} s is asked for, but the box covers "
                f"0 to {(nt - 1) * self.dt:g} s; make a longer box or end the run by {self.last_time:g} s"
            )
        s = np.clip(s, 0.0, nt - 1.0)
        first = np.minimum(s.astype(np.intp), nt - 2)
        return first, first + 1, s - first

    def _tower_column(
        self, z: NDArray[np.float64], i0: NDArray[np.intp], i1: NDArray[np.intp], ft: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Wind on the tower line; its first point lies at the grid's lowest row, as InflowWind takes it."""
        n = self.tower.shape[1]
        depth = (self.z_bottom - z) / self.dz
        k = np.minimum(depth.astype(np.intp), n - 1)
        lowest = self.z_bottom - (n - 1) * self.dz
        last = k == n - 1
        weight = np.where(last, 1.0 - np.clip(z / lowest, 0.0, 1.0) if lowest > 0.0 else 0.0, depth - k)
        below = np.minimum(k + 1, n - 1)

        def line(i: NDArray[np.intp]) -> NDArray[np.float64]:
            lower = np.where(last[:, None], 0.0, self.tower[i, below])
            return np.asarray(self.tower[i, k] * (1.0 - weight)[:, None] + lower * weight[:, None])

        return line(i0) * (1.0 - ft)[:, None] + line(i1) * ft[:, None]


def _cells(
    s: NDArray[np.float64], n: int, axis: str, position: NDArray[np.float64], limits: tuple[float, float]
) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    outside = ~((s >= -GRID_TOLERANCE) & (s <= n - 1 + GRID_TOLERANCE))
    if outside.any():
        raise WindRangeError(
            f"wind box: {axis} = {float(position[outside][0]):g} m lies outside the grid ({limits[0]:g} to "
            f"{limits[1]:g} m); make a wider or taller box"
        )
    s = np.clip(s, 0.0, n - 1.0)
    cell = np.minimum(s.astype(np.intp), n - 2)
    return cell, s - cell


@dataclass(frozen=True)
class _Header:
    periodic: bool
    nz: int
    ny: int
    n_tower: int
    nt: int
    floats: tuple[float, ...]  # dz, dy, dt, mean speed, hub height, lowest row
    scale: NDArray[np.float64]  # (3,)
    offset: NDArray[np.float64]  # (3,)
    text_length: int

    @property
    def values_per_step(self) -> int:
        return 3 * (self.ny * self.nz + self.n_tower)

    @property
    def data_start(self) -> int:
        return _HEADER.size + self.text_length


def _refuse(path: Path, found: str) -> NoReturn:
    raise ValueError(f"{path}: not a usable TurbSim .bts file: {found}; write it again or give another file")


def _read_header(path: Path) -> _Header:
    size = path.stat().st_size
    with path.open("rb") as file:
        raw = file.read(_HEADER.size)
    if len(raw) < _HEADER.size:
        _refuse(path, f"{size} bytes, shorter than the {_HEADER.size}-byte header")
    ident, nz, ny, n_tower, nt, *rest = _HEADER.unpack(raw)
    floats, packing, text_length = tuple(rest[:6]), np.array(rest[6:12]), rest[12]
    if ident not in (_ID_ONE_PASS, _ID_PERIODIC):
        _refuse(path, f"identifier {ident} where 7 or 8 belongs")
    if min(nz, ny, nt) < 2 or n_tower < 0 or nz * ny > _MAX_GRID_POINTS or n_tower > _MAX_GRID_POINTS:
        _refuse(path, f"grid of {nz} x {ny} points, {n_tower} tower points, {nt} steps")
    names = ("dz", "dy", "dt", "mean wind speed", "hub height", "height of the lowest row")
    for name, value in zip(names, floats, strict=True):
        lowest_ok = value >= 0.0 if name == names[-1] else value > 0.0
        if not (math.isfinite(value) and lowest_ok):
            _refuse(path, f"{name} is {value}")
    if not np.isfinite(packing).all() or (packing[0::2] == 0.0).any():
        _refuse(path, f"velocity scales {packing[0::2].tolist()} and offsets {packing[1::2].tolist()}")
    if not 0 <= text_length <= _MAX_TEXT:
        _refuse(path, f"description of {text_length} bytes")
    header = _Header(ident == _ID_PERIODIC, nz, ny, n_tower, nt, floats, packing[0::2], packing[1::2], text_length)
    expected = header.data_start + 2 * header.values_per_step * nt
    if expected != size:
        _refuse(path, f"{size} bytes where its header announces {expected} (truncated or corrupt)")
    return header


def check_box(path: str | os.PathLike[str]) -> None:
    """Check a ``.bts`` file's header and length only.

    Raises:
        FileNotFoundError: no such file.
        ValueError: not usable.
    """
    _read_header(Path(path))


def read_box(path: str | os.PathLike[str]) -> WindBox:
    """Read a TurbSim full-field file.

    Raises:
        FileNotFoundError: no such file.
        ValueError: truncated, corrupt or implausible content; checked against the file's length before any
        allocation.
    """
    path = Path(path)
    h = _read_header(path)
    with path.open("rb") as file:
        file.seek(_HEADER.size)
        text = file.read(h.text_length).decode("latin-1").strip()
        raw = np.fromfile(file, dtype="<i2", count=h.values_per_step * h.nt)
    if raw.size != h.values_per_step * h.nt:
        _refuse(path, f"{raw.size} values where its header announces {h.values_per_step * h.nt}")
    values = raw.reshape(h.nt, -1, 3).astype(np.float32)
    with np.errstate(over="ignore"):
        values -= h.offset.astype(np.float32)
        values /= h.scale.astype(np.float32)
    if not np.isfinite(values).all():
        _refuse(path, f"velocity scales {h.scale.tolist()} give velocities that are not finite")
    dz, dy, dt, mean_speed, hub_height, z_bottom = h.floats
    n_grid = h.ny * h.nz
    return WindBox(
        velocity=values[:, :n_grid].reshape(h.nt, h.nz, h.ny, 3),
        dt=dt,
        dy=dy,
        dz=dz,
        z_bottom=z_bottom,
        hub_height=hub_height,
        mean_speed=mean_speed,
        periodic=h.periodic,
        tower=values[:, n_grid:],
        description=text,
    )


def write_box(box: WindBox, path: str | os.PathLike[str]) -> None:
    """Write a wind box as a TurbSim full-field file, atomically (complete or not at all).

    Velocities are packed to 16 bits over each component's range, rounded to nearest: the error is at most
    half a step, range / 65535 / 2.

    Raises:
        ValueError: velocities that are not finite, or a description longer than 4096 bytes.
    """
    path = Path(path)
    text = box.description.encode("latin-1", errors="replace")
    if len(text) > _MAX_TEXT:
        raise ValueError(f"{path}: description of {len(text)} bytes; give at most {_MAX_TEXT}")
    nt, nz, ny, _ = box.velocity.shape
    points = np.concatenate([box.velocity.reshape(nt, nz * ny, 3), box.tower], axis=1)
    if not np.isfinite(points).all():
        raise ValueError(f"{path}: the wind box holds velocities that are not finite; nothing written")
    low = points.min(axis=(0, 1)).astype(float)
    span = points.max(axis=(0, 1)) - low
    # Scale and offset as the reader will find them: 32-bit, rounded before they are used for packing. A
    # component without any variation is stored with scale 1, as TurbSim does.
    scale = np.where(span > 0.0, 65535.0 / np.where(span > 0.0, span, 1.0), 1.0).astype(np.float32)
    offset = (-32768.0 - scale.astype(float) * low).astype(np.float32)
    packed = np.rint(points * scale.astype(float) + offset.astype(float))
    packed = np.clip(packed, -32768, 32767).astype("<i2")
    pairs = np.stack([scale, offset], axis=1).ravel().tolist()
    ident = _ID_PERIODIC if box.periodic else _ID_ONE_PASS
    header = _HEADER.pack(
        *(ident, nz, ny, box.tower.shape[1], nt),
        *(box.dz, box.dy, box.dt, box.mean_speed, box.hub_height, box.z_bottom),
        *(*pairs, len(text)),
    )
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=".part")
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(header)
            file.write(text)
            file.write(packed.tobytes())
        os.chmod(temporary, 0o644)
        os.replace(temporary, path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise
