"""`fowt build`: every component becomes an FMU."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Annotated

import typer

from cosim.cli.console import Format, FormatOption, count_progress, emit, out
from cosim.errors import CosimError, nearest


def build(
    components: Annotated[list[str] | None, typer.Argument(help="Components; all by default.")] = None,
    folder: Annotated[Path, typer.Option("--out", help="Folder for the FMUs.")] = Path("fmus"),
    output: FormatOption = Format.TEXT,
) -> None:
    """Export components from their Python definition as FMUs.

    Unchanged ones come from the cache. Example: [bold]fowt build tmd barge --out fmus[/bold]
    """
    built = build_fmus(components, quiet=output is Format.JSON)
    folder.mkdir(parents=True, exist_ok=True)
    files = {name: Path(shutil.copy2(path, folder / path.name)) for name, path in built.items()}
    if output is Format.JSON:
        emit({name: str(path) for name, path in files.items()})
        return
    for name, path in files.items():
        out.print(f"{name:12s} {path}  ({path.stat().st_size / 1000:.0f} kB)")


def build_fmus(names: list[str] | None = None, *, quiet: bool = False) -> dict[str, Path]:
    """Build the named components (default: all) in the user's cache.

    Raises:
        CosimError: no such component.
    """
    from fmus_src.library import build_library, component_names

    known = component_names()
    for name in names or []:
        if name not in known:
            raise CosimError(f"no component '{name}'{nearest(name, known)}")
    wanted = names or known
    with count_progress(quiet) as progress:
        task = progress.add_task("building FMUs", total=len(wanted), note="")
        _, built = build_library(wanted, lambda name, _: progress.update(task, advance=1, note=name))
    return built
