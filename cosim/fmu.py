"""FMI 2.0 co-simulation FMUs: what their description says, and running instances of them."""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Collection, Mapping
from ctypes import c_char_p, c_double, c_int, c_size_t, c_uint, c_void_p
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import fmpy

from cosim import archive, kernel
from cosim.errors import CosimError, RunFailed, nearest
from fmus_src.units import Unit
from fmus_src.units import unit as named_unit

Value = float | int | bool | str
VARYING = ("discrete", "continuous", None)
_C_TYPES: dict[str, Any] = {"Real": c_double, "Integer": c_int, "Boolean": c_int, "String": c_char_p}


@dataclass(frozen=True)
class FmuVariable:
    """A scalar variable; `unit` is None where the FMU declares none; bounds and nominal in that unit."""

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
class Fmu:
    """An FMU file.

    Attributes:
        feedthrough: output -> inputs on which it depends directly (all inputs, where the FMU does not say).
        interpolates: the FMU takes slopes of its inputs (canInterpolateInputs).
        keeps_state: its state can be saved and restored (canGetAndSetFMUstate).
        differentiates: it gives directional derivatives (providesDirectionalDerivative).
        varies_step: it takes steps of any length (canHandleVariableCommunicationStepSize).
    """

    path: Path
    sha256: str
    identifier: str
    binary: str
    guid: str
    generator: str
    variables: Mapping[str, FmuVariable]
    feedthrough: Mapping[str, tuple[str, ...]]
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
            raise CosimError(f"{component}: no variable '{name}' in {self.path.name}{nearest(name, self.variables)}")
        return self.variables[name]


def read_fmu(path: Path) -> Fmu:
    """Read an FMU's description.

    Raises:
        CosimError: not a readable FMI 2.0 co-simulation FMU with a binary for this platform.
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
    if md.fmiVersion != "2.0" or md.coSimulation is None:
        kind = "model exchange" if md.coSimulation is None else f"FMI {md.fmiVersion}"
        raise CosimError(f"FMU {path}: is {kind}; export it as FMI 2.0 for co-simulation")
    identifier = md.coSimulation.modelIdentifier
    # FMI 2 has no name for 64-bit ARM on Linux: its folder there is that of FMI 3
    folders = dict.fromkeys((fmpy.platform_tuple, fmpy.platform))
    binaries = [f"binaries/{f}/{identifier}{fmpy.sharedLibraryExtension}" for f in folders]
    binary = next((b for b in binaries if b in files), None)
    if binary is None:
        raise CosimError(f"FMU {path}: has no {binaries[-1]}; build it for this platform")
    units = {u.name: _unit(u) for u in md.unitDefinitions}
    variables = {v.name: _variable(v, units) for v in md.modelVariables}
    inputs = tuple(n for n, v in variables.items() if v.causality == "input")
    feedthrough = {n: inputs for n, v in variables.items() if v.causality == "output"}
    for unknown in md.outputs:
        if unknown.dependencies is not None:
            names = (d.name for d in unknown.dependencies)
            feedthrough[unknown.variable.name] = tuple(n for n in names if variables[n].causality == "input")
    return Fmu(
        path=path,
        sha256=archive.sha256(path),
        identifier=identifier,
        binary=binary,
        guid=md.guid,
        generator=md.generationTool or "",
        variables=variables,
        feedthrough=feedthrough,
        interpolates=bool(md.coSimulation.canInterpolateInputs),
        keeps_state=bool(md.coSimulation.canGetAndSetFMUstate),
        differentiates=bool(md.coSimulation.providesDirectionalDerivative),
        varies_step=bool(md.coSimulation.canHandleVariableCommunicationStepSize),
        once_per_process=bool(md.coSimulation.canBeInstantiatedOnlyOncePerProcess),
    )


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


def _variable(v: Any, units: Mapping[str, Unit]) -> FmuVariable:
    def attribute(name: str) -> Any:
        own = getattr(v, name)
        return own if own is not None or v.declaredType is None else getattr(v.declaredType, name)

    def number(name: str) -> float | None:
        text = attribute(name)
        return None if text is None else float(text)

    unit = attribute("unit") if v.type == "Real" else None
    return FmuVariable(
        v.name, v.valueReference, v.type, v.causality or "local", v.variability, v.initial,
        units.get(unit or ""), v.start, number("min"), number("max"), number("nominal"), v.description or "",
    )  # fmt: skip


class Instance:
    """An instantiated FMU. Every failure raises `RunFailed` with the FMU's own message."""

    def __init__(self, name: str, fmu: Fmu, folder: Path, start: float, log: kernel.Log | None = None) -> None:
        """Load the binary from the unpacked FMU in `folder`, instantiate, and set up the experiment.

        Args:
            log: where to keep the FMU's messages; here by default.
        """
        self.name = name
        self.fmu = fmu
        self.log = log or kernel.Log()
        self._callbacks = (c_void_p * 5)()  # fmi2CallbackFunctions
        kernel.library().fill_callbacks(self._callbacks, ctypes.byref(self.log))
        self._instance = c_void_p()
        try:
            # on Windows, libraries that the FMU brings are to be found beside its own
            options: dict[str, Any] = {"winmode": 8} if sys.platform == "win32" else {}
            self._dll = ctypes.CDLL(str((folder / fmu.binary).resolve()), **options)
            self._dll.fmi2Instantiate.restype = c_void_p
        except (OSError, AttributeError) as error:
            raise RunFailed(f"{name}: {fmu.path.name} cannot be loaded: {error}") from error
        resources = (folder / "resources").resolve().as_uri()
        texts = [c_char_p(t.encode()) for t in (name, fmu.guid, resources)]
        self._instance.value = self._dll.fmi2Instantiate(
            texts[0], c_int(1), texts[1], texts[2], ctypes.byref(self._callbacks), c_int(0), c_int(1)
        )
        if not self._instance:
            fmpy.freeLibrary(self._dll._handle)
            raise RunFailed(f"{name}: {fmu.path.name} cannot be instantiated{self.message()}")
        self._call("fmi2SetupExperiment", c_int(0), c_double(0.0), c_double(start), c_int(0), c_double(0.0))

    def set(self, values: Mapping[str, Value]) -> None:
        """Set start values, in the FMU's own units."""
        for name, value in values.items():
            variable = self.fmu.variables[name]
            kind = "Integer" if variable.type == "Enumeration" else variable.type
            plain = value.encode() if isinstance(value, str) else value
            array = (_C_TYPES[kind] * 1)(plain)
            reference = (c_uint * 1)(variable.reference)
            self._call(f"fmi2Set{kind}", reference, c_size_t(1), array, what=f"{name} = {value}: ")

    def enter_initialisation(self) -> None:
        """Start initialisation mode."""
        self._call("fmi2EnterInitializationMode")

    def exit_initialisation(self) -> None:
        """Leave initialisation mode: the FMU is ready to step."""
        self._call("fmi2ExitInitializationMode")

    def message(self) -> str:
        """ ": " and the FMU's last message, errors before warnings; or nothing."""
        lines = self.log.lines()
        errors = [text for status, text in lines if status > kernel.WARNING]
        chosen = errors[-1:] or [text for _, text in lines][-1:]
        return f": {chosen[0]}" if chosen else ""

    def member(self) -> dict[str, int | None]:
        """Addresses that the kernel calls: of the instance, and of the FMI functions by the kernel's names."""
        addresses: dict[str, int | None] = {"instance": self._instance.value}
        states = dict.fromkeys(("get_state", "set_state", "free_state"), self.fmu.keeps_state)
        offered = {"set_slopes": self.fmu.interpolates, "directional": self.fmu.differentiates, **states}
        for short, function in kernel.FUNCTIONS.items():
            if not offered.get(short, True):
                addresses[short] = None
                continue
            try:
                addresses[short] = ctypes.cast(getattr(self._dll, function), c_void_p).value
            except AttributeError as error:
                raise RunFailed(f"{self.name}: {self.fmu.path.name} lacks the function {function}") from error
        return addresses

    def failure(self, call: str, status: int, time: float) -> str:
        """The line that a run ends with when `call` returned a failing status in the step from `time`, s."""
        return (
            f"{self.name}: {call} returned {kernel.status_name(status)}"
            f" at t = {time:.6g} s{self.message() or '; the FMU gave no reason'}"
        )

    def abandon(self) -> None:
        """After fmi2Fatal, FMI allows no further call, not even to free the instance."""
        self._instance.value = None

    def free(self, terminate: bool) -> None:
        """Terminate (after a run without error) and free; does nothing the second time."""
        if not self._instance:
            return
        if terminate:
            self._dll.fmi2Terminate(self._instance)  # the results are complete: its status changes nothing
        self._dll.fmi2FreeInstance(self._instance)
        self._instance.value = None
        fmpy.freeLibrary(self._dll._handle)

    def _call(self, function: str, *arguments: Any, what: str = "") -> None:
        status = getattr(self._dll, function)(self._instance, *arguments)
        if status in (0, kernel.WARNING):
            return
        if status == kernel.FATAL:
            self.abandon()
        raise RunFailed(f"{self.name}: {what}{function} returned {kernel.status_name(status)}{self.message()}")
