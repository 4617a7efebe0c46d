"""What a run leaves behind: channels streamed to Parquet, statistics, provenance."""

from __future__ import annotations

import importlib.metadata
import json
import math
import platform
import shutil
import sys
import time
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from cosim.checks import CheckedSystem
from cosim.errors import CosimError, nearest
from cosim.fmu import VARYING, FmuVariable, elements
from cosim.system import Mapped, split_name
from fmus_src.units import conversion
from fmus_src.units import unit as named_unit

Array = npt.NDArray[np.float64]
RESULTS = "results.parquet"
PARTS = "results.parts"
PART_BYTES = 2_000_000
PART_SECONDS = 5.0


@dataclass(frozen=True)
class Channel:
    """A named quantity to record: `variable` is component.variable; `unit` None is the FMU's own."""

    name: str
    variable: str
    unit: str | None = None
    description: str = ""


@dataclass(frozen=True)
class SelectedChannel:
    """A channel of a given system: recorded value = factor * FMU value + offset."""

    name: str
    component: int
    variable: FmuVariable
    unit: str
    description: str
    factor: float = 1.0
    offset: float = 0.0


def read_channels(file: Path) -> tuple[Channel, ...]:
    """Channels from a TOML file with a table per channel: `variable`, and optionally `unit` and `description`.

    Raises:
        CosimError: the file is missing or malformed.
    """
    try:
        tables = tomllib.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise CosimError(f"{file}: cannot be read ({error})") from error
    channels = []
    for name, table in tables.items():
        if not isinstance(table, dict) or not isinstance(table.get("variable"), str):
            raise CosimError(f'{file}: channel [{name}] needs variable = "component.variable"')
        unknown = set(table) - {"variable", "unit", "description"}
        if unknown:
            raise CosimError(f"{file}: channel [{name}] has an unknown key '{min(unknown)}'")
        channels.append(Channel(name, **table))
    return tuple(channels)


def select_channels(
    system: CheckedSystem, channels: Sequence[Channel], patterns: Sequence[str] = ()
) -> tuple[tuple[SelectedChannel, ...], tuple[str, ...]]:
    """Channels that the system has, and variables that match a pattern, under their full names.

    Channels of components that the system lacks are left out; those of variables that an FMU lacks, too, with a
    warning. A pattern may be the name of an array. In patterns, * and ? are wild; they find what varies (parameters by
    their full name only).

    Raises:
        CosimError: a pattern matches nothing, or a unit cannot be converted.
    """
    known = set(system.names)
    selected, warnings = [], []
    for channel in channels:
        if not any(channel.variable.startswith(f"{c}.") for c in known):
            continue
        owner, name = split_name(channel.variable, known)
        k = system.names.index(owner)
        mapped = system.mapped[k].get(name) if system.mapped else None
        name = mapped.name if mapped else name
        if name not in system.fmus[k].variables:
            hint = nearest(name, system.fmus[k].variables)
            warnings.append(f"channel {channel.name}: not recorded, {owner} has no variable '{name}'{hint}")
            continue
        selected.append(_convert(channel, k, system.fmus[k].variables[name], mapped))
    full = {f"{n}.{v.name}": (k, v) for k, n in enumerate(system.names) for v in system.fmus[k].variables.values()}
    raw: dict[str, tuple[int, FmuVariable]] = {}
    for pattern in patterns:
        named = [pattern] if pattern in full else elements(full, pattern)
        found = {n: full[n] for n in named} or {
            n: kv for n, kv in full.items()
            if fnmatchcase(n, pattern.replace("[", "[[]")) and kv[1].variability in VARYING and kv[1].type != "String"
            and ("der(" in pattern or not kv[1].name.startswith("der("))  # which are for solvers
        }  # fmt: skip
        if not found or next(iter(found.values()))[1].type == "String":
            raise CosimError(f"record '{pattern}': matches no variable that can be recorded{nearest(pattern, full)}")
        raw |= found
    selected += [_convert(Channel(n, n, None, v.description), k, v) for n, (k, v) in raw.items()]
    if not selected:
        raise CosimError("nothing to record: name variables, such as record '*'")
    return tuple(selected), tuple(warnings)


def _convert(channel: Channel, component: int, variable: FmuVariable, mapped: Mapped | None = None) -> SelectedChannel:
    """Recorded value = factor * FMU value + offset; `mapped` says how the FMU's value follows from the system's."""
    description = channel.description or variable.description
    if variable.type == "String":
        raise CosimError(f"channel {channel.name}: {channel.variable} is text and cannot be recorded")
    back = (1.0 / mapped.factor, -mapped.offset / mapped.factor) if mapped and mapped.factor else (1.0, 0.0)
    own = variable.unit or (mapped.unit if mapped else None)
    if channel.unit is None or own is None:
        unit = channel.unit or (own.name if own else "1")
        return SelectedChannel(channel.name, component, variable, unit, description, *back)
    try:
        factor, offset = conversion(own, named_unit(channel.unit))
    except ValueError as error:
        raise CosimError(f"channel {channel.name}: {channel.variable}: {error}") from error
    factors = factor * back[0], factor * back[1] + offset
    return SelectedChannel(channel.name, component, variable, channel.unit, description, *factors)


class Recorder:
    """Streams rows to disk and keeps running statistics; memory does not grow with time.

    Rows go to part files, each complete in itself, that become `results.parquet` at the end: so a full disk or a
    killed process costs no more than the last part, and `read_results` reads what is there.
    """

    def __init__(self, folder: Path, channels: Sequence[SelectedChannel], statistics_from: float) -> None:
        self.channels = channels
        fields = [_field("Time", "s", "simulated time")] + [_field(c.name, c.unit, c.description) for c in channels]
        units = {"Time": "s"} | {c.name: c.unit for c in channels}
        self._schema = pa.schema(fields, metadata={"units": json.dumps(units)})
        self._folder, self._parts = folder, folder / PARTS
        self._parts.mkdir()
        self._written: list[Path] = []
        self._flushed = time.monotonic()
        self._pending: list[Array] = []
        self._pending_bytes = 0
        self._from = statistics_from - 1e-9 * max(1.0, abs(statistics_from))
        self._count = 0
        self._mean, self._squares = np.zeros(len(channels)), np.zeros(len(channels))
        self._min, self._max = np.full(len(channels), math.inf), np.full(len(channels), -math.inf)
        self.last: Array = np.full(1 + len(channels), math.nan)

    def add(self, rows: Array) -> None:
        """Add rows, shape (rows, 1 + channels): time, channels.

        Raises:
            OSError: the disk is full.
        """
        if not len(rows):
            return
        self.last = rows[-1]
        self._count_in(rows[rows[:, 0] >= self._from, 1:])
        self._pending.append(rows)
        self._pending_bytes += rows.nbytes
        if self._pending_bytes >= PART_BYTES or time.monotonic() - self._flushed > PART_SECONDS:
            self._flush()

    def close(self) -> None:
        """Write what is pending and join the parts.

        Raises:
            OSError: the disk is full; the parts stay.
        """
        self._flush()
        joined = self._folder / RESULTS
        scratch = joined.with_suffix(".part")
        try:
            with pq.ParquetWriter(scratch, self._schema, compression="zstd") as writer:
                for part in self._written:
                    writer.write_table(pq.read_table(part))
            scratch.replace(joined)
        finally:
            scratch.unlink(missing_ok=True)
        shutil.rmtree(self._parts)

    def summary(self) -> dict[str, dict[str, Any]]:
        """Statistics after the transient: {channel: {unit, mean, std, rms, min, max}}; std as of a population."""
        if not self._count:
            return {}
        variance = self._squares / self._count
        rms = np.sqrt(variance + self._mean**2)
        columns = zip(self._mean, np.sqrt(variance), rms, self._min, self._max, strict=True)
        return {
            c.name: {"unit": c.unit} | dict(zip(("mean", "std", "rms", "min", "max"), map(float, v), strict=True))
            for c, v in zip(self.channels, columns, strict=True)
        }

    def _count_in(self, rows: Array) -> None:
        """Merge a block into mean and sum of squared deviations (Chan, Golub and LeVeque, 1983)."""
        n = len(rows)
        if not n:
            return
        mean = rows.mean(axis=0)
        delta, total = mean - self._mean, self._count + n
        self._squares += ((rows - mean) ** 2).sum(axis=0) + delta**2 * (self._count * n / total)
        self._mean += delta * (n / total)
        self._count = total
        self._min = np.minimum(self._min, rows.min(axis=0))
        self._max = np.maximum(self._max, rows.max(axis=0))

    def _flush(self) -> None:
        if self._pending:
            rows = np.concatenate(self._pending)
            self._pending, self._pending_bytes = [], 0
            columns = [pa.array(np.ascontiguousarray(column)) for column in rows.T]
            part = self._parts / f"{len(self._written):06d}.parquet"
            scratch = part.with_suffix(".torn")
            try:
                pq.write_table(pa.Table.from_arrays(columns, schema=self._schema), scratch, compression="zstd")
                scratch.replace(part)
            finally:
                scratch.unlink(missing_ok=True)  # a full disk has room again to say so
            self._written.append(part)
        self._flushed = time.monotonic()


def _field(name: str, unit: str, description: str) -> Any:
    return pa.field(name, pa.float64(), metadata={"unit": unit, "description": description})


def result_files(folder: Path) -> list[Path]:
    """The Parquet files that hold a run's results, in the order of time: one, or a broken-off run's parts."""
    joined, parts = folder / RESULTS, sorted((folder / PARTS).glob("*.parquet"))
    return [joined] if joined.exists() or not parts else parts


def read_results(folder: Path) -> pd.DataFrame:
    """A run's channels, indexed by time (s); `attrs["units"]` has their units. Reads a broken-off run's parts too.

    Raises:
        CosimError: the folder holds no readable results.
    """
    try:
        table = pa.concat_tables([pq.read_table(path) for path in result_files(folder)])
    except (OSError, pa.ArrowException) as error:
        raise CosimError(f"{folder}: no readable {RESULTS} ({error})") from error
    frame = table.to_pandas().set_index("Time")
    frame.attrs["units"] = json.loads(table.schema.metadata[b"units"])
    return frame


def write_json(file: Path, content: Any) -> None:
    """Write JSON so that the file is either the old or the new one, never half of it."""
    scratch = file.with_suffix(".part")
    scratch.write_text(json.dumps(content, indent=1, allow_nan=True) + "\n", encoding="utf-8")
    scratch.replace(file)


def new_folder(folder: Path) -> Path:
    """Create a results folder; one that exists must be empty.

    Raises:
        CosimError: it has content, or cannot be written to.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        taken = any(folder.iterdir())
        (folder / ".writable").touch()
        (folder / ".writable").unlink()
    except OSError as error:
        raise CosimError(f"results folder {folder}: {error.strerror}; choose another") from error
    if taken:
        raise CosimError(f"results folder {folder}: is not empty; choose a new one (nothing is overwritten)")
    return folder


def versions() -> dict[str, str]:
    """Versions of what a run depends on."""
    found = {"python": sys.version.split()[0], "platform": platform.platform()}
    for package in ("fowt-cosim", "fmpy", "numpy", "pyarrow"):
        try:
            found[package] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            found[package] = "not installed"
    return found
