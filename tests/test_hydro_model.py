"""The hydro component: the sea's statistics, and its loads against the database and closed forms."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca
import numpy as np
import numpy.typing as npt
import pytest
from scipy.signal import cont2discrete, dlsim
from scipy.stats import kstest, kurtosis

from fmus_src.equations import Equations, derive
from fmus_src.hydro import waves
from fmus_src.hydro.database import load
from fmus_src.hydro.model import COMPONENTS, component
from fmus_src.hydro.radiation import groups, radiation_model
from fmus_src.instance import Instance

Array = npt.NDArray[np.float64]
STILL = {"Hs": 0.0}


@pytest.fixture(scope="module")
def equations() -> Equations:
    return derive(component())


def at_start(equations: Equations, values: Mapping[str, float]) -> Instance:
    instance = Instance(equations)
    instance.set(values)
    instance.initialise()
    return instance


def loads(instance: Instance) -> Array:
    outputs = instance.outputs()
    return np.array([outputs[f"{name}[{i}]"] for name in ("force", "moment") for i in (1, 2, 3)])


def sea(instance: Instance) -> tuple[Array, Array]:
    """Amplitudes and phases of the irregular sea."""
    amplitude = np.array([instance.get(f"wave.amplitude[{i + 1}]") for i in range(COMPONENTS)])
    phase = np.array([instance.get(f"wave.phase[{i + 1}]") for i in range(COMPONENTS)])
    return amplitude, phase


def elevation(amplitude: Array, phase: Array, time: Array) -> Array:
    omega, _ = waves.frequency_cells(COMPONENTS)
    return np.cos(np.multiply.outer(time, omega) + phase) @ amplitude


# --- the sea ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("hs", "tp", "gamma"), [(1.7, 12.5, 0.0), (5.6, 12.5, 0.0), (4.0, 6.0, 5.0), (4.0, 20.0, 3.3)])
def test_variance_of_the_sea_is_exact(equations: Equations, hs: float, tp: float, gamma: float) -> None:
    amplitude, _ = sea(at_start(equations, {"Hs": hs, "Tp": tp, "gamma": gamma}))
    assert 0.5 * np.sum(amplitude**2) == pytest.approx(hs**2 / 16.0, rel=1e-12)


def test_spectrum_is_jonswap(equations: Equations) -> None:
    omega, width = waves.frequency_cells(COMPONENTS)
    # gamma = 1 is Pierson-Moskowitz, whose energy below w is exp(-1.25 (wp / w)^4): quantiles in closed form.
    amplitude, _ = sea(at_start(equations, {"Hs": 4.0, "Tp": 12.5}))
    energy = np.cumsum(amplitude**2) / np.sum(amplitude**2)
    for share in (0.1, 0.25, 0.5, 0.75, 0.9):
        expected = 2.0 * np.pi / 12.5 * (-np.log(share) / 1.25) ** -0.25
        # Cells of 0.9 % of the frequency; the lost tail of 0.1 % of the energy moves the last quantile most.
        assert np.interp(share, energy, omega) == pytest.approx(expected, rel=0.01)
    # The peak is gamma times Pierson-Moskowitz's, up to the normalisation 1 - 0.287 ln(gamma), which holds to 1 %.
    peak = 2.0 * np.pi / 10.0
    ratio = float(waves.jonswap(peak, 3.0, 10.0, 3.3) / waves.jonswap(peak, 3.0, 10.0, 1.0))
    assert ratio == pytest.approx(3.3 * (1.0 - 0.287 * np.log(3.3)))
    fine = np.linspace(0.2, 12.0, 40_000)
    for gamma in (1.0, 3.3, 5.0):
        values = np.array(ca.DM(waves.jonswap(ca.DM(fine), 3.0, 10.0, gamma))).ravel()
        assert 4.0 * np.sqrt(np.trapezoid(values, fine)) == pytest.approx(3.0, rel=0.01)
    assert width.sum() == pytest.approx(waves.HIGHEST - waves.LOWEST)


def test_default_peak_enhancement() -> None:
    # IEC 61400-3 (2009), annex B. All five load cases of Wang et al. have Tp / sqrt(Hs) > 5.
    for hs in (1.7, 2.0, 2.6, 4.0, 5.6):
        assert float(waves.peak_enhancement(hs, 12.5)) == 1.0
    assert float(waves.peak_enhancement(1.0, 3.0)) == 5.0
    assert float(waves.peak_enhancement(1.0, 4.3)) == pytest.approx(np.exp(5.75 - 1.15 * 4.3))


def test_phases_are_the_generators_numbers() -> None:
    # The recursion AS 183, run here with integers, against the closed form.
    x = [1 + 12345 % (m - 1) for m in waves.MODULI]
    state = [pow(v, 5, m) for v, m in zip(x, waves.MODULI, strict=True)]
    expected = []
    for _ in range(COMPONENTS):
        state = [v * a % m for v, a, m in zip(state, waves.MULTIPLIERS, waves.MODULI, strict=True)]
        expected.append(sum(v / m for v, m in zip(state, waves.MODULI, strict=True)) % 1.0)
    found = np.array(waves.phases(ca.DM(12345), COMPONENTS)).ravel() / (2.0 * np.pi)
    assert np.abs(found - expected).max() < 1e-12


def test_seas_of_different_seeds_are_independent() -> None:
    seeds = [*range(40), 2**31 - 1]
    function = ca.Function("phases", [s := ca.MX.sym("s")], [waves.phases(s, COMPONENTS)])
    u = np.array([np.array(function(seed)).ravel() for seed in seeds]) / (2.0 * np.pi)
    assert np.array_equal(u[3], np.array(function(3)).ravel() / (2.0 * np.pi))
    # Uniform at the 0.1 % level; phases of any two seeds as unrelated as random ones (5 standard deviations), and so
    # are their increments from seed to seed, which a plain congruential start would make equal.
    assert kstest(u.ravel(), "uniform").pvalue > 1e-3
    for phases in (u, np.diff(u[:40], axis=0)):
        coherence = np.abs(np.exp(2j * np.pi * phases) @ np.exp(-2j * np.pi * phases).T) / COMPONENTS
        assert (coherence - np.eye(len(phases))).max() < 5.0 / np.sqrt(COMPONENTS)


def test_elevation_is_gaussian_and_does_not_repeat(equations: Equations) -> None:
    time = np.arange(0.0, 3600.0, 0.5)
    moments = []
    for seed in (1, 2, 3):
        amplitude, phase = sea(at_start(equations, {"Hs": 4.0, "seed": seed}))
        eta = elevation(amplitude, phase, time)
        moments.append(kurtosis(eta, fisher=False))
        # An hour of a narrow-banded sea knows its Hs to some 3 %.
        assert 4.0 * eta.std() == pytest.approx(4.0, rel=0.06)
        instance = at_start(equations, {"Hs": 4.0, "seed": seed})
        assert instance.get("wave_elevation") == pytest.approx(eta[0])
    assert np.mean(moments) == pytest.approx(3.0, abs=0.3)
    # Autocorrelation: a repetition within the hour would bring it back to one.
    omega, _ = waves.frequency_cells(COMPONENTS)
    lag = np.arange(60.0, 3600.0, 0.25)
    correlation = np.cos(np.multiply.outer(lag, omega)) @ amplitude**2 / np.sum(amplitude**2)
    assert np.abs(correlation).max() < 0.5


@pytest.mark.parametrize("even", [True, False])
def test_given_sea_acts_as_the_seeded_one_of_the_same_components(equations: Equations, even: bool) -> None:
    # Even: 0.1, 0.12, ... with gaps, summed by products of rows and columns; else the seeded sea's frequencies.
    if even:
        omega = 0.02 * np.delete(np.arange(5, 120), [7, 50, 51])
        rng = np.random.default_rng(3)
        amplitude, phase = rng.uniform(0.01, 0.1, len(omega)), rng.uniform(0.0, 6.28, len(omega))
    else:
        omega, _ = waves.frequency_cells(COMPONENTS)
        amplitude, phase = sea(at_start(equations, {"Hs": 4.0, "seed": 9}))
    given = waves.WaveComponents(omega, amplitude, phase)
    assert (waves.spacing(omega) is not None) == even
    instance = at_start(derive(component(sea=given)), {"heading": 0.3})
    # The reference: the seeded sea's own sum, or the same waves one by one as regular waves.
    reference = at_start(equations, {"Hs": 4.0, "seed": 9, "heading": 0.3})
    for time in (0.0, 123.4, 3000.0):
        instance.time = reference.time = time
        if even:
            angle = omega * time + phase
            assert instance.get("wave_elevation") == pytest.approx(np.sum(amplitude * np.cos(angle)), abs=1e-9)
        else:
            scale = np.abs(loads(reference)) + 1.0
            assert (np.abs(loads(instance) - loads(reference)) / scale).max() < 1e-9
            assert instance.get("wave_elevation") == pytest.approx(reference.get("wave_elevation"), abs=1e-9)
    if even:
        single = waves.WaveComponents(omega[30:31], amplitude[30:31], phase[30:31])
        rest = waves.WaveComponents(*(np.delete(v, 30) for v in (omega, amplitude, phase)))
        still = loads(at_start(equations, STILL))
        parts = [loads(at_start(derive(component(sea=s)), {"drag_coefficient": 0.0})) - still for s in (single, rest)]
        whole = loads(at_start(derive(component(sea=given)), {"drag_coefficient": 0.0})) - still
        assert parts[0] + parts[1] == pytest.approx(whole, rel=1e-9, abs=1e-3)


def test_added_mass_is_an_output(equations: Equations) -> None:
    instance = at_start(equations, STILL)
    found = [[instance.get(f"added_mass[{i},{j}]") for j in range(1, 7)] for i in range(1, 7)]
    assert np.array_equal(found, load().added_mass_infinite)


# --- loads ------------------------------------------------------------------------------------------------------


def test_still_water_gives_buoyancy_and_restoring(equations: Equations) -> None:
    weight = 1025.0 * 9.80665
    calm = loads(at_start(equations, STILL))
    assert calm == pytest.approx([0.0, 0.0, weight * 6000.0, 0.0, 0.0, 0.0], abs=1e-3)
    moved = {"platform.position[3]": 0.1, "platform.rotation[1]": 0.02, "platform.rotation[2]": 0.05}
    change = loads(at_start(equations, STILL | moved)) - calm
    c55 = weight * (40.0**4 / 12.0 - 6000.0 * 2.0)
    assert change == pytest.approx([0.0, 0.0, -weight * 160.0, -0.02 * c55, -0.05 * c55, 0.0], rel=1e-6, abs=1e-3)
    # A barge yawed by 90 deg that pitches leans sideways: the moment turns with it.
    turned = loads(at_start(equations, STILL | {"platform.rotation[2]": 0.05, "platform.rotation[3]": np.pi / 2}))
    assert turned - calm == pytest.approx([0.0, 0.0, 0.0, 0.05 * c55, 0.0, 0.0], abs=10.0)


@pytest.mark.parametrize(("omega", "heading"), [(0.5, 0.0), (0.9, 45.0), (0.87, 0.0), (1.5, 90.0), (0.7, 135.0)])
def test_regular_wave_excites_as_the_database(equations: Equations, omega: float, heading: float) -> None:
    database = load()
    period = 2.0 * np.pi / omega
    instance = at_start(equations, {
        **STILL, "drag_coefficient": 0.0, "heading": np.radians(heading), "regular_wave.amplitude": 0.5,
        "regular_wave.period": period, "regular_wave.phase": 0.4,
    })  # fmt: skip
    still, samples = loads(at_start(equations, STILL)), []
    for n in range(4):
        instance.time = n * period / 4.0
        samples.append(loads(instance) - still)
    found = (samples[0] - samples[2] + 1j * (samples[3] - samples[1])) / 2.0 / (0.5 * np.exp(0.4j))
    mirrored = heading > 90.0
    column = int(np.argmin(np.abs(np.degrees(database.heading) - (180.0 - heading if mirrored else heading))))
    expected = np.array([np.interp(omega, database.omega, x) for x in database.excitation[:, column].T])
    if mirrored:
        expected *= np.array([-1, 1, 1, 1, -1, -1])
    # Exact at the database's points (the spline and the sum over heading interpolate); linear interpolation, used here
    # for what lies between (0.87 rad/s), is good to 1 %.
    tolerance = 0.01 if omega == 0.87 else 1e-6
    scale = np.abs(database.excitation).max(axis=(0, 1))
    assert (np.abs(found - expected) / scale).max() < tolerance


def test_irregular_excitation_is_the_sum_of_its_waves(equations: Equations) -> None:
    database = load()
    instance = at_start(equations, {"Hs": 4.0, "drag_coefficient": 0.0})
    amplitude, phase = sea(instance)
    omega, _ = waves.frequency_cells(COMPONENTS)
    x = np.array([np.interp(omega, database.omega, values) for values in database.excitation[:, 0].T])
    still = loads(at_start(equations, STILL))
    errors = []
    for time in np.linspace(0.0, 300.0, 25):
        instance.time = time
        expected = (x * amplitude * np.exp(1j * (omega * time + phase))).real.sum(axis=1)
        errors.append((loads(instance) - still - expected)[[0, 2, 4]])
    deviation = np.sqrt(0.5 * (np.abs(x) ** 2 @ amplitude**2))[[0, 2, 4]]
    # Against linear interpolation between 0.05 rad/s.
    assert (np.std(errors, axis=0) < 0.01 * deviation).all()


def test_waves_from_the_side_swap_surge_and_sway(equations: Equations) -> None:
    ahead = loads(at_start(equations, {"Hs": 4.0, "seed": 5}))
    abeam = loads(at_start(equations, {"Hs": 4.0, "seed": 5, "heading": np.pi / 2}))
    # Five digits are stored for each degree of freedom.
    assert abeam[[1, 2]] == pytest.approx(ahead[[0, 2]], rel=1e-4)
    assert abeam[3] == pytest.approx(-ahead[4], rel=1e-4)
    assert np.abs(abeam[[0, 4]]).max() < 1e-4 * np.abs(ahead[[0, 4]]).max()
    quarter = loads(at_start(equations, {"Hs": 4.0, "seed": 5, "heading": np.pi / 4}))
    assert quarter[0] == pytest.approx(quarter[1], rel=1e-4)


def memory(equations: Equations) -> tuple[Array, Array, Array]:
    """The component's own radiation system x' = a x + b v, force = c x, by unit inputs and states."""
    instance = at_start(equations, STILL | {"drag_coefficient": 0.0})
    names = [f"platform.{v}[{i}]" for v in ("velocity", "angular_velocity") for i in (1, 2, 3)]
    n, still = equations.sizes["x"], loads(instance)
    a = np.column_stack([instance.derivative(e) for e in np.eye(n)])
    b = np.zeros((n, 6))
    for i, name in enumerate(names):
        instance.set({name: 1.0})
        b[:, i] = instance.derivative(np.zeros(n))
        instance.set({name: 0.0})
    c = np.zeros((6, n))
    for i in range(n):
        instance._values["x"] = np.eye(n)[i]
        c[:, i] = loads(instance) - still
    return a, b, c


def test_forced_motion_meets_added_mass_and_damping(equations: Equations) -> None:
    # Oscillating with velocity v the barge feels -(B + i w (A - A_inf)) v from the memory.
    database = load()
    model = radiation_model(database)
    a, b, c = memory(equations)
    # Where the waves have their energy; the fit itself is judged over all frequencies in test_hydro_database.
    n = int(np.sum(database.omega <= 1.5))
    omega = database.omega[:n]
    response = np.array([c @ np.linalg.solve(1j * w * np.eye(len(a)) - a, b) for w in omega])
    difference = database.added_mass[:n] - database.added_mass_infinite
    expected = -(database.damping[:n] + 1j * omega[:, None, None] * difference)
    for dofs in groups(database):
        rows, columns = np.ix_(dofs, dofs)
        scale = np.sqrt(np.diagonal(database.damping[:, dofs][:, :, dofs], axis1=1, axis2=2).max(axis=0))
        error = (response - expected)[:, rows, columns] / np.multiply.outer(scale, scale)
        reference = expected[:, rows, columns] / np.multiply.outer(scale, scale)
        # The fit's error (in B, in A) and the 1 to 2 % to which A and B are one causal function.
        allowed = max(np.hypot(model.damping_error[f"{i + 1}{i + 1}"], model.added_mass_error[f"{i + 1}{i + 1}"])
                      for i in dofs) + 0.02  # fmt: skip
        assert np.linalg.norm(error) / np.linalg.norm(reference) < allowed


def test_radiation_only_takes_energy(equations: Equations) -> None:
    # Whatever the motion, the work done on the water up to any time is positive: random velocities from rest, with
    # surge and pitch in proportion to their typical sizes.
    a, b, c = memory(equations)
    step = 0.05
    system = cont2discrete((a, b, c, np.zeros((6, 6))), step, method="foh")
    rng = np.random.default_rng(7)
    time = np.arange(0.0, 200.0, step)
    waves_of_motion = np.cos(np.multiply.outer(time, rng.uniform(0.05, 2.0, 30)) + rng.uniform(0.0, 6.3, 30))
    velocity = waves_of_motion @ rng.normal(size=(30, 6)) * np.array([1.0, 1.0, 1.0, 0.04, 0.04, 0.04])
    velocity *= np.minimum(1.0, time / 5.0)[:, None]
    _, force, _ = dlsim(system, velocity)
    work = -np.cumsum(np.sum(force * velocity, axis=1)) * step
    assert work.min() > -1e-3 * work.max()
    assert work[-1] > 0.5 * work.max()


def test_radiation_can_be_switched_off(equations: Equations) -> None:
    instance = at_start(equations, STILL | {"drag_coefficient": 0.0, "platform.velocity[1]": 1.0})
    instance.do_step(0.1)
    assert loads(instance)[0] < -1e4
    instance = at_start(
        equations, STILL | {"drag_coefficient": 0.0, "platform.velocity[1]": 1.0, "radiation_memory": 0.0}
    )
    instance.do_step(0.1)
    assert loads(instance)[0] == 0.0


def test_drag_of_a_towed_deck(equations: Equations) -> None:
    # Steady tow at U: rho/2 Cd D d U^2 at half the draft.
    still = loads(at_start(equations, STILL))
    towed = loads(at_start(equations, STILL | {"platform.velocity[1]": 0.8, "platform.velocity[2]": 0.6})) - still
    drag = 0.5 * 1025.0 * 45.1352 * 4.0
    assert towed == pytest.approx([-0.8 * drag, -0.6 * drag, 0.0, -2.0 * 0.6 * drag, 2.0 * 0.8 * drag, 0.0], rel=1e-6)
    # Pitching at rate q: velocity q z along x, moment -rho/2 Cd D q^2 d^4 / 4, three Gauss points exact up to z^5.
    pitched = loads(at_start(equations, STILL | {"platform.angular_velocity[2]": 0.1})) - still
    assert pitched[4] == pytest.approx(-0.5 * 1025.0 * 45.1352 * 0.01 * 4.0**4 / 4.0, rel=1e-6)
    # Moving with the water of a wave there is none: velocity of deep water a w exp(k z), nearly uniform over the draft.
    wave = {"regular_wave.amplitude": 0.5, "regular_wave.period": 20.0}
    omega = 2.0 * np.pi / 20.0
    follow = {"platform.velocity[1]": 0.5 * omega * 1.02}
    held, free = at_start(equations, STILL | wave), at_start(equations, STILL | wave | follow)
    without = at_start(equations, STILL | wave | {"drag_coefficient": 0.0})
    assert abs(loads(free)[0] - loads(without)[0]) < 0.01 * abs(loads(held)[0] - loads(without)[0])
