"""`fowt build`: every component becomes an FMU."""

from __future__ import annotations

import shutil
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cosim.cli.console import Format, FormatOption, count_progress, emit, note, out, warn
from cosim.errors import CosimError, nearest

if TYPE_CHECKING:
    from fmus_src.export.platforms import Platform


def build(
    components: Annotated[list[str] | None, typer.Argument(help="Components; all by default.")] = None,
    folder: Annotated[Path, typer.Option("--out", help="Folder for the FMUs.")] = Path("fmus"),
    option: Annotated[
        list[str] | None,
        typer.Option("--option", metavar="NAME=VALUE", help="Argument of one component's component()."),
    ] = None,
    name: Annotated[str | None, typer.Option("--name", help="File name of one component's FMU.")] = None,
    fmi: Annotated[str, typer.Option("--fmi", metavar="2|3|2,3", help="Version of FMI, or both.")] = "2",
    platform: Annotated[
        str,
        typer.Option(
            "--platform",
            metavar="NAMES",
            help="linux-x86_64, linux-aarch64, windows-x86_64, macos-x86_64, macos-aarch64, native, all; with commas.",
        ),
    ] = "native",
    output: FormatOption = Format.TEXT,
) -> None:
    """Export components from their Python definition as FMUs.

    Unchanged ones come from the cache. Each is for co-simulation and model
    exchange; that of FMI 3.0 is named NAME-fmi3.fmu. Examples:

    [bold]fowt build tmd barge --out fmus[/bold]

    [bold]fowt build tmd --fmi 2,3 --platform all[/bold]

    [bold]fowt build hydro --option sea=waves.csv --name hydro-given[/bold]
    """
    quiet = output is Format.JSON
    if (option or name) and len(components or []) != 1:
        raise CosimError("--option and --name are for one component: name it, as in 'fowt build hydro --option ...'")
    if name and ("/" in name or "\\" in name):
        raise CosimError(f"--name {name}: give the name of a file without a folder; --out names the folder")
    targets = [_target(version, platform) for version in _versions(fmi)]
    folder.mkdir(parents=True, exist_ok=True)
    files: dict[str, Path] = {}
    for target in targets:
        if option and components:
            built = {components[0]: build_with_options(components[0], option, target)}
        else:
            built = build_fmus(components, quiet=quiet, target=target)
        for component, path in built.items():
            stem = name.removesuffix(".fmu") if name else component
            file = f"{stem}.fmu" if name and len(targets) == 1 else target.file(stem)
            key = component if len(targets) == 1 else target.file(component).removesuffix(".fmu")
            files[key] = Path(shutil.copy2(path, folder / file))
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


@dataclass(frozen=True)
class Target:
    """What FMUs are built for: version of FMI ("2" or "3") and platforms; none: the one this runs on."""

    fmi: str = "2"
    platforms: tuple[Platform, ...] = ()

    def file(self, stem: str) -> str:
        from fmus_src.export.build import fmu_name

        return fmu_name(stem, self.fmi)


def _versions(text: str) -> list[str]:
    versions = [v.strip().removesuffix(".0") for v in text.split(",")]
    if not set(versions) <= {"2", "3"}:
        raise CosimError(f"--fmi {text}: give 2, 3 or 2,3")
    return sorted(set(versions))


def _target(fmi: str, platform: str) -> Target:
    from fmus_src.export.platforms import platforms_named

    names = [n.strip() for n in platform.split(",")]
    try:
        chosen = platforms_named(names)
    except ValueError as error:
        raise CosimError(f"--platform {platform}: {error}") from error
    return Target(fmi, () if names == ["native"] else chosen)


def build_with_options(component: str, options: Sequence[str], target: Target = Target()) -> Path:
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
        path = build_variant(component, given, fmi=target.fmi, platforms=target.platforms)
    for warning in caught:
        if warning.category is UserWarning:
            warn(str(warning.message))
    return path


def build_fmus(names: list[str] | None = None, *, quiet: bool = False, target: Target = Target()) -> dict[str, Path]:
    """Build the named components (default: all) in the user's cache.

    Raises:
        CosimError: no such component.
    """
    from fmus_src.library import build_library, component_names

    wanted = _known(names) if names else component_names()
    with count_progress(quiet) as progress:
        task = progress.add_task("building FMUs", total=len(wanted), note="")
        _, built = build_library(
            wanted,
            lambda name, _: progress.update(task, advance=1, note=name),
            fmi=target.fmi,
            platforms=target.platforms,
        )
    return built


def _known(names: list[str]) -> list[str]:
    from fmus_src.library import component_names

    known = component_names()
    for name in names:
        if name not in known:
            raise CosimError(f"no component '{name}'{nearest(name, known)}")
    return names
