"""Judging a design in several scenarios (load cases, seeds, uncertain parameters) by several responses at once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal, Protocol

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
How = Literal["worst", "mean", "worst-case"]
WORDS: dict[How, str] = {"worst": "largest", "mean": "mean", "worst-case": "largest case's mean"}


@dataclass(frozen=True)
class Scenario:
    """Conditions under which a design is judged.

    Attributes:
        case: label of the load case.
        seed: of its wind and sea; None if it has neither.
        overrides: values of the system's parameters by name, where they differ (an uncertain inertia, say).
        weight: in the mean over the scenarios; 0: the scenario is evaluated and not judged.
        group: load case that it is one realisation of, if that is not `case`.
    """

    case: str
    seed: int | None = None
    overrides: Mapping[str, float] = field(default_factory=dict)
    weight: float = 1.0
    group: str = ""

    @property
    def label(self) -> str:
        """Such as "lc1 seed 2, barge.platform.Iyy = 7e+08"."""
        words = [self.case if self.seed is None else f"{self.case} seed {self.seed}"]
        return ", ".join([*words, *(f"{name} = {value:g}" for name, value in self.overrides.items())])


class Responses(Protocol):
    """Standard deviations of a design's responses in each scenario.

    Attributes:
        first_failure: message of the first design that could not be evaluated, or None.
    """

    first_failure: str | None

    def __call__(self, candidates: Array, /) -> Array:
        """Standard deviations, shape (n, scenarios, channels), of designs of shape (n, variables); nan: none."""


def aggregate(
    deviations: Array, reference: Array, weights: Array, how: How, cases: Sequence[str] | None = None
) -> Array:
    """One fitness of each design: its standard deviations by the reference's, averaged or the worst of them.

    "worst-case" averages over the realisations (seeds, uncertain parameters) of a load case, and takes the worst of
    load cases and channels: one seed's standard deviation is a draw, the mean of several an estimate.

    By "worst" and with the published design as the reference, a fitness below 1 is better in every one of them.

    Args:
        deviations: shape (n, scenarios, channels).
        reference: of the design that it is compared with, shape (scenarios, channels).
        weights: of the mean, at least 0, shape (scenarios, channels) or one that broadcasts to it; "worst" leaves out
            what has no weight, and treats the rest alike.
        cases: the scenarios' load cases, for "worst-case"; each its own by default.

    Returns:
        shape (n,); nan for a design that lacks any of its deviations.

    Raises:
        ValueError: a reference is not positive, or a weight negative or all are 0.
    """
    weights = np.broadcast_to(np.asarray(weights, dtype=float), reference.shape)
    if not (np.all(np.isfinite(reference)) and np.all(reference > 0.0)):
        raise ValueError("a reference's standard deviation is not above 0: leave out that channel")
    if not (np.all(np.isfinite(weights)) and np.all(weights >= 0.0) and np.any(weights > 0.0)):
        raise ValueError("weights of scenarios must be at least 0, and one above it")
    ratios = deviations / reference
    if how == "mean":
        return np.asarray((ratios * weights).sum(axis=(1, 2)) / weights.sum())
    if how == "worst-case":
        names = list(cases or map(str, range(len(reference))))
        member = np.array([[name == case for name in names] for case in dict.fromkeys(names)], dtype=float)
        total = member @ weights
        means = np.einsum("gs,nsc->ngc", member, ratios * weights) / np.where(total > 0.0, total, 1.0)
        return np.asarray(np.where(np.isnan(means) | (total > 0.0), means, -np.inf).max(axis=(1, 2)))
    return np.asarray(np.where(np.isnan(ratios) | (weights > 0.0), ratios, -np.inf).max(axis=(1, 2)))


class ScenarioFitness:
    """An objective for `optimisation.search`: the fitness by `aggregate`, followed by the responses it is made of.

    Args:
        responses: gives the standard deviations.
        reference: those of the design that others are compared with, shape (scenarios, channels).
        scenarios, channels: labels.
        how: see `aggregate`.

    Raises:
        ValueError: as `aggregate`; names the reference that is not positive.
    """

    def __init__(
        self, responses: Responses, reference: Array, scenarios: Sequence[Scenario], channels: Sequence[str], how: How
    ) -> None:
        self.responses, self.reference, self.how = responses, np.asarray(reference, dtype=float), how
        self.scenarios, self.channels = tuple(scenarios), tuple(channels)
        self.weights = np.repeat([[s.weight] for s in scenarios], len(self.channels), axis=1)
        for s, c in np.argwhere(~(np.isfinite(self.reference) & (self.reference > 0.0))):
            raise ValueError(
                f"{self.scenarios[s].label}: the reference's standard deviation of {self.channels[c]} is"
                f" {self.reference[s, c]:g}: leave out that channel (--channels), or compare with another design"
            )
        self.cases = [s.group or s.case for s in self.scenarios]
        aggregate(self.reference[None], self.reference, self.weights, how, self.cases)

    @property
    def first_failure(self) -> str | None:
        """Message of the first design that could not be evaluated, or None."""
        return self.responses.first_failure

    @first_failure.setter
    def first_failure(self, message: str | None) -> None:
        self.responses.first_failure = message

    def __call__(self, candidates: Array) -> Array:
        """Fitness and responses, shape (n, 1 + scenarios * channels); nan where a design failed in any scenario."""
        found = np.asarray(self.responses(candidates), dtype=float).reshape(len(candidates), -1)
        found = np.where(np.isfinite(found).all(axis=1, keepdims=True), found, np.nan)
        return np.column_stack([self.fitness(found), found])

    def fitness(self, flat: Array) -> Array:
        """Fitness, shape (n,), from responses of shape (n, scenarios * channels)."""
        return aggregate(flat.reshape(-1, *self.reference.shape), self.reference, self.weights, self.how, self.cases)
