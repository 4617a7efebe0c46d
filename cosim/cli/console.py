"""What the commands share: output for people and for machines, progress bars, errors in one line."""

from __future__ import annotations

import json
import math
from enum import StrEnum
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, ProgressColumn, Task, TextColumn, TimeRemainingColumn
from rich.text import Text

out = Console(highlight=False)
err = Console(stderr=True, highlight=False)


class Format(StrEnum):
    """Output for people, or one JSON object."""

    TEXT = "text"
    JSON = "json"


FormatOption = Annotated[Format, typer.Option("--format", help="text, or json: stdout is then one JSON object.")]


def failure(text: str) -> None:
    """Print an error as one line on stderr."""
    err.print(Text.assemble(("error: ", "bold red"), " ".join(text.split())), soft_wrap=True)


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


class _Speed(ProgressColumn):
    """Simulated seconds per second of wall time."""

    def render(self, task: Task) -> Text:
        return Text(f"{task.speed:.0f}x real time" if task.speed else "", style="cyan")


def simulation_progress(quiet: bool) -> Progress:
    """Progress bars over simulated time, with speed and time left."""
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.completed:.0f}/{task.total:.0f} s"),
        _Speed(),
        TextColumn("left"),
        TimeRemainingColumn(),
        console=err,
        disable=quiet,
        transient=True,
    )


def count_progress(quiet: bool, seconds: float = 30.0) -> Progress:
    """Progress bars over a number of things; the time left follows from the speed over the last `seconds`."""
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.completed:.0f}/{task.total:.0f}"),
        TextColumn("{task.fields[note]}"),
        TimeRemainingColumn(),
        speed_estimate_period=seconds,
        console=err,
        disable=quiet,
        transient=True,
    )
