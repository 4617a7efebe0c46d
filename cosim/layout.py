"""The layout of a system for the kernel: flat arrays of values, inputs and ports, and what is to be read anew when."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from cosim.checks import CheckedPort, CheckedSystem, Link
from cosim.errors import CosimError, nearest
from cosim.fmu import FmuVariable
from cosim.graph import algebraic_loops, stale_outputs
from cosim.recording import SelectedChannel

Algorithm = Literal["gauss-seidel", "jacobi", "iterated", "newton"]
Extrapolation = Literal["quadratic", "linear", "held"]
ITERATED = ("iterated", "newton")
# An iterated component steps so often in half a step: its own integration is not to hide what the iteration gains.
FINER = 2
TYPES = ("Real", "Integer", "Boolean")
CHANGING = (None, "continuous", "discrete")  # variabilities
HELD, EXTRAPOLATED, INTERPOLATED = range(3)

Integers = npt.NDArray[np.int32]
Reals = npt.NDArray[np.float64]


@dataclass(frozen=True)
class MemberLayout:
    """One component in the stepping order.

    Attributes:
        component: its index in the system.
        reads, inputs: counts by type. derived: real values that are continuous outputs; varying: real inputs that are
            not held; each come first.
        iterated: others follow its continuous outputs. stale: it is read anew at the end of a step.
        every, substeps: it steps once in `every` steps, or `substeps` times in each.
    """

    component: int
    reads: tuple[int, int, int]
    inputs: tuple[int, int, int]
    derived: int
    varying: int
    iterated: bool
    stale: bool
    every: int
    substeps: int


@dataclass(frozen=True)
class Layout:
    """Flat arrays of the kernel; members are in stepping order, values and inputs of a member are contiguous.

    Attributes:
        reads: (component index, variable) of each value; likewise `inputs`.
        owner, target: member of each value, of each input.
        source, mode, factor, offset: of each input.
        backward: inputs to correct in the exchange at the end of a step; `late`: in the iteration; `tear`: on loops.
        every_backward: those to correct where all components are read anew, as at initialisation.
        ports: names of those measured. pairs: (port, effort, flow, flow used, by rate), see kernel.h.
        channel, channel_factor, channel_offset: value index and conversion of each channel.
    """

    members: tuple[MemberLayout, ...]
    reads: tuple[tuple[int, FmuVariable], ...]
    inputs: tuple[tuple[int, FmuVariable], ...]
    owner: Integers
    target: Integers
    source: Integers
    mode: Integers
    factor: Reals
    offset: Reals
    backward: Integers
    every_backward: Integers
    late: Integers
    tear: Integers
    ports: tuple[str, ...]
    pairs: tuple[tuple[int, int, int, int, int], ...]
    channel: Integers
    channel_factor: Reals
    channel_offset: Reals
    loops: tuple[str, ...]

    def scales(self) -> Reals:
        """Magnitude of each value, for tolerances and limits: its nominal, 1 if none."""
        return np.array([abs(v.nominal or 1.0) for _, v in self.reads])


def lay_out(
    system: CheckedSystem,
    order: Sequence[int],
    channels: Sequence[SelectedChannel],
    algorithm: Algorithm,
    extrapolation: Extrapolation,
    rates: Mapping[str, float],
) -> Layout:
    """Compile a system into arrays.

    Args:
        order: components in stepping order.
        extrapolation: "held" also leaves outputs as the components gave them at the end of their step.
        rates: steps of a component, in communication steps: 2, 3, ... or 1/2, 1/3, ...

    Raises:
        CosimError: a rate cannot be used.
    """
    draft = _Draft(system, order, channels, algorithm, rates)
    assumed = (HELD,) if algorithm in ITERATED else () if extrapolation == "held" else (HELD, EXTRAPOLATED)
    stale = stale_outputs(system, order, lambda k: draft.mode(k) in assumed and k.output.variability in CHANGING)
    read_anew = {c for c, v in draft.reads if draft.every[c] == 1 and (c, v.name) in stale}
    continuous = {k.source for k in draft.links if draft.mode(k) != HELD}
    loops = algebraic_loops(system)
    on_loops = frozenset[tuple[int, str]]().union(*(loop.inputs for loop in loops))
    ports, pairs = draft.pairs()

    def backward(chosen: Callable[[Link], bool]) -> Integers:
        found = [i for i, k in enumerate(draft.links) if not draft.forward(k) and chosen(k)]
        return np.array(found, dtype=np.int32)

    return Layout(
        members=tuple(draft.member(c, c in continuous, c in read_anew) for c in order),
        reads=draft.reads,
        inputs=tuple((k.target, k.input) for k in draft.links),
        owner=np.array([draft.place[c] for c, _ in draft.reads], dtype=np.int32),
        target=np.array([draft.place[k.target] for k in draft.links], dtype=np.int32),
        source=np.array([draft.number[k.source, k.output.name] for k in draft.links], dtype=np.int32),
        mode=np.array([draft.mode(k) for k in draft.links], dtype=np.int32),
        factor=np.array([k.factor for k in draft.links], dtype=float),
        offset=np.array([k.offset for k in draft.links], dtype=float),
        backward=backward(lambda k: {k.source, k.target} <= read_anew and (k.source, k.output.name) in stale),
        every_backward=backward(lambda k: True),
        late=backward(lambda k: draft.mode(k) != HELD and k.target in continuous),
        tear=backward(lambda k: _type(k.input) == 0 and (k.target, k.input.name) in on_loops),
        ports=ports,
        pairs=pairs,
        channel=np.array([draft.number[c.component, c.variable.name] for c in channels], dtype=np.int32),
        channel_factor=np.array([c.factor for c in channels], dtype=float),
        channel_offset=np.array([c.offset for c in channels], dtype=float),
        loops=tuple(loop.path for loop in loops),
    )


class _Draft:
    """A system in stepping order: what is read and set, in the order of the kernel's arrays, and when it is known.

    Attributes:
        place: position of each component. every, substeps: its rate.
        links: sorted by member, type, and whether they vary; reads: by member, type, and continuous outputs first.
        number: index of each value.
    """

    def __init__(
        self,
        system: CheckedSystem,
        order: Sequence[int],
        channels: Sequence[SelectedChannel],
        algorithm: Algorithm,
        rates: Mapping[str, float],
    ) -> None:
        self.system, self.algorithm = system, algorithm
        self.place = place = {component: position for position, component in enumerate(order)}
        self.every, self.substeps = _rates(system, rates, algorithm)
        wanted = {(k.source, k.output.name): k.output for k in system.links}
        wanted |= {(c.component, c.variable.name): c.variable for c in channels}
        wanted |= {(port.component, flow.name): flow for port in system.ports for _, flow, _ in port.pairs}
        values = ((c, v) for (c, _), v in wanted.items())
        self.reads = tuple(sorted(values, key=lambda r: (place[r[0]], _type(r[1]), not _continuous(r[1]))))
        self.number = {(c, v.name): i for i, (c, v) in enumerate(self.reads)}
        self.links = sorted(system.links, key=lambda k: (place[k.target], _type(k.input), self.mode(k) == HELD))

    def forward(self, link: Link) -> bool:
        """Whether the source comes first in the order."""
        return self.place[link.source] < self.place[link.target]

    def mode(self, link: Link) -> int:
        """What the target sees of the source over a step."""
        if not _varies(link):
            return HELD
        advanced = self.algorithm != "jacobi" and self.forward(link) and self.every[link.source] == 1
        return INTERPOLATED if advanced else EXTRAPOLATED

    def member(self, component: int, iterated: bool, stale: bool) -> MemberLayout:
        own = [k for k in self.links if k.target == component]
        return MemberLayout(
            component=component,
            reads=_counts(v for c, v in self.reads if c == component),
            inputs=_counts(k.input for k in own),
            derived=sum(_continuous(v) for c, v in self.reads if c == component),
            varying=sum(self.mode(k) != HELD for k in own),
            iterated=iterated,
            stale=stale,
            every=self.every[component],
            substeps=self.substeps[component],
        )

    def pairs(self) -> tuple[tuple[str, ...], tuple[tuple[int, int, int, int, int], ...]]:
        """Ports that can be measured, and their pairs: their effort varies, and both ends step in each step."""
        at = {(k.target, k.input.name): i for i, k in enumerate(self.links)}
        names: list[str] = []
        found: list[tuple[int, int, int, int, int]] = []
        for port in self.system.ports:
            for effort, flow, position in port.pairs:
                i = at.get((port.component, effort.name))
                if i is None or not self._measurable(self.links[i]):
                    continue
                label = self._label(port)
                names += [label] if label not in names else []
                ends = (port.component, self.links[i].source)
                feeds = {
                    k.output.name: j for j, k in enumerate(self.links)
                    if (k.source, k.target) == ends and self.mode(k) != HELD and k.factor != 0.0
                }  # fmt: skip
                used = feeds.get(flow.name, feeds.get(position, -1))
                value = self.number[port.component, flow.name]
                found.append((names.index(label), i, value, used, int(flow.name not in feeds)))
        return tuple(names), tuple(found)

    def _measurable(self, link: Link) -> bool:
        each_step = self.every[link.target] == self.every[link.source] == 1
        return each_step and self.mode(link) != HELD and link.factor != 0.0

    def _label(self, port: CheckedPort) -> str:
        unique = [p.name for p in self.system.ports].count(port.name) == 1
        return port.name if unique else f"{self.system.names[port.component]}.{port.name}"


def _varies(link: Link) -> bool:
    """Whether an input changes between communication points: what is sampled, an integer or a parameter does not."""
    continuous = link.input.variability in (None, "continuous")
    return continuous and _continuous(link.output) and link.input.type == "Real"


def _continuous(variable: FmuVariable) -> bool:
    return variable.type == "Real" and variable.causality == "output" and variable.variability in (None, "continuous")


def _rates(
    system: CheckedSystem, rates: Mapping[str, float], algorithm: Algorithm
) -> tuple[dict[int, int], dict[int, int]]:
    """Steps between a component's steps, and its steps within one (iterated: within half of one), by component."""
    every = dict.fromkeys(range(len(system.names)), 1)
    substeps = dict.fromkeys(range(len(system.names)), FINER if algorithm in ITERATED else 1)
    for name, rate in rates.items():
        if name not in system.names:
            raise CosimError(f"rate of '{name}': no such component{nearest(name, system.names)}")
        if not 1e-6 < rate < 1e6:
            raise CosimError(f"rate of {name}: {rate:g} steps is out of range; use 2 or 1/2")
        k, multiple, fraction = system.names.index(name), round(rate), round(1.0 / rate)
        if not (rate >= 1.0 and rate == multiple) and not (0.0 < rate < 1.0 and abs(rate * fraction - 1.0) < 1e-9):
            raise CosimError(f"rate of {name}: {rate:g} steps is no whole number nor one over such; use 2 or 1/2")
        if rate > 1.0 and algorithm in ITERATED:
            raise CosimError(
                f"rate of {name}: algorithm '{algorithm}' takes no multiples of the step; use gauss-seidel"
            )
        every[k], substeps[k] = (multiple, substeps[k]) if rate >= 1.0 else (1, substeps[k] * fraction)
    return every, substeps


def _counts(variables: Any) -> tuple[int, int, int]:
    found = [_type(v) for v in variables]
    return found.count(0), found.count(1), found.count(2)


def _type(variable: FmuVariable) -> int:
    return TYPES.index("Integer" if variable.type == "Enumeration" else variable.type)
