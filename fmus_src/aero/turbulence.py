"""Turbulent wind after IEC 61400-1 (ed. 3, 2005): normal turbulence, Kaimal spectra, exponential coherence.

The field is the one NREL's TurbSim makes for ``IECKAI`` with its default settings (TurbSim User's Guide
v2.00):

- standard deviations: sigma_1 = I_ref (0.75 V_hub + 5.6 m/s), the same at every height (eq. 11); sigma_2 =
  0.8 sigma_1, sigma_3 = 0.5 sigma_1 (annex B);
- spectra: S_k(f) = 4 sigma_k^2 (L_k / V_hub) / (1 + 6 f L_k / V_hub)^(5/3), L = (8.1, 2.7, 0.66) Lambda_1
  (eq. B.14, table B.1), Lambda_1 = 0.7 z_hub up to 60 m and 42 m above (eq. 5);
- coherence of the downwind component: exp(-12 sqrt((f r / V_hub)^2 + (0.12 r / L_c)^2)), L_c = 8.1 Lambda_1
  (eq. B.16), taken as |S_ij| / sqrt(S_ii S_jj); the lateral and vertical components are uncorrelated between
  points and with each other;
- mean wind: power law in height.

Method: Veers, SAND88-0152 (1988): Cholesky factors of the coherence matrix at every frequency, uniform
random phases, inverse FFT.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len

from fmus_src.aero.turbsim_file import WindBox, check_box, write_box

#: Part of the cache key: raise it whenever the same spec gives other numbers than before.
GENERATOR_VERSION: Final = 1
#: Expected turbulence intensity at 15 m/s by turbulence class, IEC 61400-1 table 1.
REFERENCE_INTENSITY: Final = {"A": 0.16, "B": 0.14, "C": 0.12}
_SIGMA_RATIO: Final = np.array([1.0, 0.8, 0.5])
_LENGTH_RATIO: Final = np.array([8.1, 2.7, 0.66])
_COHERENCE_DECREMENT: Final = 12.0
_COHERENCE_OFFSET: Final = 0.12
# Where neighbouring points share less than this, their coherence matrix is the unit matrix for every purpose
# and needs no factor: four fifths of the frequencies.
_NEGLIGIBLE_COHERENCE: Final = 1e-5
_BLOCK: Final = 64
_MAX_VALUES: Final = 400_000_000


@dataclass(frozen=True)
class TurbulenceSpec:
    """What a turbulent wind box is made from; equal specs give equal boxes.

    Attributes:
        mean_speed: mean wind at hub height, m/s.
        turbulence_class: "A", "B" or "C".
        seed: any non-negative integer.
        duration: simulated time the box must serve, s; the box is longer by the time its width takes to pass.
        dt: time step, s.
        hub_height: centre of the grid, m.
        shear_exponent: of the mean wind's power law (0.2: IEC normal wind profile, eq. 10).
        grid_points: points along y and along z.
        grid_width: width and height of the grid, m.
        scale_to_target: scale each component so that the standard deviation at the hub is exactly its target
            (TurbSim's ScaleIEC = 1). False, as TurbSim's default, leaves a seed's own sampling deviation of
            a few percent.

    Raises:
        ValueError: a value outside what the model is made for.
    """

    mean_speed: float
    turbulence_class: str = "B"
    seed: int = 1
    duration: float = 640.0
    dt: float = 0.05
    hub_height: float = 90.0
    shear_exponent: float = 0.2
    grid_points: int = 15
    grid_width: float = 145.0
    scale_to_target: bool = False

    def __post_init__(self) -> None:
        if self.turbulence_class not in REFERENCE_INTENSITY:
            raise ValueError(f"turbulence_class is {self.turbulence_class!r}; give 'A', 'B' or 'C'")
        if isinstance(self.seed, bool) or not isinstance(self.seed, int) or self.seed < 0:
            raise ValueError(f"seed is {self.seed!r}; give an integer of at least 0")
        for name in ("mean_speed", "duration", "dt", "hub_height", "grid_width"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise ValueError(f"{name} is {value}; give a finite value above zero")
        if not (math.isfinite(self.shear_exponent) and 0.0 <= self.shear_exponent <= 1.0):
            raise ValueError(f"shear_exponent is {self.shear_exponent}; give a value from 0 to 1")
        if self.grid_points < 3 or self.grid_points % 2 == 0:
            raise ValueError(f"grid_points is {self.grid_points}; give an odd number from 3 (one point is the hub)")
        if self.grid_width >= 2.0 * self.hub_height:
            raise ValueError(f"grid_width {self.grid_width} m reaches the sea; give less than twice hub_height")
        if 3.0 * self.grid_points**2 * (self.duration + self.grid_width / self.mean_speed) / self.dt > _MAX_VALUES:
            raise ValueError("the box would hold over 4e8 velocities; give a shorter duration or fewer grid_points")

    @property
    def sigma(self) -> NDArray[np.float64]:
        """Target standard deviation of the three components, m/s (3,)."""
        intensity = REFERENCE_INTENSITY[self.turbulence_class]
        return intensity * (0.75 * self.mean_speed + 5.6) * _SIGMA_RATIO

    @property
    def length_scale(self) -> NDArray[np.float64]:
        """Integral length scales of the three components, m (3,)."""
        return _LENGTH_RATIO * min(0.7 * self.hub_height, 42.0)


def kaimal_spectrum(spec: TurbulenceSpec, frequency: NDArray[np.float64]) -> NDArray[np.float64]:
    """One-sided Kaimal spectra of the components, m^2/s (3, n), at frequencies (n,) Hz (IEC eq. B.14)."""
    time_scale = (spec.length_scale / spec.mean_speed)[:, None]
    variance = (spec.sigma**2)[:, None]
    return np.asarray(4.0 * variance * time_scale / (1.0 + 6.0 * frequency * time_scale) ** (5.0 / 3.0))


def coherence(
    spec: TurbulenceSpec, frequency: NDArray[np.float64], distance: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Coherence of the downwind component, (n_frequency, *distance.shape) (IEC eq. B.16).

    Args:
        spec: the wind.
        frequency: Hz (n_frequency,).
        distance: separation normal to the mean wind, m, any shape.
    """
    decay = _COHERENCE_DECREMENT / spec.mean_speed
    frozen = _COHERENCE_DECREMENT * _COHERENCE_OFFSET / spec.length_scale[0]
    f = frequency.reshape(-1, *([1] * distance.ndim))
    return np.asarray(np.exp(-distance * np.sqrt((decay * f) ** 2 + frozen**2)))


def generate(spec: TurbulenceSpec) -> WindBox:
    """Make the wind box of ``spec``: bit for bit the same on one kind of machine. A second or two."""
    n = spec.grid_points
    spacing = spec.grid_width / (n - 1)
    nt = math.ceil((spec.duration + spec.grid_width / spec.mean_speed) / spec.dt - 1e-9)
    nfft = next_fast_len(nt, real=True)
    df = 1.0 / (nfft * spec.dt)
    frequency = df * np.arange(1, (nfft - 1) // 2 + 1)  # neither mean nor Nyquist
    z = spec.hub_height + (np.arange(n) - n // 2) * spacing

    rng = np.random.Generator(np.random.PCG64(np.random.SeedSequence(spec.seed)))
    amplitude = np.sqrt(0.5 * df * kaimal_spectrum(spec, frequency)) * nfft
    velocity = np.empty((nt, n * n, 3), dtype=np.float32)
    for component in range(3):
        phase = rng.uniform(0.0, 2.0 * math.pi, size=(frequency.size, n * n))
        mixed = np.exp(1j * phase)
        if component == 0:
            mixed = _correlate(spec, frequency, mixed, spacing)
        bins = np.zeros((nfft // 2 + 1, n * n), dtype=complex)
        bins[1 : frequency.size + 1] = amplitude[component][:, None] * mixed
        velocity[:, :, component] = irfft(bins, n=nfft, axis=0, overwrite_x=True)[:nt]
    if spec.scale_to_target:
        hub = velocity[:, (n * n) // 2].astype(float)
        velocity *= (spec.sigma / hub.std(axis=0)).astype(np.float32)
    field = velocity.reshape(nt, n, n, 3)
    field[..., 0] += (spec.mean_speed * (z / spec.hub_height) ** spec.shear_exponent)[:, None].astype(np.float32)
    return WindBox(
        velocity=field,
        dt=spec.dt,
        dy=spacing,
        dz=spacing,
        z_bottom=float(z[0]),
        hub_height=spec.hub_height,
        mean_speed=spec.mean_speed,
        periodic=False,
        tower=np.empty((nt, 0, 3), dtype=np.float32),
        description=f"Kaimal, class {spec.turbulence_class}, {spec.mean_speed:g} m/s, seed {spec.seed}",
    )


def _correlate(
    spec: TurbulenceSpec, frequency: NDArray[np.float64], phasor: NDArray[np.complex128], spacing: float
) -> NDArray[np.complex128]:
    """Mix independent unit phasors (n_frequency, n_points) so that points share the coherence.

    The coherence does not change when the grid is mirrored about its centre lines, so in terms of sums and
    differences of mirror images the coherence matrix splits into four independent blocks, each factored on
    its own: a sixteenth of the work.
    """
    n = spec.grid_points
    steps = np.arange(n) * spacing
    separation = np.hypot(steps[:, None], steps[None, :])
    n_coherent = int(np.count_nonzero(coherence(spec, frequency, np.array(spacing)) > _NEGLIGIBLE_COHERENCE))
    mixed = phasor.copy()
    for start in range(0, n_coherent, _BLOCK):
        block = slice(start, min(start + _BLOCK, n_coherent))
        shared = coherence(spec, frequency[block], separation)
        mixed[block] = _mix(shared, phasor[block].reshape(-1, n, n)).reshape(-1, n * n)
    return mixed


def _mix(shared: NDArray[np.float64], phasor: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Square root of the coherence matrix times the phasors (n_frequency, nz, ny).

    Args:
        shared: coherence by the number of rows and columns between two points (n_frequency, n, n).
        phasor: (n_frequency, n, n).
    """
    n_frequency, n, _ = phasor.shape
    half = n // 2
    mixed = np.zeros_like(phasor)
    for sign_z in (1.0, -1.0):
        for sign_y in (1.0, -1.0):
            i, j = np.indices((half + (sign_z > 0), half + (sign_y > 0))).reshape(2, -1)
            # Basis vectors: (point +- mirror image) / sqrt 2; a point on the centre line is its own image.
            weight = np.where(i == half, 0.5**0.5, 1.0) * np.where(j == half, 0.5**0.5, 1.0)
            dz, dy = abs(i[:, None] - i), abs(j[:, None] - j)
            image_z, image_y = n - 1 - i[:, None] - i, n - 1 - j[:, None] - j
            matrix = shared[:, dz, dy] + sign_y * shared[:, dz, image_y]
            matrix += sign_z * (shared[:, image_z, dy] + sign_y * shared[:, image_z, image_y])
            factor = np.linalg.cholesky(matrix * (weight[:, None] * weight))
            # Independent phasors of this block: those at the quadrant's own points.
            source = np.ascontiguousarray(phasor[:, i if sign_z > 0 else n - 1 - i, j if sign_y > 0 else n - 1 - j])
            parts = factor @ source.view(float).reshape(n_frequency, i.size, 2)
            value = np.ascontiguousarray(parts).view(complex)[..., 0] * (0.5 * weight)
            for rows, sign in ((i, 1.0), (n - 1 - i, sign_z)):
                mixed[:, rows, j] += sign * value
                mixed[:, rows, n - 1 - j] += sign * sign_y * value
    return mixed


def cached_box(spec: TurbulenceSpec, folder: str | os.PathLike[str]) -> Path:
    """Path of the ``.bts`` file of ``spec`` in ``folder``: made once, then found again by the spec's hash.

    The file appears complete or not at all, so several processes may ask for one box at once. A file that is
    not usable (cut short by a full disk, say) is made again.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    # Integers and floats of equal value are one spec: 18 and 18.0 must share a key.
    plain = {
        k: float(v) if isinstance(v, int | float) and not isinstance(v, bool) else v for k, v in asdict(spec).items()
    }
    plain["seed"] = spec.seed
    key = json.dumps({"generator": GENERATOR_VERSION, **plain}, sort_keys=True)
    path = folder / f"kaimal_{hashlib.sha256(key.encode()).hexdigest()[:20]}.bts"
    try:
        check_box(path)
    except (FileNotFoundError, ValueError):
        write_box(generate(spec), path)
    return path
