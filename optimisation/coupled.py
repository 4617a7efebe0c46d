"""Designs evaluated by simulations that take seconds each: in parallel, stored one by one, never run twice."""

from __future__ import annotations

import json
import os
import threading
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from optimisation.scenarios import Scenario

Array = npt.NDArray[np.float64]
STORE = "simulations.jsonl"
# (values by name, scenario's index, told to stop?) -> standard deviations, shape (channels,)
Simulation = Callable[[Mapping[str, float], int, Callable[[], bool]], Array]


class SimulationFailed(RuntimeError):
    """A simulation of one design in one scenario gave no result; the message says why."""


class StoredResponses:
    """Standard deviations from a simulation for each (design, scenario), see `optimisation.scenarios.Responses`.

    Threads suit simulations that run outside Python's interpreter lock, as FMUs do. Results do not depend on the number
    of workers. Each finished simulation is one line of a file, so that an abrupt end costs those that were running.

    Args:
        simulate: raises `SimulationFailed` for a design that cannot be simulated; other errors end the search.
        variables: names of a design's values.
        scenarios, channels: labels.
        store: file of finished simulations, which is read first; it must belong to the same problem. None: no file.
        workers: threads.
        tick: called after each simulation with 1, and at the start of a call with the number of those stored.

    Raises:
        ValueError: the store cannot be read.
    """

    def __init__(
        self,
        simulate: Simulation,
        variables: Sequence[str],
        scenarios: Sequence[Scenario],
        channels: Sequence[str],
        *,
        store: Path | None = None,
        workers: int = 1,
        tick: Callable[[int], None] | None = None,
    ) -> None:
        self._simulate, self._names = simulate, tuple(variables)
        self._scenarios, self._channels = tuple(scenarios), tuple(channels)
        self._store, self._workers, self._tick = store, workers, tick
        self.first_failure: str | None = None
        self.simulations = 0
        self._known = _read(store, len(self._channels)) if store is not None and store.exists() else {}

    def __call__(self, candidates: Array) -> Array:
        """See `optimisation.scenarios.Responses`."""
        found = np.full((len(candidates), len(self._scenarios), len(self._channels)), np.nan)
        failures: dict[tuple[int, int], str] = {}
        stop = threading.Event()
        with ThreadPoolExecutor(self._workers) as pool:
            jobs: dict[Future[Array], tuple[int, int]] = {}
            for i, candidate in enumerate(candidates):
                for s, scenario in enumerate(self._scenarios):
                    known = self._known.get((*candidate.tolist(), scenario.label))
                    if known is not None:
                        found[i, s] = known
                        continue
                    values = dict(zip(self._names, candidate.tolist(), strict=True))
                    jobs[pool.submit(self._simulate, values, s, stop.is_set)] = (i, s)
            self._count(found.shape[0] * found.shape[1] - len(jobs))
            try:
                self._collect(jobs, candidates, found, failures)
            except BaseException:  # Ctrl-C, or an error that no other design can put right: the running ones stop too
                stop.set()
                pool.shutdown(wait=True, cancel_futures=True)
                self._keep_finished(jobs, candidates)
                raise
        if failures and self.first_failure is None:
            i, s = min(failures)
            at = ", ".join(f"{n} = {v:.6g}" for n, v in zip(self._names, candidates[i], strict=True))
            self.first_failure = f"{self._scenarios[s].label}: {failures[i, s]} at {at}"
        return found

    def _collect(
        self, jobs: dict[Future[Array], tuple[int, int]], candidates: Array, found: Array,
        failures: dict[tuple[int, int], str],
    ) -> None:  # fmt: skip
        pending = set(jobs)
        while pending:
            # a short wait, so that Ctrl-C is noticed
            done, pending = wait(pending, timeout=0.5, return_when=FIRST_COMPLETED)
            for job in done:
                i, s = jobs[job]
                try:
                    found[i, s] = job.result()
                    self._keep(candidates[i], s, found[i, s])
                except SimulationFailed as error:
                    failures[i, s] = str(error)
                self._count(1)

    def _keep_finished(self, jobs: Mapping[Future[Array], tuple[int, int]], candidates: Array) -> None:
        """Keep what has come to its end beside what broke off."""
        for job, (i, s) in jobs.items():
            known = (*candidates[i].tolist(), self._scenarios[s].label) in self._known
            if job.done() and not known and not job.cancelled() and job.exception() is None:
                with suppress(OSError):  # if that is what has broken off
                    self._keep(candidates[i], s, job.result())

    def _keep(self, candidate: Array, s: int, deviations: Array) -> None:
        label = self._scenarios[s].label
        self._known[(*candidate.tolist(), label)] = deviations
        if self._store is None:
            return
        line = {
            "scenario": label,
            "design": dict(zip(self._names, candidate.tolist(), strict=True)),
            "std": dict(zip(self._channels, deviations.tolist(), strict=True)),
        }
        with self._store.open("a", encoding="utf-8") as file:
            file.write(json.dumps(line) + "\n")
            file.flush()
            os.fsync(file.fileno())

    def _count(self, more: int) -> None:
        self.simulations += more
        if self._tick is not None and more:
            self._tick(more)


def _read(store: Path, channels: int) -> dict[tuple[Any, ...], Array]:
    """Finished simulations; a last line that a kill has torn is cut off."""
    content = store.read_bytes()
    whole = content[: content.rfind(b"\n") + 1]
    if whole != content:
        os.truncate(store, len(whole))
    known = {}
    for number, line in enumerate(whole.decode("utf-8").splitlines(), start=1):
        try:
            entry = json.loads(line)
            deviations = np.array(list(entry["std"].values()), dtype=float)
            if deviations.shape != (channels,):
                raise ValueError(f"{deviations.size} channels instead of {channels}")
            known[(*entry["design"].values(), entry["scenario"])] = deviations
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise ValueError(f"{store}, line {number}: is no finished simulation ({error}); delete the line") from error
    return known
