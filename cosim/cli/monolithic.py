"""`fowt run --monolithic`: the components of a run as one FMU, in which every connection holds at every instant."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

from cosim.checks import CheckedSystem, check
from cosim.cli.console import busy
from cosim.errors import CosimError
from cosim.fmu import read_fmu
from cosim.recording import Channel, select_channels
from cosim.run import RunSettings
from cosim.system import ComponentInstance, System
from fmus_src.compose import Connection
from fmus_src.library import build_library, build_system, component_names

if TYPE_CHECKING:
    from cosim.cli.run import Prepared

NAME = "monolith"


def as_one(prepared: Prepared, *, quiet: bool = False) -> Prepared:
    """The run with its system as one FMU, built once; channels keep their names, start values their components.

    Raises:
        CosimError: an FMU is not this package's own, so that its equations are not at hand, or cannot be composed.
    """
    checked = check(prepared.system)
    parts = _parts(prepared.system)
    connections: list[Connection] = [
        (f"{checked.names[k.source]}.{k.output.name}", f"{checked.names[k.target]}.{k.input.name}", k.factor, k.offset)
        for k in checked.links
    ]
    with busy("building the system as one FMU", quiet):
        try:
            fmu = build_system(NAME, parts, connections)
        except ValueError as error:
            raise CosimError(f"monolithic: {error}") from error
    start = {f"{c.name}.{n}": value for c in prepared.system.components for n, value in c.start.items()}
    known = read_fmu(fmu).variables
    one = System(
        prepared.system.name,
        # Inputs that are connected have no start value of their own any more.
        (ComponentInstance(NAME, fmu, {n: v for n, v in start.items() if n in known}),),
        notes=prepared.system.notes,
        open_inputs=frozenset((NAME, f"{part}.{name}") for part, name in prepared.system.open_inputs),
    )
    settings = _settings(prepared.settings, checked)
    return replace(prepared, label=f"{prepared.label}-monolithic", system=one, settings=settings)


def _parts(system: System) -> dict[str, str]:
    """The library's component behind each FMU."""
    parts: dict[str, str] = {}
    for component in system.components:
        fmu = read_fmu(component.fmu)
        own = fmu.identifier in component_names()
        if not own or read_fmu(build_library([fmu.identifier])[1][fmu.identifier]).guid != fmu.guid:
            raise CosimError(
                f"{component.name}: {component.fmu} is not this package's own build of '{fmu.identifier}', so that its"
                " equations are not at hand: run without --monolithic, or without swapping it"
            )
        parts[component.name] = fmu.identifier
    return parts


def _settings(settings: RunSettings, checked: CheckedSystem) -> RunSettings:
    """The same channels, found in the one FMU; a connected input is recorded as what feeds it."""
    sources = {
        f"{checked.names[k.target]}.{k.input.name}": f"{checked.names[k.source]}.{k.output.name}"
        for k in checked.links
        if (k.factor, k.offset) == (1.0, 0.0)
    }
    named = [c for c in settings.channels if any(c.variable.startswith(f"{n}.") for n in checked.names)]
    named += [Channel(c.name, c.name) for c in _recorded(settings, checked)]
    channels = tuple(replace(c, variable=f"{NAME}.{sources.get(c.variable, c.variable)}") for c in named)
    about: Mapping[str, str | int] = dict(settings.about) | {"monolithic": True}
    return replace(settings, channels=channels, record=(), order=(), about=about)


def _recorded(settings: RunSettings, checked: CheckedSystem) -> list[Channel]:
    """The variables that patterns find among the components."""
    if not settings.record:
        return []
    selected, _ = select_channels(checked, (), settings.record)
    return [Channel(c.name, c.name, None, c.description) for c in selected]
