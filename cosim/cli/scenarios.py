"""What `fowt optimise` judges designs by besides the free decay: co-simulations, and linear models, in scenarios."""

from __future__ import annotations

import hashlib
import json
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from cosim.archive import sha256
from cosim.case import LoadCase, Number, qualified, read_case
from cosim.cli.console import warn
from cosim.cli.run import Changes, _value, prepare
from cosim.cli.scenario_options import design_values
from cosim.errors import CosimError, RunFailed, nearest
from cosim.recording import Channel, read_channels
from cosim.run import RunSettings, simulate
from cosim.system import StartValue, System, split_name, with_parameters

if TYPE_CHECKING:
    from cosim.case import Damper
    from optimisation.coupled import StoredResponses
    from optimisation.objective import Design
    from optimisation.receptance import LinearModel
    from optimisation.scenarios import Scenario, ScenarioFitness
    from optimisation.tuning import Request

Array = npt.NDArray[np.float64]
CHUNK = 64  # designs at once: a linear model has thousands of frequencies, and memory for a few is in the cache


@dataclass(frozen=True)
class Judged:
    """What designs are judged by, ready for the search.

    Attributes:
        task: variables with bounds and units.
        digests: of what the scenarios consist of, by label.
        prior: a cheap model of the responses, or None.
        fitness: makes the objective, which may take simulations of the reference; its argument are options of
            `optimisation.coupled.StoredResponses`.
    """

    task: Design
    digests: Mapping[str, str]
    prior: Callable[[Array], Array] | None
    fitness: Callable[[Mapping[str, Any]], ScenarioFitness]


def judge(request: Request, models: Path | None, *, quiet: bool) -> Judged:
    """Prepare the scenarios of a request.

    Args:
        models: folder of linear models, or None.
    """
    from optimisation.scenarios import ScenarioFitness

    if request.objective == "spectral":
        return _judge_spectral(request, models)
    runs = CoupledRuns(request, quiet=quiet)
    digests, prior = runs.digests(), None
    if request.surrogate_prior:
        prior, more = _prior(request, linear_models(models))
        digests |= more

    def fitness(options: Mapping[str, Any]) -> ScenarioFitness:
        reference = runs.reference(options)
        responses = runs.responses(options)
        return ScenarioFitness(responses, reference, request.scenarios, request.channels, request.aggregate)

    return Judged(runs.task(), digests, prior, fitness)


def linear_models(folder: Path | None) -> dict[Path, LinearModel]:
    """Linear models of a folder by file, in the order of their names.

    Raises:
        CosimError: no folder named, or there are none.
    """
    if folder is None:
        raise CosimError("this search needs its linear models: name their folder (--models FOLDER)")
    files = sorted(folder.glob("*.npz"))
    if not files:
        raise CosimError(f"--models {folder}: no linear models (*.npz); make them with 'fowt linearise'")
    from optimisation.receptance import LinearModel

    return {file: LinearModel.load(file) for file in files}


def _judge_spectral(request: Request, folder: Path | None) -> Judged:
    from optimisation.scenarios import ScenarioFitness

    models = linear_models(folder)
    labels = [m.label for m in models.values()]
    if labels != [s.label for s in request.scenarios]:
        raise CosimError(f"--models {folder}: its models are {', '.join(labels)}, the search is another's")
    names = [v.name for v in request.task().variables]
    responses = SpectralResponses(request, list(models.values()), names)
    values = design_values(request.damper, "--relative-to") if request.reference is None else request.reference
    # with the search's own --set, as co-simulations have it, and the reference's values on top
    reference = SpectralResponses(request, list(models.values()), (), values)(np.zeros((1, 0)))[0]

    def fitness(options: Mapping[str, Any]) -> ScenarioFitness:
        return ScenarioFitness(responses, reference, request.scenarios, request.channels, request.aggregate)

    return Judged(request.task(), {m.label: sha256(f) for f, m in models.items()}, None, fitness)


def _prior(request: Request, models: Mapping[Path, LinearModel]) -> tuple[Callable[[Array], Array], dict[str, str]]:
    """Responses by the linear models of the request's scenarios, and these models' digests."""
    found = {}
    for s in request.scenarios:
        case = read_case(s.case)
        files = [f for f, m in models.items() if _is_of(m, case, s, request.parameters)]
        if len(files) != 1:
            those = f"{len(files)} ({', '.join(f.name for f in files)})" if files else "none"
            others = [m.label for m in models.values()]
            raise CosimError(
                f"--models: {those} of '{s.label}'; name a folder with one, made by 'fowt linearise' with the case's"
                f" --seeds, --vary and --set (there are {', '.join(others[:6])}{', ...' * (len(others) > 6)})"
            )
        found[s.label] = files[0]
    chosen = [models[file] for file in found.values()]
    responses = SpectralResponses(request, chosen, [v.name for v in request.task().variables])

    def prior(candidates: Array) -> Array:
        return responses(candidates).reshape(len(candidates), -1)

    return prior, {f"{label}, linear": sha256(file) for label, file in found.items()}


def _is_of(model: LinearModel, case: LoadCase, scenario: Scenario, parameters: Mapping[str, float]) -> bool:
    """Whether a model was made in a scenario's case and seed, and with the search's parameters as the scenario changes
    them; the dampers' are told to the model as it is evaluated, the same in all scenarios."""
    own = case.seed if scenario.seed is None else scenario.seed
    same_seed = model.about.get("seed", own) == own or not (case.seed_parameters or case.wind)
    free = _damper_values(model)
    given = {n: v for n, v in _made_with(model).items() if n not in free}
    wanted = {n: v for n, v in parameters.items() if n not in free} | dict(scenario.overrides)
    return model.about.get("case") == case.name and same_seed and given == wanted


def _damper_values(model: LinearModel) -> set[str]:
    """Names of what a linear model leaves to the design, or knows of its dampers."""
    return {f"{d.name}.{q}" for d in model.dampers for q in ("m", "k", "c", "stroke", "k_stop", "c_stop")}


def _made_with(model: LinearModel) -> dict[str, Number]:
    """Values that a model was made with by --set and --vary."""
    given = dict(item.split("=", 1) for item in model.about.get("set", ()))
    return {name: _value(text) for name, text in given.items()}


class SpectralResponses:
    """Standard deviations of the request's channels by linear models, see `optimisation.scenarios.Responses`.

    Raises:
        CosimError: the models have other dampers or lack a channel.
        ValueError: the models cannot have a variable.
    """

    def __init__(
        self,
        request: Request,
        models: Sequence[LinearModel],
        names: Sequence[str],
        design: Mapping[str, float] | None = None,
    ) -> None:
        from optimisation.spectral import SpectralResponse

        wanted = sorted(name.removesuffix(".active") for name, on in request.task().switches.items() if on)
        theirs = sorted(d.name for d in models[0].dampers)
        if wanted != theirs:
            raise CosimError(f"the linear models have {' and '.join(theirs)}, {request.damper} {' and '.join(wanted)}")
        known = _damper_values(models[0])
        for name, value in request.parameters.items():
            if name not in known and any(_made_with(m).get(name) != value for m in models):
                raise CosimError(
                    f"'{name}' is fixed in the linear models: make some with 'fowt linearise --set {name}=VALUE'"
                )
        values = design_values(request.damper, "damper") | dict(request.parameters) | dict(design or {})
        fixed = {n: float(v) for n, v in values.items() if n not in names}
        self._response = SpectralResponse(models, names, fixed)
        for channel in request.channels:
            if channel not in self._response.channels:
                raise CosimError(f"the linear models have no channel '{channel}'{nearest(channel, models[0].channels)}")
        self._columns = [self._response.channels.index(c) for c in request.channels]
        self._names = tuple(names)
        self.first_failure: str | None = None

    def __call__(self, candidates: Array) -> Array:
        """Shape (n, scenarios, channels)."""
        with np.errstate(all="ignore"):  # what is not finite is reported as such
            parts = [self._response(candidates[i : i + CHUNK]) for i in range(0, len(candidates), CHUNK)]
        found: Array = np.concatenate(parts)[:, :, self._columns]
        failed = np.flatnonzero(~np.isfinite(found).all(axis=(1, 2)))
        if len(failed) and self.first_failure is None:
            x = candidates[failed[0]]
            at = ", ".join(f"{n} = {v:.6g}" for n, v in zip(self._names, x, strict=True))
            self.first_failure = f"the linear model is not stable at {at}"
        return found


@dataclass(frozen=True)
class _Run:
    """A scenario with one damper arrangement, ready to start."""

    system: System
    settings: RunSettings
    arrangement: Damper

    def with_values(self, values: Mapping[str, Any]) -> System:
        starts = {name: StartValue(value) for name, value in values.items()}
        return with_parameters(self.system, qualified(starts, self.arrangement, self.system))


class CoupledRuns:
    """Co-simulations of the full system: each scenario prepared once, each run with a design's values.

    Raises:
        CosimError: an unknown case, channel, parameter or reference.
    """

    def __init__(self, request: Request, *, quiet: bool) -> None:
        self._request, self._quiet = request, quiet
        if request.until is not None and request.until <= max(read_case(s.case).transient for s in request.scenarios):
            warn(f"runs of {request.until:g} s end within the transient: statistics include it")
        self._runs = [self._prepare(s, request.damper) for s in request.scenarios]
        own = request.reference is None and request.relative_to != request.damper
        self._references = [self._prepare(s, request.relative_to) for s in request.scenarios] if own else self._runs
        self._contents: dict[Path, str] = {}

    def _prepare(self, scenario: Scenario, damper: str) -> _Run:
        request, case = self._request, read_case(scenario.case)
        channels = _selected(case, request.channels)
        beyond = request.until is not None and request.until > case.stop  # a longer wind box
        changes = Changes(seed=scenario.seed, until=request.until if beyond else None)
        prepared = prepare(case, damper, changes, quiet=self._quiet)
        settings = replace(prepared.settings, channels=channels)
        if request.until is not None:
            transient = case.transient if request.until > case.transient else 0.0
            settings = replace(settings, stop=request.until, transient=transient)
            settings.steps()
        run = _Run(prepared.system, settings, case.dampers[damper])
        return replace(run, system=run.with_values({**request.parameters, **scenario.overrides}))

    def task(self) -> Design:
        """The request's variables, held against the FMUs that have them."""
        from optimisation.variables import checked_variables

        run = self._runs[0]

        def fmu_of(name: str) -> tuple[Path, str]:
            full = next(iter(qualified({name: StartValue(0.0)}, run.arrangement, run.system)), name)
            owner, variable = split_name(full, {c.name for c in run.system.components})
            return run.system.component(owner).fmu, variable

        return checked_variables(self._request.task(), fmu_of)

    def digests(self) -> dict[str, str]:
        """What each scenario consists of, as digests by label: FMUs, their parameters, wind, connections, settings."""
        labels = [s.label for s in self._request.scenarios]
        pairs = zip(labels, self._runs, self._references, strict=True)
        return {label: self._digest(run, reference) for label, run, reference in pairs}

    def _digest(self, *runs: _Run) -> str:
        from optimisation.checkpoint import fmu_digest

        def content(value: Any) -> Any:
            path = Path(value) if isinstance(value, str) and value else None
            if path is None or not path.is_file():
                return value
            if path not in self._contents:
                self._contents[path] = fmu_digest(path) if path.suffix == ".fmu" else sha256(path)
            return self._contents[path]

        parts = [
            {
                "components": [
                    [c.name, content(str(c.fmu)), {n: [content(v.value), v.unit] for n, v in c.start.items()}]
                    for c in run.system.components
                ],
                "connections": [asdict(c) for c in run.system.connections],
                "settings": asdict(run.settings),
            }
            for run in runs
        ]
        return hashlib.sha256(json.dumps(parts, sort_keys=True, default=str).encode()).hexdigest()

    def reference(self, options: Mapping[str, Any]) -> Array:
        """Standard deviations of the design that others are compared with, shape (scenarios, channels).

        Args:
            options: of `optimisation.coupled.StoredResponses`.
        """
        from optimisation.coupled import StoredResponses

        request, values = self._request, self._request.reference or {}

        def run(_: Mapping[str, float], s: int, stopped: Callable[[], bool]) -> Array:
            return self._simulate(self._references[s], values, stopped)

        responses = StoredResponses(run, (), request.scenarios, request.channels, **options)
        found: Array = responses(np.empty((1, 0)))[0]
        if responses.first_failure:
            raise CosimError(f"--relative-to {request.relative_to}: {responses.first_failure}")
        return found

    def responses(self, options: Mapping[str, Any]) -> StoredResponses:
        """Standard deviations of designs; options as of `reference`."""
        from optimisation.coupled import StoredResponses

        request = self._request

        def run(values: Mapping[str, float], s: int, stopped: Callable[[], bool]) -> Array:
            return self._simulate(self._runs[s], values, stopped)

        names = [v.name for v in request.task().variables]
        return StoredResponses(run, names, request.scenarios, request.channels, **options)

    def _simulate(self, run: _Run, values: Mapping[str, float], stopped: Callable[[], bool]) -> Array:
        from optimisation.coupled import SimulationFailed

        def on_progress(*_: float) -> None:
            if stopped():
                raise KeyboardInterrupt

        with tempfile.TemporaryDirectory(prefix="fowt-run-", ignore_cleanup_errors=True) as folder:
            try:
                result = simulate(run.with_values(values), run.settings, Path(folder) / "run", on_progress)
            except RunFailed as error:
                if isinstance(error.__cause__, OSError):  # a full disk is no fault of the design
                    raise
                raise SimulationFailed(str(error)) from error
        names = self._request.channels
        missing = [name for name in names if name not in result.summary]
        if missing:
            raise CosimError(
                f"channel {missing[0]} is not there with damper '{run.arrangement.name}': leave it out (--channels), or"
                " compare with another design (--relative-to)"
            )
        found = np.array([result.summary[name]["std"] for name in names])
        if not np.isfinite(found).all():
            name = names[int(np.flatnonzero(~np.isfinite(found))[0])]
            raise SimulationFailed(f"the standard deviation of {name} is not finite")
        return found


def _selected(case: LoadCase, names: Sequence[str]) -> tuple[Channel, ...]:
    known = {c.name: c for c in read_channels(case.channels)}
    for name in names:
        if name not in known:
            raise CosimError(f"{case.name}: no channel '{name}'{nearest(name, known)}")
    return tuple(known[name] for name in names)
