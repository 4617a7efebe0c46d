"""Results as a MATLAB file, format 5: what every MATLAB since 5, Octave and SciPy read."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from cosim.errors import CosimError
from cosim.formats.history import History

LONGEST = 63  # characters of a MATLAB name
LARGEST = 2**31 - 1  # bytes of a variable in format 5
OVERHEAD = 1024  # bytes of a field's name, tags and texts, with room to spare


def write_mat(history: History, path: Path) -> None:
    """Write structures with one field per channel: `channels` (n x 1 doubles, `Time` among them), `units`,
    `descriptions`, `names` (before they were made fit for MATLAB), and the text `about`.

    The whole run is held in memory, at most 2 GB.

    Raises:
        CosimError: the results are larger than the format holds, or damaged. OSError: writing fails.
    """
    from scipy.io import savemat

    size = len(history.names) * (8 * history.rows + OVERHEAD)
    if size > LARGEST:
        raise CosimError(
            f"{size / 1e9:.1f} GB are more than a variable of MATLAB's format 5 holds (2 GB);"
            " record fewer channels, or read results.parquet with MATLAB's parquetread"
        )
    values = np.empty((len(history.names), history.rows))
    first = 0
    for block in history.blocks():
        values[:, first : first + len(block)] = block.T
        first += len(block)
    fields = matlab_names(history.names)
    content = {
        "channels": dict(zip(fields, values, strict=True)),
        "units": dict(zip(fields, history.units, strict=True)),
        "descriptions": dict(zip(fields, history.descriptions, strict=True)),
        "names": dict(zip(fields, history.names, strict=True)),
        "about": history.about,
    }
    with path.open("wb") as file:
        savemat(file, content, format="5", long_field_names=True, oned_as="column")


def matlab_names(names: Iterable[str]) -> tuple[str, ...]:
    """Names made of letters, digits and "_", of at most 63 characters, each once: "a.b[1]" -> "a_b_1"."""
    found: dict[str, None] = {}
    for name in names:
        text = re.sub(r"[^A-Za-z0-9_]+", "_", name).strip("_") or "x"
        text = text if text[0].isalpha() else f"x{text}"
        candidate, count = text[:LONGEST], 1
        while candidate in found:
            count += 1
            candidate = f"{text[: LONGEST - len(str(count)) - 1]}_{count}"
        found[candidate] = None
    return tuple(found)
