"""`fowt list`: load cases, damper arrangements and components."""

from __future__ import annotations

from rich.table import Table

from cosim.case import read_case, shipped_cases
from cosim.cli.console import Format, FormatOption, emit, out


def list_all(output: FormatOption = Format.TEXT) -> None:
    """List load cases, damper arrangements and components.

    Example: [bold]fowt list --format json[/bold]
    """
    from fmus_src.library import component_names

    cases = {name: read_case(name) for name in shipped_cases()}
    dampers = {name: d.description for case in cases.values() for name, d in case.dampers.items()}
    if output is Format.JSON:
        emit({
            "cases": {name: case.description for name, case in cases.items()},
            "dampers": dampers,
            "components": component_names(),
        })  # fmt: skip
        return
    for title, rows in (("load case", {n: c.description for n, c in cases.items()}), ("damper", dampers)):
        table = Table(title, "description", box=None, pad_edge=False)
        for name, description in rows.items():
            table.add_row(name, description)
        out.print(table)
        out.print()
    out.print("components: " + ", ".join(component_names()))
