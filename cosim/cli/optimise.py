"""`fowt optimise`: tune dampers on the simplified model's FMU."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_args

import typer

from cosim.cli.build import build_fmus
from cosim.cli.console import Format, FormatOption, count_progress, emit, err, out, warn
from cosim.cli.run import _pair, _value, free_path
from cosim.errors import CosimError, nearest
from cosim.recording import new_folder
from cosim.ssp import read_parameters

if TYPE_CHECKING:
    from optimisation.pareto import Front
    from optimisation.result import OptimisationResult
    from optimisation.search import Generation
    from optimisation.tuning import Request

CPUS = os.cpu_count() or 1


class SearchMethod(StrEnum):
    """Names of the single-objective searches."""

    GA = "ga"
    DE = "de"
    CMA_ES = "cma-es"


ParameterOption = Annotated[
    list[str] | None, typer.Option("--set", metavar="PARAM=VALUE", help="A parameter of the simplified model.")
]
SetFileOption = Annotated[
    list[Path] | None, typer.Option("--ssv", help="Parameter set of the simplified model, such as identified.ssv.")
]
BoundsOption = Annotated[
    list[str] | None, typer.Option("--bounds", metavar="NAME=LOW:HIGH", help="Other bounds than those of eq. 14.")
]
FmuOption = Annotated[Path | None, typer.Option(help="Another FMU with the simplified model's variables.")]
FolderOption = Annotated[Path | None, typer.Option("--out", help="New folder for the results.")]
DaskOption = Annotated[
    str | None, typer.Option(metavar="ADDRESS", help="Evaluate on a Dask cluster: its scheduler, tcp://HOST:8786.")
]
WorkersOption = Annotated[int, typer.Option(min=1, help="Threads; the result does not depend on it.")]


def optimise(
    damper: Annotated[str | None, typer.Argument(help="tmd-n, tmd-p or mtmd; not needed with --resume.")] = None,
    method: Annotated[
        SearchMethod | None,
        typer.Option(help="ga: the paper's genetic algorithm (default); de: differential evolution; cma-es."),
    ] = None,
    seed: Annotated[int | None, typer.Option(min=0, help="Seed of the search; 1 by default.")] = None,
    population: Annotated[int | None, typer.Option(min=2, help="By default the method's own; ga: 100.")] = None,
    generations: Annotated[int | None, typer.Option(min=1, help="Largest number; ga: 50.")] = None,
    evaluations: Annotated[int | None, typer.Option(min=2, help="Largest number of simulations; 5000.")] = None,
    bounds: BoundsOption = None,
    set_: ParameterOption = None,
    ssv: SetFileOption = None,
    polish: Annotated[bool, typer.Option("--polish", help="Refine the best design and certify it.")] = False,
    pareto: Annotated[bool, typer.Option("--pareto", help="Response against damper stroke, by NSGA-II.")] = False,
    fmu: FmuOption = None,
    folder: FolderOption = None,
    resume: Annotated[Path | None, typer.Option(help="Continue the search in this folder, with its settings.")] = None,
    workers: WorkersOption = CPUS,
    dask: DaskOption = None,
    output: FormatOption = Format.TEXT,
) -> None:
    """Tune damper stiffness and damping; write result.json, tuned.ssv and convergence.png (or pareto.csv and .png).

    A checkpoint follows each generation; after an interruption: [bold]fowt optimise --resume FOLDER[/bold].

    Example: [bold]fowt optimise mtmd --seed 3[/bold], then [bold]fowt run lc4 --damper mtmd --ssv .../tuned.ssv[/bold]
    """
    from optimisation.checkpoint import CHECKPOINT

    quiet = output is Format.JSON
    given: dict[str, Any] = {
        "damper": damper and known_damper(damper),
        "method": "nsga2" if pareto else method and method.value,
        "seed": seed, "population": population, "generations": generations, "evaluations": evaluations,
        "parameters": parameters(set_, ssv) or None, "bounds": parsed_bounds(bounds) or None,
    }  # fmt: skip
    if pareto and (method or polish):
        raise CosimError(f"--pareto has its own method: leave out {'--method' if method else '--polish'}")
    if resume and folder:
        raise CosimError("--resume goes on in its own folder: leave out --out")
    request = _request(given, resume)
    if dask and request.method == "nsga2":
        raise CosimError("--dask evaluates the decay's deviation only: leave out --pareto")
    if polish and request.method == "nsga2":
        raise CosimError("--polish refines one optimum, not a front: leave it out")
    request.task()  # refuses bad bounds before anything is built
    file = simplified(fmu, quiet)
    target = resume or new_folder(folder or free_path(Path("runs") / f"optimise-{request.damper}"))
    options: dict[str, Any] = {"workers": workers, "checkpoint": target / CHECKPOINT, "resume": resume is not None}
    with _resumable(target):
        if request.method == "nsga2":
            from optimisation.pareto import pareto as search_front

            with _progress(request, quiet) as progress:
                front = search_front(request, file, progress=progress, **options)
            _report_front(front, target, quiet)
        else:
            from optimisation.tuning import refine, tune

            with _progress(request, quiet) as progress:
                result = tune(request, file, progress=progress, dask=dask, **options)
            written = _write(result, target)
            if polish:
                with polishing(target, quiet) as follow:
                    result = refine(result, request, file, workers=workers, progress=follow)
                written = _write(result, target)
            _report(result, written, target, quiet)


def known_damper(name: str) -> str:
    """The name, if it is one of an arrangement that can be tuned."""
    from optimisation.objective import DamperName

    if name not in get_args(DamperName):
        raise CosimError(f"nothing to tune for '{name}'{nearest(name, get_args(DamperName))}")
    return name


def parameters(items: list[str] | None, files: list[Path] | None = None) -> dict[str, float]:
    """Values from parameter set files, in SI units as the simplified model's, and then from --set PARAM=VALUE."""
    values: dict[str, float] = {}
    for file in files or []:
        for name, start in read_parameters(file).items():
            if not isinstance(start.value, (int, float)):
                raise CosimError(f"{file}: {name} is no number")
            factor, offset = (start.unit.factor, start.unit.offset) if start.unit else (1.0, 0.0)
            values[name] = factor * float(start.value) + offset
    for name, text in (_pair(i, "--set", "PARAM=VALUE") for i in items or []):
        if not isinstance(value := _value(text), (int, float)):
            raise CosimError(f"--set {name}={text}: give a number")
        values[name] = float(value)
    return values


def parsed_bounds(items: list[str] | None) -> dict[str, tuple[float, float]]:
    """Bounds from --bounds NAME=LOW:HIGH."""
    found = {}
    for name, text in (_pair(i, "--bounds", "NAME=LOW:HIGH") for i in items or []):
        try:
            low, high = (float(part) for part in text.split(":"))
        except ValueError as error:
            raise CosimError(f"--bounds {name}={text}: write it as NAME=LOW:HIGH") from error
        if not (math.isfinite(low) and math.isfinite(high) and low < high):
            raise CosimError(f"--bounds {name}={text}: the lower bound comes first, both finite")
        found[name] = (low, high)
    return found


def simplified(fmu: Path | None, quiet: bool) -> Path:
    """The FMU named, or the package's own, built if need be."""
    file = fmu or build_fmus(["simplified"], quiet=quiet)["simplified"]
    if not file.is_file():
        raise CosimError(f"FMU {file}: no such file")
    return file


def _request(given: dict[str, Any], resume: Path | None) -> Request:
    """What the command line asks for; with --resume, what it leaves out is the checkpoint's."""
    from optimisation.checkpoint import CHECKPOINT, read_checkpoint, refuse_another
    from optimisation.tuning import Request

    asked = {name: value for name, value in given.items() if value is not None}
    if resume is not None:
        if (resume / "result.json").exists():
            raise CosimError(f"{resume}: this search has ended, see its result.json; nothing to resume")
        saved = read_checkpoint(resume / CHECKPOINT)[0]
        if "bounds" in asked:
            asked["bounds"] = saved["bounds"] | asked["bounds"]
        refuse_another(resume / CHECKPOINT, saved, saved | asked)
        asked = {name: value for name, value in saved.items() if name != "fmu"}
        asked["bounds"] = {name: tuple(limits) for name, limits in asked["bounds"].items()}
    elif "damper" not in asked:
        raise CosimError("name a damper to tune: tmd-n, tmd-p or mtmd")
    return Request(**asked).resolved()


@contextmanager
def _resumable(folder: Path) -> Iterator[None]:
    """Say how to go on when the user interrupts."""
    try:
        yield
    except KeyboardInterrupt:
        from optimisation.checkpoint import CHECKPOINT

        if (folder / CHECKPOINT).exists():
            warn(f"interrupted; continue with: fowt optimise --resume {folder}")
        else:
            warn("interrupted before the first generation was complete")
        raise typer.Exit(130) from None
    finally:
        if not any(folder.iterdir()):  # a failed search has nothing to leave
            folder.rmdir()


@contextmanager
def _progress(request: Request, quiet: bool) -> Iterator[Callable[[Generation], None]]:
    """A bar over evaluations, with generation, best fitness and time left."""
    with count_progress(quiet) as bar:
        label = f"tuning {request.damper} by {request.method}"
        task = bar.add_task(label, total=request.evaluations, note="")

        def show(g: Generation) -> None:
            note = f"generation {g.number}, best {g.best:.4f} m"
            if g.failures:
                note += f", {g.failures} failed"
            bar.update(task, completed=g.evaluations, note=note)

        yield show


@contextmanager
def polishing(folder: Path, quiet: bool) -> Iterator[Callable[[int, float], None]]:
    """Show how a polish gets on; if the user interrupts, say that the search's result is kept."""
    with nullcontext() if quiet else err.status("polishing") as status:

        def show(count: int, best: float) -> None:
            if status is not None:
                status.update(f"polishing: {count} evaluations, best {best:.7f} m")

        try:
            yield show
        except KeyboardInterrupt:
            warn(f"polish interrupted; {folder} has the result of the search, not polished")
            raise typer.Exit(130) from None


def _write(result: OptimisationResult, target: Path) -> list[Path]:
    from optimisation.result import plot_convergence, write_json, write_ssv

    return [write_ssv(result, target / "tuned.ssv"), plot_convergence(result, target / "convergence.png"),
            write_json(result, target / "result.json")]  # fmt: skip


def _report(result: OptimisationResult, written: list[Path], target: Path, quiet: bool) -> None:
    if result.failures:
        warn(f"{result.failures} evaluations failed and were penalised; the first: {result.first_failure}")
    if quiet:
        emit({
            "fitness": result.fitness, "parameters": result.parameters, "evaluations": result.evaluations,
            "generations": result.generations, "failures": result.failures, "seconds": result.seconds,
            "certified": result.local_optimum and result.local_optimum.certified, "folder": str(target),
        })  # fmt: skip
        return
    out.print(f"fitness {result.fitness:.4f} m after {result.evaluations} evaluations in {result.seconds:.1f} s")
    for name, value in result.parameters.items():
        note = "  (at a bound of the search)" if name in result.at_bound else ""
        out.print(f"  {name:20s} {value:10.1f} {'N/m' if name.endswith('.k') else 'N s/m'}{note}")
    if result.local_optimum:
        out.print(f"{result.local_optimum.verdict}; gained {result.local_optimum.gain:.1e} m", soft_wrap=True)
    out.print(f"{target}: {', '.join(p.name for p in written)}", soft_wrap=True)


def _report_front(front: Front, target: Path, quiet: bool) -> None:
    from optimisation.pareto import plot_front, write_front

    written = [plot_front(front, target / "pareto.png"), *write_front(front, target)]
    failures = front.history[-1].failures
    if failures:
        warn(f"{failures} evaluations failed and were penalised; the first: {front.first_failure}")
    if quiet:
        emit({"designs": front.designs.to_dict("records"), "optima": front.optima.to_dict("records"),
              "failures": failures, "seconds": front.seconds, "folder": str(target)})  # fmt: skip
        return
    out.print(f"{len(front.designs)} designs after {front.history[-1].evaluations} evaluations")
    response, stroke = front.designs.columns[-2:]
    for _, row in front.optima.iterrows():
        out.print(f"  {row[response]:.4f} m of response at {row[stroke]:.2f} m of stroke")
    out.print(f"{target}: {', '.join(p.name for p in written)}", soft_wrap=True)
