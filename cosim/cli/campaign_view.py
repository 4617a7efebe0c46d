"""What `fowt campaign` shows: its progress, and its tables at the end."""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from cosim.campaign.store import Outcome, Task, under_way
from cosim.cli.console import err, number, out, warn

if TYPE_CHECKING:
    import pandas as pd

    from optimisation.campaign.runs import Campaign


class Progress:
    """A live table: runs done, running, failed and left of each case, and the time left."""

    def __init__(self, tasks: Sequence[Task], outcomes: Mapping[str, Outcome], root: Path, quiet: bool) -> None:
        self._case = {task.label: str(task.about["case"]) for task in tasks}
        self._outcomes = dict(outcomes)
        self._root = root
        self._before, self._began = len(outcomes), time.monotonic()
        self._live = None if quiet or not err.is_terminal else Live(
            get_renderable=self._render, console=err, refresh_per_second=2, transient=True
        )  # fmt: skip

    def __enter__(self) -> Progress:
        if self._live:
            self._live.start()
        return self

    def __exit__(self, *details: object) -> None:
        if self._live:
            self._live.stop()

    def done(self, outcome: Outcome) -> None:
        """Count a run that has come to its end."""
        self._outcomes[outcome.label] = outcome

    def _render(self) -> Group:
        outcomes = dict(self._outcomes)
        running = Counter(self._case[n] for n in under_way(self._root) if n in self._case and n not in outcomes)
        failed = Counter(self._case[n] for n, o in outcomes.items() if o.error)
        done = Counter(self._case[n] for n, o in outcomes.items() if not o.error)
        planned = Counter(self._case.values())
        table = Table("case", box=None, pad_edge=False)
        for column in ("done", "running", "failed", "to do"):
            table.add_column(column, justify="right")
        for case, total in planned.items():
            left = total - done[case] - failed[case] - running[case]
            table.add_row(
                case, str(done[case]), str(running[case]), Text(str(failed[case]), style="red" if failed[case] else ""),
                str(left),
            )  # fmt: skip
        return Group(table, Text(f"{len(outcomes)} of {len(self._case)} runs{self._time_left(len(outcomes))}"))

    def _time_left(self, ended: int) -> str:
        new, taken = ended - self._before, time.monotonic() - self._began
        if not new:
            return ""
        left = taken / new * (len(self._case) - ended)
        return f", {left:.0f} s left" if left < 100.0 else f", {left / 60.0:.0f} min left"


def evaluate_all(campaign: Campaign) -> dict[str, pd.DataFrame]:
    """Every table of a campaign, by the name of its file."""
    import pandas as pd

    from optimisation.campaign import tables
    from optimisation.campaign.paper import beside_paper

    table = campaign.table
    power = [tables.levels(table, s, ["GenPwr"]).assign(statistic=s) for s in ("mean", "rms", "std")]
    found = {
        "suppression": tables.suppression(table),
        "ranking": tables.ranking(table),
        "extremes": tables.extremes(table),
        "dampers": tables.damper_travel(table),
        "power": pd.concat(power, ignore_index=True),
        "paper": beside_paper(table),
    }
    found["fatigue"], why_not = tables.fatigue_and_why(table, campaign.speeds())
    if why_not:
        warn(f"{why_not}: no loads over a lifetime")
    return found


def show(campaign: Campaign, tables: Mapping[str, pd.DataFrame]) -> None:
    """Print a campaign's tables: suppression, order of the arrangements, fatigue, stops, and the paper beside."""
    rates = tables["suppression"]
    if len(rates):
        out.print("suppression of standard deviations, %")
        out.print(_wide(rates, "rate"))
    else:
        out.print("no suppression rates: they need runs of 'none' and of another arrangement in the same case and seed")
    if len(tables["ranking"]):
        out.print("is the first better than the second, and how sure that is")
        out.print(_ranking(tables["ranking"]))
    fatigue = tables["fatigue"]
    if len(fatigue) and fatigue["reduction"].notna().any():
        out.print("reduction of damage-equivalent loads, %")
        out.print(_wide(fatigue[fatigue["reduction"].notna()], "reduction"))
    if len(tables["dampers"]):
        out.print("damper travel")
        out.print(_travel(tables["dampers"]))
    if len(tables["paper"]):
        out.print("beside the paper")
        out.print(_paper(tables["paper"]))
    if len(rates) and rates["seeds"].max() > 1:
        out.print("± : half of the 95 % confidence interval (Student's t over seeds, paired)", soft_wrap=True)
    out.print(f"{campaign.folder}: runs.parquet, {', '.join(f'{n}.csv' for n in tables)}", soft_wrap=True)


def _table(*names: str) -> Table:
    """A table whose first columns name a row: in a narrow terminal figures are folded, names never cut."""
    view = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    for name in names:
        view.add_column(name, no_wrap=True)
    return view


def _wide(table: pd.DataFrame, value: str) -> Table:
    """A row for each case and arrangement, a column for each channel."""
    channels = list(dict.fromkeys(table["channel"]))
    view = _table("case", "damper")
    for channel in channels:
        view.add_column(channel, justify="right")
    before = ""
    for (case, damper), part in table.groupby(["case", "damper"], sort=False):
        found = part.set_index("channel")
        cells = [_with_half(found.loc[c, value], found.loc[c, "half"]) if c in found.index else "" for c in channels]
        view.add_row(case if case != before else "", damper, *cells)
        before = case
    return view


def _ranking(table: pd.DataFrame) -> Table:
    """Whether each arrangement is better than the next, with the confidence that it is."""
    cases = list(dict.fromkeys(table["case"]))
    view = _table("order", "channel")
    for case in cases:
        view.add_column(case)
    before: Any = ""
    for (better, worse, channel), part in table.groupby(["better", "worse", "channel"], sort=False):
        found = part.set_index("case")
        cells = [_verdict(found.loc[c]) if c in found.index else "" for c in cases]
        pair = f"{better} > {worse}"
        view.add_row(pair if pair != before else "", channel, *cells)
        before = pair
    return view


def _verdict(row: pd.Series) -> str:
    if math.isnan(row["probability"]):
        return f"{row['difference']:+.1f}"
    return f"{row['verdict']} ({100.0 * row['probability']:.0f} %)"


def _travel(table: pd.DataFrame) -> Table:
    view = _table("case", "damper", "channel")
    for column in ("mean, m", "largest, m", "stop hits", "most"):
        view.add_column(column, justify="right")
    for row in table.itertuples():
        view.add_row(
            row.case, row.damper, row.channel, f"{row.stroke:.2f}", f"{row.largest:.2f}", f"{row.stop_hits:.1f}",
            f"{row.most_hits:.0f}",
        )  # fmt: skip
    return view


def _paper(table: pd.DataFrame) -> Table:
    view = _table("case", "damper", "channel", "")
    for column in ("paper", "ours"):
        view.add_column(column, justify="right", no_wrap=True)
    for row in table.itertuples():
        what = "suppression" if row.quantity == "suppression" else "RMS"
        says = "" if row.says == "about" else f"{row.says} "
        view.add_row(
            row.case, row.damper, row.channel, what, f"{says}{number(row.paper)} {row.unit}",
            _with_half(row.ours, row.half),
        )  # fmt: skip
    return view


def _with_half(value: float, half: float) -> str:
    return f"{value:.1f}" if math.isnan(half) else f"{value:.1f} ± {half:.1f}"
