"""What the commands share: output for people and for machines, progress bars, errors in one line."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext
from enum import StrEnum
from itertools import pairwise
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, ProgressColumn, Task, TextColumn, TimeRemainingColumn
from rich.status import Status
from rich.text import Text

# Names of files, components and variables come from anywhere: "a[1]" and "[red]" are text, and so is ":x:".
out = Console(highlight=False, markup=False, emoji=False)
err = Console(stderr=True, highlight=False, markup=False, emoji=False)


class Format(StrEnum):
    """Output for people, or one JSON object."""

    TEXT = "text"
    JSON = "json"


FormatOption = Annotated[Format, typer.Option("--format", help="text, or json: stdout is then one JSON object.")]


class Interrupted(Exception):
    """The user has stopped a command; the message says what is kept and how to go on."""


def failure(text: str) -> None:
    """Print an error as one line on stderr."""
    err.print(Text.assemble(("error: ", "bold red"), " ".join(text.split())), soft_wrap=True)


def json_is_wanted(words: Sequence[str]) -> bool:
    """Whether a command's words ask for JSON, also where they are wrong otherwise and so are not parsed."""
    return "--format=json" in words or ("--format", "json") in pairwise(words)


def emit_error(text: str) -> None:
    """Tell a program that reads stdout why a command failed, if its words ask for JSON."""
    if json_is_wanted(sys.argv[1:]):
        emit({"error": " ".join(text.split())})


def warn(text: str) -> None:
    """Print a warning on stderr."""
    err.print(Text.assemble(("warning: ", "yellow"), text), soft_wrap=True)


def note(text: str) -> None:
    """Print something worth knowing on stderr."""
    err.print(Text(f"note: {text}", style="dim"), soft_wrap=True)


def number(value: float) -> str:
    """A value to four digits, large ones without exponent."""
    return f"{value:,.0f}" if 1e4 <= abs(value) < 1e9 else f"{value:.4g}"


def emit(content: Any) -> None:
    """Print one JSON object on stdout; numbers that JSON lacks (nan) become null."""
    print(json.dumps(_plain(content), indent=2))


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(v) for v in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def busy(text: str, quiet: bool = False) -> AbstractContextManager[Status | None]:
    """A spinner beside a text while something takes its time; change the text by `status.update(Text(...))`."""
    return nullcontext() if _silent(quiet) else err.status(Text(text))


def _silent(quiet: bool) -> bool:
    """Whether nothing is to be drawn that moves: into a file it would be blank lines."""
    return quiet or not err.is_terminal


def _text(template: str) -> TextColumn:
    return TextColumn(template, markup=False)


class _Speed(ProgressColumn):
    """Simulated seconds per second of wall time."""

    def render(self, task: Task) -> Text:
        return Text(f"{task.speed:.0f}x real time" if task.speed else "", style="cyan")


def simulation_progress(quiet: bool) -> Progress:
    """Progress bars over simulated time, with speed and time left."""
    return Progress(
        _text("{task.description}"),
        BarColumn(),
        _text("{task.completed:.0f}/{task.total:.0f} s"),
        _Speed(),
        _text("left"),
        TimeRemainingColumn(),
        console=err,
        disable=_silent(quiet),
        transient=True,
    )


def count_progress(quiet: bool, seconds: float = 30.0) -> Progress:
    """Progress bars over a number of things; the time left follows from the speed over the last `seconds`."""
    return Progress(
        _text("{task.description}"),
        BarColumn(),
        _text("{task.completed:.0f}/{task.total:.0f}"),
        _text("{task.fields[note]}"),
        TimeRemainingColumn(),
        speed_estimate_period=seconds,
        console=err,
        disable=_silent(quiet),
        transient=True,
    )
