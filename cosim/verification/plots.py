"""Pictures of a comparison: histories and spectra laid over each other, and curves of single figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator
from scipy.signal import welch

from cosim.verification.metrics import cut
from cosim.verification.plan import Comparison
from cosim.verification.reference import Record
from cosim.verification.table import Row

Array = npt.NDArray[np.float64]
REFERENCE, OURS = "#444444", "#d55e00"
ZOOM = 150.0  # s
SEGMENT = 200.0  # s, of Welch's estimate
WELCH = "power spectral density (Welch, Hann)"
SPECTRUM_HZ = 0.7  # upper end of the spectra, unless a mode above it is compared


def plot_histories(
    comparison: Comparison, reference: Record, run: Record, units: Mapping[str, str], label: str, path: Path
) -> Path | None:
    """Per channel: the whole window, an enlarged part of it, power spectral densities; None without channels."""
    channels = [c for c in comparison.channels if c in reference.channels and c in run.channels]
    if not channels:
        return None
    figure = _figure(15.0, 2.1 * len(channels) + 1.0)
    axes = figure.subplots(len(channels), 3, squeeze=False, sharex="col", width_ratios=(1.3, 1.3, 1.0))
    highest = max([SPECTRUM_HZ, *(1.3 * c.near for c in comparison.checks)])
    for (full, part, spectrum), channel in zip(axes, channels, strict=True):
        unit = units.get(channel, "")
        for record, colour, name, width in ((reference, REFERENCE, label, 1.6), (run, OURS, "this model", 0.8)):
            time, x = cut(record, channel, comparison.window, unit)
            style: dict[str, Any] = {"color": colour, "linewidth": width, "label": name}
            full.plot(time, x, **style)
            shown = _zoomed(time)
            part.plot(time[shown], x[shown], **style)
            frequency, density = _spectrum(time, x)
            low = (frequency > 0.0) & (frequency <= highest)
            draw = spectrum.semilogy if np.any(density[low] > 0.0) else spectrum.plot  # a still record has no spectrum
            draw(frequency[low], density[low], **style)
        full.set_ylabel(f"{channel}\n({unit})" if unit else channel)
        spectrum.set_ylabel(f"({unit})²/Hz" if unit else "1/Hz")
        _shorten(spectrum)
    for k, (title, unit) in enumerate((("history", "s"), ("part of it", "s"), (WELCH, "Hz"))):
        axes[0, k].set_title(title, fontsize=10)
        axes[-1, k].set_xlabel(f"{'frequency' if unit == 'Hz' else 'time'} ({unit})")
    return _finish(figure, axes, comparison.name, path)


def plot_curve(
    name: str, comparisons: Sequence[Comparison], rows: Sequence[Row], label: str, path: Path
) -> Path | None:
    """Every quantity of the comparisons of a curve against what tells them apart; None if there are fewer than two."""
    at = {c.name: c.curve.at for c in comparisons if c.curve}
    axis = next((c.curve.axis for c in comparisons if c.curve), "")
    kinds = list(dict.fromkeys((r.channel, r.quantity) for r in rows if r.comparison in at and np.isfinite(r.ours)))
    if len({r.comparison for r in rows if r.comparison in at}) < 2 or not kinds:
        return None
    columns = min(3, len(kinds))
    height = -(-len(kinds) // columns)
    figure = _figure(4.6 * columns, 3.0 * height + 0.6, gap=0.3, between=0.32)
    axes = figure.subplots(height, columns, squeeze=False)
    for panel, (channel, quantity) in zip(axes.ravel(), kinds, strict=False):
        points = sorted(
            (at[r.comparison], r) for r in rows if r.comparison in at and (r.channel, r.quantity) == (channel, quantity)
        )
        x = [p[0] for p in points]
        panel.plot(x, [p[1].reference for p in points], "o-", color=REFERENCE, markersize=7, linewidth=1.6, label=label)
        panel.plot(x, [p[1].ours for p in points], "x--", color=OURS, markersize=7, linewidth=1.0, label="this model")
        unit = points[0][1].unit
        panel.set_ylabel(f"{channel}, {quantity}" + (f" ({unit})" if unit else ""))
        panel.set_xlabel(axis)
    for panel in axes.ravel()[len(kinds) :]:
        panel.set_visible(False)
    return _finish(figure, axes, name, path)


def _figure(width: float, height: float, gap: float = 0.06, between: float = 0.2) -> Figure:
    """A figure with margins in inches: laying it out by its texts takes longer than drawing it."""
    figure = Figure(figsize=(width, height))
    FigureCanvasAgg(figure)
    figure.subplots_adjust(
        left=1.25 / width, right=1.0 - 0.15 / width, bottom=0.85 / height, top=1.0 - 0.65 / height,
        wspace=between, hspace=gap,
    )  # fmt: skip
    return figure


def _zoomed(time: Array) -> npt.NDArray[np.bool_]:
    """The middle part of a long record, the first part of a decay that fits twice into it or less."""
    length = min(ZOOM, (time[-1] - time[0]) / 3.0)
    begin = time[0] + (0.5 * (time[-1] - time[0] - length) if time[-1] - time[0] > 2.0 * ZOOM else 0.0)
    return (time >= begin) & (time <= begin + length)


def _spectrum(time: Array, x: Array) -> tuple[Array, Array]:
    step = (time[-1] - time[0]) / (time.size - 1)
    count = min(time.size, round(SEGMENT / step))
    frequency, density = welch(x, 1.0 / step, window="hann", nperseg=count, noverlap=count // 2, detrend="constant")
    return np.asarray(frequency), np.asarray(density)


def _shorten(axis: Any) -> None:
    """Keep the six decades below the peak: what lies deeper is numerical noise."""
    top = max(float(np.max(line.get_ydata())) for line in axis.lines)
    if top > 0.0:
        low, _ = axis.get_ylim()
        axis.set_ylim(max(low, 1e-6 * top), 3.0 * top)
    axis.yaxis.set_minor_locator(NullLocator())


def _finish(figure: Figure, axes: Any, title: str, path: Path) -> Path:
    for axis in axes.ravel():
        axis.grid(alpha=0.3)
    handles, labels = axes.ravel()[0].get_legend_handles_labels()
    figure.suptitle(title)
    figure.legend(handles, labels, loc="lower center", ncols=2, frameon=False)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=100)
    return path
