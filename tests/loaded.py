"""An FMU extracted for direct calls, as an importing tool makes them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import fmpy
import fmpy.fmi2
import pytest
from fmpy.fmi1 import FMICallException


class Loaded:
    """One FMU, extracted once; instances of it keep their log lines in `messages`."""

    def __init__(self, path: Path, folder: Path) -> None:
        self.description = fmpy.read_model_description(str(path))
        self.folder = folder
        fmpy.extract(str(path), unzipdir=str(folder))
        self.reference = {v.name: v.valueReference for v in self.description.modelVariables}
        self.messages: list[str] = []

    def instance(self, name: str = "one") -> fmpy.fmi2.FMU2Slave:
        slave = fmpy.fmi2.FMU2Slave(
            guid=self.description.guid,
            unzipDirectory=str(self.folder),
            modelIdentifier=self.description.coSimulation.modelIdentifier,
            instanceName=name,
        )
        callbacks = fmpy.fmi2.fmi2CallbackFunctions()
        callbacks.logger = fmpy.fmi2.fmi2CallbackLoggerTYPE(self._log)
        callbacks.allocateMemory = fmpy.fmi2.fmi2CallbackAllocateMemoryTYPE(fmpy.fmi2.calloc)
        callbacks.freeMemory = fmpy.fmi2.fmi2CallbackFreeMemoryTYPE(fmpy.fmi2.free)
        slave.instantiate(callbacks=callbacks)
        return slave

    def _log(self, environment: Any, name: bytes, status: int, category: bytes, message: bytes) -> None:
        self.messages.append(message.decode())

    def vr(self, *names: str) -> list[int]:
        return [self.reference[n] for n in names]


def initialised(fmu: Loaded, values: dict[str, float] | None = None) -> fmpy.fmi2.FMU2Slave:
    slave = fmu.instance()
    slave.setupExperiment(startTime=0.0)
    if values:
        slave.setReal(fmu.vr(*values), list(values.values()))
    slave.enterInitializationMode()
    slave.exitInitializationMode()
    return slave


def refusal(fmu: Loaded, call: Callable[[], object]) -> str:
    """The message with which the FMU refuses a call."""
    with pytest.raises(FMICallException):
        call()
    return fmu.messages[-1]
