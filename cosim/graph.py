"""The graph of a system's direct dependencies: algebraic loops, and the order of the components."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from cosim.checks import CheckedSystem
from cosim.errors import CosimError, nearest


def algebraic_loops(system: CheckedSystem) -> list[str]:
    """Algebraic loops, each as a path "a.y -> b.u -> b.y -> a.u -> a.y" (one shortest path per loop).

    Nodes are the connected outputs and inputs; edges are the connections, and the direct dependencies of outputs on
    inputs that the FMUs declare. A loop is a strongly connected part of this graph.
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
    loops, seen = [], set()
    for i in range(len(nodes)):
        inside = [[j for j in s if label[j] == label[i]] for s in successors]
        if label[i] not in seen and (path := _shortest_cycle(i, inside)):
            seen.add(label[i])
            loops.append(" -> ".join(f"{system.names[c]}.{v}" for c, v in (nodes[j] for j in path)))
    return loops


def step_order(system: CheckedSystem, first: Sequence[str] = ()) -> tuple[int, ...]:
    """The order in which Gauss-Seidel advances the components.

    Those named `first` lead. Of the others, one whose output follows an input directly comes after the component that
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
        if any(link.input.name in inputs for inputs in system.fmus[link.target].feedthrough.values()):
            feeds[link.source].append(link.target)
    label = _strong_labels(feeds)
    order = [system.names.index(name) for name in dict.fromkeys(first)]
    while len(order) < n:
        waiting = [i for i in range(n) if i not in order]
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
