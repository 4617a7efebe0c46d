"""`fowt verify`: hold the coupled model against OpenFAST results."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table
from rich.text import Text

from cosim.case import LoadCase, Number, case_folder, read_case
from cosim.cli.console import (
    Format,
    FormatOption,
    Interrupted,
    busy,
    emit,
    failure,
    note,
    number,
    out,
    simulation_progress,
    warn,
)
from cosim.cli.run import Changes, prepare
from cosim.errors import CosimError, nearest
from cosim.fmu import read_fmu
from cosim.recording import read_channels
from cosim.verification.plan import Comparison, choose, read_plan
from cosim.verification.reference import Record
from cosim.verification.runs import Job, Outcome, Stopped, run_all
from cosim.verification.sources import from_figures, from_folder
from cosim.verification.table import Reference, Row, read_run, reference_values, rows_of, write_table

FIGURES = "verification-openfast.toml"
STYLES = {"pass": "green", "FAIL": "bold red", "missing": "yellow", "no run": "bold red"}


def verify(
    names: Annotated[
        list[str] | None, typer.Argument(help="Comparisons, or folders of them; * and ? are wild. All by default.")
    ] = None,
    against: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder of OpenFAST results (docs/verification.md).")
    ] = None,
    hydro_database: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="Hydrodynamics: closed, moonpool, deep, or a path."),
    ] = None,
    workers: Annotated[int, typer.Option(min=1, help="Runs at a time.")] = os.cpu_count() or 1,
    folder: Annotated[
        Path, typer.Option("--out", help="Folder for runs, table and pictures; finished runs in it are used again.")
    ] = Path("runs/verify"),
    report_only: Annotated[bool, typer.Option("--report-only", help="Exit with 0 even if a row fails.")] = False,
    output: FormatOption = Format.TEXT,
) -> None:
    """Run this model beside OpenFAST results: one table of differences and tolerances, and overlaid pictures.

    Exits with 0 if every row passes, with 1 if not. Without --against, it uses
    the figures that ship with the package.

    Example: [bold]fowt verify decay --against results[/bold]
    """
    quiet = output is Format.JSON
    plan = read_plan(case_folder(), against)
    chosen = choose(plan, names or [])
    if against is None:
        chosen, references = from_figures(case_folder() / FIGURES, chosen)
        if not chosen:
            raise CosimError(
                f"no figures ship for {', '.join(names or [])}; give a folder of results with --against DIR"
            )
        note("histories (R2), their pictures and turbulent load cases need --against DIR (docs/verification.md)")
    else:
        wanted = {n: plan[n] for c in chosen.values() for n in (c.undamped, c.name) if n in plan}
        references = from_folder(against, wanted)
        chosen = {n: c for n, c in chosen.items() if n in references}
        if not chosen:
            raise CosimError(f"{against}: holds nothing of {', '.join(names or [])} but what they are compared with")
    setups = {n: _setup(plan[n], against, hydro_database) for n in references}
    values = {n: reference_values(c, references, setups[n].units) for n, c in chosen.items()}
    _warn_of_missing(chosen, references, setups)
    outcomes = _run(setups, folder, workers, quiet)
    runs = {n: read_run(o.folder) for n, o in outcomes.items() if not o.error}
    rows = [
        row for n, c in chosen.items()
        for row in rows_of(c, references[n], values[n], runs.get(n), runs.get(c.undamped or ""), setups[n].units)
    ]  # fmt: skip
    for line in dict.fromkeys(row.note for row in rows if row.note):
        warn(line)
    pictures = _draw(chosen, references, runs, rows, setups, folder)
    about = {"against": str(against or FIGURES), "runs": {n: str(o.folder) for n, o in outcomes.items()}}
    files = write_table(rows, folder, about)
    passed = all(row.passed for row in rows)
    if quiet:
        emit(
            {"passed": passed, **json.loads(files[1].read_text(encoding="utf-8")), "pictures": list(map(str, pictures))}
        )
    else:
        _show(rows)
        _show_times(outcomes, setups)
        out.print(f"{folder}: {', '.join(p.name for p in files)}, {len(pictures)} pictures", soft_wrap=True)
        count = sum(row.passed for row in rows)
        out.print(Text(f"{count} of {len(rows)} rows pass", style="green" if passed else "bold red"))
    if not (passed or report_only):
        raise typer.Exit(1)


@dataclass(frozen=True)
class Setup:
    """How a comparison is run: the changed load case, FMUs built for it, and the units of its channels."""

    name: str
    case: LoadCase
    damper: str | None
    swap: tuple[str, ...]
    units: Mapping[str, str]
    changed: Mapping[str, bool]

    def job(self) -> Job:
        """The run, ready to start.

        Raises:
            CosimError: a change names a variable that there is not, or a component that this run leaves out; of the
                changes common to all comparisons, the latter is no mistake.
        """
        prepared = prepare(self.case, self.damper, Changes(swap=self.swap), quiet=True)
        fmus = {c.name: c.fmu for c in prepared.system.components}
        for name, own in self.changed.items():
            component, _, variable = name.partition(".")
            if component not in fmus:
                if own:
                    raise CosimError(f"{self.name}: '{name}': this run has no '{component}'{nearest(component, fmus)}")
                continue
            known = read_fmu(fmus[component]).variables
            if variable not in known:
                raise CosimError(f"{self.name}: {component} has no '{variable}'{nearest(variable, known)}")
        return Job(self.name, prepared.label, prepared.system, prepared.settings)


def _setup(comparison: Comparison, against: Path | None, database: str | None) -> Setup:
    """Raises CosimError where the comparison names what there is not."""
    own = against / comparison.case if against else None
    case = read_case(str(own) if own and own.is_file() else comparison.case)
    units = {c.name: c.unit or "" for c in read_channels(case.channels)}
    for channel in comparison.channels:
        if channel not in units:
            raise CosimError(
                f"{comparison.name}: {case.channels.name} has no channel '{channel}'{nearest(channel, units)}"
            )
    parameters: dict[str, Number] = dict(case.parameters) | dict(comparison.parameters)
    parameters |= {name: str(_file(comparison, against, path)) for name, path in comparison.files.items()}
    box = case.wind if case.wind and case.wind.parameter not in parameters else None
    changed = replace(case, parameters=parameters, wind=box, stop=comparison.window[1], transient=0.0)
    options = {c: dict(given) for c, given in comparison.options.items() if c not in case.without}
    for component, given in comparison.build.items():
        files = {option: str(_file(comparison, against, path)) for option, path in given.items()}
        options[component] = options.get(component, {}) | files
    if database is not None and "hydro" in options:
        options["hydro"]["database"] = str(database)
    named = {n: n in comparison.own for n in (*comparison.parameters, *comparison.files)}
    return Setup(comparison.name, changed, comparison.damper, _variants(options), units, named)


def _file(comparison: Comparison, against: Path | None, name: str) -> Path:
    if against is None:
        raise CosimError(f"{comparison.name}: needs '{name}' of a folder of results; give it with --against DIR")
    path = (against / name).resolve()
    if not path.is_file():
        raise CosimError(f"{against / name}: no such file; {comparison.name} runs with it, add it")
    return path


def _variants(options: Mapping[str, Mapping[str, str]]) -> tuple[str, ...]:
    """FMUs built with options, as `--swap` takes them; what has been built already comes from the cache."""
    if not options:
        return ()
    from fmus_src.library import build_variant

    return tuple(f"{component}={build_variant(component, given)}" for component, given in options.items())


def _warn_of_missing(
    chosen: Mapping[str, Comparison], references: Mapping[str, Reference], setups: Mapping[str, Setup]
) -> None:
    for name, comparison in chosen.items():
        missing = dict.fromkeys(c.channel for c in comparison.checks if not references[name].has(c))
        if missing:
            warn(
                f"{references[name].where}: no channel {', '.join(missing)}; add it to that run's outputs, or leave it"
                f" out of '{name}' in the folder's verification.toml"
            )
        for channel in comparison.channels:
            record = references[name].record
            if record and channel in record.channels and channel not in record.units:
                note(f"{references[name].where}: {channel} has no unit, taken as {setups[name].units[channel]}")


def _run(setups: Mapping[str, Setup], folder: Path, workers: int, quiet: bool) -> dict[str, Outcome]:
    from cosim.cli.build import build_fmus

    build_fmus(quiet=quiet)
    jobs = [setup.job() for setup in setups.values()]
    with simulation_progress(quiet) as progress:
        total = sum(job.settings.stop for job in jobs)
        task = progress.add_task("", total=total)

        def follow(share: float, running: Sequence[str]) -> None:
            names = ", ".join(n.rpartition("/")[2] for n in running)
            progress.update(task, completed=share * total, description=names)

        try:
            outcomes = run_all(jobs, folder / "runs", workers, follow)
        except Stopped as stopped:
            progress.stop()
            done = len(stopped.done)
            raise Interrupted(
                f"stopped by the user; {done} of {len(jobs)} runs are kept in {folder} and used by the next call"
            ) from stopped
    for name, outcome in outcomes.items():
        if outcome.error:
            failure(f"{name}: {outcome.error} ({outcome.folder})")
    return outcomes


def _draw(
    chosen: Mapping[str, Comparison],
    references: Mapping[str, Reference],
    runs: Mapping[str, Record],
    rows: Sequence[Row],
    setups: Mapping[str, Setup],
    folder: Path,
) -> list[Path]:
    from cosim.verification.plots import plot_curve, plot_histories

    pictures: list[Path | None] = []
    with busy("drawing"):
        for name, comparison in chosen.items():
            record = references[name].record
            if record is not None and name in runs:
                path = folder / f"{name.replace('/', '-')}.png"
                pictures.append(plot_histories(comparison, record, runs[name], setups[name].units, "reference", path))
        for curve in dict.fromkeys(c.curve.name for c in chosen.values() if c.curve):
            points = [c for c in chosen.values() if c.curve and c.curve.name == curve]
            pictures.append(plot_curve(curve, points, rows, "reference", folder / f"{curve}.png"))
    return [p for p in pictures if p]


def _show(rows: Sequence[Row]) -> None:
    """The table; a comparison's name stands at its first row only."""
    table = Table("case", "channel", "quantity", box=None, pad_edge=False, padding=(0, 1, 0, 0))
    for column in ("reference", "ours", "difference", "tolerance"):
        table.add_column(column, justify="right", no_wrap=True)
    table.add_column("")
    before = ""
    for row in rows:
        stem = row.comparison.rpartition("/")[2]
        table.add_row(
            stem if row.comparison != before else "", row.channel, row.quantity,
            _value(row.reference, row.unit),
            f"{row.ours:.4f}" if row.limit == "at_least" else _value(row.ours), _difference(row), _tolerance(row),
            Text(row.status, style=STYLES[row.status]),
        )  # fmt: skip
        before = row.comparison
    out.print(table)


def _value(value: float, unit: str = "") -> str:
    return f"{number(value)} {unit}".rstrip() if value == value else "-"


def _difference(row: Row) -> str:
    if row.difference != row.difference:
        return "-"
    return f"{100 * row.difference:+.2f} %" if row.limit == "relative" else f"{row.difference:+.3g} {_step(row)}"


def _tolerance(row: Row) -> str:
    if row.limit == "relative":
        return f"{100 * row.tolerance:g} %"
    return f">= {row.tolerance:g}" if row.limit == "at_least" else f"{row.tolerance:g} {_step(row)}"


def _step(row: Row) -> str:
    return "points" if row.unit == "%" else row.unit


def _show_times(outcomes: Mapping[str, Outcome], setups: Mapping[str, Setup]) -> None:
    """Where the time of the longest run went."""
    ran = [n for n, o in outcomes.items() if not o.error]
    if not ran:
        return
    name = max(ran, key=lambda n: setups[n].case.stop)
    content = json.loads((outcomes[name].folder / "run.json").read_text(encoding="utf-8"))
    seconds = sorted(content["component_seconds"].items(), key=lambda item: -item[1])
    parts = ", ".join(f"{component} {s:.2f}" for component, s in seconds)
    folders = {o.folder: o.reused for o in outcomes.values()}
    out.print(f"{len(folders)} runs, {sum(folders.values())} of them from before", soft_wrap=True)
    out.print(f"wall time of {name} by component, s: {parts}", soft_wrap=True)
