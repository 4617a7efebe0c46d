"""The report as one self-contained HTML page: sections, figures and data in a template."""

from __future__ import annotations

from collections.abc import Iterable
from importlib import resources
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import jinja2

from optimisation.report.diagram import system_svg
from optimisation.report.findings import lacking_sentence
from optimisation.report.motion import motion_data
from optimisation.report.sections import Section
from optimisation.report.study import Study
from optimisation.report.style import case_name, damper_name, listed

FIRST_SHOWN = "lc4"  # of the load cases: rough, and what the paper shows


def render(study: Study, sections: Iterable[Section], made: str) -> str:
    """The page.

    Args:
        made: when, for the footer.

    Returns:
        HTML that loads nothing: style, scripts, plotly.js and data are inside.
    """
    from plotly.offline import get_plotlyjs

    kept = tuple(sections)
    environment = jinja2.Environment(autoescape=True, trim_blocks=True, undefined=jinja2.StrictUndefined)
    figures = {p.name: {key: v.figure.to_plotly_json() for key, v in p.variants.items()} for s in kept for p in s.plots}
    motion = motion_data(study) if any(s.special == "motion" for s in kept) else {}
    graph = system_svg(study.graph, "Components of the system and their connections") if study.graph is not None else ""
    return environment.from_string(_file("report.html.j2")).render(
        title=f"Damper campaign {study.name}",
        subtitle=_subtitle(study),
        studied=_studied(study),
        lacking=lacking_sentence(study),
        sections=kept,
        case_name=case_name,
        chosen=_chosen,
        graph=graph,
        css=_file("report.css"),
        motion=_file("motion.html"),
        plotly=get_plotlyjs(),
        script=_file("report.js") + "\n" + _file("motion.js"),
        figures=_json(figures),
        motion_data=_json(motion),
        made=made,
        version=_version(),
    )


def _subtitle(study: Study) -> str:
    done = len(study.runs) - len(study.lacking())
    cases = ", ".join(case_name(c) for c in study.cases)
    dampers = ", ".join(damper_name(d) for d in study.dampers)
    return f"{cases}; {dampers}; {done} runs; NREL 5-MW turbine on the ITI Energy barge"


def _studied(study: Study) -> str:
    plural = "s" if len(study.seeds) > 1 else ""
    dampers, cases = len(study.damped), len(study.cases)
    names = listed([damper_name(d) for d in study.damped])
    return (
        f"{dampers} damper arrangement{'s' * (dampers != 1)} ({names}) beside the turbine without damper, in {cases}"
        f" load case{'s' * (cases != 1)} with {len(study.seeds)} realisation{plural} of wind and sea"
        f" (seed{plural} {', '.join(map(str, study.seeds))}). Every arrangement meets the same wind and sea, so rates"
        " are differences of pairs."
    )


def _chosen(choices: Iterable[str]) -> str:
    names = list(choices)
    return FIRST_SHOWN if FIRST_SHOWN in names else names[0]


def _json(content: Any) -> str:
    """JSON that may stand in a script element; arrays as base64, as plotly.js reads them."""
    from plotly.io.json import to_json_plotly

    return str(to_json_plotly(content, engine="json")).replace("<", "\\u003c").replace("\u2028", "\\u2028")


def _file(name: str) -> str:
    return resources.files("optimisation.report").joinpath("templates", name).read_text(encoding="utf-8")


def _version() -> str:
    try:
        return version("fowt-cosim")
    except PackageNotFoundError:
        return "(not installed)"
