"""Power spectral densities of a campaign's runs, averaged over seeds."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pandas as pd

from optimisation.evaluation import power_spectral_density

Array = npt.NDArray[np.float64]
SEGMENT = 200.0  # s: 5 mHz resolve the platform's pitch (0.084 Hz) from the wave peak (0.080 Hz)


@dataclass(frozen=True)
class MeanSpectrum:
    """Average of the records' one-sided spectra: Welch's method, Hann window, half overlapping segments.

    Attributes:
        frequency: Hz, shape (n,). density: channel's unit squared per Hz, shape (n,).
        segment: length of a segment, s. segments: of all records together. seeds: number of records.
    """

    frequency: Array
    density: Array
    segment: float
    segments: int
    seeds: int


def mean_spectrum(
    frames: Iterable[pd.DataFrame], channel: str, *, transient: float = 30.0, segment: float = SEGMENT
) -> MeanSpectrum:
    """Average spectrum of a channel over runs of equal length and sampling.

    Args:
        frames: channels by column, indexed by time (s).

    Raises:
        ValueError: no run, a run lacks the channel, or the runs differ in length or sampling.
    """
    spectra = []
    for frame in frames:
        if channel not in frame.columns:
            raise ValueError(f"spectrum: a run has no channel '{channel}'")
        time, values = frame.index.to_numpy(), frame[channel].to_numpy()
        spectra.append(power_spectral_density(time, values, transient=transient, segment=segment))
    if not spectra:
        raise ValueError(f"spectrum of {channel}: no finished run")
    first = spectra[0]
    for s in spectra[1:]:
        # A record's step is the mean of its own samples' distances, so it has rounding errors.
        if s.frequency.shape != first.frequency.shape or not np.allclose(s.frequency, first.frequency, rtol=1e-9):
            raise ValueError(f"spectrum of {channel}: the runs differ in length or sampling")
    density = np.mean([s.density for s in spectra], axis=0)
    return MeanSpectrum(first.frequency, density, first.segment, sum(s.segments for s in spectra), len(spectra))
