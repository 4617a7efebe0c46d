"""The process of one FMU: requests on stdin, answers on stdout; arguments are the page file and the parent's id."""

from __future__ import annotations

import ctypes
import json
import mmap
import os
import pickle
import sys
import threading
import time
from contextlib import suppress
from ctypes import c_void_p
from pathlib import Path
from typing import Any

from cosim import kernel
from cosim.errors import RunFailed
from cosim.instance import Instance, instantiate
from cosim.isolation import native


def main() -> None:
    """Run the process, to its end."""
    try:
        _serve(Path(sys.argv[1]), int(sys.argv[2]))
    except Exception as error:
        print(f"{type(error).__name__}: {error}", file=sys.stderr, flush=True)
        os._exit(1)
    os._exit(0)  # at once: leaving the interpreter would run the FMU's destructors for nothing


def _serve(page_file: Path, parent: int) -> None:
    """Load the FMU that the page file names and serve it until the other end closes."""
    source, target = _take_pipes()
    _follow(parent)
    with page_file.open("r+b") as file:
        memory = mmap.mmap(file.fileno(), ctypes.sizeof(native.Page))
        file.seek(ctypes.sizeof(native.Page))
        name, fmu, folder, start = pickle.load(file)
    with suppress(OSError):  # Windows leaves that to the parent
        page_file.unlink()
    page = native.Page.from_buffer(memory)
    channel = native.open_channel(source, target)
    try:
        instance = instantiate(name, fmu, folder, start, page.log)
        member = instance.member()
    except RunFailed as error:
        _answer(channel, error=str(error))
        return
    _answer(channel, value=[name for name, address in member.items() if address is None])
    addresses = {kernel.FUNCTIONS[short]: address for short, address in member.items() if short != "instance"}
    functions = (c_void_p * len(native.CALLS))(*(addresses.get(name) for name in native.CALLS))
    while native.library().channel_serve(channel, functions, member["instance"], page):
        _obey(channel, instance)


def _obey(channel: Any, instance: Instance) -> None:
    """Run a method of the instance; what it raises is the answer."""
    method, *arguments = json.loads(channel.contents.said())
    try:
        getattr(instance, method)(*arguments)
    except RunFailed as error:
        _answer(channel, error=str(error))
    else:
        _answer(channel, value=None)


def _answer(channel: Any, **content: Any) -> None:
    text = json.dumps(content).encode()
    native.library().channel_answer(channel, text, len(text))


def _take_pipes() -> tuple[int, int]:
    """Private copies of stdin and stdout; whatever the FMU prints goes to stderr, which the parent collects."""
    pipes = os.dup(0), os.dup(1)
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, 0)
    os.dup2(2, 1)
    if sys.platform == "win32":  # no dialogue box when the FMU crashes
        ctypes.windll.kernel32.SetErrorMode(0x0001 | 0x0002 | 0x8000)
    return pipes


def _follow(parent: int) -> None:
    """End with the parent even while the FMU hangs and so does not see the pipe's end."""
    above = os.getppid()  # on Windows perhaps a launcher, which outlives the parent

    def watch() -> None:
        if sys.platform == "win32":
            process = ctypes.windll.kernel32.OpenProcess(0x00100000, False, parent)  # SYNCHRONIZE
            if not process:
                return
            ctypes.windll.kernel32.WaitForSingleObject(c_void_p(process), -1)
        else:
            while os.getppid() == above:
                time.sleep(1.0)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
