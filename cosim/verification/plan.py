"""What is compared with what: `verification.toml`, shipped in `cases/`, and another one that results may have."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, Literal, get_args

from cosim.case import Number
from cosim.errors import CosimError, nearest
from cosim.toml_file import TomlReader, read_toml

FILE = "verification.toml"
Quantity = Literal["mean", "std", "R2", "frequency", "damping ratio", "amplitude", "phase", "suppression"]
LIMITS = ("relative", "absolute", "at_least")
Window = tuple[float, float]


@dataclass(frozen=True)
class Check:
    """One row of the table: a quantity of a channel, and how far it may be off.

    Attributes:
        label: name of the row's quantity, and of its figure where the reference is a list of figures.
        limit, tolerance: "relative" (of the reference), "absolute" (in the quantity's unit) or "at_least" (R2).
        near: of a decay, about where the mode is, Hz; `others`: further modes of the record.
        window: in place of the comparison's, s.
    """

    channel: str
    quantity: Quantity
    label: str
    limit: str
    tolerance: float
    near: float = 0.0
    others: tuple[float, ...] = ()
    window: Window | None = None


@dataclass(frozen=True)
class Curve:
    """The comparison is one point of a curve: `at` on an axis called `axis`."""

    name: str
    axis: str
    at: float


@dataclass(frozen=True)
class Comparison:
    """A run of ours held against one reference.

    Attributes:
        name: folder and stem of the history in the reference's folder.
        table, row: in place of a history, a file of figures and the columns' values that name the row.
        case, damper: our run; parameters: changes in it, `own` those that the comparison itself names.
        files: parameters that name a file in the reference's folder; build: component -> options that name one.
        options: component -> options with which its FMU is built, where the run has it.
        window: time compared, s; the run ends with it.
        undamped: comparison whose standard deviations the suppression refers to.
        wave_period: of a regular wave, s; amplitudes and phases are those against `wave_channel`.
        whole_turns_of: channel of a rotational speed, rpm: the window is cut to whole turns.
    """

    name: str
    case: str
    checks: tuple[Check, ...]
    window: Window
    damper: str | None = None
    table: str | None = None
    row: Mapping[str, Any] = field(default_factory=dict)
    parameters: Mapping[str, Number] = field(default_factory=dict)
    own: tuple[str, ...] = ()
    files: Mapping[str, str] = field(default_factory=dict)
    build: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    options: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    undamped: str | None = None
    wave_period: float | None = None
    wave_channel: str = "Wave1Elev"
    whole_turns_of: str | None = None
    curve: Curve | None = None

    @property
    def group(self) -> str:
        """Folder of the reference."""
        return self.name.rpartition("/")[0]

    @property
    def stem(self) -> str:
        """Name without the folder."""
        return self.name.rpartition("/")[2]

    @property
    def channels(self) -> tuple[str, ...]:
        """Channels compared, each once."""
        return tuple(dict.fromkeys(check.channel for check in self.checks))


def read_plan(shipped: Path, folder: Path | None) -> dict[str, Comparison]:
    """Comparisons by name: those shipped, with what the reference folder's own `verification.toml` adds or replaces.

    Raises:
        CosimError: a file is malformed.
    """
    tables: dict[str, Any] = {"parameters": {}, "options": {}, "checks": {}, "comparison": {}}
    origins: dict[str, Path] = {}
    for path in [shipped / FILE, *([folder / FILE] if folder and (folder / FILE).is_file() else [])]:
        content = read_toml(path)
        with TomlReader(content, path, "") as top:
            for part, known in tables.items():
                given = top.values(part) if part == "parameters" else top.table(part)
                given = _options(given, path, part) if part == "options" else given
                known.update(given)
                origins |= dict.fromkeys(given, path) if part == "comparison" else {}
    return {name: _comparison(name, tables, origins[name]) for name in tables["comparison"]}


def choose(plan: Mapping[str, Comparison], names: Sequence[str]) -> dict[str, Comparison]:
    """Those of which name, folder, stem or a stem's beginning (LC4 of LC4_none) fits a given name; without names all.

    Raises:
        CosimError: a name fits none.
    """
    chosen: set[str] = set()
    for name in names:
        wanted = name.rstrip("/").lower()
        found = {
            c.name for c in plan.values()
            if any(
                fnmatchcase(known.lower(), pattern)
                for known in (c.name, c.group, c.stem, *_curve(c)) for pattern in (wanted, f"{wanted}_*")
            )
        }  # fmt: skip
        if not found:
            known = dict.fromkeys([*(c.group for c in plan.values()), *(c.stem for c in plan.values())])
            raise CosimError(f"nothing to verify is called '{name}'{nearest(name, [k for k in known if k])}")
        chosen |= found
    return {n: c for n, c in plan.items() if n in chosen or not names}


def _curve(comparison: Comparison) -> tuple[str, ...]:
    return (comparison.curve.name,) if comparison.curve else ()


def _comparison(name: str, tables: Mapping[str, Any], path: Path) -> Comparison:
    table = _inherited(name, tables["comparison"], path)
    with TomlReader(table, path, f"{name}.") as r:
        listed = [c for key in r.take("checks", list) for c in _checks(str(key), tables["checks"], path)]
        channels = [c.channel for c in listed]
        checks = sorted(listed, key=lambda c: channels.index(c.channel))
        window = _window(r.take("window", list), path, name)
        assert window is not None
        curve, own, files = r.table("curve"), r.values("parameters"), r.values("files")
        result = Comparison(
            name=name,
            case=r.take("case", str),
            checks=tuple(checks),
            window=window,
            damper=r.take("damper", str, "") or None,
            table=r.take("table", str, "") or None,
            row=r.table("row"),
            parameters=dict(tables["parameters"]) | own,
            own=(*own, *files),
            files=files,
            build=_options(r.table("build"), path, f"{name}.build"),
            options=tables["options"],
            undamped=r.take("undamped", str, "") or None,
            wave_period=r.take("wave_period", float, 0.0) or None,
            wave_channel=r.take("wave_channel", str, "Wave1Elev"),
            whole_turns_of=r.take("whole_turns_of", str, "") or None,
        )
    if not checks:
        raise CosimError(f"{path}: {name} has no checks; give its lists some, or leave it out")
    if curve:
        with TomlReader(curve, path, f"{name}.curve.") as r:
            result = replace(result, curve=Curve(r.take("name", str), r.take("axis", str), r.take("at", float)))
    for check in checks:
        if check.quantity in ("amplitude", "phase") and result.wave_period is None:
            raise CosimError(f"{path}: {name}: {check.quantity} needs 'wave_period'")
        if check.quantity == "suppression" and result.undamped is None:
            raise CosimError(f"{path}: {name}: suppression needs 'undamped', the comparison without damper")
    return result


def _options(tables: Mapping[str, Any], path: Path, where: str) -> dict[str, dict[str, str]]:
    """Component -> option -> text."""
    for component, given in tables.items():
        if not isinstance(given, dict) or any(isinstance(v, (dict, list)) for v in given.values()):
            raise CosimError(f"{path}: {where}.{component} should be a table of options {{ NAME = VALUE }}")
    return {component: {k: str(v) for k, v in given.items()} for component, given in tables.items()}


def _inherited(name: str, tables: Mapping[str, Any], path: Path) -> dict[str, Any]:
    """A comparison's table on top of the one it is `like`."""
    table = dict(tables[name])
    model = table.pop("like", None)
    if model is None:
        return table
    if model not in tables or "like" in tables[model]:
        hint = nearest(str(model), tables) if model not in tables else "; name one that is like no other"
        raise CosimError(f"{path}: {name} is like '{model}'{hint}")
    return dict(tables[model]) | table


def _checks(key: str, lists: Mapping[str, Any], path: Path) -> list[Check]:
    if key not in lists:
        raise CosimError(f"{path}: no list of checks '{key}'{nearest(key, lists)}")
    found = []
    if not isinstance(lists[key], list) or not all(isinstance(table, dict) for table in lists[key]):
        raise CosimError(f"{path}: checks.{key} should be a list of tables [{{ channels = ..., quantity = ... }}]")
    for table in lists[key]:
        with TomlReader(table, path, f"checks.{key}.") as r:
            quantity, channels = r.take("quantity", str), r.take("channels", list)
            limits = {limit: r.take(limit, float, -1.0) for limit in LIMITS}
            near, others = r.take("near", float, 0.0), tuple(map(float, r.take("others", list, [])))
            label, window = r.take("label", str, quantity), _window(r.take("window", list, []), path, f"checks.{key}")
        given = [(limit, value) for limit, value in limits.items() if value >= 0.0]
        if quantity not in get_args(Quantity):
            raise CosimError(f"{path}: checks.{key}: no quantity '{quantity}'{nearest(quantity, get_args(Quantity))}")
        if len(given) != 1 or (quantity == "R2") != (given[0][0] == "at_least"):
            raise CosimError(f"{path}: checks.{key}: {quantity} needs one tolerance: relative or absolute; R2 at_least")
        if quantity in ("frequency", "damping ratio") and not near > 0.0:
            raise CosimError(f"{path}: checks.{key}: {quantity} needs 'near', about where the mode is, Hz")
        found += [Check(str(c), quantity, label, *given[0], near, others, window) for c in channels]
    return found


def _window(values: Sequence[Any], path: Path, name: str) -> Window | None:
    if not values:
        return None
    try:
        begin, end = map(float, values)
    except (TypeError, ValueError) as error:
        raise CosimError(f"{path}: {name}: a window is [begin, end] in s, not {values}") from error
    if not 0.0 <= begin < end:
        raise CosimError(
            f"{path}: {name}: window {begin:g} to {end:g} s; it must begin at 0 or later and before its end"
        )
    return begin, end
