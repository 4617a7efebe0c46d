"""`fowt inspect` and `fowt validate`: what a file from elsewhere offers, and whether it can be relied on."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table
from rich.text import Text

from cosim.cli.console import Format, FormatOption, emit, out
from cosim.errors import CosimError
from cosim.inspection import inspect as look
from cosim.validation import TIMEOUT, Finding
from cosim.validation import validate as check

WIDE = 100  # columns that a table with descriptions takes
LISTED = 8  # parameters of a component
SHOWN = ("input", "output", "parameter", "structuralParameter")
STYLES = {"ok": "green", "warning": "yellow", "fail": "bold red", "skipped": "dim"}


def inspect(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="An FMU, or an SSP package.")],
    everything: Annotated[bool, typer.Option("--all", help="Local variables, sources and files too.")] = False,
    output: FormatOption = Format.TEXT,
) -> None:
    """Show what an FMU or a package offers: interfaces, platforms, variables, capabilities. Loads no binary.

    Example: [bold]fowt inspect damper.fmu[/bold]
    """
    facts = look(file)
    if output is Format.JSON:
        emit(facts)
    elif facts["kind"] == "FMU":
        _show_fmu(facts, everything)
    else:
        _show_package(facts, everything)


def validate(
    files: Annotated[list[Path], typer.Argument(metavar="FILE", help="FMUs or SSP packages; their binaries are run.")],
    step: Annotated[float | None, typer.Option(metavar="H", min=1e-9, help="Step of the trials, s.")] = None,
    timeout: Annotated[float, typer.Option(metavar="T", min=1.0, help="Wall time for all trials of one, s.")] = TIMEOUT,
    output: FormatOption = Format.TEXT,
) -> None:
    """Check FMUs: description, units, platform, and trials of each binary in a process of its own.

    Of a package: its structure, and each FMU in it. Of several files it shows
    what is not ok. Exits with 0 if nothing fails, with 1 if something does.

    Example: [bold]fowt validate damper.fmu[/bold]
    """
    missing = next((f for f in files if not f.is_file()), None)
    if missing is not None:
        raise CosimError(f"FMU {missing}: no such file")
    reports: list[dict[str, Any]] = []
    for file in files:
        findings = check(file, step, timeout)
        failed = any(f.status == "fail" for f in findings)
        reports.append({"file": str(file), "passed": not failed, "findings": [asdict(f) for f in findings]})
        if output is not Format.JSON:
            _show_findings(file, findings, alone=len(files) == 1)
    passed = all(r["passed"] for r in reports)
    if output is Format.JSON:
        emit(reports[0] if len(reports) == 1 else {"passed": passed, "files": reports})
    if not passed:
        raise typer.Exit(1)


def _show_findings(file: Path, findings: list[Finding], alone: bool) -> None:
    """All findings, then the verdict; of one file among several the verdict, then what is not ok."""
    doubts, failed = (sum(f.status == s for f in findings) for s in ("warning", "fail"))
    words = f"{failed} of {len(findings)} checks fail" if failed else "usable"
    words += f", {doubts} warning{'s' if doubts > 1 else ''}" if doubts else ""
    verdict = Text(f"{file}: {words}", style=STYLES["fail" if failed else "ok"])
    if not alone:
        out.print(verdict, soft_wrap=True)
    table = Table(box=None, show_header=False, pad_edge=not alone)
    for f in findings:
        if alone or f.status != "ok":
            table.add_row(Text(f.name), Text(f.status, style=STYLES[f.status]), Text(f.detail))
    if table.row_count:
        out.print(table)
    if alone:
        out.print(verdict, soft_wrap=True)


def _show_fmu(facts: dict[str, Any], everything: bool) -> None:
    kinds = ", ".join(facts["interfaces"]) or "no interface"
    _line(f"{facts['file']}: FMI {facts['fmi']}, {kinds}, {facts['size'] / 1000:.0f} kB")
    title = ": ".join(filter(None, (facts["model"], facts["description"])))
    _line(title + (f" (by {facts['generator']})" if facts["generator"] else ""))
    _line(f"sha256 {facts['sha256']}")
    here = "" if facts["runs_here"] else " (none for this machine)"
    _line(f"platforms: {', '.join(facts['platforms']) or 'none'}{here}; {len(facts['sources'])} source files")
    for name, capabilities in facts["interfaces"].items():
        words = (k if v is True else f"{k} = {v}" for k, v in capabilities.items() if k != "modelIdentifier")
        _line(f"{name}: {', '.join(words) or 'no capability beyond the minimum'}")
    shown = [v for v in facts["variables"] if everything or v["causality"] in SHOWN]
    table = Table(box=None, pad_edge=False)
    for column in ("variable", "causality", "type", "unit", "start"):
        table.add_column(column, no_wrap=True)
    described = out.width >= WIDE
    if described:
        table.add_column("description")
    for v in sorted(shown, key=lambda v: SHOWN.index(v["causality"]) if v["causality"] in SHOWN else len(SHOWN)):
        cells = [v["name"], v["causality"], v["type"], v["unit"], v["start"][:24]]
        cells += [v["description"]] if described else []
        table.add_row(*(Text(c) for c in cells))
    out.print(table)
    left = len(facts["variables"]) - len(shown)
    if left:
        _line(f"and {left} of other causality; --all shows them")
    if everything:
        for name in (*facts["sources"], *facts["resources"]):
            _line(name)


def _show_package(facts: dict[str, Any], everything: bool) -> None:
    _line(f"{facts['file']}: SSP {facts['ssp']}, system '{facts['system']}', {facts['size'] / 1e6:.1f} MB")
    _line(f"sha256 {facts['sha256']}")
    times = {n: facts[n] for n in ("start", "stop", "step") if facts[n] is not None}
    _line(f"{len(facts['connections'])} connections, {len(facts['outputs'])} named outputs; "
          + (", ".join(f"{n} {v:g} s" for n, v in times.items()) or "no times"))  # fmt: skip
    for name, c in facts["components"].items():
        made = f", by {c['generator']}" if c["generator"] else ""
        _line(
            f"{name}: {c['fmu']} (FMI {c['fmi']}; {', '.join(c['platforms']) or 'no binary'}; {c['sha256'][:12]}{made})"
        )
        shown = [f"{k} = {v}" for k, v in c["parameters"].items()]
        more = [f"... ({len(shown)} values)"] if len(shown) > LISTED and not everything else []
        if shown:
            _line(f"    {', '.join(shown[: None if everything else LISTED] + more)}")
    for line in (*facts["notes"], *(facts["connections"] + facts["files"] if everything else ())):
        _line(line)


def _line(text: str) -> None:
    out.print(Text(text), soft_wrap=True)
