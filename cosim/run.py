"""Run a system: `simulate(system, settings, folder)`."""

from __future__ import annotations

import errno
import math
import signal
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal, get_args

import pandas as pd

from cosim.archive import extract
from cosim.checks import CheckedSystem, check
from cosim.errors import CosimError, RunFailed, nearest
from cosim.graph import step_order
from cosim.instance import Instance, instantiate
from cosim.isolation import CALL_TIMEOUT, IsolatedInstance, isolated_names
from cosim.layout import ITERATED, Algorithm, Extrapolation, Layout, lay_out
from cosim.plan import Stepper, Stepping
from cosim.recording import (
    Channel,
    Recorder,
    SelectedChannel,
    new_folder,
    read_results,
    select_channels,
    versions,
    write_json,
)
from cosim.system import System

BLOCK_WALL = 0.2  # s between looks at progress and Ctrl-C
BLOCK_SIMULATED = 2.0  # s
ENERGY_TOLERANCE = {False: 1e-3, True: 1e-5}  # of single passes, and of iterated steps
RESIDUAL_SHARE = 1e-3  # of the energy that crossed a port: above it the coupling's own energy is worth a warning
Progress = Callable[[float], None]


@dataclass(frozen=True)
class RunSettings:
    """How to run.

    Attributes:
        stop, start: s. step: communication step, s; stop - start is a multiple of it.
        algorithm: "gauss-seidel" (each component sees what those before it have reached), "jacobi" (none does),
            "iterated" (steps are repeated to convergence, with Aitken's relaxation), "newton" (the same, with the
            Jacobian of direct feed-through).
        extrapolation: inputs "quadratic" or "linear" over the step, or "held" as classic masters do. Held inputs damp
            negatively: a force held over the step costs a mode omega * step / 4 of its damping ratio (Gauss-Seidel),
            three times that with Jacobi. See docs/coupling.md.
        tolerance: relative, of algebraic loops and iterations; None for the algorithm's own.
        energy_tolerance: error of a mechanical port's power, as a share of it, above which a step is repeated in halves
            (as when a damper hits its end stop); 0: never. None: 1e-3 (iterated: 1e-5) if all FMUs can go back, else 0.
        rates: step of a component in communication steps, such as {"mooring": 2} or {"nacelle_damper": 0.5}.
        order: components to advance first.
        channels, record: what to record, see `select_channels`; every `decimation`-th step.
        transient: time left out of the statistics, s.
        isolate: components to run in processes of their own, or "all": one that crashes then ends only its run.
        call_timeout: wall time that a call of an isolated component may take, s.
        about: what the caller wants run.json to say of the run, such as case, damper and seed.
    """

    stop: float
    start: float = 0.0
    step: float = 0.0125
    algorithm: Algorithm = "gauss-seidel"
    extrapolation: Extrapolation = "quadratic"
    tolerance: float | None = None
    energy_tolerance: float | None = None
    rates: Mapping[str, float] = field(default_factory=dict)
    order: tuple[str, ...] = ()
    channels: tuple[Channel, ...] = ()
    record: tuple[str, ...] = ()
    decimation: int = 1
    transient: float = 0.0
    isolate: tuple[str, ...] = ()
    call_timeout: float = CALL_TIMEOUT
    about: Mapping[str, str | int] = field(default_factory=dict)

    def steps(self) -> int:
        """Number of steps.

        Raises:
            CosimError: a setting is out of range.
        """
        if not (math.isfinite(self.start) and math.isfinite(self.stop) and self.stop > self.start):
            raise CosimError(f"stop {self.stop:g} s must be finite and after start {self.start:g} s")
        if not (math.isfinite(self.step) and self.step > 0.0):
            raise CosimError(f"step {self.step:g} s must be positive")
        if not (math.isfinite(self.call_timeout) and self.call_timeout > 0.0):
            raise CosimError(f"call timeout {self.call_timeout:g} s must be positive")
        if self.decimation < 1:
            raise CosimError(f"decimation {self.decimation} must be 1 or more")
        if not 0.0 <= self.transient < self.stop - self.start:
            raise CosimError(
                f"transient {self.transient:g} s leaves nothing of {self.stop - self.start:g} s; shorten it"
            )
        for name, kinds in (("algorithm", Algorithm), ("extrapolation", Extrapolation)):
            value = getattr(self, name)
            if value not in get_args(kinds):
                raise CosimError(f"no {name} '{value}'{nearest(value, get_args(kinds))}")
        if self.tolerance is not None and not 0.0 < self.tolerance < 1.0:
            raise CosimError(f"tolerance {self.tolerance:g} must be between 0 and 1")
        if self.energy_tolerance is not None and not 0.0 <= self.energy_tolerance < 1.0:
            raise CosimError(f"energy_tolerance {self.energy_tolerance:g} must be between 0 (never halve a step) and 1")
        exact = (self.stop - self.start) / self.step
        steps = round(exact)
        if steps < 1 or abs(exact - steps) > 1e-6:
            ends = " or ".join(f"{self.start + n * self.step:.10g}" for n in (max(1, int(exact)), int(exact) + 1))
            raise CosimError(f"stop {self.stop:g} s is not a whole number of steps of {self.step:g} s; use {ends}")
        return steps


@dataclass(frozen=True)
class RunResult:
    """What a run gave; `status` is "completed" or "stopped" (by Ctrl-C).

    Attributes:
        time: reached, s. wall_time: of the whole run, s.
        last: last recorded values by channel. summary: statistics after the transient.
        component_seconds: wall time of each component.
        ports: of each mechanical port, the energy that `crossed` it and the coupling's `residual`, J; their `share`.
    """

    folder: Path
    status: Literal["completed", "stopped"]
    message: str
    time: float
    steps: int
    wall_time: float
    component_seconds: dict[str, float] = field(repr=False)
    ports: dict[str, dict[str, float]] = field(repr=False)
    warnings: tuple[str, ...] = field(repr=False)
    summary: dict[str, dict[str, Any]] = field(repr=False)
    last: dict[str, float] = field(repr=False)

    def frame(self) -> pd.DataFrame:
        """All recorded channels, indexed by time (s)."""
        return read_results(self.folder)


def simulate(system: System, settings: RunSettings, folder: Path, progress: Progress | None = None) -> RunResult:
    """Run a system into a new folder: results.parquet, summary.json and run.json.

    Args:
        folder: to be created; one that exists must be empty (nothing is ever deleted).
        progress: called a few times a second with the time reached, s.

    Raises:
        CosimError: the system or a setting cannot be used; nothing was run.
        RunFailed: the run broke off; what was computed until then is in the folder.
    """
    steps = settings.steps()
    checked = check(system, isolated_names([c.name for c in system.components], settings.isolate))
    channels, missing = select_channels(checked, settings.channels, settings.record)
    order = step_order(checked, settings.order)
    layout = lay_out(checked, order, channels, settings.algorithm, settings.extrapolation, settings.rates)
    warnings = [*checked.warnings, *missing, *_held_loops(settings, layout)]
    run = _Run(settings, checked, channels, layout, warnings, new_folder(folder))
    try:
        return run.execute(steps, progress)
    except BaseException as error:
        with suppress(OSError):  # where the disk is full, the error itself is what matters
            run.write(
                "stopped" if isinstance(error, KeyboardInterrupt) else "failed",
                str(error) or ("stopped by the user" if isinstance(error, KeyboardInterrupt) else type(error).__name__),
            )
        if isinstance(error, OSError):
            full = error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
            remedy = "; free disk space or choose another" if full else ""
            raise RunFailed(f"{folder}: writing failed: {error.strerror or error}{remedy}") from error
        raise


def _held_loops(settings: RunSettings, layout: Layout) -> list[str]:
    if settings.extrapolation != "held" or settings.algorithm in ITERATED:
        return []
    return [f"algebraic loop, its values held over each step: {path}" for path in layout.loops]


@contextmanager
def _interrupt_flag() -> Iterator[list[bool]]:
    """A flag that the first Ctrl-C sets; the second interrupts as usual. Other threads keep the usual way."""
    flag: list[bool] = []
    if threading.current_thread() is not threading.main_thread():
        yield flag
        return
    previous = signal.getsignal(signal.SIGINT) or signal.SIG_DFL

    def on_interrupt(number: int, frame: Any) -> None:
        flag.append(True)
        signal.signal(signal.SIGINT, previous)

    signal.signal(signal.SIGINT, on_interrupt)
    try:
        yield flag
    finally:
        signal.signal(signal.SIGINT, previous)


class _Run:
    """One run: the FMU instances, the stepping and what is written about it."""

    def __init__(
        self,
        settings: RunSettings,
        checked: CheckedSystem,
        channels: Sequence[SelectedChannel],
        layout: Layout,
        warnings: list[str],
        folder: Path,
    ) -> None:
        self.settings, self.checked, self.channels, self.layout = settings, checked, channels, layout
        self.warnings, self.folder = warnings, folder
        self.began = time.perf_counter()
        self.started_at = datetime.now(UTC).isoformat(timespec="seconds")
        self.stepper: Stepper | None = None
        self.passes = 0

    def execute(self, steps: int, progress: Progress | None) -> RunResult:
        self.write("running", "")
        s = self.settings
        with ExitStack() as stack:
            unpacked = Path(
                stack.enter_context(tempfile.TemporaryDirectory(prefix="fowt-", ignore_cleanup_errors=True))
            )
            recorder = Recorder(self.folder, self.channels, s.start + s.transient)
            with ExitStack() as always:
                always.callback(recorder.close)
                instances = self._instantiate(unpacked, stack)
                self.stepper = stepper = Stepper(self.layout, instances, self._stepping())
                stack.callback(stepper.close)
                self._initialise(stepper, instances)
                with _interrupt_flag() as interrupted:
                    always.callback(lambda: recorder.add(stepper.take_rows()))  # before the recorder closes
                    self._loop(stepper, recorder, steps, progress, interrupted)
            status: Literal["completed", "stopped"] = "completed" if stepper.plan.steps_done == steps else "stopped"
            stepper.close()
            for instance in instances:
                instance.free(terminate=True)
        message = "" if status == "completed" else (
            f"stopped by the user at t = {stepper.time:.6g} s of {s.stop:g} s; results until then are in {self.folder}"
        )  # fmt: skip
        self._keep_messages(instances)
        self._judge_ports(stepper)
        summary = recorder.summary()
        write_json(self.folder / "summary.json", summary)
        self.write(status, message)
        last = dict(zip((c.name for c in self.channels), recorder.last[1:].tolist(), strict=True))
        return RunResult(
            self.folder, status, message, stepper.time, int(stepper.plan.steps_done),
            time.perf_counter() - self.began, stepper.seconds(), stepper.ports(), tuple(self.warnings), summary, last,
        )  # fmt: skip

    def _stepping(self) -> Stepping:
        s = self.settings
        obstacle = self._obstacle_to_halving()
        if s.energy_tolerance and obstacle:
            raise CosimError(f"energy_tolerance {s.energy_tolerance:g}: {obstacle}; set it to 0")
        usual = 0.0 if obstacle or s.extrapolation == "held" else ENERGY_TOLERANCE[s.algorithm in ITERATED]
        chosen = usual if s.energy_tolerance is None else s.energy_tolerance
        return Stepping(s.start, s.step, s.decimation, s.algorithm, s.extrapolation, s.tolerance, chosen)

    def _obstacle_to_halving(self) -> str:
        """Why steps of this system cannot be repeated in halves, or ""."""
        if not self.layout.pairs:
            return f"system '{self.checked.name}' has no mechanical port to judge steps by"
        for member in self.layout.members:
            name, fmu = self.checked.names[member.component], self.checked.fmus[member.component]
            if member.every > 1:
                return f"{name} steps at multiples of the step, so that steps cannot be halved"
            if not fmu.keeps_state:
                return f"{name}: {fmu.path.name} cannot save its state (canGetAndSetFMUstate)"
            if not fmu.varies_step:
                return f"{name}: {fmu.path.name} takes steps of one length (canHandleVariableCommunicationStepSize)"
        return ""

    def _instantiate(self, unpacked: Path, stack: ExitStack) -> list[Instance]:
        s = self.settings
        folders: dict[Path, Path] = {}
        instances: list[Instance] = []
        isolated = isolated_names(self.checked.names, s.isolate)
        for name, fmu in zip(self.checked.names, self.checked.fmus, strict=True):
            if fmu.path not in folders:
                folders[fmu.path] = extract(fmu.path, unpacked / str(len(folders)))
            if name in isolated:
                instances.append(IsolatedInstance(name, fmu, folders[fmu.path], s.start, s.call_timeout))
            else:
                instances.append(instantiate(name, fmu, folders[fmu.path], s.start))
            stack.callback(instances[-1].free, False)
        return instances

    def _initialise(self, stepper: Stepper, instances: Sequence[Instance]) -> None:
        for instance, start in zip(instances, self.checked.start, strict=True):
            instance.set(start)
            instance.enter_initialisation()
        self.passes = stepper.initialise()
        for instance in instances:
            instance.exit_initialisation()
        stepper.begin()

    def _loop(
        self, stepper: Stepper, recorder: Recorder, steps: int, progress: Progress | None, interrupted: list[bool]
    ) -> None:
        largest = max(1, round(BLOCK_SIMULATED / self.settings.step))
        count, done = 1, 0
        while done < steps and not interrupted:
            count = min(count, largest, stepper.capacity(), steps - done)
            before = time.perf_counter()
            try:
                stepper.advance(count)
            except KeyboardInterrupt:  # outside the main thread's flag, such as a second Ctrl-C
                interrupted.append(True)
            taken = time.perf_counter() - before
            recorder.add(stepper.take_rows())
            done = int(stepper.plan.steps_done)
            count = max(1, min(2 * count, int(count * BLOCK_WALL / max(taken, 1e-6))))
            if progress is not None:
                progress(stepper.time)

    def _keep_messages(self, instances: Sequence[Instance]) -> None:
        for instance in instances:
            texts = dict.fromkeys(text for _, text in instance.log.lines())
            self.warnings += [f"{instance.name}: {text}" for text in texts]

    def _judge_ports(self, stepper: Stepper) -> None:
        for name, port in stepper.ports().items():
            if port["share"] > RESIDUAL_SHARE:
                self.warnings.append(
                    f"port {name}: the coupling added {port['residual']:.3g} J, {100.0 * port['share']:.2g} % of what"
                    " crossed it; reduce the step, or use quadratic extrapolation or an iterated algorithm"
                )

    def write(self, status: str, message: str) -> None:
        """Write run.json: everything needed to know what this run was, and to repeat it."""
        components = {
            name: {
                "fmu": str(fmu.path), "sha256": fmu.sha256, "guid": fmu.guid, "generator": fmu.generator,
                "start": dict(start),
            }
            for name, fmu, start in zip(self.checked.names, self.checked.fmus, self.checked.start, strict=True)
        }  # fmt: skip
        settings = asdict(self.settings) | {"channels": [c.name for c in self.channels]}
        content = {
            "status": status,
            "message": message,
            "system": self.checked.name,
            "started": self.started_at,
            "wall_time": time.perf_counter() - self.began,
            "time_reached": self.stepper.time if self.stepper else self.settings.start,
            "steps_done": int(self.stepper.plan.steps_done) if self.stepper else 0,
            "component_seconds": self.stepper.seconds() if self.stepper else {},
            "ports": self.stepper.ports() if self.stepper else {},
            "stepping": self.stepper.work() if self.stepper else {},
            "initialisation_passes": self.passes,
            "settings": settings | {"order": [self.checked.names[m.component] for m in self.layout.members]},
            "components": components,
            "connections": [
                f"{self.checked.names[k.source]}.{k.output.name} -> {self.checked.names[k.target]}.{k.input.name}"
                for k in self.checked.links
            ],
            "warnings": self.warnings,
            "versions": versions(),
        }
        write_json(self.folder / "run.json", content)
