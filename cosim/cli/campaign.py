"""`fowt campaign`: load cases x damper arrangements x seeds, in parallel; it may be interrupted at any moment."""

from __future__ import annotations

import json
import os
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from cosim.campaign.pool import run_here, run_on_dask
from cosim.campaign.store import RUNS, Outcome, Task, Work, finished_rows, foreign, locked, results_differ
from cosim.case import Damper, LoadCase, read_case, shipped_cases
from cosim.cli.build import build_fmus
from cosim.cli.campaign_plan import (
    CASES,
    DAMPERS,
    SEEDS,
    Earlier,
    Options,
    begun,
    command,
    in_order,
    made_plan,
    refuse_another,
    write_plan,
)
from cosim.cli.campaign_view import Progress, evaluate_all, show
from cosim.cli.console import Format, FormatOption, Interrupted, count_progress, emit, failure, note, warn
from cosim.cli.run import Changes, SetOption, SsvOption, UntilOption, free_path, prepare, wind_file
from cosim.cli.seeds import parsed_seeds
from cosim.errors import CosimError, nearest
from cosim.fmu import read_fmu
from cosim.run import RunSettings
from cosim.system import System, split_name
from cosim.verification.runs import Job
from fmus_src.units import conversion, unit
from optimisation.campaign.runs import (
    PLAN,
    TABLE,
    evaluation_digest,
    read_campaign,
    rows_of_run,
    run_name,
    table_digest,
    write_table,
)

TABLES = ("suppression", "ranking", "fatigue", "extremes", "dampers", "power", "paper")
SHOWN = 4  # names of runs in a message
OWN = (PLAN, TABLE, *(f"{name}.csv" for name in TABLES), f"{PLAN[:-5]}.part", f"{TABLE}.partial")


def campaign(
    cases: Annotated[list[str] | None, typer.Argument(help="Load cases; lc1 to lc5 by default.")] = None,
    dampers: Annotated[str, typer.Option(help="Damper arrangements.")] = DAMPERS,
    seeds: Annotated[str, typer.Option(metavar="1:3,8", help="Seeds of wind and sea.")] = SEEDS,
    ssv: SsvOption = None,
    set_: SetOption = None,
    until: UntilOption = None,
    workers: Annotated[int, typer.Option(min=1, help="Runs at a time on this machine.")] = os.cpu_count() or 1,
    dask: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="Run on a Dask cluster, such as tcp://host:8786.")
    ] = None,
    folder: Annotated[
        Path | None, typer.Option("--out", help="Folder; a campaign that is there already goes on, and keeps its runs.")
    ] = None,
    resume: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="Go on with the campaign in this folder, as it was begun.")
    ] = None,
    output: FormatOption = Format.TEXT,
) -> None:
    """Run load cases with every damper arrangement and seed: suppression rates with intervals, fatigue, extremes.

    All arrangements of one seed meet the same wind and sea. Finished runs are
    never repeated: after Ctrl-C or a crash the same command goes on.

    Example: [bold]fowt campaign lc3 lc4 --seeds 2:9 --out study[/bold]
    """
    quiet = output is Format.JSON
    usual = (DAMPERS, SEEDS)
    if resume is not None:
        if cases or folder or ssv or set_ or until is not None or (dampers, seeds) != usual:
            raise CosimError("--resume goes on as the campaign was begun; change it with --out and all its options")
        root, options = resume, begun(resume)
    else:
        root = folder or free_path(Path("runs") / "campaign")
        options = Options(
            tuple(dict.fromkeys(map(_from_anywhere, cases or CASES))), _names(dampers, "--dampers"),
            parsed_seeds(seeds), tuple(str(p.absolute()) for p in ssv or ()), tuple(set_ or ()), until,
        )  # fmt: skip
    if not (root / PLAN).exists() and foreign(root, OWN):
        raise CosimError(f"{root}: is no campaign's folder, it holds '{foreign(root, OWN)[0]}'; choose another")
    _finish(root, carried_out(root, options, workers=workers, dask=dask, quiet=quiet), quiet)


def carried_out(
    root: Path, options: Options, *, workers: int, dask: str | None = None, quiet: bool = False
) -> dict[str, Outcome]:
    """Run what is not finished of a campaign; returns how each of its runs ended, by label.

    Raises:
        CosimError: a name or file of the options is unknown, or the folder has another campaign.
    """
    read = _read_cases(options, new=not (root / PLAN).exists())
    for path in options.ssv:
        if not Path(path).is_file():
            raise CosimError(f"--ssv {path}: no such file")
    refuse_another(root, options)
    try:
        tasks = _tasks(options, read, workers, quiet)
        with locked(root):
            return _run(root.absolute(), options, read, tasks, workers, dask, quiet)
    except KeyboardInterrupt:
        way = "the same command begins again"
        if (root / PLAN).exists():
            way = f"go on with: fowt campaign --resume {shlex.quote(str(root))}"
        raise Interrupted(f"stopped by the user; what has finished is kept, {way}") from None


def _run(
    root: Path, options: Options, cases: Mapping[str, LoadCase], tasks: list[Task], workers: int, dask: str | None,
    quiet: bool,
) -> dict[str, Outcome]:  # fmt: skip
    """Run what is not finished; the plan and the table say at every end how far it is."""
    work = Work(root, rows_of_run, evaluation_digest())
    earlier, commands = Earlier.read(root), [command(options)]
    cases, kept = dict(cases), _kept(root, options, earlier, cases, tasks)
    if kept:
        note(f"{len(kept)} finished runs of earlier commands stay in the tables")
        cases |= {case.name: case for case, _ in kept}
        tasks = in_order([*(task for _, task in kept), *tasks], earlier)
        commands = [*(c for c in earlier.commands if c != commands[0]), *commands]
    outcomes: dict[str, Outcome] = {}
    for task in tasks:
        rows, why = finished_rows(work, task)
        if rows is not None:
            outcomes[task.label] = Outcome(task.label, rows)
        elif why:
            warn(f"{task.label}: {why}; it is done again")
    waiting = sorted((t for t in tasks if t.label not in outcomes), key=lambda t: int(t.about["seed"]))
    plan = made_plan(options, cases, tasks, commands, root)
    write_plan(root, plan, outcomes)
    if outcomes:
        note(f"{len(outcomes)} of {len(tasks)} runs are there already")
    try:
        with Progress(tasks, outcomes, root, quiet) as progress:

            def done(outcome: Outcome) -> None:
                outcomes[outcome.label] = outcome
                progress.done(outcome)

            if waiting and dask is not None:
                run_on_dask(work, waiting, dask, done)
            elif waiting:
                run_here(work, waiting, workers, done)
    finally:
        rows = [row for task in tasks for row in _rows(outcomes, task)]
        if rows:
            plan["table_sha256"] = table_digest(write_table(rows, root / TABLE))
        else:
            (root / TABLE).unlink(missing_ok=True)
        write_plan(root, plan, outcomes)
    return outcomes


def _kept(
    root: Path, options: Options, earlier: Earlier, named: Mapping[str, LoadCase], tasks: Sequence[Task]
) -> list[tuple[LoadCase, Task]]:
    """Finished runs of earlier commands that this one does not name; told of where they can no longer be used."""
    found: list[tuple[LoadCase, Task]] = []
    useless: dict[str, list[str]] = {}
    again = {t.label for t in tasks}
    left = {label: run for label, run in earlier.runs.items() if label not in again}
    there = {label: run for label, run in left.items() if (root / RUNS / label).exists()}
    if len(there) < len(left):
        note(f"{len(left) - len(there)} runs of earlier commands have not finished; name them to have them run")
    fmus = next(iter(build_fmus(quiet=True).values())).parent if there else root
    for label, (name, damper, seed) in there.items():
        try:
            case = named[name] if name in named else read_case(earlier.cases[name])
            task = _prepared_task(case, damper, seed, options, fmus, again=True)
            why = results_differ(root / RUNS / label, task.key)
        except CosimError as error:
            why = str(error)
        except KeyError:
            why = f"campaign.json has no load case '{name}'"
        if why:
            useless.setdefault(why, []).append(label)
        else:
            found.append((case, task))
    for why, labels in useless.items():
        more = f", ... ({len(labels)} runs)" if len(labels) > SHOWN else ""
        warn(f"{', '.join(labels[:SHOWN])}{more}: {why}; left out of the tables: name them to have them run again")
    return found


def _finish(root: Path, outcomes: Mapping[str, Outcome], quiet: bool) -> None:
    """Tables of what has finished, and the failures last, where they are seen."""
    failed = {label: o.error for label, o in outcomes.items() if o.error}
    content: dict[str, Any] = {"folder": str(root), "runs": len(outcomes), "failed": failed}
    if len(failed) < len(outcomes):
        found = read_campaign(root)
        tables = evaluate_all(found)
        for name, table in tables.items():
            table.to_csv(root / f"{name}.csv", index=False)
        content |= {"table_sha256": found.plan["table_sha256"]}
        content |= {name: json.loads(table.to_json(orient="records")) for name, table in tables.items()}
        if not quiet:
            show(found, tables)
    if quiet:
        emit(content)
    for label, error in failed.items():
        failure(f"{label}: {error}")
    if failed:
        failure(f"{len(failed)} of {len(outcomes)} runs failed; the same command tries them again")
        raise typer.Exit(1)


def _tasks(options: Options, cases: Mapping[str, LoadCase], workers: int, quiet: bool) -> list[Task]:
    """Every run, ready to start: FMUs built and wind made once, before any of them."""
    folder = next(iter(build_fmus(quiet=quiet).values())).parent
    winds = [
        (case, seed, max(case.stop, options.until or 0.0)) for case in cases.values() if case.wind
        for seed in _seeds_of(case, options)
    ]  # fmt: skip
    if winds:
        from joblib import Parallel, delayed

        with count_progress(quiet) as progress:
            bar = progress.add_task("wind", total=len(winds), note="")
            made = Parallel(min(workers, len(winds)), batch_size=1, return_as="generator_unordered")
            for _ in made(delayed(wind_file)(case, seed, stop, True) for case, seed, stop in winds):
                progress.update(bar, advance=1)
    tasks: list[Task] = []
    with count_progress(quiet) as progress:
        bar = progress.add_task(
            "preparing", total=sum(len(_seeds_of(c, options)) for c in cases.values()) * len(options.dampers), note=""
        )
        for name, case in cases.items():
            for damper in options.dampers:
                for seed in _seeds_of(case, options):
                    again = any(t.about["case"] == name for t in tasks)
                    tasks.append(_prepared_task(case, damper, seed, options, folder, again))
                    progress.update(bar, advance=1)
    return tasks


def _prepared_task(case: LoadCase, damper: str, seed: int, options: Options, fmus: Path, again: bool) -> Task:
    if damper not in case.dampers:
        raise CosimError(f"{case.name}: no damper arrangement '{damper}'{nearest(damper, case.dampers)}")
    changes = Changes(
        set=_of_damper(options.set, case.dampers[damper]), ssv=tuple(map(Path, options.ssv)), seed=seed,
        until=options.until, fmus=fmus,
    )  # fmt: skip
    prepared = prepare(case, damper, changes, quiet=True, again=again)
    system, name = prepared.system, run_name(case.name, damper, seed)
    settings = replace(prepared.settings, about={"case": case.name, "damper": damper, "seed": seed})
    job = Job(name, name, system, settings)
    about = {
        "case": case.name, "damper": damper, "seed": seed, "transient": settings.transient,
        "strokes": strokes(system, settings),
    }  # fmt: skip
    return Task(job, job.key(), about)


def strokes(system: System, settings: RunSettings) -> dict[str, float]:
    """Travel to the end stops (m) by channel: of displacements beside which the FMU has a parameter `stroke`."""
    found = {}
    names = {c.name for c in system.components}
    for channel in settings.channels:
        if not any(channel.variable.startswith(f"{n}.") for n in names):
            continue
        owner, name = split_name(channel.variable, names)
        component = system.component(owner)
        prefix, _, last = name.rpartition(".")
        prefix += "." if prefix else ""
        known, start = read_fmu(component.fmu).variables, component.start
        active = start.get(f"{prefix}active")
        if not last.endswith("displacement") or f"{prefix}stroke" not in known or (active and active.value is False):
            continue
        stroke, given = known[f"{prefix}stroke"], start.get(f"{prefix}stroke")
        value, own = (given.value, given.unit or stroke.unit) if given else (stroke.start, stroke.unit)
        factor = conversion(own, unit("m"))[0] if own else 1.0
        found[channel.name] = float(value or 0.0) * factor
    return found


def _seeds_of(case: LoadCase, options: Options) -> tuple[int, ...]:
    """Seeds that make a difference: of a case without chance its own, so that its run is the same for any --seeds."""
    return options.seeds if case.seed_parameters or case.wind else (case.seed,)


def _of_damper(items: tuple[str, ...], damper: Damper) -> tuple[str, ...]:
    """Those `--set` that an arrangement has a component for."""
    left_out = tuple(f"{c}." for c in damper.optional if c not in damper.components)
    return tuple(item for item in items if not item.startswith(left_out)) if left_out else items


def _read_cases(options: Options, new: bool) -> dict[str, LoadCase]:
    """Load cases by name.

    Args:
        new: there is no campaign yet, so that these are all its arrangements.

    Raises:
        CosimError: one is unknown, two are of one name, or a name is no arrangement.
    """
    cases: dict[str, LoadCase] = {}
    for given in options.cases:
        case = read_case(given)
        if case.name in cases:
            raise CosimError(f"two load cases are called '{case.name}'; rename the file of one")
        for damper in options.dampers:
            if damper not in case.dampers:
                raise CosimError(f"{case.name}: no damper arrangement '{damper}'{nearest(damper, case.dampers)}")
        cases[case.name] = case
    for item in options.set if new else ():
        if not any(_of_damper((item,), c.dampers[d]) for c in cases.values() for d in options.dampers):
            raise CosimError(f"--set {item}: no arrangement of {', '.join(options.dampers)} has that damper")
    return cases


def _rows(outcomes: Mapping[str, Outcome], task: Task) -> list[dict[str, Any]]:
    outcome = outcomes.get(task.label)
    return outcome.rows or [] if outcome else []


def _from_anywhere(case: str) -> str:
    """A case's name, or its file's full path, so that the campaign can go on from another folder."""
    return str(Path(case).absolute()) if case not in shipped_cases() and Path(case).is_file() else case


def _names(text: str, option: str) -> tuple[str, ...]:
    names = tuple(dict.fromkeys(n.strip() for n in text.split(",") if n.strip()))
    if not names:
        raise CosimError(f"{option} names none; 'fowt list' shows all")
    return names
