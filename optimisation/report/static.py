"""The same figures as pictures for papers, by matplotlib."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pandas as pd
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from optimisation.report.figures import PAPER
from optimisation.report.figures_time import EXCITATION_COLOUR, FIRST_SECONDS, SPECTRUM_HZ
from optimisation.report.study import Study, present
from optimisation.report.style import (
    EXCITATIONS,
    POWER,
    RESPONSES,
    STROKES,
    case_name,
    channel_name,
    colours,
    damper_name,
    readable_unit,
)

DPI = 200


def draw_all(study: Study, folder: Path) -> list[Path]:
    """Draw every figure that the campaign has data for into a folder that exists; returns the files."""
    written: list[Path] = []

    def save(figure: Figure | None, name: str) -> None:
        if figure is not None:
            figure.savefig(folder / f"{name}.png", dpi=DPI)
            written.append(folder / f"{name}.png")

    rates = study.rates.rename(columns={"rate": "value"})
    mark = study.marks
    save(
        _bars(study, rates, RESPONSES, study.damped, "suppression of STD (%)", lambda c: mark(c, "suppression")),
        "suppression",
    )
    save(
        _bars(study, rates, (POWER,), study.damped, "suppression of STD (%)", lambda c: mark(c, "suppression")),
        "suppression-power",
    )
    save(_bars(study, study.power, (POWER,), study.dampers, "RMS", lambda c: mark(c, "rms")), "power-rms")
    if len(study.extreme):
        extreme = study.extreme.rename(columns={"maximum": "value", "maximum_half": "half"})
        save(_bars(study, extreme, RESPONSES, study.dampers, "maximum"), "extremes")
    loads = study.fatigue[study.fatigue["case"].isin(study.cases)].drop(columns="half").rename(columns={"del": "value"})
    save(_bars(study, loads, tuple(dict.fromkeys(loads["channel"])), study.dampers, "DEL, range at 1 Hz"), "fatigue")
    travel = study.travel.rename(columns={"stroke": "value"})
    save(_bars(study, travel, tuple(STROKES), study.damped, "largest displacement (m)"), "strokes")
    save(_wind(study), "wind-field")
    for case in study.cases:
        save(_histories(study, case, (*EXCITATIONS, *RESPONSES)), f"histories-{case}")
        save(_histories(study, case, (POWER,)), f"power-{case}")
        save(_histories(study, case, tuple(STROKES)), f"dampers-{case}")
        save(_spectra(study, case), f"spectra-{case}")
    return written


def _panels(rows: int, columns: int, height: float, **options: Any) -> tuple[Figure, Any]:
    figure = Figure(figsize=(4.4 * columns if columns > 1 else 7.0, height * rows + 0.7), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(rows, columns, squeeze=False, **options)
    for axis in axes.ravel():
        axis.grid(alpha=0.3, linewidth=0.5)
        axis.set_axisbelow(True)
        axis.tick_params(labelsize=8)
    return figure, axes


def _bars(
    study: Study, table: pd.DataFrame, channels: Sequence[str], dampers: Sequence[str], what: str,
    marks: Callable[[str], pd.DataFrame] | None = None,
) -> Figure | None:  # fmt: skip
    """Bars of `value` with whiskers `half` by case and arrangement, a panel for each channel; the paper's marks."""
    shown = present(table, "channel", list(channels))
    if not shown:
        return None
    columns = min(2, len(shown))
    figure, axes = _panels(-(-len(shown) // columns), columns, 2.4)
    for axis, channel in zip(axes.ravel(), shown, strict=False):
        own = table[table["channel"] == channel]
        cases, present_dampers = present(own, "case", study.cases), present(own, "damper", list(dampers))
        place = {c: i for i, c in enumerate(cases)}
        width = 0.8 / max(1, len(present_dampers))
        offset = {d: (k - 0.5 * (len(present_dampers) - 1)) * width for k, d in enumerate(present_dampers)}
        for damper in present_dampers:
            rows = own[own["damper"] == damper]
            half = rows["half"].fillna(0.0) if "half" in rows else None
            axis.bar(
                [place[c] + offset[damper] for c in rows["case"]], rows["value"], 0.92 * width, yerr=half,
                color=colours(study.dampers)[damper], label=damper_name(damper), error_kw={"lw": 0.7, "capsize": 1.5},
            )  # fmt: skip
        paper = marks(channel) if marks else pd.DataFrame()
        if len(paper):
            x = [place[c] + offset[d] for c, d in zip(paper["case"], paper["damper"], strict=True)]
            axis.plot(x, paper["paper"], "D", mfc="none", color="#b0338f", ms=5, mew=1.4, label=PAPER)
        if channel in STROKES and channel in study.limits():
            axis.axhline(study.limits()[channel], color="#c0392b", linestyle="--", linewidth=0.9, label="end stop")
        unit = "" if what.endswith(")") else f" ({readable_unit(study.units.get(channel, ''))})"
        axis.set_ylabel(what + unit, fontsize=8)
        axis.set_title(channel_name(channel), fontsize=9)
        axis.set_xticks(range(len(cases)), [case_name(c) for c in cases])
        axis.axhline(0.0, color="black", linewidth=0.6)
    for axis in axes.ravel()[len(shown) :]:
        axis.remove()
    return _with_legend(figure)


def _with_legend(figure: Figure) -> Figure:
    entries = {
        label: handle for axis in figure.axes for handle, label in zip(*axis.get_legend_handles_labels(), strict=True)
    }
    figure.legend(entries.values(), entries.keys(), loc="outside upper center", ncols=min(5, len(entries)), fontsize=8)
    return figure


def _histories(study: Study, case: str, channels: Sequence[str]) -> Figure | None:
    frames = {d: study.histories[case, d] for d in study.dampers if (case, d) in study.histories}
    shown = [c for c in channels if any(c in f.columns for f in frames.values())]
    if not shown:
        return None
    figure, axes = _panels(len(shown), 1, 1.15, sharex=True)
    first = study.transient(case)
    for axis, channel in zip(axes[:, 0], shown, strict=True):
        for damper, frame in frames.items():
            if channel in frame.columns and not (channel in EXCITATIONS and damper != next(iter(frames))):
                part = frame.loc[first : first + FIRST_SECONDS, channel]
                colour = EXCITATION_COLOUR if channel in EXCITATIONS else colours(study.dampers)[damper]
                label = None if channel in EXCITATIONS else damper_name(damper)
                axis.plot(part.index, part, color=colour, linewidth=0.8, label=label)
        axis.set_ylabel(f"{channel}\n({readable_unit(study.units.get(channel, ''))})", fontsize=7.5)
    axes[-1, 0].set_xlabel("time (s)", fontsize=8)
    axes[0, 0].set_title(f"{case_name(case)}, seed {study.history_seeds[case]}", fontsize=9)
    figure.align_ylabels()
    return _with_legend(figure)


def _spectra(study: Study, case: str) -> Figure | None:
    shown = [c for c in RESPONSES if study.spectra.get((case, c))]
    if not shown:
        return None
    figure, axes = _panels(-(-len(shown) // 2), min(2, len(shown)), 2.4)
    for axis, channel in zip(axes.ravel(), shown, strict=False):
        spectra = study.spectra[case, channel]
        for damper in [d for d in study.dampers if d in spectra]:
            s = spectra[damper]
            low = (s.frequency > 0.0) & (s.frequency <= SPECTRUM_HZ)
            axis.semilogy(
                s.frequency[low],
                s.density[low],
                color=colours(study.dampers)[damper],
                linewidth=1.0,
                label=damper_name(damper),
            )
        unit = readable_unit(study.units.get(channel, ""))
        axis.set_ylabel(f"PSD (({unit})²/Hz)", fontsize=8)
        axis.set_xlabel("frequency (Hz)", fontsize=8)
        axis.set_title(f"{channel_name(channel)}, {case_name(case)}", fontsize=9)
    for axis in axes.ravel()[len(shown) :]:
        axis.remove()
    return _with_legend(figure)


def _wind(study: Study) -> Figure | None:
    if study.wind is None:
        return None
    wind = study.wind
    figure, axes = _panels(1, 1, 2.6)
    mesh = axes[0, 0].pcolormesh(wind.time, wind.height, wind.speed, cmap="cividis", shading="nearest", rasterized=True)
    figure.colorbar(mesh, ax=axes[0, 0], label="wind speed (m/s)")
    axes[0, 0].set_xlabel("time (s)", fontsize=8)
    axes[0, 0].set_ylabel("height above sea (m)", fontsize=8)
    axes[0, 0].set_title(f"{case_name(wind.case)}, seed {wind.seed}: vertical line through the hub", fontsize=9)
    return figure
