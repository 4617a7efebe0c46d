"""The fitness evaluated by the workers of a Dask cluster, which need not share a file system with the search.

The FMU travels as a task of its own: a worker that lacks it fetches it, and Dask repeats the task if the worker that
held it is lost, as it repeats the chunks of candidates. Needs the extra `dask`.
"""

from __future__ import annotations

import asyncio
import functools
import hashlib
import logging
import tempfile
import threading
import time
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from optimisation.objective import TowerTopDeviation

Array = npt.NDArray[np.float64]

CONNECT = 5.0  # s, to reach the scheduler
PATIENCE = 60.0  # s without any worker: long enough for one to be restarted
CHUNKS = 2  # for each thread of the cluster: a slow one then holds up half as much
IDLE = 64  # instances that a worker process keeps for the chunks to come


class ClusterError(RuntimeError):
    """The cluster cannot be reached, or cannot evaluate."""


@dataclass(frozen=True)
class Task:
    """What a worker needs besides FMU and candidates; arguments of `TowerTopDeviation`."""

    digest: str
    names: tuple[str, ...]
    fixed: tuple[tuple[str, float], ...]
    horizon: float


class DistributedDeviation:
    """`TowerTopDeviation` on a Dask cluster: the same values bit for bit, however many workers there are.

    Args:
        fmu, variables, parameters, horizon: as `TowerTopDeviation`.
        address: of the scheduler, such as "tcp://node1:8786".

    Attributes:
        shape: of a candidate's fitness.
        first_failure: message of the first candidate that could not be evaluated, or None.

    Raises:
        ValueError: as `TowerTopDeviation`.
        ClusterError: Dask is not installed, or no scheduler answers at the address.
    """

    shape: tuple[int, ...] = ()

    def __init__(
        self,
        fmu: Path,
        variables: Sequence[str],
        parameters: Mapping[str, float] | None = None,
        *,
        horizon: float = 100.0,
        address: str,
    ) -> None:
        TowerTopDeviation(fmu, variables, parameters, horizon=horizon).close()  # refuses here what workers would refuse
        content = fmu.read_bytes()
        digest = hashlib.sha256(content).hexdigest()
        self._task = Task(digest, tuple(variables), tuple(sorted(dict(parameters or {}).items())), horizon)
        self._address = address
        self.first_failure: str | None = None
        self._client = connect(address)
        self._fmu = self._client.submit(bytes, content, key=f"fowt-fmu-{digest}")

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Leave the cluster; what it has not computed yet is cancelled."""
        with _quiet():
            self._client.close(timeout=CONNECT)

    def __call__(self, candidates: Array) -> Array:
        """Fitness in m, shape (n, *shape), of candidates of shape (n, variables); nan where the simulation failed.

        Raises:
            ClusterError: no worker for a minute, the scheduler is gone, or a worker cannot evaluate.
        """
        if len(candidates) == 0:
            return np.empty((0, *self.shape))
        with _quiet():
            found = self._evaluate(candidates)
        for _, failure in found:
            self.first_failure = self.first_failure or failure
        return np.concatenate([values for values, _ in found])

    def _evaluate(self, candidates: Array) -> list[tuple[Array, str | None]]:
        from distributed import KilledWorker

        try:
            threads = sum(self._wait_for_workers().values())
            chunks = np.array_split(candidates, min(len(candidates), CHUNKS * threads))
            futures = self._client.map(
                evaluate, [self._fmu] * len(chunks), [self._task] * len(chunks), chunks, pure=False
            )
            self._wait(futures)
            return list(self._client.gather(futures))
        except KilledWorker as error:
            raise ClusterError(f"Dask cluster {self._address}: each worker that got a chunk died: {error}") from error
        except ClusterError:
            raise
        except Exception as error:
            what = f"{type(error).__name__}: {error}"
            if isinstance(error, ImportError):
                what += "; install the same version of fowt-cosim on the workers"
            raise ClusterError(f"Dask cluster {self._address} cannot evaluate: {what}") from error

    def _wait_for_workers(self) -> dict[str, int]:
        """Threads by worker, as soon as there is one."""
        end = time.monotonic() + PATIENCE
        while not (found := self._client.nthreads()):
            if time.monotonic() > end:
                raise ClusterError(f"Dask cluster {self._address}: no worker for {PATIENCE:.0f} s; start one")
            time.sleep(0.2)
        return dict(found)

    def _wait(self, futures: Sequence[Any]) -> None:
        from distributed import wait

        while any(not f.done() for f in futures):
            try:
                with self._client.as_current():
                    wait(futures, timeout=10.0)
            except TimeoutError:
                self._wait_for_workers()


def connect(address: str) -> Any:
    """A client of the scheduler at an address.

    Raises:
        ClusterError: Dask is not installed, or no scheduler answers.
    """
    try:
        from distributed import Client
    except ImportError as error:
        raise ClusterError('Dask is not installed: pip install "fowt-cosim[dask]"') from error
    hint = "start one with 'dask scheduler', and workers with 'dask worker ADDRESS'"
    with _quiet():
        try:
            # the client itself hangs if what answers speaks another language
            found = asyncio.run(asyncio.wait_for(_identity(address), CONNECT))
        except Exception as error:  # that language may raise anything
            known = isinstance(error, (OSError, ValueError))
            reason = (
                (str(error) or f"no answer within {CONNECT:g} s") if known else "what answers speaks something else"
            )
            raise ClusterError(f"no Dask scheduler at {address} ({reason}); {hint}") from error
        if found != "Scheduler":
            raise ClusterError(f"{address} is a Dask {found.lower()}, no scheduler; {hint}")
        return Client(address, timeout=CONNECT, set_as_default=False)


async def _identity(address: str) -> str:
    """What kind of Dask server is there."""
    from distributed import rpc

    async with rpc(address, timeout=CONNECT) as server:
        return str((await server.identity())["type"])


def evaluate(fmu: bytes, task: Task, candidates: Array) -> tuple[Array, str | None]:
    """Fitness of a chunk, and the first failure's message; runs in a worker's thread."""
    return _worker().evaluate(fmu, task, candidates)


class WorkerState:
    """What a worker process keeps between chunks: each FMU unpacked once, and idle instances, one chunk using one."""

    def __init__(self, folder: Path | None = None) -> None:
        self._lock = threading.Lock()
        self._folder = tempfile.TemporaryDirectory(prefix="fowt-fmu-", dir=folder, ignore_cleanup_errors=True)
        self._idle: list[tuple[Task, TowerTopDeviation]] = []

    def evaluate(self, fmu: bytes, task: Task, candidates: Array) -> tuple[Array, str | None]:
        """See the function of this name."""
        objective = self._take(fmu, task)
        try:
            values = objective(candidates)
            return values, objective.first_failure
        finally:
            self._give_back(task, objective)

    def _take(self, fmu: bytes, task: Task) -> TowerTopDeviation:
        with self._lock:
            for i, (known, objective) in enumerate(self._idle):
                if known == task:
                    del self._idle[i]
                    objective.first_failure = None
                    return objective
            folder = Path(self._folder.name) / task.digest
            if not folder.exists():
                with zipfile.ZipFile(BytesIO(fmu)) as archive:
                    archive.extractall(folder)
        return TowerTopDeviation(folder, task.names, dict(task.fixed), horizon=task.horizon)

    def _give_back(self, task: Task, objective: TowerTopDeviation) -> None:
        with self._lock:
            self._idle.append((task, objective))
            surplus = [self._idle.pop(0)[1] for _ in range(len(self._idle) - IDLE)]
        for old in surplus:
            old.close()


@functools.cache
def _worker() -> WorkerState:
    from distributed import get_worker

    return WorkerState(Path(get_worker().local_directory))


@contextmanager
def _quiet() -> Iterator[None]:
    """Dask reports each lost connection on stderr; what matters of it is said in one line here."""
    logger = logging.getLogger("distributed")
    before = logger.level
    logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        logger.setLevel(before)
