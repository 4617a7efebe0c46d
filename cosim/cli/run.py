"""`fowt run`: co-simulate one load case."""

from __future__ import annotations

import itertools
import math
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table
from rich.text import Text

from cosim.case import LoadCase, Number, qualified, read_case, with_damper
from cosim.cli.build import build_fmus
from cosim.cli.console import Format, FormatOption, busy, emit, note, number, out, simulation_progress, warn
from cosim.errors import CosimError, RunFailed, nearest
from cosim.formats import convert, format_names
from cosim.recording import read_channels
from cosim.run import Progress, RunResult, RunSettings, simulate
from cosim.ssp import read_mapping, read_parameters, read_system
from cosim.swap import NameRule, with_swapped
from cosim.system import System, split_name, with_parameters, without

MAIN_CHANNELS = ("PtfmPitch", "TTDspFA", "TwrBsMyt", "RootMyc1", "GenPwr")

SetOption = Annotated[list[str] | None, typer.Option("--set", metavar="COMPONENT.PARAM=VALUE", help="Set a parameter.")]
SwapOption = Annotated[
    list[str] | None, typer.Option("--swap", metavar="COMPONENT=FILE.fmu", help="Use another FMU for a component.")
]
MapOption = Annotated[
    list[str] | None,
    typer.Option(
        "--map",
        metavar="COMPONENT.NAME=NAME",
        help="What a swapped FMU calls a variable, '-' if it has none; or a mapping file, FILE.ssm.",
    ),
]
SsvOption = Annotated[list[Path] | None, typer.Option("--ssv", metavar="FILE.ssv", help="Parameter set file.")]
SeedOption = Annotated[int | None, typer.Option(min=0, help="Seed of wind and sea.")]
UntilOption = Annotated[float | None, typer.Option(metavar="T", help="End of the run, s.")]
StepOption = Annotated[float | None, typer.Option(metavar="H", help="Communication step, s.")]
AlgorithmOption = Annotated[
    str | None, typer.Option(help="gauss-seidel (default), jacobi, iterated or newton.", show_default=False)
]
ExtrapolationOption = Annotated[str | None, typer.Option(help="Inputs over a step: quadratic (default), linear, held.")]
EnergyOption = Annotated[
    float | None,
    typer.Option(
        help="Error of a port's power above which a step is repeated in halves: 1e-3, iterated 1e-5; 0: never."
    ),
]
IsolateOption = Annotated[
    list[str] | None,
    typer.Option("--isolate", metavar="COMPONENT", help="Run a component in a process of its own; or 'all'."),
]
CallTimeoutOption = Annotated[
    float | None, typer.Option(metavar="T", help="Wall time for one call of an isolated component: 60 s.")
]
FmusOption = Annotated[Path | None, typer.Option(help="Folder of FMUs to use instead of this package's own.")]


@dataclass(frozen=True)
class Changes:
    """What the command line changes in a load case.

    Attributes:
        stepping: settings of the run, see `RunSettings`.
        monolithic: whether the components run as one FMU, see `cosim.cli.monolithic`.
    """

    swap: Sequence[str] = ()
    map: Sequence[str] = ()
    set: Sequence[str] = ()
    ssv: Sequence[Path] = ()
    seed: int | None = None
    until: float | None = None
    step: float | None = None
    fmus: Path | None = None
    record: Sequence[str] = ()
    stepping: Mapping[str, Any] = field(default_factory=dict)
    monolithic: bool = False


def run(
    case: Annotated[str, typer.Argument(help="Load case: a name ('fowt list') or a .toml file; or a package, .ssp.")],
    damper: Annotated[str | None, typer.Option(help="Damper arrangement, such as mtmd ('fowt list').")] = None,
    swap: SwapOption = None,
    map_: MapOption = None,
    set_: SetOption = None,
    ssv: SsvOption = None,
    seed: SeedOption = None,
    until: UntilOption = None,
    step: StepOption = None,
    folder: Annotated[Path | None, typer.Option("--out", help="New folder for the results.")] = None,
    fmus: FmusOption = None,
    record: Annotated[
        list[str] | None, typer.Option(metavar="PATTERN", help="Record variables too: 'barge.hub.*'.")
    ] = None,
    algorithm: AlgorithmOption = None,
    extrapolation: ExtrapolationOption = None,
    tolerance: Annotated[float | None, typer.Option(help="Of iterations and algebraic loops, relative.")] = None,
    energy_tolerance: EnergyOption = None,
    rate: Annotated[
        list[str] | None, typer.Option(metavar="COMPONENT=N", help="Step a component once in N steps, or 1/N: N times.")
    ] = None,
    monolithic: Annotated[
        bool, typer.Option("--monolithic", help="All components as one FMU, integrated together: the exact coupling.")
    ] = False,
    isolate: IsolateOption = None,
    also: Annotated[
        str | None, typer.Option(metavar="FORMATS", help="Write the results in other formats too: csv,mat,outb.")
    ] = None,
    call_timeout: CallTimeoutOption = None,
    output: FormatOption = Format.TEXT,
) -> None:
    """Co-simulate a load case and write results.parquet, summary.json, run.json and run.png.

    A package (FILE.ssp), --swap and --fmus load binaries of files that you name.

    Example: [bold]fowt run lc4 --damper mtmd --set nacelle_damper.k=6302 --seed 2[/bold]
    """
    stepping = {
        "algorithm": algorithm, "extrapolation": extrapolation, "tolerance": tolerance,
        "energy_tolerance": energy_tolerance, "rates": dict(_rate(r) for r in rate) if rate else None,
        "isolate": tuple(isolate) if isolate else None, "call_timeout": call_timeout,
    }  # fmt: skip
    chosen_stepping = [f"--{name.replace('_', '-').removesuffix('s')}" for name, v in stepping.items() if v is not None]
    if monolithic and chosen_stepping:
        raise CosimError(f"{chosen_stepping[0]} is for coupled components; --monolithic has one: leave either out")
    if call_timeout is not None and not isolate:
        raise CosimError("--call-timeout is for components in processes of their own: add --isolate COMPONENT")
    changes = Changes(
        swap or (), map_ or (), set_ or (), ssv or (), seed, until, step, fmus, record or (), stepping, monolithic
    )
    quiet = output is Format.JSON
    formats = () if also is None else format_names(also, "--also")
    with (
        simulation_progress(quiet) as progress,
        tempfile.TemporaryDirectory(prefix="fowt-", ignore_cleanup_errors=True) as unpacked,
    ):
        if case.lower().endswith(".ssp"):
            from cosim.cli.package import prepare_package

            prepared = prepare_package(Path(case), damper, changes, Path(unpacked))
        else:
            prepared = prepare(read_case(case), damper, changes, quiet=quiet)
        task = progress.add_task(prepared.label, total=prepared.settings.stop)
        result = prepared.execute(folder, lambda t, *_: progress.update(task, completed=t))
    for line in result.warnings:
        (note if line.startswith("algebraic loop") else warn)(line)
    if not quiet:
        _show(result)
    files = [str(path) for path in convert(result.folder, formats)] if formats else []
    if quiet:
        about_files = {"files": files} if files else {}
        emit({"folder": str(result.folder), "status": result.status, "summary": result.summary, **about_files})
    elif files:
        out.print(f"also written: {', '.join(files)}", soft_wrap=True, markup=False)
    if result.status == "stopped":
        warn(result.message)
        raise typer.Exit(130)


@dataclass(frozen=True)
class Prepared:
    """A run ready to start."""

    label: str
    system: System
    settings: RunSettings
    usual_step: float

    def execute(self, folder: Path | None, progress: Progress) -> RunResult:
        """Simulate into the folder (default: a new one below ./runs) and draw the run."""
        from cosim.cli.plots import plot_run

        target = folder or free_path(Path("runs") / self.label)
        try:
            result = simulate(self.system, self.settings, target, progress)
        except RunFailed as error:
            coarse = self.settings.step > self.usual_step
            hint = f"; the step is larger than the case's {self.usual_step:g} s: try that" if coarse else ""
            raise RunFailed(f"{error}{hint} (what was computed is in {target})") from error
        plot_run(result.folder, self.label)
        return result


def prepare(
    case: LoadCase, damper: str | None, changes: Changes, *, quiet: bool = False, again: bool = False
) -> Prepared:
    """Build what is missing, make the wind, and put the system together.

    Args:
        again: the case has been prepared before with these changes: what is doubtful has been said.

    Raises:
        CosimError: a name in the changes is unknown, or a file cannot be used.
    """
    name = case.damper if damper is None else damper
    if name not in case.dampers:
        raise CosimError(f"no damper arrangement '{name}'{nearest(name, case.dampers)}")
    arrangement = case.dampers[name]
    folders = [changes.fmus] if changes.fmus else [next(iter(build_fmus(quiet=quiet).values())).parent]
    settings = _settings(case, changes, again)
    settings.steps()
    whole = read_system(arrangement.system or case.system, folders)
    system = without(with_damper(whole, arrangement), *case.without)
    seed = case.seed if changes.seed is None else changes.seed
    values: dict[str, Number] = dict(case.parameters) | dict.fromkeys(case.seed_parameters, seed)
    left_out = {c.name for c in whole.components} - {c.name for c in system.components}
    if case.wind and case.wind.parameter.split(".")[0] not in left_out:
        values[case.wind.parameter] = str(wind_file(case, seed, settings.stop, quiet))
    system = with_parameters(system, {n: v for n, v in values.items() if n.split(".")[0] not in left_out})
    system = swapped(system, changes)
    for file in changes.ssv:
        system = with_parameters(system, qualified(read_parameters(file), arrangement, system))
    system = with_settings(system, changes)
    label = f"{case.name}-{name}" + (f"-seed{seed}" if case.seed_parameters else "")
    about: dict[str, str | int] = {"case": case.name, "damper": name, "seed": seed}
    prepared = Prepared(label, system, replace(settings, about=about), case.step)
    if changes.monolithic:
        from cosim.cli.monolithic import as_one

        return as_one(prepared, quiet=quiet)
    return prepared


def swapped(system: System, changes: Changes) -> System:
    """The system with the FMUs of --swap, their names mapped by --map.

    Raises:
        CosimError: a name is unknown, or a file cannot be used.
    """
    rules: dict[str, list[NameRule]] = {c.name: [] for c in system.components}
    for item in changes.map:
        for component, rule in _rules(item, set(rules)):
            rules[component].append(rule)
    given = dict(_pair(item, "--swap", "COMPONENT=FILE.fmu") for item in changes.swap)
    for component, own in rules.items():
        if own and component not in given:
            raise CosimError(f"--map {component}.{own[0].variable}: add --swap {component}=FILE.fmu")
    for component, file in given.items():
        system = with_swapped(system, component, Path(file), rules.get(component, ()))
    return system


def _rules(item: str, names: set[str]) -> list[tuple[str, NameRule]]:
    """Component and rule of each entry of a --map."""
    if "=" not in item and item.lower().endswith(".ssm"):
        found = []
        for e in read_mapping(Path(item)):
            component, variable = split_name(e.source, names)
            target = e.target.removeprefix(f"{component}.")
            found.append((component, NameRule(variable, target, e.factor, e.offset, e.convert)))
        return found
    full, target = _pair(item, "--map", "COMPONENT.NAME=NAME, or FILE.ssm")
    component, variable = split_name(full, names)
    return [(component, NameRule(variable, target))]


def with_settings(system: System, changes: Changes) -> System:
    """The system with the values of --set.

    Raises:
        CosimError: a component is unknown.
    """
    given = dict(_pair(item, "--set", "COMPONENT.PARAM=VALUE") for item in changes.set)
    return with_parameters(system, {n: _value(text) for n, text in given.items()})


def _settings(case: LoadCase, changes: Changes, again: bool = False) -> RunSettings:
    stop = case.stop if changes.until is None else changes.until
    transient = case.transient if stop > case.transient else 0.0
    if transient < case.transient and not again:
        warn(f"the run ends within the transient of {case.transient:g} s: statistics include it")
    if case.wind and stop > case.stop and not again:
        warn(f"a run beyond the case's {case.stop:g} s has a longer wind box, so another wind than the case's")
    settings = RunSettings(
        stop=stop,
        step=case.step if changes.step is None else changes.step,
        transient=transient,
        decimation=case.record_every,
        channels=read_channels(case.channels),
        record=tuple(changes.record),
    )
    return replace(settings, **{k: v for k, v in changes.stepping.items() if v is not None})


def wind_file(case: LoadCase, seed: int, stop: float, quiet: bool) -> Path:
    """The box of a case with wind, generated once; it spans the whole case: a shorter run sees the same wind."""
    from platformdirs import user_cache_path

    from fmus_src.aero.turbulence import TurbulenceSpec, cached_box

    assert case.wind is not None
    duration = max(case.stop, stop)
    spec = TurbulenceSpec(
        mean_speed=case.wind.mean_speed, turbulence_class=case.wind.turbulence_class, seed=seed, duration=duration
    )
    if case.wind.width != spec.grid_width:  # points no further apart than they are by default
        spacing = spec.grid_width / (spec.grid_points - 1)
        points = 2 * math.ceil(case.wind.width / (2.0 * spacing) - 1e-9) + 1
        spec = replace(spec, grid_width=case.wind.width, grid_points=points)
    with busy("generating the turbulent wind", quiet):
        return cached_box(spec, user_cache_path("fowt-cosim") / "wind")


def _pair(item: str, option: str, form: str) -> tuple[str, str]:
    name, equals, value = item.partition("=")
    if not (name and equals and value):
        raise CosimError(f"{option} {item}: write it as {form}")
    return name, value


def _rate(item: str) -> tuple[str, float]:
    """A component and its step in communication steps, from "COMPONENT=2" or "COMPONENT=1/2"."""
    component, text = _pair(item, "--rate", "COMPONENT=2 or COMPONENT=1/2")
    try:
        return component, float(Fraction(text))
    except (ValueError, ZeroDivisionError, OverflowError) as error:
        raise CosimError(f"--rate {item}: '{text}' is no number; write it as COMPONENT=2 or COMPONENT=1/2") from error


def _value(text: str) -> Number:
    if text.lower() in ("true", "false"):
        return text.lower() == "true"
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text


def free_path(wanted: Path) -> Path:
    """The path, or the first of wanted-2, wanted-3, ... that does not exist: nothing is ever overwritten."""
    numbered = (wanted.with_name(f"{wanted.stem}-{i}{wanted.suffix}") for i in itertools.count(2))
    candidates = itertools.chain([wanted], numbered)
    return next(c for c in candidates if not c.exists())


def _show(result: RunResult) -> None:
    if not result.summary:
        out.print(f"nothing recorded after the transient; {result.folder}")
        return
    table = Table("channel", "unit", box=None, pad_edge=False)
    for column in ("mean", "std", "min", "max"):
        table.add_column(column, justify="right")
    for name, s in result.summary.items():
        table.add_row(Text(name), Text(s["unit"]), *(number(s[k]) for k in ("mean", "std", "min", "max")))
    out.print(table)
    if result.ports:
        out.print(_ports_line(result), soft_wrap=True, markup=False)
    out.print(f"{result.status}: {result.folder} ({result.wall_time:.1f} s of wall time)", markup=False)


def _ports_line(result: RunResult) -> str:
    """The largest coupling-energy residual among the ports, in words."""
    name, port = max(result.ports.items(), key=lambda item: item[1]["share"])
    return (
        f"coupling energy: at most {port['share']:.1e} of what crossed a port"
        f" ({name}: {port['residual']:.3g} J of {port['crossed']:.3g} J); all ports in run.json"
    )
