"""Damage-equivalent loads: rainflow cycles (ASTM E1049-85), Palmgren-Miner, one Woehler exponent, no mean correction.

DEL = (sum n_i S_i^m / (f T))^(1/m): the range that, repeated at f = 1 Hz for the record's length T, does the same
damage as its cycles (IEC 61400-13). Residual half cycles count as halves.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import pairwise

import numpy as np
import numpy.typing as npt
import pandas as pd

# Woehler exponents: welded steel for the tower, glass-fibre composite for the blade.
EXPONENTS: Mapping[str, float] = {"TwrBsMyt": 4.0, "RootMyc1": 10.0}
EQUIVALENT_FREQUENCY = 1.0  # Hz


def damage_equivalent_load(
    values: npt.ArrayLike, duration: float, exponent: float, frequency: float = EQUIVALENT_FREQUENCY
) -> float:
    """Damage-equivalent range of a record, in its unit.

    Args:
        values: samples, shape (n,). duration: that they span, s.
        exponent: of the S-N curve. frequency: of the equivalent cycles, Hz.

    Raises:
        ValueError: duration, exponent or frequency is not positive, or a value is not finite.
    """
    import rainflow

    x = np.asarray(values, dtype=float)
    if not (duration > 0.0 and exponent > 0.0 and frequency > 0.0):
        raise ValueError(
            f"damage-equivalent load: duration {duration:g} s, exponent {exponent:g} and frequency {frequency:g} Hz"
            " must be positive"
        )
    if not np.all(np.isfinite(x)):
        raise ValueError("damage-equivalent load: a value is not finite")
    cycles = np.array([(c[0], c[2]) for c in rainflow.extract_cycles(x)], dtype=float).reshape(-1, 2)
    if not len(cycles):
        return 0.0
    largest = float(cycles[:, 0].max())
    if largest == 0.0:
        return 0.0
    damage = float(np.sum(cycles[:, 1] * (cycles[:, 0] / largest) ** exponent))  # scaled: S^10 of N m overflows nothing
    return float(largest * (damage / (frequency * duration)) ** (1.0 / exponent))


def wind_bins(
    speeds: Mapping[str, float],
    *,
    mean_speed: float = 10.0,
    shape: float = 2.0,
    cut_in: float = 3.0,
    cut_out: float = 25.0,
) -> pd.DataFrame:
    """Share of the operating time that each load case stands for: that of the wind speeds nearest its own.

    Weibull distribution of the ten-minute mean at hub height; shape 2 is Rayleigh's, and with a yearly mean of 10 m/s
    it is that of IEC 61400-1 class I, for which the NREL 5-MW turbine was made. Bins part halfway between neighbouring
    cases; the first begins at cut-in, the last ends at cut-out. Standstill and idling are left out.

    Args:
        speeds: mean wind speed of each load case, m/s.

    Returns:
        a row per case in order of speed: `case`, `speed`, `low`, `high` (m/s), `weight` (sums to 1).
        `attrs["operating"]` is the share of all time between cut-in and cut-out.

    Raises:
        ValueError: no case, two of the same speed, or one outside cut-in and cut-out.
    """
    order = sorted(speeds, key=lambda case: speeds[case])
    if not order:
        raise ValueError("wind bins: no load case has a wind speed")
    values = [speeds[case] for case in order]
    for case, speed in zip(order, values, strict=True):
        if not cut_in <= speed <= cut_out:
            raise ValueError(
                f"wind bins: {case} at {speed:g} m/s is outside {cut_in:g} to {cut_out:g} m/s; leave it out"
            )
    for first, second in pairwise(order):
        if speeds[first] == speeds[second]:
            raise ValueError(f"wind bins: {first} and {second} both stand for {speeds[first]:g} m/s; leave one out")
    edges = [cut_in, *((a + b) / 2.0 for a, b in pairwise(values)), cut_out]
    scale = mean_speed / math.gamma(1.0 + 1.0 / shape)
    below = 1.0 - np.exp(-((np.array(edges) / scale) ** shape))
    operating = float(below[-1] - below[0])
    table = pd.DataFrame(
        {"case": order, "speed": values, "low": edges[:-1], "high": edges[1:], "weight": np.diff(below) / operating}
    )
    table.attrs["operating"] = operating
    return table


def combined(loads: npt.ArrayLike, weights: npt.ArrayLike, exponent: float) -> float:
    """Damage-equivalent load of several conditions: their damages weighted by shares of time (which sum to 1)."""
    x, w = np.asarray(loads, dtype=float), np.asarray(weights, dtype=float)
    largest = float(x.max())
    return float(largest * np.sum(w * (x / largest) ** exponent) ** (1.0 / exponent)) if largest > 0.0 else 0.0
