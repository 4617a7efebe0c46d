"""Interactive figures against time and frequency: wind field, histories, spectra."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
import plotly.graph_objects as go

from optimisation.report.figures import Variant, base_figure
from optimisation.report.study import Study, WindField
from optimisation.report.style import (
    EXCITATIONS,
    case_name,
    channel_name,
    colours,
    damper_name,
    envelope,
    number,
    readable_unit,
)

BUCKETS = 800
FIRST_SECONDS = 200.0
SPECTRUM_HZ = 0.7
EXCITATION_COLOUR = "#7a7aa8"


def wind_field(wind: WindField) -> Variant:
    """Wind speed over time and height on the vertical line through the hub."""
    figure = base_figure(330, "height above sea (m)", "time (s)", legend=False)
    figure.add_heatmap(
        x=wind.time.astype(np.float32), y=wind.height, z=np.round(wind.speed, 1).astype(np.float32),
        colorscale="Cividis", colorbar={"title": {"text": "m/s"}, "thickness": 12},
        hovertemplate="t = %{x:.0f} s, z = %{y:.0f} m: %{z:.1f} m/s<extra></extra>",
    )  # fmt: skip
    figure.update_yaxes(zeroline=False)
    rows = np.linspace(0, len(wind.height) - 1, min(6, len(wind.height))).round().astype(int)[::-1]
    table = pd.DataFrame({
        "height (m)": [number(wind.height[i]) for i in rows],
        "mean (m/s)": [number(wind.speed[i].mean()) for i in rows],
        "STD (m/s)": [number(wind.speed[i].std(), 3) for i in rows],
        "min (m/s)": [number(wind.speed[i].min()) for i in rows],
        "max (m/s)": [number(wind.speed[i].max()) for i in rows],
    })  # fmt: skip
    caption = (
        f"{case_name(wind.case)}, seed {wind.seed}: wind along its mean direction above and below the hub, means"
        f" over {wind.time[1] - wind.time[0]:.1f} s; {wind.speed.min():.1f} to {wind.speed.max():.1f} m/s, mean"
        f" {wind.speed.mean():.1f} m/s. The rotor turns in this field, which spans its disc."
    )
    return Variant(figure, caption, table)


def histories(study: Study, case: str, channels: Sequence[str]) -> Variant | None:
    """Histories of one case and seed, a row per channel, all arrangements; None where no run is complete."""
    frames = {d: study.histories[case, d] for d in study.dampers if (case, d) in study.histories}
    shown = [c for c in channels if any(c in f.columns for f in frames.values())]
    if not shown:
        return None
    rows, gap = len(shown), 0.045
    figure = base_figure(110 + 165 * rows, "", "time (s)")
    layout = {}
    span = (1.0 - gap * (rows - 1)) / rows
    named: set[str] = set()
    for i, channel in enumerate(shown):
        suffix = "" if i == 0 else str(i + 1)
        top = 1.0 - i * (span + gap)
        unit = readable_unit(study.units.get(channel, ""))
        layout[f"yaxis{suffix}"] = {
            "domain": [max(0.0, top - span), top], "title": {"text": f"{channel}<br>({unit})", "standoff": 6},
            "automargin": True, "zeroline": False, "anchor": "x",
        }  # fmt: skip
        for damper, frame in frames.items():
            if channel in frame.columns and not (channel in EXCITATIONS and damper != next(iter(frames))):
                _trace(figure, study, channel, damper, frame, f"y{suffix}", named)
    end = max(float(f.index[-1]) for f in frames.values())
    first = study.transient(case)
    layout["xaxis"] = {
        "title": {"text": "time (s)"}, "anchor": f"y{rows}" if rows > 1 else "y", "domain": [0, 1],
        "range": [first, min(end, first + FIRST_SECONDS)], "automargin": True,
    }  # fmt: skip
    figure.update_layout(layout, hovermode="x")
    return Variant(figure, _history_caption(study, case, end), _history_table(study, case, frames, shown))


def _trace(
    figure: go.Figure, study: Study, channel: str, damper: str, frame: pd.DataFrame, axis: str, named: set[str]
) -> None:
    excitation = channel in EXCITATIONS
    time, values = envelope(frame.index.to_numpy(), frame[channel].to_numpy(), BUCKETS)
    label = "wind and waves" if excitation else damper_name(damper)
    figure.add_scatter(
        x=time.astype(np.float32), y=values.astype(np.float32), mode="lines", xaxis="x", yaxis=axis,
        name=label, legendgroup=label, showlegend=label not in named,
        line={"width": 1.3, "color": EXCITATION_COLOUR if excitation else colours(study.dampers)[damper]},
        hovertemplate="%{y:,.4~g} " + readable_unit(study.units.get(channel, "")),
    )  # fmt: skip
    named.add(label)


def _history_caption(study: Study, case: str, end: float) -> str:
    zoom = " Drag to zoom, double-click to see all." if end > study.transient(case) + FIRST_SECONDS else ""
    return (
        f"{case_name(case)} ({study.text(case)}), seed {study.history_seeds[case]}: one seed of"
        f" {len(study.seeds)}. Drawn thinned to the lowest and highest sample of every {end / BUCKETS:.2g} s, so that"
        f" peaks stay.{zoom} The table gives the statistics of this seed from {study.transient(case):g} s on."
    )


def _history_table(study: Study, case: str, frames: dict[str, pd.DataFrame], channels: Sequence[str]) -> pd.DataFrame:
    rows = []
    for channel in channels:
        for damper, frame in frames.items():
            if channel in frame.columns and not (channel in EXCITATIONS and damper != next(iter(frames))):
                x = frame.loc[frame.index >= study.transient(case), channel]
                rows.append({
                    "channel": f"{channel} ({readable_unit(study.units.get(channel, ''))})",
                    "arrangement": "all" if channel in EXCITATIONS else damper_name(damper),
                    "mean": number(x.mean()), "STD": number(x.std(ddof=0)),
                    "min": number(x.min()), "max": number(x.max()),
                })  # fmt: skip
    return pd.DataFrame(rows)


def spectrum(study: Study, case: str, channel: str) -> Variant | None:
    """Power spectral density of a channel in one case, averaged over seeds; None where there is none."""
    spectra = study.spectra.get((case, channel))
    if not spectra:
        return None
    unit = readable_unit(study.units.get(channel, ""))
    squared = f"({unit})²/Hz" if "·" in unit else f"{unit}²/Hz"
    figure = base_figure(320, f"PSD ({squared})", "frequency (Hz)")
    rows, peaks = [], []
    for damper in [d for d in study.dampers if d in spectra]:
        s = spectra[damper]
        low = (s.frequency > 0.0) & (s.frequency <= SPECTRUM_HZ)
        frequency, density = s.frequency[low], s.density[low]
        figure.add_scatter(
            x=frequency.astype(np.float32), y=density.astype(np.float32), mode="lines", name=damper_name(damper),
            line={"width": 1.6, "color": colours(study.dampers)[damper]}, hovertemplate="%{x:.3f} Hz: %{y:.4~g}",
        )  # fmt: skip
        top = int(density.argmax())
        rows.append({
            "arrangement": damper_name(damper), "peak at (Hz)": f"{frequency[top]:.3f}",
            f"peak density ({squared})": number(density[top], 4),
            f"STD up to {SPECTRUM_HZ:g} Hz ({unit})": number(float(np.sqrt(np.trapezoid(density, frequency))), 4),
            "seeds": s.seeds,
        })  # fmt: skip
        peaks.append(f"{damper_name(damper)} {number(density[top], 3)} at {frequency[top]:.3f} Hz")
    figure.update_yaxes(type="log", exponentformat="power", dtick=1, zeroline=False)
    figure.update_xaxes(range=[0.0, SPECTRUM_HZ])
    how = (
        f"Welch's method, Hann window, segments of {s.segment:.0f} s, half overlapping;"
        f" averaged over {s.seeds} seed{'s' * (s.seeds > 1)}."
    )
    caption = f"{channel_name(channel)} in {case_name(case)}; peaks ({squared}): {'; '.join(peaks)}. {how}"
    return Variant(figure, caption, pd.DataFrame(rows))
