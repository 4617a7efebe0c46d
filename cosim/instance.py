"""Running instances of FMUs, of FMI 2.0 and 3.0."""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Mapping
from ctypes import c_bool, c_char_p, c_double, c_int, c_size_t, c_uint, c_void_p
from pathlib import Path
from typing import Any

import fmpy
import numpy as np

from cosim import kernel
from cosim.errors import RunFailed
from cosim.fmu import Fmu, Value

ADAPTED = {"Enumeration": "Int64"}  # types that have another's functions
_C_TYPES: dict[str, Any] = {"Real": c_double, "Integer": c_int, "Boolean": c_int, "String": c_char_p}


def instantiate(name: str, fmu: Fmu, folder: Path, start: float, log: kernel.Log | None = None) -> Instance:
    """An instance of an FMU of FMI 2.0 or 3.0, unpacked in `folder`; see `Instance`."""
    return (Instance3 if fmu.version == "3.0" else Instance)(name, fmu, folder, start, log)


class Instance:
    """An instantiated FMU, of FMI 2.0. Every failure raises `RunFailed` with the FMU's own message.

    Attributes:
        apart: it runs in a process of its own.
    """

    apart = False

    def __init__(self, name: str, fmu: Fmu, folder: Path, start: float, log: kernel.Log | None = None) -> None:
        """Load the binary from the unpacked FMU in `folder`, instantiate, and set up the experiment.

        Args:
            log: where to keep the FMU's messages; here by default.
        """
        self.name = name
        self.fmu = fmu
        self.log = log or kernel.Log()
        self._instance = c_void_p()
        try:
            # on Windows, libraries that the FMU brings are to be found beside its own
            options: dict[str, Any] = {"winmode": 8} if sys.platform == "win32" else {}
            self._dll = ctypes.CDLL(str((folder / fmu.binary).resolve()), **options)
            self._instance.value = self._instantiated((folder / "resources").resolve())
        except (OSError, AttributeError) as error:
            raise RunFailed(f"{name}: {fmu.path.name} cannot be loaded: {error}") from error
        if not self._instance:
            fmpy.freeLibrary(self._dll._handle)
            raise RunFailed(f"{name}: {fmu.path.name} cannot be instantiated{self.message()}")
        self._set_up(start)

    def _instantiated(self, resources: Path) -> int | None:
        self._callbacks = (c_void_p * 5)()  # fmi2CallbackFunctions
        kernel.library().fill_callbacks(self._callbacks, ctypes.byref(self.log))
        self._dll.fmi2Instantiate.restype = c_void_p
        texts = [c_char_p(t.encode()) for t in (self.name, self.fmu.guid, resources.as_uri())]
        made: int | None = self._dll.fmi2Instantiate(
            texts[0], c_int(1), texts[1], texts[2], ctypes.byref(self._callbacks), c_int(0), c_int(1)
        )
        return made

    def _set_up(self, start: float) -> None:
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
        offered = self._offered()
        for short, function in kernel.FUNCTIONS.items():
            if not offered.get(short, True):
                addresses[short] = None
                continue
            try:
                addresses[short] = ctypes.cast(getattr(self._dll, function), c_void_p).value
            except AttributeError as error:
                raise RunFailed(f"{self.name}: {self.fmu.path.name} lacks the function {function}") from error
        return addresses

    def _offered(self) -> dict[str, bool]:
        """Which of the functions that an FMU need not have this one has."""
        states = dict.fromkeys(("get_state", "set_state", "free_state"), self.fmu.keeps_state)
        return {"set_slopes": self.fmu.interpolates, "directional": self.fmu.differentiates, **states}

    def failure(self, call: str, status: int, time: float) -> str:
        """The line that a run ends with when `call` returned a failing status in the step from `time`, s."""
        event = f"{call} returned {kernel.status_name(status)}"
        reason = self.message() or "; the FMU gave no reason"
        return f"{self.name}: {call_name(event, self.fmu.version)} at t = {time:.6g} s{reason}"

    def abandon(self) -> None:
        """After fmi2Fatal, FMI allows no further call, not even to free the instance."""
        self._instance.value = None

    def free(self, terminate: bool) -> None:
        """Terminate (after a run without error) and free; does nothing the second time."""
        if not self._instance:
            return
        self._end(terminate)
        self._instance.value = None
        fmpy.freeLibrary(self._dll._handle)

    def _end(self, terminate: bool) -> None:
        if terminate:
            self._dll.fmi2Terminate(self._instance)  # the results are complete: its status changes nothing
        self._dll.fmi2FreeInstance(self._instance)

    def _call(self, function: str, *arguments: Any, what: str = "") -> None:
        self._judge(function, getattr(self._dll, function)(self._instance, *arguments), what)

    def _judge(self, function: str, status: int, what: str) -> None:
        if status in (0, kernel.WARNING):
            return
        if status == kernel.FATAL:
            self.abandon()
        event = call_name(f"{function} returned {kernel.status_name(status)}", self.fmu.version)
        raise RunFailed(f"{self.name}: {what}{event}{self.message()}")


class Instance3(Instance):
    """An instantiated FMU of FMI 3.0; the kernel calls it through kernel/adapter.c."""

    def _instantiated(self, resources: Path) -> int | None:
        library = kernel.library()
        self._adapter, self._kept = _adapter(self.fmu, self._dll, self.log)
        inputs = {v.reference for v in self.fmu.variables.values() if v.causality == "input"}
        within = [a.reference for a in self.fmu.arrays if a.intermediate and a.size and a.first in inputs]
        asked = within if self.fmu.interpolates else []
        function = self._dll.fmi3InstantiateCoSimulation
        function.restype = c_void_p
        made: int | None = function(
            c_char_p(self.name.encode()), c_char_p(self.fmu.guid.encode()), c_char_p(f"{resources}{os.sep}".encode()),
            c_bool(False), c_bool(True), c_bool(False), c_bool(False),
            (c_uint * len(asked))(*asked), c_size_t(len(asked)), ctypes.byref(self._adapter),
            library.adapter_log, library.adapter_update if asked else c_void_p(),
        )  # fmt: skip
        self._adapter.fmu = made
        return made

    def _set_up(self, start: float) -> None:
        self._start = start

    def set(self, values: Mapping[str, Value]) -> None:
        """Set start values, in the FMU's own units."""
        for name, value in values.items():
            variable = self.fmu.variables[name]
            what = f"{name} = {value}: "
            if isinstance(value, str):
                number = next(a.reference for a in self.fmu.arrays if a.size and a.first == variable.reference)
                text, one = (c_char_p * 1)(value.encode()), c_size_t(1)
                self._call("fmi3SetString", (c_uint * 1)(number), one, text, one, what=what)
                continue
            element, array = (c_uint * 1)(variable.reference), (c_double * 1)(value)
            status = kernel.library().adapter_set_real(ctypes.byref(self._adapter), element, c_size_t(1), array)
            self._judge(f"fmi3Set of {variable.type}", status, what)

    def enter_initialisation(self) -> None:
        """Start initialisation mode."""
        no = c_bool(False)
        self._call("fmi3EnterInitializationMode", no, c_double(0.0), c_double(self._start), no, c_double(0.0))

    def exit_initialisation(self) -> None:
        """Leave initialisation mode: the FMU is ready to step."""
        self._call("fmi3ExitInitializationMode")

    def member(self) -> dict[str, int | None]:
        """Addresses that the kernel calls: of the adapter, and of its functions by the kernel's names."""
        offered = self._offered() | {"get_integer": False, "set_integer": False}  # they pass as reals
        functions = {
            short: ctypes.cast(getattr(kernel.library(), f"adapter_{short}"), c_void_p).value
            if offered.get(short, True) else None
            for short in kernel.FUNCTIONS
        }  # fmt: skip
        return {"instance": ctypes.addressof(self._adapter), **functions}

    def _end(self, terminate: bool) -> None:
        if terminate:
            self._dll.fmi3Terminate(self._instance)
        self._dll.fmi3FreeInstance(self._instance)


def call_name(text: str, version: str) -> str:
    """A text with functions and statuses of FMI 2.0 by their names in that version."""
    return text.replace("fmi2", "fmi3").replace("FMUstate", "FMUState") if version == "3.0" else text


def _adapter(fmu: Fmu, dll: Any, log: kernel.Log) -> tuple[kernel.AdapterStruct, list[Any]]:
    """What kernel/adapter.c needs for an FMU, and what is to be kept alive with it."""
    n, n_arrays = sum(a.size for a in fmu.arrays), len(fmu.arrays)
    numeric = [kernel.NUMERIC_TYPES.index(ADAPTED.get(a.type, a.type)) if a.type != "String" else 0 for a in fmu.arrays]
    arrays = (kernel.ArrayStruct * n_arrays)(
        *(kernel.ArrayStruct(a.reference, t, a.first, a.size) for a, t in zip(fmu.arrays, numeric, strict=True))
    )
    room = {
        "array_of": np.repeat(np.arange(n_arrays, dtype=np.int32), [a.size for a in fmu.arrays]),
        "values": np.array([x for a in fmu.arrays for x in a.start], dtype=float),
        **{name: np.zeros(n) for name in ("base", "slope", "bend", "seeds", "typed")},
        "moving": np.zeros(n, dtype=np.uint32),
        **{name: np.zeros(n_arrays, dtype=np.uint32) for name in ("references", "known")},
        **{name: np.zeros(n_arrays, dtype=np.int32) for name in ("listed", "chosen")},
        **{name: np.zeros(n_arrays, dtype=np.int64) for name in ("place", "seen")},
    }
    functions = {"do_step": "fmi3DoStep"}
    if fmu.keeps_state:
        functions |= {f"{verb.lower()}_state": f"fmi3{verb}FMUState" for verb in ("Get", "Set", "Free")}
    if fmu.differentiates:
        functions["directional"] = "fmi3GetDirectionalDerivative"
    adapter = kernel.AdapterStruct(
        log=ctypes.pointer(log), arrays=arrays, **{name: array.ctypes.data for name, array in room.items()},
        **{name: _address(dll, function) for name, function in functions.items()},
    )  # fmt: skip
    for i in sorted(set(numeric)):
        adapter.get[i] = _address(dll, f"fmi3Get{kernel.NUMERIC_TYPES[i]}")
        adapter.set[i] = _address(dll, f"fmi3Set{kernel.NUMERIC_TYPES[i]}")
    return adapter, [arrays, room]


def _address(dll: Any, function: str) -> int | None:
    return ctypes.cast(getattr(dll, function), c_void_p).value
