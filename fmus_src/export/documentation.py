"""The FMU's one page of documentation: what it is, its variables, where its equations stand."""

from __future__ import annotations

from html import escape
from pathlib import Path

from fmus_src.component import Component
from fmus_src.equations import Equations

_STYLE = """body{font:16px/1.5 system-ui,sans-serif;max-width:60rem;margin:2rem auto;padding:0 1rem}
body{color:#222;background:#fff}
table{border-collapse:collapse;width:100%;font-size:14px}
th,td{text-align:left;padding:.25rem .5rem;border-bottom:1px solid #ddd;vertical-align:top}
td.n{text-align:right;font-variant-numeric:tabular-nums}code{font-size:13px}
@media(prefers-color-scheme:dark){body{color:#ddd;background:#181818}th,td{border-color:#444}}"""

_TITLES = {
    "parameter": "Parameters",
    "calculated": "Calculated parameters",
    "input": "Inputs",
    "output": "Outputs",
    "state": "Continuous states",
    "sampled_state": "Sampled states",
}


_INPUTS = {
    "2": "In co-simulation inputs may be given with first and second time derivatives.",
    "3": "In co-simulation inputs hold their values over a step.",
}


def documentation(equations: Equations, fmi: str = "2") -> str:
    """`documentation/index.html` of an FMU of FMI 2.0 or 3.0."""
    component = equations.component
    sampled = f", sampled every {component.sample_time:g} s" if component.sample_time else ""
    parts = [
        "<!DOCTYPE html>",
        f'<html lang="en"><head><meta charset="utf-8"><title>{escape(component.name)}</title>',
        f"<style>{_STYLE}</style></head><body>",
        f"<h1>{escape(component.name)}</h1><p>{escape(component.description)}.</p>",
        f"<p>FMI {fmi}.0 co-simulation and model exchange, written as equations in Python and exported as C: it needs "
        "neither Python nor any other tool. Co-simulation: Runge-Kutta integration of order 4 with sub-steps of at "
        f"most {component.internal_step:g} s{sampled}. Model exchange: the importer integrates; switches are event "
        f"indicators, samples time events. {_INPUTS[fmi]} Array elements count from 1. SI units.</p>",
    ]
    for causality, title in _TITLES.items():
        rows = [
            f"<tr><td><code>{escape(v.name)}{_dimensions(v.shape)}</code></td><td>{escape(v.unit)}</td>"
            f'<td class="n">{_start(v.start) if causality in ("parameter", "input") else ""}</td>'
            f"<td>{escape(v.description)}</td></tr>"
            for v in equations.variables
            if v.causality == causality and not v.internal
        ]
        if causality == "parameter":
            rows += [
                f"<tr><td><code>{escape(v.name)}</code></td><td>text</td><td></td><td>{escape(v.description)}</td></tr>"
                for v in equations.strings
            ]
        if rows:
            head = "<tr><th>name</th><th>unit</th><th>start</th><th>description</th></tr>"
            parts.append(f"<h2>{title}</h2><table>{head}{''.join(rows)}</table>")
    return "\n".join([*parts, "</body></html>"]) + "\n"


def licence(component: Component) -> str:
    """`documentation/licenses/license.txt`: the model's own licence, then that of the code around it."""
    own = [component.name, component.copyright, component.license and f"Licence: {component.license}"]
    around = (Path(__file__).parent / "license.txt").read_text(encoding="utf-8")
    return "\n".join([*(line for line in own if line), "", around])


def _dimensions(shape: tuple[int, ...]) -> str:
    return f"[{','.join(str(n) for n in shape)}]" if shape else ""


def _start(values: tuple[float, ...]) -> str:
    if len(set(values)) == 1:
        return f"{values[0]:g}"
    return ", ".join(f"{v:g}" for v in values) if len(values) <= 6 else "array"
