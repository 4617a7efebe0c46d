"""Command line: `python -m benchmarks [--quick] [--only NAME] [--out DIR] [--repeats N]`."""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from rich.console import Console
from rich.status import Status

from benchmarks.measure import Result, Settings


def benchmarks() -> dict[str, Callable[[Settings], Result]]:
    """All benchmarks by name."""
    from benchmarks.fitness import fitness
    from benchmarks.memory import memory
    from benchmarks.python_fmu import python_fmu
    from benchmarks.stepping import overhead, stepping

    return {
        "stepping": stepping, "overhead": overhead, "python-fmu": python_fmu, "fitness": fitness, "memory": memory,
    }  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, print and write; 1 if contenders disagree or fail."""
    from benchmarks import report
    from cosim.cli.run import free_path
    from cosim.errors import CosimError
    from cosim.recording import new_folder

    known = benchmarks()
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="light systems and short runs: does it work?")
    parser.add_argument("--only", action="append", choices=list(known), help="one benchmark; may be repeated")
    parser.add_argument("--out", type=Path, help="new folder for the results (default: one below ./runs)")
    parser.add_argument("--repeats", type=int, default=0, help="interleaved rounds (default 5, quick 1)")
    options = parser.parse_args(arguments)
    if options.repeats < 0:
        parser.error(f"--repeats {options.repeats}: give 1 or more")
    repeats = options.repeats or (1 if options.quick else 5)
    console = Console(width=None if sys.stdout.isatty() else 120)
    try:
        out = new_folder(options.out or free_path(Path("runs") / "benchmarks"))
    except CosimError as error:
        parser.error(str(error))
    about = {"machine": report.machine(), "quick": options.quick, "repeats": repeats}
    results: dict[str, Result] = {}
    with console.status("") as status, tempfile.TemporaryDirectory(prefix="fowt-benchmark-") as scratch:
        for name in options.only or known:
            note = partial(_note, status, name)
            settings = Settings(Path(scratch) / name, repeats, options.quick, note)
            results[name] = known[name](settings)
            report.write(results, about, out)  # what is done is kept if a later one is interrupted
    report.show(results, console)
    report.plot(results, out / "benchmarks.png")
    console.print(f"{out / 'results.json'}, {out / 'benchmarks.png'}")
    wrong = report.disagreements(results)
    for line in wrong:
        Console(stderr=True).print(f"[red]{line}[/red]")
    return 1 if wrong else 0


def _note(status: Status, benchmark: str, text: str) -> None:
    status.update(f"{benchmark}: {text}")


if __name__ == "__main__":
    sys.exit(main())
