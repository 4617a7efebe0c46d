"""Picture of a linear model: how its rails respond to their masses, and spectra without and with dampers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from cosim.cli.plots import COLOURS, SPECTRUM_HZ, _panels, _save
from optimisation.evaluation import power_spectral_density
from optimisation.receptance import LinearModel


def plot_linear(model: LinearModel, damped: npt.NDArray[np.float64] | None, path: Path) -> Path:
    """Draw specific forces per displacement of the masses, and spectra of up to four channels.

    Args:
        damped: histories (n, C + D) with the given springs and dashpots, or None.
    """
    count, shown = len(model.channels), range(min(4, len(model.channels)))
    figure, axes = _panels(1 + (len(shown) + 1) // 2, 2, width=12.0, height=2.6)
    for i, (axis, damper) in enumerate(zip(axes[0], model.dampers, strict=False)):
        for j, moved in enumerate(model.dampers):
            gain = np.abs(model.gain[:, count + i, j])
            axis.semilogy(model.frequencies, gain, color=COLOURS[1 + j], label=f"{moved.name} moved")
        axis.set_ylabel("|a / s| (1/s²)")
        axis.set_title(f"specific force at the {damper.name}", fontsize=10)
        axis.legend(fontsize=8)
    held = model.histories(model.base[:, :count].T)
    for channel, axis in zip(shown, axes[1:].ravel(), strict=False):
        curves = [("masses held", held[channel], COLOURS[0])]
        if damped is not None:
            curves.append(("given dampers, predicted", damped[:, channel], COLOURS[2]))
        for label, record, colour in curves:
            time = np.linspace(0.0, model.stop - model.start, len(record))
            spectrum = power_spectral_density(time, record, transient=0.0)
            low = (spectrum.frequency > 0.0) & (spectrum.frequency <= SPECTRUM_HZ)
            axis.semilogy(spectrum.frequency[low], spectrum.density[low], color=colour, label=label, linewidth=0.9)
        axis.set_ylabel(f"{model.channels[channel]} (({model.units[channel]})²/Hz)", fontsize=9)
        axis.legend(fontsize=8)
    for axis in axes[-1]:
        axis.set_xlabel("frequency (Hz)")
    figure.suptitle(f"{model.label}: response to the dampers' masses, and spectra (Welch)", fontsize=11)
    return _save(figure, path)
