"""From a run to rows of a campaign's table, and from a campaign's folder to its table, plan and histories."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from optimisation.campaign.fatigue import EXPONENTS, damage_equivalent_load
from optimisation.evaluation import after_transient, statistics

PLAN, TABLE, RUNS = "campaign.json", "runs.parquet", "runs"
KEYS = ["case", "damper", "seed", "channel"]
# Of a row: the channel's; of a damper's displacement; of its whole run, repeated in each of its rows.
CHANNEL = ["unit", "mean", "std", "rms", "min", "max", "del"]
DAMPER = ["stroke", "stop_hits"]
RUN = ["coupling_energy_share", "wall_seconds"]
COLUMNS = [*KEYS, *CHANNEL, *DAMPER, *RUN]


@dataclass(frozen=True)
class Campaign:
    """A campaign's folder.

    Attributes:
        plan: content of campaign.json. table: of runs.parquet, see `COLUMNS`.
    """

    folder: Path
    plan: Mapping[str, Any]
    table: pd.DataFrame

    @property
    def cases(self) -> list[str]:
        """Load cases, in the order of the command."""
        return list(self.plan["cases"])

    @property
    def dampers(self) -> list[str]:
        """Damper arrangements, in the order of the command."""
        return list(self.plan["dampers"])

    def speeds(self) -> dict[str, float]:
        """Mean wind speed of each load case that has a turbulent wind, m/s."""
        return {name: c["wind_speed"] for name, c in self.plan["cases"].items() if c.get("wind_speed") is not None}

    def transient(self, case: str) -> float:
        """Time left out of a case's statistics, s."""
        return float(self.plan["cases"][case]["transient"])

    def missing(self) -> list[tuple[str, str, int, str]]:
        """Runs that are planned and not in the table: case, damper, seed, and why ("" if they never ran)."""
        planned = ((r["case"], r["damper"], int(r["seed"]), str(r.get("message", ""))) for r in self.plan["runs"])
        there = set(self.table[["case", "damper", "seed"]].itertuples(index=False, name=None))
        return [run for run in planned if run[:3] not in there]

    def run_folder(self, case: str, damper: str, seed: int) -> Path:
        """Folder of a run, as `fowt run` leaves it."""
        return self.folder / RUNS / run_name(case, damper, seed)

    def frame(self, case: str, damper: str, seed: int) -> pd.DataFrame:
        """A run's channels, indexed by time (s); `attrs["units"]` has their units.

        Raises:
            ValueError: the run is not there.
        """
        return read_frame(self.run_folder(case, damper, seed))

    def seeds(self, case: str, damper: str) -> list[int]:
        """Seeds of the finished runs of a case and arrangement."""
        rows = self.table[(self.table["case"] == case) & (self.table["damper"] == damper)]
        return sorted(int(s) for s in rows["seed"].unique())


def run_name(case: str, damper: str, seed: int) -> str:
    """Name of a run, and of its folder."""
    return f"{case}-{damper}-seed{seed}"


def read_campaign(folder: Path) -> Campaign:
    """Read a campaign's folder, a finished one or not.

    Raises:
        ValueError: it holds no campaign, or nothing of it is finished.
    """
    try:
        plan = json.loads((folder / PLAN).read_text(encoding="utf-8"))
        plan["cases"], plan["dampers"], plan["runs"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ValueError(f"{folder}: is no folder of 'fowt campaign' (no readable {PLAN})") from error
    if not (folder / TABLE).exists():
        raise ValueError(f"{folder}: no run has finished; continue with 'fowt campaign --resume {folder}'")
    return Campaign(folder, plan, read_table(folder / TABLE))


def read_table(path: Path) -> pd.DataFrame:
    """A campaign's table.

    Raises:
        ValueError: the file is missing, torn, or lacks a column.
    """
    try:
        table = pd.read_parquet(path)
    except (OSError, ValueError) as error:  # pyarrow's errors are of these kinds
        raise ValueError(f"{path}: cannot be read ({error}); run the campaign again to have it written anew") from error
    lost = [c for c in COLUMNS if c not in table.columns]
    if lost:
        raise ValueError(f"{path}: has no column '{lost[0]}'; run the campaign again to have it written anew")
    return table


def write_table(rows: Iterable[Mapping[str, Any]], path: Path) -> pd.DataFrame:
    """Write rows as a campaign's table, as a whole or not at all; returns it."""
    table = pd.DataFrame(list(rows), columns=COLUMNS)
    numbers = [c for c in COLUMNS if c not in ("case", "damper", "channel", "unit", "seed")]
    table = table.astype(dict.fromkeys(numbers, float) | {"seed": "int64"})
    partial = path.with_name(path.name + ".partial")
    table.to_parquet(partial, index=False, compression="zstd")
    os.replace(partial, path)
    return table


def table_digest(table: pd.DataFrame) -> str:
    """SHA-256 of a table less its wall times: the same for the same campaign, however often it was interrupted."""
    digest = hashlib.sha256()
    for column in table.columns.drop("wall_seconds"):
        digest.update(column.encode())
        values = table[column]
        if values.dtype == np.float64:
            digest.update(values.to_numpy().tobytes())
        else:
            digest.update("\n".join(map(str, values)).encode())
    return digest.hexdigest()


def rows_of_run(folder: Path, about: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Rows of a campaign's table from a run's folder: one for each channel.

    Args:
        about: `case`, `damper`, `seed`, `transient` (s), and `strokes`: the travel to the end stops (m) by the channel
            of a damper's displacement.

    Raises:
        ValueError: results or provenance cannot be read, or a value is not finite.
    """
    frame = read_frame(folder)
    content = json.loads((folder / "run.json").read_text(encoding="utf-8"))
    time, transient, strokes = frame.index.to_numpy(), float(about["transient"]), about["strokes"]
    units = frame.attrs["units"]
    shares = [abs(port["share"]) for port in content["ports"].values()]
    whole = {
        "coupling_energy_share": max(shares) if shares else None,
        "wall_seconds": float(content["wall_time"]),
    }
    rows = []
    for channel in frame.columns:
        row: dict[str, Any] = {k: about[k] for k in ("case", "damper", "seed")}
        try:
            t, x = after_transient(time, frame[channel].to_numpy(), transient)
        except ValueError as error:
            raise ValueError(f"{channel}: {error}") from error
        row |= {"channel": channel, "unit": units.get(channel, ""), **asdict(statistics(t, x, transient=0.0))}
        if channel in EXPONENTS:
            row["del"] = damage_equivalent_load(x, float(t[-1] - t[0]), EXPONENTS[channel])
        if channel in strokes:
            row |= {"stroke": float(np.abs(x).max()), "stop_hits": stop_hits(x, float(strokes[channel]))}
        rows.append(row | whole)
    return rows


def stop_hits(displacement: npt.ArrayLike, stroke: float) -> int:
    """How often a damper meets an end stop: displacement (m, shape (n,)) passing the stroke (m), on either side.

    A grazing contact that begins and ends between two samples is not seen.
    """
    x = np.asarray(displacement, dtype=float)
    return sum(int(beyond[0]) + int(np.sum(beyond[1:] & ~beyond[:-1])) for beyond in (x > stroke, x < -stroke))


def read_frame(folder: Path) -> pd.DataFrame:
    """A run's results.parquet, indexed by time (s); `attrs["units"]` has the channels' units.

    Raises:
        ValueError: it is missing or torn.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    path = folder / "results.parquet"
    try:
        table = pq.read_table(path)
        units = json.loads(table.schema.metadata[b"units"])
    except (OSError, pa.ArrowException, KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{path}: cannot be read ({error})") from error
    frame = table.to_pandas().set_index("Time")
    frame.attrs["units"] = units
    return frame


@cache
def evaluation_digest() -> str:
    """Digest of what `rows_of_run` follows from besides the run: this code and the libraries it counts with."""
    folder = Path(__file__).parent
    digest = hashlib.sha256("".join(version(p) for p in ("numpy", "rainflow")).encode())
    for path in (folder / "runs.py", folder / "fatigue.py", folder.parent / "evaluation.py"):
        digest.update(path.read_bytes())
    return digest.hexdigest()
