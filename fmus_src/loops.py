"""Algebraic loops between composed components: found, torn, and solved as the linear equations that they must be."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from fmus_src.flow import Flow, Pattern, Wire
from fmus_src.lookups import StoredLookup

#: ("u", member, input), ("y", member, output) or ("w", member, lookup)
Node = tuple[str, int, int]
Graph = Mapping[Node, Sequence[Node]]


def solve_loop(flow: Flow, name: str) -> None:
    """Solve one algebraic loop of a flow in which nothing else can be evaluated; its outputs become known.

    Once some inputs T of the loop are torn (taken as given), all that follows them is r(T) = r(0) + J T. That the torn
    inputs are what comes back to them are linear equations, which the composed equations solve at each evaluation.
    Derivatives of the states follow in the same way, so that nothing is evaluated twice.

    Raises:
        ValueError: the loop is not affine.
    """
    graph = _inner_loop(_unknown(flow))
    torn = _tears(graph)
    involved = sorted({m for _, m, _ in graph})
    inner, symbols, values = _opened(flow, graph, involved)
    unknown = inner.sym.sym("torn", len(torn))
    for (_, m, i), symbol in zip(torn, ca.vertsplit(unknown), strict=True):
        inner.u[m][i] = symbol
    while inner.advance():
        pass
    lookup = next((node for node in graph if node[0] == "w" and inner.w[node[1]][node[2]] is None), None)
    if lookup is not None:
        raise ValueError(f"{name}: algebraic loop through a lookup, not affine: {_path(flow, graph, lookup)}")

    outputs = [node for node in graph if node[0] == "y"]
    back = [_fed(inner, node) for node in torn]
    required = ca.vertcat(*back, *(inner.y[m][row] for _, m, row in outputs))
    curved = _curved(required, unknown, symbols)
    if curved.any():
        culprit = torn[int(np.flatnonzero(curved.any(axis=0))[0])]
        raise ValueError(f"{name}: algebraic loop that is not affine: {_path(flow, graph, culprit)}")

    following = _following(flow, graph, inner, unknown, symbols)
    results = [required, *(f.values for f in following)]
    expressions = [e for r in results for e in (ca.densify(r), ca.densify(ca.jacobian(r, unknown)))]
    system = ca.Function("loop", [*symbols, unknown], ca.cse(expressions))
    found = system(*values, ca.MX.zeros(len(torn)))
    solution = ca.solve(ca.MX.eye(len(torn)) - found[1][: len(torn), :], found[0][: len(torn)], "qr")
    solved = [r + ca.mtimes(j, solution) for r, j in zip(found[::2], found[1::2], strict=True)]
    places = np.cumsum([0, *(int(s.numel()) for s in solved)]).tolist()
    parts = ca.vertsplit(flow.keep("loop", ca.vertcat(*solved)), places)
    for (_, m, row), value in zip(outputs, ca.vertsplit(parts[0])[len(torn) :], strict=True):
        flow.put_output(m, row, value)
    for known, part in zip(following, parts[1:], strict=True):
        if known.rows is None:
            flow.set_rates(known.member, part)
        else:
            for row, value in zip(known.rows, ca.vertsplit(part), strict=True):
                flow.put_output(known.member, row, value)


@dataclass(frozen=True)
class _Known:
    """Outputs (by row), or the state derivatives (rows None), of a member."""

    member: int
    rows: list[int] | None
    values: Any


def _following(flow: Flow, graph: Graph, inner: Flow, unknown: Any, symbols: Sequence[Any]) -> list[_Known]:
    """What else is known with the loop, and affine too: outputs and state derivatives of its members."""
    found: list[_Known] = []
    for m in sorted({m for _, m, _ in graph}):
        member = flow.members[m]
        equations, arguments = member.equations, inner.arguments(m)

        def known(inputs: Pattern, lookups: Pattern, m: int = m) -> bool:
            return all(flow.u[m][i] is not None or ("u", m, i) in graph for i in np.flatnonzero(inputs).tolist()) and (
                all(flow.w[m][i] is not None for i in np.flatnonzero(lookups))
            )

        rows = [
            row
            for row in flow.rows[m]
            if row not in flow.y[m]
            and ("y", m, row) not in graph
            and known(member.outputs_by_input[row], member.outputs_by_lookup[row])
        ]
        if rows:
            values = member.cut(rows)(*arguments)
            affine = np.flatnonzero(~_curved(values, unknown, symbols).any(axis=1)).tolist()
            found += [_Known(m, [rows[i] for i in affine], values[affine])] if affine else []
        if equations.sizes["x"] and known(member.rates_by_input, member.rates_by_lookup):
            values = equations.derivatives(*arguments)
            if not _curved(values, unknown, symbols).any():
                found.append(_Known(m, None, values))
    return found


def _unknown(flow: Flow) -> dict[Node, list[Node]]:
    """What is not yet known, and what of it each depends on directly."""
    graph: dict[Node, list[Node]] = {}
    for m, member in enumerate(flow.members):
        inputs = [i for i, v in enumerate(flow.u[m]) if v is None]
        lookups = [i for i, v in enumerate(flow.w[m]) if v is None]
        for kind, rows, by_input, by_lookup in (
            ("w", lookups, member.lookups_by_input, member.lookups_by_lookup),
            ("y", flow.rows[m], member.outputs_by_input, member.outputs_by_lookup),
        ):
            for row in rows:
                if kind == "w" or row not in flow.y[m]:
                    graph[kind, m, row] = [("u", m, i) for i in inputs if by_input[row, i]]
                    graph[kind, m, row] += [("w", m, i) for i in lookups if by_lookup[row, i]]
        for i in inputs:
            wire = _wire(flow, m, i)
            graph["u", m, i] = [("y", wire.source, wire.output)]
    return graph


def _wire(flow: Flow, m: int, i: int) -> Wire:
    return next(w for w in flow.wires if w.target == m and w.input == i)


def _inner_loop(graph: Graph) -> dict[Node, list[Node]]:
    """A loop that depends on no other: a strongly connected part, all of whose dependencies lie within."""
    nodes = list(graph)
    number = {node: i for i, node in enumerate(nodes)}
    rows = [number[node] for node in nodes for _ in graph[node]]
    columns = [number[other] for node in nodes for other in graph[node]]
    matrix = csr_array((np.ones(len(rows)), (rows, columns)), shape=(len(nodes), len(nodes)))
    _, label = connected_components(matrix, directed=True, connection="strong")
    open_parts = {label[a] for a, b in zip(rows, columns, strict=True) if label[a] != label[b]}
    chosen = next(label[i] for i in range(len(nodes)) if label[i] not in open_parts)
    inside = {node for node in nodes if label[number[node]] == chosen}
    return {node: [other for other in graph[node] if other in inside] for node in nodes if node in inside}


def _tears(graph: Graph) -> list[Node]:
    """Inputs without which the loop is none; each of them is needed."""
    torn = [node for node in graph if node[0] == "u"]
    for node in list(torn):
        fewer = [other for other in torn if other != node]
        if _acyclic({n: [o for o in graph[n] if o not in fewer] for n in graph if n not in fewer}):
            torn = fewer
    return torn


def _acyclic(graph: Graph) -> bool:
    left = {node: set(others) for node, others in graph.items()}
    while left:
        free = {node for node, others in left.items() if not others & left.keys()}
        if not free:
            return False
        left = {node: others for node, others in left.items() if node not in free}
    return True


def _opened(flow: Flow, graph: Graph, involved: Sequence[int]) -> tuple[Flow, list[Any], list[Any]]:
    """The loop alone as a flow in symbols of its own; these symbols, and what they stand for in the whole."""
    scalar = all(flow.members[m].component.sym is ca.SX for m in involved)
    sym = ca.SX if scalar else ca.MX
    time = sym.sym("time")
    inner = Flow(flow.members, flow.wires, time, sym, lambda _, value: value, _stored)
    inner.rows = [[row for kind, n, row in graph if (kind, n) == ("y", m)] for m in range(len(flow.members))]
    inner.w = [[0] * len(w) for w in flow.w]
    symbols, values = [time], [flow.time]
    for m in involved:
        actual = flow.arguments(m)[1:]
        own = [sym.sym(f"{key}{m}", a.numel()) for key, a in zip("xzupkw", actual, strict=True)]
        symbols += own
        values += actual
        inner.columns[m] = {"x": own[0], "z": own[1], "p": own[3], "k": own[4]}
        inner.u[m] = [None if ("u", m, i) in graph else v for i, v in enumerate(ca.vertsplit(own[2]))]
        sizes = [lookup.result_size for lookup in flow.members[m].equations.lookups]
        parts = ca.vertsplit(own[5], np.cumsum([0, *sizes]).tolist()) if sizes else []
        inner.w[m] = [None if ("w", m, i) in graph else v for i, v in enumerate(parts)]
    return inner, symbols, values


def _stored(m: int, part: str, lookup: Any, arguments: Any) -> Any:
    """Of lookups, only intermediate results can be part of a loop."""
    return arguments if isinstance(lookup, StoredLookup) else None


def _fed(inner: Flow, node: Node) -> Any:
    """What comes back to a torn input."""
    wire = _wire(inner, node[1], node[2])
    return wire.scaled(inner.y[wire.source][wire.output])


def _curved(values: Any, unknown: Any, symbols: Sequence[Any]) -> Pattern:
    """Whether elements of a column (rows) are other than affine in the torn inputs (columns)."""
    jacobian = ca.densify(ca.jacobian(values, unknown))
    check = ca.Function("check", [unknown, *symbols], [ca.vec(jacobian)])
    depends = np.asarray(ca.DM(check.jac_sparsity(0, 0), 1.0).full() != 0.0)
    return np.asarray(depends.reshape(unknown.numel(), values.numel(), unknown.numel()).any(axis=0))


def _path(flow: Flow, graph: Graph, start: Node) -> str:
    """A shortest way round the loop from a node, "a.y -> b.u -> b.y -> a.u -> a.y"."""
    forward: dict[Node, list[Node]] = {node: [] for node in graph}
    for node, others in graph.items():
        for other in others:
            forward[other].append(node)
    came_from: dict[Node, Node] = {}
    queue = deque([start])
    while start not in came_from:
        node = queue.popleft()
        for following in forward[node]:
            if following not in came_from:
                came_from[following] = node
                queue.append(following)
    path = [start]
    while len(path) == 1 or path[-1] != start:
        path.append(came_from[path[-1]])
    return " -> ".join(_label(flow, node) for node in reversed(path))


def _label(flow: Flow, node: Node) -> str:
    kind, m, i = node
    member = flow.members[m]
    if kind == "w":
        return f"lookup '{member.equations.lookups[i].name}' of {member.name}"
    return member.input_name(i) if kind == "u" else member.output_name(i)
