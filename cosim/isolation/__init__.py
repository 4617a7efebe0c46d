"""FMUs in processes of their own: one that crashes or hangs ends its run with an error, not the program."""

from __future__ import annotations

import ctypes
import json
import mmap
import os
import pickle
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Mapping, Sequence
from contextlib import suppress
from ctypes import c_void_p
from pathlib import Path
from typing import Any

from cosim import kernel
from cosim.errors import CosimError, RunFailed, nearest
from cosim.fmu import Fmu, Value
from cosim.instance import Instance, call_name
from cosim.isolation import native

CALL_TIMEOUT = 60.0  # s
START_UP = 30.0  # s, more than a process takes to start on a busy machine
PRINTED_KEPT = 4000  # bytes
# of Windows, where there are no signals
EXCEPTIONS = {
    0xC0000005: "access violation",
    0xC0000094: "integer division by zero",
    0xC00000FD: "stack overflow",
    0xC0000374: "heap corruption",
    0xC0000409: "fail fast",
}


class IsolatedInstance(Instance):
    """An `Instance` whose FMU runs in its own process; each step costs one exchange over a pair of pipes.

    Calls that return only a status are sent with the next reading, so a failure shows there; `failure` names the call
    that failed, and its time. The process ends with `free`, or with the parent.
    """

    apart = True

    # Instance's own set-up is not wanted here: it happens in the other process
    def __init__(self, name: str, fmu: Fmu, folder: Path, start: float, timeout: float = CALL_TIMEOUT) -> None:
        """Start the process; it loads and instantiates the FMU while the caller goes on.

        Args:
            timeout: wall time after which a call counts as hanging, s.
        """
        self.name, self.fmu, self.timeout, self._start = name, fmu, timeout, start
        self._call_of_python = call_name("fmi2Instantiate", fmu.version)
        self._absent: list[str] | None = None  # functions that the FMU need not have; None until it is loaded
        self._hung = 0.0  # s waited before it was killed
        self._freed = threading.Event()
        self._printed = b""
        self._library = native.library()
        self._page_file = _page_file(name, fmu, folder, start)
        with self._page_file.open("r+b") as file:
            self._page: native.Page | None = native.Page.from_buffer(
                mmap.mmap(file.fileno(), ctypes.sizeof(native.Page))
            )
        self.log = self._page.log
        self._process = _start_process(self._page_file)
        pipes = self._process.stdout, self._process.stdin
        self._channel = native.open_channel(*(pipe.fileno() for pipe in pipes if pipe is not None))
        self._threads = [threading.Thread(target=t, daemon=True) for t in (self._collect_printed, self._watch)]
        for thread in self._threads:
            thread.start()

    def set(self, values: Mapping[str, Value]) -> None:
        """Set start values, in the FMU's own units."""
        for name, value in values.items():
            self._ask(f"fmi2Set of {name} = {value}", "set", {name: value})

    def enter_initialisation(self) -> None:
        """Start initialisation mode."""
        self._ask("fmi2EnterInitializationMode", "enter_initialisation")

    def exit_initialisation(self) -> None:
        """Leave initialisation mode: the FMU is ready to step."""
        self._ask("fmi2ExitInitializationMode", "exit_initialisation")

    def member(self) -> dict[str, int | None]:
        """Addresses that the kernel calls: of the channel, and of the functions that stand for the FMU's."""
        absent = self._loaded()
        stand_ins = {
            short: None if short in absent else getattr(self._library, f"proxy_{function}")
            for short, function in kernel.FUNCTIONS.items()
        }
        addresses = {k: None if f is None else ctypes.cast(f, c_void_p).value for k, f in stand_ins.items()}
        return {"instance": ctypes.cast(self._channel, c_void_p).value, **addresses}

    def failure(self, call: str, status: int, time: float) -> str:
        """The line that a run ends with; it names the call that failed, not the reading that reported it."""
        channel = self._channel.contents
        if channel.lost:
            return self._loss(time)
        return super().failure(native.CALLS[channel.failed_call], status, self._time(channel.failed_call, time))

    def abandon(self) -> None:
        """After fmi2Fatal, FMI allows no further call: end the process."""
        self._process.kill()

    def free(self, terminate: bool) -> None:
        """Terminate (after a run without error), free and end the process; does nothing the second time."""
        if self._freed.is_set():
            return
        if not self._channel.contents.lost and self._process.poll() is None:
            if terminate:  # steps of an FMU that nothing is read from may still be open
                status = self._library.channel_synchronise(self._channel)
                if status not in (0, kernel.WARNING):
                    raise RunFailed(self.failure("", status, self._page.time if self._page else self._start))
            with suppress(RunFailed):  # the results are complete
                self._ask("fmi2Terminate", "free", terminate)
        self._reap()
        self._freed.set()
        for thread in self._threads:
            thread.join(timeout=1.0)
        for pipe in (self._process.stdout, self._process.stderr):
            if pipe is not None:
                pipe.close()
        self._library.channel_close(self._channel)
        self.log = kernel.Log.from_buffer_copy(self.log)
        self._page = None  # unmaps the file, which Windows wants before deleting it
        self._page_file.unlink(missing_ok=True)

    def _loaded(self) -> list[str]:
        """Wait until the FMU is instantiated; returns the kernel's names of the functions that it need not have."""
        if self._absent is None:
            self._absent = self._answer(self._library.channel_hear(self._channel))
            self._call_of_python = ""
        return self._absent

    def _ask(self, call: str, method: str, *arguments: Any) -> None:
        """Call a method of the `Instance` in the other process."""
        self._loaded()
        self._call_of_python = call_name(call, self.fmu.version)
        text = json.dumps([method, *arguments]).encode()
        self._answer(self._library.channel_ask(self._channel, text, len(text)))
        self._call_of_python = ""

    def _answer(self, status: int) -> Any:
        channel = self._channel.contents
        if channel.lost:
            raise RunFailed(self._loss(self._start))
        if status not in (0, kernel.WARNING):
            raise RunFailed(self.failure("", status, self._start))
        said = json.loads(channel.said())
        if "error" in said:
            raise RunFailed(said["error"])
        return said["value"]

    def _loss(self, time: float) -> str:
        """One line on how the process was lost, during the call for time `time`, s."""
        self._reap()
        how = f"did not answer within {self._hung:g} s" if self._hung else describe_end(self._process.returncode)
        call = self._call_of_python
        if self._page is not None and not call:
            call, time = call_name(native.CALLS[self._page.call], self.fmu.version), self._time(self._page.call, time)
        words = self.message() + self._last_line()
        return f"{self.name}: the process of {self.fmu.path.name} {how} at t = {time:.6g} s in {call}{words}"

    def _time(self, call: int, time: float) -> float:
        """Time of a call, s: a step's own, as it may have been put off; of other calls the given one."""
        return self._page.time if self._page is not None and native.CALLS[call] == "fmi2DoStep" else time

    def _reap(self) -> None:
        """Let the process end: it does so at once when its pipe closes, unless it hangs."""
        if self._process.stdin is not None:
            self._process.stdin.close()
        try:
            self._process.wait(timeout=2.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._threads[0].join(timeout=1.0)  # all that it printed is then here

    def _last_line(self) -> str:
        lines = self._printed.decode(errors="replace").split("\n")
        last = next((line.strip() for line in reversed(lines) if line.strip()), "")
        return f"; it last printed '{last[:300]}'" if last else ""

    def _collect_printed(self) -> None:
        """Keep the end of what the process prints, and keep its pipe from filling."""
        assert self._process.stderr is not None
        with suppress(OSError, ValueError):  # closed by `free`
            while part := os.read(self._process.stderr.fileno(), 65536):
                self._printed = (self._printed + part)[-PRINTED_KEPT:]

    def _watch(self) -> None:
        """Kill a process that keeps the kernel waiting.

        Counted in looks, not by the clock: a program that was suspended must not find that its FMUs have hung.
        """
        interval = min(1.0, self.timeout / 10.0)
        seen, looks = 0, 0
        while not self._freed.wait(interval):
            waits = self._channel.contents.waits
            looks = looks + 1 if waits == seen and waits % 2 else 0
            seen = waits
            limit = self.timeout + (START_UP if self._absent is None else 0.0)
            if looks * interval >= limit:
                self._hung = limit
                self._process.kill()
                return


def isolated_names(names: Sequence[str], isolate: Sequence[str]) -> frozenset[str]:
    """The components to isolate; "all" stands for every one.

    Raises:
        CosimError: there is no such component.
    """
    chosen = (isolate,) if isinstance(isolate, str) else isolate
    for name in chosen:
        if name != "all" and name not in names:
            raise CosimError(f"isolate: no component '{name}'{nearest(name, [*names, 'all'])}")
    return frozenset(names if "all" in chosen else chosen)


def describe_end(code: int) -> str:
    """How a process with this return code ended."""
    if code < 0:
        return f"died ({next((s.name for s in signal.Signals if s == -code), f'signal {-code}')})"
    return f"died ({EXCEPTIONS[code]})" if code in EXCEPTIONS else f"ended (exit code {code})"


def _page_file(name: str, fmu: Fmu, folder: Path, start: float) -> Path:
    """A file with the shared page and what the process needs to know."""
    descriptor, path = tempfile.mkstemp(prefix="fowt-", suffix=".page")
    with os.fdopen(descriptor, "wb") as file:
        file.write(bytes(ctypes.sizeof(native.Page)))
        pickle.dump((name, fmu, folder.resolve(), start), file)
    return Path(path)


def _start_process(page_file: Path) -> subprocess.Popen[bytes]:
    # its own process group: Ctrl-C is for the parent alone, which then ends the run in order
    group: dict[str, Any] = {"process_group": 0}
    if sys.platform == "win32":
        group = {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP | subprocess.CREATE_NO_WINDOW}
    # modules from where this program has them; PYTHONPATH would do so too, but FMUs that start Python would inherit it
    path = [p or str(Path.cwd()) for p in sys.path]
    program = f"import sys; sys.path[:] = {path!r}; from cosim.isolation.child import main; main()"
    return subprocess.Popen(
        [sys.executable, "-c", program, str(page_file), str(os.getpid())],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, bufsize=0, **group,
    )  # fmt: skip
