"""Rows of the comparison: reference, ours, difference, tolerance, and whether it is kept."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pandas as pd

from cosim.errors import CosimError
from cosim.recording import read_results, write_json
from cosim.verification.metrics import explained_variance, measure, moving, quantity_unit
from cosim.verification.plan import Check, Comparison
from cosim.verification.reference import Record

Figures = Mapping[tuple[str, str], float]


@dataclass(frozen=True)
class Reference:
    """What a comparison is held against: a history, or figures by (channel, label).

    Attributes:
        where: file, for messages. path: of the history.
    """

    where: str
    record: Record | None = None
    figures: Figures = field(default_factory=dict)

    def has(self, check: Check) -> bool:
        """Whether it can say anything about a check."""
        known = set(self.record.channels) if self.record else {c for c, label in self.figures if label == check.label}
        return check.channel in known


@dataclass(frozen=True)
class Row:
    """One row. `difference` is relative where the tolerance is, else in `unit`; nan where there is none.

    Attributes:
        status: "pass", "FAIL", "missing" (channel not in the reference) or "no run".
        note: why ours has no such quantity, if so.
    """

    comparison: str
    channel: str
    quantity: str
    unit: str
    reference: float
    ours: float
    difference: float
    limit: str
    tolerance: float
    status: str
    note: str = ""

    @property
    def passed(self) -> bool:
        """Whether the tolerance is kept."""
        return self.status == "pass"


def read_run(folder: Path) -> Record:
    """A run of ours as a record."""
    frame = read_results(folder)
    channels = {str(c): frame[c].to_numpy(dtype=float) for c in frame.columns}
    return Record(str(folder), frame.index.to_numpy(dtype=float), channels, frame.attrs["units"])


def reference_values(
    comparison: Comparison, references: Mapping[str, Reference], units: Mapping[str, str]
) -> dict[Check, float]:
    """The reference's value of every check that it has the channel of (nan of R2, which needs both histories).

    Raises:
        CosimError: a history does not cover the window, or has no such mode.
    """
    reference = references[comparison.name]
    values: dict[Check, float] = {}
    for check in comparison.checks:
        if not reference.has(check):
            continue
        if reference.record is None:
            values[check] = reference.figures[check.channel, check.label]
        elif check.quantity == "R2":
            moving(check, comparison, reference.record)  # or says why there is no R2
            values[check] = math.nan
        else:
            undamped = references.get(comparison.undamped or "")
            if check.quantity == "suppression" and (undamped is None or undamped.record is None):
                raise CosimError(
                    f"{reference.where}: suppression needs '{comparison.undamped}' in the same folder; add it"
                )
            values[check] = measure(check, comparison, reference.record, undamped.record if undamped else None, units)
    return values


def rows_of(
    comparison: Comparison,
    reference: Reference,
    values: Mapping[Check, float],
    run: Record | None,
    undamped: Record | None,
    units: Mapping[str, str],
) -> list[Row]:
    """The rows of one comparison.

    Args:
        values: from `reference_values`.
        run: ours, None if it broke off; undamped: ours without damper, for suppression.
        units: of our channels.
    """
    rows = []
    for check in comparison.checks:
        wanted, ours, status, note = values.get(check, math.nan), math.nan, "missing", ""
        if check in values:
            needs_undamped = check.quantity == "suppression" and undamped is None
            status = "no run" if run is None or needs_undamped else ""
        if run is not None and not status:
            try:
                ours = _ours(check, comparison, reference, run, undamped, units)
            except CosimError as error:  # such as no oscillation where the reference has one
                note = str(error)
        difference = _difference(check, wanted, ours)
        kept = ours >= check.tolerance if check.limit == "at_least" else abs(difference) <= check.tolerance
        rows.append(Row(
            comparison.name, check.channel, check.label, quantity_unit(check, units.get(check.channel, "")),
            wanted, ours, difference, check.limit, check.tolerance, status or ("pass" if kept else "FAIL"), note,
        ))  # fmt: skip
    return rows


def _ours(
    check: Check,
    comparison: Comparison,
    reference: Reference,
    run: Record,
    undamped: Record | None,
    units: Mapping[str, str],
) -> float:
    if check.quantity != "R2":
        return measure(check, comparison, run, undamped, units)
    assert reference.record is not None
    return explained_variance(check, comparison, reference.record, run, units.get(check.channel))


def _difference(check: Check, reference: float, ours: float) -> float:
    if check.limit == "at_least":
        return math.nan
    difference = ours - reference
    if check.quantity == "phase":
        difference = (difference + 180.0) % 360.0 - 180.0
    if check.limit == "relative":
        return difference / abs(reference) if reference else math.copysign(math.inf, difference) if difference else 0.0
    return difference


def write_table(rows: list[Row], folder: Path, about: Mapping[str, Any]) -> list[Path]:
    """Write verification.csv and verification.json."""
    records = [{**{k: getattr(row, k) for k in Row.__dataclass_fields__}} for row in rows]
    pd.DataFrame(records).to_csv(folder / "verification.csv", index=False)
    plain = [{k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in r.items()} for r in records]
    write_json(folder / "verification.json", {**about, "rows": plain})
    return [folder / "verification.csv", folder / "verification.json"]
