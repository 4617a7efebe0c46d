"""Kaimal turbulence: mean, variance, spectra and coherence against IEC 61400-1, repeatability, cache."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fmus_src.aero import turbulence
from fmus_src.aero.turbsim_file import read_box
from fmus_src.aero.turbulence import TurbulenceSpec, cached_box, coherence, generate, kaimal_spectrum

# 6000 steps are a fast FFT length, so the box is one whole period and its periodogram has no leakage.
PERIODIC = TurbulenceSpec(20.0, duration=597.0, dt=0.1, grid_points=7, grid_width=60.0)
SEEDS = range(16)


def amplitudes(spec: TurbulenceSpec) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies (n,) and complex Fourier amplitudes (n, nz, ny, 3) of a box that is one whole period."""
    velocity = generate(spec).velocity
    assert velocity.shape[0] == 6000
    lines = np.fft.rfft(velocity.astype(float), axis=0)[1:-1]
    return np.arange(1, 3000) / 600.0, lines * np.sqrt(2.0 * spec.dt / 6000)  # |line|^2 is the one-sided spectrum


@pytest.fixture(scope="module")
def ensemble() -> tuple[np.ndarray, np.ndarray]:
    runs = [amplitudes(replace(PERIODIC, seed=s)) for s in SEEDS]
    return runs[0][0], np.stack([line[..., 0] for _, line in runs])  # (seeds, n, nz, ny)


def test_normal_turbulence_model_figures() -> None:
    """IEC 61400-1 ed. 3, class B at 12 m/s: sigma_1 = 0.14 (0.75 * 12 + 5.6) m/s; 42 m scale above 60 m."""
    spec = TurbulenceSpec(12.0)
    assert spec.sigma == pytest.approx([2.044, 1.6352, 1.022])
    assert spec.length_scale == pytest.approx([340.2, 113.4, 27.72])
    f = np.logspace(-8, 5, 20001)
    # The Kaimal spectrum integrates to the variance (trapezoidal rule in log f: 1e-4; tail beyond the range:
    # 1e-5).
    area = np.trapezoid(kaimal_spectrum(spec, f) * f, np.log(f), axis=1)
    assert area == pytest.approx(spec.sigma**2, rel=1e-3)


def test_spectrum_and_coherence_worked_by_hand() -> None:
    """At 20 m/s: sigma_1 = 2.884 m/s, L_u / V = 17.01 s, L_w / V = 1.386 s, L_c = 340.2 m."""
    spectrum = kaimal_spectrum(PERIODIC, np.array([0.01, 0.1]))
    assert spectrum[0, 0] == pytest.approx(175.235, rel=1e-4)  # 4 * 2.884^2 * 17.01 / 2.0206^(5/3)
    assert spectrum[2, 1] == pytest.approx(4.2044, rel=1e-4)  # 4 * 1.442^2 * 1.386 / 1.8316^(5/3)
    # exp(-12 sqrt(0.1^2 + (0.12 * 20 / 340.2)^2))
    assert coherence(PERIODIC, np.array([0.1]), np.array(20.0)) == pytest.approx(0.30029, rel=1e-4)


def test_mean_wind_follows_the_power_law() -> None:
    box = generate(PERIODIC)
    mean = box.velocity.astype(float).mean(axis=0)
    expected = 20.0 * (box.z / 90.0) ** 0.2
    # A whole period has no mean of its own: only 32-bit rounding is left.
    assert mean[..., 0] == pytest.approx(np.repeat(expected[:, None], 7, axis=1), rel=1e-5)
    assert np.abs(mean[..., 1:]).max() < 1e-4


def test_lateral_and_vertical_spectra_are_kaimal_at_every_point() -> None:
    f, lines = amplitudes(PERIODIC)
    expected = kaimal_spectrum(PERIODIC, f)
    for component in (1, 2):
        spectrum = np.abs(lines[..., component]) ** 2
        # Uncorrelated points have deterministic amplitudes (Veers); 32-bit storage rounds the weakest lines.
        np.testing.assert_allclose(spectrum, expected[component][:, None, None] * np.ones((7, 7)), rtol=1e-2)


def test_downwind_spectrum_is_kaimal_on_average(ensemble: tuple[np.ndarray, np.ndarray]) -> None:
    f, lines = ensemble
    expected = kaimal_spectrum(PERIODIC, f)[0]
    ratio = (np.abs(lines) ** 2 / expected[:, None, None]).mean(axis=(0, 2, 3))
    for low, high in ((1, 10), (10, 40), (40, 160), (160, 640), (640, 2999)):
        band = ratio[low:high].mean()
        # One line's relative scatter is at most 1; counting points as one sample each line: 4.5 standard
        # errors.
        assert band == pytest.approx(1.0, abs=4.5 / np.sqrt(len(SEEDS) * (high - low)))


def test_standard_deviation_is_the_same_at_every_height(ensemble: tuple[np.ndarray, np.ndarray]) -> None:
    f, lines = ensemble
    df = f[0]
    variance = (np.abs(lines) ** 2).sum(axis=1).mean(axis=(0, 2)) * df  # by row
    target = kaimal_spectrum(PERIODIC, f)[0].sum() * df
    # Scatter of a seed's variance: sqrt(sum S^2) df / (sum S df) = 0.14; 16 seeds, 4 standard errors: 14 %.
    assert variance == pytest.approx(np.full(7, target), rel=0.14)
    # Lines above 1/600 Hz hold most of the nominal variance, and never more than it.
    assert 0.85 * PERIODIC.sigma[0] ** 2 < target < PERIODIC.sigma[0] ** 2


@pytest.mark.parametrize("apart", [1, 3, 6])
@pytest.mark.parametrize("frequency", [0.02, 0.06, 0.15])
def test_coherence_of_the_downwind_component(
    ensemble: tuple[np.ndarray, np.ndarray], apart: int, frequency: float
) -> None:
    f, lines = ensemble
    near = np.abs(f - frequency) <= 0.1 * frequency
    for axis in (2, 3):
        a = np.take(lines[:, near], range(7 - apart), axis=axis)
        b = np.take(lines[:, near], range(apart, 7), axis=axis)
        cross, power = (a * b.conj()).mean(), np.sqrt((np.abs(a) ** 2).mean() * (np.abs(b) ** 2).mean())
        expected = coherence(PERIODIC, f[near], np.array(apart * 10.0)).mean()
        # 4.5 standard errors of an estimated coherence, (1 - c^2) / sqrt(2 N); points of one line count once.
        error = 4.5 * (1.0 - expected**2) / np.sqrt(2 * len(SEEDS) * near.sum())
        assert cross.real / power == pytest.approx(expected, abs=error)
        assert abs(cross.imag) / power < max(error, 4.5 / np.sqrt(2 * len(SEEDS) * near.sum()))


def test_mixing_matrix_is_an_exact_square_root_of_the_coherence_matrix() -> None:
    n, spacing, f = 5, 12.0, np.array([0.004, 0.09])
    steps = np.arange(n) * spacing
    shared = coherence(PERIODIC, f, np.hypot(steps[:, None], steps))
    unit = np.eye(n * n, dtype=complex).reshape(n * n, 1, n, n)
    root = np.stack([turbulence._mix(shared, np.repeat(e, 2, axis=0)).reshape(2, -1) for e in unit], axis=-1)
    y, z = (g.ravel() for g in np.meshgrid(steps, steps))
    full = coherence(PERIODIC, f, np.hypot(y[:, None] - y, z[:, None] - z))
    assert root @ root.conj().swapaxes(1, 2) == pytest.approx(full, abs=1e-12)  # rounding


def test_lateral_and_vertical_components_are_uncorrelated_between_neighbours() -> None:
    _, lines = amplitudes(PERIODIC)
    for component in (1, 2):
        x = lines[..., component] / np.abs(lines[..., component])
        correlation = (x[:, :, 1:] * x[:, :, :-1].conj()).mean()
        assert abs(correlation) < 4.5 / np.sqrt(x[:, :, 1:].size)
    u = lines[..., 0] / np.abs(lines[..., 0])
    w = lines[..., 2] / np.abs(lines[..., 2])
    assert abs((u * w.conj()).mean()) < 4.5 / np.sqrt(u.size)


def test_scaling_gives_the_target_at_the_hub() -> None:
    box = generate(replace(PERIODIC, scale_to_target=True))
    assert box.velocity[:, 3, 3].astype(float).std(axis=0) == pytest.approx(PERIODIC.sigma, rel=1e-5)
    plain = generate(PERIODIC)
    factor = PERIODIC.sigma / plain.velocity[:, 3, 3].astype(float).std(axis=0)
    assert box.velocity[:, 0, 5, 1] == pytest.approx(plain.velocity[:, 0, 5, 1] * factor[1], rel=1e-4, abs=1e-4)


def test_a_seed_repeats_and_seeds_differ() -> None:
    spec = replace(PERIODIC, duration=60.0)
    first, again, other = generate(spec), generate(spec), generate(replace(spec, seed=2))
    assert first.velocity.tobytes() == again.velocity.tobytes()
    u, v = (b.velocity[..., 1].ravel() for b in (first, other))
    assert abs(np.corrcoef(u, v)[0, 1]) < 4.5 / np.sqrt(49 * 10)  # some ten independent gusts in 60 s at 49 points


def test_box_covers_the_run_at_any_wind_speed() -> None:
    for speed in (4.0, 25.0):
        box = generate(TurbulenceSpec(speed, duration=100.0, dt=0.2, grid_points=3))
        # A rotor up to half a grid width from the tower finds wind from 0 to 100 s less two steps.
        points = np.array([[-72.5, 0.0, 90.0], [72.5, 0.0, 90.0]])
        for t in (0.0, 99.6):
            assert np.isfinite(box.sample(t, points)).all()


def test_cache_makes_a_box_once_and_replaces_a_damaged_one(tmp_path: Path) -> None:
    spec = replace(PERIODIC, duration=20.0, grid_points=3)
    path = cached_box(spec, tmp_path / "wind")
    written = path.stat().st_mtime_ns
    assert cached_box(replace(spec, mean_speed=20), tmp_path / "wind") == path  # 20 and 20.0 are one wind
    assert path.stat().st_mtime_ns == written
    assert cached_box(replace(spec, seed=2), tmp_path / "wind") != path
    box, content = generate(spec), path.read_bytes()
    assert np.abs(read_box(path).velocity - box.velocity).max() < 1e-3
    path.write_bytes(content[:-7])
    assert cached_box(spec, tmp_path / "wind").read_bytes() == content
    assert sorted(p.suffix for p in (tmp_path / "wind").iterdir()) == [".bts", ".bts"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"mean_speed": 0.0}, "mean_speed"),
        ({"turbulence_class": "D"}, "turbulence_class"),
        ({"seed": -1}, "seed"),
        ({"duration": float("inf")}, "duration"),
        ({"grid_points": 14}, "grid_points"),
        ({"grid_width": 200.0}, "reaches the sea"),
        ({"dt": 1e-6}, "4e8"),
    ],
)
def test_impossible_specs_are_refused(change: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        TurbulenceSpec(**{"mean_speed": 12.0, **change})  # type: ignore[arg-type]
