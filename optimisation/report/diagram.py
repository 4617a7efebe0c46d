"""The system drawn: components, and connections between them with their signals and units, as SVG."""

from __future__ import annotations

import math
from collections.abc import Iterable
from html import escape

import pandas as pd

from optimisation.report.style import readable_unit

WIDTH, HEIGHT = 940.0, 560.0
BOX = (150.0, 46.0)
GAP = 9.0  # of an arrow from the line between the centres
Point = tuple[float, float]


def connection_table(connections: Iterable[str], units: dict[str, str]) -> pd.DataFrame:
    """Connections gathered by pair of components and signal.

    Args:
        connections: "component.output[i] -> component.input[i]", as in run.json.
        units: of outputs, by "component.output[i]".

    Returns:
        columns source, target, signal (indices left out), unit, count (scalars).
    """
    found: dict[tuple[str, str, str, str], int] = {}
    for line in connections:
        left, right = line.split(" -> ")
        source, output = left.split(".", 1)
        target = right.split(".", 1)[0]
        if output.startswith(f"{target}."):  # a port named after whom it serves
            output = output[len(target) + 1 :]
        key = (source, target, _without_indices(output), units.get(left, "not known"))
        found[key] = found.get(key, 0) + 1
    return pd.DataFrame(
        [(*key, count) for key, count in found.items()], columns=["source", "target", "signal", "unit", "count"]
    )


def _without_indices(name: str) -> str:
    """A signal's name for all elements and all blades alike."""
    head = name.split("[", 1)[0]
    first, dot, rest = head.partition(".")
    return f"blades.{rest}" if dot and first.startswith("blade") and first[5:].isdigit() else head


def system_svg(table: pd.DataFrame, title: str) -> str:
    """The graph as SVG: the component with most connections in the middle, the others around it.

    Colours come from the page's style sheet (classes node, edge, edge-label).
    """
    names = list(dict.fromkeys([*table["source"], *table["target"]]))
    if not names:
        return ""
    places = _places(names, table)
    parts = []
    centre = next(iter(places))
    for (source, target), rows in table.groupby(["source", "target"], sort=False):
        start, end = places[str(source)], places[str(target)]
        label_at = 0.27 if target == centre else 0.73  # where the arrows are far apart
        parts.append(
            _edge(start, end, rows, 0.5 if centre not in (source, target) or abs(start[1] - end[1]) < 1.0 else label_at)
        )
    parts += [_node(name, place) for name, place in places.items()]
    marker = (
        '<defs><marker id="arrow-head" viewBox="0 0 10 10" refX="9" refY="5" markerWidth="7" markerHeight="7" '
        'orient="auto-start-reverse"><path d="M0 0L10 5L0 10z" class="arrow"/></marker></defs>'
    )
    return (
        f'<svg class="system" viewBox="0 0 {WIDTH:.0f} {HEIGHT:.0f}" role="img" aria-label="{escape(title)}">'
        f"<title>{escape(title)}</title>{marker}{''.join(parts)}</svg>"
    )


def _places(names: list[str], table: pd.DataFrame) -> dict[str, Point]:
    degree = pd.concat([table["source"], table["target"]]).value_counts()
    centre = str(degree.index[0])
    others = [n for n in names if n != centre]
    # neighbours that exchange signals stand side by side, so that their connection crosses no other
    pairs = {(str(s), str(t)) for s, t in zip(table["source"], table["target"], strict=True)} if len(table) else set()
    ordered: list[str] = []
    for name in others:
        if name not in ordered:
            ordered += [name, *(o for o in others if o not in ordered and o != name and {(name, o), (o, name)} & pairs)]
    places = {centre: (WIDTH / 2, HEIGHT / 2)}
    for i, name in enumerate(dict.fromkeys(ordered)):
        angle = -math.pi / 2 + 2.0 * math.pi * (i + 0.5) / len(others)
        places[name] = (WIDTH / 2 + 0.40 * WIDTH * math.cos(angle), HEIGHT / 2 + 0.43 * HEIGHT * math.sin(angle))
    return places


def _node(name: str, place: Point) -> str:
    x, y = place
    return (
        f'<g class="node"><rect x="{x - BOX[0] / 2:.1f}" y="{y - BOX[1] / 2:.1f}"'
        f' width="{BOX[0]:.0f}" height="{BOX[1]:.0f}"'
        f' rx="7"/><text x="{x:.1f}" y="{y + 5:.1f}" text-anchor="middle">{escape(name)}</text></g>'
    )


def _edge(start: Point, end: Point, rows: pd.DataFrame, label_at: float) -> str:
    """An arrow shifted to its right, so that both directions show, with what flows beside it at a share of its way."""
    dx, dy = end[0] - start[0], end[1] - start[1]
    length = math.hypot(dx, dy) or 1.0  # of a component that feeds itself
    nx, ny = -dy / length, dx / length
    x1, y1 = _clip(start, (dx, dy), (GAP * nx, GAP * ny))
    x2, y2 = _clip(end, (-dx, -dy), (GAP * nx, GAP * ny))
    signals = zip(rows["signal"], rows["unit"], rows["count"], strict=True)
    full = f"{rows['source'].iloc[0]} to {rows['target'].iloc[0]}: " + ", ".join(
        f"{s} ({n} × {readable_unit(u)})" for s, u, n in signals
    )
    units = list(dict.fromkeys(readable_unit(u) for u in rows["unit"] if u not in ("", "1")))
    shown = ", ".join(units[:2]) + (", …" if len(units) > 2 else "")
    text = f"{int(rows['count'].sum())}{f' ({shown})' if shown else ''}"
    level = abs(nx) < 0.2
    x = x1 + label_at * (x2 - x1) + (0.0 if level else 10.0 * nx)
    y = y1 + label_at * (y2 - y1) + 12.0 * ny + 5.0
    anchor = "middle" if level else "start" if nx > 0.0 else "end"
    return (
        f'<g class="edge"><title>{escape(full)}</title><line x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}"'
        f' marker-end="url(#arrow-head)"/><text class="edge-label" x="{x:.1f}" y="{y:.1f}"'
        f' text-anchor="{anchor}">{escape(text)}</text></g>'
    )


def _clip(centre: Point, along: Point, shift: Point) -> Point:
    """Where a line from a box's centre, shifted, leaves the box."""
    ways = [
        (half + 3.0 - math.copysign(s, s * d)) / abs(d)
        for half, d, s in zip((BOX[0] / 2, BOX[1] / 2), along, shift, strict=True)
        if abs(d) > 1e-9
    ]
    return centre[0] + shift[0] + min(ways) * along[0], centre[1] + shift[1] + min(ways) * along[1]
