"""Search for objectives that take minutes: a Gaussian process of each response, expected improvement of the fitness.

Jones, Schonlau and Welch, J. Global Optim. 13 (1998) 455-492. A standard deviation is a smoother function of the design
than the worst of several, so that each response (scenario and channel) has a process of its own and the fitness'
improvement is averaged over their joint posterior by Monte Carlo, as in Astudillo and Frazier, ICML 2019 (composite
functions). Batches by the kriging believer (Ginsbourger, Le Riche and Carraro 2010).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize
from scipy.spatial.distance import cdist
from scipy.stats import norm, qmc
from threadpoolctl import threadpool_limits

Array = npt.NDArray[np.float64]

# hyperparameters' bounds: variance of the standardised values and of their noise, length scales of the range
VARIANCE, NOISE, LENGTH = (1e-2, 1e3), (1e-8, 0.1), (0.05, 20.0)
JITTER = 1e-8  # of the process' variance, which keeps matrices regular
SAMPLES = 128  # of the joint posterior
NEGLIGIBLE = 1e-4  # expected improvement, of the spread of the designs' fitness
WIDE = 5.0  # ratio of the bounds from which a variable is scaled by its square root, as frequencies go with stiffness


@dataclass(frozen=True)
class Effort:
    """Points among which the next design is sought: so many in the whole range, so many around the best designs; then,
    for each width (of the range), the best `kept` of them and `children` around each."""

    pool: int
    around: int
    kept: int
    children: int
    widths: tuple[float, ...]


EFFORT = Effort(1024, 1024, 8, 32, (0.05, 0.02, 0.005, 0.001))
GUIDED = Effort(128, 32, 4, 8, (0.05, 0.01))  # a cheap model is cheap beside a simulation only


class Process:
    """A Gaussian process: Matern 5/2, a length scale for each variable, noise for what is not smooth (end stops).

    Hyperparameters maximise the likelihood (Rasmussen and Williams 2006, eqs. 4.17, 5.8, 5.9), from two starts.

    Args:
        z: variables scaled to 0..1, shape (n, variables); y: values, shape (n,).
    """

    def __init__(self, z: Array, y: Array) -> None:
        self._mean, self._scale = float(y.mean()), float(y.std()) or 1.0
        self._u, self._z = (y - self._mean) / self._scale, z
        squares = (z[:, None, :] - z[None, :, :]) ** 2
        bounds = [VARIANCE, NOISE, *([LENGTH] * z.shape[1])]
        fits = [
            minimize(
                _likelihood, np.log([1.0, 1e-4, *([length] * z.shape[1])]), args=(squares, self._u), jac=True,
                method="L-BFGS-B", bounds=np.log(bounds),
            )
            for length in (0.5, 2.0)
        ]  # fmt: skip
        best = np.exp(min(fits, key=lambda fit: float(fit.fun)).x)
        self._variance, noise, self._lengths = float(best[0]), float(best[1]), best[2:]
        own = self._signal(z, z)
        self._factor = cho_factor(own + noise * np.eye(len(z)), lower=True)
        self._weights = cho_solve(self._factor, self._u)
        self._see(z)

    def _signal(self, a: Array, b: Array) -> Array:
        return self._variance * _matern(cdist(a / self._lengths, b / self._lengths))

    def _see(self, z: Array) -> None:
        self._seen = z
        own = self._signal(z, z) + JITTER * np.eye(len(z))
        self._exact = np.linalg.inv(np.linalg.cholesky(own)).T

    def predict(self, z: Array) -> tuple[Array, Array]:
        """Mean, and standard deviation of the smooth part as if that were known where it was seen, shapes (m,).

        So a design is not proposed again for the sake of its noise (re-interpolation: Forrester, Keane and Bressloff,
        AIAA J. 44 (2006) 2331-2339).
        """
        across = self._signal(z, self._seen)
        gained = np.sum((across @ self._exact) ** 2, axis=1)
        deviation = np.sqrt(np.maximum(self._variance - gained, 0.0))
        mean = across[:, : len(self._z)] @ self._weights
        return self._mean + self._scale * mean, self._scale * deviation

    @property
    def scale(self) -> float:
        """Standard deviation far from all that was seen."""
        return self._scale * float(np.sqrt(self._variance))

    def believe(self, z: Array) -> None:
        """Take the mean at a point, shape (variables,), for seen; it leaves the mean elsewhere as it was."""
        self._see(np.vstack([self._seen, z]))

    def left_out(self) -> Array:
        """Each value as predicted from all others, with these hyperparameters, shape (n,) (Rasmussen and Williams 2006,
        eq. 5.12)."""
        inverse = np.diag(cho_solve(self._factor, np.eye(len(self._z))))
        return np.asarray(self._mean + self._scale * (self._u - self._weights / inverse))


def _matern(r: Array) -> Array:
    """Matern covariance of smoothness 5/2 at scaled distances (Rasmussen and Williams 2006, eq. 4.17)."""
    root = np.sqrt(5.0) * r
    return np.asarray((1.0 + root + root**2 / 3.0) * np.exp(-root))


def _likelihood(logs: Array, squares: Array, u: Array) -> tuple[float, Array]:
    """Negative logarithm of the marginal likelihood and its gradient.

    Args:
        logs: logarithms of variance, noise and length scales. squares: of the differences, shape (n, n, variables).
    """
    variance, noise, lengths = np.exp(logs[0]), np.exp(logs[1]), np.exp(logs[2:])
    scaled = squares / lengths**2
    root = np.sqrt(5.0 * scaled.sum(axis=2))
    decay = variance * np.exp(-root)
    signal = decay * (1.0 + root + root**2 / 3.0)
    try:
        factor = np.linalg.cholesky(signal + noise * np.eye(len(u)))
    except np.linalg.LinAlgError:
        return 1e10, np.zeros_like(logs)
    inverse_root = np.linalg.inv(factor)
    inverse = inverse_root.T @ inverse_root
    weights = inverse @ u
    value = 0.5 * u @ weights + np.log(np.diag(factor)).sum()
    slope = inverse - np.outer(weights, weights)
    by_length = np.einsum("ij,ijd->d", slope * (5.0 / 3.0) * decay * (1.0 + root), scaled)
    return float(value), 0.5 * np.array([np.sum(slope * signal), noise * np.trace(slope), *by_length])


@dataclass(frozen=True)
class Accuracy:
    """How well the processes predict what they have not seen, by leaving out each design in turn; of the better half of
    the designs, as elsewhere nothing hangs on it.

    Attributes:
        responses: RMS of the relative error of each response, shape (responses,).
        fitness: RMS error of the fitness; spread: standard deviation of the fitness among the same designs.
        designs: their number.
    """

    responses: tuple[float, ...]
    fitness: float
    spread: float
    designs: int


class Surrogate:
    """Efficient global optimisation by ask and tell, see `optimisation.search.Strategy`.

    It is told the fitness and the responses that it is made of, and models the responses: by their logarithm if all are
    positive, and relative to `prior` if given. What it proposes is a function of its seed and of what it was told.

    Args:
        lower, upper: bounds, shape (variables,).
        batch: designs proposed at once, after the first ones.
        seed: of the random numbers.
        initial: designs evaluated first: the starts, and for the rest (at least two) a scrambled Sobol sequence.
        limit: largest number of designs, to which the last batch is cut; None: none.
        starts: designs to begin with, shape (n, variables).
        fitness: responses, shape (n, responses) -> fitness, shape (n,).
        prior: a cheap model of the responses, shape (n, variables) -> (n, responses), which the processes correct; it
            must be positive, as the responses. Where it has no value (nan), or a larger one than any response told, the
            largest told is taken.
    """

    def __init__(
        self, lower: Array, upper: Array, *, batch: int, seed: int, initial: int, limit: int | None = None,
        starts: Array | None = None,
        fitness: Callable[[Array], Array] | None = None, prior: Callable[[Array], Array] | None = None,
    ) -> None:  # fmt: skip
        self.library = f"scipy {scipy.__version__}"
        self._lower, self._upper, self._batch, self._seed = lower, upper, batch, seed
        self._starts = np.empty((0, lower.size)) if starts is None else np.asarray(starts, dtype=float)
        self._initial, self._prior = initial, None if prior is None else Remembered(prior)
        self._effort = EFFORT if prior is None else GUIDED
        self._limit = float("inf") if limit is None else limit
        self._fitness = fitness or (lambda responses: responses[:, 0])
        # a quantity of wide range that cannot be negative
        self._wide = (lower >= 0.0) & (upper > WIDE * lower)
        self._x = np.empty((0, lower.size))
        self._values = np.empty((0, 1))
        self._asked = self._x
        self._count = 0

    def ask(self) -> Array:
        """See `Strategy`."""
        rng = np.random.default_rng([self._seed, self._count])
        if self._count == 0:
            number = int(max(min(self._initial, self._limit) - len(self._starts), 2))
            sobol = qmc.Sobol(self._lower.size, scramble=True, seed=rng).random_base2(int(np.ceil(np.log2(number))))
            return self.recall(np.vstack([self._starts, self._decoded(sobol[:number])]))
        count = int(min(self._batch, self._limit - len(self._x)))
        if count == 0:
            return np.empty((0, self._lower.size))
        if not np.isfinite(self._values[:, 0]).any():
            return self.recall(self._decoded(rng.random((count, self._lower.size))))
        with threadpool_limits(1):  # for matrices as small as these threads only wait for each other
            return self.recall(self._decoded(self._propose(rng, count)))

    def recall(self, x: Array) -> Array:
        """See `Strategy`: past proposals need no computation, as the state is what was told."""
        if x.shape[1:] != self._lower.shape or np.any(x < self._lower) or np.any(x > self._upper):
            raise ValueError("the record's designs are none of this search")
        self._asked = x
        return x

    def tell(self, values: Array) -> None:
        """See `Strategy`."""
        self._x = np.vstack([self._x, self._asked])
        self._values = values if self._count == 0 else np.vstack([self._values, values])
        self._count += 1

    def population(self) -> tuple[Array, Array]:
        """All designs so far, see `Strategy`."""
        return self._x, self._values

    def random_state(self) -> dict[str, Any]:
        """See `Strategy`."""
        return {"seed": self._seed, "asked": self._count}

    def accuracy(self) -> Accuracy | None:
        """Error of predictions by leaving out each design; None if too few could be evaluated."""
        usable, responses = self._told()
        if usable.sum() < self._lower.size + 2:
            return None
        with threadpool_limits(1):
            predicted = _Model(self, self._x[usable], responses[usable]).left_out()
        true = self._values[usable, 0]
        better = true <= np.median(true)
        errors = np.sqrt(np.mean((predicted / responses[usable] - 1.0)[better] ** 2, axis=0))
        rms = float(np.sqrt(np.mean((self._fitness(predicted) - true)[better] ** 2)))
        return Accuracy(tuple(errors.tolist()), rms, float(true[better].std()), int(better.sum()))

    def predict(self, x: Array) -> Array:
        """Responses at designs of shape (n, variables) as the processes' means have them, shape (n, responses)."""
        usable, responses = self._told()
        return _Model(self, self._x[usable], responses[usable]).predict(x)[0]

    def _told(self) -> tuple[npt.NDArray[np.bool_], Array]:
        """Which designs have values, and the responses (the fitness itself, where no responses were told)."""
        responses = self._values[:, 1:] if self._values.shape[1] > 1 else self._values
        return np.asarray(np.isfinite(self._values).all(axis=1)), responses

    def _propose(self, rng: np.random.Generator, count: int) -> Array:
        usable, responses = self._told()
        # a design that failed counts as bad as the worst of each response, so that the search keeps away from it
        filled = np.where(usable[:, None], responses, responses[usable].max(axis=0))
        model = _Model(self, self._x, filled)
        normal = norm.ppf(qmc.Sobol(filled.shape[1], scramble=True, seed=rng).random_base2(int(np.log2(SAMPLES))))
        seen = self._encoded(self._x[usable])

        def improvement(z: Array) -> Array:
            return self._improvement(model, z, least, normal)

        negligible = NEGLIGIBLE * float(self._values[usable, 0].std())
        order = np.argsort(np.where(usable, self._values[:, 0], np.inf), kind="stable")
        best = self._encoded(self._x[order[: max(1, min(4, int(usable.sum())))]])
        effort, chosen = self._effort, list[Array]()
        # with a cheap model always the same points: it need not be asked again
        pool_rng = rng if self._prior is None else np.random.default_rng(self._seed)
        pool = qmc.Sobol(best.shape[1], scramble=True, seed=pool_rng).random(effort.pool)
        for _ in range(count):
            least = float(self._fitness(model.predict(self._decoded(seen))[0]).min())
            n = effort.around
            around = best[rng.integers(len(best), size=n)] + 0.1 * rng.standard_normal((n, best.shape[1]))
            z = np.vstack([pool, np.clip(around, 0.0, 1.0)])
            gain = improvement(z)
            if gain.max() < negligible:  # the processes may be too sure of themselves: look where they know least
                gain, widths = model.ignorance(z), effort.widths[:0]
            else:
                widths = effort.widths
            for width in widths:
                kept = z[np.argsort(-gain, kind="stable")[: effort.kept]]
                near = np.repeat(kept, effort.children, axis=0)
                near = near + width * rng.standard_normal(near.shape)
                z = np.vstack([kept, np.clip(near, 0.0, 1.0)])
                gain = improvement(z)
            chosen.append(z[int(np.argmax(gain))])
            model.believe(chosen[-1])
            seen = np.vstack([seen, chosen[-1]])
        return np.array(chosen).reshape(-1, best.shape[1])

    def _improvement(self, model: _Model, z: Array, least: float, normal: Array) -> Array:
        """Expected improvement on the least fitness, shape (n,), at scaled designs of shape (n, variables)."""
        total = np.zeros(len(z))
        for sample in model.sample(z, normal):
            fitness = self._fitness(sample)
            total += np.where(fitness < least, least - fitness, 0.0)
        return total / len(normal)

    def _encoded(self, x: Array) -> Array:
        root = np.sqrt(np.where(self._wide, x, 0.0))
        low, high = (np.sqrt(np.where(self._wide, b, 0.0)) for b in (self._lower, self._upper))
        straight = (x - self._lower) / (self._upper - self._lower)
        return np.where(self._wide, (root - low) / np.where(self._wide, high - low, 1.0), straight)

    def _decoded(self, z: Array) -> Array:
        low, high = (np.sqrt(np.where(self._wide, b, 0.0)) for b in (self._lower, self._upper))
        x = np.where(
            self._wide, (low + (high - low) * z) ** 2, self._lower + (self._upper - self._lower) * z
        )  # fmt: skip
        return np.clip(x, self._lower, self._upper)


class Remembered:
    """A function of designs, shape (n, variables) -> (n, values), that is asked once for each design."""

    def __init__(self, function: Callable[[Array], Array]) -> None:
        self._function = function
        self._known: dict[bytes, Array] = {}

    def __call__(self, x: Array) -> Array:
        keys = [row.tobytes() for row in np.ascontiguousarray(x)]
        new = [i for i, key in enumerate(keys) if key not in self._known]
        if new:
            self._known |= dict(zip((keys[i] for i in new), self._function(x[new]), strict=True))
        return np.array([self._known[key] for key in keys])


class _Model:
    """Processes of all responses over designs of shape (n, variables), in the strategy's scaling."""

    def __init__(self, search: Surrogate, x: Array, responses: Array) -> None:
        self._search = search
        self._x = x
        self._positive = bool(np.all(responses > 0.0)) and bool(np.isfinite(np.log(responses)).all())
        y = np.log(responses) if self._positive else responses
        self._largest = y.max(axis=0)
        y = y - self._offset(x)
        z = search._encoded(x)
        self._processes = [Process(z, column) for column in y.T]

    def believe(self, z: Array) -> None:
        for process in self._processes:
            process.believe(z)

    def predict(self, x: Array) -> tuple[Array, Array]:
        """Median of each response and standard deviation of the process, shapes (n, responses)."""
        mean, deviation = self._posterior(self._search._encoded(x))
        return self._response(mean + self._offset(x)), deviation

    def left_out(self) -> Array:
        y = np.column_stack([process.left_out() for process in self._processes])
        return self._response(y + self._offset(self._x))

    def ignorance(self, z: Array) -> Array:
        """Standard deviation at scaled designs, mean over the responses, each by its process' own, shape (n,)."""
        return np.asarray(np.mean([process.predict(z)[1] / process.scale for process in self._processes], axis=0))

    def sample(self, z: Array, normal: Array) -> Any:
        """Responses at scaled designs, shape (n, responses), for each row of standard normal numbers."""
        mean, deviation = self._posterior(z)
        mean = mean + self._offset(self._search._decoded(z))
        for row in normal:
            yield self._response(mean + deviation * row)

    def _posterior(self, z: Array) -> tuple[Array, Array]:
        means, deviations = zip(*(process.predict(z) for process in self._processes), strict=True)
        return np.column_stack(means), np.column_stack(deviations)

    def _response(self, y: Array) -> Array:
        return np.exp(y) if self._positive else y

    def _offset(self, x: Array) -> Array | float:
        """What the processes correct, a function of each design alone: the logarithm of the cheap model's responses."""
        prior = self._search._prior
        if prior is None or not self._positive:
            return 0.0
        y = np.log(prior(x))
        return np.asarray(np.fmin(y, self._largest))
