"""TOML files read key by key, so that a mistake in one gets a line that names file, key and remedy."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from cosim.errors import CosimError, nearest


def read_toml(path: Path) -> dict[str, Any]:
    """Content of a TOML file.

    Raises:
        CosimError: it cannot be read.
    """
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        reason = " ".join(str(error).split())[:300]
        raise CosimError(f"{path}: cannot be read ({reason})") from error


class TomlReader:
    """Takes typed keys out of a TOML table; leaving it complains about keys that nobody took."""

    def __init__(self, table: Mapping[str, Any], path: Path, prefix: str) -> None:
        self._table, self._path, self._prefix = dict(table), path, prefix
        self._taken: list[str] = []

    def __enter__(self) -> TomlReader:
        return self

    def __exit__(self, kind: object, *details: object) -> None:
        left = [k for k in self._table if k not in self._taken]
        if kind is None and left:
            raise CosimError(f"{self._path}: unknown key '{self._prefix}{left[0]}'{nearest(left[0], self._taken)}")

    def take(self, key: str, kind: type, default: Any = None) -> Any:
        self._taken.append(key)
        value = self._table.get(key, default)
        if value is None:
            raise CosimError(f"{self._path}: '{self._prefix}{key}' is missing; add it")
        if kind is float and isinstance(value, int) and not isinstance(value, bool) and abs(value) < 2**63:
            value = float(value)
        if not isinstance(value, kind) or (kind is int and isinstance(value, bool)):
            raise CosimError(f"{self._path}: '{self._prefix}{key}' = {value!r} should be a {kind.__name__}")
        return value

    def texts(self, key: str) -> tuple[str, ...]:
        """A list of texts; empty where the key is missing."""
        values = self.take(key, list, [])
        for value in values:
            if not isinstance(value, str):
                raise CosimError(f"{self._path}: '{self._prefix}{key}' holds {value!r}; it should hold names in quotes")
        return tuple(values)

    def values(self, key: str) -> dict[str, Any]:
        """Values of variables; "hydro.Hs" = 4 and hydro.Hs = 4 are the same to us, though not to TOML."""
        found: dict[str, Any] = {}

        def collect(table: Mapping[str, Any], prefix: str) -> None:
            for name, value in table.items():
                if isinstance(value, dict):
                    collect(value, f"{prefix}{name}.")
                elif isinstance(value, (bool, int, float, str)):
                    found[prefix + name] = value
                else:
                    raise CosimError(f"{self._path}: {self._prefix}{key}: {prefix}{name} = {value!r} is no value")

        collect(self.table(key), "")
        return found

    def table(self, key: str) -> dict[str, Any]:
        self._taken.append(key)
        value = self._table.get(key, {})
        if not isinstance(value, dict):
            raise CosimError(f"{self._path}: '{self._prefix}{key}' should be a table")
        return value
