"""Parameter sets (.ssv), parameter mappings (.ssm) and the bindings that apply them, of SSP 1.0 and 2.0."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from lxml import etree

from cosim.archive import parse_xml
from cosim.errors import CosimError
from cosim.fmu import Value
from cosim.system import StartValue
from fmus_src.units import Unit
from fmus_src.units import unit as named_unit

REALS = ("Real", "Float64", "Float32")
KINDS = {
    "ParameterSet": "application/x-ssp-parameter-set", "ParameterMapping": "application/x-ssp-parameter-mapping",
}  # fmt: skip
INTEGERS = ("Integer", *(f"{sign}Int{bits}" for sign in ("", "U") for bits in (8, 16, 32, 64)))


@dataclass(frozen=True)
class Origin:
    """The file that something is read from; what it names is relative to its folder.

    Attributes:
        root: folder of an unpacked package, which nothing may lead out of; None for files of the user's own.
    """

    file: Path
    root: Path | None = None

    def locate(self, source: str) -> Path:
        """The file that a source names, which is a URI: %20 stands for a blank.

        Raises:
            CosimError: it is no relative path, or leads out of the package.
        """
        scheme, path = source.partition(":")[0] if ":" in source else "", self.file.parent / unquote(source)
        try:
            path.resolve()
            path.is_file()
        except (OSError, ValueError):  # too long, or with a zero byte
            scheme = "none"
        if len(scheme) > 1:
            raise CosimError(f"{self.file}: source '{source}' is no path relative to the file; put it beside it")
        return self._within(path, f"source '{source}'")

    def beside(self, text: str) -> Path | None:
        """The file that a plain text names, as it stands; None if there is none.

        Raises:
            CosimError: there is one, but out of the package.
        """
        path = self.file.parent / text
        try:
            found = bool(text) and path.is_file()
        except (OSError, ValueError):  # too long for a path, or with a zero byte
            found = False
        return self._within(path, f"text '{text}'") if found else None

    def _within(self, path: Path, what: str) -> Path:
        if self.root is not None and not path.resolve().is_relative_to(self.root.resolve()):
            raise CosimError(f"{self.file}: {what} leads out of the package")
        return path

    def other(self, source: str) -> Origin:
        """The same for a file that this one names."""
        return Origin(self.locate(source), self.root)


@dataclass(frozen=True)
class Entry:
    """One entry of a mapping: target = factor * source + offset, after conversion of units if `convert`."""

    source: str
    target: str
    factor: float = 1.0
    offset: float = 0.0
    convert: bool = True


def read_parameters(ssv: Path) -> dict[str, StartValue]:
    """Start values of a parameter set file, by name.

    Raises:
        CosimError: the file is missing or no parameter set.
    """
    return _parameter_set(parse(Origin(ssv), "ParameterSet"), Origin(ssv))


def read_mapping(ssm: Path) -> tuple[Entry, ...]:
    """Entries of a parameter mapping file.

    Raises:
        CosimError: the file is missing or no parameter mapping.
    """
    return _mapping(parse(Origin(ssm), "ParameterMapping"), Origin(ssm))


def bindings(element: Any, origin: Origin) -> Iterator[tuple[dict[str, StartValue], tuple[str, ...]]]:
    """Values of each parameter binding of an element by name, mapped, and the names that a mapping left out.

    Raises:
        CosimError: a binding is incomplete, or names a file that cannot be read.
    """
    for binding in children(element.find("{*}ParameterBindings")):
        if binding.get("sourceBase", "SSD") != "SSD":
            raise CosimError(
                f"{origin.file}: sourceBase='component' is not supported; put the parameter set beside the .ssd"
            )
        place, found = _content(binding, origin, "ParameterValues", "ParameterSet", "a ParameterBinding")
        prefix = binding.get("prefix", "")  # comes before the mapping (SSP 1.0, ParameterBinding)
        values = {prefix + name: value for name, value in _parameter_set(found, place).items()}
        left: tuple[str, ...] = ()
        mapping = binding.find("{*}ParameterMapping")
        if mapping is not None:
            if mapping.get("sourceBase", "SSD") != "SSD":
                raise CosimError(
                    f"{origin.file}: sourceBase='component' is not supported; put the mapping beside the .ssd"
                )
            place, found = _content(mapping, origin, "", "ParameterMapping", "a ParameterMapping")
            values, left = _mapped(values, _mapping(found, place), place)
        yield values, left


def _content(element: Any, origin: Origin, wrapper: str, tag: str, what: str) -> tuple[Origin, Any]:
    """The root element that `source` names, or that stands inside."""
    source, kind = element.get("source"), element.get("type", KINDS[tag])
    inline = element.find(f"{{*}}{wrapper}/{{*}}{tag}" if wrapper else f"{{*}}{tag}")
    if kind != KINDS[tag]:
        raise CosimError(f"{origin.file}: {what} is of the type {kind}; only {KINDS[tag]} is supported")
    if source is not None:
        if inline is not None:
            raise CosimError(f"{origin.file}: {what} has both the source '{source}' and {tag}; keep one")
        place = origin.other(source)
        return place, parse(place, tag)
    if inline is None:
        raise CosimError(f"{origin.file}: {what} has neither source nor {wrapper or tag}")
    return origin, inline


def _mapping(element: Any, origin: Origin) -> tuple[Entry, ...]:
    entries, targets = [], set()
    for item in children(element):
        if tag_of(item) != "MappingEntry":
            continue
        source, target = item.get("source"), item.get("target")
        if not (source and target):
            raise CosimError(f"{origin.file}: a MappingEntry needs source and target")
        if target in targets:
            raise CosimError(f"{origin.file}: two entries have the target '{target}'; keep one")
        targets.add(target)
        factor, offset = transformation(item, f"{origin.file}: {source}")
        entries.append(Entry(source, target, factor, offset, not true(item.get("suppressUnitConversion"))))
    return tuple(entries)


def _mapped(
    values: Mapping[str, StartValue], entries: tuple[Entry, ...], origin: Origin
) -> tuple[dict[str, StartValue], tuple[str, ...]]:
    """Values under their new names; of a set with a mapping, only what the mapping names is applied."""
    mapped: dict[str, StartValue] = {}
    for e in entries:
        if e.source not in values:
            continue
        given = values[e.source]
        if (e.factor, e.offset) != (1.0, 0.0):
            if isinstance(given.value, (str, bool)):
                raise CosimError(f"{origin.file}: {e.source} is no number and cannot be transformed")
            unit = given.unit if e.convert else None
            mapped[e.target] = StartValue(given.value, unit, e.factor, e.offset)
        else:
            mapped[e.target] = given if e.convert else StartValue(given.value)
    used = {e.source for e in entries}
    return mapped, tuple(n for n in values if n not in used)


def transformation(element: Any, where: str) -> tuple[float, float]:
    """Factor and offset of an element's LinearTransformation.

    Raises:
        CosimError: it has another transformation, or one with values that are no numbers.
    """
    factor, offset = 1.0, 0.0
    found = [child for child in children(element) if tag_of(child).endswith("Transformation")]
    if len(found) > 1:
        raise CosimError(f"{where}: has {len(found)} transformations; keep one")
    for child in found:
        if tag_of(child) == "LinearTransformation":
            try:
                factor, offset = float(child.get("factor", 1.0)), float(child.get("offset", 0.0))
            except ValueError as error:
                raise CosimError(f"{where}: LinearTransformation: {error}") from error
            if not (math.isfinite(factor) and math.isfinite(offset)):
                raise CosimError(f"{where}: LinearTransformation: factor {factor:g}, offset {offset:g} are not finite")
        else:
            raise CosimError(f"{where}: {tag_of(child)} is not supported; only LinearTransformation is")
    return factor, offset


def units_of(element: Any, file: Path) -> dict[str, Unit]:
    """Units that a file defines, by name.

    Raises:
        CosimError: one has no base unit, or one of values that are no numbers.
    """
    return {u.get("name"): _unit(u, file) for u in element.iterfind("{*}Units/{*}Unit")}


def parse(origin: Origin, expected: str) -> Any:
    """Root element of an XML file.

    Raises:
        CosimError: it is missing, no XML, declares a document type, or is something else.
    """
    file = origin.file
    try:
        content = file.read_bytes()
    except (OSError, ValueError) as error:
        reason = "no such file" if isinstance(error, FileNotFoundError) else getattr(error, "strerror", None) or error
        raise CosimError(f"{file}: cannot be read ({reason})") from error
    root = parse_xml(content, str(file))
    if tag_of(root) != expected:
        raise CosimError(f"{file}: is a {tag_of(root)}, not a {expected}")
    return root


def children(element: Any) -> list[Any]:
    """Child elements; none of None."""
    return [] if element is None else [e for e in element if isinstance(e.tag, str)]


def tag_of(element: Any) -> str:
    """Name of an element without its namespace."""
    return str(etree.QName(element).localname)


def true(text: str | None) -> bool:
    """Whether an XML boolean is set."""
    return text in ("true", "1")


def _parameter_set(element: Any, origin: Origin) -> dict[str, StartValue]:
    file = origin.file
    units = units_of(element, file)
    values: dict[str, StartValue] = {}
    for parameter in element.iterfind("{*}Parameters/{*}Parameter"):
        name, typed = (
            parameter.get("name"),
            [c for c in children(parameter) if tag_of(c) not in ("Dimension", "Annotations")],
        )
        if not name or not typed:
            raise CosimError(f"{file}: parameter '{name or '?'}' has no {'value' if name else 'name'}")
        if name in values:
            raise CosimError(f"{file}: parameter '{name}' appears twice; keep one")
        text, unit = typed[0].get("value", ""), typed[0].get("unit")
        if not text and tag_of(typed[0]) == "String" and len(typed[0]) == 1:  # SSP 2.0
            text = typed[0][0].get("value", "")
        try:
            resolved = None if unit is None else units.get(unit) or named_unit(unit)
            found = {
                n: StartValue(_value(typed[0], t, element, origin), resolved) for n, t in _elements(parameter, text)
            }
        except ValueError as error:
            if isinstance(error, CosimError):
                raise
            raise CosimError(f"{file}: parameter '{name}' = '{text[:80]}': {error}") from error
        values |= found
    return values


def _elements(parameter: Any, text: str) -> list[tuple[str, str]]:
    """Name and text of a parameter's value, or of each element of an array (SSP 2.0), row by row."""
    name, sizes = parameter.get("name"), [d.get("size") for d in parameter.iterfind("{*}Dimension")]
    if not sizes:
        return [(name, text)]
    texts, shape = text.split(), [int(n or 0) for n in sizes]
    if len(texts) != math.prod(shape) or not texts:
        raise ValueError(f"{len(texts)} values for an array of {' x '.join(map(str, shape))} elements")
    indices = itertools.product(*(range(1, n + 1) for n in shape))
    return [(f"{name}[{','.join(map(str, i))}]", t) for i, t in zip(indices, texts, strict=True)]


def _value(typed: Any, text: str, parameters: Any, origin: Origin) -> Value:
    """A parameter's value; a String that names a file beside the parameter set becomes its full path."""
    kind = tag_of(typed)
    if kind in (*REALS, *INTEGERS) and len(text.split()) > 1:
        raise ValueError("several values without a Dimension")
    if kind in REALS:
        return float(text)
    if kind in INTEGERS:
        return int(text)
    if kind == "Boolean" and text in ("true", "false", "1", "0"):
        return true(text)
    if kind == "Enumeration":
        kinds = parameters.iterfind("{*}Enumerations/{*}Enumeration")
        own = [k for k in kinds if k.get("name") == typed.get("name")]
        named = {i.get("name"): i.get("value", "") for k in own for i in k.iterfind("{*}Item")}
        value = named.get(text, text)
        if not re.fullmatch(r"[+-]?\d{1,18}", value):
            raise ValueError("is neither a number nor an item of an enumeration in this file")
        return int(value)
    if kind == "String":
        file = origin.beside(text)
        return text if file is None else str(file.resolve())
    raise ValueError(f"is no {kind} value that can be set here")


def _unit(element: Any, file: Path) -> Unit:
    base = element.find("{*}BaseUnit")
    name = element.get("name")
    if base is None:
        raise CosimError(f"{file}: unit '{name}' has no BaseUnit")
    try:
        exponents = {b: int(base.get(b, 0)) for b in ("kg", "m", "s", "A", "K", "mol", "cd", "rad")}
        kept = tuple(sorted((b, e) for b, e in exponents.items() if e))
        factor, offset = float(base.get("factor", 1.0)), float(base.get("offset", 0.0))
    except ValueError as error:
        raise CosimError(f"{file}: unit '{name}': {error}") from error
    if not (math.isfinite(factor) and math.isfinite(offset) and factor):
        raise CosimError(f"{file}: unit '{name}': factor {factor:g} and offset {offset:g} convert nothing")
    return Unit(name, factor, offset, kept)
