"""What all figures share: names, colours that stay with an arrangement, numbers, thinned histories."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

# After the palette of Okabe and Ito (2008), told apart in all common forms of colour blindness; of moderate lightness,
# so that each shows on white and on black.
KNOWN_COLOURS = {"none": "#7d8590", "tmd-n": "#e08e00", "tmd-p": "#1f83c4", "mtmd": "#d0501b"}
FURTHER_COLOURS = ("#009e73", "#c46fa0", "#56b4e9", "#8c6d31", "#6f63bb")
SYMBOLS = ("circle", "square", "diamond", "triangle-up", "cross", "x", "star", "triangle-down", "hexagon")
DAMPER_NAMES = {"none": "No damper", "tmd-n": "TMD-N", "tmd-p": "TMD-P", "mtmd": "MTMD"}
CHANNEL_NAMES = {
    "TTDspFA": "Tower-top fore-aft displacement",
    "PtfmPitch": "Platform pitch",
    "PtfmSurge": "Platform surge",
    "PtfmHeave": "Platform heave",
    "TwrBsMyt": "Tower-base fore-aft moment",
    "RootMyc1": "Blade-root flapwise moment",
    "GenPwr": "Generator power",
    "Wind1VelX": "Wind speed at the hub",
    "Wave1Elev": "Wave elevation",
    "NStC1_XQ": "Nacelle damper displacement",
    "SStC1_XQ": "Platform damper displacement",
}
RESPONSES = ("TTDspFA", "TwrBsMyt", "PtfmPitch", "RootMyc1")
POWER = "GenPwr"
EXCITATIONS = ("Wind1VelX", "Wave1Elev")
SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
STROKES = {"NStC1_XQ": "nacelle_damper", "SStC1_XQ": "platform_damper"}


def colours(dampers: Sequence[str]) -> dict[str, str]:
    """A colour per arrangement: the same one whichever others are shown."""
    unknown = sorted(d for d in dampers if d not in KNOWN_COLOURS)
    further = {d: FURTHER_COLOURS[i % len(FURTHER_COLOURS)] for i, d in enumerate(unknown)}
    return {d: KNOWN_COLOURS.get(d) or further[d] for d in dampers}


def symbols(dampers: Sequence[str]) -> dict[str, str]:
    """A marker per arrangement, so that colour is not the only sign."""
    order = [*KNOWN_COLOURS, *sorted(d for d in dampers if d not in KNOWN_COLOURS)]
    return {d: SYMBOLS[order.index(d) % len(SYMBOLS)] for d in dampers}


def damper_name(damper: str) -> str:
    """An arrangement's name for readers."""
    return DAMPER_NAMES.get(damper, damper)


def case_name(case: str) -> str:
    """A load case's name for readers: LC4 for lc4."""
    return case.upper() if case.lower().startswith("lc") and case[2:].isdigit() else case


def channel_name(channel: str) -> str:
    """A channel's name for readers."""
    return CHANNEL_NAMES.get(channel, channel)


def readable_unit(unit: str) -> str:
    """A unit as it is printed: kN·m for kN.m, m/s² for m/s2; "-" for a number."""
    return unit.translate(str.maketrans(".23", "·²³")) if unit not in ("", "1") else "-"


def number(value: float, digits: int = 4) -> str:
    """A value to some significant digits; from 10,000 to a million in full, beyond as a power of ten; "–" for nan."""
    if not np.isfinite(value):
        return "–"
    text = f"{value:,.0f}" if 1e4 <= abs(value) < 1e6 else f"{value:.{digits}g}"
    if abs(value) >= 1e6 or "e" in text:
        mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
        text = f"{mantissa}·10{str(int(exponent)).translate(SUPERSCRIPTS)}"
    return text.replace("-", "−")


def percent(value: float) -> str:
    """A rate in % to a tenth."""
    return f"{round(value, 1) + 0.0:.1f}".replace("-", "−") if np.isfinite(value) else "–"  # + 0.0: no negative zero


def listed(items: Mapping[str, object] | Sequence[str]) -> str:
    """Names in a sentence: "a, b and c"."""
    names = list(items)
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}" if names else "none"


def envelope(time: Array, values: Array, buckets: int) -> tuple[Array, Array]:
    """Thin a history for display: the lowest and the highest sample of each bucket, in their order and at their times.

    Peaks keep their values and times, unlike with averaging or taking every n-th sample.

    Args:
        time, values: shape (n,).
        buckets: equal parts of the record; the result has at most twice as many samples.

    Returns:
        times and values; those given where they are as few already.
    """
    if len(time) <= 2 * buckets:
        return time, values
    size = -(-len(time) // buckets)
    padding = -len(time) % size
    padded = np.concatenate([values, np.full(padding, values[-1])]).reshape(-1, size)
    first = np.arange(len(padded)) * size
    kept = np.concatenate([first + padded.argmin(axis=1), first + padded.argmax(axis=1)])
    kept = np.unique(np.minimum(kept, len(time) - 1))
    return time[kept], values[kept]
