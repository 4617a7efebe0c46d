"""`fowt optimise`: tune dampers on the simplified model's FMU."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated, get_args

import typer

from cosim.cli.build import build_fmus
from cosim.cli.console import Format, FormatOption, count_progress, emit, out, warn
from cosim.cli.run import _pair, _value, free_path
from cosim.errors import CosimError, nearest
from cosim.recording import new_folder


def optimise(
    damper: Annotated[str, typer.Argument(help="tmd-n, tmd-p or mtmd.")],
    seed: Annotated[int, typer.Option(min=0, help="Seed of the genetic algorithm.")] = 1,
    population: Annotated[int, typer.Option(min=2)] = 100,
    generations: Annotated[int, typer.Option(min=1)] = 50,
    set_: Annotated[
        list[str] | None, typer.Option("--set", metavar="PARAM=VALUE", help="A parameter of the simplified model.")
    ] = None,
    fmu: Annotated[Path | None, typer.Option(help="Another FMU with the simplified model's variables.")] = None,
    folder: Annotated[Path | None, typer.Option("--out", help="New folder for the results.")] = None,
    workers: Annotated[int, typer.Option(min=1, help="Threads; the result does not depend on it.")] = os.cpu_count()
    or 1,
    output: FormatOption = Format.TEXT,
) -> None:
    """Tune damper stiffness and damping by a genetic algorithm; write result.json, tuned.ssv and convergence.png.

    Example: [bold]fowt optimise mtmd --seed 3[/bold], then [bold]fowt run lc4 --damper mtmd --ssv .../tuned.ssv[/bold]
    """
    from optimisation.objective import DamperName
    from optimisation.result import plot_convergence, write_json, write_ssv
    from optimisation.tuning import optimise as tune

    quiet = output is Format.JSON
    choice = next((name for name in get_args(DamperName) if name == damper), None)
    if choice is None:
        raise CosimError(f"nothing to tune for '{damper}'{nearest(damper, get_args(DamperName))}")
    file = fmu or build_fmus(["simplified"], quiet=quiet)["simplified"]
    if not file.is_file():
        raise CosimError(f"FMU {file}: no such file")
    values = {}
    for name, text in (_pair(i, "--set", "PARAM=VALUE") for i in set_ or []):
        if not isinstance(value := _value(text), (int, float)):
            raise CosimError(f"--set {name}={text}: give a number")
        values[name] = float(value)
    target = folder or free_path(Path("runs") / f"optimise-{damper}")
    with count_progress(quiet) as progress:
        task = progress.add_task(f"tuning {damper}", total=generations, note="")
        result = tune(
            choice, file, seed=seed, population=population, generations=generations, parameters=values, workers=workers,
            progress=lambda g: progress.update(task, completed=g.number, note=f"best {g.best:.4f} m"),
        )  # fmt: skip
    new_folder(target)
    written = [write_json(result, target / "result.json"), write_ssv(result, target / "tuned.ssv"),
               plot_convergence(result, target / "convergence.png")]  # fmt: skip
    if result.failures:
        warn(f"{result.failures} evaluations failed and were penalised; the first: {result.first_failure}")
    if quiet:
        emit({
            "fitness": result.fitness, "parameters": result.parameters, "evaluations": result.evaluations,
            "generations": result.generations, "seconds": result.seconds, "folder": str(target),
        })  # fmt: skip
        return
    out.print(f"fitness {result.fitness:.4f} m after {result.evaluations} evaluations in {result.seconds:.1f} s")
    for name, value in result.parameters.items():
        note = "  (at a bound of the search)" if name in result.at_bound else ""
        out.print(f"  {name:20s} {value:10.1f} {'N/m' if name.endswith('.k') else 'N s/m'}{note}")
    out.print(f"{target}: {', '.join(p.name for p in written)}", soft_wrap=True)
