"""Read reference results: histories (.parquet, .csv, .outb, .out) and tables of figures."""

from __future__ import annotations

import ast
import json
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
import pyarrow.parquet as pq

from cosim.errors import CosimError, nearest
from fmus_src.units import conversion, unit

Array = npt.NDArray[np.float64]
TIME = "Time"


@dataclass(frozen=True)
class Record:
    """Histories of channels.

    Attributes:
        where: file or folder, for messages.
        time: s, shape (n,), increasing.
        channels: by OpenFAST's name, each of shape (n,).
        units: of those channels whose unit is known, as FMI writes units ("kN.m").
    """

    where: str
    time: Array
    channels: Mapping[str, Array]
    units: Mapping[str, str] = field(default_factory=dict)

    def values(self, channel: str, wanted: str | None = None) -> Array:
        """A channel's values, in the wanted unit where both units are known.

        Raises:
            CosimError: no such channel, its unit cannot be converted, or a value is not finite.
        """
        if channel not in self.channels:
            raise CosimError(f"{self.where}: no channel '{channel}'{nearest(channel, self.channels)}")
        values = self.channels[channel]
        if not np.all(np.isfinite(values)):
            at = self.time[~np.isfinite(values)][0]
            raise CosimError(f"{self.where}: {channel} at {at:g} s is not a finite number; repeat that run")
        own = self.units.get(channel)
        if not wanted or own is None or own == wanted:
            return values
        try:
            factor, offset = conversion(unit(own), unit(wanted))
        except ValueError as error:
            raise CosimError(f"{self.where}: {channel}: {error}") from error
        return factor * values + offset


def find_history(folder: Path, stem: str) -> Path | None:
    """The file of a history: `stem` may contain a folder; of several formats the first of `READERS` counts."""
    return next((p for suffix in READERS if (p := folder / f"{stem}{suffix}").is_file()), None)


def read_history(path: Path) -> Record:
    """Read a history; names and units as OpenFAST writes them, in the header or in the metadata.

    Raises:
        CosimError: the file cannot be read, or has no increasing time.
    """
    reader = READERS.get(path.suffix.lower())
    if reader is None:
        raise CosimError(f"{path}: not a history; known are {', '.join(READERS)}")
    try:
        frame, units = reader(path)
        columns = {str(c): np.asarray(frame[c], dtype=float) for c in frame.columns if _numeric(frame[c])}
    except CosimError:
        raise
    except Exception as error:  # whatever a reader meets in a damaged file
        raise CosimError(f"{path}: cannot be read ({type(error).__name__}: {' '.join(str(error).split())})") from error
    named = {_split(c): v for c, v in columns.items()}
    found = {name: values for (name, _), values in named.items()}
    known = {name: written for name, written in named if written} | {n: u for n, u in units.items() if u}
    if TIME not in found:
        raise CosimError(f"{path}: no column '{TIME}'{nearest(TIME, found)}")
    time = found.pop(TIME)
    if time.size < 2 or not np.all(np.diff(time) > 0.0):
        raise CosimError(f"{path}: times do not increase, or are fewer than two; repeat that run")
    return Record(str(path), time, found, {n: fmi_unit(u) for n, u in known.items() if n in found})


def read_row(path: Path, row: Mapping[str, Any]) -> dict[tuple[str, str], float]:
    """Figures of one row of a table whose columns are called CHANNEL_QUANTITY, by (channel, quantity).

    Args:
        row: column -> value, which together name one row.

    Raises:
        CosimError: the file cannot be read, or not just one row has these values.
    """
    try:
        table = pd.read_csv(path)
    except (OSError, ValueError) as error:
        raise CosimError(f"{path}: cannot be read ({error})") from error
    for column, value in row.items():
        if column not in table.columns:
            raise CosimError(f"{path}: no column '{column}'{nearest(column, map(str, table.columns))}")
        table = table[table[column] == value]
    if len(table) != 1:
        wanted = ", ".join(f"{c} = {v}" for c, v in row.items())
        raise CosimError(f"{path}: {len(table)} rows have {wanted}, one is needed")
    figures = {}
    for column, value in table.iloc[0].items():
        channel, _, quantity = str(column).rpartition("_")
        if channel and pd.api.types.is_number(value):
            figures[channel, quantity] = float(value)
    return figures


def fmi_unit(text: str) -> str:
    """OpenFAST's way to write a unit in FMI's: "(kN-m)" -> "kN.m", "deg/s^2" -> "deg/s2"."""
    text = text.strip().strip("()[]").strip()
    text = text.replace("sec", "s").replace("^", "").replace("-", "." if len(text) > 1 else "1")
    return text or "1"


def _split(column: str) -> tuple[str, str]:
    """Name and unit of a column such as "PtfmPitch (deg)" or "PtfmPitch_[deg]"."""
    match = re.fullmatch(r"(\w+?)[ _]*[\[(](.*)[\])]", column.strip())
    return (match[1], match[2]) if match else (column.strip(), "")


def _numeric(column: Any) -> bool:
    return bool(pd.api.types.is_numeric_dtype(column))


def _parquet(path: Path) -> tuple[pd.DataFrame, dict[str, str]]:
    frame = pd.read_parquet(path).reset_index()
    text = (pq.read_schema(path).metadata or {}).get(b"units", b"{}").decode()
    try:
        return frame, dict(json.loads(text))
    except ValueError:
        return frame, dict(ast.literal_eval(text))  # written with Python's quotes


def _csv(path: Path) -> tuple[pd.DataFrame, dict[str, str]]:
    return pd.read_csv(path), {}


def _openfast(path: Path) -> tuple[pd.DataFrame, dict[str, str]]:
    try:
        from openfast_io.FAST_output_reader import FASTOutputFile
    except ImportError as error:
        raise CosimError(f"{path}: needs openfast-io; pip install 'fowt-cosim[openfast]'") from error
    file = FASTOutputFile(str(path))
    names, units = file.info["attribute_names"], file.info["attribute_units"]
    return pd.DataFrame(file.data, columns=names), dict(zip(names, units, strict=True))


READERS: Mapping[str, Callable[[Path], tuple[pd.DataFrame, dict[str, str]]]] = {
    ".parquet": _parquet,
    ".csv": _csv,
    ".outb": _openfast,
    ".out": _openfast,
}
