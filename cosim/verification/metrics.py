"""Quantities of a record: statistics, modes of a decay, response to a regular wave, suppression, explained variance."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline

from cosim.errors import CosimError
from cosim.verification.modes import fit_oscillations
from cosim.verification.plan import Check, Comparison
from cosim.verification.reference import Record

Array = npt.NDArray[np.float64]
PLACE = 1e-6  # s, within which a sample still counts as lying on an end of the window


def quantity_unit(check: Check, channel_unit: str) -> str:
    """Unit of a check's quantity, given that of its channel."""
    units = {
        "frequency": "Hz", "damping ratio": "", "R2": "", "amplitude": f"{channel_unit}/m", "phase": "deg",
        "suppression": "%",
    }  # fmt: skip
    return units.get(check.quantity, channel_unit)


def measure(
    check: Check,
    comparison: Comparison,
    record: Record,
    undamped: Record | None = None,
    units: Mapping[str, str] | None = None,
) -> float:
    """The quantity of one record.

    Args:
        undamped: the record that a suppression refers to.
        units: wanted units of channels.

    Raises:
        CosimError: the record lacks the channel or part of the window, or has no such mode.
    """
    wanted = (units or {}).get(check.channel)
    time, x = cut(record, check.channel, window_of(check, comparison), wanted)
    try:
        match check.quantity:
            case "mean":
                return float(x[_whole_turns(comparison, record, time)].mean())
            case "std":
                return float(x.std())
            case "frequency" | "damping ratio":
                mode = fit_oscillations(time, x, (check.near, *check.others)).modes[0]
                return mode.frequency if check.quantity == "frequency" else mode.damping_ratio
            case "amplitude" | "phase":
                response = _wave_response(check, comparison, record, time, x)
                return float(abs(response)) if check.quantity == "amplitude" else float(np.degrees(np.angle(response)))
            case "suppression":
                assert undamped is not None
                without = moving(check, comparison, undamped, wanted)[1]
                return float(100.0 * (1.0 - x.std() / without.std()))
            case _:
                raise CosimError(f"{check.quantity} is no quantity of one record")
    except ValueError as error:
        if isinstance(error, CosimError):
            raise
        raise CosimError(f"{record.where}: {check.channel} {error}; change the check's window or modes") from error


def explained_variance(
    check: Check, comparison: Comparison, reference: Record, ours: Record, unit: str | None
) -> float:
    """R2: share of the reference's variance that ours explains: 1 - sum (ours - reference)^2 over its own sum."""
    time, y = moving(check, comparison, reference, unit)
    x = CubicSpline(*cut(ours, check.channel, window_of(check, comparison), unit))(time)
    return float(1.0 - np.sum((x - y) ** 2) / np.sum((y - y.mean()) ** 2))


def moving(check: Check, comparison: Comparison, record: Record, unit: str | None = None) -> tuple[Array, Array]:
    """Times and values of the record that a check divides by.

    Raises:
        CosimError: as `cut`, or the channel does not move.
    """
    time, x = cut(record, check.channel, window_of(check, comparison), unit)
    if not np.ptp(x) > 0.0:
        raise CosimError(f"{record.where}: {check.channel} does not move; drop its {check.quantity}")
    return time, x


def window_of(check: Check, comparison: Comparison) -> tuple[float, float]:
    """Time over which a check is made, s."""
    return check.window or comparison.window


def cut(record: Record, channel: str, window: tuple[float, float], unit: str | None = None) -> tuple[Array, Array]:
    """Times and values of a channel within a window, s.

    Raises:
        CosimError: the record has no such channel, or does not cover the window.
    """
    x, time = record.values(channel, unit), record.time
    begin, end = window
    step = float(np.diff(time).max())
    if time[0] > begin + step or time[-1] < end - step:
        raise CosimError(
            f"{record.where}: covers {time[0]:g} to {time[-1]:g} s, {begin:g} to {end:g} s are to be compared;"
            " run longer, or shorten the comparison's window in the folder's verification.toml"
        )
    within = (time >= begin - PLACE) & (time <= end + PLACE)
    return time[within], x[within]


def _whole_turns(comparison: Comparison, record: Record, time: Array) -> npt.NDArray[np.bool_]:
    """Samples of the last whole revolutions in the window."""
    if comparison.whole_turns_of is None:
        return np.ones(time.size, dtype=bool)
    window = float(time[0]), float(time[-1])
    speed = cut(record, comparison.whole_turns_of, window, "rpm")[1].mean()
    turn = 60.0 / speed if speed > 0.0 else np.inf
    turns = int((time[-1] - time[0]) / turn)
    return time > time[-1] - turns * turn + PLACE if turns else np.ones(time.size, dtype=bool)


def _wave_response(check: Check, comparison: Comparison, record: Record, time: Array, x: Array) -> complex:
    """Complex amplitude per metre of wave, lead positive; free modes that have not died out are fitted along."""
    assert comparison.wave_period is not None
    forcing = (1.0 / comparison.wave_period,)
    elevation = cut(record, comparison.wave_channel, (float(time[0]), float(time[-1])), "m")[1]
    wave = fit_oscillations(time, elevation, (), forcing).forced[0]
    return fit_oscillations(time, x, check.others, forcing).forced[0] / wave
