"""Radiation memory: retardation functions, and a state-space model fitted to them.

    F_rad(t) = -A_inf a(t) - integral_0^t K(t - s) v(s) ds                              Cummins (1962)
    K(t) = 2/pi integral_0^inf B(w) cos(w t) dw,  A(w) - A_inf = -1/w integral_0^inf K(t) sin(w t) dt    Ogilvie (1964)

The convolution is replaced by x' = a x + b v, F = -c x (Taghipour, Perez and Moan, Ocean Engineering 35, 2008). Poles
come from vector fitting (Gustavsen and Semlyen, IEEE Trans. Power Delivery 14, 1999) of
K(i w) = B(w) + i w (A(w) - A_inf), with A(w) - A_inf computed from B so that the target is causal. The residues solve a
linear least-squares problem under what the physics demands:

* K(i 0) = 0: no damping of a steady drift (surge moves at 0.05 rad/s, where B vanishes);
* Re K(i w) positive semidefinite at all frequencies: radiation never feeds energy into the barge.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations_with_replacement

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline
from scipy.linalg import block_diag, null_space
from scipy.optimize import nnls
from scipy.sparse.csgraph import connected_components

from fmus_src.hydro.database import HydroDatabase, couplings

Array = npt.NDArray[np.float64]
Complex = npt.NDArray[np.complex128]

POLES = (6, 8, 10, 12)  # of each group of coupled degrees of freedom; the first number that fits well is taken
GOOD, POOR = 0.05, 0.10  # relative L2 error of K(t): no more poles are tried; the fit is warned of
# Beyond the database the damping is continued as (w_last / w)^n: a vertical wall of depth much above the wave length
# radiates waves of amplitude 2 v / w, hence B11 ~ w^-3, and the moment's arm brings 1/k = g / w^2 for each index of
# roll and pitch. Heave radiates from the bottom, exp(-2 k d) for draft d, of which w^-8 leaves as little.
TAIL_EXPONENT = np.add.outer(*2 * (np.array([1.5, 1.5, 4.0, 3.5, 3.5, 1.5]),))
# Roll and pitch resonate where they radiate little: there a small error of K is a large one of their damping.
EMPHASIS, RESONANCE = 4.0, 0.6  # weight of the fit below a frequency, rad/s
ROUNDS = 60  # of cutting planes
SPACING, HIGHEST = 0.005, 40.0  # rad/s, quadrature of the cosine transform


@dataclass(frozen=True)
class RadiationModel:
    """State-space model x' = a x + b v of the radiation memory; its force on the barge is -c x.

    Attributes:
        a: (n, n), 1/s, block diagonal with 1x1 and 2x2 blocks. b: (n, 6). c: (6, n).
            v is the PRP's velocity (m/s, rad/s), c x in N and N m.
        retardation_error: relative L2 error of K(t), 0 to 60 s, of each pair by its name ("11", "15", ...); couplings
            are relative to the geometric mean of their diagonals.
        damping_error, added_mass_error: the same over the database's frequencies for B(w) and w (A(w) - A_inf).
    """

    a: Array
    b: Array
    c: Array
    retardation_error: dict[str, float]
    damping_error: dict[str, float]
    added_mass_error: dict[str, float]

    @property
    def statement(self) -> str:
        """The errors of K(t) in one line."""
        errors = ", ".join(f"{pair} {error:.1%}" for pair, error in self.retardation_error.items())
        return f"radiation memory of {len(self.a)} states, relative L2 error of K(t) by pair: {errors or 'none'}"

    def response(self, omega: Array) -> Complex:
        """K(i w), N s/m and so on, shape (len(omega), 6, 6)."""
        identity = np.eye(len(self.a))
        return np.array([self.c @ np.linalg.solve(1j * w * identity - self.a, self.b) for w in omega])

    def retardation(self, time: Array) -> Array:
        """K(t), N/m and so on, shape (len(time), 6, 6)."""
        poles, vectors = np.linalg.eig(self.a)
        left = np.linalg.solve(vectors, self.b.astype(complex))
        modes = np.exp(np.multiply.outer(time, poles))
        return np.einsum("in,tn,nj->tij", self.c @ vectors, modes, left).real


def continued_damping(database: HydroDatabase) -> tuple[Array, Array]:
    """Damping on a fine grid from 0, with its high-frequency tail: frequencies (n,) in rad/s and B (n, 6, 6)."""
    last = float(database.omega[-1])
    grid = np.arange(0.0, HIGHEST + SPACING / 2, SPACING)
    inside = grid <= last
    # B vanishes at zero frequency with zero slope (waves of infinite length carry no energy away).
    spline = CubicSpline(
        np.r_[0.0, database.omega], np.concatenate([np.zeros((1, 6, 6)), database.damping]),
        bc_type=((1, np.zeros((6, 6))), (2, np.zeros((6, 6)))),
    )  # fmt: skip
    damping = np.zeros((len(grid), 6, 6))
    damping[inside] = spline(grid[inside])
    damping[~inside] = database.damping[-1] * (last / grid[~inside, None, None]) ** TAIL_EXPONENT
    return grid, damping


def retardation(database: HydroDatabase, time: Array) -> Array:
    """Retardation functions K(t) from the damping with its tail; time in s, result (len(time), 6, 6)."""
    grid, damping = continued_damping(database)
    weight = np.full(len(grid), 2.0 / np.pi * SPACING)
    weight[[0, -1]] /= 2.0
    flat = (weight[:, None] * damping.reshape(len(grid), 36)).astype(float)
    return np.asarray((np.cos(np.multiply.outer(time, grid)) @ flat).reshape(len(time), 6, 6))


def added_mass_difference(database: HydroDatabase, omega: Array) -> Array:
    """A(w) - A_inf from the damping alone (Kramers-Kronig), kg and so on, shape (len(omega), 6, 6).

    A(w) - A_inf = 2/pi integral (B(s) - B(w)) / (s^2 - w^2) ds; the principal value of the subtracted part is zero.
    """
    grid, damping = continued_damping(database)
    spline = CubicSpline(grid, damping)
    middle = (grid[:-1] + grid[1:]) / 2.0
    result = np.zeros((len(omega), 6, 6))
    at_middle = spline(middle)
    for n, w in enumerate(omega):
        here = spline(w)
        distance = middle - w
        near = np.abs(distance) < 1e-9
        kernel = np.where(near, 0.0, 1.0 / (np.where(near, 1.0, distance) * (middle + w)))
        total = np.einsum("s,sij->ij", kernel, at_middle - here) * SPACING
        total += near.sum() * spline(w, 1) / (2.0 * w) * SPACING
        total -= here / (2.0 * w) * np.log((HIGHEST + w) / (HIGHEST - w))
        result[n] = 2.0 / np.pi * total
    return result


@lru_cache(maxsize=8)
def radiation_model(database: HydroDatabase) -> RadiationModel:
    """The fitted model of a database; see `fit`. A poor fit (above 10 % in K(t) of a pair) is warned of."""
    model = fit(database)
    poor = [pair for pair, error in model.retardation_error.items() if error > POOR]
    if poor:
        warnings.warn(
            f"hydro: {database.name}: poor fit of {', '.join(poor)}; {model.statement}; resonances need finer "
            "frequencies, and damping that has not died out at the highest more of them",
            stacklevel=2,
        )
    return model


def groups(database: HydroDatabase) -> list[tuple[int, ...]]:
    """Degrees of freedom that radiation couples with each other; those that radiate nothing are left out."""
    count, labels = connected_components(couplings(database), directed=False)
    reactance = np.abs(database.omega[:, None, None] * database.added_mass).max(axis=0).diagonal()
    radiates = database.damping.max(axis=0).diagonal() > 1e-6 * np.maximum(reactance, 1e-30)
    members = [tuple(int(i) for i in np.flatnonzero((labels == n) & radiates)) for n in range(count)]
    return [dofs for dofs in members if dofs]


def fit(database: HydroDatabase) -> RadiationModel:
    """Fit the radiation model of a database; takes some seconds."""
    # The tail beyond the database holds a third of K(0) in surge, hence it takes part in the fit.
    last = float(database.omega[-1])
    omega = np.r_[database.omega, np.arange(last + 0.1, 4.0 * last, 0.1)]
    grid, damping = continued_damping(database)
    target = CubicSpline(grid, damping)(omega) + 1j * omega[:, None, None] * added_mass_difference(database, omega)
    members = groups(database)
    blocks = [_fit_group(database, dofs, omega, target) for dofs in members]
    if not blocks:
        raise ValueError(f"hydro: {database.name} has no radiation damping at all")
    a = block_diag(*[block[0] for block in blocks])
    b = np.vstack([block[1] for block in blocks])
    c = np.hstack([block[2] for block in blocks])
    return _with_errors(RadiationModel(a, b, c, {}, {}, {}), database, members, target[: len(database.omega)])


def _fit_group(
    database: HydroDatabase, dofs: tuple[int, ...], omega: Array, target: Complex
) -> tuple[Array, Array, Array]:
    """Realisation a, b (n, 6), c (6, n) of one group, with as many poles as it takes."""
    scale = np.sqrt(np.array([database.damping[:, i, i].max() for i in dofs]))
    scaled = target[np.ix_(range(len(omega)), dofs, dofs)] / np.multiply.outer(scale, scale)
    weight = np.sqrt(np.gradient(omega))
    if {3, 4} & set(dofs):
        weight *= 1.0 + EMPHASIS * np.exp(-((omega / RESONANCE) ** 4))
    selection = np.zeros((len(dofs), 6))
    selection[range(len(dofs)), dofs] = scale
    best, least = None, np.inf
    for count in POLES:
        poles = fit_poles(omega, scaled, weight, count)
        a, b, c = realisation(poles, fit_residues(omega, scaled, weight, poles))
        model = RadiationModel(a, b @ selection, selection.T @ c, {}, {}, {})
        errors = _with_errors(model, database, [dofs], target[: len(database.omega)]).retardation_error
        if max(errors.values()) < least:
            best, least = model, max(errors.values())
        if least < GOOD:
            break
    assert best is not None
    return best.a, best.b, best.c


def fit_poles(omega: Array, target: Complex, weight: Array, count: int, iterations: int = 40) -> Complex:
    """Stable poles common to all elements of `target` (n, q, q), by vector fitting; conjugate pairs, shape (count,)."""
    imag = np.geomspace(max(omega[0], 0.1), omega[-1], count // 2)
    poles = np.concatenate([[-0.2 * w + 1j * w, -0.2 * w - 1j * w] for w in imag])
    rows, columns = np.triu_indices(target.shape[1])
    elements = [target[:, i, j] for i, j in zip(rows, columns, strict=True)]
    for _ in range(iterations):
        basis = _real_basis(omega, poles)
        blocks, right = [], []
        for element in elements:
            system = _stack(weight[:, None] * np.hstack([basis, -basis * element[:, None]]))
            q, r = np.linalg.qr(system)
            blocks.append(r[len(poles) :, len(poles) :])
            right.append((q.T @ _stack((weight * element)[:, None]))[len(poles) :, 0])
        weights = np.linalg.lstsq(np.vstack(blocks), np.concatenate(right), rcond=None)[0]
        a, b = _real_poles(poles)
        poles = np.linalg.eigvals(a - np.outer(b, weights))
        poles = -np.abs(poles.real) + 1j * poles.imag
        poles = _conjugate_pairs(poles)
    return poles


def fit_residues(omega: Array, target: Complex, weight: Array, poles: Complex) -> Array:
    """Coefficients (count, q, q) of the real basis, with K(0) = 0 and Re K(i w) positive semidefinite."""
    q = target.shape[1]
    rows, columns = np.triu_indices(q)
    n, elements = len(poles), len(rows)
    # Off-diagonal elements count twice in the matrix norm.
    share = np.where(rows == columns, 1.0, np.sqrt(2.0))
    matrix = np.kron(np.diag(share), _stack(weight[:, None] * _real_basis(omega, poles)))
    right = np.concatenate(
        [s * _stack((weight * target[:, i, j])[:, None])[:, 0] for i, j, s in zip(rows, columns, share, strict=True)]
    )
    steady = _real_basis(np.zeros(1), poles).real
    free = null_space(np.kron(np.eye(elements), steady))
    checked = np.r_[
        np.geomspace(1e-4, 4e-3, 10), np.linspace(0.005, 6.0, 1200), np.geomspace(6.0, 100 * omega[-1], 200)
    ]
    real = _real_basis(checked, poles).real * np.maximum(1.0, checked / omega[-1])[:, None] ** 2
    # Asking for a little more than zero makes the cutting planes converge; near w = 0 it must vanish with K.
    margin = 2e-5 * np.minimum(1.0, checked**2)
    cuts: list[Array] = []
    bounds: list[float] = []
    q_factor, r_factor = np.linalg.qr(matrix @ free)
    unconstrained = np.linalg.solve(r_factor, q_factor.T @ right)
    solution = free @ unconstrained
    for _ in range(ROUNDS):
        smallest, vectors = np.linalg.eigh(_symmetric(real @ solution.reshape(elements, n).T, q))
        low = smallest[:, 0]
        worst = [k for k in range(len(low)) if low[k] < 0.0 and low[k] == low[max(k - 5, 0) : k + 6].min()]
        if not worst:
            break
        for k in worst:
            v = vectors[k, :, 0]
            factor = np.array([v[i] * v[j] * (1.0 if i == j else 2.0) for i, j in zip(rows, columns, strict=True)])
            cuts.append(np.kron(factor, real[k]))
            bounds.append(margin[k])
        constraint = np.array(cuts)
        solution = free @ _nearest_feasible(unconstrained, r_factor, constraint @ free, np.array(bounds))
    # What the cutting planes leave below zero (little) is lifted by s / ((s - p)(s - p*)) of each pair of poles, whose
    # real part is positive at every frequency but zero.
    lift = _band_passes(poles)
    low = np.linalg.eigvalsh(_symmetric(real @ solution.reshape(elements, n).T, q))[:, 0]
    positive = real @ lift
    amount = 1.001 * np.max(-low / np.where(positive > 0.0, positive, np.inf), initial=0.0)
    return _symmetric(solution.reshape(elements, n).T, q) + amount * lift[:, None, None] * np.eye(q)


def _symmetric(values: Array, q: int) -> Array:
    """Symmetric matrices (n, q, q) from their upper triangles (n, q (q + 1) / 2)."""
    rows, columns = np.triu_indices(q)
    result = np.zeros((len(values), q, q))
    result[:, rows, columns] = result[:, columns, rows] = values
    return result


def _band_passes(poles: Complex) -> Array:
    """Coefficients (n,) in the real basis of the sum of s / ((s - p)(s - p*)) over the pairs of poles."""
    result: list[float] = []
    for p in poles:
        if p.imag > 0.0:
            result += [0.5, -0.5 * p.real / p.imag]
        elif p.imag == 0.0:
            result.append(0.0)
    return np.array(result)


def realisation(poles: Complex, residues: Array) -> tuple[Array, Array, Array]:
    """Real matrices a (n q, n q), b (n q, q), c (q, n q) of sum over the real basis of residues (n, q, q)."""
    q = residues.shape[1]
    a, b = _real_poles(poles)
    identity = np.eye(q)
    return np.asarray(np.kron(a, identity)), np.asarray(np.kron(b[:, None], identity)), np.hstack(list(residues))


def _real_poles(poles: Complex) -> tuple[Array, Array]:
    """Real a (n, n) and b (n,) with blocks [re, im; -im, re] and [2, 0] for a conjugate pair, [p] and [1] else."""
    blocks, b = [], []
    for p in poles:
        if p.imag > 0.0:
            blocks.append(np.array([[p.real, p.imag], [-p.imag, p.real]]))
            b += [2.0, 0.0]
        elif p.imag == 0.0:
            blocks.append(np.array([[p.real]]))
            b += [1.0]
    return block_diag(*blocks), np.array(b)


def _real_basis(omega: Array, poles: Complex) -> Complex:
    """Columns (i w I - a)^-1 b of `_real_poles`: 1/(s-p) + 1/(s-p*) and i/(s-p) - i/(s-p*); shape (len(omega), n)."""
    s = 1j * omega
    columns = []
    for p in poles:
        if p.imag > 0.0:
            columns += [1 / (s - p) + 1 / (s - p.conj()), 1j / (s - p) - 1j / (s - p.conj())]
        elif p.imag == 0.0:
            columns.append(1 / (s - p))
    return np.array(columns).T


def _conjugate_pairs(poles: Complex) -> Complex:
    """Poles in ascending frequency, each with positive imaginary part followed by its conjugate."""
    result: list[complex] = []
    for p in sorted(poles, key=lambda p: (abs(p), p.imag)):
        if abs(p.imag) < 1e-9 * abs(p):
            result.append(complex(p.real, 0.0))
        elif p.imag > 0.0:
            result += [complex(p), complex(p).conjugate()]
    return np.array(result)


def _stack(values: Array | Complex) -> Array:
    return np.vstack([values.real, values.imag])


def _nearest_feasible(free: Array, r: Array, constraint: Array, bound: Array) -> Array:
    """min |r (x - free)| subject to constraint x >= bound (Lawson and Hanson 1974, chapter 23)."""
    g = np.linalg.solve(r.T, constraint.T).T
    h = bound - constraint @ free
    size = np.abs(g).max()
    u, _ = nnls(np.vstack([g.T, h[None]]) / size, np.r_[np.zeros(g.shape[1]), 1.0], maxiter=100 * len(h))
    residual = np.vstack([g.T, h[None]]) / size @ u - np.r_[np.zeros(g.shape[1]), 1.0]
    return np.asarray(free + np.linalg.solve(r, -residual[:-1] / residual[-1]))


def _with_errors(
    model: RadiationModel, database: HydroDatabase, members: Sequence[tuple[int, ...]], target: Complex
) -> RadiationModel:
    time = np.arange(0.0, 60.0, 0.1)
    response = model.response(database.omega)
    pairs: Sequence[tuple[Array, Array]] = (
        (model.retardation(time), retardation(database, time)),
        (response.real, target.real),
        (response.imag, target.imag),
    )
    errors: tuple[dict[str, float], ...] = ({}, {}, {})
    for error, (ours, theirs) in zip(errors, pairs, strict=True):
        size = np.linalg.norm(theirs, axis=0)
        scale = np.sqrt(np.multiply.outer(size.diagonal(), size.diagonal()))
        difference = np.linalg.norm(ours - theirs, axis=0)
        for dofs in members:
            for i, j in combinations_with_replacement(dofs, 2):
                error[f"{i + 1}{j + 1}"] = float(difference[i, j] / scale[i, j])
    return RadiationModel(model.a, model.b, model.c, *errors)
