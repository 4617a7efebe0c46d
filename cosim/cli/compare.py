"""`fowt compare`: suppression rates of damper arrangements, with histories and spectra."""

from __future__ import annotations

import json
import os
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Annotated, Any

import pandas as pd
import typer
from rich.progress import TaskID
from rich.table import Table

from cosim.case import read_case
from cosim.cli.console import Format, FormatOption, Interrupted, emit, number, out, simulation_progress, warn
from cosim.cli.run import MAIN_CHANNELS, Changes, SeedOption, SetOption, SsvOption, UntilOption, free_path, prepare
from cosim.errors import CosimError
from cosim.recording import read_results
from cosim.run import Progress


def compare(
    what: Annotated[list[str], typer.Argument(help="One load case to run, or the folders of finished runs.")],
    dampers: Annotated[str, typer.Option(help="Arrangements to run, the first being the reference.")] = "none,mtmd",
    seed: SeedOption = None,
    until: UntilOption = None,
    set_: SetOption = None,
    ssv: SsvOption = None,
    channels: Annotated[str, typer.Option(help="Channels to compare.")] = ",".join(MAIN_CHANNELS),
    folder: Annotated[Path | None, typer.Option("--out", help="New folder for the results.")] = None,
    output: FormatOption = Format.TEXT,
) -> None:
    """Compare damper arrangements: standard deviations, suppression rates, histories and spectra.

    Given a load case, it runs each arrangement in the same wind and sea first.

    Example: [bold]fowt compare lc4 --dampers none,tmd-n,tmd-p,mtmd[/bold]
    """
    from cosim.cli.plots import plot_comparison
    from optimisation.evaluation import compare as evaluate

    quiet = output is Format.JSON
    runs = [Path(w) for w in what if Path(w).is_dir()]
    if runs and all(Path(w).exists() for w in what):  # a shell's * also names the pictures beside the runs
        if set_ or ssv or seed is not None or until is not None:
            raise CosimError("--set, --ssv, --seed and --until go with a load case, not with finished runs")
        if folder:
            folder.mkdir(parents=True, exist_ok=True)
        picture_folder = folder or runs[0].parent
    elif len(what) == 1:
        changes = Changes(set=set_ or (), ssv=ssv or (), seed=seed, until=until)
        chosen = list(dict.fromkeys(d.strip() for d in dampers.split(",") if d.strip()))
        if not chosen:
            raise CosimError("--dampers names no arrangement; 'fowt list' shows all")
        runs = _run_all(what[0], chosen, changes, folder, quiet)
        picture_folder = runs[0].parent
    else:
        missing = next(w for w in what if not Path(w).is_dir())
        raise CosimError(f"'{missing}' is no folder of a run; give one load case, or folders only")
    frames, units, transient = _read(runs, listed=len(what) > 1 or Path(what[0]).is_dir())
    names = list(dict.fromkeys(c.strip() for c in channels.split(",")))
    shown = [n for n in names if all(n in f.columns for f in frames.values())]
    if not shown:
        raise CosimError(f"the runs have none of the channels {', '.join(names)} in common")
    if set(names) - set(shown) and channels != ",".join(MAIN_CHANNELS):
        warn(f"not in every run, left out: {', '.join(n for n in names if n not in shown)}")
    table = evaluate(frames, shown, transient=transient)
    picture = plot_comparison(frames, shown, units, transient, free_path(picture_folder / "comparison.png"))
    if quiet:
        rows = table.reset_index().to_dict(orient="records")
        emit({"runs": [str(r) for r in runs], "table": rows,
              "picture": str(picture)})  # fmt: skip
        return
    _show(table, list(frames), shown, units)
    out.print(f"statistics after {transient:g} s; picture: {picture}", soft_wrap=True)


def _run_all(name: str, dampers: list[str], changes: Changes, folder: Path | None, quiet: bool) -> list[Path]:
    """Run each arrangement; two at a time on two cores, since the FMUs run without Python."""
    case = read_case(name)
    with simulation_progress(quiet) as progress:
        prepared = [prepare(case, d, changes, quiet=quiet) for d in dampers]
        root = folder or free_path(Path("runs") / f"{case.name}-comparison")
        tasks = [progress.add_task(p.label, total=p.settings.stop) for p in prepared]
        stop = threading.Event()

        def follow(task: TaskID) -> Progress:
            def on_progress(time: float, *_: float) -> None:
                progress.update(task, completed=time)
                if stop.is_set():
                    raise KeyboardInterrupt

            return on_progress

        with ThreadPoolExecutor(max_workers=os.cpu_count() or 1) as pool:
            jobs = [
                pool.submit(p.execute, root / d, follow(task))
                for p, d, task in zip(prepared, dampers, tasks, strict=True)
            ]
            try:
                results = [job.result() for job in jobs]
            except BaseException as error:  # Ctrl-C or a failed run: the others stop too, and keep what they have
                stop.set()
                pool.shutdown(wait=True, cancel_futures=True)
                if not isinstance(error, KeyboardInterrupt):
                    raise
                progress.stop()
                raise Interrupted(f"stopped by the user; results until then are in {root}") from error
    for line in dict.fromkeys(w for r in results for w in r.warnings if not w.startswith("algebraic loop")):
        warn(line)
    return [r.folder for r in results]


def _read(runs: list[Path], listed: bool) -> tuple[dict[str, pd.DataFrame], dict[str, str], float]:
    """Results by label, their units, and the transient to drop; runs of different lengths are cut to the shortest.

    Args:
        listed: the runs were named by the user, in any order: the undamped one is the reference.
    """
    settings = {run: _settings(run) for run in runs}
    if listed:
        runs = sorted(runs, key=lambda run: settings[run]["about"].get("damper") != "none")
    frames = {run.name if [r.name for r in runs].count(run.name) == 1 else str(run): read_results(run) for run in runs}
    units = {name: unit for frame in frames.values() for name, unit in frame.attrs.get("units", {}).items()}
    for key in ("case", "seed"):
        found = list(dict.fromkeys(str(settings[run]["about"].get(key)) for run in runs))
        if len(found) > 1:
            warn(f"the runs differ in {key}: {', '.join(found)}")
    end = min(frame.index[-1] for frame in frames.values())
    if any(frame.index[-1] > end for frame in frames.values()):
        warn(f"the runs differ in length: compared up to {end:g} s")
        frames = {label: frame.loc[:end] for label, frame in frames.items()}
    return frames, units, max(float(s["transient"]) for s in settings.values())


def _settings(run: Path) -> dict[str, Any]:
    try:
        settings = json.loads((run / "run.json").read_text())["settings"]
        return {"about": dict(settings["about"]), "transient": float(settings["transient"])}
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise CosimError(f"{run}: no readable run.json ({type(error).__name__}: {error})") from error


def _show(table: pd.DataFrame, labels: list[str], channels: list[str], units: dict[str, str]) -> None:
    reference, *others = labels
    view = Table("standard deviation", box=None, pad_edge=False)
    view.add_column(reference, justify="right")
    for label in others:
        view.add_column(f"{label} (suppression)", justify="right")
    for channel in channels:
        cells = [f"{channel} ({units.get(channel, '')})", number(float(table.loc[(channel, reference), "std"]))]
        for label in others:
            row = table.loc[(channel, label)]
            cells.append(f"{number(float(row['std']))} ({row['suppression']:4.1f} %)")
        view.add_row(*cells)
    out.print(view)
