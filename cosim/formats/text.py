"""Results as comma-separated values."""

from __future__ import annotations

import csv
import io
from pathlib import Path

from pyarrow import csv as arrow_csv

from cosim.formats.history import History


def write_csv(history: History, path: Path) -> None:
    """Write one line of names with units, `Time_[s],PtfmPitch_[deg],...`, then the rows.

    The header is the one that pyDatView and the OpenFAST Python readers give to columns. Each number has the fewest
    digits that tell it from every other float64; what is no number is `nan`, `inf`, `-inf`.

    Raises:
        CosimError: the results are damaged. OSError: writing fails.
    """
    header = io.StringIO()
    columns = (f"{name}_[{unit}]" for name, unit in zip(history.names, history.units, strict=True))
    csv.writer(header, lineterminator="\n").writerow(columns)
    with path.open("wb") as file:
        file.write(header.getvalue().encode())
        for table in history.tables():
            arrow_csv.write_csv(table, file, arrow_csv.WriteOptions(include_header=False))
