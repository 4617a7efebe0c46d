"""Who runs a campaign's tasks: processes of this machine (joblib's loky), or the workers of a Dask cluster.

A worker that dies takes no campaign with it. Locally all runs that were under way are then suspects, since the pool
ends with its worker; each is run again alone, and one whose process dies twice more is the culprit and given
up. On Dask the scheduler repeats a lost task and gives it up by its own count (`allowed-failures`).
"""

from __future__ import annotations

import logging
import os
import shutil
from collections import Counter
from collections.abc import Callable, Generator, Iterable, Sequence
from concurrent.futures import BrokenExecutor
from contextlib import closing
from dataclasses import replace

from cosim.campaign.store import UNFINISHED, Outcome, Task, Work, execute, finished_rows, under_way
from cosim.errors import CosimError, RunFailed

CONNECT_SECONDS = 5
EMPTY_HANDED = 3  # deaths of workers before any run of theirs begins: then something else is wrong
Done = Callable[[Outcome], None]


def run_here(work: Work, tasks: Sequence[Task], workers: int, done: Done) -> None:
    """Run tasks in processes of this machine.

    Args:
        done: called with each outcome.

    Raises:
        RunFailed: the workers die before they begin a run.
        KeyboardInterrupt: of the user; the runs under way are stopped.
    """
    work = replace(work, parent=os.getpid())
    waiting, empty_handed = {task.label: task for task in tasks}, 0
    while waiting:
        clear_unfinished(work, waiting.values())
        try:
            with closing(_pool(work, list(waiting.values()), workers)) as outcomes:
                for outcome in outcomes:
                    if outcome.stopped:
                        raise KeyboardInterrupt
                    del waiting[outcome.label]
                    done(outcome)
        except BrokenExecutor:
            suspects = [waiting[label] for label in sorted(under_way(work.folder) & set(waiting))]
            for label in list(waiting):  # some may have finished and not been able to say so
                rows, _ = finished_rows(work, waiting[label])
                if rows is not None:
                    suspects = [s for s in suspects if s.label != label]
                    del waiting[label]
                    done(Outcome(label, rows))
            empty_handed = 0 if suspects else empty_handed + 1
            if empty_handed == EMPTY_HANDED:
                raise RunFailed("worker processes die before they begin a run; is there memory for them?") from None
            with closing(_one_by_one(work, suspects)) as outcomes:
                for outcome in outcomes:
                    if outcome.stopped:
                        raise KeyboardInterrupt from None
                    del waiting[outcome.label]
                    done(outcome)


def _pool(work: Work, tasks: Sequence[Task], workers: int) -> Generator[Outcome]:
    """Outcomes as they come; one worker too is a process of its own, which joblib would not make.

    Raises:
        BrokenExecutor: a worker died.
    """
    workers = min(workers, len(tasks))
    if workers > 1:
        from joblib import Parallel, delayed

        pool = Parallel(workers, backend="loky", batch_size=1, return_as="generator_unordered")
        yield from pool(delayed(execute)(work, task) for task in tasks)
        return
    from joblib.externals.loky import ProcessPoolExecutor

    one = ProcessPoolExecutor(1)
    try:
        for future in [one.submit(execute, work, task) for task in tasks]:
            yield future.result()
    finally:
        one.shutdown(wait=True, kill_workers=True)


def _one_by_one(work: Work, suspects: Sequence[Task]) -> Generator[Outcome]:
    """Run suspects one after the other in a process with no other; what kills that twice is given up."""
    left, deaths = list(suspects), Counter[str]()
    while left:
        clear_unfinished(work, left)
        try:
            with closing(_pool(work, left, 1)) as outcomes:
                for outcome in outcomes:
                    left.pop(0)
                    yield outcome
        except BrokenExecutor:
            label = left[0].label
            deaths[label] += 1
            if deaths[label] == 2:
                left.pop(0)
                yield Outcome(label, error="its process died twice (a crashing FMU, or too little memory); given up")


def run_on_dask(work: Work, tasks: Sequence[Task], address: str, done: Done) -> None:
    """Run tasks on a Dask cluster, whose workers see the campaign's folder, the FMUs and the wind at the same paths.

    Raises:
        CosimError: no such cluster, or `distributed` is not installed.
        KeyboardInterrupt: of the user; the tasks are cancelled.
    """
    try:
        from distributed import Client, as_completed
    except ImportError as error:
        raise CosimError("--dask needs the package 'distributed'; install fowt-cosim[dask]") from error
    logging.getLogger("distributed").setLevel(logging.ERROR)
    try:
        client = Client(address, timeout=CONNECT_SECONDS)
    except (OSError, ValueError) as error:
        said = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise CosimError(f"--dask {address}: no scheduler answers there ({said}); start one there") from error
    clear_unfinished(work, tasks)
    with client:
        # pure: a task that an earlier campaign left on the cluster must not answer for this one
        futures = {client.submit(execute, work, task, pure=False): task.label for task in tasks}
        try:
            for future in as_completed(futures):
                lost = future.exception()
                outcome = Outcome(futures[future], error=_lost(lost)) if lost is not None else future.result()
                if outcome.stopped:
                    outcome = Outcome(outcome.label, error="stopped on its worker")
                done(outcome)
        except BaseException:
            client.cancel(list(futures), force=True)
            raise


def _lost(error: BaseException) -> str:
    if type(error).__name__ == "KilledWorker":
        return "its workers died, as often as the scheduler allows (a crashing FMU, or too little memory); given up"
    return f"{type(error).__name__}: {' '.join(str(error).split())}"


def clear_unfinished(work: Work, tasks: Iterable[Task]) -> None:
    """Drop what broken-off attempts at these runs left."""
    folder, labels = work.folder / UNFINISHED, {task.label for task in tasks}
    for path in folder.iterdir() if folder.exists() else ():
        if path.name.rpartition(".")[0] in labels:
            shutil.rmtree(path, ignore_errors=True)
