"""The icon of FMUs: a wind turbine on a barge, drawn from polygons as SVG and as PNG."""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

Point = tuple[float, float]
Shape = tuple[str, Sequence[Point]]  # colour "#rrggbb", corners in a square of 100 with y downwards

_PIXELS, _SAMPLES = 128, 4
_SEA, _STEEL, _LIGHT, _PAPER = "#2b6c8f", "#3a4652", "#8fa3b3", "#f4f7f9"


def turbine() -> list[Shape]:
    """The component's icon."""
    hub = (52.0, 32.0)
    shapes: list[Shape] = [
        (_PAPER, [(2, 2), (98, 2), (98, 98), (2, 98)]),
        (_SEA, [*_wave(), (98.0, 98.0), (2.0, 98.0)]),
        (_LIGHT, [(49.5, 33), (54.5, 33), (56, 70), (48, 70)]),
        (_STEEL, [(26, 68), (78, 68), (78, 80), (26, 80)]),
    ]
    shapes += [(_STEEL, _blade(hub, math.radians(angle))) for angle in (90.0, 210.0, 330.0)]
    circle = [(hub[0] + 3 * math.cos(a), hub[1] + 3 * math.sin(a)) for a in np.arange(24) * math.pi / 12]
    return [*shapes, (_LIGHT, circle)]


def port() -> list[Shape]:
    """The mark of a mechanical port."""
    return [(_STEEL, [(5, 5), (95, 5), (95, 95), (5, 95)]), (_PAPER, [(30, 30), (70, 30), (70, 70), (30, 70)])]


def svg(shapes: Sequence[Shape]) -> str:
    """The shapes as SVG."""
    polygons = "\n".join(
        f'<polygon fill="{colour}" points="{" ".join(f"{x:.2f},{y:.2f}" for x, y in corners)}"/>'
        for colour, corners in shapes
    )
    return f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 100 100">\n{polygons}\n</svg>\n'


def png(shapes: Sequence[Shape]) -> bytes:
    """The shapes as a PNG image of 128 pixels a side, transparent where there is none."""
    n = _PIXELS * _SAMPLES
    image = np.zeros((n, n, 4))
    for colour, corners in shapes:
        rgb = [int(colour[i : i + 2], 16) for i in (1, 3, 5)]
        image[_inside(np.asarray(corners, dtype=float), n)] = [*rgb, 255]
    blocks = image.reshape(_PIXELS, _SAMPLES, _PIXELS, _SAMPLES, 4)
    alpha = blocks[..., 3:].sum(axis=(1, 3))
    coloured = (blocks[..., :3] * (blocks[..., 3:] > 0)).sum(axis=(1, 3)) * 255 / np.maximum(alpha, 1)
    pixels = np.concatenate([coloured, alpha / _SAMPLES**2], axis=2).round().astype(np.uint8)
    rows = b"".join(b"\0" + row.tobytes() for row in pixels)  # 0: no filter
    header = struct.pack(">IIBBBBB", _PIXELS, _PIXELS, 8, 6, 0, 0, 0)
    chunks = (b"IHDR", header), (b"IDAT", zlib.compress(rows, 9)), (b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + b"".join(_chunk(name, data) for name, data in chunks)


def _chunk(name: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))


def _inside(corners: npt.NDArray[np.float64], n: int) -> npt.NDArray[np.bool_]:
    """Which of n by n points of the square are inside: those with an odd number of edges to their right."""
    centre = (np.arange(n) + 0.5) * 100.0 / n
    x, y = centre[None, :], centre[:, None]
    odd = np.zeros((n, n), dtype=bool)
    for (x1, y1), (x2, y2) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        if y1 != y2:
            spans = (y1 > y) != (y2 > y)
            odd ^= spans & (x < x1 + (y - y1) / (y2 - y1) * (x2 - x1))
    return odd


def _wave() -> list[Point]:
    return [(float(x), 78.0 + 3.0 * math.sin(x / 100.0 * 6.0 * math.pi)) for x in np.linspace(2.0, 98.0, 49)]


def _blade(hub: Point, angle: float) -> list[Point]:
    """A blade from the hub, angle from the right, counter-clockwise."""
    outline = [(0.0, -1.5), (8.0, -3.0), (30.0, -0.6), (30.0, 0.6), (8.0, 1.2), (0.0, 1.5)]
    c, s = math.cos(angle), math.sin(angle)
    return [(hub[0] + r * c - w * s, hub[1] - r * s - w * c) for r, w in outline]
