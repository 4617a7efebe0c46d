"""Campaigns on disk: however often they are broken off, the table is the same; what fails harms no other run."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pandas as pd
import pytest

from cosim.campaign.pool import run_here
from cosim.campaign.store import RECORD, RUNS, SET_ASIDE, UNFINISHED, Outcome, Task, Work, finished_rows, locked
from cosim.case import read_case
from cosim.cli.campaign import strokes
from cosim.cli.run import Changes, prepare
from cosim.errors import CosimError
from cosim.recording import RESULTS
from cosim.run import RunSettings
from cosim.system import ComponentInstance, StartValue, System
from cosim.verification.runs import Job
from optimisation.campaign.runs import read_campaign, rows_of_run
from tests.conftest import Outcome as Ended

from .campaign_runs import evaluate
from .cosim_fmus import probe

# Four runs of the simplified model; the last arrangement hits its stops.
WORDS = ("campaign", "decay5-simplified", "decay10-simplified", "--dampers", "none,mtmd", "--until", "150")
COUNT = 4


@pytest.fixture(scope="module")
def probe_fmu(fmu_folder: Path) -> Path:
    return probe(fmu_folder)


@pytest.fixture
def task(probe_fmu: Path) -> Callable[..., Task]:
    """A run of the probe FMU, which can be told to fail on its way."""

    def make(name: str, fail_at: float = 1e9, slope: float = 1.0) -> Task:
        start = {
            "fail_at": StartValue(fail_at),
            "fail_status": StartValue(3),
            "slope": StartValue(slope),
            "u": StartValue(1.0),
        }
        system = System("probe", (ComponentInstance("a", probe_fmu, start),))
        job = Job(name, name, system, RunSettings(stop=1.0, step=0.1, record=("*",)))
        about = {"case": "probe", "damper": name, "seed": 1, "transient": 0.0, "strokes": {}}
        return Task(job, job.key(), about)

    return make


def run(work: Work, *tasks: Task) -> dict[str, Outcome]:
    outcomes: dict[str, Outcome] = {}
    run_here(work, tasks, 2, lambda o: outcomes.update({o.label: o}))
    return outcomes


def test_a_failing_run_and_a_dying_worker_harm_no_other_run(task: Callable[..., Task], tmp_path: Path) -> None:
    """Of four runs one kills its worker every time, one once, one fails: the last and the one killed once finish."""
    work = Work(tmp_path, evaluate, "1")
    tasks = [task("always"), task("once"), task("failing", fail_at=0.5), task("good")]
    outcomes = run(work, *tasks)
    assert {label: bool(o.rows) for label, o in outcomes.items()} == {
        "always": False, "once": True, "failing": False, "good": True,
    }  # fmt: skip
    assert "died twice" in outcomes["always"].error
    assert "fmi2Error at t = 0.5" in outcomes["failing"].error
    assert sorted(p.name for p in (tmp_path / RUNS).iterdir()) == ["good", "once"]
    # what the failing run computed is there to be looked at
    assert any((p / RESULTS).exists() for p in (tmp_path / UNFINISHED).glob("failing.*"))


def test_a_result_that_disagrees_with_its_record_is_no_result(task: Callable[..., Task], tmp_path: Path) -> None:
    work = Work(tmp_path, rows_of_run, "1")
    one = task("one")
    rows = run(work, one)["one"].rows
    folder = tmp_path / RUNS / "one"
    results, record = (folder / RESULTS).read_bytes(), (folder / RECORD).read_text()
    assert finished_rows(work, one) == (rows, "")
    for content, why in (
        (results[:-50], "differs"),
        (b"", "differs"),
        (results[:200] + b"?" + results[201:], "differs"),
    ):
        (folder / RESULTS).write_bytes(content)
        assert why in finished_rows(work, one)[1]
    (folder / RESULTS).unlink()
    assert "cannot be read" in finished_rows(work, one)[1]
    (folder / RESULTS).write_bytes(results)
    for text in (record[: len(record) // 2], record.replace('"seed": 1', '"seed": 2'), "[]", ""):
        (folder / RECORD).write_text(text)
        assert RECORD in finished_rows(work, one)[1]
    (folder / RECORD).write_text(record)
    assert "inputs have changed" in finished_rows(work, task("one", slope=2.0))[1]
    # other inputs: run again, and what was there is set aside; another evaluation: not run again
    assert run(work, task("one", slope=2.0))["one"].rows != rows
    assert (tmp_path / SET_ASIDE / "one" / RESULTS).read_bytes() == results
    written = (folder / RESULTS).stat().st_mtime_ns
    later = Work(tmp_path, rows_of_run, "2")
    assert "another version" in finished_rows(later, task("one", slope=2.0))[1]
    assert run(later, task("one", slope=2.0))["one"].rows
    assert (folder / RESULTS).stat().st_mtime_ns == written
    assert finished_rows(later, task("one", slope=2.0))[1] == ""


def test_a_folder_has_one_campaign_at_a_time(tmp_path: Path) -> None:
    with locked(tmp_path), pytest.raises(CosimError, match="another campaign is running"), locked(tmp_path):
        pass
    with locked(tmp_path):
        pass


def table(folder: Path) -> pd.DataFrame:
    return read_campaign(folder).table.drop(columns="wall_seconds")


def test_killed_at_any_moment_it_goes_on_to_the_same_table(fowt: Callable[..., Ended], tmp_path: Path) -> None:
    """Killed (SIGKILL) when its first run has finished; meanwhile a result is torn; then on Dask, too."""
    assert fowt(*WORDS, "--out", "whole").code == 0
    command = [sys.executable, "-c", "from cosim.cli import main; main()", *WORDS, "--out", "killed", "--workers", "1"]
    process = subprocess.Popen(command, cwd=tmp_path, stderr=subprocess.DEVNULL)
    runs = tmp_path / "killed" / RUNS
    while process.poll() is None and len(list(runs.glob("*"))) < 2:
        time.sleep(0.002)
    process.send_signal(signal.SIGKILL)
    process.wait()
    there = {p.name: (p / RESULTS).stat().st_mtime_ns for p in runs.iterdir()}
    assert 2 <= len(there) < COUNT
    torn = min(there)
    (runs / torn / RESULTS).write_bytes((runs / torn / RESULTS).read_bytes()[:-100])
    resumed = fowt("campaign", "--resume", "killed")
    assert resumed.code == 0, resumed.err
    assert f"{torn}: {RESULTS} differs from its record" in resumed.err
    again = {name: (runs / name / RESULTS).stat().st_mtime_ns for name in there}
    assert {name for name in there if again[name] != there[name]} == {torn}
    pd.testing.assert_frame_equal(table(tmp_path / "killed"), table(tmp_path / "whole"), check_exact=True)
    plans = [json.loads((tmp_path / f / "campaign.json").read_text()) for f in ("killed", "whole")]
    assert plans[0]["table_sha256"] == plans[1]["table_sha256"]


def test_a_dask_cluster_gives_the_same_table(fowt: Callable[..., Ended], tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed", reason="the extra 'dask' is not installed")
    assert fowt(*WORDS, "--out", "here").code == 0
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None, local_directory=str(tmp_path)
    ) as cluster:
        there = fowt(*WORDS, "--out", "there", "--dask", cluster.scheduler_address)
    assert there.code == 0, there.err
    pd.testing.assert_frame_equal(table(tmp_path / "there"), table(tmp_path / "here"), check_exact=True)


def test_the_table_has_what_the_runs_have(fowt: Callable[..., Ended], tmp_path: Path) -> None:
    """Also: a run that cannot start is told of and exits with 1, while the others are evaluated."""
    words = ("campaign", "decay5", "--dampers", "none,tmd-p,tmd-n", "--until", "3", "--out", "c", "--format", "json")
    ended = fowt(*words, "--set", "nacelle_damper.m=-1")
    content = json.loads(ended.out)
    assert ended.code == 1
    assert list(content["failed"]) == ["decay5-tmd-n-seed1"]
    assert "nacelle_damper.m" in ended.err
    found = read_campaign(tmp_path / "c")
    assert [(c, d) for c, d, _, _ in found.missing()] == [("decay5", "tmd-n")]
    row = found.table.set_index(["damper", "channel"]).loc[("tmd-p", "TwrBsMyt")]
    summary = json.loads((found.run_folder("decay5", "tmd-p", 1) / "summary.json").read_text())["TwrBsMyt"]
    assert row["unit"] == summary["unit"]
    # the run's own statistics are merged from blocks: equal but for rounding
    assert [row[k] for k in ("mean", "std", "max")] == pytest.approx([summary[k] for k in ("mean", "std", "max")])
    assert 0.0 < row["del"] < row["max"] - row["min"]
    assert 0.0 <= row["coupling_energy_share"] < 1e-3
    travel = found.frame("decay5", "tmd-p", 1)["SStC1_XQ"].abs().max()
    assert found.table.set_index(["damper", "channel"]).loc[("tmd-p", "SStC1_XQ"), "stroke"] == travel
    rates = pd.read_csv(tmp_path / "c" / "suppression.csv").set_index(["damper", "channel"])
    assert rates.loc[("tmd-p", "TwrBsMyt"), "damped"] == pytest.approx(row["std"])
    mended = fowt(*words, "--set", "nacelle_damper.m=2e4")
    assert "another --set" in mended.err


def test_a_second_command_keeps_the_runs_of_the_first(fowt: Callable[..., Ended], tmp_path: Path) -> None:
    """Two commands on one folder give the table of one that names all; what is named later changes nothing."""
    first, second, *rest = WORDS[1:]
    assert fowt("campaign", first, *rest, "--out", "two").code == 0
    times = {p.name: (p / RESULTS).stat().st_mtime_ns for p in (tmp_path / "two" / RUNS).iterdir()}
    ended = fowt("campaign", second, *rest, "--out", "two", "--format", "json")
    assert ended.code == 0, ended.err
    assert f"note: {COUNT // 2} finished runs of earlier commands stay in the tables" in ended.err
    content = json.loads(ended.out)
    assert content["runs"] == COUNT
    assert [r["case"] for r in content["suppression"]] == [first, first, second, second]  # two channels each
    assert fowt(*WORDS, "--out", "one").code == 0
    pd.testing.assert_frame_equal(table(tmp_path / "two"), table(tmp_path / "one"), check_exact=True)
    plan = read_campaign(tmp_path / "two").plan
    assert list(plan["cases"]) == [first, second]
    assert plan["command"].count("--out two") == 2
    assert {r["status"] for r in plan["runs"]} == {"done"}

    assert fowt("campaign", "--resume", "two").code == 0
    assert read_campaign(tmp_path / "two").plan["table_sha256"] == plan["table_sha256"]
    assert {n: (tmp_path / "two" / RUNS / n / RESULTS).stat().st_mtime_ns for n in times} == times
    torn = tmp_path / "two" / RUNS / min(times)
    (torn / RESULTS).write_bytes(b"")
    ended = fowt("campaign", second, *rest, "--out", "two", "--format", "json")
    assert f"{torn.name}: {RESULTS} differs from its record; left out of the tables" in " ".join(ended.err.split())
    assert json.loads(ended.out)["runs"] == COUNT - 1


def test_strokes_are_those_of_the_arrangement(fowt: Callable[..., Ended]) -> None:
    """8 and 18 m (Wang et al. 2022, section 4); of the simplified model only those of its active dampers."""
    for case, damper, found in (
        ("decay5", "mtmd", {"NStC1_XQ": 8.0, "SStC1_XQ": 18.0}),
        ("decay5", "none", {}),
        ("decay5-simplified", "tmd-n", {"NStC1_XQ": 8.0}),
    ):
        prepared = prepare(read_case(case), damper, Changes(), quiet=True)
        assert strokes(prepared.system, prepared.settings) == found


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--dampers", "tmd"), "no damper arrangement 'tmd'; did you mean 'mtmd'"),
        (("--dampers", "none", "--set", "nacelle_damper.k=1"), "no arrangement of none has that damper"),
        (("--resume", "nowhere"), "holds no campaign"),
        (("--resume", "x", "--seeds", "1:2"), "--resume goes on as the campaign was begun"),
        (("--ssv", "none.ssv"), "no such file"),
        (("--out", "taken"), "is no campaign's folder, it holds 'mine.txt'"),
        (("--until", "2", "--dask", "tcp://127.0.0.1:9"), "no scheduler answers"),
    ],
)
def test_mistakes_get_one_line(fowt: Callable[..., Ended], tmp_path: Path, words: tuple[str, ...], said: str) -> None:
    (tmp_path / "taken").mkdir()
    (tmp_path / "taken" / "mine.txt").touch()
    cases = () if "--resume" in words else ("decay5",)
    ended = fowt("campaign", *cases, *words)
    assert ended.code == 1
    assert said in " ".join(ended.err.split())
