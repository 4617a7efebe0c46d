"""A coupled system as its dampers see it: response to a force on each damper's rail, from records of a few runs.

Structural modification by receptances (Mottershead and Ram, Mech. Syst. Signal Process. 20 (2006) 1293-1308): the
displacements per unit of force of the system as it is, measured, give those of the system with other springs and
dashpots, exactly and without a model of it. Here the system is measured with its dampers' masses held still and with
each mass in turn moved as prescribed, everything else (wind, sea, controller) alike. To first order

    y = y0 + G_ys s,    a = a0 + G_as s,    (s^2 M + s C + K) s = -M a + u

with responses y, specific forces a along the rails, relative displacements s, masses M, forces u on the masses.
All is evaluated along a line of the Laplace plane, p = sigma + i omega, sigma > 0: the transform of a record of finite
length times exp(-sigma t) has no leakage, even where the structure hardly damps, since all runs start from the same
state (Hall and Beck, Earthquake Eng. Struct. Dyn. 21 (1993) 1019-1042, who solve equations of motion so).
"""

from __future__ import annotations

import json
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
import scipy.fft

Array = npt.NDArray[np.float64]
Complex = npt.NDArray[np.complexfloating[Any, Any]]

DECAYS = 3.0  # sigma times the record's length
PADDING = 2  # record and zeros, in lengths of the record: what wraps around is less by exp(-PADDING * DECAYS)
NEARBY = 8  # bins to either side over which a gain is fitted


@dataclass(frozen=True)
class Damper:
    """A damper as the runs had it.

    Attributes:
        name: of the component, such as "nacelle_damper". mass: kg.
        displacement, acceleration: columns of the records: relative displacement, m, and specific force of the
            attachment along the rail, m/s2.
    """

    name: str
    mass: float
    displacement: str
    acceleration: str


@dataclass(frozen=True)
class LinearModel:
    """Linear response of one scenario (case, seed, parameters) at F points of the Laplace plane.

    Attributes:
        label: of the scenario; `about` says what it was made from.
        channels, units: of the responses, (C,). dampers: (D,).
        p: sigma + 2 pi i k / (length step), (F,), rad/s, k = 0, 1, ...
        base: transforms of channels and specific forces along the rails with the masses held, (F, C + D): of a
            record x_j they are sum_j x_j exp(-p j step).
        gain: of the same per relative displacement of each mass, (F, C + D, D).
        rest: variance beyond the highest frequency, which the dampers leave as it is, (C,).
        step, length: of the record, s and instants, zeros at its end included; statistics: from `start` to `stop`, s.
    """

    label: str
    channels: tuple[str, ...]
    units: tuple[str, ...]
    dampers: tuple[Damper, ...]
    p: Complex
    base: Complex
    gain: Complex
    rest: Array
    step: float
    length: int
    start: float
    stop: float
    about: Mapping[str, Any] = field(default_factory=dict)

    @property
    def frequencies(self) -> Array:
        """Hz, (F,)."""
        return np.asarray(self.p.imag / (2.0 * np.pi), dtype=float)

    @property
    def masses(self) -> Array:
        """Of the dampers, kg, (D,)."""
        return np.array([d.mass for d in self.dampers])

    def histories(self, transforms: Complex) -> Array:
        """Histories within the statistics' window of transforms (..., F), as densely as the highest frequency needs.

        Returns:
            (..., instants).
        """
        coarse = 2 * transforms.shape[-1]
        step = self.step * self.length / coarse
        time = step * np.arange(coarse)
        shown = (time >= self.start - 1e-9) & (time <= self.stop + 1e-9)
        whole = scipy.fft.irfft(transforms, coarse, axis=-1) * (coarse / self.length)
        result: Array = whole[..., shown] * np.exp(self.p[0].real * time[shown])
        return result

    def save(self, path: Path) -> Path:
        """Write to a .npz file; returns its path."""
        words = {name: getattr(self, name) for name in _WORDS} | {
            "dampers": [vars(d) for d in self.dampers], "about": dict(self.about)
        }  # fmt: skip
        partial = path.with_name(path.name + ".partial")
        with partial.open("wb") as stream:
            arrays = {name: getattr(self, name) for name in _ARRAYS}
            np.savez_compressed(stream, words=np.array(json.dumps(words)), **arrays)
        partial.replace(path)
        return path

    @classmethod
    def load(cls, path: Path) -> LinearModel:
        """Read what `save` has written.

        Raises:
            ValueError: the file is none of these, or cannot be read.
        """
        try:
            with np.load(path, allow_pickle=False) as file:
                words = json.loads(str(file["words"]))
                arrays = {name: file[name] for name in _ARRAYS}
            words |= {n: tuple(words[n]) for n in ("channels", "units")}
            words["dampers"] = tuple(Damper(**d) for d in words["dampers"])
            return cls(**words, **arrays)
        except (OSError, EOFError, KeyError, TypeError, ValueError, zipfile.BadZipFile) as error:
            reason = " ".join(str(error).split())
            raise ValueError(f"{path}: no linear model ({reason}); write one with 'fowt linearise'") from error


_WORDS = ("label", "channels", "units", "step", "length", "start", "stop")
_ARRAYS = ("p", "base", "gain", "rest")


def estimate(
    held: pd.DataFrame,
    shaken: Sequence[pd.DataFrame],
    channels: Sequence[str],
    dampers: Sequence[Damper],
    *,
    label: str,
    highest: float,
    transient: float = 30.0,
    units: Sequence[str] | None = None,
    about: Mapping[str, Any] | None = None,
) -> LinearModel:
    """Linear model of one scenario.

    Args:
        held: record with the masses held at their rails' centres, indexed by time, s, evenly, from 0.
        shaken: one record for each damper, in the same wind and sea, in which its mass alone was moved.
        highest: frequency up to which the masses were moved, Hz.
        transient: time left out of the statistics, s.

    Raises:
        ValueError: the records differ in time or lack a column, or a mass was not moved.
    """
    names = [*channels, *(d.acceleration for d in dampers)]
    time = _common_time([held, *shaken], names)
    step = float(time[1] - time[0])
    length = PADDING * len(time)
    count = int(highest * length * step) + 1
    p = DECAYS / float(time[-1]) + 2j * np.pi * np.arange(count) / (length * step)
    fading = np.exp(-p[0].real * time)[:, None]

    def transform(record: pd.DataFrame) -> Complex:
        result: Complex = np.fft.rfft(record.to_numpy() * fading, length, axis=0)[:count]
        return result

    base = transform(held[names])
    gains = []
    for record, damper in zip(shaken, dampers, strict=True):
        motion = transform(record[[damper.displacement]])
        if not np.any(np.abs(motion) > 0.0):
            raise ValueError(f"'{damper.displacement}' rests in the record that is to move it: give it an amplitude")
        change = transform(record[names] - held[names])
        gains.append(_gain(change, motion[:, 0]))
    model = LinearModel(
        label, tuple(channels), tuple(units or ("",) * len(channels)), tuple(dampers), p, base,
        np.stack(gains, axis=-1), np.zeros(len(channels)), step, length, transient, float(time[-1]), dict(about or {}),
    )  # fmt: skip
    in_band = model.histories(base[:, : len(channels)].T).var(axis=-1)
    full = held[list(channels)].to_numpy()[time >= transient - 1e-9].var(axis=0)
    return replace(model, rest=np.maximum(full - in_band, 0.0))


@dataclass(frozen=True)
class Mode:
    """A mode that a damper drives: frequency, Hz, damping ratio, and the damper's mass by the mode's at its place.

    The structure's alone: without the damper, whose mass the measured system holds.
    """

    frequency: float
    damping: float
    mass_ratio: float


def fit_mode(model: LinearModel, damper: int, low: float, high: float) -> Mode:
    """The one mode between two frequencies, Hz, from the specific force along a rail per displacement of its mass.

    Near a mode G_as = R / (p^2 + 2 zeta w p + w^2) + const. A mass m held on a structure of modal mass M moves it by
    G_as = -m / (M + m) p^4 / (p^2 + ...) there, so that m / (M + m) = -R / w^4; gravity along the tilting rail is in R.
    """
    index = len(model.channels) + damper
    band = (model.frequencies >= low) & (model.frequencies <= high)
    if np.count_nonzero(band) < 6:
        raise ValueError(f"'{model.label}': {low:g} to {high:g} Hz holds too few points to fit a mode; widen it")
    p, gain = model.p[band], model.gain[band, index, damper]
    scale = 2.0 * np.pi * 0.5 * (low + high)
    q = p / scale
    # gain (q^2 + a1 q + a0) = b2 q^2 + b1 q + b0, repeated with each point weighted by the last denominator
    weight = np.ones(len(q))
    for _ in range(8):
        columns = np.stack([gain * q, gain, -(q**2), -q, -np.ones_like(q)], axis=1) * weight[:, None]
        right = -gain * q**2 * weight
        both = np.concatenate([columns.real, columns.imag]), np.concatenate([right.real, right.imag])
        a1, a0, b2, _, b0 = np.linalg.lstsq(*both, rcond=None)[0]
        weight = 1.0 / np.abs(q**2 + a1 * q + a0)
    if not a0 > 0.0:
        raise ValueError(f"'{model.label}': no mode between {low:g} and {high:g} Hz; choose another band")
    root = np.sqrt(a0)
    residue = float(b0 - b2 * a0) * scale**2  # real part of the numerator less its constant, at the mode
    share = min(max(-residue / (root * scale) ** 4, 1e-9), 0.9)
    ratio = share / (1.0 - share)
    grown = np.sqrt(1.0 + ratio)
    return Mode(float(root * scale * grown / (2.0 * np.pi)), float(a1 / (2.0 * root) * grown), float(ratio))


def _gain(response: Complex, motion: Complex) -> Complex:
    """Response (F, m) per motion (F,) at each frequency, by local rational models.

    Over the nearby bins the gain is taken as (b0 + b1 r + b2 r^2) / (1 + d r), by least squares (McKelvey and Guerin,
    IFAC SYSID 2012): a mean over bins, against what is not linear in the records, that does not flatten resonances.
    """
    count, reach = len(motion), min(NEARBY, (len(motion) - 1) // 2)
    first = np.clip(np.arange(count) - reach, 0, count - 2 * reach - 1)
    bins = first[:, None] + np.arange(2 * reach + 1)
    r = (bins - np.arange(count)[:, None]) / reach
    u = motion[bins]
    gain = np.empty_like(response)
    for column in range(response.shape[1]):
        y = response[bins, column]
        scale = np.abs(y).mean(axis=1, keepdims=True) + 1e-300
        y, size = y / scale, np.abs(u).mean(axis=1, keepdims=True) + 1e-300
        v = u / size
        regressors = np.stack([v, r * v, r**2 * v, -r * y], axis=-1)
        adjoint = np.swapaxes(regressors.conj(), 1, 2)
        normal = adjoint @ regressors + 1e-9 * np.eye(4)
        gain[:, column] = np.linalg.solve(normal, adjoint @ y[..., None])[:, 0, 0] * (scale / size)[:, 0]
    return gain


def _common_time(records: Sequence[pd.DataFrame], names: Sequence[str]) -> Array:
    time = np.asarray(records[0].index, dtype=float)
    for record in records:
        if len(record) != len(time) or not np.allclose(record.index, time, atol=1e-9):
            raise ValueError("the held and the shaken record differ in time: run them with the same end and step")
        for name in names:
            if name not in record:
                raise ValueError(f"the record has no column '{name}': record it in every run")
    if len(time) < 16 or not np.allclose(np.diff(time), time[1] - time[0], rtol=1e-6):
        raise ValueError("the records need at least 16 evenly spaced instants")
    return time
