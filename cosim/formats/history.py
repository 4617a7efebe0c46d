"""A run's results as other formats want them: names, units as OpenFAST writes them, rows in batches."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.parquet as pq

from cosim.errors import CosimError
from cosim.recording import result_files

BATCH = 16_384  # rows


@dataclass(frozen=True)
class History:
    """Channels over time, still on disk.

    Attributes:
        files: Parquet files, in the order of time.
        names: of the columns; the first is "Time".
        units: of each column, as OpenFAST writes them ("kN-m", "-").
        descriptions: of each column, or "".
        rows: number of rows, at least 1.
        about: what run.json says of the run, in one line, or "".
    """

    files: tuple[Path, ...]
    names: tuple[str, ...]
    units: tuple[str, ...]
    descriptions: tuple[str, ...]
    rows: int
    about: str

    def tables(self) -> Iterator[Any]:
        """The rows as `pyarrow.RecordBatch`es of at most `BATCH` rows: memory does not grow with the run.

        Raises:
            CosimError: a file is damaged.
        """
        for path in self.files:
            try:
                with pq.ParquetFile(path, pre_buffer=False) as file:  # a buffer would hold the whole file
                    yield from (b.select(self.names) for b in file.iter_batches(BATCH, columns=list(self.names)))
            except (OSError, pa.ArrowException) as error:
                raise CosimError(f"{path.name} cannot be read ({_line(error)}); repeat the run") from error

    def blocks(self) -> Iterator[npt.NDArray[np.float64]]:
        """The rows as arrays of shape (rows of the batch, columns)."""
        for table in self.tables():
            yield np.column_stack([column.to_numpy(zero_copy_only=False) for column in table.columns])


def open_history(folder: Path) -> History:
    """The results in a run's folder; of a broken-off run, what was kept.

    Raises:
        CosimError: no such folder, no readable results in it, or no rows.
    """
    if not folder.is_dir():
        raise CosimError(f"{folder}: no such folder; give that of a run")
    try:
        files = result_files(folder)
        schema = pq.read_schema(files[0])
        rows = sum(pq.read_metadata(path).num_rows for path in files)
        units = json.loads(schema.metadata[b"units"])
    except (OSError, pa.ArrowException, KeyError, TypeError, ValueError) as error:
        raise CosimError(
            f"{folder}: no readable results ({_line(error)}); repeat the run, or give the folder of another"
        ) from error
    if "Time" not in schema.names:
        raise CosimError(f"{folder}: its results have no column 'Time'; give the folder of a run")
    if not rows:
        raise CosimError(f"{folder}: its results have no rows; the run broke off before its first")
    names = ("Time", *(n for n in schema.names if n != "Time"))
    fields = [(schema.field(n).metadata or {}).get(b"description", b"").decode() for n in names]
    return History(
        tuple(files), names, tuple(openfast_unit(str(units.get(n, ""))) for n in names), tuple(fields), rows,
        _about(folder),
    )  # fmt: skip


def openfast_unit(text: str) -> str:
    """FMI's way to write a unit in OpenFAST's: "kN.m" -> "kN-m", "deg/s2" -> "deg/s^2", "1" -> "-"."""
    powers = re.sub(r"(?<=[A-Za-z)])(-?\d+)", r"^\1", text.strip())
    return powers.replace(".", "-") if text.strip() not in ("", "1") else "-"


def _about(folder: Path) -> str:
    """System, case, damper and seed, and the version that computed them, as far as run.json tells."""
    try:
        record = json.loads((folder / "run.json").read_text(encoding="utf-8"))
        about = {k: v for k, v in record["settings"]["about"].items() if k != "key"}
        said = [f"system {record['system']}", *(f"{k} {v}" for k, v in about.items()), record["status"]]
        return " ".join(f"fowt-cosim {record['versions']['fowt-cosim']}: {', '.join(said)}".split())
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return ""


def _line(error: BaseException) -> str:
    return " ".join(f"{type(error).__name__}: {error}".split())
