"""Functions of one blade station applied to all of them: a loop in the generated C, however long the function.

Quantities of the stations are matrices with a column for each, so that nothing is copied between such functions.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import fields
from typing import TYPE_CHECKING, Any, Generic, TypeVar

import casadi as ca

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

_T = TypeVar("_T", bound="DataclassInstance")


class Layout(Generic[_T]):
    """How the fields of a dataclass lie in a column: in their order, one row each unless `sizes` says otherwise."""

    def __init__(self, kind: type[_T], **sizes: int) -> None:
        self.kind = kind
        self.sizes = {f.name: sizes.get(f.name, 1) for f in fields(kind)}

    @property
    def size(self) -> int:
        return sum(self.sizes.values())

    def rows(self, name: str) -> slice:
        """Rows of a field."""
        first = 0
        for field, size in self.sizes.items():
            if field == name:
                return slice(first, first + size)
            first += size
        raise KeyError(name)

    def row(self, outer: str, field: str, inner: Layout[Any]) -> slice:
        """Rows of a field of the layout that lies in one of this layout's fields."""
        first, within = self.rows(outer).start, inner.rows(field)
        return slice(first + within.start, first + within.stop)

    def unpack(self, column: Any) -> _T:
        """The dataclass of a column (or of a matrix with a column for each station)."""
        return self.kind(**{name: column[self.rows(name), :] for name in self.sizes})

    def pack(self, value: _T) -> Any:
        """The column of a dataclass."""
        return ca.vertcat(*[getattr(value, name) for name in self.sizes])


def each(name: str, function: Callable[..., Sequence[Any]], *matrices: Any) -> list[Any]:
    """Apply a function of columns to every station.

    Args:
        function: takes a column of each matrix (SX), returns columns.
        matrices: arguments, (rows, stations) each; a single column is the same for all stations.

    Returns:
        results, (rows, stations) each.
    """
    stations = max(int(m.shape[1]) for m in matrices)
    columns = [ca.SX.sym(f"a{i}", int(m.shape[0])) for i, m in enumerate(matrices)]
    results = [ca.densify(r) for r in function(*columns)]
    whole = [m if m.shape[1] == stations else ca.repmat(m, 1, stations) for m in matrices]
    applied = ca.Function(name, columns, results).map(stations)(*whole)
    return list(applied) if isinstance(applied, (tuple, list)) else [applied]


def either(name: str, condition: Any, arguments: Sequence[Any], yes: Callable[..., Any], no: Callable[..., Any]) -> Any:
    """`yes` or `no` of the arguments (MX), of which only the one that the condition asks for is evaluated."""
    symbols = [ca.MX.sym(f"a{i}", *a.shape) for i, a in enumerate(arguments)]
    if_yes = ca.Function(f"{name}_yes", symbols, [ca.densify(yes(*symbols))])
    if_no = ca.Function(f"{name}_no", symbols, [ca.densify(no(*symbols))])
    return ca.Function.if_else(name, if_yes, if_no)(condition, *arguments)
