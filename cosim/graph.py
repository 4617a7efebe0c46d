"""The graph of a system's direct dependencies: algebraic loops, and the order of the components."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from cosim.checks import CheckedSystem, Link
from cosim.errors import CosimError, nearest


@dataclass(frozen=True)
class Loop:
    """An algebraic loop: a strongly connected part of the graph of direct dependencies.

    Attributes:
        path: "a.y -> b.u -> b.y -> a.u -> a.y", a shortest way round.
        inputs: (component, input) of all its inputs.
    """

    path: str
    inputs: frozenset[tuple[int, str]]


def algebraic_loops(system: CheckedSystem) -> list[Loop]:
    """Algebraic loops of a system.

    Nodes of the graph are the connected outputs and inputs; edges are the connections, and the direct dependencies of
    outputs on inputs that the FMUs declare.
    """
    edges: dict[tuple[int, str], list[tuple[int, str]]] = {}
    for link in system.links:
        edges.setdefault((link.source, link.output.name), []).append((link.target, link.input.name))
        edges.setdefault((link.target, link.input.name), [])
    for component, output in list(edges):
        for name in system.fmus[component].feedthrough.get(output, ()):
            if (component, name) in edges:
                edges[component, name].append((component, output))
    nodes = list(edges)
    number = {node: i for i, node in enumerate(nodes)}
    successors = [[number[n] for n in edges[node]] for node in nodes]
    label = _strong_labels(successors)
    inputs = {(link.target, link.input.name) for link in system.links}
    loops, seen = [], set()
    for i in range(len(nodes)):
        if label[i] in seen:
            continue
        inside = [[j for j in s if label[j] == label[i]] for s in successors]
        if path := _shortest_cycle(i, inside):
            seen.add(label[i])
            text = " -> ".join(f"{system.names[c]}.{v}" for c, v in (nodes[j] for j in path))
            members = frozenset(n for j, n in enumerate(nodes) if label[j] == label[i] and n in inputs)
            loops.append(Loop(text, members))
    return loops


def stale_outputs(
    system: CheckedSystem, components: Sequence[int], assumed: Callable[[Link], bool]
) -> set[tuple[int, str]]:
    """Outputs, as (component, variable), that a step leaves out of date: they follow inputs known at its end only.

    Args:
        components: those of which outputs are wanted.
        assumed: whether a link's input was assumed over the step (held or extrapolated).
    """
    inputs = {(k.target, k.input.name) for k in system.links if assumed(k)}
    outputs: set[tuple[int, str]] = set()
    while True:
        follow = {
            (c, output)
            for c in components
            for output, taken in system.fmus[c].feedthrough.items()
            if any((c, name) in inputs for name in taken)
        }
        inputs |= {(k.target, k.input.name) for k in system.links if (k.source, k.output.name) in follow}
        if follow == outputs:
            return outputs
        outputs = follow


def step_order(system: CheckedSystem, first: Sequence[str] = ()) -> tuple[int, ...]:
    """The order in which Gauss-Seidel advances the components.

    Those named `first` lead; those that give sampled values only come last, so that they sample what the others have
    reached. Of the rest, one whose output follows an input directly comes after the component that
    feeds this input; where that leaves a choice (or is circular), the order of the system's file decides: put the
    structure before what acts on it.

    Raises:
        CosimError: `first` names no component.
    """
    for name in first:
        if name not in system.names:
            raise CosimError(f"order: no component '{name}'{nearest(name, system.names)}")
    n = len(system.names)
    feeds: list[list[int]] = [[] for _ in range(n)]
    for link in system.links:
        sampled = link.output.variability == "discrete"  # held over a step, whatever the order
        if not sampled and any(link.input.name in inputs for inputs in system.fmus[link.target].feedthrough.values()):
            feeds[link.source].append(link.target)
    label = _strong_labels(feeds)
    order = [system.names.index(name) for name in dict.fromkeys(first)]
    continuous = {k.source for k in system.links if k.output.variability != "discrete"}
    while len(order) < n:
        waiting = [i for i in range(n) if i not in order]
        waiting = [i for i in waiting if i in continuous] or waiting
        held = {j for i in waiting for j in feeds[i] if label[j] != label[i]}
        order.append(next(i for i in waiting if i not in held))
    return tuple(order)


def _strong_labels(successors: list[list[int]]) -> Any:
    """Number of the strongly connected part of each node."""
    n = len(successors)
    rows = np.repeat(np.arange(n), [len(s) for s in successors])
    columns = np.array([j for s in successors for j in s], dtype=int)
    graph = csr_array((np.ones(len(rows)), (rows, columns)), shape=(n, n))
    return connected_components(graph, directed=True, connection="strong")[1]


def _shortest_cycle(start: int, successors: list[list[int]]) -> list[int]:
    """Nodes of a shortest path from `start` back to it, both ends included; empty if there is none."""
    came_from: dict[int, int] = {}
    queue = deque([start])
    while queue:
        node = queue.popleft()
        for following in successors[node]:
            if following == start:
                path = [start, node]
                while path[-1] != start:
                    path.append(came_from[path[-1]])
                return path[::-1] if node != start else [start, start]
            if following not in came_from:
                came_from[following] = node
                queue.append(following)
    return []
