"""`fowt verify` end to end: against histories that this model made itself, against perturbed ones, and misuse."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow.parquet as pq
import pytest

from tests.conftest import Outcome

PLAN = """
[parameters]
"barge.dof.nacelle_yaw" = false  # the component's own value, in place of the one that OpenFAST's results need
[options]
hydro = {}
[checks]
pitch = [
    { channels = ["PtfmPitch"], quantity = "frequency", near = 0.08, others = [0.54], relative = 0.005 },
    { channels = ["PtfmPitch"], quantity = "std", relative = 0.05 },
    { channels = ["PtfmPitch", "TTDspFA"], quantity = "R2", at_least = 0.99 },
]
damper = [{ channels = ["PtfmPitch"], quantity = "suppression", absolute = 2.0 }]
figures = [{ channels = ["PtfmPitch"], quantity = "mean", absolute = 0.05 }]
[comparison."mine/none"]
case = "decay5"
window = [0.0, 40.0]
checks = ["pitch"]
[comparison."mine/damped"]
like = "mine/none"
damper = "mtmd"
undamped = "mine/none"
checks = ["damper"]
[comparison."mine/table"]
like = "mine/none"
table = "table.csv"
row = { case = 1 }
checks = ["figures"]
"""


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of results as a user may have it, but of this model."""
    from cosim.case import read_case
    from cosim.cli.run import Changes, prepare
    from cosim.run import simulate

    folder = tmp_path_factory.mktemp("results")
    (folder / "mine").mkdir()
    means = []
    for name, damper in (("none", "none"), ("damped", "mtmd")):
        prepared = prepare(read_case("decay5"), damper, Changes(until=40.0), quiet=True)
        result = simulate(prepared.system, prepared.settings, folder / "runs" / name)
        means.append(result.summary["PtfmPitch"]["mean"])
        shutil.copy(result.folder / "results.parquet", folder / "mine" / f"{name}.parquet")
    (folder / "table.csv").write_text(f"case,PtfmPitch_mean\n1,{means[0]}\n2,99\n")
    (folder / "verification.toml").write_text(PLAN)
    return folder


def rows(outcome: Outcome) -> dict[tuple[str, str, str], dict[str, Any]]:
    content = json.loads(outcome.out)
    return {(r["comparison"].rpartition("/")[2], r["channel"], r["quantity"]): r for r in content["rows"]}


def test_a_model_agrees_with_itself_and_runs_once(fowt: Callable[..., Outcome], results: Path, tmp_path: Path) -> None:
    words = ("verify", "mine", "--against", str(results), "--out", "v", "--workers", "2")
    first = fowt(*words)
    assert first.code == 0, first.out + first.err
    assert "6 of 6 rows pass" in first.out
    assert "2 runs, 0 of them from before" in first.out  # the table's is the same as the first
    assert {p.name for p in (tmp_path / "v").iterdir()} == {
        "runs", "verification.csv", "verification.json", "mine-none.png", "mine-damped.png",
    }  # fmt: skip
    again = fowt(*words, "--format", "json")
    content = json.loads(again.out)
    assert content["passed"] is True
    # The table's mean was summed up in another order.
    assert all(abs(r["difference"]) < 1e-12 for r in content["rows"] if r["limit"] != "at_least")
    assert len(list((tmp_path / "v/runs").iterdir())) == 2  # nothing was run again
    assert pd.read_csv(tmp_path / "v/verification.csv")["status"].tolist() == ["pass"] * 6


def test_a_perturbed_reference_fails(fowt: Callable[..., Outcome], results: Path, tmp_path: Path) -> None:
    """Times stretched by 1 % (frequency 1 % lower), values larger by 10 %: each check sees what it should see."""
    folder = tmp_path / "perturbed"
    shutil.copytree(results, folder, ignore=shutil.ignore_patterns("runs"))
    table = pq.read_table(folder / "mine/none.parquet")
    frame = table.to_pandas()
    frame["Time"] *= 1.01
    frame["PtfmPitch"] *= 1.1
    frame.drop(columns="TTDspFA").to_csv(folder / "mine/none.csv", index=False)
    (folder / "mine/none.parquet").unlink()
    outcome = fowt("verify", "mine/none", "--against", str(folder), "--format", "json")
    assert outcome.code == 1
    assert "no channel TTDspFA; add it to that run's outputs" in outcome.err
    found = rows(outcome)
    assert found["none", "PtfmPitch", "frequency"]["difference"] == pytest.approx(0.01, rel=0.02)
    assert found["none", "PtfmPitch", "std"]["difference"] == pytest.approx(1 / 1.1 - 1, abs=0.01)
    statuses = {key[1:]: row["status"] for key, row in found.items()}
    assert statuses == {
        ("PtfmPitch", "frequency"): "FAIL", ("PtfmPitch", "std"): "FAIL", ("PtfmPitch", "R2"): "FAIL",
        ("TTDspFA", "R2"): "missing",
    }  # fmt: skip
    assert fowt("verify", "mine/none", "--against", str(folder), "--report-only").code == 0


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--against", "nowhere"), "nowhere: no such folder"),
        (("--against", "{empty}"), "holds none of the results asked for"),
        (("--against", "{results}", "decya"), "nothing to verify is called 'decya'; did you mean 'decay'"),
        (("turbulent",), "no figures ship for turbulent; give a folder of results with --against DIR"),
        (("mine/damped", "--against", "{alone}"), "suppression needs 'mine/none' in the same folder"),
        (("mine/none", "--against", "{short}"), "covers 0 to 20 s, 0 to 40 s are to be compared; run longer"),
        (("mine/none", "--against", "{torn}"), "none.parquet: cannot be read"),
        (("mine/none", "--against", "{wind}"), "wind.bts: no such file; mine/none runs with it, add it"),
        (("mine/none", "--against", "{channel}"), "has no channel 'PtfmPich'; did you mean 'PtfmPitch'"),
        (("mine/none", "--against", "{misspelt}"), "hydro has no 'drag_coeficient'; did you mean 'drag_coefficient'"),
        (("mine/none", "--against", "{absent}"), "'aero.wind_speed': this run has no 'aero'"),
        (("mine/none", "--against", "{unchecked}"), "has no checks; give its lists some"),
        (("mine/none", "--against", "{still}"), "PtfmPitch does not move; drop its R2"),
    ],
)
def test_a_mistake_gets_one_line(
    fowt: Callable[..., Outcome],
    results: Path,
    tmp_path: Path,
    words: tuple[str, ...],
    message: str,
) -> None:
    def changed(name: str) -> Path:
        return Path(
            shutil.copytree(results, tmp_path / name, ignore=shutil.ignore_patterns("runs"), dirs_exist_ok=True)
        )

    (changed("alone") / "mine/none.parquet").unlink()
    short = changed("short") / "mine/none.parquet"
    pq.write_table(pq.read_table(short).slice(0, 401), short)
    (changed("torn") / "mine/none.parquet").write_bytes(b"PAR1 torn")
    (changed("wind") / "verification.toml").write_text(
        PLAN.replace('case = "decay5"', 'case = "lc1"\nfiles = { "aero.wind_file" = "wind.bts" }')
    )
    (changed("channel") / "verification.toml").write_text(
        PLAN.replace('["PtfmPitch"], quantity = "std"', '["PtfmPich"], quantity = "std"')
    )
    case = 'case = "decay5"'
    (changed("misspelt") / "verification.toml").write_text(
        PLAN.replace("[parameters]", "[parameters]\nhydro.drag_coeficient = 0.0")
    )
    (changed("absent") / "verification.toml").write_text(
        PLAN.replace(case, f'{case}\nparameters = {{ "aero.wind_speed" = 3.0 }}')
    )
    (changed("unchecked") / "verification.toml").write_text(PLAN.replace('["pitch"]', "[]"))
    still = changed("still")
    frame = pq.read_table(still / "mine/none.parquet").to_pandas().assign(PtfmPitch=0.0)
    frame.to_csv(still / "mine/none.csv", index=False)
    (still / "mine/none.parquet").unlink()
    (still / "verification.toml").write_text(
        PLAN.replace('quantity = "frequency", near = 0.08, others = [0.54], relative', 'quantity = "mean", absolute')
    )
    (tmp_path / "empty").mkdir()
    folders = {p.name: str(p) for p in tmp_path.iterdir()} | {"results": str(results)}
    outcome = fowt("verify", *(w.format(**folders) for w in words))
    lines = [line for line in outcome.err.splitlines() if line.startswith("error:")]
    assert outcome.code == 1
    assert len(lines) == 1
    assert message in lines[0]
    assert not (tmp_path / "runs").exists()  # found before anything was run


def test_all_figures_keep_their_tolerances(fowt: Callable[..., Outcome]) -> None:
    """OpenFAST's decays (blades rigid and flexible), regular waves and steady wind: every figure that ships."""
    found = rows(fowt("verify", "--format", "json"))
    assert len(found) == 79
    assert [key for key, row in found.items() if row["status"] != "pass"] == []
