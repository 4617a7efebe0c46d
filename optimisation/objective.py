"""The fitness of a damper design (Wang et al. 2022, eqs. 13-14), evaluated on the simplified model's FMU."""

from __future__ import annotations

import math
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Self, cast, get_args

import numpy as np
import numpy.typing as npt
from fmpy import extract, read_model_description
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import (
    FMU2Slave,
    defaultCallbacks,
    fmi2CallbackFunctions,
    fmi2CallbackLoggerTYPE,
    fmi2Fatal,
    fmi2Warning,
)

from optimisation.stability import check_parameters

Array = npt.NDArray[np.float64]
DamperName = Literal["tmd-n", "tmd-p", "mtmd", "tlcd-p", "tmdi-n"]
PUBLISHED: tuple[DamperName, ...] = ("tmd-n", "tmd-p", "mtmd")  # the paper's, which the simplified model has
FITNESS = "tower_top_displacement_std"
BASE_UNITS = {"N/m": {"kg": 1, "s": -2}, "N.s/m": {"kg": 1, "s": -1}, "kg": {"kg": 1}, "1": {}}


@dataclass(frozen=True)
class DesignVariable:
    """A parameter to be tuned, with its bounds (those of eq. 14; its second line names the nacelle twice).

    Attributes:
        name: of the FMU's variable, such as "nacelle_damper.k".
        unit: of bounds and result; "" for none.
        base: the unit's exponents of SI base units, as FMI and SSP have them, such as {"kg": 1, "s": -2}.
    """

    name: str
    lower: float
    upper: float
    unit: str
    base: Mapping[str, int | float] = field(default_factory=dict)


@dataclass(frozen=True)
class Design:
    """What is tuned for one damper arrangement.

    Attributes:
        damper: arrangement.
        variables: in the order of a candidate's values.
        switches: which dampers are there.
        paper_fitness, paper_parameters: of the published optimum (table 4); m, and in the order of `variables`; nan and
            none for dampers that the paper and the simplified model do not have.
    """

    damper: DamperName
    variables: tuple[DesignVariable, ...]
    switches: dict[str, float]
    paper_fitness: float
    paper_parameters: tuple[float, ...]


def design(damper: str) -> Design:
    """Design variables of a damper arrangement.

    Raises:
        ValueError: no such arrangement.
    """
    published = {
        "tmd-n": (0.4881, (6302.0, 1598.0)),
        "tmd-p": (0.3863, (53_565.0, 13_839.0)),
        "mtmd": (0.3735, (7653.0, 4013.0, 52_597.0, 11_911.0)),
    }
    other = {
        "tlcd-p": (("platform_damper.ratio", 0.5, 5.0, "1"), ("platform_damper.xi", 0.0, 30.0, "1")),
        "tmdi-n": (
            *((f"nacelle_damper.{n}", 0.0, 50_000.0, unit) for n, unit in (("k", "N/m"), ("c", "N.s/m"))),
            ("nacelle_damper.b", 0.0, 20_000.0, "kg"),
            *((f"nacelle_damper.{n}", 0.0, 5000.0, unit) for n, unit in (("k_s", "N/m"), ("c_s", "N.s/m"))),
        ),
    }  # fmt: skip
    if damper in other:
        own = tuple(DesignVariable(n, low, high, unit, BASE_UNITS[unit]) for n, low, high, unit in other[damper])
        return Design(cast(DamperName, damper), own, {}, math.nan, ())
    if damper not in published:
        raise ValueError(f"unknown damper '{damper}': choose one of {', '.join(get_args(DamperName))}")
    places = {"nacelle_damper": (50_000.0, damper != "tmd-p"), "platform_damper": (200_000.0, damper != "tmd-n")}
    variables = tuple(
        DesignVariable(f"{place}.{name}", 0.0, upper, unit, BASE_UNITS[unit])
        for place, (upper, present) in places.items()
        if present
        for name, unit in (("k", "N/m"), ("c", "N.s/m"))
    )
    switches = {f"{place}.active": float(present) for place, (_, present) in places.items()}
    return Design(cast(DamperName, damper), variables, switches, *published[damper])


def with_bounds(task: Design, bounds: Mapping[str, tuple[float, float]]) -> Design:
    """The design with other bounds of its variables, by name.

    Raises:
        ValueError: no such variable, or the bounds are not finite, at least 0 and ascending.
    """
    names = [v.name for v in task.variables]
    for name, (lower, upper) in bounds.items():
        if name not in names:
            raise ValueError(f"bounds of '{name}': {task.damper} is tuned by {', '.join(names)}")
        if not (np.isfinite(upper) and 0.0 <= lower < upper):
            raise ValueError(f"bounds of {name}, {lower:g}:{upper:g}: give 0 <= LOW < HIGH")
    variables = tuple(
        replace(v, lower=bounds[v.name][0], upper=bounds[v.name][1]) if v.name in bounds else v for v in task.variables
    )
    return replace(task, variables=variables)


def with_variables(task: Design, variables: Mapping[str, tuple[float, float]]) -> Design:
    """The design with further variables, by name with their bounds; one that it has gets these bounds.

    Raises:
        ValueError: bounds are not finite and ascending, or the variable switches a damper on or off.
    """
    for name, (lower, upper) in variables.items():
        if name in task.switches:
            raise ValueError(f"variable {name}: {task.damper} sets it; choose another damper instead")
        if not (np.isfinite(lower) and np.isfinite(upper) and lower < upper):
            raise ValueError(f"variable {name}={lower:g}:{upper:g}: the lower bound comes first, both finite")
    known = {v.name: v for v in task.variables}
    new = {
        name: replace(known.get(name, DesignVariable(name, lower, upper, "")), lower=lower, upper=upper)
        for name, (lower, upper) in variables.items()
    }
    return replace(task, variables=tuple((known | new).values()))


class TowerTopDeviation:
    """Standard deviation of the tower-top displacement over a free decay: one `doStep` of the FMU per candidate.

    Each worker thread has an FMU instance of its own, reset for every candidate; the FMU's code runs outside Python's
    interpreter lock. Results do not depend on the number of workers.

    Args:
        fmu: the simplified model; the file, or the folder that it was unpacked into.
        variables: names of the parameters that a candidate gives.
        parameters: values of others, the same for all candidates (an identified parameter set, say).
        horizon: length of the decay, s (paper: not given; 100 s reproduces table 4).
        workers: threads.

    Attributes:
        shape: of a candidate's fitness.
        first_failure: message of the first candidate that could not be evaluated, or None.

    Raises:
        ValueError: the FMU lacks one of the variables, or is no co-simulation FMU; a parameter is outside its limits,
            or the structure is unstable with them.
    """

    shape: tuple[int, ...] = ()

    def __init__(
        self,
        fmu: Path,
        variables: Sequence[str],
        parameters: Mapping[str, float] | None = None,
        *,
        horizon: float = 100.0,
        workers: int = 1,
    ) -> None:
        if workers < 1 or not horizon > 0.0:
            raise ValueError(f"{fmu.name}: the objective needs workers >= 1 and a horizon above 0 s")
        self.names, self.fixed, self.horizon = tuple(variables), dict(parameters or {}), horizon
        self.first_failure: str | None = None
        self._description = read_model_description(str(fmu))
        known = {v.name: v for v in self._description.modelVariables}
        for name in (*self.names, *self.fixed, FITNESS):
            if name not in known:
                raise ValueError(f"{fmu.name} has no variable '{name}': is it the simplified model's FMU?")
        if self._description.coSimulation is None:
            raise ValueError(f"{fmu.name} is no co-simulation FMU: export it with co-simulation")
        check_parameters(self._description, self.fixed)
        self._known = known
        self._temporary = None if fmu.is_dir() else tempfile.mkdtemp(prefix="fowt-fmu-")
        self._folder = self._temporary or str(fmu)
        if self._temporary:
            extract(str(fmu), self._temporary)
        self._workers = workers
        self._messages: list[str] = []
        self._callbacks = _collecting(self._messages)
        self._slaves: list[Any] = [self._instantiate() for _ in range(workers)]

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Free the instances and the unpacked FMU."""
        for slave in self._slaves:
            slave.freeInstance()
        self._slaves = []
        if self._temporary:
            shutil.rmtree(self._temporary, ignore_errors=True)

    def __call__(self, candidates: Array) -> Array:
        """Fitness in m, shape (n, *shape), of candidates of shape (n, variables); nan where the simulation failed."""
        parts = np.array_split(np.arange(len(candidates)), self._workers)

        def part(worker: int) -> Array:
            found = [self._evaluate(worker, candidates[i]) for i in parts[worker]]
            return np.array(found, dtype=float).reshape(-1, *self.shape)

        if self._workers == 1:
            return part(0)
        with ThreadPoolExecutor(self._workers) as pool:
            return np.concatenate(list(pool.map(part, range(self._workers))))

    def _instantiate(self) -> Any:
        description = self._description
        slave = FMU2Slave(
            guid=description.guid,
            unzipDirectory=self._folder,
            modelIdentifier=description.coSimulation.modelIdentifier,
            instanceName="objective",
        )
        slave.instantiate(callbacks=self._callbacks)
        return slave

    def _evaluate(self, worker: int, candidate: Array) -> Any:
        slave = self._slaves[worker]
        values = self.fixed | dict(zip(self.names, candidate.tolist(), strict=True))
        try:
            slave.reset()
            self._set(slave, values)
            slave.setupExperiment(startTime=0.0, stopTime=self.horizon)
            slave.enterInitializationMode()
            slave.exitInitializationMode()
            fitness = self._simulate(slave)
            problem = None if np.isfinite(fitness).all() else f"{FITNESS} = {fitness}"
        except FMICallException as error:
            # a failed instance is replaced, as FMI promises little about its state; a fatal one must not be touched
            if error.status != fmi2Fatal:
                slave.freeInstance()
            self._slaves[worker] = self._instantiate()
            fitness, problem = np.full(self.shape, np.nan), self._messages[-1] if self._messages else str(error)
        if problem is not None and self.first_failure is None:
            at = ", ".join(f"{n} = {v:.6g}" for n, v in values.items() if n in self.names)
            self.first_failure = f"{problem} at {at}"
        return fitness

    def _simulate(self, slave: Any) -> Any:
        slave.doStep(currentCommunicationPoint=0.0, communicationStepSize=self.horizon)
        return float(slave.getReal([self._known[FITNESS].valueReference])[0])

    def _set(self, slave: Any, values: Mapping[str, float]) -> None:
        for name, value in values.items():
            variable = self._known[name]
            if variable.type == "Boolean":
                slave.setBoolean([variable.valueReference], [bool(value)])
            elif variable.type == "Integer":
                slave.setInteger([variable.valueReference], [int(value)])
            else:
                slave.setReal([variable.valueReference], [float(value)])


def _collecting(messages: list[str]) -> Any:
    """FMI callbacks that keep the FMU's messages about errors instead of printing them."""

    def log(environment: Any, instance: bytes, status: int, category: bytes, message: bytes | None) -> None:
        if status > fmi2Warning and message:
            messages[:] = [message.decode("utf-8", "replace").replace("%%", "%")]

    callbacks = fmi2CallbackFunctions()
    callbacks.logger = fmi2CallbackLoggerTYPE(log)
    callbacks.allocateMemory = defaultCallbacks.allocateMemory
    callbacks.freeMemory = defaultCallbacks.freeMemory
    return callbacks
