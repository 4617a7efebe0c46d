"""Run many systems at a time, each into a folder of its own, and take up again what has been run already."""

from __future__ import annotations

import hashlib
import json
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import asdict, dataclass, replace
from functools import cache
from importlib.metadata import version
from itertools import count
from pathlib import Path
from typing import Any

import cosim
from cosim.errors import RunFailed
from cosim.fmu import read_fmu
from cosim.run import RunSettings, simulate
from cosim.system import System

KEY = "key"
AROUND = ("campaign/", "cli/", "formats/", "verification/")  # parts of this package that no result follows from
Progress = Callable[[float, Sequence[str]], None]


@dataclass(frozen=True)
class Job:
    """A run to be made: what it is for, how its folder is called, and its whole input."""

    name: str
    label: str
    system: System
    settings: RunSettings

    def key(self) -> str:
        """Digest of all that the results follow from: FMUs, start values, files they name, settings, this package."""
        components = [
            (c.name, read_fmu(c.fmu).sha256, sorted((n, _content(v.value), str(v.unit)) for n, v in c.start.items()))
            for c in self.system.components
        ]
        connections = [(str(c), c.factor, c.offset, c.convert_units) for c in self.system.connections]
        settings = asdict(self.settings) | {"about": {}}
        text = json.dumps([_master(), components, connections, settings], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()


@dataclass(frozen=True)
class Outcome:
    """Where a job's results are; `error` says why it broke off, `reused` that it had been run before."""

    folder: Path
    reused: bool = False
    error: str = ""


class Stopped(Exception):
    """The user stopped; `done` are the jobs that have finished."""

    def __init__(self, done: Mapping[str, Outcome]) -> None:
        super().__init__("stopped by the user")
        self.done = done


def run_all(jobs: Sequence[Job], folder: Path, workers: int, progress: Progress | None = None) -> dict[str, Outcome]:
    """Run jobs in parallel, the longest first, into `folder/LABEL-KEY`; equal ones once, finished ones not again.

    Args:
        progress: called with the share of the simulated time that is done, and the names of the jobs that run.

    Raises:
        Stopped: on Ctrl-C; runs under way stop at once.
        CosimError: a system or a setting cannot be used.
    """
    keys = {job.name: job.key() for job in jobs}
    unique = {keys[job.name]: job for job in sorted(jobs, key=lambda j: -j.settings.stop)}
    outcomes: dict[str, Outcome] = {}
    for key, job in unique.items():
        found = next((f for f in _folders(folder, job, key) if _finished(f, key)), None)
        if found:
            outcomes[key] = Outcome(found, reused=True)
    reached = {key: unique[key].settings.stop for key in outcomes}
    waiting = {key: job for key, job in unique.items() if key not in outcomes}
    stop = threading.Event()

    def run(job: Job, key: str) -> Outcome:
        def follow(time: float) -> None:
            reached[key] = time
            if stop.is_set():
                raise KeyboardInterrupt

        target = next(_folders(folder, job, key, new=True))
        settings = replace(job.settings, about={**job.settings.about, KEY: key})
        try:
            return Outcome(simulate(job.system, settings, target, follow).folder)
        except RunFailed as error:
            return Outcome(target, error=str(error))

    with ThreadPoolExecutor(max_workers=workers) as pool:
        futures = {pool.submit(run, job, key): key for key, job in waiting.items()}

        def tick() -> None:
            if progress is not None:
                done = sum(reached.values()) / max(1.0, sum(job.settings.stop for job in unique.values()))
                progress(done, [unique[key].name for future, key in futures.items() if future.running()])

        try:
            _wait(futures, outcomes, tick)
        except BaseException as error:
            stop.set()
            pool.shutdown(wait=True, cancel_futures=True)
            if isinstance(error, KeyboardInterrupt):
                raise Stopped({name: outcomes[key] for name, key in keys.items() if key in outcomes}) from error
            raise
    return {name: outcomes[key] for name, key in keys.items()}


def _wait(futures: Mapping[Future[Outcome], str], outcomes: dict[str, Outcome], tick: Callable[[], None]) -> None:
    left = set(futures)
    while left:
        done, left = wait(left, timeout=0.2, return_when=FIRST_COMPLETED)
        outcomes |= {futures[future]: future.result() for future in done}
        tick()


def _folders(folder: Path, job: Job, key: str, new: bool = False) -> Iterator[Path]:
    """Folders of a job in order: those that exist, or those that do not, for nothing is overwritten."""
    base = f"{job.label}-{key[:8]}"
    for path in (folder / (base if n == 1 else f"{base}-{n}") for n in count(1)):
        if path.exists() != new:
            yield path
        elif not new:
            return


def _finished(folder: Path, key: str) -> bool:
    try:
        content = json.loads((folder / "run.json").read_text(encoding="utf-8"))
        return bool(content["status"] == "completed" and content["settings"]["about"].get(KEY) == key)
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return False


def _content(value: Any) -> Any:
    """A start value; of one that names a file, the digest of what is in it."""
    if isinstance(value, str) and value and Path(value).is_file():
        state = Path(value).stat()
        return _digest(Path(value), state.st_size, state.st_mtime_ns)
    return value


@cache
def _digest(path: Path, size: int, modified: int) -> str:
    """Of a file in this state: a big wind box is read once, however many runs use it."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


@cache
def _master() -> str:
    """Digest of what steps the systems: this package's sources less what only arranges runs or looks at results."""
    digest = hashlib.sha256(version("numpy").encode())
    for root in map(Path, cosim.__path__):
        for path in sorted(root.rglob("*")):
            inside = path.relative_to(root).as_posix()
            if path.suffix in (".py", ".c", ".h") and not inside.startswith(AROUND):
                digest.update(inside.encode() + path.read_bytes())
    return digest.hexdigest()
