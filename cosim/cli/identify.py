"""`fowt identify`: the simplified model's parameters from free decays of the coupled model, or of any other."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import numpy.typing as npt
import typer
from rich.table import Table
from rich.text import Text

from cosim.case import case_folder, read_case, read_dampers, shipped_cases
from cosim.cli.console import Format, FormatOption, busy, emit, out, warn
from cosim.cli.run import Changes, _pair, _value, free_path, prepare
from cosim.errors import CosimError, nearest
from cosim.recording import new_folder
from cosim.ssp import read_parameters
from cosim.verification.reference import READERS, Record, read_history

if TYPE_CHECKING:
    from optimisation.identification import Decay, Fit, Identification, Model

Array = npt.NDArray[np.float64]

PREFIX = "simplified."
VERIFIED = ("decay10", "mtmd")  # on which the paper judges its set: figure 5
AT_REST = 0.15  # of the standard deviation of a channel's rate, at the first sample


def identify(
    reference: Annotated[
        str, typer.Option(help="Free decay: a load case, or a .parquet, .csv, .out, .outb file.")
    ] = "decay5",
    damper: Annotated[str, typer.Option(help="Dampers of that record: none, tmd-n, tmd-p, mtmd.")] = "none",
    anchor: Annotated[
        str, typer.Option(help="Second record, which fixes the common scale; 'none' leaves it out.")
    ] = "decay10",
    anchor_damper: Annotated[str, typer.Option(help="Dampers of the second record.")] = "mtmd",
    set_: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="PARAM=VALUE", help="Another parameter of the simplified model."),
    ] = None,
    folder: Annotated[Path | None, typer.Option("--out", help="New folder for the results.")] = None,
    output: FormatOption = Format.TEXT,
) -> None:
    """Identify inertia, stiffness and damping of the simplified model; write result.json, identified.ssv, identify.png.

    A file needs Time, PtfmPitch (deg) and TTDspFA (m), and begins at the
    release, at rest.

    Example: [bold]fowt identify --reference my.outb --anchor my_damped.outb[/bold]
    """
    from optimisation.identification import UNKNOWNS

    quiet = output is Format.JSON
    values = {name: _number(name, text) for name, text in (_pair(i, "--set", "PARAM=VALUE") for i in set_ or [])}
    taken = next((n for n in values if n in {u.name for u in UNKNOWNS}), None)
    if taken:
        raise CosimError(f"--set {taken}: it is identified; leave it out")
    sources = [(reference, damper)] + ([(anchor, anchor_damper)] if anchor != "none" else [])
    target = folder or free_path(Path("runs") / "identify")
    with all_or_nothing(target) as place:
        found = identified(sources, place, values, quiet=quiet)
        written = found.write(place, target)
    if not found.result.identifiable:
        warn(f"{found.result.weakness}; give a record with a damper (--anchor)")
    if quiet:
        emit(found.content(target))
        return
    _show(found.result, found.fits, found.paper)
    out.print(f"{target}: {', '.join(written)}", soft_wrap=True)


@dataclass(frozen=True, eq=False)
class Identified:
    """An identification, and how its set and the paper's (table 3) reproduce each record."""

    result: Identification
    fits: list[Fit]
    paper: list[Fit]

    def content(self, target: Path) -> dict[str, Any]:
        """All figures, see `optimisation.identified.content`, with the results folder."""
        from optimisation.identified import content

        return content(self.result, self.fits, self.paper) | {"folder": str(target)}

    def write(self, place: Path, target: Path) -> list[str]:
        """Write result.json, identified.ssv and identify.png into a place that will be the target; their names."""
        from optimisation.identified import plot, write_json, write_ssv

        written = (
            write_json(self.content(target), place / "result.json"),
            write_ssv("identified", self.result.values, place / "identified.ssv"),
            plot(self.fits, place / "identify.png"),
        )
        return [path.name for path in written]


def identified(
    sources: list[tuple[str, str]], place: Path, values: Mapping[str, float] | None = None, *, quiet: bool = False
) -> Identified:
    """Identify from records, each a load case or a file and its dampers; runs of load cases go to folders in `place`.

    Args:
        values: other parameters of the simplified model.
    """
    from optimisation.identification import UNKNOWNS, assess_fit
    from optimisation.identification import identify as fit

    simplified = Simplified.make(values)
    fitted = [simplified.decay(_record(s, d, place, quiet), d) for s, d in sources]
    further = [] if VERIFIED in sources else [simplified.decay(_record(*VERIFIED, place, quiet), VERIFIED[1])]
    model = simplified.model()
    with busy("identifying", quiet) as status:

        def tell(count: int, error: float) -> None:
            if status is not None:
                status.update(Text(f"identifying: simulation {count}, mean squared error {error:.4g}"))

        result = fit(model, fitted, progress=tell)
        own, paper = (
            [assess_fit(model, d, v, fitted=d in fitted) for d in (*fitted, *further)]
            for v in (result.values, {u.name: u.paper for u in UNKNOWNS})
        )
    return Identified(result, own, paper)


@contextmanager
def all_or_nothing(folder: Path) -> Iterator[Path]:
    """A place to write results in, moved to a new folder at the end; after a failure nothing is left of either.

    Raises:
        CosimError: the folder has content, or cannot be written to.
    """
    made = [p for p in (folder, *folder.parents) if not p.exists()]
    new_folder(folder)
    try:
        with tempfile.TemporaryDirectory(prefix="fowt-") as scratch:
            yield Path(scratch)
            for item in sorted(Path(scratch).iterdir()):
                shutil.move(item, folder / item.name)
    except BaseException:
        for path in made:
            with suppress(OSError):  # another has put something there meanwhile
                path.rmdir()
        raise


@dataclass(frozen=True, eq=False)
class Simplified:
    """The simplified model as identification needs it.

    Attributes:
        equations: of the component, see `fmus_src.equations`.
        values: parameters that differ from its defaults, whatever the record.
        defaults: all its parameters.
    """

    equations: Any
    values: Mapping[str, float]
    defaults: Mapping[str, float]

    @classmethod
    def make(cls, values: Mapping[str, float] | None = None) -> Simplified:
        """The model with some parameters changed.

        Raises:
            CosimError: it has no such parameter.
        """
        from fmus_src.equations import derive
        from fmus_src.simplified.model import component

        equations, values = derive(component()), dict(values or {})
        parameters = equations.of("parameter")
        defaults = {n: s for v in parameters for n, s in zip(v.element_names(), v.start, strict=True)}
        for name in values:
            if name not in defaults:
                raise CosimError(f"simplified model: no parameter '{name}'{nearest(name, defaults)}")
        return cls(equations, values, defaults)

    def model(self) -> Model:
        """Channels and their derivatives, see `optimisation.identification.Model`."""
        from fmus_src.sensitivity import Sensitivity
        from optimisation.identification import UNKNOWNS

        sensitivity = Sensitivity(
            self.equations, [u.name for u in UNKNOWNS], ["platform_pitch", "tower_top_displacement"]
        )
        units = np.array([np.degrees(1.0), 1.0])

        def simulate(decay: Decay, values: Mapping[str, float], derivatives: bool) -> tuple[Array, Array]:
            y, slopes = sensitivity.trajectory(
                {**decay.settings, **values}, samples=len(decay.values), spacing=decay.spacing, derivatives=derivatives
            )
            return y * units, slopes * units[:, None]

        return simulate

    def decay(self, record: Record, damper: str) -> Decay:
        """A record as a decay of this model: released where it begins, with dampers at rest in their bodies.

        Raises:
            CosimError: a channel is missing, times are not equally spaced, or the record does not begin at rest.
            ValueError: as `Decay`.
        """
        from optimisation.identification import CHANNELS, Decay

        settings = {**_dampers(damper), **self.values}
        columns = np.column_stack([record.values(c, unit) for c, unit in zip(CHANNELS, ("deg", "m"), strict=True)])
        steps = np.diff(record.time)
        spacing = float(steps.mean())
        if np.abs(steps - spacing).max() > 1e-3 * spacing:
            raise CosimError(f"{record.where}: samples are not equally spaced in time; resample it")
        label = (
            f"{Path(record.where).stem}, damper {damper}"
            if damper not in record.where.lower()
            else Path(record.where).stem
        )
        every = {**self.defaults, **settings}
        platform = float(np.radians(columns[0, 0]))
        tower = platform + float(columns[0, 1]) / every["hub_height"]
        start = {
            "initial_platform_pitch": platform,
            "initial_tower_angle": tower,
            "nacelle_damper.initial_displacement": every["nacelle_damper.R"] * tower,
            "platform_damper.initial_displacement": -every["platform_damper.R"] * platform,
        }
        decay = Decay(label, spacing, columns, settings | start)
        _check_rest(decay)
        return decay


def _check_rest(decay: Decay) -> None:
    first = decay.values[:3]
    rate = (-3.0 * first[0] + 4.0 * first[1] - first[2]) / (2.0 * decay.spacing)
    usual = np.gradient(decay.values, decay.spacing, axis=0).std(axis=0)
    if np.any(np.abs(rate) > AT_REST * usual):
        raise CosimError(f"{decay.label}: does not begin at rest; cut it so that it begins at the release")


def _dampers(name: str) -> dict[str, float]:
    """The simplified model's parameters for a damper arrangement."""
    arrangements = read_dampers(case_folder() / "dampers-simplified.toml")
    if name not in arrangements:
        raise CosimError(f"no damper arrangement '{name}'{nearest(name, arrangements)}")
    arrangement = arrangements[name]
    tuned = read_parameters(arrangement.parameters) if arrangement.parameters else {}
    values = {**{n: v.value for n, v in tuned.items()}, **arrangement.values}
    return {n.removeprefix(PREFIX): float(v) for n, v in values.items()}


def _record(source: str, damper: str, target: Path, quiet: bool) -> Record:
    """A history from a file, or from a run of a load case into the results folder."""
    path = Path(source)
    if path.suffix.lower() in READERS:
        if not path.is_file():
            raise CosimError(f"record {path}: no such file")
        return read_history(path)
    if source not in shipped_cases() and path.suffix != ".toml":
        known = nearest(source, [n for n in shipped_cases() if n.startswith("decay")])
        raise CosimError(f"no record '{source}': neither a load case nor a file of {', '.join(READERS)}{known}")
    prepared = prepare(read_case(source), damper, Changes(), quiet=quiet)
    with busy(f"running {prepared.label}", quiet):
        result = prepared.execute(target / prepared.label, lambda *_: None)
    record = read_history(result.folder / "results.parquet")
    return Record(str(result.folder), record.time, record.channels, record.units)


def _number(name: str, text: str) -> float:
    value = _value(text)
    if isinstance(value, str):
        raise CosimError(f"--set {name}={text}: give a number, true or false")
    return float(value)


def _show(result: Identification, fits: list[Fit], paper: list[Fit]) -> None:
    from optimisation.identification import CHANNELS, UNKNOWNS

    table = Table("unknown", "unit", box=None, pad_edge=False)
    for column in ("identified", "standard error", "paper", "ratio"):
        table.add_column(column, justify="right")
    for u in UNKNOWNS:
        value = result.values[u.name]
        error = f"{100.0 * result.standard_errors[u.name]:.2g} %"
        table.add_row(u.name, u.unit, f"{value:.3e}", error, f"{u.paper:.2e}", f"{value / u.paper:.2f}")
    out.print(table)
    table = Table("record", "channel", "", box=None, pad_edge=False)
    for column in ("residual RMS", "R2", "R2 with the paper's set"):
        table.add_column(column, justify="right")
    for fit, published in zip(fits, paper, strict=True):
        for channel, unit in zip(CHANNELS, ("deg", "m"), strict=True):
            how, rms = "fitted" if fit.fitted else "predicted", f"{fit.residual_rms[channel]:.3g} {unit}"
            table.add_row(fit.decay.label, channel, how, rms, f"{fit.r2[channel]:.4f}", f"{published.r2[channel]:.4f}")
    out.print(table)
    largest = result.singular_values / result.singular_values[0]
    out.print(f"weakest direction: {result.weakness}; all: {', '.join(f'{s:.1e}' for s in largest)}", soft_wrap=True)
