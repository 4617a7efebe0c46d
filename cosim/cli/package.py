"""`fowt export`: a load case as SSP package; and packages, own or foreign, prepared for `fowt run`."""

from __future__ import annotations

import shlex
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from cosim.archive import entry_names, sha256
from cosim.case import read_case
from cosim.checks import check
from cosim.cli.console import Format, FormatOption, emit, note, out, warn
from cosim.cli.run import (
    Changes,
    FmusOption,
    MapOption,
    Prepared,
    SeedOption,
    SetOption,
    SsvOption,
    StepOption,
    SwapOption,
    UntilOption,
    free_path,
    prepare,
    swapped,
    with_settings,
)
from cosim.errors import CosimError, nearest
from cosim.recording import Channel
from cosim.run import RunSettings
from cosim.ssp import Structure, read_package, read_parameters
from cosim.ssp_writer import VERSIONS, write_package
from cosim.system import System, with_parameters

USUAL_STEP = 0.0125  # s
OF_CASES = ("damper", "seed", "fmus", "monolithic")


def export(
    case: Annotated[str, typer.Argument(help="Load case: a name ('fowt list') or a .toml file.")],
    damper: Annotated[str | None, typer.Option(help="Damper arrangement, such as mtmd ('fowt list').")] = None,
    version: Annotated[str, typer.Option("--ssp", help="Version of SSP: 1.0 or 2.0.")] = "1.0",
    file: Annotated[Path | None, typer.Option("--out", metavar="FILE.ssp", help="The package to write.")] = None,
    swap: SwapOption = None,
    map_: MapOption = None,
    set_: SetOption = None,
    ssv: SsvOption = None,
    seed: SeedOption = None,
    until: UntilOption = None,
    step: StepOption = None,
    fmus: FmusOption = None,
    own_names: Annotated[
        bool, typer.Option("--own-names", help="Parameter sets by the FMUs' own names, for tools that read no .ssm.")
    ] = False,
    output: FormatOption = Format.TEXT,
) -> None:
    """Write a load case as one SSP package: structure, FMUs, parameter sets and wind, for any tool that reads SSP.

    Example: [bold]fowt export lc4 --damper mtmd --out lc4.ssp[/bold]
    """
    if version not in VERSIONS:
        raise CosimError(f"--ssp {version}: no such version{nearest(version, VERSIONS)}")
    changes = Changes(swap or (), map_ or (), set_ or (), ssv or (), seed, until, step, fmus)
    prepared = prepare(read_case(case), damper, changes, quiet=output is Format.JSON)
    target = file or free_path(Path(f"{prepared.label}.ssp"))
    target.parent.mkdir(parents=True, exist_ok=True)
    for line in prepared.system.notes:
        warn(line)
    written = write_package(prepared.system, prepared.settings, target, version, mappings=not own_names)
    mappings = [n for n in entry_names(written) if n.endswith(".ssm")]
    if mappings:
        note(f"libcosim passes over {', '.join(mappings)} without a word; for such tools, write with --own-names")
    size, names = written.stat().st_size, [c.name for c in prepared.system.components]
    if output is Format.JSON:
        emit({"file": str(written), "ssp": version, "size": size, "sha256": sha256(written), "components": names})
        return
    out.print(f"{written}  (SSP {version}, {size / 1e6:.1f} MB: {', '.join(names)})", soft_wrap=True)
    out.print(f"run it with: fowt run {shlex.quote(str(written))}", soft_wrap=True)


def prepare_package(ssp: Path, damper: str | None, changes: Changes, folder: Path) -> Prepared:
    """A package ready to run, unpacked in `folder`, with the changes of the command line.

    Raises:
        CosimError: the package or a change cannot be used.
    """
    given = {**vars(changes), "damper": damper}
    for name in OF_CASES:
        if given[name] not in (None, False, (), []):
            raise CosimError(f"--{name} is for load cases; {ssp.name} is a package with its own components")
    if not ssp.is_file():
        raise CosimError(f"{ssp}: no such file")
    found = read_package(ssp, folder)
    note(f"{ssp.name} brings {len({c.fmu for c in found.system.components})} FMUs, whose binaries are loaded now")
    system = swapped(found.system, changes)
    for file in changes.ssv:
        system = with_parameters(system, read_parameters(file))
    system = with_settings(system, changes)
    settings = _settings(ssp, found, system, changes)
    about: dict[str, str | int] = {"package": str(ssp), "package_sha256": sha256(ssp)}
    return Prepared(ssp.stem, system, replace(settings, about=about), settings.step)


def _settings(ssp: Path, found: Structure, system: System, changes: Changes) -> RunSettings:
    start, stop = found.start or 0.0, found.stop if changes.until is None else changes.until
    if stop is None:
        raise CosimError(f"{ssp}: says no end of the run; give one with --until")
    step = changes.step or found.step
    if step is None:
        step = USUAL_STEP
        note(f"{ssp.name} says no step: {step:g} s are used; --step gives another")
    transient = found.transient if stop - start > found.transient else 0.0
    chosen = {k: v for k, v in changes.stepping.items() if v is not None}
    settings = RunSettings(stop, start, step, transient=transient, decimation=max(1, found.record_every), **chosen)
    settings.steps()
    return replace(settings, channels=_channels(found, system), record=tuple(changes.record))


def _channels(found: Structure, system: System) -> tuple[Channel, ...]:
    """What the package names; if nothing, all outputs of all components."""
    if found.outputs:
        return found.outputs
    checked = check(system, [c.name for c in system.components])
    pairs = zip(checked.names, checked.fmus, strict=True)
    everything = ((n, v) for n, fmu in pairs for v in fmu.variables.values())
    return tuple(
        Channel(f"{n}.{v.name}", f"{n}.{v.name}", None, v.description)
        for n, v in everything if v.causality == "output" and v.type != "String"
    )  # fmt: skip
