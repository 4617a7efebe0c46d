"""`fowt linearise`: how the coupled system responds to its dampers, measured by moving their masses."""

from __future__ import annotations

import hashlib
import json
import math
import os
import tempfile
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import pandas as pd
import typer
from rich.table import Table

from cosim.case import LoadCase, read_case
from cosim.cli.build import build_fmus
from cosim.cli.console import Format, FormatOption, Interrupted, emit, note, number, out, simulation_progress, warn
from cosim.cli.run import MAIN_CHANNELS, Changes, Prepared, SetOption, UntilOption, prepare
from cosim.cli.seeds import parsed_seeds
from cosim.errors import CosimError
from cosim.fmu import read_fmu
from cosim.recording import read_results
from cosim.run import simulate
from cosim.swap import with_swapped
from cosim.system import System, with_parameters
from optimisation.baselines import Primary, stiffness_and_damping, warburton
from optimisation.receptance import Damper, LinearModel, Mode, estimate, fit_mode
from optimisation.spectral import SpectralResponse

AMPLITUDE = 0.3  # m: little beside the strokes of some metres, and 1e4 times the coupling's error
HIGHEST = 0.69  # Hz: of the prescribed motions
SPECIFIC_FORCE = "attachment.specific_force[1]"


@dataclass(frozen=True)
class Scenario:
    """A case with a seed and parameters, put together with its dampers as they are (`prepared`) and moved."""

    label: str
    prepared: Prepared
    dampers: tuple[Damper, ...]
    about: dict[str, Any]

    def run(self, moved: str | None, shaker: Path, progress: Callable[[float], None]) -> pd.DataFrame:
        """Simulate with every mass held but `moved`."""
        system = self.prepared.system
        for damper in self.dampers:
            system = with_swapped(system, damper.name, shaker)
        period = self.prepared.settings.stop - self.prepared.settings.transient
        values: dict[str, float] = {}
        for damper in self.dampers:
            values[f"{damper.name}.amplitude"] = AMPLITUDE * (damper.name == moved)
            values[f"{damper.name}.period"] = min(period, 600.0)
        record = tuple(n for d in self.dampers for n in (d.displacement, d.acceleration))
        settings = replace(self.prepared.settings, record=record)
        with tempfile.TemporaryDirectory(prefix="fowt-linearise-") as folder:
            result = simulate(with_parameters(system, values), settings, Path(folder), progress)
            if result.status == "stopped":
                raise KeyboardInterrupt
            return read_results(result.folder)


def linearise(
    cases: Annotated[list[str], typer.Argument(help="Load cases: names ('fowt list') or .toml files.")],
    damper: Annotated[str, typer.Option(help="Damper arrangement; its masses and places are those of the models.")] = (
        "mtmd"
    ),
    seeds: Annotated[
        str | None, typer.Option(metavar="1:3,8", help="Seeds of wind and sea (default: the case's).")
    ] = None,
    vary: Annotated[
        list[str] | None,
        typer.Option(metavar="COMPONENT.PARAM=LOW,NOMINAL,HIGH", help="Uncertain parameter: a model for each value."),
    ] = None,
    set_: SetOption = None,
    until: UntilOption = None,
    channels: Annotated[str, typer.Option(help="Responses.")] = ",".join(MAIN_CHANNELS),
    folder: Annotated[Path, typer.Option("--out", help="Folder; models that are there already are kept.")] = Path(
        "linear"
    ),
    mode: Annotated[str, typer.Option(metavar="LOW,HIGH", help="Band of the pitch mode, Hz.")] = "0.06,0.11",
    workers: Annotated[int | None, typer.Option(min=1, help="Runs at a time (default: one for each core).")] = None,
    output: FormatOption = Format.TEXT,
) -> None:
    """Measure how each case responds to its dampers' masses, to evaluate springs and dashpots in milliseconds.

    Three runs for two dampers: masses held, and each in turn moved by 0.3 m.
    Writes a model and a picture of each.

    Example: [bold]fowt linearise lc1 lc4 --seeds 1:3 --out linear[/bold]
    """
    quiet = output is Format.JSON
    low, high = _numbers(mode, "--mode", 2)
    names = tuple(dict.fromkeys(c.strip() for c in channels.split(",") if c.strip()))
    wanted = [
        _scenario(read_case(case), damper, seed, override, Changes(set=set_ or (), until=until), names, quiet)
        for case in dict.fromkeys(cases)
        for seed in (parsed_seeds(seeds) if seeds else [None])
        for override in _overrides(vary or ())
    ]
    folder.mkdir(parents=True, exist_ok=True)
    missing = [s for s in wanted if not _done(folder, s)]
    for scenario in wanted:
        if scenario not in missing:
            note(f"{_file(folder, scenario)}: there already, not repeated")
    _run_all(missing, names, folder, workers or os.cpu_count() or 1, quiet)
    rows = [_describe(LinearModel.load(_file(folder, s)), s, low, high, folder) for s in wanted]
    if quiet:
        emit({"folder": str(folder), "models": rows})
    else:
        _show(rows)
        out.print(f"models and pictures: {folder}", soft_wrap=True)


def _scenario(
    case: LoadCase, damper: str, seed: int | None, override: str, changes: Changes, channels: Sequence[str], quiet: bool
) -> Scenario:
    changes = replace(changes, seed=seed, set=[*changes.set, *([override] if override else [])])
    prepared = prepare(case, damper, changes, quiet=quiet)
    known = {c.name for c in prepared.settings.channels}
    for name in channels:
        if name not in known:
            raise CosimError(f"{case.name} has no channel '{name}'; its channels are in {case.channels.name}")
    arrangement = case.dampers[damper]
    dampers = tuple(_damper(prepared.system, name) for name in arrangement.components)
    if not dampers:
        raise CosimError(f"'{damper}' has no dampers to move; choose another arrangement with --damper")
    used = case.seed if seed is None else seed
    label = f"{case.name}-seed{used}" + (f"-{override.replace('[', '').replace(']', '')}" if override else "")
    starts = {
        f"{c.name}.{n}": str(v.value)
        for c in prepared.system.components
        for n, v in c.start.items()
        if not (c.name in arrangement.components and n != "m")
    }
    content = [starts, prepared.settings.stop, prepared.settings.step, prepared.settings.transient, list(channels),
               [vars(d) for d in dampers], [str(c.fmu) for c in prepared.system.components]]  # fmt: skip
    about = {"case": case.name, "seed": used, "damper": damper, "set": list(changes.set),
             "key": hashlib.sha256(json.dumps(content).encode()).hexdigest()}  # fmt: skip
    return Scenario(label, prepared, dampers, about)


def _damper(system: System, name: str) -> Damper:
    """A damper of the system: its mass, and where its attachment's specific force comes from."""
    component = system.component(name)
    sources = [c for c in system.connections if c.target == name and c.input == SPECIFIC_FORCE]
    if not sources or "m" not in read_fmu(component.fmu).variables:
        raise CosimError(f"{name}: is no damper on a rail: it needs a parameter m and a connected {SPECIFIC_FORCE}")
    start = component.start.get("m")
    mass = start.value if start is not None else read_fmu(component.fmu).variables["m"].start
    return Damper(name, float(mass or 0.0), f"{name}.displacement", f"{sources[0].source}.{sources[0].output}")


def _file(folder: Path, scenario: Scenario) -> Path:
    return folder / f"linear-{scenario.label}.npz"


def _done(folder: Path, scenario: Scenario) -> bool:
    file = _file(folder, scenario)
    if not file.exists():
        return False
    if LinearModel.load(file).about.get("key") != scenario.about["key"]:
        raise CosimError(f"{file}: was made with other settings or components; choose another folder with --out")
    return True


def _run_all(scenarios: Sequence[Scenario], channels: tuple[str, ...], folder: Path, workers: int, quiet: bool) -> None:
    """Run all, each scenario's model written as soon as its runs are done; what is written stays after Ctrl-C."""
    if not scenarios:
        return
    shaker = build_fmus(quiet=quiet)["shaker"]
    stop = threading.Event()
    with simulation_progress(quiet) as progress, ThreadPoolExecutor(max_workers=workers) as pool:
        jobs: list[list[Future[pd.DataFrame]]] = []
        for scenario in scenarios:
            moved = [None, *(d.name for d in scenario.dampers)]
            task = progress.add_task(scenario.label, total=len(moved) * scenario.prepared.settings.stop)
            reached = [0.0] * len(moved)

            def follow(index: int, task: Any = task, reached: list[float] = reached) -> Callable[[float], None]:
                def on_progress(time: float, *_: float) -> None:
                    reached[index] = time
                    progress.update(task, completed=sum(reached))
                    if stop.is_set():
                        raise KeyboardInterrupt

                return on_progress

            jobs.append([pool.submit(scenario.run, name, shaker, follow(i)) for i, name in enumerate(moved)])
        try:
            for scenario, runs in zip(scenarios, jobs, strict=True):
                held, *shaken = (run.result() for run in runs)
                _estimate(scenario, held, shaken, channels).save(_file(folder, scenario))
                runs.clear()
        except BaseException as error:
            stop.set()
            pool.shutdown(wait=True, cancel_futures=True)
            if not isinstance(error, KeyboardInterrupt):
                raise
            progress.stop()
            raise Interrupted(
                f"stopped by the user; finished models are in {folder}: the same command goes on from there"
            ) from error


def _estimate(
    scenario: Scenario, held: pd.DataFrame, shaken: Sequence[pd.DataFrame], channels: tuple[str, ...]
) -> LinearModel:
    units, transient = held.attrs.get("units", {}), scenario.prepared.settings.transient
    return estimate(
        held, shaken, channels, scenario.dampers, label=scenario.label, highest=HIGHEST, transient=transient,
        units=[units.get(c, "") for c in channels], about=scenario.about,
    )  # fmt: skip


def _describe(model: LinearModel, scenario: Scenario, low: float, high: float, folder: Path) -> dict[str, Any]:
    """What is printed of a model; draws its picture."""
    from cosim.cli.linear_plot import plot_linear

    modes = {}
    for index, damper in enumerate(model.dampers):
        try:
            mode = fit_mode(model, index, low, high)
        except ValueError as error:  # the model itself is none the worse
            warn(str(error))
            continue
        k, c = stiffness_and_damping(warburton(mode.mass_ratio), _primary(mode, damper.mass))
        modes[damper.name] = {
            "frequency": mode.frequency, "damping": mode.damping, "mass_ratio": mode.mass_ratio,
            "warburton": {"k": k, "c": c},
        }  # fmt: skip
    fixed = {
        f"{d.name}.{n}": float(v.value)
        for d in model.dampers
        for n, v in scenario.prepared.system.component(d.name).start.items()
        if n in ("k", "c", "stroke", "k_stop", "c_stop") and not isinstance(v.value, str)
    }
    row: dict[str, Any] = {"label": model.label, "file": str(_file(folder, scenario)), "modes": modes, "channels": {}}
    variables = [f"{d.name}.{n}" for d in model.dampers for n in ("k", "c")]
    if not all(v in fixed for v in variables):  # no parameters to predict with
        return row | {"picture": str(plot_linear(model, None, folder / f"linear-{model.label}.png"))}
    response = SpectralResponse([model], variables, fixed)
    given = [[fixed[v] for v in variables]]
    held = model.histories(model.base[:, : len(model.channels)].T).var(axis=-1) + model.rest
    for name, unit, before, after in zip(model.channels, model.units, held**0.5, response(given)[0, 0], strict=True):
        row["channels"][name] = {"unit": unit, "held": float(before), "predicted": float(after)}
    damped = response.histories(given)[1]
    return row | {"picture": str(plot_linear(model, damped, folder / f"linear-{model.label}.png"))}


def _primary(mode: Mode, mass: float) -> Primary:
    return Primary(mode.mass_ratio, 2.0 * math.pi * mode.frequency, mode.damping, mass)


def _show(rows: Sequence[dict[str, Any]]) -> None:
    modes = Table("model", "damper", box=None, pad_edge=False)
    for title in ("pitch (Hz)", "damping ratio", "mass ratio", "Warburton k (N/m)", "c (N s/m)"):
        modes.add_column(title, justify="right")
    deviations = Table("standard deviation", "", box=None, pad_edge=False)
    deviations.add_column("masses held", justify="right")
    deviations.add_column("predicted, given dampers", justify="right")
    for row in rows:
        for name, m in row["modes"].items():
            figures = (m["frequency"], m["damping"], m["mass_ratio"], m["warburton"]["k"], m["warburton"]["c"])
            modes.add_row(row["label"], name, *map(number, figures))
        for name, c in row["channels"].items():
            deviations.add_row(row["label"], f"{name} ({c['unit']})", number(c["held"]), number(c["predicted"]))
    out.print(modes)
    out.print("Warburton (1982): one damper alone on the pitch mode, undamped, in white noise", style="dim")
    out.print(deviations)


def _numbers(text: str, option: str, count: int) -> list[float]:
    try:
        values = [float(v) for v in text.split(",")]
    except ValueError:
        values = []
    if len(values) != count or sorted(values) != values:
        raise CosimError(f"{option} {text}: write {count} rising numbers with commas between them")
    return values


def _overrides(vary: Sequence[str]) -> list[str]:
    """One parameter at a time: "NAME=VALUE" for each of its values; "" for the case as it is."""
    overrides = []
    for item in vary:
        name, _, values = item.partition("=")
        _numbers(values, f"--vary {name}", 3)
        overrides += [f"{name}={v.strip()}" for v in values.split(",")]
    return overrides or [""]
