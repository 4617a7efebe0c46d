"""Operations beyond generated expressions: tables, wind boxes, implicit equations, intermediate results, switches.

Each has a twin in the C runtime (`export/runtime/lookup_*.c`); here is the in-process one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Protocol

import casadi as ca
import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

NEWTON_ITERATIONS = 60
NEWTON_TOLERANCE = 1e-12


class LookupMemory:
    """What lookups keep between evaluations: open wind boxes and the last implicit solutions."""

    def __init__(self, strings: list[str]) -> None:
        self.strings = strings
        self.boxes: dict[str, Any] = {}
        self.solutions: dict[str, Array] = {}


class Lookup(Protocol):
    """A named operation with `arguments -> results`, both flat."""

    @property
    def name(self) -> str: ...

    @property
    def argument_size(self) -> int: ...

    @property
    def result_size(self) -> int: ...

    def evaluate(self, arguments: Array, memory: LookupMemory) -> Array: ...

    def dependencies(self) -> npt.NDArray[np.bool_]:
        """Which result (row) depends on which argument (column)."""
        ...


@dataclass(frozen=True)
class _ElementLookup:
    """One result of each argument."""

    name: str
    size: int

    @property
    def argument_size(self) -> int:
        return self.size

    @property
    def result_size(self) -> int:
        return self.size

    def dependencies(self) -> npt.NDArray[np.bool_]:
        return np.eye(self.size, dtype=bool)


@dataclass(frozen=True)
class StoredLookup(_ElementLookup):
    """The arguments themselves: an intermediate result, evaluated once for all that uses it."""

    def evaluate(self, arguments: Array, memory: LookupMemory) -> Array:
        return arguments


@dataclass(frozen=True)
class SwitchLookup(_ElementLookup):
    """1 for each argument above 0, else 0; the integrator holds the results between the crossings that it locates."""

    def evaluate(self, arguments: Array, memory: LookupMemory) -> Array:
        return (arguments > 0.0).astype(float)


@dataclass(frozen=True)
class TableLookup:
    """Linear interpolation on a uniform grid, held beyond the ends.

    Attributes:
        data: shape (tables, points, columns); which: table index of each argument.
    """

    name: str
    data: Array
    first: float
    spacing: float
    which: tuple[int, ...]

    def __post_init__(self) -> None:
        if self.data.ndim != 3 or self.data.shape[1] < 2 or not self.spacing > 0.0 or not np.isfinite(self.data).all():
            raise ValueError(f"table '{self.name}': give finite data (tables, points >= 2, columns), spacing > 0")
        if not all(0 <= table < len(self.data) for table in self.which):
            raise ValueError(f"table '{self.name}': 'which' names a table that is not among the {len(self.data)} given")

    @property
    def argument_size(self) -> int:
        return len(self.which)

    @property
    def result_size(self) -> int:
        return len(self.which) * self.data.shape[2]

    def evaluate(self, arguments: Array, memory: LookupMemory) -> Array:
        points = self.data.shape[1]
        position = np.clip((arguments - self.first) / self.spacing, 0.0, points - 1.0)
        index = np.minimum(position.astype(int), points - 2)
        weight = (position - index)[:, None]
        tables = np.asarray(self.which)
        result = self.data[tables, index] * (1.0 - weight) + self.data[tables, index + 1] * weight
        return np.asarray(result.ravel())

    def dependencies(self) -> npt.NDArray[np.bool_]:
        return np.kron(np.eye(len(self.which), dtype=bool), np.ones((self.data.shape[2], 1), dtype=bool))


@dataclass(frozen=True)
class FieldLookup:
    """Wind velocity at points from the box in the file that string parameter `file_index` names."""

    name: str
    points: int
    file_index: int

    @property
    def argument_size(self) -> int:
        return 1 + 3 * self.points

    @property
    def result_size(self) -> int:
        return 3 * self.points + 1

    def evaluate(self, arguments: Array, memory: LookupMemory) -> Array:
        path = memory.strings[self.file_index]
        if not path:
            return np.zeros(self.result_size)
        from fmus_src.aero.turbsim_file import read_box

        if path not in memory.boxes:
            box = read_box(Path(path))
            memory.boxes[path] = replace(box, tower=box.tower[:, :0])  # as in C: below the grid the lowest row holds
        velocity = memory.boxes[path].sample(float(arguments[0]), arguments[1:].reshape(-1, 3))
        return np.append(np.asarray(velocity, dtype=float).ravel(), 1.0)

    def dependencies(self) -> npt.NDArray[np.bool_]:
        points = np.kron(np.eye(self.points, dtype=bool), np.ones((3, 3), dtype=bool))
        time = np.ones((3 * self.points, 1), dtype=bool)
        return np.vstack([np.hstack([time, points]), np.zeros((1, self.argument_size), dtype=bool)])


@dataclass(frozen=True)
class ImplicitLookup:
    """Newton's method with step halving on residual(y, a) = 0, for `count` rows of arguments."""

    name: str
    residual: ca.Function
    guess: ca.Function
    count: int

    @property
    def unknowns(self) -> int:
        return int(self.residual.size1_in(0))

    @property
    def row_size(self) -> int:
        return int(self.residual.size1_in(1))

    @property
    def argument_size(self) -> int:
        return self.count * self.row_size

    @property
    def result_size(self) -> int:
        return self.count * self.unknowns

    @cached_property
    def functions(self) -> tuple[ca.Function, ca.Function]:
        """(y, a) -> residual, its Jacobian by y, its Jacobian by a; and a -> first guess."""
        y = ca.SX.sym("y", self.unknowns)
        a = ca.SX.sym("a", self.row_size)
        r = ca.densify(self.residual(y, a))
        by_y, by_a = ca.densify(ca.jacobian(r, y)), ca.densify(ca.jacobian(r, a))
        system = ca.Function(f"{self.name}_system", [y, a], [r, by_y, by_a])
        return system, ca.Function(f"{self.name}_guess", [a], [ca.densify(self.guess(a))])

    def evaluate(self, arguments: Array, memory: LookupMemory) -> Array:
        system, guess = self.functions
        rows = arguments.reshape(self.count, self.row_size)
        last = memory.solutions.get(self.name)
        result = np.empty((self.count, self.unknowns))
        for i, a in enumerate(rows):
            label = f"{self.name}[{i + 1}]"
            try:
                result[i] = self._newton(system, guess(a).full().ravel() if last is None else last[i], a, label)
            except (ArithmeticError, np.linalg.LinAlgError):
                if last is None:
                    raise
                result[i] = self._newton(system, guess(a).full().ravel(), a, label)  # the motion outran the last one
        memory.solutions[self.name] = result
        return result.ravel()

    def _newton(self, system: ca.Function, y: Array, a: Array, label: str) -> Array:
        r, by_y, _ = (m.full() for m in system(y, a))
        for _ in range(NEWTON_ITERATIONS):
            if np.linalg.norm(r) <= NEWTON_TOLERANCE:
                return y
            step = np.linalg.solve(by_y, r).ravel()
            scale = 1.0
            while True:
                trial = y - scale * step
                new_r, new_by_y, _ = (m.full() for m in system(trial, a))
                if np.linalg.norm(new_r) < np.linalg.norm(r):
                    break
                if scale < 1e-6:
                    if np.linalg.norm(r) <= 1e-8:
                        return y
                    raise ArithmeticError(f"implicit equation {label} did not converge")
                scale *= 0.5
            y, r, by_y = trial, new_r, new_by_y
        raise ArithmeticError(f"implicit equation {label} did not converge")

    def dependencies(self) -> npt.NDArray[np.bool_]:
        block = np.ones((self.unknowns, self.row_size), dtype=bool)
        return np.kron(np.eye(self.count, dtype=bool), block)
