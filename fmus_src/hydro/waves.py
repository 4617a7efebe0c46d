"""Long-crested irregular sea as a sum of wave components, and linear wave kinematics in finite depth.

    eta(t) = sum_k a_k cos(w_k t + e_k) at x = y = 0,    a_k = sqrt(2 S(w_k) dw_k)

Functions marked "symbolic" take CasADi expressions (or numbers) and return them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

LOWEST, HIGHEST = 0.12, 3.0  # rad/s
COLUMNS = 32  # of the grid of evenly spaced frequencies
# Wichmann and Hill, Algorithm AS 183, Applied Statistics 31 (1982): three generators x <- multiplier x mod modulus.
MULTIPLIERS, MODULI = (171, 172, 170), (30269, 30307, 30323)


@dataclass(frozen=True)
class WaveComponents:
    """A given sea: components of elevation at x = y = 0, a cos(w t + e).

    Attributes:
        omega: angular frequency, rad/s, shape (n,).
        amplitude: m, shape (n,).
        phase: e in cos(w t + e), rad, shape (n,).
    """

    omega: Array
    amplitude: Array
    phase: Array


def frequency_cells(count: int, low: float = LOWEST, high: float = HIGHEST) -> tuple[Array, Array]:
    """Frequencies and cell widths of a sea that does not repeat: rad/s, two arrays of shape (count,).

    The cells widen in proportion to frequency, so that a spectrum is resolved alike whatever its peak (0.0045 rad/s
    at 0.5 rad/s with 360 cells); in its cell each frequency is offset by a multiple of the golden ratio, so that no
    two differences are commensurable.
    """
    edges = np.geomspace(low, high, count + 1)
    golden = (np.sqrt(5.0) - 1.0) / 2.0
    offset = 0.1 + 0.8 * np.mod(golden * np.arange(1, count + 1), 1.0)
    width = np.diff(edges)
    return edges[:-1] + offset * width, width


def spacing(omega: Array) -> float | None:
    """Spacing dw if all frequencies are multiples k dw to six digits (as FFTs make and files keep them), else None."""
    ordered = np.sort(omega)
    step = float(np.min(np.diff(ordered), initial=np.inf))
    if not 0.0 < step < np.inf:
        return None
    # Refined from the lowest frequencies up, as the first estimate does not tell high multiples apart.
    for count in np.unique(np.geomspace(2, len(ordered), 12).astype(int)):
        k = np.round(ordered[:count] / step)
        if k[0] < 1.0:
            return None
        step = float(k @ ordered[:count] / (k @ k))
    return step if np.all(np.abs(np.round(ordered / step) * step - ordered) <= 5.01e-6 * ordered) else None


def on_grid(sea: WaveComponents, step: float) -> WaveComponents:
    """A sea of frequencies k step on all k from its lowest to its highest, padded to a multiple of `COLUMNS`.

    Components of like frequency become one; those that fill gaps and the end have no amplitude.
    """
    k = np.round(sea.omega / step).astype(int)
    rows = -(-(k.max() - k.min() + 1) // COLUMNS)
    total = np.zeros(rows * COLUMNS, dtype=complex)
    np.add.at(total, k - k.min(), sea.amplitude * np.exp(1j * sea.phase))
    return WaveComponents(step * (k.min() + np.arange(len(total))), np.abs(total), np.angle(total))


def oscillations(sea: WaveComponents, time: Any) -> tuple[Any, Any]:
    """a cos(w t + e) and a sin(w t + e) of frequencies known when the component is built, two columns; symbolic."""
    angle = ca.DM(sea.omega) * time + ca.DM(sea.phase)
    return ca.DM(sea.amplitude) * ca.cos(angle), ca.DM(sea.amplitude) * ca.sin(angle)


def grid_oscillations(sea: WaveComponents, step: float, time: Any) -> tuple[Any, Any]:
    """As `oscillations` of a sea that `on_grid` has made, at a fraction of the cost; symbolic.

    With k = k_0 + m i + j the angle is that of row i plus that of column j: of n components only n / m + m sines and
    cosines are needed, the others are their products. Exact but for rounding.
    """
    over = ca.DM(sea.omega[::COLUMNS]) * time
    along = ca.DM(step * np.arange(COLUMNS)) * time
    c_row, s_row, c_column, s_column = ca.cos(over), ca.sin(over), ca.cos(along), ca.sin(along)
    # Column by column as CasADi stores matrices: columns of the grid are made its rows.
    cosine = ca.vec(ca.mtimes(c_column, c_row.T) - ca.mtimes(s_column, s_row.T))
    sine = ca.vec(ca.mtimes(s_column, c_row.T) + ca.mtimes(c_column, s_row.T))
    real, imag = ca.DM(sea.amplitude * np.cos(sea.phase)), ca.DM(sea.amplitude * np.sin(sea.phase))
    return real * cosine - imag * sine, real * sine + imag * cosine


def peak_enhancement(hs: Any, tp: Any) -> Any:
    """Default gamma of IEC 61400-3 (2009), annex B: 5 to 1 as Tp / sqrt(Hs) goes from 3.6 to 5; symbolic."""
    steepness = tp / ca.sqrt(ca.fmax(hs, 1e-9))
    return ca.if_else(steepness <= 3.6, 5.0, ca.if_else(steepness <= 5.0, ca.exp(5.75 - 1.15 * steepness), 1.0))


def jonswap(omega: Any, hs: Any, tp: Any, gamma: Any) -> Any:
    """JONSWAP spectrum, m2 s/rad, one-sided, normalised by 1 - 0.287 ln(gamma) (IEC 61400-3, annex B); symbolic."""
    peak = 2.0 * ca.pi / tp
    sigma = ca.if_else(omega <= peak, 0.07, 0.09)
    enhancement = gamma ** ca.exp(-0.5 * ((omega / peak - 1.0) / sigma) ** 2)
    shape = 5.0 / 16.0 * peak**4 * omega**-5 * ca.exp(-1.25 * (peak / omega) ** 4)
    return (1.0 - 0.287 * ca.log(gamma)) * hs**2 * shape * enhancement


def amplitudes(omega: Array, width: Array, hs: Any, tp: Any, gamma: Any) -> Any:
    """Amplitudes, m, shape (n,); symbolic.

    They are scaled as one so that the variance is Hs^2 / 16 exactly: the spectrum's normalisation is approximate, and
    what lies beyond the highest frequency is cut off (0.1 % of the variance at Tp = 12.5 s).
    """
    density = jonswap(ca.MX(ca.DM(omega)), 1.0, tp, gamma) * ca.DM(width)
    return hs / 4.0 * ca.sqrt(2.0 * density / ca.sum1(density))


def phases(seed: Any, count: int) -> Any:
    """Uniform random phases, rad, shape (count,), from an integer seed 0 <= seed < 2^31; symbolic.

    The k-th number of a multiplicative generator is known in closed form, start * multiplier^k mod modulus; all
    products stay below 2^30 and are thus exact in double precision. The fifth power, a permutation modulo each of the
    three primes, keeps seas of successive seeds from being shifted copies of each other.
    """
    total: Any = 0.0
    for multiplier, modulus in zip(MULTIPLIERS, MODULI, strict=True):
        x = 1 + ca.fmod(seed, modulus - 1)
        square = ca.fmod(x * x, modulus)
        start = ca.fmod(ca.fmod(square * square, modulus) * x, modulus)
        powers = [float(pow(multiplier, k, modulus)) for k in range(1, count + 1)]
        total += ca.fmod(start * ca.DM(powers), modulus) / modulus
    return 2.0 * ca.pi * ca.fmod(total, 1.0)


def dispersion(omega: Any, depth: float, gravity: float) -> Any:
    """Wave number, 1/m, of one wave, by ten Newton steps from a close approximation; symbolic."""
    target = omega**2 * depth / gravity
    # Eckart (1952), within 5 %.
    x = target / ca.sqrt(ca.tanh(target))
    for _ in range(10):
        t = ca.tanh(x)
        x = x - (x * t - target) / (t + x * (1.0 - t * t))
    return x / depth


def depth_profiles(k: Any, z: float, depth: float) -> tuple[Any, Any]:
    """cosh k(z + h) / sinh k h and sinh k(z + h) / sinh k h, free of overflow; symbolic."""
    rise, mirror = ca.exp(k * z), ca.exp(-k * (z + 2.0 * depth))
    scale = 1.0 - ca.exp(-2.0 * k * depth)
    return (rise + mirror) / scale, (rise - mirror) / scale
