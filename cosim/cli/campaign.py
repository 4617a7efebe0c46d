"""`fowt campaign`: load cases x damper arrangements x seeds, in parallel; it may be interrupted at any moment."""

from __future__ import annotations

import json
import os
import shlex
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any

import typer

from cosim.archive import sha256
from cosim.campaign.pool import run_here, run_on_dask
from cosim.campaign.store import Outcome, Task, Work, finished_rows, foreign, locked
from cosim.case import Damper, LoadCase, read_case, shipped_cases
from cosim.cli.build import build_fmus
from cosim.cli.campaign_view import Progress, evaluate_all, show
from cosim.cli.console import Format, FormatOption, count_progress, emit, failure, note, warn
from cosim.cli.run import Changes, SetOption, SsvOption, UntilOption, free_path, prepare, wind_file
from cosim.errors import CosimError, nearest
from cosim.fmu import read_fmu
from cosim.recording import versions, write_json
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

CASES, DAMPERS = ("lc1", "lc2", "lc3", "lc4", "lc5"), "none,tmd-n,tmd-p,mtmd"
SEEDS = "2:7"  # with seed 1 the rotor of LC4 and LC5 sways out of its wind box
TABLES = ("suppression", "ranking", "fatigue", "extremes", "dampers", "power", "paper")
OWN = (PLAN, TABLE, *(f"{name}.csv" for name in TABLES), f"{PLAN[:-5]}.part", f"{TABLE}.partial")


@dataclass(frozen=True)
class Options:
    """What a campaign consists of; all that its results follow from, besides FMUs and versions."""

    cases: tuple[str, ...] = CASES
    dampers: tuple[str, ...] = tuple(DAMPERS.split(","))
    seeds: tuple[int, ...] = tuple(range(2, 8))
    ssv: tuple[str, ...] = ()
    set: tuple[str, ...] = ()
    until: float | None = None


def campaign(
    cases: Annotated[list[str] | None, typer.Argument(help="Load cases; lc1 to lc5 by default.")] = None,
    dampers: Annotated[str, typer.Option(help="Damper arrangements.")] = DAMPERS,
    seeds: Annotated[str, typer.Option(help="Seeds of wind and sea: 2:7, or 1,3,8.")] = SEEDS,
    ssv: SsvOption = None,
    set_: SetOption = None,
    until: UntilOption = None,
    workers: Annotated[int, typer.Option(min=1, help="Runs at a time on this machine.")] = os.cpu_count() or 1,
    dask: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="Run on a Dask cluster, such as tcp://host:8786.")
    ] = None,
    folder: Annotated[
        Path | None, typer.Option("--out", help="Folder; a campaign that is there already goes on.")
    ] = None,
    resume: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="Go on with the campaign in this folder, as it was begun.")
    ] = None,
    output: FormatOption = Format.TEXT,
) -> None:
    """Run load cases with every damper arrangement and seed: suppression rates with intervals, fatigue, extremes.

    All arrangements of one seed meet the same wind and sea. Finished runs are never repeated: after Ctrl-C or a crash
    the same command goes on. Example: [bold]fowt campaign lc3 lc4 --seeds 2:9 --out study[/bold]
    """
    quiet = output is Format.JSON
    usual = (DAMPERS, SEEDS)
    if resume is not None:
        if cases or folder or ssv or set_ or until is not None or (dampers, seeds) != usual:
            raise CosimError("--resume goes on as the campaign was begun; change it with --out and all its options")
        root, options = resume, _begun(resume)
    else:
        root = folder or free_path(Path("runs") / "campaign")
        options = Options(
            tuple(dict.fromkeys(map(_from_anywhere, cases or CASES))), _names(dampers, "--dampers"), _seeds(seeds),
            tuple(str(p.absolute()) for p in ssv or ()), tuple(set_ or ()), until,
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
    read = _read_cases(options)
    for path in options.ssv:
        if not Path(path).is_file():
            raise CosimError(f"--ssv {path}: no such file")
    _refuse_another(root, options)
    try:
        tasks = _tasks(options, read, workers, quiet)
        with locked(root):
            return _run(root.absolute(), options, read, tasks, workers, dask, quiet)
    except KeyboardInterrupt:
        begun = (root / PLAN).exists()
        way = f"go on with: fowt campaign --resume {root}" if begun else "the same command begins again"
        warn(f"stopped by the user; what has finished is kept, {way}")
        raise typer.Exit(130) from None


def _run(
    root: Path, options: Options, cases: Mapping[str, LoadCase], tasks: list[Task], workers: int, dask: str | None,
    quiet: bool,
) -> dict[str, Outcome]:  # fmt: skip
    """Run what is not finished; the plan and the table say at every end how far it is."""
    work = Work(root, rows_of_run, evaluation_digest())
    outcomes: dict[str, Outcome] = {}
    for task in tasks:
        rows, why = finished_rows(work, task)
        if rows is not None:
            outcomes[task.label] = Outcome(task.label, rows)
        elif why:
            warn(f"{task.label}: {why}; it is done again")
    waiting = sorted((t for t in tasks if t.label not in outcomes), key=lambda t: int(t.about["seed"]))
    plan = _plan(options, cases, tasks)
    _write_plan(root, plan, outcomes)
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
        _write_plan(root, plan, outcomes)
    return outcomes


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
                    changes = Changes(
                        set=_of_damper(options.set, case.dampers[damper]), ssv=tuple(map(Path, options.ssv)), seed=seed,
                        until=options.until, fmus=folder,
                    )  # fmt: skip
                    again = any(t.about["case"] == name for t in tasks)
                    tasks.append(_task(prepare(case, damper, changes, quiet=True, again=again), name, damper, seed))
                    progress.update(bar, advance=1)
    return tasks


def _task(prepared: Any, case: str, damper: str, seed: int) -> Task:
    system, settings = prepared.system, prepared.settings
    settings = replace(settings, about={"case": case, "damper": damper, "seed": seed})
    job = Job(run_name(case, damper, seed), run_name(case, damper, seed), system, settings)
    about = {
        "case": case, "damper": damper, "seed": seed, "transient": settings.transient,
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
    """Seeds that make a difference: of a case without chance one."""
    return options.seeds if case.seed_parameters or case.wind else options.seeds[:1]


def _of_damper(items: tuple[str, ...], damper: Damper) -> tuple[str, ...]:
    """Those `--set` that an arrangement has a component for."""
    left_out = tuple(f"{c}." for c in damper.optional if c not in damper.components)
    return tuple(item for item in items if not item.startswith(left_out)) if left_out else items


def _read_cases(options: Options) -> dict[str, LoadCase]:
    """Load cases by name.

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
    for item in options.set:
        if not any(_of_damper((item,), c.dampers[d]) for c in cases.values() for d in options.dampers):
            raise CosimError(f"--set {item}: no arrangement of {', '.join(options.dampers)} has that damper")
    return cases


def _plan(options: Options, cases: Mapping[str, LoadCase], tasks: list[Task]) -> dict[str, Any]:
    by_case = {t.about["case"]: t.job.settings for t in tasks}
    return {
        "command": _command(options),
        "started": datetime.now(UTC).isoformat(timespec="seconds"),
        "options": asdict(options) | {"ssv_sha256": _ssv_digests(options)},
        "cases": {
            name: {
                "description": case.description, "wind_speed": case.wind.mean_speed if case.wind else None,
                "stop": by_case[name].stop, "step": by_case[name].step, "transient": by_case[name].transient,
            }
            for name, case in cases.items()
        },
        "dampers": list(options.dampers),
        "seeds": list(options.seeds),
        "runs": [
            {**{k: t.about[k] for k in ("case", "damper", "seed")}, "folder": f"runs/{t.label}", "key": t.key}
            for t in tasks
        ],
        "versions": versions(),
        "table_sha256": None,
    }  # fmt: skip


def _command(options: Options) -> str:
    """The command that makes this campaign anywhere, however it was taken up here."""
    words = ["fowt", "campaign", *options.cases, "--dampers", ",".join(options.dampers)]
    words += ["--seeds", ",".join(map(str, options.seeds))]
    words += [w for path in options.ssv for w in ("--ssv", Path(path).name)]
    words += [w for item in options.set for w in ("--set", item)]
    return shlex.join(words if options.until is None else [*words, "--until", f"{options.until:g}"])


def _write_plan(root: Path, plan: dict[str, Any], outcomes: Mapping[str, Outcome]) -> None:
    for run in plan["runs"]:
        outcome = outcomes.get(run["folder"].removeprefix("runs/"))
        run["status"] = "waiting" if outcome is None else "failed" if outcome.error else "done"
        run["message"] = outcome.error if outcome else ""
    write_json(root / PLAN, plan)


def _rows(outcomes: Mapping[str, Outcome], task: Task) -> list[dict[str, Any]]:
    outcome = outcomes.get(task.label)
    return outcome.rows or [] if outcome else []


def _begun(root: Path) -> Options:
    """Options of the campaign in a folder.

    Raises:
        CosimError: there is none.
    """
    try:
        saved = json.loads((root / PLAN).read_text(encoding="utf-8"))["options"]
        cases, dampers, seeds, ssv, values = (tuple(saved[k]) for k in ("cases", "dampers", "seeds", "ssv", "set"))
        return Options(cases, dampers, seeds, ssv, values, saved["until"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise CosimError(f"--resume {root}: holds no campaign (no readable {PLAN}); begin one with --out") from error


def _refuse_another(root: Path, options: Options) -> None:
    """More cases, arrangements or seeds extend a campaign; other parameters are another one.

    Raises:
        CosimError: the folder has a campaign with other parameters.
    """
    if not (root / PLAN).exists():
        return
    try:
        saved = json.loads((root / PLAN).read_text(encoding="utf-8"))["options"]
        there = {"--set": saved["set"], "--until": saved["until"], "--ssv": saved["ssv_sha256"]}
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise CosimError(f"{root / PLAN}: cannot be read ({type(error).__name__}); choose another --out") from error
    wanted = {"--set": list(options.set), "--until": options.until, "--ssv": _ssv_digests(options)}
    for name, value in wanted.items():
        if value != there[name]:
            has = "another content" if name == "--ssv" else there[name] or "none"
            raise CosimError(f"{root}: its campaign was begun with another {name} ({has}); choose another --out")


def _ssv_digests(options: Options) -> list[str]:
    return [sha256(Path(p)) for p in options.ssv]


def _from_anywhere(case: str) -> str:
    """A case's name, or its file's full path, so that the campaign can go on from another folder."""
    return str(Path(case).absolute()) if case not in shipped_cases() and Path(case).is_file() else case


def _names(text: str, option: str) -> tuple[str, ...]:
    names = tuple(dict.fromkeys(n.strip() for n in text.split(",") if n.strip()))
    if not names:
        raise CosimError(f"{option} names none; 'fowt list' shows all")
    return names


def _seeds(text: str) -> tuple[int, ...]:
    found: list[int] = []
    try:
        for part in text.split(","):
            first, colon, last = part.partition(":")
            found += range(int(first), int(last) + 1) if colon else [int(first)]
    except ValueError as error:
        raise CosimError(f"--seeds {text}: write it as 1:6 or 1,3,8") from error
    if not found or min(found) < 0:
        raise CosimError(f"--seeds {text}: holds no seed of 0 or more; write it as 1:6 or 1,3,8")
    return tuple(dict.fromkeys(found))
