"""The compiled stepping kernel: built once per machine from kernel.c, loaded with ctypes."""

from __future__ import annotations

import ctypes
import hashlib
import tempfile
from ctypes import POINTER, Structure, c_char, c_double, c_int, c_int32, c_int64, c_void_p
from functools import cache
from pathlib import Path
from typing import Any

import fmpy
import platformdirs

from cosim.errors import CosimError
from fmus_src.export.compiler import FLAGS, compile_shared

CAUSES = ("", "fmi2Set of an input", "fmi2SetRealInputDerivatives", "fmi2DoStep", "fmi2Get of an output", "value")
NOT_FINITE = 5
STATUS = ("fmi2OK", "fmi2Warning", "fmi2Discard", "fmi2Error", "fmi2Fatal", "fmi2Pending")
WARNING, FATAL = STATUS.index("fmi2Warning"), STATUS.index("fmi2Fatal")
LOG_LINES = 8  # as in kernel.c
TIMED_EVERY = 5  # as in kernel.c


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


FUNCTIONS = {
    "set_real": "fmi2SetReal",
    "set_integer": "fmi2SetInteger",
    "set_boolean": "fmi2SetBoolean",
    "get_real": "fmi2GetReal",
    "get_integer": "fmi2GetInteger",
    "get_boolean": "fmi2GetBoolean",
    "set_slopes": "fmi2SetRealInputDerivatives",
    "do_step": "fmi2DoStep",
}


class MemberStruct(Structure):
    """`Member` of kernel.c."""

    _fields_ = [
        ("instance", c_void_p),
        *((name, c_void_p) for name in FUNCTIONS),
        ("first_read", c_int32),
        ("first_input", c_int32),
        ("reads", c_int32 * 3),
        ("inputs", c_int32 * 3),
        ("seconds", c_double),
    ]


class PlanStruct(Structure):
    """`Plan` of kernel.c."""

    _fields_ = [
        ("members", POINTER(MemberStruct)),
        ("n_members", c_int32),
        ("n_values", c_int32),
        *((name, c_void_p) for name in ("before", "now", "next", "read_reference", "limit", "input_reference")),
        *((name, c_void_p) for name in ("source", "mode", "factor", "offset", "value", "slope", "integers", "orders")),
        *((name, c_void_p) for name in ("channel", "channel_factor", "channel_offset", "rows")),
        ("n_channels", c_int32),
        ("rows_used", c_int32),
        ("start", c_double),
        ("step", c_double),
        ("steps_done", c_int64),
        ("decimation", c_int64),
        *((name, c_int32) for name in ("cause", "failed_member", "failed_value", "status")),
        ("failed_number", c_double),
    ]


@cache
def library() -> Any:
    """The compiled kernel, built at its first use on this machine.

    Raises:
        CosimError: the compiler cannot build it.
    """
    source = Path(__file__).with_name("kernel.c")
    key = hashlib.sha256(source.read_bytes() + " ".join((*FLAGS, fmpy.platform)).encode()).hexdigest()[:16]
    name = f"kernel-{key}{fmpy.sharedLibraryExtension}"
    for folder in (Path(platformdirs.user_cache_dir("fowt-cosim")), Path(tempfile.gettempdir()) / "fowt-cosim"):
        try:
            if not (folder / name).exists():
                compile_shared([source], folder / name, [Path(fmpy.__file__).parent / "c-code"])
            return _typed(ctypes.CDLL(str(folder / name)))
        except OSError:
            continue  # no writable cache here: try the next folder
        except RuntimeError as error:
            raise CosimError(f"stepping kernel: {error}; check that the 'ziglang' package works here") from error
    raise CosimError("stepping kernel: no writable folder for the compiled kernel; set XDG_CACHE_HOME to one")


def _typed(dll: Any) -> Any:
    plan = POINTER(PlanStruct)
    for name, arguments in (("record", [plan]), ("read_all", [plan, c_int]), ("propagate", [plan]),
                            ("run_steps", [plan, c_int64]), ("fill_callbacks", [c_void_p, POINTER(Log)])):  # fmt: skip
        function = getattr(dll, name)
        function.argtypes = arguments
        function.restype = None if name in ("record", "fill_callbacks") else c_int
    return dll
