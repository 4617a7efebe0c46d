"""Trials of an FMU, in a process that may crash: `trials(...)` is called by `cosim.validation`, never in this one.

Each trial is announced before it begins, so that a process that dies or hangs has said where.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TextIO

import fmpy
from fmpy.fmi2 import FMU2Slave
from fmpy.fmi3 import FMU3Slave

STEPS = 20
SHIFT = 0.37  # of values that are set to others, as a share
SWING = 0.1  # of moving inputs, likewise


class _Skipped(Exception):
    """A trial that this FMU does not call for."""


class _Failed(Exception):
    """A trial that went wrong, in words."""


def main() -> None:
    """Arguments: folder of the unpacked FMU, step in s, file to report to (one JSON object a line)."""
    with Path(sys.argv[3]).open("a", encoding="utf-8") as report:
        trials(Path(sys.argv[1]), float(sys.argv[2]), report)
        print(json.dumps({"end": True}), file=report, flush=True)


def trials(folder: Path, step: float, report: TextIO) -> None:
    """Run all trials on an unpacked FMU, writing what comes of each."""
    fmu = _Fmu(folder, step)

    def run(name: str, trial: Callable[[], str]) -> bool:
        print(json.dumps({"begin": name}), file=report, flush=True)
        try:
            verdict = {"name": name, "status": "ok", "detail": trial()}
        except _Doubtful as reason:
            verdict = {"name": name, "status": "warning", "detail": str(reason)}
        except _Skipped as reason:
            verdict = {"name": name, "status": "skipped", "detail": str(reason)}
        except Exception as error:  # whatever FMPy makes of what the FMU does
            text = " ".join(str(error).split()) or type(error).__name__
            verdict = {"name": name, "status": "fail", "detail": text[:300]}
        print(json.dumps(verdict), file=report, flush=True)
        return verdict["status"] != "fail"

    if not run("start values", fmu.start_values):
        return
    run("memory of set values", fmu.remembers)
    if not run("smoke run", fmu.smoke):
        return
    run("moving inputs", fmu.moves)
    run("repeats itself", fmu.repeats)
    run("reset restarts", fmu.resets)
    run("state restored", fmu.restores)
    run("instances apart", fmu.apart)


class _Doubtful(Exception):
    """Something that need not be wrong, in words."""


class _Fmu:
    """An FMU with the calls of FMI 2.0 and 3.0 brought together, as far as the trials need them."""

    def __init__(self, folder: Path, step: float) -> None:
        self.folder, self.step = folder, step
        self.md: Any = fmpy.read_model_description(str(folder), validate=False)
        self.second = self.md.fmiVersion == "2.0"
        kind = "Real" if self.second else "Float64"
        reals = [r for v in self.md.modelVariables if v.type == kind and v.alias is None for r in _elements(v)]
        self.inputs = [r for r in reals if r.causality == "input"]
        self.outputs = [r for r in reals if r.causality == "output"]
        self.set_at_start = [r for r in reals if r.settable]
        self.first: list[list[float]] = []
        self.moving = False
        self.kept: Any = None

    def make(self) -> Any:
        """A new instance, before its initialisation."""
        kind: Any = FMU2Slave if self.second else FMU3Slave
        slave = kind(
            instanceName="trial", guid=self.md.guid if self.second else self.md.instantiationToken,
            unzipDirectory=str(self.folder), modelIdentifier=self.md.coSimulation.modelIdentifier,
        )  # fmt: skip
        slave.instantiate()
        return slave

    def get(self, slave: Any, reals: Sequence[_Real]) -> list[float]:
        references = self._references(reals)
        if not references:
            return []
        return list(slave.getReal(references) if self.second else slave.getFloat64(references, nValues=len(reals)))

    def put(self, slave: Any, reals: Sequence[_Real], values: Sequence[float]) -> None:
        references = self._references(reals)
        if references:
            (slave.setReal if self.second else slave.setFloat64)(references, list(values))

    def _references(self, reals: Sequence[_Real]) -> list[int]:
        """One for each variable: FMI 2.0's share them as aliases, FMI 3.0's elements as one array."""
        found = [r.reference for r in reals]
        return found if self.second else list(dict.fromkeys(found))

    def initialise(self, slave: Any) -> None:
        self.enter(slave)
        slave.exitInitializationMode()

    def enter(self, slave: Any) -> None:
        """Begin the initialization mode, before which FMI lets no value be read."""
        if self.second:
            slave.setupExperiment(startTime=0.0)
            slave.enterInitializationMode()
        else:
            slave.enterInitializationMode(startTime=0.0)

    def advance(self, slave: Any, n: int) -> None:
        slave.doStep(currentCommunicationPoint=n * self.step, communicationStepSize=self.step)

    def history(self, slave: Any, other: Callable[[int], None] | None = None) -> list[list[float]]:
        """Outputs at the start and after each step, with moving inputs if `moving`; `other` does something between."""
        rows = [self.get(slave, self.outputs)]
        for n in range(STEPS):
            if other is not None:
                other(n)
            if self.moving:
                self.put(
                    slave, self.inputs, [_within(v, SWING * math.sin(0.7 * n + i)) for i, v in enumerate(self.inputs)]
                )
            self.advance(slave, n)
            rows.append(self.get(slave, self.outputs))
        return rows

    def start_values(self) -> str:
        if not self.md.coSimulation.canBeInstantiatedOnlyOncePerProcess:
            self.kept = self.make()  # keeps the library loaded, and what is global in it alive
        slave = self.make()
        self.enter(slave)
        found = self.get(slave, self.set_at_start)
        slave.freeInstance()
        for v, value in zip(self.set_at_start, found, strict=True):
            if not _same(value, v.start):
                raise _Failed(f"{v.name} starts at {value:g}, not at {v.start:g} as its description says")
        return f"{len(found)} as described"

    def remembers(self) -> str:
        """A value set before initialisation is read back."""
        slave, wanted = self.make(), [_other(v) for v in self.set_at_start]
        self.put(slave, self.set_at_start, wanted)
        self.enter(slave)
        found = self.get(slave, self.set_at_start)
        slave.freeInstance()
        for v, want, value in zip(self.set_at_start, wanted, found, strict=True):
            if not _same(value, want):
                raise _Failed(f"{v.name} was set to {want:g} and reads {value:g}")
        return f"{len(wanted)} read back"

    def smoke(self) -> str:
        slave = self.make()
        self.initialise(slave)
        self.first = self.history(slave)
        slave.terminate()
        slave.freeInstance()
        for n, row in enumerate(self.first):
            for v, value in zip(self.outputs, row, strict=True):
                if not math.isfinite(value):
                    raise _Failed(f"{v.name} = {value} at t = {n * self.step:g} s")
        return f"{STEPS} steps of {self.step:g} s, {len(self.outputs)} real outputs finite"

    def moves(self) -> str:
        """What follows compares runs in which something happens; without inputs to move, runs as they are."""
        if not self.inputs:
            raise _Skipped("has no real input")
        self.moving = True
        try:
            slave = self.make()
            self.initialise(slave)
            rows = self.history(slave)
            slave.freeInstance()
            if not all(math.isfinite(x) for row in rows for x in row):
                raise _Failed("an output is not finite")
        except Exception as error:
            self.moving = False
            text = " ".join(str(error).split())
            raise _Doubtful(f"does not take inputs other than their start values: {text}") from error
        self.first = rows
        changed = sum(any(row[i] != rows[0][i] for row in rows) for i in range(len(self.outputs)))
        return f"{changed} of {len(self.outputs)} outputs follow"

    def repeats(self) -> str:
        slave = self.make()
        self.initialise(slave)
        rows = self.history(slave)
        slave.freeInstance()
        return self._compare(rows, "a second run of the same differs")

    def resets(self) -> str:
        slave = self.make()
        self.put(slave, self.inputs, [_other(v) for v in self.inputs])
        self.initialise(slave)
        for n in range(STEPS):
            self.advance(slave, n)
        slave.reset()
        self.initialise(slave)
        rows = self.history(slave)
        slave.freeInstance()
        return self._compare(rows, "after a reset it is not as new")

    def restores(self) -> str:
        if not self.md.coSimulation.canGetAndSetFMUstate:
            raise _Skipped("declares no canGetAndSetFMUstate; steps are then never repeated")
        slave = self.make()
        self.initialise(slave)
        get, put, free = (getattr(slave, f"{w}FMU{'s' if self.second else 'S'}tate") for w in ("get", "set", "free"))
        state = get()
        self.history(slave)
        put(state)
        rows = self.history(slave)
        free(state)
        slave.freeInstance()
        return self._compare(rows, "after its state was restored it goes elsewhere")

    def apart(self) -> str:
        """What one instance does must not reach the other."""
        if self.md.coSimulation.canBeInstantiatedOnlyOncePerProcess:
            raise _Skipped("declares canBeInstantiatedOnlyOncePerProcess; --isolate runs each in its own")
        other, slave = self.make(), self.make()
        self.put(other, self.inputs, [_other(v) for v in self.inputs])
        self.initialise(other)
        self.initialise(slave)

        def disturb(n: int) -> None:
            with suppress(Exception):  # it may not like its inputs
                self.advance(other, n)
                self.get(other, self.outputs)

        rows = self.history(slave, disturb)
        other.freeInstance()
        rows += [self.get(slave, self.outputs)]
        slave.freeInstance()
        return self._compare(rows[:-1], "another instance beside it changes it")

    def _compare(self, rows: list[list[float]], what: str) -> str:
        for n, (a, b) in enumerate(zip(self.first, rows, strict=True)):
            for v, x, y in zip(self.outputs, a, b, strict=True):
                if x != y:
                    raise _Failed(f"{what}: {v.name} = {y:.6g} instead of {x:.6g} at t = {n * self.step:g} s")
        return "to the last bit"


@dataclass(frozen=True)
class _Real:
    """A real variable, or one element of an array; those of an array follow one another and share the reference."""

    name: str
    reference: int
    causality: str
    start: float
    low: float
    high: float
    settable: bool


def _elements(v: Any) -> list[_Real]:
    """Elements of a variable; of an array whose size another variable gives, none."""
    sizes = [int(d.start) if d.start is not None else 0 for d in v.dimensions or ()]
    count = math.prod(sizes)
    starts = [float(text) for text in str(v.start).split()] if v.start is not None else []
    starts = starts * count if len(starts) == 1 else starts
    settable = bool(starts) and v.causality in ("parameter", "input") and v.variability != "constant"
    low, high = (float(b) if b is not None else math.copysign(math.inf, s) for b, s in ((v.min, -1.0), (v.max, 1.0)))
    return [
        _Real(f"{v.name}[{i + 1}]" if sizes else v.name, v.valueReference, v.causality or "local",
              starts[i] if i < len(starts) else 0.0, low, high, settable)
        for i in range(count)
    ]  # fmt: skip


def _other(r: _Real) -> float:
    """Another value that the variable may take."""
    return next((value for share in (SHIFT, -SHIFT, 1e-3) if (value := _within(r, share)) != r.start), r.start)


def _within(r: _Real, share: float) -> float:
    """The start value moved by a share of it (of 1, if it is smaller); itself where that is out of bounds."""
    value = r.start + share * max(1.0, abs(r.start))
    return value if r.low <= value <= r.high else r.start


def _same(a: float, b: float) -> bool:
    return a == b or abs(a - b) <= 1e-12 * max(abs(a), abs(b)) or (math.isnan(a) and math.isnan(b))
