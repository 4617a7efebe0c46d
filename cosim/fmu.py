"""FMUs for co-simulation, of FMI 2.0 and 3.0: what their description says."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import fmpy

from cosim import archive
from cosim.errors import CosimError, nearest
from fmus_src.units import Unit
from fmus_src.units import unit as named_unit

Value = float | int | bool | str
VARYING = ("discrete", "continuous", None)
# FMI 3.0's types by those that they are to the master, which are FMI 2.0's; clocks and binaries it leaves alone
INTEGERS = ("Int8", "UInt8", "Int16", "UInt16", "Int32", "UInt32", "Int64", "UInt64")
KINDS = dict.fromkeys(("Float64", "Float32"), "Real") | dict.fromkeys(INTEGERS, "Integer")
KINDS |= {"Boolean": "Boolean", "String": "String", "Enumeration": "Enumeration"}
MOST_ELEMENTS = 100_000


@dataclass(frozen=True)
class FmuVariable:
    """A scalar variable, or an element of an array; `unit`, also of the bounds, is None where none is declared.

    Attributes:
        reference: the value reference; in FMI 3.0, the number of the element in the FMU (see `FmuArray`).
        type: by FMI 2.0's names.
    """

    name: str
    reference: int
    type: str
    causality: str
    variability: str | None
    initial: str | None
    unit: Unit | None
    start: str | None
    min: float | None
    max: float | None
    nominal: float | None
    description: str


@dataclass(frozen=True)
class FmuArray:
    """A variable of FMI 3.0; its elements, one if it is a scalar, have the numbers `first`, `first` + 1, ...

    Attributes:
        type: FMI 3.0's. shape: () for a scalar; elements go row by row.
        start: of each element; 0 where none is given, and of text.
        intermediate: it can be set within a step.
    """

    reference: int
    type: str
    first: int
    shape: tuple[int, ...]
    start: tuple[float, ...]
    intermediate: bool

    @property
    def size(self) -> int:
        return math.prod(self.shape)


@dataclass(frozen=True)
class Fmu:
    """An FMU file.

    Attributes:
        feedthrough: output -> inputs on which it depends directly (all inputs, where the FMU does not say).
        version: of FMI, "2.0" or "3.0".
        guid: in FMI 3.0 the instantiation token.
        arrays: all variables of FMI 3.0 by elements; empty for FMI 2.0.
        interpolates: inputs may change within a step: the FMU takes their slopes (canInterpolateInputs), or asks for
            them (providesIntermediateUpdate, and intermediateUpdate of each continuous input).
        keeps_state: its state can be saved and restored (canGetAndSetFMUState).
        differentiates: it gives directional derivatives (providesDirectionalDerivatives).
        varies_step: it takes steps of any length (canHandleVariableCommunicationStepSize).
    """

    path: Path
    version: str
    sha256: str
    identifier: str
    binary: str
    guid: str
    generator: str
    variables: Mapping[str, FmuVariable]
    feedthrough: Mapping[str, tuple[str, ...]]
    arrays: tuple[FmuArray, ...]
    interpolates: bool
    keeps_state: bool
    differentiates: bool
    varies_step: bool
    once_per_process: bool

    def variable(self, component: str, name: str) -> FmuVariable:
        """A variable by name.

        Raises:
            CosimError: no such variable.
        """
        if name not in self.variables:
            within = elements(self.variables, name)
            if within:
                file = self.path.name
                raise CosimError(f"{component}: '{name}' is an array in {file}; name an element, as {within[0]}")
            raise CosimError(f"{component}: no variable '{name}' in {self.path.name}{nearest(name, self.variables)}")
        return self.variables[name]

    def array_of(self, name: str) -> tuple[str, FmuArray] | None:
        """Name of the array and the array of which the variable of that name is an element; None if it is of none."""
        reference = self.variables[name].reference
        found = next((a for a in self.arrays if 0 <= reference - a.first < a.size), None)
        if found is None or not found.shape:
            return None
        opening, close = name.rindex("["), ")" if name.endswith(")") else ""  # der(x[1])
        return name[:opening] + close, found


def elements(names: Iterable[str], array: str) -> list[str]:
    """Those of the names that are elements of an array, by their indices: `x[2]`, `x[10]`; `x[1,2]` row by row."""
    indices = {n: n[len(array) + 1 : -1] for n in names if n.startswith(f"{array}[")}
    found = {n: [int(i) for i in text.split(",")] for n, text in indices.items() if re.fullmatch(r"\d+(, *\d+)*", text)}
    return sorted(found, key=found.__getitem__)


def read_fmu(path: Path) -> Fmu:
    """Read an FMU's description.

    Raises:
        CosimError: not a readable co-simulation FMU of FMI 2.0 or 3.0 with a binary for this platform.
    """
    try:
        stat = path.stat()
    except OSError as error:
        raise CosimError(f"FMU {path}: {error.strerror}; build it or name its folder") from error
    return _read(path, stat.st_mtime_ns, stat.st_size)


def read_description(path: Path, *, validate: bool = True) -> Any:
    """FMPy's model description of an FMU, its archive and XML looked through before FMPy reads them.

    Args:
        validate: whether a description against the schema is refused.

    Raises:
        CosimError: not a readable FMU.
    """
    try:
        archive.parse_xml(archive.read_entry(path, "modelDescription.xml"), "modelDescription.xml")
        return fmpy.read_model_description(str(path), validate=validate)
    except Exception as error:  # fmpy and lxml raise many kinds
        reason = " ".join(str(error).removeprefix(f"{path}: ").split())[:300]
        raise CosimError(f"FMU {path}: cannot be read ({reason}); build it again") from error


@lru_cache(maxsize=64)
def _read(path: Path, modified: int, size: int) -> Fmu:
    md = read_description(path)
    try:
        return _taken_from(path, md, archive.entry_names(path))
    except (KeyError, TypeError, AttributeError, OverflowError) as error:
        raise CosimError(f"FMU {path}: its description contradicts itself ({error!r}); build it again") from error
    except ValueError as error:
        if isinstance(error, CosimError):
            raise
        raise CosimError(f"FMU {path}: has a value that is none ({error}); build it again") from error


def _taken_from(path: Path, md: Any, files: Collection[str]) -> Fmu:
    if md.fmiVersion not in ("2.0", "3.0") or md.coSimulation is None:
        kind = "model exchange" if md.coSimulation is None else f"FMI {md.fmiVersion}"
        raise CosimError(f"FMU {path}: is {kind}; export it as FMI 2.0 or 3.0 for co-simulation")
    identifier = md.coSimulation.modelIdentifier
    # FMI 2 has no name for 64-bit ARM on Linux: its folder there is that of FMI 3
    folders = dict.fromkeys((fmpy.platform_tuple, fmpy.platform) if md.fmiVersion == "2.0" else (fmpy.platform_tuple,))
    binaries = [f"binaries/{f}/{identifier}{fmpy.sharedLibraryExtension}" for f in folders]
    binary = next((b for b in binaries if b in files), None)
    if binary is None:
        raise CosimError(f"FMU {path}: has no {binaries[-1]}; build it for this platform")
    units = {u.name: _unit(u) for u in md.unitDefinitions}
    common = {
        "path": path, "version": md.fmiVersion, "sha256": archive.sha256(path), "identifier": identifier,
        "binary": binary, "generator": md.generationTool or "",
        "keeps_state": bool(md.coSimulation.canGetAndSetFMUstate),
        "varies_step": bool(md.coSimulation.canHandleVariableCommunicationStepSize),
        "once_per_process": bool(md.coSimulation.canBeInstantiatedOnlyOncePerProcess),
    }  # fmt: skip
    if md.fmiVersion == "3.0":
        return Fmu(**common, guid=md.instantiationToken, **_of_version_3(path, md, units))
    variables = {v.name: _variable(v, units, v.name, v.valueReference, v.start) for v in md.modelVariables}
    return Fmu(
        **common,
        guid=md.guid,
        variables=variables,
        feedthrough=_feedthrough(md, variables, {id(v): [v.name] for v in md.modelVariables}),
        arrays=(),
        interpolates=bool(md.coSimulation.canInterpolateInputs),
        differentiates=bool(md.coSimulation.providesDirectionalDerivative),
    )


def _feedthrough(
    md: Any, variables: Mapping[str, FmuVariable], names: Mapping[int, list[str]]
) -> dict[str, tuple[str, ...]]:
    """Inputs on which each output depends; `names` has the scalars of a variable of FMPy's, by its identity."""
    inputs = tuple(n for n, v in variables.items() if v.causality == "input")
    feedthrough = {n: inputs for n, v in variables.items() if v.causality == "output"}
    for unknown in md.outputs:
        if unknown.dependencies is not None:
            known = [n for d in unknown.dependencies for n in names.get(id(d), ())]
            depends = tuple(n for n in known if variables[n].causality == "input")
            feedthrough |= dict.fromkeys(names.get(id(unknown.variable), ()), depends)
    return feedthrough


def _of_version_3(path: Path, md: Any, units: Mapping[str, Unit]) -> dict[str, Any]:
    """What FMI 3.0 says in its own way, some of which FMPy does not read."""
    root = archive.parse_xml(archive.read_entry(path, "modelDescription.xml"), "modelDescription.xml")
    asked = {int(e.get("valueReference")) for e in root.iter() if e.get("intermediateUpdate") in ("true", "1")}
    for v, e in zip(md.modelVariables, (e for e in root.find("ModelVariables") if e.get("name")), strict=False):
        if v.type.startswith("UInt"):  # of which FMPy reads no bounds
            v.min, v.max = e.get("min"), e.get("max")
    interface = root.find("CoSimulation")
    arrays, variables, names = dict[int, FmuArray](), dict[str, FmuVariable](), dict[int, list[str]]()
    count = 0
    for v in md.modelVariables:
        if v.type not in KINDS or (v.type == "String" and v.shape):
            continue
        if v.valueReference not in arrays:
            size = math.prod(v.shape)
            given = len(v.start.split()) if v.start is not None and v.type != "String" else 1
            if size and given not in (1, size):
                raise CosimError(f"FMU {path}: {v.name} has {given} start values for {size} elements; build it again")
            if count + size > MOST_ELEMENTS:
                raise CosimError(f"FMU {path}: {v.name}: more than {MOST_ELEMENTS} elements with it; use less")
            numbers = (0.0,) if v.type == "String" else tuple(_number(text) for text in _starts(v, size))
            arrays[v.valueReference] = FmuArray(
                v.valueReference, v.type, count, v.shape, numbers, v.valueReference in asked
            )
            count += size
        array = arrays[v.valueReference]
        found = {
            n: _variable(v, units, n, array.first + i, text)
            for i, (n, text) in enumerate(zip(_element_names(v), _starts(v, array.size), strict=True))
        }
        twice = variables.keys() & found
        if twice:
            raise CosimError(f"FMU {path}: two variables are called {min(twice)}; give each its own name")
        variables |= found
        names.setdefault(id(v.alias or v), []).extend(found)
    real = [v for v in md.modelVariables if KINDS.get(v.type) == "Real" and v.causality in ("input", "output")]
    moving = [v for v in real if v.causality == "input" and v.variability == "continuous"]
    return {
        "variables": variables,
        "feedthrough": _feedthrough(md, variables, names),
        "arrays": tuple(arrays.values()),
        "interpolates": interface.get("providesIntermediateUpdate") in ("true", "1")
        and all(arrays[v.valueReference].intermediate for v in moving),
        "differentiates": interface.get("providesDirectionalDerivatives") in ("true", "1")
        and all(v.type == "Float64" for v in real),
    }


def _element_names(v: Any) -> Iterator[str]:
    """`x`, or `x[1]` and `x[1,2]` row by row; of a derivative, `der(x[1])`."""
    inner, close = (v.name[:-1], ")") if v.name.startswith("der(") and v.name.endswith(")") else (v.name, "")
    for index in itertools.product(*(range(1, n + 1) for n in v.shape)):
        yield f"{inner}[{','.join(map(str, index))}]{close}" if index else v.name


def _starts(v: Any, size: int) -> list[str | None]:
    """Start value of each element: one for each, or one for all."""
    texts = [v.start] if v.type == "String" or v.start is None else v.start.split()
    return texts if len(texts) == size else [*texts, None][:1] * size


def _number(text: str | None) -> float:
    return float(text == "true") if text in ("true", "false") else float(text or 0)


def _unit(definition: Any) -> Unit:
    """The FMU's own definition of a unit; a name without base unit is resolved as usual, or stands for itself."""
    base = definition.baseUnit
    if base is not None:
        exponents = {b: int(getattr(base, b)) for b in ("kg", "m", "s", "A", "K", "mol", "cd", "rad")}
        kept = tuple(sorted((b, e) for b, e in exponents.items() if e))
        return Unit(definition.name, float(base.factor), float(base.offset), kept)
    try:
        return named_unit(definition.name)
    except ValueError:
        return Unit(definition.name, 1.0, 0.0, ((definition.name, 1),))


def _variable(v: Any, units: Mapping[str, Unit], name: str, reference: int, start: str | None) -> FmuVariable:
    def attribute(name: str) -> Any:
        own = getattr(v, name)
        return own if own is not None or v.declaredType is None else getattr(v.declaredType, name)

    def number(name: str) -> float | None:
        text = attribute(name)
        return None if text is None else float(text)

    kind = KINDS.get(v.type, v.type)
    unit = attribute("unit") if kind == "Real" else None
    return FmuVariable(
        name, reference, kind, v.causality or "local", v.variability, v.initial,
        units.get(unit or ""), start, number("min"), number("max"), number("nominal"), v.description or "",
    )  # fmt: skip
