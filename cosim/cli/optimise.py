"""`fowt optimise`: tune dampers on the simplified model's FMU."""

from __future__ import annotations

import math
import os
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_args

import typer

from cosim.cli.build import build_fmus
from cosim.cli.console import Format, FormatOption
from cosim.cli.optimise_report import (
    polishing,
    progress_bar,
    report,
    report_front,
    report_scenarios,
    resumable,
    simulation_bar,
    write_result,
)
from cosim.cli.run import _pair, _value, free_path
from cosim.cli.scenario_options import How, ObjectiveName, ScenarioOptions
from cosim.errors import CosimError, nearest
from cosim.recording import new_folder
from cosim.ssp import read_parameters

if TYPE_CHECKING:
    from optimisation.tuning import Request

CPUS = os.cpu_count() or 1


class SearchMethod(StrEnum):
    """Names of the single-objective searches."""

    GA = "ga"
    DE = "de"
    CMA_ES = "cma-es"
    SURROGATE = "surrogate"


ParameterOption = Annotated[
    list[str] | None, typer.Option("--set", metavar="PARAM=VALUE", help="A parameter of the simplified model.")
]
SetFileOption = Annotated[
    list[Path] | None, typer.Option("--ssv", metavar="FILE.ssv", help="Parameter set of the simplified model.")
]
BoundsOption = Annotated[
    list[str] | None, typer.Option("--bounds", metavar="NAME=LOW:HIGH", help="Other bounds than those of eq. 14.")
]
VariableOption = Annotated[
    list[str] | None,
    typer.Option("--variable", metavar="NAME=LOW:HIGH", help="A further design variable: any real parameter."),
]
FmuOption = Annotated[Path | None, typer.Option(help="Another FMU with the simplified model's variables.")]
FolderOption = Annotated[Path | None, typer.Option("--out", help="New folder for the results.")]
DaskOption = Annotated[
    str | None, typer.Option(metavar="ADDRESS", help="Evaluate on a Dask cluster: its scheduler, tcp://HOST:8786.")
]
WorkersOption = Annotated[int, typer.Option(min=1, help="Threads; the result does not depend on it.")]


def optimise(
    damper: Annotated[
        str | None, typer.Argument(help="tmd-n, tmd-p, mtmd; coupled: any arrangement. Not needed with --resume.")
    ] = None,
    objective: Annotated[
        ObjectiveName | None,
        typer.Option(
            help="decay (default): of the simplified model; spectral: linear models; coupled: co-simulations."
        ),
    ] = None,
    method: Annotated[
        SearchMethod | None,
        typer.Option(
            help="ga: the paper's (default); de: differential evolution; cma-es; surrogate (default if coupled)."
        ),
    ] = None,
    seed: Annotated[int | None, typer.Option(min=0, help="Seed of the search; 1 by default.")] = None,
    population: Annotated[int | None, typer.Option(min=1, help="By default the method's own; ga: 100.")] = None,
    generations: Annotated[int | None, typer.Option(min=1, help="Largest number; ga: 50.")] = None,
    evaluations: Annotated[
        int | None, typer.Option(min=2, help="Largest number of designs (default: 5000; surrogate: 60).")
    ] = None,
    bounds: BoundsOption = None,
    variable: VariableOption = None,
    set_: ParameterOption = None,
    ssv: SetFileOption = None,
    cases: Annotated[str | None, typer.Option(help="coupled: load cases, 'lc1,lc3', with weights 'lc1=2,lc3'.")] = None,
    seeds: Annotated[
        str | None, typer.Option(metavar="1:3,8", help="coupled: seeds of wind and sea (default: the case's).")
    ] = None,
    vary: Annotated[
        list[str] | None, typer.Option(metavar="COMPONENT.PARAM=V1,V2", help="coupled: scenarios of uncertain values.")
    ] = None,
    until: Annotated[float | None, typer.Option(metavar="T", help="coupled: end of each run, s.")] = None,
    channels: Annotated[str | None, typer.Option(help="Responses to reduce (default: PtfmPitch,TTDspFA).")] = None,
    how: Annotated[
        How | None, typer.Option("--aggregate", help="How many responses make one fitness: worst by default.")
    ] = None,
    relative_to: Annotated[
        str | None, typer.Option(metavar="DESIGN", help="Arrangement or .ssv file to compare with (default: none).")
    ] = None,
    start: Annotated[
        list[str] | None, typer.Option(metavar="DESIGN", help="surrogate: arrangement or .ssv file to begin with.")
    ] = None,
    models: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="Linear models: for spectral, or to guide the surrogate.")
    ] = None,
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

    A checkpoint follows each generation; after an interruption:
    [bold]fowt optimise --resume FOLDER[/bold]

    Example: [bold]fowt optimise mtmd --out new[/bold], and then
    [bold]fowt run lc4 --damper mtmd --ssv new/tuned.ssv[/bold]
    """
    from optimisation.checkpoint import CHECKPOINT

    quiet = output is Format.JSON
    known = damper and known_damper(damper)
    given: dict[str, Any] = {
        "damper": known, "method": "nsga2" if pareto else method and method.value,
        "seed": seed, "population": population, "generations": generations, "evaluations": evaluations,
        "parameters": parameters(set_, ssv) or None, "bounds": parsed_bounds(bounds) or None,
        "variables": parsed_bounds(variable, "--variable") or None,
    }  # fmt: skip
    if pareto and (method or polish):
        raise CosimError(f"--pareto has its own method: leave out {'--method' if method else '--polish'}")
    if resume and folder:
        raise CosimError("--resume goes on in its own folder: leave out --out")
    options = ScenarioOptions(objective, cases, seeds, vary, until, channels, how, relative_to, start, models)
    request = _request(given | options.settings(given, resume), resume)
    if polish and (request.method == "nsga2" or request.objective != "decay"):
        why = "one optimum, not a front" if request.method == "nsga2" else "the free decay's optimum only"
        raise CosimError(f"--polish refines {why}: leave it out")
    if dask and (request.method == "nsga2" or request.objective != "decay"):
        raise CosimError(f"--dask evaluates the free decay only: leave out --{'pareto' if pareto else 'dask'}")
    if request.objective == "decay":
        decay_damper(request.damper)
    request.task()  # refuses bad bounds before anything is built
    if request.objective != "decay":
        if pareto or fmu:
            raise CosimError(f"{'--pareto' if pareto else '--fmu'} is for the free decay: leave it out")
        _optimise_scenarios(request, models, folder, resume, workers, quiet)
        return
    file = simplified(fmu, quiet)
    target = resume or new_folder(folder or free_path(Path("runs") / f"optimise-{request.damper}"))
    settings: dict[str, Any] = {"workers": workers, "checkpoint": target / CHECKPOINT, "resume": resume is not None}
    with resumable(target):
        if request.method == "nsga2":
            from optimisation.pareto import pareto as search_front

            with progress_bar(request, quiet) as progress:
                front = search_front(request, file, progress=progress, **settings)
            report_front(front, target, quiet)
        else:
            from optimisation.tuning import refine, tune

            with progress_bar(request, quiet) as progress:
                result = tune(request, file, progress=progress, dask=dask, **settings)
            written = write_result(result, target)
            if polish:
                with polishing(target, quiet) as follow:
                    result = refine(result, request, file, workers=workers, progress=follow)
                written = write_result(result, target)
            report(result, written, target, quiet)


def _optimise_scenarios(
    request: Request, models: Path | None, folder: Path | None, resume: Path | None, workers: int, quiet: bool
) -> None:
    from cosim.cli.scenarios import judge
    from optimisation.checkpoint import CHECKPOINT
    from optimisation.coupled import STORE
    from optimisation.scenario_tuning import checked_starts, tune_scenarios

    judged = judge(request, models, quiet=quiet)
    checked_starts(request, judged.task)  # before there is a folder
    target = resume or new_folder(folder or free_path(Path("runs") / f"optimise-{request.damper}-{request.objective}"))
    with resumable(target), simulation_bar(request, quiet) as (tick, progress):
        options = {"store": target / STORE, "workers": workers, "tick": tick}
        result = tune_scenarios(
            request, lambda: judged.fitness(options), judged.task, judged.digests, prior=judged.prior,
            progress=progress, checkpoint=target / CHECKPOINT, resume=resume is not None,
        )  # fmt: skip
    report_scenarios(result, target, quiet)


def known_damper(name: str) -> str:
    """The name, if it is one of an arrangement that can be tuned."""
    from optimisation.objective import DamperName

    if name not in get_args(DamperName):
        raise CosimError(f"nothing to tune for '{name}'{nearest(name, get_args(DamperName))}")
    return name


def decay_damper(name: str) -> str:
    """The name, if it is one of an arrangement that the simplified model has."""
    from optimisation.objective import PUBLISHED

    if known_damper(name) not in PUBLISHED:
        raise CosimError(
            f"{name}: the simplified model has mass dampers only; tune it with --objective coupled --cases lc4"
        )
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


def parsed_bounds(items: list[str] | None, option: str = "--bounds") -> dict[str, tuple[float, float]]:
    """Bounds from NAME=LOW:HIGH."""
    found = {}
    for name, text in (_pair(i, option, "NAME=LOW:HIGH") for i in items or []):
        try:
            low, high = (float(part) for part in text.split(":"))
        except ValueError as error:
            raise CosimError(f"{option} {name}={text}: write it as NAME=LOW:HIGH") from error
        if not (math.isfinite(low) and math.isfinite(high) and low < high):
            raise CosimError(f"{option} {name}={text}: the lower bound comes first, both finite")
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
        return Request.of_problem(saved).resolved()
    if "damper" not in asked:
        raise CosimError("name a damper to tune: tmd-n, tmd-p, mtmd; with --objective coupled also tlcd-p, tmdi-n")
    return Request(**asked).resolved()
