"""The compiled half of the isolation: what the C files here share with Python."""

from __future__ import annotations

import ctypes
import sys
from ctypes import POINTER, Structure, c_char_p, c_double, c_int, c_int32, c_int64, c_size_t, c_ssize_t, c_void_p
from functools import cache
from pathlib import Path
from typing import Any

from cosim import kernel

# as the enumeration in channel.h
CALLS = (
    "fmi2SetReal", "fmi2SetInteger", "fmi2SetBoolean", "fmi2SetRealInputDerivatives", "fmi2DoStep", "fmi2GetFMUstate",
    "fmi2SetFMUstate", "fmi2FreeFMUstate", "fmi2GetReal", "fmi2GetInteger", "fmi2GetBoolean",
    "fmi2GetDirectionalDerivative",
)  # fmt: skip


class Page(Structure):
    """Memory that both processes see, so that it survives the FMU's: what the FMU is at, and its messages.

    `call` is the present or last one, `time` that of the last step, s; these are `Page` of channel.h.
    """

    _fields_ = [("call", c_int32), ("reserved", c_int32), ("time", c_double), ("log", kernel.Log)]


class Channel(Structure):
    """What Python sees of `Channel` in channel.h."""

    _fields_ = [
        ("text", c_void_p),
        ("text_size", c_int64),
        ("waits", c_int64),
        ("failed_call", c_int32),
        ("lost", c_int32),
    ]

    def said(self) -> bytes:
        """The last Python request or answer."""
        return ctypes.string_at(self.text, self.text_size)


@cache
def library() -> Any:
    """The compiled C files, built at its first use on this machine.

    Raises:
        CosimError: the compiler cannot build it.
    """
    folder = Path(__file__).parent
    sources = [folder / name for name in ("channel.c", "proxy.c", "server.c")]
    dll = kernel.built_library("isolation", sources, [folder / "channel.h"])
    channel = POINTER(Channel)
    for name, arguments, result in (
        ("channel_open", [c_ssize_t, c_ssize_t], channel),
        ("channel_close", [channel], None),
        ("channel_hear", [channel], c_int),
        ("channel_synchronise", [channel], c_int),
        ("channel_ask", [channel, c_char_p, c_size_t], c_int),
        ("channel_answer", [channel, c_char_p, c_size_t], c_int),
        ("channel_serve", [channel, POINTER(c_void_p * len(CALLS)), c_void_p, POINTER(Page)], c_int),
    ):
        function = getattr(dll, name)
        function.argtypes, function.restype = arguments, result
    return dll


def open_channel(source: int, target: int) -> Any:
    """A channel over two pipes, given as file descriptors."""
    pipes = [_handle(descriptor) for descriptor in (source, target)]
    return library().channel_open(*pipes)


def _handle(descriptor: int) -> int:
    if sys.platform == "win32":
        import msvcrt

        return msvcrt.get_osfhandle(descriptor)
    return descriptor
