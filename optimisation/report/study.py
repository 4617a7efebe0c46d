"""What a report is made from: a campaign's tables, histories, spectra and provenance, gathered once."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from optimisation.campaign.paper import LARGEST, beside_paper
from optimisation.campaign.runs import Campaign
from optimisation.campaign.spectra import MeanSpectrum, mean_spectrum
from optimisation.campaign.tables import (
    REFERENCE,
    damper_travel,
    extremes,
    fatigue_and_why,
    levels,
    ranking,
    suppression,
)
from optimisation.report.style import EXCITATIONS, POWER, RESPONSES, STROKES

Array = npt.NDArray[np.float64]
MOTIONS = ("PtfmSurge", "PtfmHeave")
SHOWN = tuple(dict.fromkeys((*EXCITATIONS, *RESPONSES, POWER, *MOTIONS, *STROKES)))


@dataclass(frozen=True)
class Run:
    """One run that was asked for.

    Attributes:
        status: "done", "failed", "missing" (it never ran) or "unreadable".
        message: why there is no result, else "".
        record: its run.json, empty where there is none.
    """

    case: str
    damper: str
    seed: int
    status: str
    message: str = ""
    record: Mapping[str, Any] = field(default_factory=dict, repr=False)

    @property
    def name(self) -> str:
        """Case, arrangement and seed."""
        return f"{self.case}-{self.damper}-seed{self.seed}"


@dataclass(frozen=True)
class WindField:
    """The wind along its mean direction on the vertical line through the hub.

    Attributes:
        time: s, shape (n,); height: above mean sea level, m, shape (m,); speed: m/s, shape (m, n).
    """

    case: str
    seed: int
    time: Array
    height: Array
    speed: Array


@dataclass(frozen=True)
class Study:
    """A campaign, read and evaluated.

    Attributes:
        plan: content of campaign.json. cases, dampers: in the order of the command.
        units: of each channel.
        rates, order, power, extreme, fatigue, travel, paper: tables of `optimisation.campaign` for the channels shown.
        spectra: by case and channel, then by arrangement: averaged over seeds.
        histories: by case and arrangement, channels by time, of the seed `history_seeds[case]`.
        wind: of one case, or None where its file is gone.
        graph: connections, see `optimisation.report.diagram`. variable_units: by component.variable, where known.
    """

    name: str
    plan: Mapping[str, Any]
    cases: tuple[str, ...]
    dampers: tuple[str, ...]
    units: Mapping[str, str]
    runs: tuple[Run, ...]
    table: pd.DataFrame
    rates: pd.DataFrame
    order: pd.DataFrame
    power: pd.DataFrame
    extreme: pd.DataFrame
    fatigue: pd.DataFrame
    travel: pd.DataFrame
    paper: pd.DataFrame
    spectra: Mapping[tuple[str, str], Mapping[str, MeanSpectrum]]
    histories: Mapping[tuple[str, str], pd.DataFrame]
    history_seeds: Mapping[str, int]
    graph: pd.DataFrame | None = None
    variable_units: Mapping[str, str] = field(default_factory=dict)
    wind: WindField | None = None

    @property
    def reference(self) -> str:
        """The arrangement without dampers."""
        return REFERENCE

    @property
    def damped(self) -> tuple[str, ...]:
        """Arrangements with dampers."""
        return tuple(d for d in self.dampers if d != REFERENCE)

    @property
    def seeds(self) -> tuple[int, ...]:
        """Seeds of the runs asked for."""
        return tuple(sorted({r.seed for r in self.runs}))

    def text(self, case: str) -> str:
        """Description of a case."""
        return str(self.plan["cases"][case].get("description", ""))

    def transient(self, case: str) -> float:
        """Time left out of a case's statistics, s."""
        return float(self.plan["cases"][case]["transient"])

    def rate(self, case: str, damper: str, channel: str) -> pd.Series | None:
        """Row of `rates`, or None."""
        t = self.rates
        found = t[(t["case"] == case) & (t["damper"] == damper) & (t["channel"] == channel)]
        return found.iloc[0] if len(found) else None

    def lacking(self) -> tuple[Run, ...]:
        """Runs without a result."""
        return tuple(r for r in self.runs if r.status != "done")

    def marks(self, channel: str, quantity: str) -> pd.DataFrame:
        """What the paper's text gives of a channel for single cases that were run: rows of `paper`."""
        t = self.paper
        return t[(t["channel"] == channel) & (t["quantity"] == quantity) & (t["case"] != LARGEST)]

    def limits(self) -> dict[str, float]:
        """Distance to the end stops by the channel of a damper's displacement, m, where all runs agree on it."""
        found: dict[str, set[float]] = {}
        for run in self.runs:
            for channel, component in STROKES.items():
                start = run.record.get("components", {}).get(component, {}).get("start", {})
                if "stroke" in start:
                    found.setdefault(channel, set()).add(float(start["stroke"]))
        return {channel: values.pop() for channel, values in found.items() if len(values) == 1}


def read_study(campaign: Campaign) -> Study:
    """Evaluate a campaign; runs that are missing or cannot be read are left out and listed.

    Raises:
        ValueError: no finished run can be read.
    """
    lacking = {run[:3]: run[3] for run in campaign.missing()}
    runs, histories, spectra, unreadable = _read_runs(campaign, lacking)
    table = campaign.table
    for case, damper, seed in unreadable:
        table = table[~((table["case"] == case) & (table["damper"] == damper) & (table["seed"] == seed))]
    if table.empty:
        raise ValueError(f"{campaign.folder}: no run of this campaign can be read; run it again")
    channels = (*RESPONSES, POWER)
    return Study(
        name=campaign.folder.resolve().name,
        plan=campaign.plan,
        cases=tuple(campaign.cases),
        dampers=tuple(campaign.dampers),
        units=dict(table.drop_duplicates("channel").set_index("channel")["unit"]),
        runs=runs,
        table=table,
        rates=suppression(table, channels),
        order=ranking(table, channels),
        power=levels(table, "rms", [POWER]),
        extreme=extremes(table, RESPONSES),
        fatigue=fatigue_and_why(table, campaign.speeds())[0],
        travel=damper_travel(table),
        paper=beside_paper(table),
        spectra=spectra,
        histories={key: frame for key, (_, frame) in histories.items()},
        history_seeds={case: seed for (case, _), (seed, _) in histories.items()},
    )


Key = tuple[str, str, int]
Histories = dict[tuple[str, str], tuple[int, pd.DataFrame]]
Spectra = dict[tuple[str, str], dict[str, MeanSpectrum]]


def _read_runs(campaign: Campaign, lacking: Mapping[Key, str]) -> tuple[tuple[Run, ...], Histories, Spectra, list[Key]]:
    """Each run's file read once: provenance, histories of one seed a case, spectra over all, and what is unreadable."""
    runs: list[Run] = []
    histories: Histories = {}
    spectra: Spectra = {}
    unreadable: list[Key] = []
    chosen = {case: _most_complete_seed(campaign, case) for case in campaign.cases}
    for case in campaign.cases:
        for damper in campaign.dampers:
            frames = {}
            for seed in _planned_seeds(campaign, case, damper):
                key = (case, damper, seed)
                if key in lacking:
                    runs.append(Run(*key, "failed" if lacking[key] else "missing", lacking[key]))
                    continue
                try:
                    frame = campaign.frame(*key)
                    record = json.loads((campaign.run_folder(*key) / "run.json").read_text(encoding="utf-8"))
                except (OSError, ValueError) as error:
                    runs.append(Run(*key, "unreadable", str(error)))
                    unreadable.append(key)
                    continue
                runs.append(Run(*key, "done", "", record))
                frames[seed] = frame[[c for c in SHOWN if c in frame.columns]]
            shown = chosen[case]
            if shown is not None and shown in frames:
                histories[case, damper] = (shown, frames[shown])
            for channel in (*RESPONSES, POWER):
                own = [f for f in frames.values() if channel in f.columns]
                if own:
                    spectra.setdefault((case, channel), {})[damper] = _spectrum(own, channel, campaign.transient(case))
    return tuple(runs), histories, spectra, unreadable


def _spectrum(frames: Sequence[pd.DataFrame], channel: str, transient: float) -> MeanSpectrum:
    """Average over the runs that are as long as the longest: a stopped run has another resolution."""
    longest = max(len(f) for f in frames)
    return mean_spectrum([f for f in frames if len(f) == longest], channel, transient=transient)


def _planned_seeds(campaign: Campaign, case: str, damper: str) -> list[int]:
    return [int(r["seed"]) for r in campaign.plan["runs"] if (r["case"], r["damper"]) == (case, damper)]


def _most_complete_seed(campaign: Campaign, case: str) -> int | None:
    """The first seed that most arrangements have."""
    counts: dict[int, int] = {}
    for damper in campaign.dampers:
        for seed in campaign.seeds(case, damper):
            counts[seed] = counts.get(seed, 0) + 1
    return min(counts, key=lambda s: (-counts[s], s)) if counts else None


def present(table: pd.DataFrame, column: str, order: Sequence[str]) -> list[str]:
    """Names of a column that are there, in a given order."""
    found = set(table[column]) if len(table) else set()
    return [n for n in order if n in found]
