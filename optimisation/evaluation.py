"""Evaluation of runs: statistics after the transient, suppression rate (Wang et al. 2022, eq. 15), spectra."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Statistics:
    """Statistics of a channel, in its unit; std about the mean (divisor n), rms about zero."""

    mean: float
    std: float
    rms: float
    min: float
    max: float


@dataclass(frozen=True)
class Spectrum:
    """One-sided power spectral density and how it was estimated.

    Attributes:
        frequency: Hz, shape (n,).
        density: channel's unit squared per Hz, shape (n,).
        segment: length of a segment, s; segments: their number; window, overlap: of Welch's method.
    """

    frequency: Array
    density: Array
    segment: float
    segments: int
    window: str = "hann"
    overlap: float = 0.5


def statistics(time: npt.ArrayLike, values: npt.ArrayLike, *, transient: float = 30.0) -> Statistics:
    """Statistics of a uniformly sampled channel from `transient` seconds after the first sample.

    Raises:
        ValueError: nothing is left after the transient, a value is not finite, or sampling is not uniform.
    """
    _, x = after_transient(time, values, transient)
    return Statistics(
        mean=float(x.mean()),
        std=float(x.std()),
        rms=float(np.sqrt(np.mean(x**2))),
        min=float(x.min()),
        max=float(x.max()),
    )


def suppression_rate(undamped: float, damped: float) -> float:
    """Reduction of a standard deviation by a damper, %: eq. 15. Negative if the damper makes it worse.

    Raises:
        ValueError: the undamped standard deviation is not positive.
    """
    if not undamped > 0.0:
        raise ValueError(f"suppression rate: undamped standard deviation is {undamped}, needs to be above 0")
    return (undamped - damped) / undamped * 100.0


def power_spectral_density(
    time: npt.ArrayLike, values: npt.ArrayLike, *, transient: float = 30.0, segment: float = 200.0
) -> Spectrum:
    """Welch's estimate: Hann window, half overlapping segments, mean removed from each.

    Args:
        segment: length of a segment, s, cut to the length of the record; its inverse is the resolution in Hz.

    Raises:
        ValueError: as `statistics`, or fewer than 8 samples in a segment.
    """
    from scipy.signal import welch  # its import takes a second, which what needs no spectrum should not wait for

    t, x = after_transient(time, values, transient)
    step = (t[-1] - t[0]) / (t.size - 1)
    count = min(t.size, round(segment / step))
    if count < 8:
        raise ValueError(f"spectrum: {count} samples in a segment of {segment} s; take longer segments")
    frequency, density = welch(x, 1.0 / step, window="hann", nperseg=count, noverlap=count // 2, detrend="constant")
    segments = 1 + (t.size - count) // (count - count // 2)
    return Spectrum(np.asarray(frequency), np.asarray(density), count * step, segments)


def compare(
    runs: Mapping[str, pd.DataFrame],
    channels: Sequence[str],
    *,
    reference: str | None = None,
    transient: float = 30.0,
) -> pd.DataFrame:
    """Statistics of channels in several runs, and the suppression rate against one of them.

    Args:
        runs: label -> channels by column, indexed by time (s).
        reference: label of the run without dampers; the first by default.

    Returns:
        one row per (channel, run): mean, std, rms, min, max in the channel's unit, and suppression in %
        (eq. 15; nan where the reference does not move).

    Raises:
        ValueError: no runs, an unknown reference, or a run lacks a channel.
    """
    if not runs:
        raise ValueError("compare: no runs given")
    base = next(iter(runs)) if reference is None else reference
    if base not in runs:
        raise ValueError(f"compare: reference '{base}' is none of the runs {', '.join(runs)}")
    rows: list[dict[str, Any]] = []
    for channel in channels:
        found: dict[str, Statistics] = {}
        for label, frame in runs.items():
            if channel not in frame.columns:
                raise ValueError(f"compare: run '{label}' has no channel '{channel}'")
            found[label] = statistics(frame.index.to_numpy(), frame[channel].to_numpy(), transient=transient)
        sigma = found[base].std
        for label, values in found.items():
            rate = suppression_rate(sigma, values.std) if sigma > 0.0 else float("nan")
            rows.append({"channel": channel, "run": label, **asdict(values), "suppression": rate})
    columns = ["channel", "run", "mean", "std", "rms", "min", "max", "suppression"]
    return pd.DataFrame(rows, columns=columns).set_index(["channel", "run"])


def after_transient(time: npt.ArrayLike, values: npt.ArrayLike, transient: float) -> tuple[Array, Array]:
    """Times and values from `transient` seconds after the first sample on; raises as `statistics`."""
    t, x = np.asarray(time, dtype=float), np.asarray(values, dtype=float)
    if t.ndim != 1 or t.shape != x.shape:
        raise ValueError(f"times and values must be equally long columns, not of shape {t.shape} and {x.shape}")
    # half a nanosecond: a sample at the end of the transient counts, whatever the rounding of its time
    kept = t >= (t[0] if t.size else 0.0) + transient - 5e-10
    t, x = t[kept], x[kept]
    if t.size < 2:
        raise ValueError(f"nothing left after a transient of {transient} s: simulate longer or drop less")
    steps = np.diff(t)
    if not np.all(np.abs(steps - steps.mean()) < 1e-3 * steps.mean()):
        raise ValueError("samples are not equally spaced in time: resample the run first")
    if not np.all(np.isfinite(x)):
        raise ValueError(f"value at {t[~np.isfinite(x)][0]:.6g} s is not finite")
    return t, x
