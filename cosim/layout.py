"""The layout of a system for the kernel: flat arrays of values, inputs and ports, and what is to be read anew when."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from cosim.checks import CheckedSystem, Link
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
    loops: tuple[str, ...] = field(default=())

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
    place = {component: position for position, component in enumerate(order)}
    every, substeps = _rates(system, rates, algorithm)

    def forward(link: Link) -> bool:
        return place[link.source] < place[link.target]

    def mode(link: Link) -> int:
        if not _varies(link):
            return HELD
        advanced = algorithm != "jacobi" and forward(link) and every[link.source] == 1
        return INTERPOLATED if advanced else EXTRAPOLATED

    assumed = (HELD,) if algorithm in ITERATED else () if extrapolation == "held" else (HELD, EXTRAPOLATED)
    stale = stale_outputs(
        system, order, lambda k: mode(k) in assumed and k.output.variability in (None, "continuous", "discrete")
    )
    port_names = [port.name for port in system.ports]
    port_pairs = [
        (
            port.name if port_names.count(port.name) == 1 else f"{system.names[port.component]}.{port.name}",
            port.component,
            *pair,
        )
        for port in system.ports
        for pair in port.pairs
    ]
    wanted = {(k.source, k.output.name): k.output for k in system.links}
    wanted |= {(c.component, c.variable.name): c.variable for c in channels}
    wanted |= {(component, flow.name): flow for _, component, _, flow, _ in port_pairs}
    reads = sorted(
        ((c, v) for (c, _), v in wanted.items()), key=lambda r: (place[r[0]], _type(r[1]), not _continuous(r[1]))
    )
    number = {(c, v.name): i for i, (c, v) in enumerate(reads)}
    links = sorted(system.links, key=lambda k: (place[k.target], _type(k.input), mode(k) == HELD))
    input_number = {(k.target, k.input.name): i for i, k in enumerate(links)}
    loops = algebraic_loops(system)
    on_loops = frozenset[tuple[int, str]]().union(*(loop.inputs for loop in loops))
    continuous = {k.source for k in links if mode(k) != HELD}
    read_anew = {c for c in order if every[c] == 1 and any((c, v.name) in stale for owner, v in reads if owner == c)}

    def where(chosen: Callable[[Link], bool]) -> Integers:
        return np.array([i for i, k in enumerate(links) if chosen(k)], dtype=np.int32)

    def member(component: int) -> MemberLayout:
        own = [k for k in links if k.target == component]
        return MemberLayout(
            component=component,
            reads=_counts(v for c, v in reads if c == component),
            inputs=_counts(k.input for k in own),
            derived=sum(_continuous(v) for c, v in reads if c == component),
            varying=sum(mode(k) != HELD for k in own),
            iterated=component in continuous,
            stale=component in read_anew,
            every=every[component],
            substeps=substeps[component],
        )

    ports, pairs = _pairs(port_pairs, links, mode, every, number, input_number)
    return Layout(
        members=tuple(member(c) for c in order),
        reads=tuple(reads),
        inputs=tuple((k.target, k.input) for k in links),
        owner=np.array([place[c] for c, _ in reads], dtype=np.int32),
        target=np.array([place[k.target] for k in links], dtype=np.int32),
        source=np.array([number[k.source, k.output.name] for k in links], dtype=np.int32),
        mode=np.array([mode(k) for k in links], dtype=np.int32),
        factor=np.array([k.factor for k in links], dtype=float),
        offset=np.array([k.offset for k in links], dtype=float),
        backward=where(
            lambda k: (
                k.target in read_anew
                and k.source in read_anew
                and (k.source, k.output.name) in stale
                and not forward(k)
            )
        ),
        every_backward=where(lambda k: not forward(k)),
        late=where(lambda k: mode(k) != HELD and k.target in continuous and not forward(k)),
        tear=where(lambda k: _type(k.input) == 0 and (k.target, k.input.name) in on_loops and not forward(k)),
        ports=ports,
        pairs=pairs,
        channel=np.array([number[c.component, c.variable.name] for c in channels], dtype=np.int32),
        channel_factor=np.array([c.factor for c in channels], dtype=float),
        channel_offset=np.array([c.offset for c in channels], dtype=float),
        loops=tuple(loop.path for loop in loops),
    )


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


def _pairs(
    port_pairs: Sequence[tuple[str, int, FmuVariable, FmuVariable, str]],
    links: Sequence[Link],
    mode: Any,
    every: Mapping[int, int],
    number: Mapping[tuple[int, str], int],
    input_number: Mapping[tuple[int, str], int],
) -> tuple[tuple[str, ...], tuple[tuple[int, int, int, int, int], ...]]:
    """Ports that can be measured, and their pairs: those whose effort varies and both of whose ends step each step."""
    chosen = []
    for name, component, effort, flow, position in port_pairs:
        at = input_number.get((component, effort.name))
        if at is None or mode(links[at]) == HELD or max(every[component], every[links[at].source]) > 1:
            continue
        if 0.0 in (
            links[at].factor,
            *(k.factor for k in links if k.source == component and k.target == links[at].source),
        ):
            continue
        feeds = {
            k.output.name: i for i, k in enumerate(links)
            if (k.source, k.target) == (component, links[at].source) and mode(k) != HELD
        }  # fmt: skip
        used = feeds.get(flow.name, feeds.get(position, -1))
        chosen.append((name, at, number[component, flow.name], used, int(flow.name not in feeds)))
    names = tuple(dict.fromkeys(c[0] for c in chosen))
    return names, tuple((names.index(n), at, flow, used, rate) for n, at, flow, used, rate in chosen)


def _counts(variables: Any) -> tuple[int, int, int]:
    found = [_type(v) for v in variables]
    return found.count(0), found.count(1), found.count(2)


def _type(variable: FmuVariable) -> int:
    return TYPES.index("Integer" if variable.type == "Enumeration" else variable.type)
