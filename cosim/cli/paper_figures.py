"""Figures 4 to 7 of Wang et al. (2022), redrawn from this project's own results; each with its numbers as CSV."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from cosim.cli.plots import COLOURS, _panels, _save

if TYPE_CHECKING:
    from optimisation.identification import Fit
    from optimisation.result import OptimisationResult

Array = npt.NDArray[np.float64]

SHOWN_SECONDS = 100.0
SHOWN_HZ = 0.7
PADDING = 8  # zeros after the record, in its lengths: a smooth line between the frequencies that it resolves
LABELS = {"none": "no damper", "tmd-n": "TMD-N", "tmd-p": "TMD-P", "mtmd": "MTMD"}
STOPS = {"NStC1_XQ": 8.0, "SStC1_XQ": 18.0}  # m: the paper's strokes


def fourier_amplitude(values: Array, spacing: float) -> tuple[Array, Array]:
    """Frequencies (Hz) up to 0.7 Hz and the amplitude of the Fourier transform of a record without its mean.

    Args:
        values: equally spaced, shape (n,); spacing: s. A sinusoid of amplitude a that fills the record gives a.
    """
    size = values.size * (PADDING + 1)
    amplitude = 2.0 / values.size * np.abs(np.fft.rfft(values - values.mean(), size))
    frequency = np.fft.rfftfreq(size, spacing)
    low = frequency <= SHOWN_HZ
    return np.asarray(frequency[low], dtype=float), np.asarray(amplitude[low], dtype=float)


def draw_decays(own: Fit, paper: Fit, title: str, path: Path) -> Path:
    """Figures 4 and 5: the coupled model's decay beside the simplified one's with either set, and their spectra.

    Args:
        own, paper: the same record with the identified set and with table 3's.
        path: of the PNG; the histories go to a CSV beside it (deg, m).
    """
    from optimisation.identification import CHANNELS

    spacing = own.decay.spacing
    time: Array = spacing * np.arange(len(own.model), dtype=float)
    lines = {"coupled model": own.decay.values, "simplified, table 3": paper.model, "simplified, identified": own.model}
    figure, axes = _panels(2, 2, width=12.0, height=2.9)
    columns: dict[str, Array] = {"Time": time}
    for i, (channel, unit) in enumerate(zip(CHANNELS, ("deg", "m"), strict=True)):
        for (label, values), (colour, style) in zip(
            lines.items(), (("black", "-"), (COLOURS[1], "--"), ("#d55e00", "-")), strict=True
        ):
            r2 = {"simplified, table 3": paper, "simplified, identified": own}.get(label)
            note = f", R2 {r2.r2[channel]:.3f}" if r2 else ""
            axes[i, 0].plot(time, values[:, i], style, color=colour, linewidth=1.0, label=label + note)
            axes[i, 1].plot(*fourier_amplitude(values[:, i], spacing), style, color=colour, linewidth=1.0)
            columns[f"{channel} {label} ({unit})"] = values[:, i]
        axes[i, 0].set_ylabel(f"{channel} ({unit})")
        axes[i, 1].set_ylabel(f"amplitude ({unit})")
        axes[i, 0].legend(fontsize=7, loc="upper right")
    _finish(figure, axes, title)
    pd.DataFrame(columns).to_csv(path.with_suffix(".csv"), index=False)
    return _save(figure, path)


def draw_convergence(results: Sequence[OptimisationResult], path: Path) -> Path:
    """Figure 6: best and mean fitness over the generations of the genetic algorithm, one panel per damper."""
    from optimisation.objective import design

    figure, axes = _panels(1, len(results), width=13.0, height=3.4)
    rows = []
    for axis, r in zip(axes[0], results, strict=True):
        number = [g.number for g in r.history]
        axis.plot(number, [g.mean for g in r.history], color="#999999", linewidth=1.0, label="mean of the population")
        axis.plot(number, [g.best for g in r.history], color=COLOURS[1], linewidth=1.6, label="best individual")
        axis.axhline(design(r.damper).paper_fitness, color="#d55e00", linestyle="--", label="paper, table 4")
        axis.axhline(r.undamped_fitness, color="black", linestyle=":", label="no damper")
        axis.set_title(f"{LABELS[r.damper]}: {r.fitness:.4f} m", fontsize=10)
        axis.set_xlabel("generation")
        rows += [{"damper": r.damper, "generation": g.number, "best": g.best, "mean": g.mean} for g in r.history]
    axes[0, 0].set_ylabel("standard deviation of\ntower-top displacement (m)")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, fontsize=9)
    pd.DataFrame(rows).to_csv(path.with_suffix(".csv"), index=False)
    return _save(figure, path)


def draw_damped_decays(frames: Mapping[str, pd.DataFrame], title: str, path: Path) -> Path:
    """Figure 7: A, B histories of tower-top displacement and pitch, C, D their spectra, E, F the dampers' displacement.

    Args:
        frames: by damper arrangement, indexed by time (s): PtfmPitch (deg), TTDspFA, NStC1_XQ, SStC1_XQ (m).
    """
    figure, axes = _panels(3, 2, width=12.0, height=2.5, sharex="none")
    table: dict[str, Array] = {}
    for (damper, frame), colour in zip(frames.items(), ("black", *COLOURS[1:]), strict=False):
        time = frame.index.to_numpy()
        table["Time"] = time
        for column, (channel, unit) in enumerate((("TTDspFA", "m"), ("PtfmPitch", "deg"))):
            values = frame[channel].to_numpy()
            axes[0, column].plot(time, values, color=colour, linewidth=0.9, label=LABELS[damper])
            axes[1, column].plot(*fourier_amplitude(values, float(time[1] - time[0])), color=colour, linewidth=1.0)
            table[f"{channel} {damper} ({unit})"] = values
        for column, (channel, present) in enumerate((("NStC1_XQ", ("tmd-n", "mtmd")), ("SStC1_XQ", ("tmd-p", "mtmd")))):
            if damper in present:
                axes[2, column].plot(time, frame[channel], color=colour, linewidth=0.9)
                table[f"{channel} {damper} (m)"] = frame[channel].to_numpy()
    for column, (what, damper) in enumerate((("TTDspFA (m)", "nacelle"), ("PtfmPitch (deg)", "platform"))):
        axes[0, column].set_ylabel(what)
        axes[1, column].set_ylabel(f"amplitude of\n{what}")
        axes[2, column].set_ylabel(f"{damper} damper\nin its body (m)")
        for stop in (1, -1):
            axes[2, column].axhline(stop * list(STOPS.values())[column], color="grey", linestyle=":", linewidth=0.8)
    for axis, letter in zip((*axes[0], *axes[1], *axes[2]), "ABCDEF", strict=True):
        axis.set_title(letter, loc="left", fontsize=9, fontweight="bold")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(frames))
    for row, label, limit in zip(
        axes, ("time (s)", "frequency (Hz)", "time (s)"), (SHOWN_SECONDS, SHOWN_HZ, SHOWN_SECONDS), strict=True
    ):
        for axis in row:
            axis.set_xlim(0.0, limit)
            axis.set_xlabel(label)
    figure.suptitle(title, fontsize=10)
    pd.DataFrame(table).to_csv(path.with_suffix(".csv"), index=False)
    return _save(figure, path)


def _finish(figure: Any, axes: Any, title: str) -> None:
    axes[0, 0].set_xlim(0.0, SHOWN_SECONDS)
    axes[0, 1].set_xlim(0.0, SHOWN_HZ)
    axes[-1, 0].set_xlabel("time after the release (s)")
    axes[-1, 1].set_xlabel("frequency (Hz)")
    axes[0, 1].set_title("Fourier amplitude", fontsize=9)
    figure.suptitle(title, fontsize=10)
