"""`fowt map`: the fitness over two design variables."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from cosim.cli.console import Format, FormatOption, count_progress, emit, out, warn
from cosim.cli.optimise import (
    CPUS,
    BoundsOption,
    FmuOption,
    FolderOption,
    ParameterOption,
    SetFileOption,
    WorkersOption,
    decay_damper,
    parameters,
    parsed_bounds,
    simplified,
)
from cosim.cli.run import free_path
from cosim.errors import CosimError
from cosim.recording import new_folder


def fitness_map(
    damper: Annotated[str, typer.Argument(help="tmd-n, tmd-p or mtmd.")],
    x: Annotated[str | None, typer.Option(help="Design variable along x; the damper's stiffness.")] = None,
    y: Annotated[str | None, typer.Option(help="Design variable along y; the damper's damping.")] = None,
    points: Annotated[int, typer.Option(min=3, help="Along either.")] = 41,
    at: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="Result of 'fowt optimise' for the other variables.")
    ] = None,
    bounds: BoundsOption = None,
    set_: ParameterOption = None,
    ssv: SetFileOption = None,
    fmu: FmuOption = None,
    folder: FolderOption = None,
    workers: WorkersOption = CPUS,
    output: FormatOption = Format.TEXT,
) -> None:
    """Map the fitness over two variables, with its optimum, table 4 and classical tunings; write map.png and map.csv.

    Example: [bold]fowt map tmd-p --x platform_damper.k --y platform_damper.c[/bold]
    """
    from optimisation.sensitivity import fitness_map as evaluate
    from optimisation.sensitivity import plot_map, write_csv

    quiet = output is Format.JSON
    place = "nacelle_damper" if decay_damper(damper) == "tmd-n" else "platform_damper"
    held = _result_parameters(at) if at else {}
    limits, values, file = parsed_bounds(bounds), parameters(set_, ssv), simplified(fmu, quiet)
    with count_progress(quiet) as bar:
        task = bar.add_task(f"mapping {damper}", total=points**2, note="")
        found = evaluate(
            damper, file, x or f"{place}.k", y or f"{place}.c", points=points, held=held, parameters=values,
            bounds=limits, workers=workers, progress=lambda done: bar.update(task, completed=done),
        )  # fmt: skip
    target = new_folder(folder or free_path(Path("runs") / f"map-{damper}"))
    written = [write_csv(found, target / "map.csv"), plot_map(found, target / "map.png")]
    if found.failures:
        warn(f"{found.failures} evaluations failed and are left blank; the first: {found.first_failure}")
    if quiet:
        marks = [{"label": m.label, found.x.name: m.x, found.y.name: m.y, "fitness": m.fitness} for m in found.marks]
        emit({"marks": marks, "held": found.held, "failures": found.failures, "folder": str(target)})
        return
    for m in found.marks:
        out.print(
            f"  {m.label:28s} {found.x.name} {m.x:9.1f}, {found.y.name} {m.y:9.1f}: {m.fitness:.4f} m", soft_wrap=True
        )
    out.print(found.optimum.verdict, soft_wrap=True)
    out.print(f"{target}: {', '.join(p.name for p in written)}", soft_wrap=True)


def _result_parameters(folder: Path) -> dict[str, float]:
    try:
        return dict(json.loads((folder / "result.json").read_text(encoding="utf-8"))["parameters"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise CosimError(f"--at {folder}: is no folder of 'fowt optimise' with a result.json") from error
