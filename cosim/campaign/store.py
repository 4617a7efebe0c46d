"""A campaign's runs on disk: a run counts as finished when its record says so and everything agrees with it.

FOLDER/runs/LABEL/           finished runs, each with record.json: key of its inputs, checksum, rows of the table
FOLDER/unfinished/LABEL.x/   a run under way, broken off or failed; moved to runs/ in one step when it is whole
FOLDER/set-aside/            what no longer agrees with its record or with the campaign: nothing is deleted
"""

from __future__ import annotations

import hashlib
import json
import os
import socket
import uuid
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path
from typing import Any

from cosim.archive import sha256
from cosim.errors import CosimError
from cosim.recording import RESULTS, write_json
from cosim.run import simulate
from cosim.verification.runs import Job

RUNS, UNFINISHED, SET_ASIDE, RECORD, LOCK = "runs", "unfinished", "set-aside", "record.json", ".lock"
OWN = {RUNS, UNFINISHED, SET_ASIDE, LOCK}
Rows = list[dict[str, Any]]
Evaluate = Callable[[Path, Mapping[str, Any]], Rows]


@dataclass(frozen=True)
class Task:
    """A run of a campaign.

    Attributes:
        job: what is run; its `label` names the run and its folder.
        key: of all its inputs (`Job.key`).
        about: what its evaluation is told.
    """

    job: Job
    key: str
    about: Mapping[str, Any]

    @property
    def label(self) -> str:
        """Name of the run and of its folder."""
        return self.job.label


@dataclass(frozen=True)
class Work:
    """What every run of a campaign shares.

    Attributes:
        folder: of the campaign, absolute.
        evaluate: makes the rows of a run's folder; a function of a module, so that other processes find it.
        evaluation: digest of what it does.
        parent: process without which runs stop, or None.
    """

    folder: Path
    evaluate: Evaluate
    evaluation: str
    parent: int | None = None


@dataclass(frozen=True)
class Outcome:
    """How a run ended: with rows, with an error, or stopped by the user."""

    label: str
    rows: Rows | None = None
    error: str = ""
    stopped: bool = False


def execute(work: Work, task: Task) -> Outcome:
    """Run a task (unless its results are there and only the evaluation is lacking) and put it among the finished.

    Whatever goes wrong with it is in the outcome: one run's error is not the campaign's.
    """
    try:
        if not work.folder.is_dir():
            host = socket.gethostname()
            raise CosimError(f"{host} does not see {work.folder}; workers need the campaign's folder at the same path")
        final = work.folder / RUNS / task.label
        if results_differ(final, task.key):
            return _run(work, task, final)
        return Outcome(task.label, _record(work, task, final))
    except KeyboardInterrupt:
        return Outcome(task.label, stopped=True)
    except Exception as error:
        named = isinstance(error, (ValueError, RuntimeError, OSError)) and str(error)
        text = str(error) if named else f"{type(error).__name__}: {error}"
        return Outcome(task.label, error=" ".join(text.split()))


def _run(work: Work, task: Task, final: Path) -> Outcome:
    scratch = work.folder / UNFINISHED / f"{task.label}.{uuid.uuid4().hex[:8]}"

    def follow(time: float) -> None:
        if work.parent is not None and os.getppid() != work.parent:
            raise KeyboardInterrupt  # the campaign was killed: another may be running this by now

    settings = replace(task.job.settings, about={**task.job.settings.about, "key": task.key})
    result = simulate(task.job.system, settings, scratch, follow)
    if result.status != "completed":
        return Outcome(task.label, stopped=True)
    rows = _record(work, task, scratch)
    set_aside(work.folder, final)
    (work.folder / RUNS).mkdir(exist_ok=True)
    try:
        scratch.rename(final)
    except OSError:
        if results_differ(final, task.key):  # else another process was faster, with the same run
            raise
    return Outcome(task.label, rows)


def _record(work: Work, task: Task, folder: Path) -> Rows:
    """Evaluate a run and write its record, the last thing that makes it a finished one."""
    rows = work.evaluate(folder, task.about)
    content = {"key": task.key, "results": sha256(folder / RESULTS), "evaluation": work.evaluation, "rows": rows}
    write_json(folder / RECORD, {"content": content, "sha256": _digest(content)})
    return rows


def finished_rows(work: Work, task: Task) -> tuple[Rows | None, str]:
    """Rows of a finished run; or None, and why it does not count as finished ("" if it has never been run)."""
    folder = work.folder / RUNS / task.label
    if not folder.exists():
        return None, ""
    why = results_differ(folder, task.key)
    if why:
        return None, why
    content = read_record(folder)
    if content["evaluation"] != work.evaluation:
        return None, "it was evaluated by another version"
    return list(content["rows"]), ""


def results_differ(folder: Path, key: str) -> str:
    """Why a run's results are not those of this key, or ""."""
    try:
        content = read_record(folder)
    except CosimError as error:
        return str(error)
    if content["key"] != key:
        return "its inputs have changed (parameters, FMUs, wind, settings or versions)"
    try:
        same = content["results"] == sha256(folder / RESULTS)
    except OSError as error:
        return f"{RESULTS} cannot be read ({error.strerror})"
    return "" if same else f"{RESULTS} differs from its record"


def read_record(folder: Path) -> dict[str, Any]:
    """A run's record.

    Raises:
        CosimError: there is none, or it is torn.
    """
    try:
        text = json.loads((folder / RECORD).read_text(encoding="utf-8"))
        content = dict(text["content"])
        whole = text["sha256"] == _digest(content)
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise CosimError(f"{RECORD} cannot be read ({type(error).__name__})") from error
    if not whole:
        raise CosimError(f"{RECORD} differs from its own checksum")
    return content


def set_aside(root: Path, folder: Path) -> Path | None:
    """Move a run's folder out of the way, if it exists, to a new name below `set-aside`; returns that."""
    if not folder.exists():
        return None
    (root / SET_ASIDE).mkdir(exist_ok=True)
    names = (folder.name if n == 1 else f"{folder.name}-{n}" for n in count(1))
    target = next(p for p in (root / SET_ASIDE / name for name in names) if not p.exists())
    return folder.rename(target)


def under_way(root: Path) -> set[str]:
    """Labels of the runs that have begun and not come to an end."""
    try:
        return {p.name.rpartition(".")[0] for p in (root / UNFINISHED).iterdir()}
    except OSError:
        return set()


def foreign(folder: Path, names: Sequence[str]) -> list[str]:
    """What a folder holds that is neither a campaign's nor among `names`."""
    return sorted(p.name for p in folder.iterdir() if p.name not in OWN | set(names)) if folder.exists() else []


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold a campaign's folder; the lock ends with the process, however that ends.

    Raises:
        CosimError: another campaign runs in it, or it cannot be written to.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        file = (folder / LOCK).open("a+b")
    except OSError as error:
        raise CosimError(f"folder {folder}: {error.strerror}; choose another") from error
    with file:
        try:
            _lock(file.fileno())
        except OSError as error:
            raise CosimError(f"{folder}: another campaign is running in it; wait for it or choose another") from error
        yield


def _lock(file: int) -> None:
    if os.name == "nt":
        import msvcrt

        msvcrt.locking(file, msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined,unused-ignore]
    else:
        import fcntl

        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)


def _digest(content: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()
