"""Interactive figures of suppression, power, extremes, fatigue and strokes, from tables."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
import plotly.graph_objects as go

from optimisation.report.study import Study, present
from optimisation.report.style import (
    STROKES,
    case_name,
    channel_name,
    colours,
    damper_name,
    number,
    percent,
    readable_unit,
    symbols,
)

PAPER = "Wang et al. (2022), text"
PAPER_MARKER = {"symbol": "diamond-open", "size": 11, "color": "#b0338f", "line": {"width": 2.4}}


@dataclass(frozen=True)
class Variant:
    """One figure, the sentence below it with its main numbers, and the table behind it."""

    figure: go.Figure
    caption: str
    table: pd.DataFrame


@dataclass(frozen=True)
class Plot:
    """A figure of the page, in several variants (by load case) or one, under the key ""."""

    name: str
    title: str
    variants: dict[str, Variant]
    wide: bool = False


def base_figure(height: int, y_title: str, x_title: str = "", legend: bool = True) -> go.Figure:
    """An empty figure in the page's style; its page sets the colours of text and grid by theme."""
    figure = go.Figure()
    figure.update_layout(
        template="none",
        height=height,
        autosize=True,
        margin={"l": 62, "r": 14, "t": 62 if legend else 34, "b": 44 if x_title else 26},
        showlegend=legend,
        legend={"orientation": "h", "x": 0, "y": 1.02, "xanchor": "left", "yanchor": "bottom", "font": {"size": 12}},
        font={"size": 12.5},
        paper_bgcolor="rgba(0,0,0,0)",
        plot_bgcolor="rgba(0,0,0,0)",
        hoverlabel={"font": {"size": 12}},
        barmode="group",
        bargap=0.22,
        bargroupgap=0.06,
    )
    figure.update_xaxes(title={"text": x_title, "standoff": 8}, zeroline=False, automargin=True, ticks="outside")
    figure.update_yaxes(title={"text": y_title, "standoff": 8}, zeroline=True, automargin=True)
    return figure


def suppression(study: Study, channel: str) -> Variant:
    """Suppression rate of a channel's standard deviation: bars, intervals, the paper's marks."""
    rates = study.rates[study.rates["channel"] == channel]
    cases, dampers = present(rates, "case", study.cases), present(rates, "damper", study.damped)
    figure = base_figure(330, "suppression of STD (%)")
    _grouped_bars(figure, study, rates.rename(columns={"rate": "value"}), cases, dampers, "%")
    _paper_marks(figure, study.marks(channel, "suppression"), cases, dampers)
    return Variant(figure, _suppression_caption(study, rates, channel), _suppression_table(study, rates, channel))


def _grouped_bars(
    figure: go.Figure, study: Study, table: pd.DataFrame, cases: list[str], dampers: list[str], unit: str
) -> None:
    """Bars of `value` with whiskers of `half` on either side, by case, a colour for each arrangement."""
    shown = colours(study.dampers)
    for damper in dampers:
        rows = table[table["damper"] == damper].set_index("case").reindex(cases)
        figure.add_bar(
            x=[case_name(c) for c in cases], y=_plain(rows["value"]), name=damper_name(damper), offsetgroup=damper,
            marker={"color": shown[damper]}, error_y=_whiskers(rows["half"]),
            hovertemplate="%{x}, " + damper_name(damper) + ": %{y:,.4~g} " + unit + "<extra></extra>",
        )  # fmt: skip


def _whiskers(half: pd.Series) -> dict[str, Any]:
    # a list, since nothing may be drawn where there is one seed only
    return {"type": "data", "array": _plain(half), "thickness": 1.3, "width": 3}


def _plain(values: pd.Series) -> list[float | None]:
    """Numbers as JSON knows them."""
    return [float(f"{v:.6g}") if np.isfinite(v) else None for v in values]


def _paper_marks(figure: go.Figure, marks: pd.DataFrame, cases: list[str], dampers: list[str]) -> None:
    """The paper's figures as diamonds on the bars they belong to."""
    first = True
    for damper in dampers:
        own = marks[(marks["damper"] == damper) & marks["case"].isin(cases)]
        if len(own):
            figure.add_scatter(
                x=[case_name(c) for c in own["case"]], y=own["paper"].tolist(), mode="markers", name=PAPER,
                showlegend=first, legendgroup="paper", offsetgroup=damper, marker=dict(PAPER_MARKER),
                hovertext=[f"paper: {r['says']} {r['paper']:g} %" for r in own.to_dict("records")],
                hoverinfo="text",
            )  # fmt: skip
            first = False
    figure.update_layout(scattermode="group", scattergap=0.22)


def _suppression_caption(study: Study, rates: pd.DataFrame, channel: str) -> str:
    if not len(rates):
        return "No pair of runs with and without damper is complete."
    parts = []
    for damper in present(rates, "damper", study.damped):
        rows = rates[rates["damper"] == damper]
        low, high = rows.loc[rows["rate"].idxmin()], rows.loc[rows["rate"].idxmax()]
        span = f"{percent(low['rate'])} % ({case_name(low['case'])})"
        if len(rows) > 1:
            span += f" to {percent(high['rate'])} % ({case_name(high['case'])})"
        parts.append(f"{damper_name(damper)} {span}")
    marked = " Diamonds: figures in the paper's text." if len(study.marks(channel, "suppression")) else ""
    means = "mean of the seeds with 95 % interval" if rates["half"].notna().any() else "one seed, so no interval"
    return f"Reduction of the standard deviation in the same wind and sea, {means}: {'; '.join(parts)}.{marked}"


def _suppression_table(study: Study, rates: pd.DataFrame, channel: str) -> pd.DataFrame:
    marks = study.marks(channel, "suppression").set_index(["case", "damper"])
    unit = readable_unit(study.units.get(channel, ""))
    rows = []
    for r in rates.to_dict("records"):
        key = (r["case"], r["damper"])
        paper = f"{marks.loc[key, 'says']} {marks.loc[key, 'paper']:g}" if key in marks.index else ""
        rows.append({
            "load case": case_name(r["case"]), "arrangement": damper_name(r["damper"]),
            f"STD without ({unit})": number(r["undamped"]), f"STD with ({unit})": number(r["damped"]),
            "suppression (%)": percent(r["rate"]), "95 % interval (%)": interval(r["low"], r["high"]),
            "seeds": r["seeds"], "paper (%)": paper,
        })  # fmt: skip
    return pd.DataFrame(rows)


def interval(low: float, high: float) -> str:
    """An interval in words, or that there is none."""
    return f"{percent(low)} to {percent(high)}" if np.isfinite(low) else "one seed"


def power_rms(study: Study, channel: str) -> dict[str, Variant]:
    """RMS of the power of each arrangement, case by case, with the paper's figures."""
    unit = readable_unit(study.units.get(channel, ""))
    variants = {}
    for case in present(study.power, "case", study.cases):
        rows = study.power[study.power["case"] == case].set_index("damper")
        dampers = [d for d in study.dampers if d in rows.index]
        figure = base_figure(330, f"RMS of {channel_name(channel).lower()} ({unit})")
        shown, signs = colours(study.dampers), symbols(study.dampers)
        for damper in dampers:
            r = rows.loc[[damper]]
            figure.add_scatter(
                x=[damper_name(damper)], y=_plain(r["value"]), mode="markers", name="this study",
                showlegend=damper == dampers[0], error_y=_whiskers(r["half"]),
                marker={"size": 12, "color": shown[damper], "symbol": signs[damper]},
                hovertemplate="%{x}: %{y:.1f} " + unit + "<extra></extra>",
            )  # fmt: skip
        marks = study.marks(channel, "rms")
        marks = marks[marks["case"] == case]
        if len(marks):
            figure.add_scatter(
                x=[damper_name(d) for d in marks["damper"]], y=marks["paper"].tolist(), mode="markers", name=PAPER,
                marker=dict(PAPER_MARKER), hovertemplate="paper, %{x}: %{y:.2f} " + unit + "<extra></extra>",
            )  # fmt: skip
        figure.update_xaxes(categoryorder="array", categoryarray=[damper_name(d) for d in dampers])
        text = "; ".join(f"{damper_name(d)} {rows.loc[d, 'value']:.1f}" for d in dampers)
        paper = "; ".join(f"{damper_name(d)} {v:g}" for d, v in zip(marks["damper"], marks["paper"], strict=True))
        caption = f"{case_name(case)}, mean of the seeds with its 95 % interval, {unit}: {text}." + (
            f" The paper, one realisation: {paper}." if paper else " The paper's text gives no figure for this case."
        )
        variants[case] = Variant(figure, caption, _levels_table(rows.reset_index(), "value", f"RMS ({unit})"))
    return variants


def _levels_table(rows: pd.DataFrame, column: str, what: str, half: str = "half") -> pd.DataFrame:
    return pd.DataFrame({
        "load case": [case_name(c) for c in rows["case"]],
        "arrangement": [damper_name(d) for d in rows["damper"]],
        what: [number(v, 5) for v in rows[column]],
        "± (95 %)": [number(v, 3) if np.isfinite(v) else "one seed" for v in rows[half]],
        "seeds": rows["seeds"].astype(int),
    })  # fmt: skip


def extreme(study: Study, channel: str) -> Variant:
    """Largest value of a channel in ten minutes: mean over seeds, by case and arrangement."""
    rows = study.extreme[study.extreme["channel"] == channel] if len(study.extreme) else study.extreme
    cases, dampers = present(rows, "case", study.cases), present(rows, "damper", study.dampers)
    unit = readable_unit(study.units.get(channel, ""))
    figure = base_figure(330, f"maximum ({unit})")
    if len(rows):
        view = rows.rename(columns={"maximum": "value", "maximum_half": "half"})
        _grouped_bars(figure, study, view, cases, dampers, unit)
    table = pd.DataFrame([
        {
            "load case": case_name(r["case"]), "arrangement": damper_name(r["damper"]),
            f"mean maximum ({unit})": number(r["maximum"]), "± (95 %)": number(r["maximum_half"], 3),
            f"largest of all seeds ({unit})": number(r["largest"]), f"mean minimum ({unit})": number(r["minimum"]),
            f"smallest of all seeds ({unit})": number(r["smallest"]),
            "reduction of the maximum (%)": "" if r["damper"] == study.reference else percent(r["reduction"]),
            "seeds": r["seeds"],
        }
        for r in rows.to_dict("records")
    ])  # fmt: skip
    caption = "Mean over seeds of each run's largest value, with its 95 % interval." + _reductions(
        study, rows, "of the maximum"
    )
    return Variant(figure, caption, table)


def fatigue(study: Study, channel: str, lifetime: str) -> Variant:
    """Damage-equivalent load of a channel by case and arrangement, and over the lifetime where all cases were run."""
    rows = study.fatigue[study.fatigue["channel"] == channel]
    cases, dampers = present(rows, "case", [*study.cases, lifetime]), present(rows, "damper", study.dampers)
    unit = readable_unit(study.units.get(channel, ""))
    figure = base_figure(330, f"DEL, range at 1 Hz ({unit})")
    shown = colours(study.dampers)
    for damper in dampers:
        own = rows[rows["damper"] == damper].set_index("case").reindex(cases)
        figure.add_bar(
            x=[case_name(c) for c in cases], y=_plain(own["del"]), name=damper_name(damper),
            marker={"color": shown[damper]}, hovertemplate="%{x}: %{y:,.4~g} " + unit,
        )  # fmt: skip
    table = pd.DataFrame([
        {
            "load case": case_name(r["case"]), "arrangement": damper_name(r["damper"]),
            f"DEL ({unit})": number(r["del"]),
            "reduction (%)": "" if r["damper"] == study.reference else percent(r["reduction"]),
            "95 % interval (%)": "" if r["damper"] == study.reference else interval(r["low"], r["high"]),
            "seeds": r["seeds"],
        }
        for r in rows.to_dict("records")
    ])  # fmt: skip
    exponent = number(rows["exponent"].iloc[0]) if len(rows) else "–"
    over = rows[(rows["case"] == lifetime) & (rows["damper"] != study.reference)]
    life = "; ".join(
        f"{damper_name(r['damper'])} {percent(r['reduction'])} % ({interval(r['low'], r['high'])})"
        for r in over.to_dict("records")
    )
    caption = f"Damage-equivalent load by rainflow counting, slope m = {exponent}, all seeds together." + (
        f" Lifetime, cases weighted by wind speed; reduction: {life}."
        if life
        else _reductions(study, rows, "of the load")
    )
    return Variant(figure, caption, table)


def _reductions(study: Study, rows: pd.DataFrame, what: str) -> str:
    parts = []
    for damper in present(rows, "damper", study.damped):
        own = rows[(rows["damper"] == damper)]["reduction"].dropna()
        if len(own):
            span = f"{percent(own.min())} to {percent(own.max())}" if len(own) > 1 else percent(own.iloc[0])
            parts.append(f"{damper_name(damper)} {span} %")
    return f" Reduction {what}, over the cases: {'; '.join(parts)}." if parts else ""


def strokes(study: Study, channel: str) -> Variant:
    """Largest displacement of a damper, by case and arrangement, with its end stop."""
    rows = study.travel[study.travel["channel"] == channel]
    cases, dampers = present(rows, "case", study.cases), present(rows, "damper", study.damped)
    figure = base_figure(330, "largest displacement (m)")
    shown = colours(study.dampers)
    for damper in dampers:
        own = rows[rows["damper"] == damper].set_index("case").reindex(cases)
        figure.add_bar(
            x=[case_name(c) for c in cases], y=_plain(own["stroke"]), name=damper_name(damper),
            marker={"color": shown[damper]}, customdata=_plain(own["stop_hits"]),
            hovertemplate="%{x}: %{y:.2f} m, %{customdata:.1f} stop hits a run",
        )  # fmt: skip
    limit = study.limits().get(channel)
    if limit is not None:
        figure.add_hline(
            y=limit, line={"dash": "dash", "width": 1.6, "color": "#c0392b"},
            annotation={"text": f"end stop {limit:g} m", "font": {"size": 11.5}, "yanchor": "bottom", "yshift": 9},
        )  # fmt: skip
        figure.update_yaxes(range=[0.0, 1.25 * max(limit, float(rows["stroke"].max() or 0.0))])
    table = pd.DataFrame({
        "load case": [case_name(c) for c in rows["case"]], "arrangement": [damper_name(d) for d in rows["damper"]],
        "largest displacement, mean of seeds (m)": [number(v, 3) for v in rows["stroke"]],
        "of all seeds (m)": [number(v, 3) for v in rows["largest"]],
        "stop hits a run": [number(v, 3) for v in rows["stop_hits"]],
        "most in a run": [number(v, 3) for v in rows["most_hits"]],
        "seeds": rows["seeds"].astype(int),
    })  # fmt: skip
    caption = f"Largest displacement of the {STROKES[channel].replace('_', ' ')}, mean over seeds. "
    top = rows.loc[rows["stop_hits"].idxmax()] if len(rows) and rows["stop_hits"].max() > 0.0 else None
    caption += (
        "No run reaches the stops." if top is None else
        f"Most stop hits: {number(top['stop_hits'], 3)}, {damper_name(top['damper'])} in {case_name(top['case'])}."
    )  # fmt: skip
    return Variant(figure, caption, table)
