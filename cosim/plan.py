"""The step plan: a checked system compiled into the flat arrays of the kernel, and its execution."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from cosim import kernel
from cosim.checks import CheckedSystem
from cosim.errors import RunFailed
from cosim.fmu import FmuVariable, Instance
from cosim.recording import SelectedChannel

Algorithm = Literal["gauss-seidel", "jacobi"]
Extrapolation = Literal["linear", "held"]
TYPES = ("Real", "Integer", "Boolean")
HELD, HELD_NEXT, EXTRAPOLATED, INTERPOLATED = range(4)
# |value| beyond this times its nominal is an explosion: no quantity of a wind turbine in SI units comes near.
EXPLOSION = 1e15
ROWS = 2048


@dataclass(frozen=True)
class Layout:
    """Flat arrays of the kernel; members are in stepping order, values and inputs of a member are contiguous.

    Attributes:
        order: component index of each member.
        reads: (component index, variable) of each value; likewise `inputs`.
        counts: per member, values and inputs by type, shape (members, 2, 3).
        source, mode, factor, offset: of each input.
        channel, channel_factor, channel_offset: value index and conversion of each channel.
    """

    order: tuple[int, ...]
    reads: tuple[tuple[int, FmuVariable], ...]
    inputs: tuple[tuple[int, FmuVariable], ...]
    counts: npt.NDArray[np.int32]
    source: npt.NDArray[np.int32]
    mode: npt.NDArray[np.int32]
    factor: npt.NDArray[np.float64]
    offset: npt.NDArray[np.float64]
    channel: npt.NDArray[np.int32]
    channel_factor: npt.NDArray[np.float64]
    channel_offset: npt.NDArray[np.float64]

    def scales(self) -> npt.NDArray[np.float64]:
        """Magnitude of each value, for tolerances and limits: its nominal, 1 if none."""
        return np.array([max(1.0, abs(v.nominal or 1.0)) for _, v in self.reads])


def lay_out(
    system: CheckedSystem,
    order: Sequence[int],
    channels: Sequence[SelectedChannel],
    algorithm: Algorithm,
    extrapolation: Extrapolation,
) -> Layout:
    """Compile a system into arrays."""
    wanted = {(k.source, k.output.name): k.output for k in system.links}
    wanted |= {(c.component, c.variable.name): c.variable for c in channels}
    place = {component: position for position, component in enumerate(order)}

    def by_member(item: tuple[int, FmuVariable]) -> tuple[int, int]:
        return place[item[0]], _type(item[1])

    reads = sorted(((c, v) for (c, _), v in wanted.items()), key=by_member)
    number = {(c, v.name): i for i, (c, v) in enumerate(reads)}
    links = sorted(system.links, key=lambda k: by_member((k.target, k.input)))
    inputs = [(k.target, k.input) for k in links]
    counts = np.zeros((len(order), 2, 3), dtype=np.int32)
    for which, items in enumerate((reads, inputs)):
        for component, variable in items:
            counts[place[component], which, _type(variable)] += 1

    def mode(source: int, target: int, kind: str) -> int:
        advanced = algorithm == "gauss-seidel" and place[source] < place[target]
        if extrapolation == "held" or kind != "Real":
            return HELD_NEXT if advanced else HELD
        return INTERPOLATED if advanced else EXTRAPOLATED

    return Layout(
        order=tuple(order),
        reads=tuple(reads),
        inputs=tuple(inputs),
        counts=counts,
        source=np.array([number[k.source, k.output.name] for k in links], dtype=np.int32),
        mode=np.array([mode(k.source, k.target, k.output.type) for k in links], dtype=np.int32),
        factor=np.array([k.factor for k in links], dtype=float),
        offset=np.array([k.offset for k in links], dtype=float),
        channel=np.array([number[c.component, c.variable.name] for c in channels], dtype=np.int32),
        channel_factor=np.array([c.factor for c in channels], dtype=float),
        channel_offset=np.array([c.offset for c in channels], dtype=float),
    )


class Stepper:
    """Runs a layout with FMU instances in the kernel; time is start + steps * step, never accumulated."""

    def __init__(
        self, layout: Layout, instances: Sequence[Instance], start: float, step: float, decimation: int
    ) -> None:
        self.layout = layout
        self.instances = instances
        self._library = kernel.library()
        self._begun = False
        n_values, n_inputs = len(layout.reads), len(layout.inputs)
        longest = max(n_values, n_inputs, 1)
        self.now = np.zeros(n_values)
        self.before = np.zeros(n_values)
        self.rows = np.zeros((ROWS, 1 + len(layout.channel)))
        self._arrays: dict[str, npt.NDArray[Any]] = {
            "before": self.before,
            "now": self.now,
            "next": np.zeros(n_values),
            "read_reference": np.array([v.reference for _, v in layout.reads], dtype=np.uint32),
            "limit": EXPLOSION * layout.scales(),
            "input_reference": np.array([v.reference for _, v in layout.inputs], dtype=np.uint32),
            "value": np.zeros(n_inputs),
            "slope": np.zeros(n_inputs),
            "integers": np.zeros(longest, dtype=np.int32),
            "orders": np.ones(longest, dtype=np.int32),
            "rows": self.rows,
        }
        for name in ("source", "mode", "factor", "offset", "channel", "channel_factor", "channel_offset"):
            self._arrays[name] = getattr(layout, name)
        self._members = (kernel.MemberStruct * len(layout.order))()
        self.plan = kernel.PlanStruct(
            members=self._members, n_members=len(layout.order), n_values=n_values, n_channels=len(layout.channel),
            start=start, step=step, decimation=decimation,
            **{name: array.ctypes.data for name, array in self._arrays.items()},
        )  # fmt: skip
        first = np.zeros(2, dtype=int)
        for member, component, counts in zip(self._members, layout.order, layout.counts, strict=True):
            for field, address in instances[component].member().items():
                setattr(member, field, address)
            member.first_read, member.first_input = (int(f) for f in first)
            member.reads[:], member.inputs[:] = counts[0].tolist(), counts[1].tolist()
            first += counts.sum(axis=1)

    @property
    def time(self) -> float:
        """Time reached, s."""
        return float(self.plan.start + self.plan.steps_done * self.plan.step)

    def initialise(self, passes: int = 100, tolerance: float = 1e-9) -> tuple[int, str]:
        """Propagate the connected values, in initialisation mode, until they no longer change.

        Returns:
            passes needed, and a warning naming the worst values if they were not enough ("" else).
        """
        self._check(self._library.read_all(self.plan, 0))
        scale = self.layout.scales()
        for done in range(1, passes + 1):
            old = self.now.copy()
            self._check(self._library.propagate(self.plan))
            with np.errstate(invalid="ignore"):
                error = np.abs(self.now - old) / np.maximum(scale, np.abs(self.now))
            if not np.any(error > tolerance):
                return done, ""
        worst = [i for i in np.argsort(-error)[:3] if error[i] > tolerance]
        names = ", ".join(f"{self._name(int(i))} (relative change {error[i]:.1e})" for i in worst)
        return passes, f"initial values not settled after {passes} passes: {names}; give better start values"

    def begin(self) -> None:
        """Read the initialised state, as the first row and the values before the first step."""
        self._check(self._library.propagate(self.plan))
        self._check(self._library.read_all(self.plan, 1))
        self.before[:] = self.now
        self._begun = True
        self._library.record(self.plan)

    def advance(self, steps: int) -> None:
        """Take steps, at most `capacity()`.

        Raises:
            RunFailed: an FMU failed, or a value is not finite.
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
        return {
            self.instances[c].name: m.seconds * share for c, m in zip(self.layout.order, self._members, strict=True)
        }

    def _name(self, value: int) -> str:
        component, variable = self.layout.reads[value]
        return f"{self.instances[component].name}.{variable.name}"

    def _check(self, fine: int) -> None:
        if fine:
            return
        plan = self.plan
        instance = self.instances[self.layout.order[plan.failed_member]]
        if plan.cause == kernel.NOT_FINITE:
            unit = self.layout.reads[plan.failed_value][1].unit
            time = self.time + (plan.step if self._begun else 0.0)  # a value that a step gave is that of its end
            raise RunFailed(
                f"{self._name(plan.failed_value)} = {plan.failed_number:g}{f' {unit.name}' if unit else ''}"
                f" at t = {time:.6g} s: the component has become unstable{instance.message()};"
                " reduce the step or check its parameters and inputs"
            )
        if plan.status == kernel.FATAL:
            instance.abandon()
        raise RunFailed(
            f"{instance.name}: {kernel.CAUSES[plan.cause]} returned {kernel.status_name(plan.status)}"
            f" at t = {self.time:.6g} s{instance.message() or '; the FMU gave no reason'}"
        )


def _type(variable: FmuVariable) -> int:
    return TYPES.index("Integer" if variable.type == "Enumeration" else variable.type)
