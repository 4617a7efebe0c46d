"""The files that a search over scenarios leaves: result.json and a picture."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from optimisation.checkpoint import write_atomically
from optimisation.result import plain
from optimisation.scenario_tuning import ScenarioResult
from optimisation.scenarios import WORDS


def content(result: ScenarioResult) -> dict[str, Any]:
    """The result as JSON; SI units, standard deviations in the channels' units."""
    rows = [
        {
            "scenario": label,
            "std": dict(zip(result.channels, result.deviations[s].tolist(), strict=True)),
            "reference": dict(zip(result.channels, result.reference[s].tolist(), strict=True)),
            "ratio": dict(zip(result.channels, result.ratios[s].tolist(), strict=True)),
        }
        for s, label in enumerate(result.scenarios)
    ]
    surrogate = result.left_out and {
        "response_rms_relative_error": result.left_out.responses.tolist(),
        "fitness_rms_error": result.left_out.fitness,
        "fitness_spread": result.left_out.spread,
        "designs": result.left_out.designs,
    }
    found = {
        "damper": result.damper,
        "method": result.method,
        "objective": result.objective,
        "fitness": result.fitness,
        "parameters": result.parameters,
        "aggregate": result.how,
        "relative_to": result.relative_to,
        "scenarios": rows,
        "starts": [asdict(start) for start in result.starts],
        "surrogate": surrogate,
        "evaluations": result.evaluations,
        "failures": result.failures,
        "first_failure": result.first_failure,
        "bounds": {v.name: [v.lower, v.upper] for v in result.task.variables},
        "at_bound": list(result.at_bound),
        "seed": result.seed,
        "seconds": result.seconds,
        "history": [
            {"generation": g.number, "best": g.best, "mean": g.mean, "evaluations": g.evaluations}
            for g in result.history
        ],
    }
    return dict(plain(found))


def write_json(result: ScenarioResult, path: Path) -> Path:
    """Write the result as JSON."""
    return write_atomically(path, json.dumps(content(result), indent=2, allow_nan=False) + "\n")


def plot_search(result: ScenarioResult, path: Path) -> Path:
    """Draw the fitness over the designs evaluated, and the best design's ratios in each scenario, as PNG."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11.0, 4.6), layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2, width_ratios=(3, 2))
    number = [g.evaluations for g in result.history]
    best = [g.best for g in result.history]
    if result.left_out:
        number, best = list(range(1, len(result.values) + 1)), np.minimum.accumulate(result.values).tolist()
        values = np.where(np.isfinite(result.values), result.values, np.nan)
        left.plot(number, values, "o", ms=4, color="tab:grey", label="designs")
        first = result.history[0].evaluations
        left.axvline(first + 0.5, color="tab:grey", linestyle=":", label="surrogate proposes from here on")
    else:
        left.plot(number, [g.mean for g in result.history], color="tab:grey", label="mean of the population")
    left.step(number, best, where="post", color="tab:blue", label="best so far")
    left.plot(number[int(np.argmin(best))], result.fitness, "*", ms=13, color="tab:blue", mec="black")
    for colour, start in zip(("tab:orange", "tab:green", "tab:purple", "tab:pink"), result.starts, strict=False):
        left.axhline(start.fitness, color=colour, linestyle="--", label=f"{start.label}: {start.fitness:.4f}")
    left.set_xlabel("designs evaluated")
    how = WORDS[result.how]
    left.set_ylabel(f"{how} ratio of standard deviations\nto those with '{result.relative_to}'")
    left.set_title(f"{result.damper.upper()}, {result.objective}: best {result.fitness:.4f} ({result.method})")
    left.grid(alpha=0.3)
    rows = np.arange(len(result.scenarios))
    height = 0.8 / len(result.channels)
    for c, channel in enumerate(result.channels):
        right.barh(rows + c * height, result.ratios[:, c] - 1.0, height, left=1.0, label=channel)
    right.axvline(1.0, color="black", linewidth=1.0)
    right.set_xlim(min(0.95, float(result.ratios.min()) - 0.02), max(1.05, float(result.ratios.max()) + 0.02))
    right.set_ylim(max(3.0, len(rows)) - 0.3, -0.7)
    right.set_yticks(rows + 0.4 - height / 2, result.scenarios)
    right.set_xlabel(f"standard deviation / that with '{result.relative_to}'")
    right.set_title("best design")
    right.grid(alpha=0.3, axis="x")
    right.legend(loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=3, fontsize=8)
    figure.legend(*left.get_legend_handles_labels(), loc="outside lower left", ncols=3, fontsize=8)
    figure.savefig(path, dpi=150)
    return path
