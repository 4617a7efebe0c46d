"""A given sea from a file: wave components, or a record of the elevation turned into components.

    eta(t) = sum_k a_k cos(w_k t + e_k) at x = y = 0

A record of N samples, step dt, is taken as one period T = N dt: its Fourier series has w_k = 2 pi k / T, and the sum
passes through all samples (before frequencies outside the database's are left out). Time is the record's own.
"""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd

from fmus_src.hydro.waves import WaveComponents

Array = npt.NDArray[np.float64]

COMPONENT_COLUMNS = ("omega_rad_s", "amplitude_m", "phase_rad")
TIME_COLUMNS = ("time_s", "Time", "time")
ELEVATION_COLUMNS = ("elevation_m", "Wave1Elev", "elevation")
LARGEST_LOSS = 0.02  # of the variance: what is left out beyond this is worth a warning


def read(path: Path) -> WaveComponents:
    """Components from a CSV (or Parquet) file with a header.

    The columns are either omega_rad_s, amplitude_m, phase_rad; or time_s (or Time), elevation_m (or Wave1Elev).

    Raises:
        ValueError: no such file or columns, a file that cannot be read, values that are no numbers, or a record as
            `from_record` refuses it.
    """
    if not path.is_file():
        raise ValueError(f"sea: there is no file '{path}'")
    try:
        table = pd.read_parquet(path) if path.suffix == ".parquet" else pd.read_csv(path, skipinitialspace=True)
    except Exception as error:  # whatever the reader of a broken file stumbles over
        reason = (str(error) or type(error).__name__).split("\n", 1)[0]
        raise ValueError(f"sea: {path.name} cannot be read ({reason}); give a CSV or Parquet file") from None
    if set(COMPONENT_COLUMNS) <= set(table.columns):
        return WaveComponents(*(_column(path, table, name) for name in COMPONENT_COLUMNS))
    time = next((name for name in TIME_COLUMNS if name in table.columns), None)
    elevation = next((name for name in ELEVATION_COLUMNS if name in table.columns), None)
    if time is None or elevation is None:
        raise ValueError(
            f"sea: {path.name} needs the columns {', '.join(COMPONENT_COLUMNS)}, or {TIME_COLUMNS[0]} and "
            f"{ELEVATION_COLUMNS[0]} ({TIME_COLUMNS[1]} and {ELEVATION_COLUMNS[1]})"
        )
    samples = _column(path, table, time), _column(path, table, elevation)
    try:
        return from_record(*samples)
    except ValueError as error:
        raise ValueError(f"sea: {path.name}: {error}") from None


def from_record(time: Array, elevation: Array) -> WaveComponents:
    """Fourier components of a record, all frequencies up to the sampling's; its mean is taken off.

    Args:
        time: s, shape (n,), evenly spaced. elevation: m, shape (n,). A last sample equal to the first closes a period
            and counts once.

    Raises:
        ValueError: fewer than 16 samples, an elevation that does not move, or times that are not evenly spaced.
    """
    if len(time) < 16:
        raise ValueError(f"{len(time)} samples make no record of a sea")
    step = float(np.median(np.diff(time)))
    uneven = np.flatnonzero(np.abs(np.diff(time) - step) > 1e-2 * abs(step))
    if not step > 0.0 or len(uneven):
        place = time[uneven[0]] if len(uneven) else time[0]
        raise ValueError(f"times must rise evenly; they do not at {place:g} s: resample the record")
    if np.ptp(elevation) <= 1e-9 * np.abs(elevation).max():
        raise ValueError(f"the elevation does not move: all {len(elevation)} samples are {elevation[0]:g} m")
    step = float(time[-1] - time[0]) / (len(time) - 1)  # times of single precision are even on the whole
    if abs(elevation[-1] - elevation[0]) < 1e-3 * float(np.std(elevation)):
        elevation = elevation[:-1]
    n = len(elevation)
    transform = np.fft.rfft(elevation) / n
    amplitude = 2.0 * np.abs(transform)
    if n % 2 == 0:
        amplitude[-1] /= 2.0  # the sampling's own frequency stands once in a transform
    omega = 2.0 * np.pi / (n * step) * np.arange(len(amplitude))
    phase = np.mod(np.angle(transform) - omega * time[0], 2.0 * np.pi)
    return WaveComponents(*(np.asarray(values[1:], dtype=float) for values in (omega, amplitude, phase)))


def within(sea: WaveComponents, low: float, high: float) -> tuple[WaveComponents, str]:
    """The components from `low` to `high` (rad/s) that have an amplitude, and one statement of what was left out.

    More than 2 % of the variance left out is warned of.

    Raises:
        ValueError: arrays of unlike length, values that are no numbers, or nothing left.
    """
    omega, amplitude, phase = (np.asarray(v, dtype=float).ravel() for v in (sea.omega, sea.amplitude, sea.phase))
    if not len(omega) == len(amplitude) == len(phase):
        raise ValueError(f"sea: {len(omega)} frequencies, {len(amplitude)} amplitudes and {len(phase)} phases")
    if not np.all(np.isfinite([omega, amplitude, phase])):
        raise ValueError("sea: frequencies, amplitudes and phases must be finite numbers")
    variance = 0.5 * amplitude**2
    inside = (omega >= low) & (omega <= high) & (amplitude != 0.0)
    if not inside.any():
        raise ValueError(
            f"sea: no component has its frequency between {low:g} and {high:g} rad/s, the database's range"
        )
    below, above = (float(variance[beyond].sum() / variance.sum()) for beyond in (omega < low, omega > high))
    note = (
        f"sea of {inside.sum()} components, Hs {4.0 * np.sqrt(variance[inside].sum()):.4g} m; left out: "
        f"{below:.2%} of the variance below {low:g} rad/s, {above:.2%} above {high:g} rad/s"
    )
    if below + above > LARGEST_LOSS:
        warnings.warn(f"given {note}: use a database of more frequencies or filter the record", stacklevel=2)
    return WaveComponents(omega[inside], amplitude[inside], phase[inside]), note


def _column(path: Path, table: pd.DataFrame, name: str) -> Array:
    values = pd.to_numeric(table[name], errors="coerce").to_numpy(dtype=float)
    bad = np.flatnonzero(~np.isfinite(values))
    if len(bad):
        raise ValueError(f"sea: {path.name}: column {name} is no number in row {bad[0] + 1}")
    return np.asarray(values)
