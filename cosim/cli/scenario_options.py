"""Options of `fowt optimise` about scenarios: load cases, seeds, uncertain values, reference and starting designs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cosim.case import case_folder, read_case, read_dampers
from cosim.cli.run import _pair
from cosim.cli.seeds import parsed_seeds
from cosim.errors import CosimError, nearest
from cosim.ssp import read_parameters

if TYPE_CHECKING:
    from optimisation.objective import Design
    from optimisation.scenarios import Scenario

CHANNELS = ("PtfmPitch", "TTDspFA")


class ObjectiveName(StrEnum):
    """What designs are judged by."""

    DECAY = "decay"
    SPECTRAL = "spectral"
    COUPLED = "coupled"


class How(StrEnum):
    """How scenarios and channels make one fitness."""

    WORST = "worst"
    MEAN = "mean"
    WORST_CASE = "worst-case"


@dataclass(frozen=True)
class ScenarioOptions:
    """The options of `fowt optimise` that concern scenarios; None where not given."""

    objective: ObjectiveName | None
    cases: str | None
    seeds: str | None
    vary: list[str] | None
    until: float | None
    channels: str | None
    aggregate: How | None
    relative_to: str | None
    start: list[str] | None
    models: Path | None

    def settings(self, given: Mapping[str, Any], resume: Path | None) -> dict[str, Any]:
        """Fields of a `Request`, None where the option is not given (with --resume) or has no part in it.

        Raises:
            CosimError: an option is missing, or goes with another objective.
        """
        objective = self.objective.value if self.objective else None
        if resume is None:
            objective = objective or "decay"
            self._refuse(objective, given)
        found: dict[str, Any] = {
            "objective": objective,
            "aggregate": self.aggregate and self.aggregate.value,
            "until": self.until,
            "channels": self.channels
            and tuple(dict.fromkeys(c.strip() for c in self.channels.split(",") if c.strip())),
        }
        if resume is not None and (self.start or ((self.seeds or self.vary) and not self.cases)):
            raise CosimError("--resume goes on with its scenarios and starts: leave out --seeds, --vary and --start")
        if self.cases:
            found["scenarios"] = parsed_scenarios(self.cases, self.seeds, self.vary or ())
        if self.relative_to:
            found["relative_to"] = self.relative_to
            file = Path(self.relative_to)
            found["reference"] = design_values(self.relative_to, "--relative-to") if file.suffix == ".ssv" else None
        if resume is None and objective != "decay":
            found["channels"] = found["channels"] or CHANNELS
            if objective == "coupled" and not given.get("method"):
                found["method"] = "surrogate"
            if objective == "spectral":
                self._use_models(found, str(given.get("damper")))
            found["surrogate_prior"] = objective == "coupled" and self.models is not None
        if self.start:
            names = [v.name for v in _task(given).variables]
            found["starts"] = start_designs(self.start, names)
        return {name: value for name, value in found.items() if value is not None}

    def _use_models(self, found: dict[str, Any], damper: str) -> None:
        """A scenario per linear model; they have their dampers, so that there is no design without."""
        from cosim.cli.scenarios import linear_models
        from optimisation.scenarios import Scenario

        found["scenarios"] = tuple(
            Scenario(m.label, group=str(m.about.get("case", ""))) for m in linear_models(self.models).values()
        )
        if self.relative_to not in (None, damper) and found.get("reference") is None:
            raise CosimError(
                f"--relative-to {self.relative_to}: linear models have dampers: compare with {damper} or a .ssv file"
            )
        found["relative_to"] = self.relative_to or damper

    def _refuse(self, objective: str, given: Mapping[str, Any]) -> None:
        """Refuse options that the objective does not have."""
        theirs = {
            "cases": "coupled", "seeds": "coupled", "vary": "coupled", "until": "coupled",
            "channels": "coupled spectral", "aggregate": "coupled spectral", "relative_to": "coupled spectral",
            "start": "coupled spectral", "models": "coupled spectral",
        }  # fmt: skip
        for name, objectives in theirs.items():
            if getattr(self, name) is not None and objective not in objectives:
                option = "--" + name.replace("_", "-")
                raise CosimError(f"{option} is for --objective {objectives.replace(' ', ' or ')}, not {objective}")
        if objective == "coupled" and not self.cases:
            raise CosimError("--objective coupled: name load cases, such as --cases lc1,lc4")
        if objective == "spectral" and self.models is None:
            raise CosimError("--objective spectral: name the folder of linear models (--models FOLDER)")


def _task(given: Mapping[str, Any]) -> Design:
    from optimisation.tuning import Request

    if not given.get("damper"):
        raise CosimError("name a damper to tune: tmd-n, tmd-p, mtmd; with --objective coupled also tlcd-p, tmdi-n")
    names = ("bounds", "variables")
    return Request(given["damper"], **{n: given[n] for n in names if given.get(n)}).task()


def parsed_scenarios(cases: str, seeds: str | None, vary: Sequence[str]) -> tuple[Scenario, ...]:
    """Every case with every seed (its own by default) and every value of the varied parameters.

    Args:
        cases: "lc1,lc3", or with weights "lc1=2,lc3"; seeds: see `parsed_seeds`; vary: "COMPONENT.PARAM=V1,V2,...".
    """
    from optimisation.scenarios import Scenario

    varied = [[(name, _number(name, v)) for v in text.split(",")] for name, text in _pairs(vary)]
    scenarios = []
    for item in _words(cases):
        name, _, weight = item.partition("=")
        case = read_case(name)
        own: list[int | None] = [case.seed] if case.seed_parameters else [None]
        if seeds is not None and not case.seed_parameters:
            raise CosimError(f"--seeds {seeds}: {name} has no random wind or sea; leave it out")
        for seed, values in product(own if seeds is None else parsed_seeds(seeds), product(*varied)):
            scenarios.append(Scenario(name, seed, dict(values), _number(item, weight) if weight else 1.0))
    if not scenarios:
        raise CosimError("--cases names no load case; 'fowt list' shows all")
    labels = [s.label for s in scenarios]
    for scenario in scenarios:
        if labels.count(scenario.label) > 1:
            raise CosimError(f"--cases, --vary: '{scenario.label}' appears twice (values are told apart by six digits)")
        if scenario.weight < 0.0:
            raise CosimError(f"--cases {scenario.case}={scenario.weight:g}: a weight is at least 0")
    if not any(s.weight > 0.0 for s in scenarios):
        raise CosimError("--cases: one weight at least must be above 0")
    return tuple(scenarios)


def _pairs(vary: Sequence[str]) -> list[tuple[str, str]]:
    return [_pair(item, "--vary", "COMPONENT.PARAM=VALUE,VALUE") for item in vary]


def _number(name: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not np.isfinite(value):
        raise CosimError(f"{name}: '{text}' is no finite number")
    return value


def design_values(source: str, option: str) -> dict[str, float]:
    """Values of a design by name, SI units: of a parameter set file, or of a damper arrangement's own."""
    arrangements = read_dampers(case_folder() / "dampers.toml")
    file = arrangements[source].parameters if source in arrangements else Path(source)
    if file is None or not file.is_file():
        known = [n for n, a in arrangements.items() if a.parameters is not None]
        hint = nearest(source, known)
        raise CosimError(f"{option} {source}: neither a parameter set file nor a tuned arrangement{hint}")
    values = {}
    for name, start in read_parameters(file).items():
        if isinstance(start.value, bool) or not isinstance(start.value, (int, float)):
            raise CosimError(f"{file}: {name} is no number")
        factor, offset = (start.unit.factor, start.unit.offset) if start.unit else (1.0, 0.0)
        values[name] = factor * float(start.value) + offset
    return values


def start_designs(sources: Sequence[str], names: Sequence[str]) -> dict[str, tuple[float, ...]]:
    """Designs to begin a search with, by label, in the order of the variables' names."""
    starts = {}
    for source in dict.fromkeys(sources):
        values = design_values(source, "--start")
        missing = [n for n in names if n not in values]
        if missing:
            raise CosimError(f"--start {source}: has no value of {', '.join(missing)}; add it, or leave the start out")
        starts[source] = tuple(values[n] for n in names)
    return starts


def _words(text: str) -> list[str]:
    return list(dict.fromkeys(word.strip() for word in text.split(",") if word.strip()))
