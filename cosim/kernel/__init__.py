"""The compiled stepping kernel: built once per machine from C, loaded with ctypes."""

from __future__ import annotations

import ctypes
import hashlib
import tempfile
from collections.abc import Sequence
from ctypes import POINTER, Structure, c_char, c_double, c_int, c_int32, c_int64, c_size_t, c_uint32, c_void_p
from functools import cache
from pathlib import Path
from typing import Any

import fmpy
import platformdirs

from cosim.errors import CosimError
from fmus_src.export.compiler import FLAGS, compile_shared

CAUSES = (
    "", "fmi2Set of an input", "fmi2SetRealInputDerivatives", "fmi2DoStep", "fmi2Get of an output", "value",
    "fmi2GetFMUstate", "fmi2SetFMUstate", "fmi2GetDirectionalDerivative",
)  # fmt: skip
SET_FAILED, SLOPE_FAILED, NOT_FINITE, NOT_CONVERGED, LOOP_OPEN = 1, 2, 5, 9, 10
STATUS = ("fmi2OK", "fmi2Warning", "fmi2Discard", "fmi2Error", "fmi2Fatal", "fmi2Pending")
WARNING, FATAL = STATUS.index("fmi2Warning"), STATUS.index("fmi2Fatal")
LOG_LINES = 8  # as in kernel.h
TIMED_EVERY = 5  # as in kernel.h
SOURCES = ("kernel.c", "member.c", "signals.c", "exchange.c", "iterate.c", "energy.c", "adapter.c")
# of FMI 3.0, as in adapter.c; enumerations are integers there
NUMERIC_TYPES = (
    "Float64", "Float32", "Int8", "UInt8", "Int16", "UInt16", "Int32", "UInt32", "Int64", "UInt64", "Boolean",
)  # fmt: skip


def status_name(status: int) -> str:
    """An FMI status by its name."""
    return STATUS[status] if 0 <= status < len(STATUS) else f"status {status}"


class Log(Structure):
    """Last warnings and errors of one FMU instance."""

    _fields_ = [
        ("count", c_int32),
        ("status", c_int32 * LOG_LINES),
        ("text", (c_char * 400) * LOG_LINES),
    ]

    def lines(self) -> list[tuple[int, str]]:
        """(status, message), oldest first."""
        first = max(0, self.count - LOG_LINES)
        slots = [i % LOG_LINES for i in range(first, self.count)]
        return [(self.status[i], self.text[i].value.decode(errors="replace").strip()) for i in slots]


# FMI functions by the names of kernel.h; the last five may be missing, and those of integers where they pass as reals.
FUNCTIONS = {
    "set_real": "fmi2SetReal",
    "set_integer": "fmi2SetInteger",
    "set_boolean": "fmi2SetBoolean",
    "get_real": "fmi2GetReal",
    "get_integer": "fmi2GetInteger",
    "get_boolean": "fmi2GetBoolean",
    "do_step": "fmi2DoStep",
    "set_slopes": "fmi2SetRealInputDerivatives",
    "get_state": "fmi2GetFMUstate",
    "set_state": "fmi2SetFMUstate",
    "free_state": "fmi2FreeFMUstate",
    "directional": "fmi2GetDirectionalDerivative",
}


class MemberStruct(Structure):
    """`Member` of kernel.h."""

    _fields_ = [
        ("instance", c_void_p),
        *((name, c_void_p) for name in FUNCTIONS),
        ("saved", c_void_p),
        ("first_read", c_int32),
        ("first_input", c_int32),
        ("reads", c_int32 * 3),
        ("inputs", c_int32 * 3),
        *((name, c_int32) for name in ("derived", "varying", "iterated", "stale", "every", "substeps", "phase")),
        ("age", c_double),
        ("seconds", c_double),
    ]


class ArrayStruct(Structure):
    """`Array` of adapter.h."""

    _fields_ = [("reference", c_uint32), *((name, c_int32) for name in ("type", "first", "size"))]


class AdapterStruct(Structure):
    """`Adapter` of adapter.h."""

    _fields_ = [
        ("fmu", c_void_p),
        ("log", POINTER(Log)),
        *((name, c_void_p * len(NUMERIC_TYPES)) for name in ("get", "set")),
        *((name, c_void_p) for name in ("do_step", "get_state", "set_state", "free_state", "directional")),
        ("arrays", POINTER(ArrayStruct)),
        *((name, c_void_p) for name in ("array_of", "values", "base", "slope", "bend", "moving", "seeds", "typed")),
        *((name, c_void_p) for name in ("references", "known", "listed", "chosen", "place", "seen")),
        ("round", c_int64),
        ("n_moving", c_size_t),
        ("begin", c_double),
        ("failed", c_int),
    ]


class PairStruct(Structure):
    """`Pair` of kernel.h."""

    _fields_ = [(name, c_int32) for name in ("port", "effort", "flow", "flow_used", "by_rate")]


class PortStruct(Structure):
    """`Port` of kernel.h."""

    _fields_ = [("crossed", c_double), ("residual", c_double)]


class PlanStruct(Structure):
    """`Plan` of kernel.h."""

    _fields_ = [
        ("members", POINTER(MemberStruct)),
        *((name, c_int32) for name in ("n_members", "n_values", "n_inputs")),
        *((name, c_void_p) for name in ("now", "next", "mid", "rate", "slope", "bend")),
        *((name, c_void_p) for name in ("read_reference", "owner", "limit", "scale")),
        *((name, c_void_p) for name in ("input_reference", "source", "target", "mode", "factor", "offset")),
        *((name, c_void_p) for name in ("value", "input_slope", "input_bend", "begun")),
        *((name, c_void_p) for name in ("mid_used", "end_used", "mid_before", "end_before")),
        *((name, c_void_p) for name in ("integers", "first_order", "second_order", "derivatives")),
        *((name, c_void_p) for name in ("backward", "late", "tear", "backward_tear", "late_tear")),
        *((name, c_int32) for name in ("n_backward", "n_late", "n_tear")),
        *((name, c_void_p) for name in ("jacobian", "matrix", "correction", "seed", "response")),
        ("jacobian_known", c_int32),
        ("jacobian_attempts", c_int64),
        ("gain", c_double),
        ("pairs", POINTER(PairStruct)),
        ("ports", POINTER(PortStruct)),
        *((name, c_int32) for name in ("n_pairs", "n_ports")),
        ("last_bend", c_void_p),
        *((name, c_void_p) for name in ("channel", "channel_factor", "channel_offset", "rows")),
        *((name, c_int32) for name in ("n_channels", "rows_used")),
        *((name, c_double) for name in ("start", "step")),
        *((name, c_int64) for name in ("steps_done", "decimation")),
        *((name, c_int32) for name in ("order", "scheme")),
        *((name, c_double) for name in ("tolerance", "energy_tolerance", "time", "last")),
        *((name, c_int32) for name in ("history", "reversible", "slow", "timed", "depth")),
        *((name, c_int64) for name in ("attempts", "rejected", "iterations", "sweeps")),
        *((name, c_int32) for name in ("cause", "failed_member", "failed_value", "status")),
        ("failed_number", c_double),
    ]


@cache
def library() -> Any:
    """The compiled kernel, built at its first use on this machine.

    Raises:
        CosimError: the compiler cannot build it.
    """
    folder = Path(__file__).parent
    sources, headers = ([folder / name for name in names] for names in (SOURCES, ("kernel.h", "adapter.h")))
    return _typed(built_library("kernel", sources, headers))


def built_library(name: str, sources: Sequence[Path], headers: Sequence[Path] = ()) -> Any:
    """A shared library of C sources that use FMI 2.0 headers, from the user's cache or compiled into it, and loaded.

    Raises:
        CosimError: the compiler cannot build it, or there is no folder to keep it.
    """
    digest = hashlib.sha256(" ".join((*FLAGS, fmpy.platform)).encode())
    for file in (*sources, *headers):
        digest.update(file.read_bytes())
    file_name = f"{name}-{digest.hexdigest()[:16]}{fmpy.sharedLibraryExtension}"
    for folder in (Path(platformdirs.user_cache_dir("fowt-cosim")), Path(tempfile.gettempdir()) / "fowt-cosim"):
        try:
            if not (folder / file_name).exists():
                includes = [*dict.fromkeys(h.parent for h in headers), Path(fmpy.__file__).parent / "c-code"]
                compile_shared(sources, folder / file_name, includes)
            return ctypes.CDLL(str(folder / file_name))
        except OSError:
            continue  # no writable cache here: try the next folder
        except RuntimeError as error:
            raise CosimError(f"{name}: {error}; check that the 'ziglang' package works here") from error
    raise CosimError(f"{name}: no writable folder for the compiled library; set XDG_CACHE_HOME to one")


def _typed(dll: Any) -> Any:
    plan = POINTER(PlanStruct)
    for name, arguments in (("record", [plan]), ("read_all", [plan, c_int]), ("settle", [plan]), ("linearise", [plan]),
                            ("run_steps", [plan, c_int64]), ("release_states", [plan]),
                            ("fill_callbacks", [c_void_p, POINTER(Log)])):  # fmt: skip
        function = getattr(dll, name)
        function.argtypes = arguments
        function.restype = None if name in ("record", "release_states", "fill_callbacks") else c_int
    return dll
