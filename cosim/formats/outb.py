"""Results as OpenFAST's binary output, `.outb`, as OpenFAST itself writes it by default (OutFileFmt 2).

That is FileFmtID 4: names of any length, values as 16-bit integers over each channel's range. OpenFAST's uncompressed
variant (FileFmtID 3) cuts names to 10 characters, and weio 2.0, pyDatView and openfast_toolbox fail to open it
(github.com/OpenFAST/openfast_toolbox/issues/41).
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import BinaryIO

import numpy as np
import numpy.typing as npt

from cosim.errors import CosimError
from cosim.formats.history import History

Array = npt.NDArray[np.float64]
FORMAT_ID = 4  # FileFmtID_ChanLen_In
HALF_RANGE = 32_767  # of a 16-bit integer
LARGEST = 1e30  # far inside of what scales in single precision can tell
SHORTEST_NAME = 10  # characters, as OpenFAST's
LONGEST_NAME = 32_767  # the length is a 16-bit integer


def write_outb(history: History, path: Path) -> None:
    """Write the file, in two passes over the results: ranges first, then rows.

    A value is off by at most 1/131,000 of its channel's range, plus 2e-12 of the channel's largest magnitude.

    Raises:
        CosimError: a value is not finite or beyond 1e30, times are not equidistant, a name is too long, or the results
            are damaged.
        OSError: writing fails.
    """
    low, high, start, step = _survey(history)
    scale, offset = scaling(low, high)
    with path.open("wb") as file:
        _write_header(file, history, start, step, scale, offset)
        for block in history.blocks():
            file.write(np.rint(block[:, 1:] * scale + offset).astype("<i2").tobytes())


def scaling(low: Array, high: Array) -> tuple[Array, Array]:
    """Scale and offset of channels: integer = round(scale * value + offset), value = (integer - offset) / scale.

    Both are of single precision in the file: they are rounded here, and the rounded ones used. The offset's rounding
    moves the integers by up to 2^-24 of |value| * scale; the range is widened by more, so that none overflows.

    Args:
        low, high: smallest and largest value of each channel, shape (channels,).
    """
    largest = np.maximum(np.abs(low), np.abs(high))
    width = np.maximum(high - low + largest * 2.0**-22, 1.0 / LARGEST)
    scale = np.float32(2 * HALF_RANGE / width).astype(float)
    return scale, np.float32(-0.5 * (low + high) * scale).astype(float)


def _survey(history: History) -> tuple[Array, Array, float, float]:
    """Ranges of the channels, first time and step.

    Raises:
        CosimError: the format cannot hold the values.
    """
    count = len(history.names) - 1
    low, high = np.full(count, np.inf), np.full(count, -np.inf)
    times = []
    for block in history.blocks():
        bad = ~(np.abs(block) < LARGEST)
        if bad.any():
            row, column = np.argwhere(bad)[0]
            raise CosimError(
                f"{history.names[column]} is {block[row, column]:g} at {block[row, 0]:.10g} s, which .outb cannot"
                " hold; use csv or mat"
            )
        times.append(block[:, 0].copy())  # a view would hold the block
        low, high = np.minimum(low, block[:, 1:].min(axis=0)), np.maximum(high, block[:, 1:].max(axis=0))
    time = np.concatenate(times)
    step = float((time[-1] - time[0]) / max(1, len(time) - 1))
    uneven = np.abs(time - (time[0] + step * np.arange(len(time)))) > 1e-3 * abs(step)
    if uneven.any():
        raise CosimError(f"times are not equidistant near {time[uneven][0]:.10g} s, as .outb needs; use csv or mat")
    return low, high, float(time[0]), step


def _write_header(file: BinaryIO, history: History, start: float, step: float, scale: Array, offset: Array) -> None:
    units = [f"({unit})" for unit in history.units]
    length = max(SHORTEST_NAME, *map(len, history.names), *map(len, units))
    if length > LONGEST_NAME:
        raise CosimError(f"a name has {length} characters, .outb holds {LONGEST_NAME}; use csv or mat")
    about = _bytes(history.about or "fowt-cosim")
    file.write(struct.pack("<hhii", FORMAT_ID, length, len(scale), history.rows))
    file.write(struct.pack("<dd", start, step))
    file.write(scale.astype("<f4").tobytes() + offset.astype("<f4").tobytes())
    file.write(struct.pack("<i", len(about)) + about)
    for text in (*history.names, *units):
        file.write(_bytes(text.ljust(length)))


def _bytes(text: str) -> bytes:
    """One byte a character, as readers expect; others become "?"."""
    return text.encode("latin-1", "replace")
