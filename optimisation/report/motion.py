"""Data of the side view in motion: what moves, at 10 Hz, in 16-bit integers."""

from __future__ import annotations

import base64
import math
from typing import Any

import numpy as np

from optimisation.report.study import Study
from optimisation.report.style import (
    case_name,
    colours,
    damper_name,
)

RATE = 10.0  # Hz
SECONDS = 300.0
MOVING = ("PtfmSurge", "PtfmHeave", "PtfmPitch", "TTDspFA", "NStC1_XQ", "SStC1_XQ")
WAVES = "Wave1Elev"
GRAVITY = 9.80665


def motion_data(study: Study) -> dict[str, Any]:
    """All that the side view needs, ready for JSON; empty cases where no run is complete.

    Per case: `t0` (s), `n` samples, `waves` and, per arrangement, the channels, each {"lo", "hi", "data"}: 16-bit
    integers in base64 that span lo to hi; `c`, the phase speed of the sea's peak (m/s).
    """
    cases = {}
    for case in study.cases:
        frames = {d: study.histories[case, d] for d in study.dampers if (case, d) in study.histories}
        if not frames or not {"PtfmPitch", "TTDspFA"} <= set(next(iter(frames.values())).columns):
            continue
        first = next(iter(frames.values()))
        start = min(study.transient(case), float(first.index[-1]) / 2.0)
        end = min(start + SECONDS, *(float(f.index[-1]) for f in frames.values()))
        time = np.arange(start, end, 1.0 / RATE)
        content: dict[str, Any] = {
            "name": case_name(case), "text": study.text(case), "seed": study.history_seeds[case],
            "t0": start, "n": len(time), "rate": RATE, "c": phase_speed(*_sea(study, case)), "runs": {},
        }  # fmt: skip
        if WAVES in first.columns:
            content["waves"] = packed(np.interp(time, first.index, first[WAVES]))
        for damper, frame in frames.items():
            content["runs"][damper] = {
                c: packed(np.interp(time, frame.index, frame[c])) for c in MOVING if c in frame.columns
            }
        cases[case] = content
    return {
        "cases": cases,
        "dampers": {d: {"name": damper_name(d), "colour": c} for d, c in colours(study.dampers).items()},
        "reference": study.reference,
        "limits": study.limits(),
    }


def packed(values: np.ndarray[Any, np.dtype[np.float64]]) -> dict[str, Any]:
    """Values as little-endian 16-bit integers between their bounds: an error of at most 1/131070 of their range."""
    low, high = float(values.min()), float(values.max())
    scaled = np.zeros(len(values)) if high == low else (values - low) / (high - low)
    data = base64.b64encode(np.round(scaled * 65535.0).astype("<u2").tobytes()).decode("ascii")
    return {"lo": low, "hi": high, "data": data}


def phase_speed(period: float, depth: float) -> float:
    """Speed of a wave crest, m/s: linear theory, omega^2 = g k tanh(k depth), by Newton's method."""
    omega = 2.0 * math.pi / period
    k = omega**2 / GRAVITY
    for _ in range(50):
        tanh = math.tanh(k * depth)
        change = (GRAVITY * k * tanh - omega**2) / (GRAVITY * (tanh + k * depth * (1.0 - tanh**2)))
        k -= change
        if abs(change) < 1e-12 * k:
            break
    return omega / k


def _sea(study: Study, case: str) -> tuple[float, float]:
    """Peak period (s) and water depth (m) of a case, from its runs' parameters."""
    for run in study.runs:
        if run.case == case:
            for component in run.record.get("components", {}).values():
                if "Tp" in component.get("start", {}):
                    return float(component["start"]["Tp"]), float(component["start"].get("depth", 150.0))
    return 12.5, 150.0
