"""The parts of the report, each a title, sentences, figures and tables."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
import pandas as pd

from optimisation.campaign.fatigue import wind_bins
from optimisation.campaign.tables import LIFETIME
from optimisation.report import figures, figures_time, findings
from optimisation.report.figures import Plot, Variant
from optimisation.report.study import Study, present
from optimisation.report.style import (
    EXCITATIONS,
    POWER,
    RESPONSES,
    STROKES,
    case_name,
    channel_name,
    damper_name,
    number,
    percent,
    readable_unit,
)


@dataclass(frozen=True)
class Table:
    """A table of the page; `name` is also that of its CSV file. `shades`: of the cells of each row, 0 to 1, or empty.

    `narrow` ones stand side by side.
    """

    name: str
    title: str
    frame: pd.DataFrame
    note: str = ""
    shades: tuple[tuple[float, ...], ...] = ()
    narrow: bool = False


@dataclass(frozen=True)
class Section:
    """A tab of the page.

    Attributes:
        intro: a paragraph. lead: sentences below it. cards: what, how much, by which.
        choices: load cases to choose from, for figures with variants.
        special: name of a part with a template of its own, "motion" or "system".
    """

    name: str
    title: str
    lead: tuple[str, ...] = ()
    plots: tuple[Plot, ...] = ()
    tables: tuple[Table, ...] = ()
    choices: tuple[str, ...] = ()
    special: str = ""
    intro: str = ""
    cards: tuple[tuple[str, str, str], ...] = ()


def all_sections(study: Study) -> tuple[Section, ...]:
    """The report's sections, those without content left out."""
    made = (_summary, _suppression, _histories, _spectra, _power, _loads, _dampers, _motion, _system)
    return tuple(s for s in (make(study) for make in made) if s.lead or s.plots or s.tables or s.special)


def _by_case(study: Study, make: Callable[[str], Variant | None]) -> dict[str, Variant]:
    found = {case: make(case) for case in study.cases}
    return {case: v for case, v in found.items() if v is not None}


def _choices(*plots: Plot) -> tuple[str, ...]:
    return tuple(dict.fromkeys(case for p in plots for case in p.variants if case))


def _summary(study: Study) -> Section:
    lead = (*findings.headline(study), *findings.stop_sentences(study), findings.paper_sentence(study))
    tables = [_overview(study, channel) for channel in findings.HEADLINES]
    shown = (*filter(None, tables), *_beside(study))
    return Section("summary", "Summary", tuple(filter(None, lead)), tables=shown, cards=tuple(findings.cards(study)))


def _overview(study: Study, channel: str) -> Table | None:
    """Suppression by case (rows) and arrangement (columns), with half intervals and the best one named."""
    rates = study.rates[study.rates["channel"] == channel]
    if not len(rates):
        return None
    rows, shades = [], []
    dampers = present(rates, "damper", study.damped)
    for case in present(rates, "case", study.cases):
        row, shade = {"load case": case_name(case)}, [0.0]
        for damper in dampers:
            r = study.rate(case, damper, channel)
            half = f" ± {percent(r['half'])}" if r is not None and np.isfinite(r["half"]) else ""
            row[damper_name(damper)] = "–" if r is None else f"{percent(r['rate'])}{half}"
            shade.append(0.0 if r is None else min(1.0, max(0.0, float(r["rate"]) / 40.0)))
        best = findings.best(study, case, channel)
        row["best"] = "–" if best is None or best["rate"] <= 0.0 else damper_name(best["damper"])
        rows.append(row)
        shades.append((*shade, 0.0))
    seeds = sorted(set(rates["seeds"].astype(int)))
    counted = f"{seeds[0]} to {seeds[-1]} seeds" if len(seeds) > 1 else f"{seeds[0]} seed{'s' * (seeds[0] > 1)}"
    note = f"Suppression of the standard deviation in %, {counted}" + (
        "; ± half the 95 % interval." if rates["half"].notna().any() else ": no intervals."
    )
    title = f"{channel_name(channel)} ({channel})"
    return Table(f"overview-{channel}", title, pd.DataFrame(rows), note, tuple(shades), narrow=True)


def _beside(study: Study) -> tuple[Table, ...]:
    rows = []
    for r in study.paper.to_dict("records"):
        unit = readable_unit(r["unit"])
        rate = r["quantity"] == "suppression"
        rows.append({
            "quantity": f"{'suppression of STD' if rate else 'RMS'}, {r['channel']} ({unit})",
            "load case": findings.paper_case(r["case"]), "arrangement": damper_name(r["damper"]),
            "paper": f"{r['says']} {r['paper']:g}", "here": percent(r["ours"]),
            "95 % interval": figures.interval(r["low"], r["high"]), "verdict": findings.verdict(r),
        })  # fmt: skip
    note = (
        "Each figure in the paper's text (Wang et al. 2022, sections 6.2 and 6.3; one realisation of its own wind and"
        " sea, in FAST-SC) beside this campaign's mean over seeds. within: the paper's figure lies in our interval."
    )
    return (Table("paper", "The paper's figures beside ours", pd.DataFrame(rows), note),) if rows else ()


def _suppression(study: Study) -> Section:
    plots = [
        Plot(f"suppression-{c}", f"Figure 10{letter}: {channel_name(c)} ({c})", {"": figures.suppression(study, c)})
        for letter, c in zip("ABCD", ("TTDspFA", "PtfmPitch", "TwrBsMyt", "RootMyc1"), strict=True)
        if (study.rates["channel"] == c).any()
    ]
    lines = findings.order_sentences(study)
    intro = "The paper finds MTMD better than TMD-P, and TMD-P better than TMD-N, in every load case. Here, that order:"
    return Section(
        "suppression", "Suppression", tuple(lines), tuple(plots), _order_table(study), intro=intro if lines else ""
    )


def _order_table(study: Study) -> tuple[Table, ...]:
    """Differences between neighbours of the paper's order: a row per case and pair, a column per channel."""
    if not len(study.order):
        return ()
    rows, shades = [], []
    channels = present(study.order, "channel", (*RESPONSES, POWER))
    for (case, better, worse), part in study.order.groupby(["case", "better", "worse"], sort=False):
        found = part.set_index("channel")
        row = {"load case": case_name(case), "better?": f"{damper_name(better)} than {damper_name(worse)}"}
        shade = [0.0, 0.0]
        for channel in channels:
            r = found.loc[channel] if channel in found.index else None
            half = f" ± {percent(r['half'])}" if r is not None and np.isfinite(r["half"]) else ""
            sure = r["verdict"] if r is not None and half else "one seed"
            row[channel] = "–" if r is None else f"{percent(r['difference'])}{half}: {sure}"
            shade.append(0.6 if sure == "yes" else 0.0)
        rows.append(row)
        shades.append(tuple(shade))
    note = (
        "Differences of suppression rates in points, paired by seed, ± half their 95 % intervals. yes: better (shaded);"
        " no: worse; open: the interval holds zero, these seeds do not tell."
    )
    return (Table("order", "Which arrangement is better", pd.DataFrame(rows), note, tuple(shades)),)


def _histories(study: Study) -> Section:
    plots = []
    if study.wind is not None:
        plots.append(
            Plot("wind-field", "Figure 8: the wind field", {"": figures_time.wind_field(study.wind)}, wide=True)
        )
    own = _by_case(study, lambda case: figures_time.histories(study, case, (*EXCITATIONS, *RESPONSES)))
    history = Plot("histories", "Figure 9: histories", own, wide=True)
    return Section("histories", "Histories", (), (history, *plots) if own else tuple(plots), choices=_choices(history))


def _spectra(study: Study) -> Section:
    plots = []
    for letters, channel in zip(("A, B", "C, D", "E, F", "G, H"), RESPONSES, strict=True):
        own = _by_case(study, partial(figures_time.spectrum, study, channel=channel))
        if own:
            plots.append(Plot(f"spectrum-{channel}", f"Figure 11{letters}: {channel_name(channel)}", own))
    return Section("spectra", "Spectra", (), tuple(plots), choices=_choices(*plots))


def _power(study: Study) -> Section:
    own = _by_case(study, lambda case: figures_time.histories(study, case, (POWER,)))
    rms = figures.power_rms(study, POWER)
    plots = []
    if own:
        plots.append(Plot("power-history", "Figure 12: generator power", own, wide=True))
    if rms:
        plots.append(Plot("power-rms", "Figure 13: RMS of the power", rms))
    if (study.rates["channel"] == POWER).any():
        shown = figures.suppression(study, POWER)
        plots.append(Plot(f"suppression-{POWER}", "Figure 14: suppression of power fluctuations", {"": shown}))
    return Section("power", "Power", (), tuple(plots), choices=_choices(*plots))


def _loads(study: Study) -> Section:
    plots = [
        Plot(f"extreme-{c}", f"Extreme values: {channel_name(c)}", {"": figures.extreme(study, c)})
        for c in RESPONSES
        if len(study.extreme) and (study.extreme["channel"] == c).any()
    ]
    plots += [
        Plot(f"fatigue-{c}", f"Damage-equivalent load: {channel_name(c)}", {"": figures.fatigue(study, c, LIFETIME)})
        for c in dict.fromkeys(study.fatigue["channel"])
    ]
    return Section("loads", "Extremes and fatigue", (), tuple(plots), _bins(study))


def _bins(study: Study) -> tuple[Table, ...]:
    speeds = {n: c["wind_speed"] for n, c in study.plan["cases"].items() if c.get("wind_speed") is not None}
    if len(speeds) < 2 or not (study.fatigue["case"] == LIFETIME).any():
        return ()
    bins = wind_bins(speeds)
    frame = pd.DataFrame({
        "load case": [case_name(c) for c in bins["case"]], "mean wind (m/s)": bins["speed"],
        "stands for (m/s)": [f"{number(a)} to {number(b)}" for a, b in zip(bins["low"], bins["high"], strict=True)],
        "share of operating time (%)": [percent(100.0 * w) for w in bins["weight"]],
    })  # fmt: skip
    note = (
        "Lifetime: Rayleigh distribution with a yearly mean of 10 m/s (IEC 61400-1, class I), cut-in to cut-out; each"
        " case stands for the wind speeds nearest its own."
    )
    return (Table("wind-bins", "Weights of the load cases over a lifetime", frame, note),)


def _dampers(study: Study) -> Section:
    channels = present(study.travel, "channel", list(STROKES))
    own = _by_case(study, lambda case: figures_time.histories(study, case, tuple(STROKES)))
    plots = [Plot(f"stroke-{c}", channel_name(c), {"": figures.strokes(study, c)}) for c in channels]
    if own:
        plots.append(Plot("damper-history", "Damper displacements", own, wide=True))
    return Section(
        "dampers", "Dampers", tuple(findings.stop_sentences(study)), tuple(plots), _parameters(study), _choices(*plots)
    )


def _parameters(study: Study) -> tuple[Table, ...]:
    """Parameters of the dampers, an arrangement a column; runs of an arrangement that differ are shown so."""
    found: dict[str, dict[str, list[str]]] = {}
    for run in study.runs:
        for component, content in run.record.get("components", {}).items():
            if component in STROKES.values() or "damper" in component or component.startswith("mtmd"):
                for name, value in content.get("start", {}).items():
                    full = f"{component}.{name}"
                    unit = readable_unit(study.variable_units.get(full, ""))
                    label = f"{full} ({unit})" if unit != "-" else full
                    values = found.setdefault(label, {}).setdefault(run.damper, [])
                    text = number(float(value), 6) if isinstance(value, (int, float)) else str(value)
                    if text not in values:
                        values.append(text)
    if not found:
        return ()
    rows = [
        {"parameter": label, **{damper_name(d): " or ".join(by.get(d, ["–"])) for d in study.damped}}
        for label, by in found.items()
    ]
    note = "What the campaign set; parameters not listed have the FMU's own start values."
    return (Table("parameters", "Parameters of the arrangements", pd.DataFrame(rows), note),)


def _motion(study: Study) -> Section:
    return Section("motion", "Motion", special="motion" if study.histories else "")


def _system(study: Study) -> Section:
    tables = [*_connections(study), *_ports(study), *_fmus(study), *_provenance(study)]
    return Section(
        "system", "System and provenance", (), (), tuple(tables), special="system" if study.graph is not None else ""
    )


def _connections(study: Study) -> tuple[Table, ...]:
    if study.graph is None or not len(study.graph):
        return ()
    rows = []
    for (source, target), part in study.graph.groupby(["source", "target"], sort=False):
        signals = ", ".join(
            f"{s}{f' ×{n}' if n > 1 else ''} ({readable_unit(u)})"
            for s, u, n in zip(part["signal"], part["unit"], part["count"], strict=True)
        )
        rows.append({"from": source, "to": target, "scalars": int(part["count"].sum()), "signals (unit)": signals})
    return (Table("connections", "Connections", pd.DataFrame(rows)),)


def _ports(study: Study) -> tuple[Table, ...]:
    """The largest coupling-energy residual of each mechanical port over all runs."""
    worst: dict[str, tuple[float, str, float, float]] = {}
    for run in study.runs:
        for port, e in run.record.get("ports", {}).items():
            share = abs(float(e["share"]))
            if port not in worst or share > worst[port][0]:
                worst[port] = (share, run.name, float(e["residual"]), float(e["crossed"]))
    rows = [
        {
            "port": port, "largest share": number(share, 2), "residual (J)": number(residual, 3),
            "crossed (J)": number(crossed, 3), "in run": name,
        }
        for port, (share, name, residual, crossed) in worst.items()
    ]  # fmt: skip
    note = (
        "Energy that the coupling itself added at each mechanical port, as a share of the energy that crossed it: the"
        " largest of all runs."
    )
    return (Table("coupling-energy", "Coupling energy", pd.DataFrame(rows), note),) if rows else ()


def _fmus(study: Study) -> tuple[Table, ...]:
    rows = {
        (component, str(content.get("sha256", "")), str(content.get("generator", "")))
        for run in study.runs
        for component, content in run.record.get("components", {}).items()
    }
    frame = pd.DataFrame(sorted(rows), columns=["component", "SHA-256 of the FMU", "made by"])
    return (Table("fmus", "FMUs", frame),) if rows else ()


def _provenance(study: Study) -> tuple[Table, ...]:
    records = [r.record for r in study.runs if r.record]
    seconds = sum(float(r.get("wall_time", 0.0)) for r in records)
    cases = "; ".join(f"{case_name(c)}: {study.text(c)}" for c in study.cases)
    done = len(study.runs) - len(study.lacking())
    facts = {
        "command": study.plan.get("command", "not recorded"), "started": study.plan.get("started", "not recorded"),
        "runs": f"{done} of {len(study.runs)}", "seeds": ", ".join(map(str, study.seeds)), "load cases": cases,
        "machine time of the runs": f"{seconds:.0f} s",
    } | {f"version of {k}": v for k, v in study.plan.get("versions", {}).items()}  # fmt: skip
    if records:
        s = records[0]["settings"]
        facts["coupling"] = (
            f"{s.get('algorithm')}, inputs {s.get('extrapolation')}, step {s.get('step')} s,"
            f" recorded every {s.get('decimation')} steps"
        )
    frame = pd.DataFrame({"what": list(facts), "value": [str(v) for v in facts.values()]})
    lacking = [{"run": r.name, "status": r.status, "why": r.message or "never ran"} for r in study.lacking()]
    return (
        Table("provenance", "Provenance", frame),
        *((Table("missing-runs", "Runs without a result", pd.DataFrame(lacking)),) if lacking else ()),
    )
