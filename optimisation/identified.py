"""What an identification found, and the files it leaves: result.json, a parameter set (.ssv), a picture."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from optimisation.identification import CHANNELS, UNKNOWNS, Fit, Identification

BASE_UNITS = {
    "kg.m2": {"kg": 1, "m": 2},
    "N.m/rad": {"kg": 1, "m": 2, "s": -2, "rad": -1},
    "N.m.s/rad": {"kg": 1, "m": 2, "s": -1, "rad": -1},
}
CHANNEL_UNITS = ("deg", "m")


def content(result: Identification, fits: Sequence[Fit], paper: Sequence[Fit]) -> dict[str, Any]:
    """All figures in SI units (channels in deg and m), as plain numbers, lists and dictionaries.

    Args:
        fits: of the identified set; paper: of table 3, for the same records.
    """
    return {
        "unknowns": {
            u.name: {
                "value": result.values[u.name], "unit": u.unit,
                "standard_error": result.values[u.name] * result.standard_errors[u.name],
                "relative_standard_error": result.standard_errors[u.name],
                "paper": u.paper, "ratio": result.values[u.name] / u.paper, "first_guess": u.first_guess,
            }
            for u in UNKNOWNS
        },
        "identifiable": result.identifiable,
        "weakest": result.weakness,
        "weak_direction": dict(zip((u.name for u in UNKNOWNS), result.weak_direction.tolist(), strict=True)),
        "singular_values": result.singular_values.tolist(),
        "correlation": result.correlation.tolist(),
        "mean_squared_error": result.cost,
        "evaluations": result.evaluations,
        "records": [
            {
                "record": fit.decay.label, "fitted": fit.fitted, "R2": fit.r2, "residual_rms": fit.residual_rms,
                "R2_paper": published.r2, "residual_rms_paper": published.residual_rms,
            }
            for fit, published in zip(fits, paper, strict=True)
        ],
    }  # fmt: skip


def write_json(found: Mapping[str, Any], path: Path) -> Path:
    """Write what `content` gives as JSON; numbers that are not finite become null."""
    plain = json.loads(json.dumps(found), parse_constant=lambda _: None)
    path.write_text(json.dumps(plain, indent=2) + "\n", encoding="utf-8")
    return path


def write_ssv(name: str, values: Mapping[str, float], path: Path) -> Path:
    """Write values of the unknowns as an SSP 1.0 parameter set of the simplified model."""
    from pyssp_standard.ssv import SSV

    with SSV(path, mode="w") as parameter_set:
        parameter_set.ssv_elem.name = name
        for u in UNKNOWNS:
            parameter_set.add_parameter(u.name, "Real", value=float(f"{values[u.name]:.6g}"), unit=u.unit)
        for unit, base in BASE_UNITS.items():
            parameter_set.add_unit(unit, base)
    return path


def plot(fits: Sequence[Fit], path: Path) -> Path:
    """Draw each record with the simplified model over it as PNG (the paper's figures 4 and 5)."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.0, 2.1 * len(fits) * len(CHANNELS) + 0.6), layout="constrained")
    FigureCanvasAgg(figure)
    panels = iter(figure.subplots(len(fits) * len(CHANNELS), 1, squeeze=False).ravel())
    for fit in fits:
        time = fit.decay.spacing * np.arange(len(fit.model))
        for i, (channel, unit) in enumerate(zip(CHANNELS, CHANNEL_UNITS, strict=True)):
            axes = next(panels)
            axes.plot(time, fit.decay.values[:, i], color="black", linewidth=1.4, label="record")
            axes.plot(time, fit.model[:, i], color="#d55e00", linewidth=0.9, label="simplified model, identified")
            axes.set_ylabel(f"{channel} ({unit})")
            axes.set_xlim(0.0, min(time[-1], 100.0))
            axes.grid(alpha=0.3)
            how = "fitted" if fit.fitted else "predicted"
            axes.set_title(f"{fit.decay.label}, {how}: R2 = {fit.r2[channel]:.4f}", fontsize=9)
    axes.set_xlabel("time after the release (s)")
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=2)
    figure.savefig(path, dpi=130)
    return path
