"""`fowt build`: every component becomes an FMU."""

from __future__ import annotations

import shutil
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from cosim.cli.console import Format, FormatOption, count_progress, emit, note, out, warn
from cosim.errors import CosimError, nearest


def build(
    components: Annotated[list[str] | None, typer.Argument(help="Components; all by default.")] = None,
    folder: Annotated[Path, typer.Option("--out", help="Folder for the FMUs.")] = Path("fmus"),
    option: Annotated[
        list[str] | None,
        typer.Option("--option", metavar="NAME=VALUE", help="Argument of one component's component()."),
    ] = None,
    name: Annotated[str | None, typer.Option("--name", help="File name of one component's FMU.")] = None,
    output: FormatOption = Format.TEXT,
) -> None:
    """Export components from their Python definition as FMUs.

    Unchanged ones come from the cache. Examples: [bold]fowt build tmd barge --out fmus[/bold],
    [bold]fowt build hydro --option database=DIR/Barge --option sea=waves.csv --name hydro-given[/bold]
    """
    quiet = output is Format.JSON
    if (option or name) and len(components or []) != 1:
        raise CosimError("--option and --name are for one component: name it, as in 'fowt build hydro --option ...'")
    if name and ("/" in name or "\\" in name):
        raise CosimError(f"--name {name}: give the name of a file without a folder; --out names the folder")
    if option and components:
        built = {components[0]: build_with_options(components[0], option)}
    else:
        built = build_fmus(components, quiet=quiet)
    folder.mkdir(parents=True, exist_ok=True)
    stem = name.removesuffix(".fmu") if name else None
    files = {c: Path(shutil.copy2(path, folder / f"{stem or path.stem}.fmu")) for c, path in built.items()}
    if output is Format.JSON:
        emit({c: str(path) for c, path in files.items()})
        return
    for c, path in files.items():
        out.print(f"{c:12s} {path}  ({path.stat().st_size / 1000:.0f} kB)")
    if option:
        import fmpy

        for path in files.values():
            for fact in str(fmpy.read_model_description(str(path), validate=False).description).split(". "):
                note(fact)


def build_with_options(component: str, options: Sequence[str]) -> Path:
    """Build one component with options NAME=VALUE in the user's cache; what is doubtful is warned of.

    Raises:
        CosimError: no such component or option, or a value that it cannot be built with.
    """
    from fmus_src.library import build_variant

    _known([component])
    given: dict[str, str] = {}
    for item in options:
        key, equals, value = item.partition("=")
        if not (key and equals and value):
            raise CosimError(f"--option {item}: write it as NAME=VALUE")
        given[key] = value
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", UserWarning)
        path = build_variant(component, given)
    for warning in caught:
        if warning.category is UserWarning:
            warn(str(warning.message))
    return path


def build_fmus(names: list[str] | None = None, *, quiet: bool = False) -> dict[str, Path]:
    """Build the named components (default: all) in the user's cache.

    Raises:
        CosimError: no such component.
    """
    from fmus_src.library import build_library, component_names

    wanted = _known(names) if names else component_names()
    with count_progress(quiet) as progress:
        task = progress.add_task("building FMUs", total=len(wanted), note="")
        _, built = build_library(wanted, lambda name, _: progress.update(task, advance=1, note=name))
    return built


def _known(names: list[str]) -> list[str]:
    from fmus_src.library import component_names

    known = component_names()
    for name in names:
        if name not in known:
            raise CosimError(f"no component '{name}'{nearest(name, known)}")
    return names
