"""Pictures of runs: histories and spectra, with units."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pandas as pd
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from cosim.recording import read_results

COLOURS = ("#444444", "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
HISTORY_SECONDS = 200.0
# What a reader looks at first; a run shows those of them that it has and that move, or its first channels.
SHOWN_FIRST = (
    "Wind1VelX", "Wave1Elev", "PtfmPitch", "TTDspFA", "TwrBsMyt", "RootMyc1", "GenPwr", "NStC1_XQ", "SStC1_XQ",
)  # fmt: skip
SPECTRUM_HZ = 0.7


def plot_run(folder: Path, title: str) -> Path | None:
    """Draw the main channels of one run against time to run.png; None where there is nothing to draw."""
    frame = read_results(folder)
    if len(frame) < 2:
        return None
    units = frame.attrs.get("units", {})
    moving = [c for c in frame.columns if np.ptp(frame[c].to_numpy()) > 0.0] or list(frame.columns)
    shown = [c for c in SHOWN_FIRST if c in moving] or moving[: len(SHOWN_FIRST)]
    figure, axes = _panels(len(shown), 1, width=9.0, height=1.4)
    for axis, channel in zip(axes[:, 0], shown, strict=True):
        axis.plot(frame.index, frame[channel], color=COLOURS[1], linewidth=0.8)
        axis.set_ylabel(f"{channel}\n({units.get(channel, '')})", fontsize=8)
    axes[-1, 0].set_xlabel("time (s)")
    figure.align_ylabels()
    axes[0, 0].set_title(title)
    return _save(figure, folder / "run.png")


def plot_comparison(
    frames: Mapping[str, pd.DataFrame],
    channels: Sequence[str],
    units: Mapping[str, str],
    transient: float,
    path: Path,
) -> Path:
    """Draw histories (left, the last part of the run) and power spectral densities (right), one row per channel."""
    from optimisation.evaluation import power_spectral_density

    figure, axes = _panels(len(channels), 2, width=13.0, height=2.2)
    for (left, right), channel in zip(axes, channels, strict=True):
        unit = units.get(channel, "")
        for colour, (label, frame) in zip(_cycle(len(frames)), frames.items(), strict=True):
            time, values = frame.index.to_numpy(), frame[channel].to_numpy()
            shown = time >= max(transient, time[-1] - HISTORY_SECONDS)
            left.plot(time[shown], values[shown], color=colour, linewidth=0.9, label=label)
            spectrum = power_spectral_density(time, values, transient=transient)
            low = (spectrum.frequency > 0.0) & (spectrum.frequency <= SPECTRUM_HZ)
            right.semilogy(spectrum.frequency[low], spectrum.density[low], color=colour, linewidth=0.9, label=label)
        left.set_ylabel(f"{channel} ({unit})")
        right.set_ylabel(f"({unit})²/Hz")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=len(frames))
    axes[0, 0].set_title("history")
    axes[0, 1].set_title(f"power spectral density (Welch, Hann window, segments of {spectrum.segment:.0f} s)")
    axes[-1, 0].set_xlabel("time (s)")
    axes[-1, 1].set_xlabel("frequency (Hz)")
    return _save(figure, path)


def _panels(
    rows: int, columns: int, *, width: float, height: float, sharex: Literal["col", "none"] = "col"
) -> tuple[Figure, Any]:
    figure = Figure(figsize=(width, height * rows + 0.8), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(rows, columns, squeeze=False, sharex=sharex)
    for axis in axes.ravel():
        axis.grid(alpha=0.3)
    return figure, axes


def _cycle(n: int) -> list[str]:
    return [COLOURS[i % len(COLOURS)] for i in range(n)]


def _save(figure: Figure, path: Path) -> Path:
    figure.savefig(path, dpi=110)
    return path


def plot_convergence(table: pd.DataFrame, title: str, path: Path) -> Path:
    """Draw error against step, one line per scheme, with the slopes of first and second order."""
    figure, axes = _panels(1, 1, width=8.0, height=5.5)
    axis = axes[0, 0]
    for colour, marker, (label, part) in zip(_cycle(9), "osv^D*X<>", table.groupby("scheme", sort=False), strict=False):
        axis.loglog(part["step"], part["error"], marker=marker, color=colour, label=str(label), linewidth=1.2)
    steps = np.array([table["step"].min(), table["step"].max()])
    finite = table["error"][np.isfinite(table["error"])]
    for order, style in ((1, ":"), (2, "--")):
        axis.loglog(steps, 0.3 * finite.max() * (steps / steps[1]) ** order, style, color="#999999",
                    label=f"slope {order}", linewidth=1.0)  # fmt: skip
    marks = sorted(table["step"].unique())
    axis.set_xticks(marks, [f"{1e3 * h:.4g}" for h in marks])
    axis.minorticks_off()
    axis.set_xlabel("communication step (ms)")
    axis.set_ylabel("largest error / standard deviation (-)")
    axis.set_title(title, fontsize=10)
    axis.grid(True, which="both", alpha=0.25)
    figure.legend(fontsize=8, loc="outside lower center", ncols=3)
    return _save(figure, path)
