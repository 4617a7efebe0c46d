"""`fowt converge`: errors of the coupling against the monolithic run, for ever smaller steps."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import pandas as pd
import typer
from rich.table import Table

from cosim.case import LoadCase, read_case
from cosim.cli.console import Format, FormatOption, count_progress, emit, out
from cosim.cli.run import MAIN_CHANNELS, Changes, Prepared, SeedOption, SetOption, free_path, prepare
from cosim.convergence import SCHEMES, Scheme, settled, steps_of, study
from cosim.errors import CosimError, RunFailed, nearest
from cosim.recording import new_folder, read_results
from cosim.run import simulate


def converge(
    case: Annotated[str, typer.Argument(help="Load case: a name ('fowt list') or a .toml file.")],
    damper: Annotated[str | None, typer.Option(help="Damper arrangement.")] = None,
    step: Annotated[float | None, typer.Option(metavar="H", help="Coarsest step, s; the case's by default.")] = None,
    halvings: Annotated[int, typer.Option(min=1, max=8, help="How often it is halved.")] = 3,
    until: Annotated[float, typer.Option(metavar="T", help="End of the runs, s.")] = 60.0,
    transient: Annotated[float, typer.Option(help="Left out of the errors, s.")] = 0.0,
    seed: SeedOption = None,
    set_: SetOption = None,
    channels: Annotated[str, typer.Option(help="Channels whose errors are taken.")] = ",".join(MAIN_CHANNELS),
    folder: Annotated[Path | None, typer.Option("--out", help="New folder for the results.")] = None,
    output: FormatOption = Format.TEXT,
) -> None:
    """Halve the step and show error and order of each algorithm, against the same system as one ODE.

    Errors are root mean squares over standard deviations, the largest of the
    channels.

    Example: [bold]fowt converge lc4 --damper none --until 60[/bold]
    """
    from cosim.cli.plots import plot_convergence

    quiet = output is Format.JSON
    chosen = read_case(case)
    steps = steps_of(chosen.step if step is None else step, halvings)
    if not 0.0 <= transient < until:
        raise CosimError(f"--transient {transient:g} s must be at least 0 and before the end of the runs, {until:g} s")
    target = new_folder(folder or free_path(Path("runs") / f"{chosen.name}-convergence"))
    changes = Changes(set=set_ or (), seed=seed, until=until)
    names = [c.strip() for c in channels.split(",")]
    with count_progress(quiet) as progress:
        task = progress.add_task("runs", total=1 + len(SCHEMES) * len(steps), note="monolithic reference")
        reference = _run(chosen, damper, replace(changes, monolithic=True), steps[0], steps[0], target / "monolithic")
        assert reference is not None
        progress.advance(task)
        for name in names:
            if name not in reference.columns and channels != ",".join(MAIN_CHANNELS):
                raise CosimError(f"--channels: the case has no channel '{name}'{nearest(name, reference.columns)}")
        names = [n for n in names if n in reference.columns and reference[n].std() > 0.0]
        if not names:
            raise CosimError(f"none of the channels {channels} moves in this case; name others with --channels")

        def one(job: tuple[Scheme, float]) -> pd.DataFrame | None:
            scheme, h = job
            place = target / scheme.label.replace(", ", "-").replace(" ", "-") / f"{h:.6g}"
            frame = _run(chosen, damper, replace(changes, stepping=scheme.settings()), h, steps[0], place)
            progress.update(task, advance=1, note=f"{scheme.label}, {h:g} s")
            return frame

        jobs = [(scheme, h) for scheme in SCHEMES for h in steps]
        with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
            frames = dict(zip(jobs, pool.map(one, jobs), strict=True))
    table = study(lambda scheme, h: frames[scheme, h], reference, SCHEMES, steps, names, transient)
    table.to_csv(target / "convergence.csv", index=False)
    picture = plot_convergence(table, f"{chosen.name}, {until:g} s: {', '.join(names)}", target / "convergence.png")
    if quiet:
        emit({"table": table.to_dict(orient="records"), "orders": settled(table), "picture": str(picture)})
        return
    _show(table, steps)
    out.print(f"largest error of {', '.join(names)}, over its standard deviation; picture: {picture}", soft_wrap=True)


def _run(
    case: LoadCase, damper: str | None, changes: Changes, step: float, coarsest: float, folder: Path
) -> pd.DataFrame | None:
    """Results on the grid of the coarsest step; None where a coupled run breaks off."""
    prepared: Prepared = prepare(case, damper, replace(changes, step=step), quiet=True)
    settings = replace(prepared.settings, decimation=round(coarsest / step), transient=0.0)
    try:
        result = simulate(prepared.system, settings, folder)
    except RunFailed:
        if changes.monolithic:
            raise
        return None
    if result.status == "stopped":
        raise KeyboardInterrupt
    return read_results(result.folder)


def _show(table: pd.DataFrame, steps: list[float]) -> None:
    view = Table("error at step", box=None, pad_edge=False)
    for h in steps:
        view.add_column(f"{h * 1e3:.4g} ms", justify="right")
    view.add_column("order", justify="right")
    for (label, part), order in zip(table.groupby("scheme", sort=False), settled(table).values(), strict=True):
        cells = [f"{e:.1e}" if e < float("inf") else "broke off" for e in part["error"]]
        view.add_row(str(label), *cells, f"{order:.1f}")
    out.print(view)
