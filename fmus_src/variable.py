"""A component's variables: what is declared of them, and their scalar names."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import casadi as ca
import numpy as np

Kind = Literal["real", "integer", "boolean", "string"]
Causality = Literal["parameter", "calculated", "input", "output", "state", "sampled_state"]


@dataclass(frozen=True)
class Variable:
    """A declared variable (scalar or array).

    Attributes:
        name: structured name without index.
        causality: role in the component.
        kind: data type; integers and booleans are parameters that the equations see as numbers.
        shape: () for a scalar, (n,) or (rows, columns).
        unit: SI unit string; display_unit: unit for people, such as "deg".
        start: start values, shape (size,), row by row.
        min, max: bounds of every element, or None.
        nominal: magnitude for solver tolerances, or None.
        tunable: whether a parameter may change during a run.
        internal: of no interest outside (coefficients of a sum, say): the FMU does not list it.
    """

    name: str
    causality: Causality
    description: str
    unit: str = "1"
    kind: Kind = "real"
    shape: tuple[int, ...] = ()
    start: tuple[float, ...] = (0.0,)
    text: str = ""
    min: float | None = None
    max: float | None = None
    nominal: float | None = None
    display_unit: str | None = None
    tunable: bool = False
    internal: bool = False

    @property
    def size(self) -> int:
        return size_of(self.shape)

    def element_names(self) -> list[str]:
        """Scalar names in storage order: `name`, or `name[1]`..., or `name[1,1]`... row by row."""
        if not self.shape:
            return [self.name]
        indices = np.ndindex(*self.shape)
        return [f"{self.name}[{','.join(str(i + 1) for i in index)}]" for index in indices]


def size_of(shape: tuple[int, ...]) -> int:
    """Number of elements."""
    return int(np.prod(shape, dtype=int))


def shape_of(expression: Any) -> tuple[int, ...]:
    """Shape of a CasADi expression or a number as a variable has it: () for one element, (n,) for a column."""
    if not hasattr(expression, "shape") or expression.shape in ((), (1, 1)):
        return ()
    rows, columns = expression.shape if len(expression.shape) == 2 else (expression.shape[0], 1)
    return (rows,) if columns == 1 else (rows, columns)


def shaped(flat: Any, shape: tuple[int, ...]) -> Any:
    """The flat, row-by-row symbol as a column vector or matrix."""
    return ca.reshape(flat, shape[1], shape[0]).T if len(shape) == 2 else flat
