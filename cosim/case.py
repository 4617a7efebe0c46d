"""Load cases and damper arrangements: small TOML files that choose a system, its parameters, wind and run length."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Any

from cosim.errors import CosimError, nearest
from cosim.ssp import read_parameters
from cosim.system import StartValue, System, with_parameters, without

Number = float | int | bool | str


@dataclass(frozen=True)
class Wind:
    """A turbulent wind box to be generated (or found in the cache): IEC Kaimal turbulence.

    Attributes:
        parameter: `component.variable` that takes the file's path.
        mean_speed: at hub height, m/s.
        turbulence_class: "A", "B" or "C".
    """

    parameter: str
    mean_speed: float
    turbulence_class: str = "B"


@dataclass(frozen=True)
class Damper:
    """A damper arrangement.

    Attributes:
        components: those of the system that are kept; `optional` lists those of all arrangements.
        parameters: parameter set file, or None; `prefix` goes before its names.
        values: further parameter values.
        system: system of its own instead of the load case's, or None.
    """

    name: str
    description: str
    components: tuple[str, ...] = ()
    optional: tuple[str, ...] = ()
    parameters: Path | None = None
    prefix: str = ""
    values: Mapping[str, Number] = field(default_factory=dict)
    system: Path | None = None


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
    """Read a load case by its name, or from the path of a TOML file.

    Raises:
        CosimError: no such case, or the file is malformed.
    """
    shipped = shipped_cases()
    path = shipped.get(name.lower()) or Path(name)
    if not path.is_file():
        raise CosimError(f"no load case '{name}'{nearest(name, shipped)} ('fowt list' shows all; or give a .toml file)")
    table = _toml(path)
    with _Reader(table, path, "") as top:
        run, wind = top.table("run"), top.table("wind")
        with _Reader(run, path, "run.") as r:
            stop, step = r.take("stop", float), r.take("step", float, 0.0125)
            transient, record_every = r.take("transient", float, 0.0), r.take("record_every", int, 4)
        box = None
        if wind:
            with _Reader(wind, path, "wind.") as w:
                box = Wind(w.take("parameter", str), w.take("mean_speed", float), w.take("turbulence_class", str, "B"))
        dampers = read_dampers(path.parent / top.take("dampers", str, _dampers_of(table)))
        if not (stop > 0.0 and step > 0.0 and 0.0 <= transient < stop and record_every >= 1):
            raise CosimError(f"{path}: [run] needs stop > transient >= 0, step > 0 and record_every >= 1")
        return LoadCase(
            file=path,
            description=top.take("description", str),
            system=path.parent / top.take("system", str),
            channels=path.parent / top.take("channels", str),
            dampers=dampers,
            damper=top.take("damper", str, "none"),
            without=tuple(top.take("without", list, [])),
            stop=stop,
            step=step,
            transient=transient,
            record_every=record_every,
            seed=top.take("seed", int, 1),
            seed_parameters=tuple(top.take("seed_parameters", list, [])),
            wind=box,
            parameters=top.table("parameters"),
        )


def read_dampers(path: Path) -> dict[str, Damper]:
    """Damper arrangements of a TOML file, by name.

    Raises:
        CosimError: the file is missing or malformed.
    """
    tables = _toml(path)
    optional = tuple(dict.fromkeys(c for t in tables.values() for c in t.get("components", [])))
    dampers = {}
    for name, table in tables.items():
        with _Reader(table, path, f"{name}.") as r:
            file, own = r.take("parameters", str, ""), r.take("system", str, "")
            dampers[name] = Damper(
                name=name,
                description=r.take("description", str, ""),
                components=tuple(r.take("components", list, [])),
                optional=optional,
                parameters=path.parent / file if file else None,
                prefix=r.take("prefix", str, ""),
                values=r.table("values"),
                system=path.parent / own if own else None,
            )
    return dampers


def with_damper(system: System, damper: Damper) -> System:
    """The system with one damper arrangement: its components kept, those of the others dropped, its values set."""
    present = {c.name for c in system.components}
    for name in damper.components:
        system.component(name)  # a misspelt one must not pass for an arrangement without it
    system = without(system, *(c for c in damper.optional if c in present and c not in damper.components))
    if damper.parameters is not None:
        system = with_parameters(system, qualified(read_parameters(damper.parameters), damper, system))
    return with_parameters(system, damper.values)


def qualified(values: Mapping[str, StartValue], damper: Damper, system: System) -> dict[str, StartValue]:
    """A tuned set for one arrangement: prefixed where no component is named, less the dampers that are left out."""
    names = tuple(f"{c.name}." for c in system.components)
    left_out = tuple(f"{c}." for c in damper.optional if f"{c}." not in names)
    kept = {n: v for n, v in values.items() if not n.startswith(left_out)}
    return {n if n.startswith(names) else damper.prefix + n: v for n, v in kept.items()}


def _dampers_of(table: Mapping[str, Any]) -> str:
    simplified = str(table.get("system", "")).startswith("simplified")
    return "dampers-simplified.toml" if simplified else "dampers.toml"


def _toml(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise CosimError(f"{path}: cannot be read ({error})") from error


class _Reader:
    """Takes typed keys out of a TOML table; leaving it complains about keys that nobody took."""

    def __init__(self, table: Mapping[str, Any], path: Path, prefix: str) -> None:
        self._table, self._path, self._prefix = dict(table), path, prefix
        self._taken: list[str] = []

    def __enter__(self) -> _Reader:
        return self

    def __exit__(self, kind: object, *details: object) -> None:
        left = [k for k in self._table if k not in self._taken]
        if kind is None and left:
            raise CosimError(f"{self._path}: unknown key '{self._prefix}{left[0]}'{nearest(left[0], self._taken)}")

    def take(self, key: str, kind: type, default: Any = None) -> Any:
        self._taken.append(key)
        value = self._table.get(key, default)
        if value is None:
            raise CosimError(f"{self._path}: '{self._prefix}{key}' is missing; add it")
        if kind is float and isinstance(value, int) and not isinstance(value, bool):
            value = float(value)
        if not isinstance(value, kind) or (kind is int and isinstance(value, bool)):
            raise CosimError(f"{self._path}: '{self._prefix}{key}' = {value!r} should be a {kind.__name__}")
        return value

    def table(self, key: str) -> dict[str, Any]:
        self._taken.append(key)
        value = self._table.get(key, {})
        if not isinstance(value, dict):
            raise CosimError(f"{self._path}: '{self._prefix}{key}' should be a table")
        return value
