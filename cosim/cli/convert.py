"""`fowt convert`: results of runs in the formats of other tools."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from cosim.cli.console import Format, FormatOption, count_progress, emit, failure, out
from cosim.errors import CosimError
from cosim.formats import convert as write
from cosim.formats import format_names
from cosim.recording import PARTS, RESULTS


def convert(
    folders: Annotated[list[Path], typer.Argument(help="Folders of runs, of campaigns, or that hold runs.")],
    to: Annotated[str, typer.Option(metavar="FORMATS", help="What to write: csv, mat, outb; several: csv,mat.")],
    target: Annotated[
        Path | None,
        typer.Option("--out", help="Folder for RUN.csv, ... instead of results.csv, ... beside the results."),
    ] = None,
    output: FormatOption = Format.TEXT,
) -> None:
    """Write results of finished or broken-off runs as CSV, MATLAB or OpenFAST files.

    Example: [bold]fowt convert runs/lc4-mtmd-seed4 --to outb,csv[/bold]
    """
    formats = format_names(to, "--to")
    if not formats:
        raise CosimError(f"--to {to}: every run has its {RESULTS} already; name csv, mat or outb")
    runs = find_runs(folders)
    bases = _bases(runs, formats, target)
    written: dict[str, list[str]] = {}
    failed: dict[str, str] = {}
    quiet = output is Format.JSON
    with count_progress(quiet or len(runs) == 1) as progress:
        bar = progress.add_task("converting", total=len(runs), note="")
        for run, base in zip(runs, bases, strict=True):
            try:
                written[str(run)] = [str(path) for path in write(run, formats, base)]
            except CosimError as error:  # of one run: the others are converted all the same
                failed[str(run)] = str(error)
            progress.update(bar, advance=1)
    if quiet:
        emit({"files": written, "failed": failed})
    elif len(runs) == 1:
        for path in (path for paths in written.values() for path in paths):
            out.print(path, soft_wrap=True, markup=False)
    else:
        out.print(f"{len(written)} of {len(runs)} runs converted to {', '.join(formats)}")
    for message in failed.values():
        failure(message)
    if failed:
        raise typer.Exit(1)


def find_runs(folders: Sequence[Path]) -> list[Path]:
    """The folders that hold results: those given, and one level below those that hold runs (a campaign's: in `runs`).

    Raises:
        CosimError: a folder is missing, or holds no results.
    """
    found: dict[Path, None] = {}
    for folder in folders:
        if not folder.is_dir():
            raise CosimError(f"{folder}: no such folder; give that of a run")
        inside = folder / "runs" if (folder / "runs").is_dir() else folder
        runs = [folder] if _has_results(folder) else sorted(p for p in inside.iterdir() if _has_results(p))
        if not runs:
            raise CosimError(f"{folder}: holds no {RESULTS}, nor does a folder in it; give the folder of a run")
        found |= dict.fromkeys(runs)
    return list(found)


def _has_results(folder: Path) -> bool:
    return (folder / RESULTS).is_file() or (folder / PARTS).is_dir()


def _bases(runs: Sequence[Path], formats: Sequence[str], target: Path | None) -> list[Path | None]:
    """Where to write each run, without suffix; None: beside its results.

    Raises:
        CosimError: two runs would have the same file, or a file exists.
    """
    if target is None:
        return [None] * len(runs)
    names = [run.resolve().name for run in runs]
    for name in names:
        if names.count(name) > 1:
            raise CosimError(f"--out {target}: several runs are called '{name}'; convert them one by one")
        for path in (target / f"{name}.{f}" for f in formats):
            if path.exists():
                raise CosimError(f"{path}: exists; choose another --out (nothing is overwritten)")
    return [target / name for name in names]
