"""`fowt methods`: what search methods find, from several seeds."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, cast

import typer
from rich.table import Table

from cosim.cli.console import Format, FormatOption, count_progress, emit, out
from cosim.cli.optimise import (
    CPUS,
    FmuOption,
    FolderOption,
    ParameterOption,
    SearchMethod,
    SetFileOption,
    WorkersOption,
    decay_damper,
    parameters,
    simplified,
)
from cosim.cli.run import free_path
from cosim.cli.seeds import parsed_seeds
from cosim.errors import CosimError, nearest
from cosim.recording import new_folder

if TYPE_CHECKING:
    import pandas as pd

    from optimisation.objective import DamperName
    from optimisation.search import Generation


def methods(
    dampers: Annotated[list[str] | None, typer.Argument(help="tmd-n, tmd-p, mtmd; all three by default.")] = None,
    methods: Annotated[str, typer.Option(help="Search methods, with commas.")] = ",".join(SearchMethod),
    seeds: Annotated[str, typer.Option(metavar="1:3,8", help="Seeds of each search.")] = "1:10",
    evaluations: Annotated[
        int | None, typer.Option(min=2, help="Largest number of each search (default: 5000).")
    ] = None,
    polish: Annotated[bool, typer.Option(help="Polish each result too.")] = True,
    set_: ParameterOption = None,
    ssv: SetFileOption = None,
    fmu: FmuOption = None,
    folder: FolderOption = None,
    workers: WorkersOption = CPUS,
    output: FormatOption = Format.TEXT,
) -> None:
    """Compare search methods over seeds: best, median and worst fitness, and speed; write summary.csv and trials.csv.

    Example: [bold]fowt methods mtmd --seeds 1:10[/bold]
    """
    from optimisation.statistics import summary, table, trials
    from optimisation.tuning import Request

    quiet = output is Format.JSON
    chosen = [m.strip() for m in methods.split(",") if m.strip()]
    for name in chosen:
        if name not in list(SearchMethod):
            raise CosimError(f"--methods {name}: no such search method{nearest(name, list(SearchMethod))}")
    if not chosen:
        raise CosimError("--methods names no search method")
    numbers = parsed_seeds(seeds)
    values = parameters(set_, ssv)
    arrangements = dict.fromkeys(cast("DamperName", decay_damper(d)) for d in dampers or all_dampers())
    requests = [
        Request(d, method=SearchMethod(m).value, seed=s, evaluations=evaluations, parameters=values).resolved()
        for d in arrangements for m in dict.fromkeys(chosen) for s in numbers
    ]  # fmt: skip
    file = simplified(fmu, quiet)
    target = new_folder(folder or free_path(Path("runs") / "methods"))
    found = []
    with count_progress(quiet) as bar:
        task = bar.add_task("searching", total=sum(r.evaluations or 0 for r in requests), note="")
        for i, request in enumerate(requests):
            before = sum(r.evaluations or 0 for r in requests[:i])
            note = f"{request.damper} by {request.method}, seed {request.seed}"

            def show(g: Generation, before: int = before, note: str = note) -> None:
                bar.update(task, completed=before + g.evaluations, note=note)

            found += trials(request, file, workers=workers, polished=polish, progress=show)
            # after each search, so that an interruption loses one at most
            table(found).to_csv(target / "trials.csv", index=False)
            summary(found).to_csv(target / "summary.csv", index=False)
    result = summary(found)
    if quiet:
        emit({"summary": result.to_dict("records"), "folder": str(target)})
        return
    _show(result)
    out.print(f"{target}: summary.csv, trials.csv", soft_wrap=True)


def all_dampers() -> tuple[DamperName, ...]:
    """The arrangements of the simplified model."""
    from optimisation.objective import PUBLISHED

    return PUBLISHED


def _show(result: pd.DataFrame) -> None:
    title = "fitness in m; close: seeds that came within 1 mm of the best known"
    view = Table(box=None, pad_edge=False, title=title, title_justify="left")
    view.add_column("damper", no_wrap=True)
    view.add_column("method", no_wrap=True)
    for column in ("best", "median", "worst", "close", "runs", "runs/s"):
        view.add_column(column, justify="right", no_wrap=True)
    for _, r in result.iterrows():
        view.add_row(
            r["damper"], r["method"] + (" + polish" if r["polished"] else ""),
            *(f"{r[c]:.4f}" for c in ("best", "median", "worst")), f"{r['close']} of {r['seeds']}",
            f"{r['evaluations']:.0f}", f"{r['evaluations_per_second']:.0f}",
        )  # fmt: skip
    out.print(view)
