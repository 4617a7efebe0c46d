"""`fowt reproduce`: tables and figures of Wang et al. (2022) in one go."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cosim.case import read_case
from cosim.cli.campaign import carried_out
from cosim.cli.campaign_plan import Options
from cosim.cli.console import Format, FormatOption, busy, count_progress, emit, out
from cosim.cli.identify import VERIFIED, identified
from cosim.cli.methods import all_dampers
from cosim.cli.optimise import CPUS, WorkersOption, simplified
from cosim.cli.run import Changes, free_path, prepare
from cosim.errors import CosimError
from cosim.recording import new_folder, read_results
from cosim.run import simulate

if TYPE_CHECKING:
    import pandas as pd

    from optimisation.result import OptimisationResult

CONVERGED = {"tmd-n": 9, "tmd-p": 3, "mtmd": 6}  # the paper's generations
SUMMARY = "summary.md"


@dataclass(frozen=True)
class Settings:
    """What the sections share: results folder, seed of the search, threads, whether to be silent."""

    folder: Path
    seed: int
    workers: int
    quiet: bool

    @property
    def runs(self) -> Path:
        """Folder of the runs that figures are drawn from."""
        return self.folder / "runs"


def reproduce(
    section: Annotated[
        list[int] | None,
        typer.Option(
            metavar="N", help="4: identification; 5: optimisation; 6: load cases (120 runs). 4 and 5 by default."
        ),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the genetic algorithm.")] = 1,
    folder: Annotated[Path | None, typer.Option("--out", help="New folder for the results.")] = None,
    workers: WorkersOption = CPUS,
    output: FormatOption = Format.TEXT,
) -> None:
    """Redo tables and figures of Wang et al. (2022): PNG and CSV each, and summary.md over all.

    Example, everything in a quarter of an hour:
    [bold]fowt reproduce --section 4 --section 5 --section 6[/bold]
    """
    chosen = sorted(set(section or QUICK))
    unknown = next((s for s in chosen if s not in SECTIONS), None)
    if unknown is not None:
        raise CosimError(f"--section {unknown}: there are {', '.join(map(str, SECTIONS))}")
    quiet = output is Format.JSON
    settings = Settings(new_folder(folder or free_path(Path("runs") / "reproduce")), seed, workers, quiet)
    parts = ["# Wang et al. (2022), reproduced\n"]
    for number in chosen:
        parts += SECTIONS[number](settings)
        # after each section, so that an interruption keeps what is done
        (settings.folder / SUMMARY).write_text("\n".join(parts) + "\n", encoding="utf-8")
    if quiet:
        emit(
            {"folder": str(settings.folder), "files": sorted(p.name for p in settings.folder.iterdir() if p.is_file())}
        )
        return
    out.print("\n".join(line for line in parts if not line.startswith("![")), soft_wrap=True)
    out.print(f"\nall of it with the figures: {settings.folder / SUMMARY}", soft_wrap=True)


def identification(settings: Settings) -> list[str]:
    """Section 4: table 3, figures 4 and 5."""
    import pandas as pd

    from cosim.cli.paper_figures import draw_decays
    from optimisation.identification import CHANNELS, UNKNOWNS

    place = settings.folder
    found = identified([("decay5", "none"), VERIFIED], settings.runs, quiet=settings.quiet)
    found.write(place, place)
    rows: list[dict[str, Any]] = [
        {"unknown": u.name, "unit": u.unit, "first guess": u.first_guess, "paper": u.paper,
         "identified": found.result.values[u.name], "standard error (%)": 100 * found.result.standard_errors[u.name]}
        for u in UNKNOWNS
    ]  # fmt: skip
    pd.DataFrame(rows).to_csv(place / "table-3.csv", index=False)
    titles = ("Figure 4: 5 deg of initial pitch, no damper", "Figure 5: 10 deg of initial pitch, MTMD")
    names = ("figure-4.png", "figure-5.png")
    text = ["## Section 4: parameter identification\n", "Table 3\n"]
    text += markdown(
        ("unknown", "unit", "first guess", "paper", "identified", "standard error"),
        ([r["unknown"], r["unit"], *(f"{r[k]:.3g}" for k in ("first guess", "paper", "identified")),
          f"{r['standard error (%)']:.1f} %"] for r in rows),
    )  # fmt: skip
    text += ["", "R2 of the simplified model on the coupled model's decays\n"]
    fits = list(zip(found.fits, found.paper, strict=True))
    text += markdown(
        ("decay", "channel", "paper's set", "identified set"),
        ([f.decay.label, c, f"{p.r2[c]:.3f}", f"{f.r2[c]:.3f} ({'fitted' if f.fitted else 'predicted'})"]
         for f, p in fits for c in CHANNELS),
    )  # fmt: skip
    for (own, paper), title, name in zip(fits, titles, names, strict=True):
        text += ["", f"![{title}]({draw_decays(own, paper, title, place / name).name})"]
    return [*text, ""]


def optimisation(settings: Settings) -> list[str]:
    """Section 5: table 4, figures 6 and 7."""
    import pandas as pd

    from cosim.cli.paper_figures import draw_convergence, draw_damped_decays
    from optimisation.result import write_ssv

    place = settings.folder
    fmu = simplified(None, settings.quiet)
    results = _tuned(fmu, settings)
    rows = [row for r in results for row in _table_4(r, fmu)]
    table = pd.DataFrame(rows)
    table.to_csv(place / "table-4.csv", index=False)
    sets: dict[str, Path] = {r.damper: write_ssv(r, place / f"tuned-{r.damper}.ssv") for r in results}
    draw_convergence(results, place / "figure-6.png")
    with busy("free decays", settings.quiet):
        for name, parameters, title in (
            ("figure-7", sets, "optima of our genetic algorithm"),
            ("figure-7-table-4", {}, "parameters of the paper's table 4"),
        ):
            frames = {d: _decay(d, parameters.get(d), settings) for d in ("none", *all_dampers())}
            draw_damped_decays(frames, f"Figure 7: decay from 5 deg, {title}", place / f"{name}.png")
    text = ["## Section 5: optimisation by genetic algorithm\n", "Table 4\n"]
    text += markdown(
        ("damper", "what", "fitness (m)", "k_n (N/m)", "c_n (N s/m)", "k_p (N/m)", "c_p (N s/m)", "generation"),
        ([r["damper"], r["what"], f"{r['fitness']:.4f}",
          *("-" if pd.isna(v := r.get(n, float("nan"))) else f"{v:.0f}" for n in _VARIABLES),
          str(r["generation"] or "-")] for r in rows),
    )  # fmt: skip
    figures = (("6", "figure-6"), ("7", "figure-7"), ("7 with table 4", "figure-7-table-4"))
    text += [line for number, name in figures for line in ("", f"![Figure {number}]({name}.png)")]
    return [*text, ""]


def load_cases(settings: Settings) -> list[str]:
    """Section 6: five load cases, figures 8 to 14, and what the paper's text says of them."""
    from cosim.cli.report import ReportFormat, read, write
    from optimisation.campaign.paper import beside_paper
    from optimisation.campaign.runs import read_campaign

    place = settings.folder / "campaign"
    outcomes = carried_out(place, LOAD_CASES, workers=settings.workers, quiet=settings.quiet)
    failed = [label for label, o in outcomes.items() if o.error]
    study = read(place)
    page, _ = write(study, ReportFormat.HTML, settings.folder / "report.html")
    write(study, ReportFormat.PNG, settings.folder / "load-cases")
    text = [
        "## Section 6: load cases\n",
        f"Figures 8 to 14: [{page.name}]({page.name}), and as pictures in load-cases/.\n",
    ]
    text += markdown(
        ("quantity", "case", "damper", "channel", "unit", "paper", "ours, 95 % interval"),
        ([r.quantity, r.case, r.damper, r.channel, r.unit, f"{r.says} {r.paper:g}".strip(),
          f"{r.ours:.4g} [{r.low:.4g}, {r.high:.4g}]"] for r in beside_paper(read_campaign(place).table).itertuples()),
    )  # fmt: skip
    return [*text, *(f"\nfailed: {label}" for label in failed), ""]


LOAD_CASES = Options()
SECTIONS: dict[int, Callable[[Settings], list[str]]] = {4: identification, 5: optimisation, 6: load_cases}
QUICK = (4, 5)
_VARIABLES = ("nacelle_damper.k", "nacelle_damper.c", "platform_damper.k", "platform_damper.c")


def _tuned(fmu: Path, settings: Settings) -> list[OptimisationResult]:
    """The paper's search for each damper."""
    from optimisation.search import Generation
    from optimisation.tuning import BUDGET, Request, tune

    results = []
    with count_progress(settings.quiet) as bar:
        for damper in all_dampers():
            task = bar.add_task(f"tuning {damper}", total=BUDGET, note="")

            def show(g: Generation, task: Any = task) -> None:
                bar.update(task, completed=g.evaluations, note=f"generation {g.number}, best {g.best:.4f} m")

            request = Request(damper, seed=settings.seed)
            results.append(tune(request, fmu, workers=settings.workers, progress=show))
    return results


def _table_4(result: OptimisationResult, fmu: Path) -> list[dict[str, Any]]:
    """Rows of table 4 for one damper: the paper's, ours at its parameters, and ours."""
    import numpy as np

    from optimisation.objective import TowerTopDeviation, design

    task = design(result.damper)
    names = [v.name for v in task.variables]
    paper = dict(zip(names, task.paper_parameters, strict=True))

    def ours(**more: float) -> float:
        with TowerTopDeviation(fmu, names, task.switches | more) as objective:
            return float(objective(np.array([task.paper_parameters]))[0])

    about: list[tuple[str, float, dict[str, float], int | None]] = [
        ("paper", task.paper_fitness, paper, CONVERGED[result.damper]),
        ("ours at these parameters", ours(), paper, None),
        ("the same, stops act on the damper alone", ours(stop_reaction=0.0), paper, None),
        (f"ours, seed {result.seed}", result.fitness, result.parameters, result.converged_at),
    ]
    return [{"damper": result.damper, "what": w, "fitness": f, "generation": g} | p for w, f, p, g in about]


def _decay(damper: str, parameters: Path | None, settings: Settings) -> pd.DataFrame:
    """The simplified model's decay from 5 deg as in eq. 13: dampers at rest in the global frame, 100 s."""
    rest = [f"simplified.{place}.initial_displacement=0" for place in ("nacelle_damper", "platform_damper")]
    changes = Changes(set=rest, ssv=[parameters] if parameters else [], until=100.0)
    prepared = prepare(read_case("decay5-simplified"), damper, changes, quiet=settings.quiet)
    name = f"decay-{damper}-{'tuned' if parameters else 'table-4'}"
    if damper == "none" and (settings.runs / name).exists():
        return read_results(settings.runs / name)
    return read_results(simulate(prepared.system, prepared.settings, settings.runs / name).folder)


def markdown(head: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """Lines of a Markdown table."""
    return [f"| {' | '.join(row)} |" for row in (head, ["---"] * len(head), *rows)]
