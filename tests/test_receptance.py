"""Response to springs and dashpots from runs with held and moved masses: against the system solved directly."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest
from scipy.linalg import solve_continuous_lyapunov
from scipy.optimize import minimize
from scipy.signal import lsim

from optimisation.baselines import Primary, stiffness_and_damping, warburton
from optimisation.receptance import Damper, LinearModel, estimate, fit_mode
from optimisation.spectral import SpectralResponse

Array = npt.NDArray[Any]
STEP, END = 0.1, 630.0
TIME = STEP * np.arange(round(END / STEP) + 1)
M = np.array([[9e5, 5e4], [5e4, 7e5]])  # kg: of two masses, the dampers' held masses not included
C = np.array([[2.2e4, -4e3], [-4e3, 1.5e4]])  # N s/m: damping ratios of 0.02 and 0.01
K = np.array([[4e5, -1e5], [-1e5, 8e5]])  # N/m: 0.09 and 0.18 Hz
MASS = np.array([4e4, 3e4])
DAMPERS = tuple(Damper(f"d{i}", MASS[i], f"s{i}", f"a{i}") for i in range(2))
VARIABLES = ("d0.k", "d0.c", "d1.k", "d1.c")


def _noise(seed: int, low: float, high: float) -> Array:
    generator = np.random.default_rng(seed)
    frequency = np.fft.rfftfreq(len(TIME), STEP)
    lines = np.exp(2j * np.pi * generator.random(len(frequency))) * ((frequency > low) & (frequency < high))
    record = np.fft.irfft(lines, len(TIME))
    return np.asarray(record / record.std())


def _first_order(mass: Array, damping: Array, stiffness: Array) -> Array:
    inverse = np.linalg.inv(mass)
    return np.block([[np.zeros_like(mass), np.eye(len(mass))], [-inverse @ stiffness, -inverse @ damping]])


def _solve(mass: Array, damping: Array, stiffness: Array, force: Array) -> tuple[Array, Array]:
    """Displacements and accelerations from rest, force (n, dof) linear between the instants."""
    n = len(mass)
    a = _first_order(mass, damping, stiffness)
    b = np.vstack([np.zeros((n, n)), np.linalg.inv(mass)])
    c = np.vstack([np.eye(n, 2 * n), a[n:]])
    d = np.vstack([np.zeros((n, n)), b[n:]])
    _, output, _ = lsim((a, b, c, d), force, TIME)
    return output[:, :n], output[:, n:]


def _wind() -> Array:
    return 5e4 * np.stack([_noise(1, 0.02, 0.4), _noise(2, 0.02, 0.4)], axis=1)


def _record(moved: int | None) -> pd.DataFrame:
    """The structure with held masses, one of them moved: it feels -m s''."""
    motion = np.zeros((len(TIME), 2))
    force = _wind()
    if moved is not None:
        omega = 2 * np.pi * np.arange(12, 420) / 600.0
        angle = omega * TIME[:, None] + 2 * np.pi * np.random.default_rng(3 + moved).random(len(omega))
        cosine, sine = np.cos(angle) / omega, np.sin(angle) / omega
        q, rate, acceleration = cosine.sum(axis=1), -sine @ omega, -cosine @ omega**2
        late = TIME / 5.0  # it rises from rest, as the shaker's does
        fade = np.exp(-(late**2))
        slope, curvature = 2 * late * fade / 5.0, (2 - 4 * late**2) * fade / 25.0
        motion[:, moved] = 0.01 * (1 - fade) * q
        force[:, moved] -= MASS[moved] * 0.01 * ((1 - fade) * acceleration + 2 * slope * rate + curvature * q)
    x, a = _solve(M + np.diag(MASS), C, K, force)
    columns = {"x0": x[:, 0], "x1": x[:, 1], "a0": a[:, 0], "a1": a[:, 1], "s0": motion[:, 0], "s1": motion[:, 1]}
    return pd.DataFrame(columns, index=TIME)


@pytest.fixture(scope="module")
def model() -> LinearModel:
    held, *shaken = (_record(moved) for moved in (None, 0, 1))
    return estimate(held, shaken, ["x0", "x1"], DAMPERS, label="two masses", highest=0.69)


def _direct(k: Array, c: Array) -> Array:
    """Histories of x0, x1, s0, s1 of the structure with dampers, s'' = -(k s + c s') / m - x''."""
    coupling = np.diag(MASS)
    mass = np.block([[M + coupling, coupling], [coupling, coupling]])
    blank = np.zeros((2, 2))
    damping, stiffness = (np.block([[p, blank], [blank, np.diag(q)]]) for p, q in ((C, c), (K, k)))
    return _solve(mass, damping, stiffness, np.concatenate([_wind(), np.zeros((len(TIME), 2))], axis=1))[0]


@pytest.mark.parametrize("design", [(1.2e4, 4e3, 3.5e4, 6e3), (8e3, 9e2, 9e4, 2e3), (3e4, 2e4, 1e4, 2e4)])
def test_deviations_are_those_of_the_coupled_system(model: LinearModel, design: tuple[float, ...]) -> None:
    response = SpectralResponse([model], VARIABLES, {})
    k, c = np.array(design[0::2]), np.array(design[1::2])
    exact = _direct(k, c)[TIME >= 30.0].std(axis=0)
    found = np.concatenate([response([design])[0, 0], response.strokes([design])[0, 0]])
    assert response.histories(design)[1].std(axis=0) == pytest.approx(found, rel=1e-3)  # which has what is out of band
    # the fit over +-6 mHz holds resonances of 1 % damping to about a per cent
    assert found == pytest.approx(exact, rel=0.02)


def test_a_conservative_structure_is_reciprocal(model: LinearModel) -> None:
    """m_i G_ij = m_j G_ji (Maxwell, Betti); damping C symmetric too, so at all frequencies."""
    gain = MASS[:, None] * model.gain[:, 2:]
    middle = (model.frequencies > 0.05) & (model.frequencies < 0.5)
    error = np.abs(gain[middle, 0, 1] - gain[middle, 1, 0])
    # the two come from different records; each has its own error of the fit
    assert np.sqrt(np.mean(error**2)) < 0.05 * np.sqrt(np.mean(np.abs(gain[middle, 0, 1]) ** 2))


def _single(mass_ratio: float, count: int = 20_000) -> LinearModel:
    """Undamped mass with its damper's mass held, white force: base and gain in closed form, the mass 1 kg, 1 rad/s."""
    m, step = mass_ratio, 0.25
    p = 1e-9 + 2j * np.pi * np.arange(count // 2) / (count * step)
    dynamic = (1.0 + m) * p**2 + 1.0
    base = np.stack([1.0 / dynamic, p**2 / dynamic], axis=1)
    gain = np.stack([-m * p**2 / dynamic, -m * p**4 / dynamic], axis=1)[:, :, None]
    damper = Damper("d", m, "s", "a")
    return LinearModel("sdof", ("x",), ("m",), (damper,), p, base, gain, np.zeros(1), step, count, 0.0, count * step)


def _lyapunov(m: float, k: float, c: float) -> float:
    """Variance of the mass in white noise of unit intensity: an H2 norm."""
    a = _first_order(np.array([[1.0 + m, m], [m, m]]), np.diag([0.0, c]), np.diag([1.0, k]))
    b = np.array([[0.0], [0.0], *np.linalg.inv([[1.0 + m, m], [m, m]])[:, :1]])
    return float(solve_continuous_lyapunov(a, -b @ b.T)[0, 0])


@pytest.mark.parametrize("mass_ratio", [0.02, 0.1])
def test_the_least_deviation_in_white_noise_is_warburton_s(mass_ratio: float) -> None:
    response = SpectralResponse([_single(mass_ratio)], ["d.k", "d.c"], {})
    primary = Primary(mass_ratio, 1.0, 0.0, mass_ratio)
    k, c = stiffness_and_damping(warburton(mass_ratio), primary)
    found = minimize(lambda u: float(response([np.exp(u)])[0, 0, 0]), np.log([0.9 * k, 1.3 * c]), method="Nelder-Mead",
                     options={"xatol": 1e-6, "fatol": 1e-14})  # fmt: skip
    # 5000 s, over which all has died out, in steps that leave out frequencies above 2 Hz: 1e-5 of the variance
    assert np.exp(found.x) == pytest.approx([k, c], rel=1e-3)
    # the norm: variance per unit of force impulse, sum x_j^2 dt of the free response is the H2 norm squared
    impulse = response([[k, c]])[0, 0, 0] ** 2 * response.models[0].stop / response.models[0].step ** 2
    assert impulse == pytest.approx(_lyapunov(mass_ratio, k, c), rel=2e-3)


def test_mode_of_one_degree_of_freedom() -> None:
    mode = fit_mode(_single(0.05), 0, 0.12, 0.18)
    # the fit's constant stands for p^4, which varies over the band: 5 % of the ratio is what that leaves
    assert mode.mass_ratio == pytest.approx(0.05, rel=0.05)
    assert mode.frequency == pytest.approx(1.0 / (2 * np.pi), rel=3e-3)


@pytest.mark.parametrize("stop", [(7e3, 1e3), (5e5, 5e5)])
def test_stops_keep_a_damper_as_a_simulation_does(stop: tuple[float, float]) -> None:
    """Gaussian drive of a damper whose stops, as soft as its spring or as hard as the barge's, are often met."""
    m, k, c, stroke = 2e4, 7e3, 2.5e3, 1.6
    drive = 0.28 * _noise(5, 0.03, 0.3)
    held = LinearModel(
        "held", (), (), (Damper("d", m, "s", "a"),), *_rigid(drive), np.zeros(0), STEP, 2 * len(TIME), 30.0, END
    )
    fixed = {"d.k": k, "d.c": c, "d.k_stop": stop[0], "d.c_stop": stop[1]}
    free, stopped = SpectralResponse([held], ["d.stroke"], fixed).strokes([[1e6], [stroke]])[:, 0, 0]
    x, v, path = 0.0, 0.0, np.empty(len(TIME))
    fine = 10  # the stop stops a mass in 1 / 25 s
    h = STEP / fine
    forces = np.interp(np.arange(len(TIME) * fine) * h, TIME, drive).tolist()
    for j, a in enumerate(forces):
        if j % fine == 0:
            path[j // fine] = x
        over = x - stroke if x > stroke else min(x + stroke, 0.0)
        outward = stop[1] * v if over * v > 0.0 else 0.0
        v += h * (-(k * x + c * v + stop[0] * over + outward) / m - a)
        x += h * v
    exact = path[TIME >= 30.0].std()
    assert free > 1.05 * exact  # the stops matter
    assert stopped == pytest.approx(exact, rel=0.01)  # steps of 0.05 s against 0.01 s


def test_a_mass_that_leans_on_its_stop() -> None:
    """A spring of next to nothing and a thick dashpot: what an impulse did is felt for the whole record.

    Pushed by 0.5 m/s2 the mass creeps to its stop and stays there, m a / k_stop = 0.02 m beyond.
    """
    m, stroke, slope, hard = 2e4, 1.6, 0.5, 5e5
    drive = np.where(TIME > 5.0, slope, 0.0)
    held = LinearModel(
        "held", (), (), (Damper("d", m, "s", "a"),), *_rigid(drive), np.zeros(0), STEP, 2 * len(TIME), 30.0, END
    )
    variables = {"d.k": 0.5, "d.c": 2e4, "d.k_stop": hard, "d.c_stop": hard, "d.stroke": stroke}
    time, records = SpectralResponse([held], ["d.k"], variables).histories([0.5])
    resting = records[(time > 0.3 * END) & (time < 0.9 * END), 0]
    # the band of the record smooths the step of the slope: a hundredth of the travel
    assert resting == pytest.approx(-(stroke + m * slope / hard), abs=0.02 * stroke)


def _rigid(drive: Array) -> tuple[Array, Array, Array]:
    """Line, transform of a given specific force, and no gain: a rail that nothing moves."""
    sigma, length = 3.0 / END, 2 * len(TIME)
    count = int(0.69 * length * STEP) + 1
    p = sigma + 2j * np.pi * np.arange(count) / (length * STEP)
    base = np.fft.rfft(drive * np.exp(-sigma * TIME), length)[:count, None]
    return p, base, np.zeros((count, 1, 1))


def test_models_are_kept_on_file(model: LinearModel, tmp_path: Path) -> None:
    again = LinearModel.load(model.save(tmp_path / "model.npz"))
    assert again.dampers == model.dampers
    assert again.channels == model.channels
    one, other = (SpectralResponse([m], VARIABLES, {})([[1e4, 4e3, 4e4, 6e3]]) for m in (model, again))
    assert np.array_equal(one, other)
    (tmp_path / "text.npz").write_text("no model")
    with pytest.raises(ValueError, match=r"no linear model .*; write one with 'fowt linearise'"):
        LinearModel.load(tmp_path / "text.npz")


def test_misuse_is_one_clear_line(model: LinearModel) -> None:
    with pytest.raises(ValueError, match=r"'d0\.m' is fixed in a linear model"):
        SpectralResponse([model], ["d0.m"], {})
    with pytest.raises(ValueError, match=r"d1\.c is neither a variable nor given"):
        SpectralResponse([model], VARIABLES[:3], {})
    with pytest.raises(ValueError, match="were made with 40000 kg"):
        SpectralResponse([model], VARIABLES, {"d0.m": 2e4})
    with pytest.raises(ValueError, match=r"expected \(n, 4\)"):
        SpectralResponse([model], VARIABLES, {})([[1.0]])
    columns = ["x0", "a0", "a1", "s0", "s1"]
    held = pd.DataFrame(np.zeros((40, 5)), columns=columns, index=STEP * np.arange(40))
    with pytest.raises(ValueError, match="'s0' rests in the record"):
        estimate(held, [held, held], ["x0"], DAMPERS, label="x", highest=0.69)
    with pytest.raises(ValueError, match="differ in time"):
        estimate(held, [held.iloc[:-1], held], ["x0"], DAMPERS, label="x", highest=0.69)
    bad = SpectralResponse([model], VARIABLES, {})([[1e4, -1.0, 1e4, 1e3], [1e4, 1e3, 1e4, 1e3]])
    assert np.isnan(bad[0]).all()
    assert np.isfinite(bad[1]).all()
