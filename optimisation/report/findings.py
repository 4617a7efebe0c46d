"""What a campaign shows, in sentences made from its figures."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from optimisation.campaign.paper import LARGEST
from optimisation.campaign.tables import ORDER
from optimisation.report.study import Study
from optimisation.report.style import (
    POWER,
    RESPONSES,
    STROKES,
    case_name,
    channel_name,
    damper_name,
    listed,
    number,
    percent,
)

HEADLINES = ("PtfmPitch", "TTDspFA")


def interval(row: pd.Series) -> str:
    """A rate with its interval: "21.5 % [18.2, 24.8]"."""
    if not np.isfinite(row["low"]):
        return f"{percent(row['rate'])} %"
    return f"{percent(row['rate'])} % [{percent(row['low'])}, {percent(row['high'])}]"


def best(study: Study, case: str, channel: str) -> pd.Series | None:
    """Row of the arrangement that suppresses a channel most in a case."""
    rows = study.rates[(study.rates["case"] == case) & (study.rates["channel"] == channel)].dropna(subset=["rate"])
    return rows.loc[rows["rate"].idxmax()] if len(rows) else None


def winners(study: Study, channel: str) -> dict[str, list[str]]:
    """Arrangement -> cases in which it suppresses a channel most."""
    found: dict[str, list[str]] = {}
    for case in study.cases:
        row = best(study, case, channel)
        if row is not None:
            found.setdefault(str(row["damper"]), []).append(case)
    return found


def headline(study: Study) -> list[str]:
    """The main sentences: the best arrangement for platform pitch and tower top, its range over the cases."""
    lines = []
    for channel in HEADLINES:
        found = winners(study, channel)
        if not found:
            continue
        total = sum(map(len, found.values()))
        name, cases = max(found.items(), key=lambda item: len(item[1]))
        rows = study.rates[(study.rates["channel"] == channel) & (study.rates["damper"] == name)].dropna(
            subset=["rate"]
        )
        low, high = rows.loc[rows["rate"].idxmin()], rows.loc[rows["rate"].idxmax()]
        where = f"in {len(cases)} of {total} load cases" if total > 1 else f"in {case_name(cases[0])}"
        others = "; ".join(
            f"{damper_name(d)} in {listed([case_name(c) for c in cs])}" for d, cs in found.items() if d != name
        )
        span = (
            f"by {interval(high)} in {case_name(high['case'])} and {interval(low)} in {case_name(low['case'])},"
            " its best and worst case"
            if len(rows) > 1
            else f"by {interval(high)}"
        )
        lines.append(
            f"{channel_name(channel)}: {damper_name(name)} suppresses the standard deviation most {where}"
            f"{f' ({others})' if others else ''}, {span}."
        )
    return lines


def cards(study: Study) -> list[tuple[str, str, str]]:
    """Figures to be seen first: what, how much, and by which arrangement."""
    found = []
    for channel in (*HEADLINES, "TwrBsMyt", POWER):
        ranked = winners(study, channel)
        if not ranked:
            continue
        total = sum(map(len, ranked.values()))
        name, cases = max(ranked.items(), key=lambda item: len(item[1]))
        rates = study.rates[(study.rates["channel"] == channel) & (study.rates["damper"] == name)]["rate"].dropna()
        span = f"{rates.min():.0f} to {rates.max():.0f} %" if len(rates) > 1 else f"{rates.iloc[0]:.0f} %"
        best_in = f"best in {len(cases)} of {total} cases" if total > 1 else f"best in {case_name(cases[0])}"
        found.append((channel_name(channel), span.replace("-", "−"), f"less STD with {damper_name(name)}, {best_in}"))
    return found


def order_sentences(study: Study) -> list[str]:
    """Whether MTMD > TMD-P > TMD-N, which the paper finds in every case, holds here, channel by channel."""
    if not set(ORDER) <= set(study.dampers):
        return []
    lines = []
    for channel in RESPONSES:
        kept, broken, compared = [], [], 0
        for case in study.cases:
            rows = [study.rate(case, d, channel) for d in ORDER]
            if any(r is None for r in rows):
                continue
            rates = [float(r["rate"]) for r in rows if r is not None]
            compared += 1
            if rates[0] > rates[1] > rates[2]:
                kept.append(case)
            else:
                actual = sorted(zip(rates, ORDER, strict=True), reverse=True)
                broken.append(f"{case_name(case)} has {' > '.join(damper_name(d) for _, d in actual)}")
        if compared:
            doubt = doubtful(study, channel, kept)
            tail = f"; {', '.join(broken)}" if broken else ""
            unsure = f". Not certain with these seeds: {', '.join(doubt)}" if doubt else ""
            lines.append(f"{channel_name(channel)}: holds in {len(kept)} of {compared} load cases{tail}{unsure}.")
    return lines


def doubtful(study: Study, channel: str, cases: list[str]) -> list[str]:
    """Steps of the order that hold on average but not beyond the seeds' scatter: their 95 % interval includes zero."""
    table = study.order
    table = table[(table["channel"] == channel) & table["case"].isin(cases) & (table["verdict"] == "open")]
    return [
        f"{damper_name(r['better'])} over {damper_name(r['worse'])} in {case_name(r['case'])}"
        for r in table.to_dict("records")
    ]


def verdict(row: Mapping[str, Any]) -> str:
    """A row of the paper's figures beside ours, judged: "within", "lower here" or "higher here".

    With one seed there is no interval: then "at least" and "at most" can be met, and other figures are higher or lower.
    """
    met = row["within"] and (np.isfinite(row["half"]) or row["says"] in ("at least", "at most"))
    if not np.isfinite(row["half"]) and row["says"] == "at least":
        met = row["ours"] >= row["paper"]
    return "within" if met else "lower here" if row["ours"] < row["paper"] else "higher here"


def paper_sentence(study: Study) -> str:
    """The paper's figures beside ours counted, and the widest gap in suppression named."""
    rows = study.paper.to_dict("records")
    if not rows:
        return ""
    count = Counter(verdict(r) for r in rows)
    text = (
        f"The paper's text gives {len(rows)} figures for these cases and arrangements: {count['within']} agree with our"
        f" 95 % intervals, {count['lower here']} where ours is lower, {count['higher here']} where it is higher."
    )
    rates = [r for r in rows if r["quantity"] == "suppression" and verdict(r) != "within"]
    if rates:
        widest = max(rates, key=lambda r: abs(r["ours"] - r["paper"]))
        text += (
            f" The widest gap in suppression is {channel_name(widest['channel']).lower()},"
            f" {damper_name(widest['damper'])}, {paper_case(widest['case'])}: {percent(widest['ours'])} % here,"
            f" {widest['says']} {widest['paper']:g} % there."
        )
    return text


def paper_case(case: str) -> str:
    """The case a figure of the paper is for, in words."""
    return "largest of the cases" if case == LARGEST else case_name(case)


def stop_sentences(study: Study) -> list[str]:
    """Largest stroke of each damper beside its stop, and how often it hits."""
    lines = []
    for channel, component in STROKES.items():
        rows = study.travel[study.travel["channel"] == channel]
        if not len(rows):
            continue
        runs = study.table[(study.table["channel"] == channel) & study.table["stroke"].notna()]
        hit = int((runs["stop_hits"] > 0).sum())
        top, most = rows.loc[rows["largest"].idxmax()], rows.loc[rows["stop_hits"].idxmax()]
        limit = study.limits().get(channel)
        stop = f" (end stop {limit:g} m)" if limit is not None else ""
        text = (
            f"{component.replace('_', ' ').capitalize()}: largest displacement {number(top['largest'], 3)} m{stop},"
            f" {damper_name(top['damper'])} in {case_name(top['case'])}; "
        )
        text += (
            f"at its stops in {hit} of {len(runs)} runs, most often {damper_name(most['damper'])} in"
            f" {case_name(most['case'])} ({number(most['stop_hits'], 3)} hits a run)."
            if hit
            else f"never at its stops in {len(runs)} runs."
        )
        lines.append(text)
    return lines


def lacking_sentence(study: Study) -> str:
    """Which runs have no result, or ""."""
    lacking = study.lacking()
    if not lacking:
        return ""
    names = [f"{r.name} ({r.status})" for r in lacking]
    shown = ", ".join(names[:12]) + (f" and {len(names) - 12} more" if len(names) > 12 else "")
    return f"{len(lacking)} of {len(study.runs)} runs have no result and are left out: {shown}."
