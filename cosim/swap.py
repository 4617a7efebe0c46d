"""Another FMU in a component's place, whatever it calls its variables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from fnmatch import fnmatchcase
from pathlib import Path

from cosim.errors import CosimError, nearest
from cosim.fmu import Fmu, elements, read_fmu
from cosim.system import ComponentInstance, Connection, Mapped, Port, StartValue, System, with_parameters

NONE = "-"


@dataclass(frozen=True)
class NameRule:
    """What an FMU calls a variable of the system.

    Attributes:
        variable: the system's name, within the component, of a scalar or of an array, whose elements then have the
            indices that the FMU's array has; with `target` "-" it may have wild cards * and ?.
        target: the FMU's name, or "-" if it has no such variable: its connections are left out.
        factor, offset: FMU's value = factor * system's + offset, after conversion of the unit if `convert`.
    """

    variable: str
    target: str
    factor: float = 1.0
    offset: float = 0.0
    convert: bool = True


def with_swapped(system: System, name: str, fmu: Path, rules: Sequence[NameRule] = ()) -> System:
    """The system with another FMU for a component; start values of variables it lacks are left out and noted.

    Units need no rule: connections convert them, and start values given so far keep the unit of the replaced FMU.

    Raises:
        CosimError: no such component, not a usable FMU, or variables that are connected and that it lacks.
    """
    old, new = system.component(name), read_fmu(fmu)
    before = _readable(old.fmu)
    wired = {c.output for c in system.connections if c.source == name}
    wired |= {c.input for c in system.connections if c.target == name}
    mapped, dropped = _resolve(name, rules, new, before, wired | set(old.start))
    _refuse_missing(name, new, sorted(wired - dropped), mapped)
    connections = tuple(
        _renamed(c, name, mapped) for c in system.connections
        if not ((c.source == name and c.output in dropped) or (c.target == name and c.input in dropped))
    )  # fmt: skip
    lost_feeds = {(c.target, c.input) for c in system.connections if c.source == name and c.output in dropped}
    kept = {
        n: _with_unit(v, before, n)
        for n, v in old.start.items()
        if n not in dropped and (n in mapped or n in new.variables)
    }
    lost = sorted(set(old.start) - set(kept) - dropped)
    notes = [f"{name}: {fmu.name} has no {', '.join(lost)}: left out of its start values"] if lost else []
    if lost_feeds:
        without = ", ".join(sorted(f"{t}.{i}" for t, i in lost_feeds))
        notes.append(f"{name}: {fmu.name} gives nothing to {without}: left at their start values")
    swapped = replace(
        system,
        components=tuple(
            ComponentInstance(name, fmu, mapped=mapped) if c.name == name else c for c in system.components
        ),
        connections=connections,
        notes=(*system.notes, *notes),
        open_inputs=system.open_inputs | lost_feeds,
        ports=tuple(_port_renamed(p, name, mapped) for p in system.ports),
    )
    return with_parameters(swapped, {f"{name}.{n}": v for n, v in kept.items()})


def _resolve(
    name: str, rules: Sequence[NameRule], new: Fmu, before: Fmu | None, used: set[str]
) -> tuple[dict[str, Mapped], set[str]]:
    """The FMU's variables by the system's names, and the system's variables that it has not."""
    known = used | (set(before.variables) if before else set())
    units = {n: v.unit for n, v in before.variables.items()} if before else {}
    mapped, dropped = dict[str, Mapped](), set[str]()
    for n, unit in units.items():
        if unit is not None and n in new.variables and new.variables[n].unit is None:
            mapped[n] = Mapped(n, unit=unit, unitless=True)
    for rule in [e for given in rules for e in _by_elements(name, given, known, new)]:
        if rule.target == NONE:
            found = {rule.variable} & known or set(elements(known, rule.variable))
            found = found or {n for n in known if fnmatchcase(n, rule.variable.replace("[", "[[]"))}
        else:
            found = {rule.variable} & known
        if not found:
            raise CosimError(
                f"map {name}.{rule.variable}: the system has no such variable{nearest(rule.variable, known)}"
            )
        if rule.target == NONE:
            dropped |= found
            continue
        if rule.target not in new.variables:
            raise CosimError(
                f"map {name}.{rule.variable}={rule.target}: {new.path.name} has no variable"
                f" '{rule.target}'{nearest(rule.target, new.variables)}"
            )
        unitless = new.variables[rule.target].unit is None
        mapped[rule.variable] = Mapped(
            rule.target, rule.factor, rule.offset, rule.convert, units.get(rule.variable), unitless
        )
    return {n: m for n, m in mapped.items() if n not in dropped}, dropped


def _by_elements(name: str, rule: NameRule, known: set[str], new: Fmu) -> list[NameRule]:
    """A rule for whole arrays as those for their elements."""
    ours, theirs = elements(known, rule.variable), elements(new.variables, rule.target)
    if rule.variable in known or rule.target in new.variables or not (ours and theirs):
        return [rule]
    if len(ours) != len(theirs):
        raise CosimError(
            f"map {name}.{rule.variable}={rule.target}: {len(ours)} elements to {len(theirs)}; map them one by one"
        )
    return [replace(rule, variable=rule.variable + n[len(rule.target) :], target=n) for n in theirs]


def _refuse_missing(name: str, new: Fmu, wired: Sequence[str], mapped: Mapping[str, Mapped]) -> None:
    missing = [v for v in wired if v not in mapped and v not in new.variables]
    if not missing:
        return
    first = next((m for m in missing if get_close_matches(m, new.variables, n=1)), missing[0])
    rest = [repr(m) for m in missing if m != first]
    others = f"; nor {', '.join(rest)}" if rest else ""
    raise CosimError(
        f"{name}: {new.path.name} has no variable '{first}'{nearest(first, new.variables)}{others}; map each with"
        f" --map {name}.{first}=NAME, or with --map {name}.{first}=- if it has none"
    )


def _renamed(c: Connection, name: str, mapped: Mapping[str, Mapped]) -> Connection:
    if c.source == name and c.output in mapped:
        m = mapped[c.output]
        if m.offset or not m.factor:
            raise CosimError(f"map {name}.{c.output}: an output takes a factor only, and not 0")
        c = replace(
            c, output=m.name, factor=c.factor / m.factor, convert_units=c.convert_units and m.convert,
            units=(m.unit, c.units[1]),
        )  # fmt: skip
    if c.target == name and c.input in mapped:
        m = mapped[c.input]
        c = replace(
            c, input=m.name, factor=m.factor * c.factor, offset=m.factor * c.offset + m.offset,
            convert_units=c.convert_units and m.convert, units=(c.units[0], m.unit),
        )  # fmt: skip
    return c


def _port_renamed(port: Port, name: str, mapped: Mapping[str, Mapped]) -> Port:
    if port.component != name:
        return port

    def own(name: str) -> str:
        return mapped[name].name if name in mapped else name

    return replace(port, pairs=tuple((own(e), own(f), own(x)) for e, f, x in port.pairs))


def _with_unit(value: StartValue, before: Fmu | None, variable: str) -> StartValue:
    """A plain start value was in the unit of the FMU that it was meant for."""
    if value.unit is not None or before is None or variable not in before.variables:
        return value
    return replace(value, unit=before.variables[variable].unit)


def _readable(path: Path) -> Fmu | None:
    try:
        return read_fmu(path)
    except CosimError:  # of another platform, say; it is not to run
        return None
