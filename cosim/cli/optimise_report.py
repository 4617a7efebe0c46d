"""What `fowt optimise` shows: progress, results, and how to go on after an interruption."""

from __future__ import annotations

import math
import shlex
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from rich.table import Table
from rich.text import Text

from cosim.cli.console import Interrupted, busy, count_progress, emit, out, warn

if TYPE_CHECKING:
    from optimisation.pareto import Front
    from optimisation.result import OptimisationResult
    from optimisation.scenario_tuning import ScenarioResult
    from optimisation.search import Generation
    from optimisation.tuning import Request


@contextmanager
def resumable(folder: Path) -> Iterator[None]:
    """Say how to go on when the user interrupts."""
    try:
        yield
    except KeyboardInterrupt:
        from optimisation.checkpoint import CHECKPOINT, read_checkpoint

        if (folder / CHECKPOINT).exists():
            record = read_checkpoint(folder / CHECKPOINT)[1]
            done = [float(v[0]) for values in record.values for v in values if math.isfinite(v[0])]
            best = f", best until then {min(done):.4f}" if done else ""
            message = f"interrupted{best}; continue with: fowt optimise --resume {shlex.quote(str(folder))}"
        else:
            message = "interrupted before the first generation was complete"
        raise Interrupted(message) from None
    finally:
        if not any(folder.iterdir()):  # a failed search has nothing to leave
            folder.rmdir()


@contextmanager
def progress_bar(request: Request, quiet: bool) -> Iterator[Callable[[Generation], None]]:
    """A bar over evaluations, with generation, best fitness and time left."""
    with count_progress(quiet) as bar:
        label = f"tuning {request.damper} by {request.method}"
        task = bar.add_task(label, total=request.evaluations, note="")
        unit = " m" if request.objective == "decay" else ""

        def show(g: Generation) -> None:
            words = f"generation {g.number}, best {g.best:.4f}{unit}"
            if g.failures:
                words += f", {g.failures} failed"
            bar.update(task, completed=g.evaluations, note=words)

        yield show


@contextmanager
def simulation_bar(
    request: Request, quiet: bool
) -> Iterator[tuple[Callable[[int], None], Callable[[Generation], None]]]:
    """A bar over the scenarios of all designs and of their reference: called with how many more are done, and after
    each generation, which counts those that are not simulated (read from a checkpoint, or of linear models)."""
    assert request.evaluations is not None
    each = len(request.scenarios)
    with count_progress(quiet, seconds=600.0) as bar:
        label = f"tuning {request.damper} by {request.method}"
        total, done, words = (request.evaluations + 1) * each, 0, ""
        task = bar.add_task(label, total=total, note="reference")

        def advance(more: int) -> None:
            nonlocal done
            done = min(done + more, total)
            note = words or ("reference" if done < each else "first designs")
            bar.update(task, completed=done, note=note)

        def show(g: Generation) -> None:
            nonlocal words
            what = "co-simulations, " if request.objective == "coupled" else ""
            failed = f", {g.failures} failed" if g.failures else ""
            words = f"{what}{g.evaluations} designs, best {g.best:.4f}{failed}"
            advance(max(0, (g.evaluations + 1) * each - done))

        yield advance, show


@contextmanager
def polishing(folder: Path, quiet: bool) -> Iterator[Callable[[int, float], None]]:
    """Show how a polish gets on; if the user interrupts, say that the search's result is kept."""
    with busy("polishing", quiet) as status:

        def show(count: int, best: float) -> None:
            if status is not None:
                status.update(Text(f"polishing: {count} evaluations, best {best:.7f} m"))

        try:
            yield show
        except KeyboardInterrupt:
            raise Interrupted(f"polish interrupted; {folder} has the result of the search, not polished") from None


def write_result(result: OptimisationResult, target: Path) -> list[Path]:
    """Write the result of a search on the free decay; returns the files."""
    from optimisation.result import plot_convergence, write_json, write_ssv

    return [write_ssv(result, target / "tuned.ssv"), plot_convergence(result, target / "convergence.png"),
            write_json(result, target / "result.json")]  # fmt: skip


def report(result: OptimisationResult, written: list[Path], target: Path, quiet: bool) -> None:
    """Show the result of a search on the free decay."""
    if result.failures:
        warn(f"{result.failures} evaluations failed and were penalised; the first: {result.first_failure}")
    if quiet:
        emit({
            "fitness": result.fitness, "parameters": result.parameters, "evaluations": result.evaluations,
            "generations": result.generations, "failures": result.failures, "seconds": result.seconds,
            "certified": result.local_optimum and result.local_optimum.certified, "folder": str(target),
        })  # fmt: skip
        return
    out.print(f"fitness {result.fitness:.4f} m after {result.evaluations} evaluations in {result.seconds:.1f} s")
    units = {v.name: v.unit for v in result.variables}
    _show_parameters(result.parameters, units, result.at_bound)
    if result.local_optimum:
        out.print(f"{result.local_optimum.verdict}; gained {result.local_optimum.gain:.1e} m", soft_wrap=True)
    out.print(f"{target}: {', '.join(p.name for p in written)}", soft_wrap=True)


def report_scenarios(result: ScenarioResult, target: Path, quiet: bool) -> None:
    """Write and show the result of a search over scenarios."""
    from optimisation.result import write_design
    from optimisation.scenario_files import content, plot_search, write_json
    from optimisation.scenarios import WORDS

    variables = result.task.variables
    written = [write_design(result.damper, result.parameters, variables, target / "tuned.ssv"),
               plot_search(result, target / "convergence.png"), write_json(result, target / "result.json")]  # fmt: skip
    if result.failures:
        warn(f"{result.failures} designs failed and were penalised; the first: {result.first_failure}")
    if quiet:
        emit(content(result) | {"folder": str(target)})
        return
    what = WORDS[result.how] + f" ratio of standard deviations to '{result.relative_to}'"
    count, seconds = result.evaluations, result.seconds
    out.print(f"fitness {result.fitness:.4f} ({what}) after {count} designs in {seconds:.0f} s", soft_wrap=True)
    _show_parameters(result.parameters, {v.name: v.unit for v in variables}, result.at_bound)
    table = Table("STD by reference's", box=None, pad_edge=False)
    for channel in result.channels:
        table.add_column(channel, justify="right")
    for label, row in zip(result.scenarios, result.ratios, strict=True):
        table.add_row(label, *(f"{value:.4f}" for value in row))
    out.print(table)
    for start in result.starts:
        out.print(f"  start {start.label}: fitness {start.fitness:.4f}", soft_wrap=True)
    if result.left_out:
        worst = 100.0 * float(result.left_out.responses.max())
        out.print(
            f"surrogate, leaving out each of the {result.left_out.designs} better designs: responses within"
            f" {worst:.2g} % RMS, fitness {result.left_out.fitness:.2g} (their spread {result.left_out.spread:.2g})",
            soft_wrap=True,
        )
    out.print(f"{target}: {', '.join(p.name for p in written)}", soft_wrap=True)


def _show_parameters(parameters: dict[str, float], units: dict[str, str], at_bound: tuple[str, ...]) -> None:
    for name, value in parameters.items():
        words = "  (at a bound of the search)" if name in at_bound else ""
        shown = f"{value:10.1f}" if abs(value) >= 100.0 or value == 0.0 else f"{value:10.4g}"
        out.print(f"  {name:20s} {shown} {units.get(name, '').replace('.', ' ')}{words}")


def report_front(front: Front, target: Path, quiet: bool) -> None:
    """Write and show a Pareto front."""
    from optimisation.pareto import plot_front, write_front

    written = [plot_front(front, target / "pareto.png"), *write_front(front, target)]
    failures = front.history[-1].failures
    if failures:
        warn(f"{failures} evaluations failed and were penalised; the first: {front.first_failure}")
    if quiet:
        emit({"designs": front.designs.to_dict("records"), "optima": front.optima.to_dict("records"),
              "failures": failures, "seconds": front.seconds, "folder": str(target)})  # fmt: skip
        return
    out.print(f"{len(front.designs)} designs after {front.history[-1].evaluations} evaluations")
    response, stroke = front.designs.columns[-2:]
    for _, row in front.optima.iterrows():
        out.print(f"  {row[response]:.4f} m of response at {row[stroke]:.2f} m of stroke")
    out.print(f"{target}: {', '.join(p.name for p in written)}", soft_wrap=True)
