"""A campaign's folder of harmonic histories, whose statistics are known in closed form."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from optimisation.campaign.runs import rows_of_run, write_table

# Suppression of the standard deviation by case and arrangement, %; in lc4 not in the paper's order.
RATES = {
    "lc3": {"none": 0.0, "tmd-n": 5.0, "tmd-p": 8.0, "mtmd": 20.0},
    "lc4": {"none": 0.0, "tmd-n": 10.0, "tmd-p": 6.0, "mtmd": 18.0},
}
SCATTER = {1: -1.0, 2: 0.0, 3: 1.0}  # points of suppression rate by seed: no effect on the mean
FAILED = ("lc4", "mtmd", 3)
AMPLITUDES = {"TTDspFA": 0.6, "TwrBsMyt": 9e4, "PtfmPitch": 3.0, "RootMyc1": 4e3, "GenPwr": 300.0}
MEANS = {"GenPwr": 4900.0, "RootMyc1": 6e3, "TwrBsMyt": 4e4}
UNITS = {
    "PtfmSurge": "m", "PtfmHeave": "m", "Wind1VelX": "m/s", "Wave1Elev": "m", "TTDspFA": "m", "TwrBsMyt": "kN.m",
    "PtfmPitch": "deg", "RootMyc1": "kN.m", "GenPwr": "kW", "NStC1_XQ": "m", "SStC1_XQ": "m",
}  # fmt: skip
FREQUENCY, STEP, TRANSIENT, STOP = 0.08, 0.1, 30.0, 280.0  # 20 periods after the transient: exact statistics
CONNECTIONS = [
    "hydro.force[1] -> barge.hydro.force[1]", "hydro.force[2] -> barge.hydro.force[2]",
    "barge.platform.position[1] -> hydro.platform.position[1]",
    "nacelle_damper.force[1] -> barge.nacelle_damper.force[1]", "barge.hub.speed -> aero.hub.speed",
]  # fmt: skip
STROKES = {"NStC1_XQ": 8.0, "SStC1_XQ": 18.0}


def write_campaign(folder: Path) -> Path:
    """Two load cases, four arrangements, three seeds; one run failed."""
    rows: list[dict[str, Any]] = []
    runs = []
    for case, rates in RATES.items():
        for damper in rates:
            for seed in SCATTER:
                run = folder / "runs" / f"{case}-{damper}-seed{seed}"
                done = (case, damper, seed) != FAILED
                about = {"case": case, "damper": damper, "seed": seed, "transient": TRANSIENT, "strokes": STROKES}
                if done:
                    _write_run(run, case, damper, seed)
                    rows += rows_of_run(run, about)
                message = "" if done else "aero: left the <wind> field"
                runs.append({k: about[k] for k in ("case", "damper", "seed")} | {
                    "folder": f"runs/{run.name}", "key": "", "status": "done" if done else "failed", "message": message,
                })  # fmt: skip
    write_table(rows, folder / "runs.parquet")
    plan = {
        "command": "fowt campaign lc3 lc4 --seeds 1:3", "options": {}, "started": "2026-01-01T00:00:00+00:00",
        "cases": {c: {"description": f"{s:g} m/s", "wind_speed": s, "stop": STOP, "transient": TRANSIENT, "step": 0.01}
                  for c, s in {"lc3": 12.0, "lc4": 18.0}.items()},
        "dampers": list(RATES["lc3"]), "seeds": list(SCATTER), "runs": runs, "versions": {"python": "3"},
    }  # fmt: skip
    (folder / "campaign.json").write_text(json.dumps(plan))
    return folder


def _write_run(folder: Path, case: str, damper: str, seed: int) -> None:
    folder.mkdir(parents=True)
    time = np.arange(0.0, STOP, STEP)
    wave = np.sin(2.0 * np.pi * FREQUENCY * time + seed)
    scatter = 0.0 if damper == "none" else SCATTER[seed]
    left = 1.0 - (RATES[case][damper] + scatter) / 100.0
    columns = {c: MEANS.get(c, 0.0) + left * a * wave for c, a in AMPLITUDES.items()}
    columns |= {"PtfmSurge": 0.5 * wave, "PtfmHeave": 0.2 * wave, "Wind1VelX": 12.0 + wave, "Wave1Elev": 1.5 * wave}
    components: dict[str, Any] = {"barge": {}, "hydro": {"start": {"Hs": 3.0, "Tp": 12.5}}}
    if damper in ("tmd-n", "mtmd"):  # over its stop of 8 m in lc4
        columns["NStC1_XQ"] = (8.4 if case == "lc4" else 5.0) * np.sin(2.0 * np.pi * FREQUENCY * time)
        components["nacelle_damper"] = {"start": {"stroke": 8.0, "k": 6302.0}}
    if damper in ("tmd-p", "mtmd"):
        columns["SStC1_XQ"] = 9.0 * wave
        components["platform_damper"] = {"start": {"stroke": 18.0, "k": 53565.0}}
    frame = pd.DataFrame({"Time": time} | columns)
    units = {c: UNITS[c] for c in columns}
    table = pa.Table.from_pandas(frame, preserve_index=False)
    pq.write_table(table.replace_schema_metadata({"units": json.dumps(units)}), folder / "results.parquet")
    about = {"fmu": "gone.fmu", "sha256": "ab" * 32, "generator": "test"}
    record = {
        "status": "completed", "wall_time": 1.0, "connections": CONNECTIONS,
        "ports": {"hydro": {"crossed": 1e9, "residual": -12.0, "share": 1.2e-8}},
        "components": {n: {"start": {}} | about | content for n, content in components.items()},
        "settings": {"algorithm": "gauss-seidel", "extrapolation": "quadratic", "step": 0.0125, "decimation": 8},
    }  # fmt: skip
    (folder / "run.json").write_text(json.dumps(record))
