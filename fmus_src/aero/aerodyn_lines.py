"""Lines of OpenFAST's text input: a value, its name, a comment; other files included. Errors name file and line."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NoReturn

_DEEPEST = 5  # files within files
_LARGEST = 20_000_000  # bytes


@dataclass(frozen=True)
class Line:
    """A line with something on it: its file, number and text without comment."""

    path: Path
    number: int
    text: str

    @property
    def words(self) -> list[str]:
        """Words, quoted ones whole and without their quotes."""
        return [w.strip("\"'") for w in re.findall(r"\"[^\"]*\"|'[^']*'|[^\s,]+", self.text)]

    @property
    def name(self) -> str:
        """Second word, in small letters: the name of the line's value."""
        words = self.words
        return words[1].lower() if len(words) > 1 else ""

    def refuse(self, why: str) -> NoReturn:
        """Raise a ValueError that shows the line."""
        text = "".join(c if c.isprintable() else "?" for c in self.text)[:60]
        raise ValueError(f"aero: {shown(self.path)}, line {self.number}: {why}: '{text}'")

    def numbers(self, count: int, what: str) -> list[float]:
        """The first `count` words as numbers."""
        words = self.words[:count]
        if len(words) < count:
            self.refuse(f"needs {count} numbers ({what})")
        values = [_number(word) for word in words]
        if None in values:
            self.refuse(f"needs {count} finite numbers ({what})")
        return [v for v in values if v is not None]

    def number_of(self, what: str, low: int, high: int) -> int:
        """The first word as a whole number."""
        value = self.numbers(1, what)[0]
        if value != int(value) or not low <= value <= high:
            self.refuse(f"{what} must be a whole number from {low} to {high}")
        return int(value)

    def flag(self) -> bool:
        """The first word as a truth value."""
        word = self.words[0].strip(".").lower()
        if word not in ("t", "true", "f", "false"):
            self.refuse("write True or False")
        return word.startswith("t")

    @property
    def is_default(self) -> bool:
        """Whether the value is left to the program."""
        return self.words[0].lower() == "default"

    @property
    def file(self) -> Path:
        """The file that the first word names, relative to the file that the line stands in."""
        return self.path.parent / self.words[0].replace("\\", "/")


def lines_of(path: Path, depth: int = 0) -> Iterator[Line]:
    """Lines of a file and of the files that it includes, without comments and empty ones.

    Raises:
        ValueError: a file cannot be read.
    """
    try:
        if path.stat().st_size > _LARGEST:
            raise ValueError(f"aero: {shown(path)} is larger than {_LARGEST / 1e6:g} MB: no file of AeroDyn")
        text = path.read_text(encoding="utf-8", errors="replace")
    except (OSError, ValueError) as error:
        if str(error).startswith("aero:"):
            raise
        raise ValueError(f"aero: {shown(path)} cannot be read; check the name and its folder") from None
    for number, raw in enumerate(text.split("\n"), 1):
        content = re.split("[!#%]", raw, maxsplit=1)[0].strip()
        line = Line(path, number, content)
        if not content.startswith("@"):
            if line.words:
                yield line
            continue
        words = replace(line, text=content[1:]).words
        if not words or depth >= _DEEPEST:
            line.refuse(f'write @"FILE", at most {_DEEPEST} files within another')
        included = path.parent / words[0].replace("\\", "/")
        if words[1:2] == ["NumCoords"] and not _is_file(included):
            yield replace(line, text="0 NumCoords")  # coordinates are for pictures
        elif not _is_file(included):
            line.refuse("there is no such file")
        else:
            yield from lines_of(included, depth + 1)


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):  # a name that no file system takes
        return False


def following(lines: Iterator[Line], path: Path, what: str) -> Line:
    """The next line.

    Raises:
        ValueError: there is none; `what` says what should have followed.
    """
    line = next(lines, None)
    if line is None:
        raise ValueError(f"aero: {shown(path)} ends before {what}; it is not whole")
    return line


def _number(word: str) -> float | None:
    """A number as Fortran writes it; None if it is none, or not finite."""
    try:
        value = float(re.sub("[dD]", "e", word)) if "_" not in word else math.nan
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def shown(path: Path) -> str:
    """A file's name as a terminal can print it."""
    return "".join(c if c.isprintable() else "?" for c in path.name)[:80]
