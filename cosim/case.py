"""Load cases and damper arrangements: small TOML files that choose a system, its parameters, wind and run length."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from importlib import resources
from pathlib import Path
from typing import Any

from cosim.errors import CosimError, nearest
from cosim.ssp import read_parameters
from cosim.system import StartValue, System, with_parameters, without
from cosim.toml_file import TomlReader, read_toml

Number = float | int | bool | str


@dataclass(frozen=True)
class Wind:
    """A turbulent wind box to be generated (or found in the cache): IEC Kaimal turbulence.

    Attributes:
        parameter: `component.variable` that takes the file's path.
        mean_speed: at hub height, m/s.
        turbulence_class: "A", "B" or "C".
        width: of the box, m; the rotor must stay within it however far the platform sways.
    """

    parameter: str
    mean_speed: float
    turbulence_class: str = "B"
    width: float = 145.0


@dataclass(frozen=True)
class Damper:
    """A damper arrangement.

    Attributes:
        components: those of the system that are kept; `optional` lists those of all arrangements.
        parameters: parameter set file, or None; `prefix` goes before its names.
        values: further parameter values.
        system: system of its own instead of the load case's, or None.
        fmus: names of the FMUs that take the place of the system's, by component; they are in the same folder.
    """

    name: str
    description: str
    components: tuple[str, ...] = ()
    optional: tuple[str, ...] = ()
    parameters: Path | None = None
    prefix: str = ""
    values: Mapping[str, Number] = field(default_factory=dict)
    system: Path | None = None
    fmus: Mapping[str, Number] = field(default_factory=dict)


@dataclass(frozen=True)
class LoadCase:
    """A load case: what is simulated, for how long, and under which wind and sea.

    Attributes:
        file: where it was read from; `name` is the file's stem.
        without: components of the system that are left out.
        stop, step, transient: s; statistics begin after the transient.
        record_every: communication steps per recorded row.
        seed: of the random wind and sea; `seed_parameters` are set to it.
    """

    file: Path
    description: str
    system: Path
    channels: Path
    dampers: Mapping[str, Damper]
    damper: str
    without: tuple[str, ...]
    stop: float
    step: float
    transient: float
    record_every: int
    seed: int
    seed_parameters: tuple[str, ...]
    wind: Wind | None
    parameters: Mapping[str, Number]

    @property
    def name(self) -> str:
        """Name of the case: its file without the ending."""
        return self.file.stem


def shipped_cases() -> dict[str, Path]:
    """Load cases that come with the package, by name."""
    folder = case_folder()
    files = sorted(folder.glob("*.toml"))
    return {f.stem: f for f in files if not f.stem.startswith(("channels", "dampers", "verification"))}


def case_folder() -> Path:
    """Folder of the cases that come with the package."""
    return Path(str(resources.files("cases")))


def read_case(name: str) -> LoadCase:
    """Read a load case by its name, or from the path of a TOML file; files that it names lie beside it, or come from
    the package.

    Raises:
        CosimError: no such case, or the file is malformed.
    """
    shipped = shipped_cases()
    path = shipped.get(name.lower()) or Path(name)
    if not path.is_file():
        raise CosimError(f"no load case '{name}'{nearest(name, shipped)} ('fowt list' shows all; or give a .toml file)")
    table = read_toml(path)
    with TomlReader(table, path, "") as top:
        run, wind = top.table("run"), top.table("wind")
        with TomlReader(run, path, "run.") as r:
            stop, step = r.take("stop", float), r.take("step", float, 0.0125)
            transient, record_every = r.take("transient", float, 0.0), r.take("record_every", int, 4)
        box = None
        if wind:
            with TomlReader(wind, path, "wind.") as w:
                box = Wind(
                    w.take("parameter", str), w.take("mean_speed", float), w.take("turbulence_class", str, "B"),
                    w.take("width", float, Wind.width),
                )  # fmt: skip
        dampers = read_dampers(_file(path, top.take("dampers", str, _dampers_of(table))))
        if not (stop > 0.0 and step > 0.0 and 0.0 <= transient < stop and record_every >= 1):
            raise CosimError(f"{path}: [run] needs stop > transient >= 0, step > 0 and record_every >= 1")
        return LoadCase(
            file=path,
            description=top.take("description", str),
            system=_file(path, top.take("system", str)),
            channels=_file(path, top.take("channels", str)),
            dampers=dampers,
            damper=top.take("damper", str, "none"),
            without=top.texts("without"),
            stop=stop,
            step=step,
            transient=transient,
            record_every=record_every,
            seed=top.take("seed", int, 1),
            seed_parameters=top.texts("seed_parameters"),
            wind=box,
            parameters=top.values("parameters"),
        )


def read_dampers(path: Path) -> dict[str, Damper]:
    """Damper arrangements of a TOML file, by name.

    Raises:
        CosimError: the file is missing or malformed.
    """
    tables = read_toml(path)
    dampers = {}
    for name, table in tables.items():
        if not isinstance(table, dict):
            raise CosimError(f"{path}: '{name}' should be a table [{name}]")
        with TomlReader(table, path, f"{name}.") as r:
            file, own = r.take("parameters", str, ""), r.take("system", str, "")
            dampers[name] = Damper(
                name=name,
                description=r.take("description", str, ""),
                components=r.texts("components"),
                parameters=_file(path, file) if file else None,
                prefix=r.take("prefix", str, ""),
                values=r.values("values"),
                system=_file(path, own) if own else None,
                fmus=r.values("fmus"),
            )
    optional = tuple(dict.fromkeys(c for d in dampers.values() for c in d.components))
    return {name: replace(d, optional=optional) for name, d in dampers.items()}


def with_damper(system: System, damper: Damper) -> System:
    """The system with one damper arrangement: its components kept, those of the others dropped, its values set."""
    present = {c.name for c in system.components}
    for name in damper.components:
        system.component(name)  # a misspelt one must not pass for an arrangement without it
    system = without(system, *(c for c in damper.optional if c in present and c not in damper.components))
    for name, fmu in damper.fmus.items():
        own = replace(system.component(name), fmu=system.component(name).fmu.with_name(f"{fmu}.fmu"))
        system = replace(system, components=tuple(own if c.name == name else c for c in system.components))
    if damper.parameters is not None:
        system = with_parameters(system, qualified(read_parameters(damper.parameters), damper, system))
    return with_parameters(system, damper.values)


def qualified(values: Mapping[str, StartValue], damper: Damper, system: System) -> dict[str, StartValue]:
    """A tuned set for one arrangement: prefixed where no component is named, less the dampers that are left out."""
    names = tuple(f"{c.name}." for c in system.components)
    left_out = tuple(f"{c}." for c in damper.optional if f"{c}." not in names)
    kept = {n: v for n, v in values.items() if not n.startswith(left_out)}
    return {n if n.startswith(names) else damper.prefix + n: v for n, v in kept.items()}


def _file(path: Path, name: str) -> Path:
    """A file that another names: beside it, else the package's own of that name."""
    beside, shipped = path.parent / name, case_folder() / name
    return shipped if shipped.is_file() and not beside.is_file() else beside


def _dampers_of(table: Mapping[str, Any]) -> str:
    simplified = str(table.get("system", "")).startswith("simplified")
    return "dampers-simplified.toml" if simplified else "dampers.toml"
