"""End stops of dampers in a linear model: the force of each contact, and what all of them add to the motion.

A stop's force f on a mass (eq. 6 of Wang et al. 2022) is one more drive of the linear system

    (p^2 M + p C + K + M G_as) s = -M a0 + f,        s(t) = s_free(t) + sum_j int h_j(t - u) f_j(u) du,

with the response h to an impulse on each mass. Stops act rarely and briefly, so that f is found instant by instant only
while a mass is beyond its stroke: within an instant f depends on its own effect on the speed, which is solved for.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.fft

from optimisation.receptance import LinearModel

Array = npt.NDArray[np.float64]
Complex = npt.NDArray[np.complexfloating[Any, Any]]

INSTANT = 0.05  # s: half of it changes standard deviations by 1e-3, the stops' damping ends a motion in 0.04 s
MEMORY = 120.0  # s for which an impulse is felt at least: twice that changes standard deviations by 1e-3
DECAYS = 3.0  # time constants of a mass on its own spring and dashpot for which it is felt, if that is longer
PLAUSIBLE = 10.0  # strokes that a mass may travel, on the softest of stops
EDGE = 0.2  # share of the band over which what the structure adds to an impulse's response fades out
FAR = 1e9  # m: stroke without stops
BLOCK = 4000  # instants looked through at a time


@dataclass(frozen=True)
class Stops:
    """End stops of one or many dampers: travel, m, stiffness, N/m, and damping while moving out, N s/m."""

    stroke: Array
    stiffness: Array
    damping: Array


def with_impacts(model: LinearModel, free: Complex, stiffness: Array, damping: Array, stops: Stops) -> Complex:
    """Transforms of the dampers' displacements with their stops, (D, F); nan if the contacts grow without bound.

    That befalls masses on soft springs that lean on a stop, since the structure's answer is known in a band only.

    Args:
        free: transforms without stops, (D, F).
        stiffness, damping: of the dampers, (D,); stops: of (D,).
    """
    if np.all(stops.stroke >= FAR):
        return free
    whole = model.step * model.length
    count = scipy.fft.next_fast_len(max(2, round(whole / INSTANT)), real=True)
    step = whole / count
    time = step * np.arange(min(count, int(model.stop / step) + 1))
    fading = np.exp(model.p[0].real * time)

    def history(transform: Complex) -> Array:
        full = scipy.fft.irfft(transform, count, axis=-1)[..., : len(time)]
        return np.asarray(full * (count / model.length) * fading)

    s, v = history(free), history(free * model.p)
    if not np.any(np.abs(s) > stops.stroke[:, None]):
        return free
    felt = max(MEMORY, DECAYS / max(_slowest_decay(model.masses, stiffness, damping), 1e-9))
    memory = min(len(time), round(felt / step))
    position, speed = _impulse_responses(model, stiffness, damping, count, memory)
    with np.errstate(over="ignore", invalid="ignore"):  # of contacts that grow
        _march(s, v, step * position, step * speed, stops)
    if not np.all(np.abs(s) <= PLAUSIBLE * stops.stroke[:, None]):
        return np.full_like(free, np.nan)
    faded = scipy.fft.rfft(s / fading, count, axis=-1)[:, : len(model.p)]
    return np.asarray(faded * (model.length / count))


def _slowest_decay(mass: Array, stiffness: Array, damping: Array) -> float:
    """Slowest rate at which the motion of a mass alone dies away, 1/s."""
    return min(-_own_rates(*own)[0].real for own in zip(mass, stiffness, damping, strict=True))


def _own_rates(mass: float, stiffness: float, damping: float) -> tuple[complex, complex, complex]:
    """Rates of the two parts of a mass' motion on its own spring and dashpot, the slower first, and half of their
    difference, 1/s."""
    decay, square = damping / (2.0 * mass), stiffness / mass
    root = np.sqrt(complex(decay**2 - square)) or 1e-9j  # imaginary if it swings
    slow = -square / (decay + root) if root.real > 0.0 else root - decay  # no difference of near equals
    return complex(slow), complex(-(decay + root)), complex(root)


def _march(s: Array, v: Array, position: Array, speed: Array, stops: Stops) -> None:
    """Add the stops' contacts to displacements and velocities, (D, N), in place.

    Args:
        position, speed: responses of each mass to a force of 1 N on each for an instant, (D, D, memory).
    """
    last, memory = s.shape[1], position.shape[2]
    at = 0
    while at < last:
        beyond = np.any(np.abs(s[:, at : at + BLOCK]) > stops.stroke[:, None], axis=0)
        first = int(np.argmax(beyond))
        if not beyond[first]:
            at += BLOCK
            continue
        at += first
        end = min(last, at + memory)
        for d in np.flatnonzero(np.abs(s[:, at]) > stops.stroke):
            # half of its own instant's force has acted by now
            own = 0.5 * speed[d, d, 0]
            f = _contact_force(s[d, at], v[d, at], own, stops.stroke[d], stops.stiffness[d], stops.damping[d])
            v[:, at] += 0.5 * speed[:, d, 0] * f
            s[:, at + 1 : end] += position[:, d, 1 : end - at] * f
            v[:, at + 1 : end] += speed[:, d, 1 : end - at] * f
        at += 1


def _contact_force(s: float, v: float, own: float, stroke: float, stiffness: float, damping: float) -> float:
    """Eq. 6 with v = (speed without this force) + own f: damping acts only while the mass moves outward."""
    side = 1.0 if s > 0.0 else -1.0
    spring = -stiffness * (s - side * stroke)
    damped = (spring - damping * v) / (1.0 + damping * own)
    return float(damped if side * (v + own * damped) > 0.0 else spring)


def _impulse_responses(
    model: LinearModel, stiffness: Array, damping: Array, count: int, memory: int
) -> tuple[Array, Array]:
    """Displacements, m, and velocities, m/s, of each mass after 1 N s on each, (D, D, memory).

    A mass alone on its spring answers in closed form at once; the structure, within the model's band, adds the rest.
    """
    mass, p = model.masses, model.p
    number, step = len(mass), model.step * model.length / count
    time = step * np.arange(memory)
    own = mass[:, None] * p**2 + damping[:, None] * p + stiffness[:, None]
    driven = mass[:, None] * model.gain[:, len(model.channels) :]
    diagonal = np.eye(number)
    whole = np.linalg.inv(driven + diagonal * own.T[:, :, None])
    added = np.moveaxis(whole - diagonal / own.T[:, :, None], 0, -1)
    share = np.clip((model.frequencies / model.frequencies[-1] - 1.0 + EDGE) / EDGE, 0.0, 1.0)
    added = added * (0.5 + 0.5 * np.cos(np.pi * share))
    growing = np.exp(p[0].real * time) / step
    position = scipy.fft.irfft(added, count, axis=-1)[..., :memory] * growing
    speed = scipy.fft.irfft(added * p, count, axis=-1)[..., :memory] * growing
    for d in range(number):
        slow, fast, root = _own_rates(mass[d], stiffness[d], damping[d])
        both = np.exp(slow * time), np.exp(fast * time)
        position[d, d] += ((both[0] - both[1]) / (2.0 * root)).real / mass[d]
        speed[d, d] += ((slow * both[0] - fast * both[1]) / (2.0 * root)).real / mass[d]
    return position, speed
