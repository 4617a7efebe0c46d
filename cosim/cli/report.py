"""`fowt report`: a campaign as one page to send, as pictures or as tables."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer

from cosim.cli.console import busy, out, warn
from cosim.errors import CosimError

if TYPE_CHECKING:
    from optimisation.report.study import Study, WindField

WIND_CASE = "lc4"  # the paper's figure 8
WIND_SECONDS = 200.0
WIND_MEANS = 0.5  # s


class ReportFormat(StrEnum):
    """What a campaign is written as."""

    HTML = "html"
    PNG = "png"
    CSV = "csv"


def report(
    folder: Annotated[Path, typer.Argument(help="Folder of 'fowt campaign', finished or not.")],
    target: Annotated[
        Path | None, typer.Option("--out", help="File (html) or folder (png, csv). Default: report.html, in FOLDER.")
    ] = None,
    kind: Annotated[
        ReportFormat, typer.Option("--format", help="html: one page; png: static figures; csv: the tables behind them.")
    ] = ReportFormat.HTML,
) -> None:
    """Write what a campaign found: one page with interactive figures, tables and the turbine in motion.

    The page needs no network and no other file. Runs without a result are named
    and left out.

    Example: [bold]fowt report runs/campaign --out report.html[/bold]
    """
    with busy("reading the runs"):
        study = read(folder)
    if lacking := study.lacking():
        names = ", ".join(r.name for r in lacking[:8]) + (f" and {len(lacking) - 8} more" if len(lacking) > 8 else "")
        warn(f"{len(lacking)} of {len(study.runs)} runs have no result and are left out: {names}")
    with busy("drawing"):
        written, what = write(
            study, kind, target or folder / (f"report{'' if kind is ReportFormat.HTML else f'-{kind}'}")
        )
    out.print(f"{what}: {written}", soft_wrap=True)


def read(folder: Path) -> Study:
    """A campaign's study, with its system's graph and a wind field where their files are still there.

    Raises:
        CosimError: no such folder. ValueError: it holds no campaign, or nothing of it is finished.
    """
    from optimisation.campaign.runs import read_campaign
    from optimisation.report.diagram import connection_table
    from optimisation.report.study import read_study

    if not folder.is_dir():
        raise CosimError(f"{folder}: no such folder; give that of a 'fowt campaign'")
    study = read_study(read_campaign(folder))
    records = [r.record for r in study.runs if r.record]
    units = _units(study)
    largest = max(records, key=lambda r: len(r.get("connections", [])))
    graph = connection_table(largest.get("connections", []), units)
    return replace(study, graph=graph, variable_units=units, wind=_wind(study))


def write(study: Study, kind: ReportFormat, target: Path) -> tuple[Path, str]:
    """Write the report in one format; returns where, and what was written."""
    from optimisation.report.sections import all_sections

    sections = all_sections(study)
    if kind is ReportFormat.HTML:
        from optimisation.report.page import render

        page = target.with_suffix(".html") if not target.suffix else target
        page.parent.mkdir(parents=True, exist_ok=True)
        made = datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC")
        page.write_text(render(study, sections, made), encoding="utf-8")
        return page, f"page of {page.stat().st_size / 1e6:.1f} MB"
    target.mkdir(parents=True, exist_ok=True)
    if kind is ReportFormat.CSV:
        tables = {t.name: t.frame for s in sections for t in s.tables}
        tables |= {
            f"{p.name}-{k}".rstrip("-"): v.table for s in sections for p in s.plots for k, v in p.variants.items()
        }
        for name, table in tables.items():
            table.to_csv(target / f"{name}.csv", index=False)
        return target, f"{len(tables)} tables"
    from optimisation.report.static import draw_all

    return target, f"{len(draw_all(study, target))} pictures"


def _units(study: Study) -> dict[str, str]:
    """Units of the FMUs' variables, by component.variable, of the FMUs that are still where the runs had them."""
    from cosim.fmu import read_fmu

    files = {
        (name, content["fmu"])
        for run in study.runs
        for name, content in run.record.get("components", {}).items()
        if "fmu" in content
    }
    units: dict[str, str] = {}
    for component, file in sorted(files):
        try:
            variables = read_fmu(Path(file)).variables.values()
        except CosimError:
            continue
        units |= {f"{component}.{v.name}": v.unit.name if v.unit else "" for v in variables}
    return units


def _wind(study: Study) -> WindField | None:
    """The wind on the vertical through the hub in one case, if its box is still in the cache."""
    from fmus_src.aero.turbsim_file import read_box
    from optimisation.report.study import WindField

    files = {
        run.case: (run.seed, Path(str(component["start"]["wind_file"])))
        for run in reversed(study.runs)
        for component in run.record.get("components", {}).values()
        if "wind_file" in component.get("start", {})
    }
    case = WIND_CASE if WIND_CASE in files else next(iter(files), None)
    if case is None:
        return None
    seed, file = files[case]
    try:
        box = read_box(file)
    except (OSError, ValueError):
        return None
    size = max(1, round(WIND_MEANS / box.dt))
    count = min(len(box.velocity), round(WIND_SECONDS / box.dt)) // size
    middle = box.velocity[: count * size, :, box.velocity.shape[2] // 2, 0]
    speed = middle.reshape(count, size, -1).mean(axis=1).T
    time, height = (0.5 + np.arange(count)) * size * box.dt, box.z_bottom + np.arange(len(speed)) * box.dz
    return WindField(case, seed, time.astype(float), height.astype(float), speed.astype(float))
