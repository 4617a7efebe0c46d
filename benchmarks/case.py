"""What every contender gets to step: a system on disk, as SSP, with its values read out once for those that need them.

Only the standard library is imported here, as each contender's process imports this module.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

Value = float | int | bool | str


@dataclass(frozen=True)
class Case:
    """A system ready to be stepped.

    Attributes:
        folder: of SystemStructure.ssd and resources/; `archive` is the same as .ssp.
        components: names.
        start: start values by component and variable, in the FMU's units: the parameter bindings of the .ssd.
        initial: value of each connected input once the initialised system has settled, by component and variable.
        compared: outputs "component.variable" that every contender records, and must agree on.
        step: communication step, s.
        stop: simulated time, s, where a contender is not given its own.
    """

    name: str
    description: str
    folder: Path
    archive: Path
    components: tuple[str, ...]
    start: Mapping[str, Mapping[str, Value]]
    initial: Mapping[str, Mapping[str, float]]
    compared: tuple[str, ...]
    step: float
    stop: float


@dataclass(frozen=True)
class Sample:
    """One run of one contender.

    Attributes:
        steps: communication steps timed (all, or all but the first).
        seconds: wall time of them. cpu_seconds: of all threads. total_seconds: of the run with loading and results.
        peak_memory: of the contender's process, B; nan where the platform does not say.
        series: compared outputs at the end of each communication step.
        component_seconds: wall time inside each FMU, where the contender tells.
    """

    steps: int
    seconds: float
    cpu_seconds: float
    total_seconds: float
    peak_memory: float
    series: Mapping[str, list[float]] = field(repr=False, default_factory=dict)
    component_seconds: Mapping[str, float] = field(default_factory=dict)

    @property
    def per_step(self) -> float:
        """Wall time of a communication step, s."""
        return self.seconds / self.steps

    @property
    def cpu_per_step(self) -> float:
        """CPU time of a communication step, s: what a busy machine changes least."""
        return self.cpu_seconds / self.steps
