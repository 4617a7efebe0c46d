"""The stepping of a laid-out system with FMU instances: the kernel's plan, its execution and its failures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from cosim import kernel
from cosim.errors import CosimError, RunFailed
from cosim.instance import Instance
from cosim.layout import ITERATED, Algorithm, Extrapolation, Layout

ORDERS = {"held": 0, "linear": 1, "quadratic": 2}
SINGLE_PASS, FIXED_POINT, NEWTON = range(3)
# |value| beyond this times its nominal is an explosion: no quantity of a wind turbine in SI units comes near.
EXPLOSION = 1e15
ROWS = 2048


@dataclass(frozen=True)
class Stepping:
    """How a layout is stepped.

    Attributes:
        start, step: s. decimation: steps per recorded row.
        tolerance: relative, of algebraic loops and iterations; None: 1e-5, and 1e-10 where steps are iterated.
        energy_tolerance: share of a port's power above which a step is halved; 0: never.
    """

    start: float
    step: float
    decimation: int
    algorithm: Algorithm
    extrapolation: Extrapolation
    tolerance: float | None = None
    energy_tolerance: float = 0.0


class Stepper:
    """Runs a layout with FMU instances in the kernel; time is start + steps * step, never accumulated."""

    def __init__(self, layout: Layout, instances: Sequence[Instance], how: Stepping) -> None:
        self.layout = layout
        self.instances = instances
        self._library = kernel.library()
        self._begun = False
        self._arrays = _arrays(layout)
        self.now, self.rows = self._arrays["now"], self._arrays["rows"]
        self._members = (kernel.MemberStruct * len(layout.members))()
        self._pairs = (kernel.PairStruct * max(1, len(layout.pairs)))(*(kernel.PairStruct(*p) for p in layout.pairs))
        self._ports = (kernel.PortStruct * max(1, len(layout.ports)))()
        iterated = how.algorithm in ITERATED
        tolerance = how.tolerance or (1e-10 if iterated else 1e-5)
        self.plan = kernel.PlanStruct(
            members=self._members, n_members=len(layout.members), n_values=len(layout.reads),
            n_inputs=len(layout.inputs), n_late=len(layout.late), n_tear=len(layout.tear),
            pairs=self._pairs, n_pairs=len(layout.pairs), ports=self._ports, n_ports=len(layout.ports),
            n_channels=len(layout.channel), start=how.start, step=how.step, decimation=how.decimation,
            order=ORDERS[how.extrapolation], tolerance=tolerance, energy_tolerance=how.energy_tolerance,
            scheme={"iterated": FIXED_POINT, "newton": NEWTON}.get(how.algorithm, SINGLE_PASS), time=how.start,
            slow=any(m.every > 1 for m in layout.members),
            **{name: array.ctypes.data for name, array in self._arrays.items() if hasattr(kernel.PlanStruct, name)},
        )  # fmt: skip
        self._fill_members(saving=iterated or how.energy_tolerance > 0.0)
        self._read_anew(everything=True)

    def _fill_members(self, saving: bool) -> None:
        first_read = first_input = 0
        for member, m in zip(self._members, self.layout.members, strict=True):
            instance = self.instances[m.component]
            for field, address in instance.member().items():
                setattr(member, field, address)
            if saving and member.get_state is None:
                raise CosimError(
                    f"{instance.name}: {instance.fmu.path.name} cannot save its state (canGetAndSetFMUstate), which"
                    " iterated steps need; use algorithm gauss-seidel"
                )
            member.first_read, member.first_input = first_read, first_input
            member.reads[:], member.inputs[:] = m.reads, m.inputs
            for name in ("derived", "varying", "iterated", "every", "substeps"):
                setattr(member, name, getattr(m, name))
            first_read += sum(m.reads)
            first_input += sum(m.inputs)
        usable = all(member.get_state for member in self._members) and not self.plan.slow
        self.plan.reversible = usable

    def _read_anew(self, everything: bool) -> None:
        """Choose what an exchange reads anew: all components (initialisation), or those that a step leaves stale."""
        which = "every_backward" if everything else "backward"
        self.plan.n_backward = len(getattr(self.layout, which))
        self.plan.backward = self._arrays[which].ctypes.data
        self.plan.backward_tear = self._arrays[f"{which}_tear"].ctypes.data
        for member, m in zip(self._members, self.layout.members, strict=True):
            member.stale = everything or m.stale

    @property
    def time(self) -> float:
        """Time reached, s."""
        return float(self.plan.start + self.plan.steps_done * self.plan.step)

    def initialise(self) -> int:
        """Propagate the connected values, in initialisation mode, and solve algebraic loops.

        Returns:
            sweeps over the components that this took.

        Raises:
            RunFailed: an FMU failed, or a loop has no solution that is found.
        """
        self._check(self._library.read_all(self.plan, 0))
        self._check(self._library.settle(self.plan))
        return int(self.plan.sweeps)

    def begin(self) -> None:
        """Read the initialised state as the first row, and linearise algebraic loops."""
        self._check(self._library.settle(self.plan))
        self._check(self._library.read_all(self.plan, 1))
        self._check(self._library.linearise(self.plan))
        self._read_anew(everything=False)
        self.plan.sweeps = 0
        self._begun = True
        self._library.record(self.plan)

    def advance(self, steps: int) -> None:
        """Take steps, at most `capacity()`.

        Raises:
            RunFailed: an FMU failed, a value is not finite, or an iteration does not converge.
        """
        self._check(self._library.run_steps(self.plan, steps))

    def capacity(self) -> int:
        """Steps until the row buffer may be full."""
        return int((ROWS - self.plan.rows_used) * self.plan.decimation)

    def take_rows(self) -> npt.NDArray[np.float64]:
        """Rows recorded since the last call, shape (rows, 1 + channels)."""
        taken = self.rows[: self.plan.rows_used].copy()
        self.plan.rows_used = 0
        return taken

    def seconds(self) -> dict[str, float]:
        """Wall time spent in each component, by name: that of every fifth step, scaled to all."""
        done = self.plan.steps_done
        timed = (done + kernel.TIMED_EVERY - 1) // kernel.TIMED_EVERY
        share = done / timed if timed else 0.0
        members = zip(self.layout.members, self._members, strict=True)
        return {self.instances[m.component].name: member.seconds * share for m, member in members}

    def ports(self) -> dict[str, dict[str, float]]:
        """Energies of each mechanical port, J: what crossed it, and the coupling's residual; `share` of the former."""
        ports = zip(self.layout.ports, self._ports, strict=False)  # the array has one element at least
        return {
            name: {
                "crossed": port.crossed,
                "residual": port.residual,
                "share": abs(port.residual) / port.crossed if port.crossed > 0.0 else 0.0,
            }
            for name, port in ports
        }

    def work(self) -> dict[str, int]:
        """How often steps were attempted, halved and iterated, and outputs read anew."""
        return {name: int(getattr(self.plan, name)) for name in ("attempts", "rejected", "iterations", "sweeps")}

    def close(self) -> None:
        """Give saved states back, before the instances are freed."""
        self._library.release_states(self.plan)

    def _name(self, value: int) -> str:
        component, variable = self.layout.reads[value]
        return f"{self.instances[component].name}.{variable.name}"

    def _input_name(self, number: int) -> str:
        component, variable = self.layout.inputs[number]
        return f"{self.instances[component].name}.{variable.name}"

    def _check(self, fine: int) -> None:
        if fine:
            return
        plan = self.plan
        instance = self.instances[self.layout.members[plan.failed_member].component]
        end = self.time + (plan.step if self._begun else 0.0)  # what a step gave is of its end
        if plan.cause == kernel.NOT_FINITE:
            unit = self.layout.reads[plan.failed_value][1].unit
            raise RunFailed(
                f"{self._name(plan.failed_value)} = {plan.failed_number:g}{f' {unit.name}' if unit else ''}"
                f" at t = {end:.6g} s: the component has become unstable{instance.message()};"
                " reduce the step or check its parameters and inputs"
            )
        if plan.cause in (kernel.NOT_CONVERGED, kernel.LOOP_OPEN):
            raise RunFailed(self._unsolved(plan, end))
        if plan.cause == kernel.SET_FAILED and plan.failed_value >= 0:
            value = f"{self._input_name(plan.failed_value)} = {plan.failed_number:.15g} at t = {self.time:.6g} s"
            raise RunFailed(f"{value}: does not fit an FMI integer of 32 bits; connect what does, or an FMU of FMI 3.0")
        failure = instance.failure(kernel.CAUSES[plan.cause], plan.status, self.time)
        if plan.status == kernel.FATAL:
            self._abandon(instance)
        if plan.cause == kernel.SLOPE_FAILED and (plan.order == 2 or plan.scheme != SINGLE_PASS):
            failure += "; if it takes no second derivatives, use algorithm gauss-seidel with linear extrapolation"
        raise RunFailed(failure)

    def _abandon(self, failed: Instance) -> None:
        """After fmi2Fatal, FMI allows no further call to any instance of the FMU that is in the same process."""
        for member, m in zip(self._members, self.layout.members, strict=True):
            instance = self.instances[m.component]
            if instance is failed or (not instance.apart and instance.fmu.path == failed.fmu.path):
                instance.abandon()
                member.saved = None

    def _unsolved(self, plan: Any, time: float) -> str:
        worst = self._input_name(plan.failed_value)
        if plan.cause == kernel.NOT_CONVERGED:
            remedy = "reduce the step" + (" or use newton" if plan.scheme == FIXED_POINT else "")
            return f"the iterated step to t = {time:.6g} s does not converge at {worst}; {remedy}"
        looped = [path for path in self.layout.loops if worst in path.split(" -> ")] or list(self.layout.loops)
        path = f" (algebraic loop {looped[0]})" if looped else ""
        return f"{worst} does not settle at t = {time:.6g} s{path}; give better start values, or break the loop"


def _arrays(layout: Layout) -> dict[str, npt.NDArray[Any]]:
    """The kernel's arrays by name: what the layout gives, and work space."""
    n_values, n_inputs, n_tear = len(layout.reads), len(layout.inputs), len(layout.tear)
    n_back = max(len(layout.every_backward), len(layout.late))
    longest = max(n_values, n_inputs, 2 * n_back, 1)
    place = {int(i): j for j, i in enumerate(layout.tear)}
    arrays: dict[str, npt.NDArray[Any]] = {
        "read_reference": np.array([v.reference for _, v in layout.reads], dtype=np.uint32),
        "input_reference": np.array([v.reference for _, v in layout.inputs], dtype=np.uint32),
        "limit": EXPLOSION * np.maximum(1.0, layout.scales()),
        "scale": layout.scales(),
        "rows": np.zeros((ROWS, 1 + len(layout.channel))),
        "integers": np.zeros(longest, dtype=np.int32),
        "first_order": np.ones(longest, dtype=np.int32),
        "second_order": np.full(longest, 2, dtype=np.int32),
        "derivatives": np.zeros(longest),
        "jacobian": np.zeros((n_tear, n_tear)),
        "matrix": np.zeros((n_tear, n_tear)),
        "correction": np.zeros(2 * n_tear),
        "seed": np.zeros(longest),
        "response": np.zeros(n_values),
        "last_bend": np.zeros(len(layout.pairs)),
    }
    arrays |= {name: np.zeros(n_values) for name in ("now", "next", "mid", "rate", "slope", "bend")}
    arrays |= {name: np.zeros(n_inputs) for name in ("value", "input_slope", "input_bend", "begun")}
    arrays |= {name: np.zeros(n_back) for name in ("mid_used", "end_used", "mid_before", "end_before")}
    for name in ("owner", "target", "source", "mode", "factor", "offset", "tear", "late", "backward", "every_backward"):
        arrays[name] = getattr(layout, name)
    for name in ("late", "backward", "every_backward"):
        arrays[f"{name}_tear"] = np.array([place.get(int(i), -1) for i in arrays[name]], dtype=np.int32)
    for name in ("channel", "channel_factor", "channel_offset"):
        arrays[name] = getattr(layout, name)
    return arrays
