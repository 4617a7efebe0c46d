"""Identification of the simplified model: derivatives, known answers, identifiability, the coupled model's decays."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from cosim.case import case_folder
from cosim.cli.identify import Simplified
from cosim.ssp import read_parameters
from cosim.verification.reference import Record
from fmus_src.instance import simulate
from fmus_src.sensitivity import Sensitivity
from optimisation.identification import UNKNOWNS, Decay, IdentificationError, Model, identify

from .conftest import Outcome

NAMES = [u.name for u in UNKNOWNS]
TRUE = dict(zip(NAMES, (2.3e9, 2.1e9, 5.5e7, 3.6e9, 1.55e10, 3.5e7), strict=True))
SPACING, SECONDS = 0.05, 40.0


@cache
def model() -> Model:
    return Simplified.make().model()


@cache
def synthetic(damper: str, degrees: float) -> Decay:
    """A decay of the simplified model itself."""
    time = np.arange(0.0, SECONDS + SPACING / 2, SPACING)
    channels = {"PtfmPitch": degrees * np.cos(0.5 * time), "TTDspFA": 1e-3 * time**2}  # but for the start, of no matter
    draft = Simplified.make().decay(Record("synthetic", time, channels, {}), damper)
    return Decay(damper, SPACING, model()(draft, TRUE, False)[0], draft.settings)


@pytest.mark.parametrize(("damper", "stops", "tolerance"), [("none", 0, 1e-6), ("mtmd", 2, 1e-3)])
def test_derivatives_are_those_of_finite_differences(damper: str, stops: int, tolerance: float) -> None:
    """Central differences; 1e-5 of a value turns the tower's mode by a milliradian, so they err by some 1e-7.

    Across end stops the differences suffer from the integration's error at the damper's stiff contact, 1e-4; without
    the jump of the sensitivities at contact the derivatives would be off by 0.2 and more.
    """
    decay = synthetic(damper, 10.0)
    _, slopes = model()(decay, TRUE, True)
    stroke = _nacelle_stroke(decay)
    assert np.count_nonzero(np.diff((stroke > 8.0).astype(int)) == 1) >= stops
    for i, name in enumerate(NAMES):
        step = 1e-5 * TRUE[name]
        ahead, behind = (model()(decay, TRUE | {name: TRUE[name] + s}, False)[0] for s in (step, -step))
        expected = (ahead - behind) / (2.0 * step)
        off = np.abs(slopes[:, :, i] - expected).max(axis=0) / np.abs(expected).max(axis=0)
        assert np.all(off < tolerance), name


def test_trajectory_is_that_of_the_component_in_process() -> None:
    decay = synthetic("mtmd", 10.0)
    own = simulate(Simplified.make().equations, stop=5.0, step=SPACING, parameters={**decay.settings, **TRUE})
    # the same algorithm; only the order of floating-point operations differs
    assert decay.values[: len(own), 0] == pytest.approx(np.degrees(own["platform_pitch"].to_numpy()), abs=1e-9)
    assert decay.values[: len(own), 1] == pytest.approx(own["tower_top_displacement"].to_numpy(), abs=1e-10)


def test_known_parameters_are_recovered_from_the_papers_first_guesses() -> None:
    found = identify(model(), [synthetic("none", 5.0), synthetic("mtmd", 10.0)])
    assert found.identifiable
    for name, value in TRUE.items():
        assert found.values[name] == pytest.approx(value, rel=1e-6)


def test_without_a_damper_the_common_scale_is_not_fixed() -> None:
    """Only gravity, which does not scale, tells one scale from another: a fiftieth of the stiffness."""
    alone = identify(model(), [synthetic("none", 5.0)], start=TRUE)
    assert not alone.identifiable
    assert "common scale is not fixed" in alone.weakness
    assert alone.weak_direction == pytest.approx(np.full(6, alone.weak_direction.mean()), rel=0.6)
    anchored = identify(model(), [synthetic("none", 5.0), synthetic("mtmd", 10.0)], start=TRUE)
    assert anchored.singular_values[-1] > 10.0 * alone.singular_values[-1]


def test_standard_errors_of_white_noise_are_the_classical_ones() -> None:
    decay, sigma = synthetic("mtmd", 10.0), np.array([0.05, 0.01])
    noise = sigma * np.random.default_rng(1).standard_normal(decay.values.shape)
    noisy = Decay("noisy", SPACING, decay.values + noise, decay.settings)
    found = identify(model(), [noisy], start=TRUE)
    weighted = model()(noisy, found.values, True)[1] * np.array(list(found.values.values())) / noisy.scale[:, None]
    # ordinary least squares with unequal noise in the channels: A^-1 M A^-1
    a = np.einsum("tci,tcj->ij", weighted, weighted)
    m = np.einsum("tci,tcj,c->ij", weighted, weighted, (sigma / noisy.scale) ** 2)
    classical = np.sqrt(np.diag(np.linalg.inv(a) @ m @ np.linalg.inv(a)))
    errors = np.array(list(found.standard_errors.values()))
    # the estimate averages some 2 * 40 s / 25 s independent stretches: right to a factor of two
    assert np.all((errors / classical > 0.4) & (errors / classical < 2.0))
    off = np.array([found.values[n] / TRUE[n] - 1.0 for n in NAMES])
    assert np.all(np.abs(off) < 4.0 * classical)


def test_a_start_that_diverges_is_named() -> None:
    with pytest.raises(IdentificationError, match=r"diverges from I_p = "):
        identify(model(), [synthetic("none", 5.0)], start=TRUE | {"I_p": 1e3})


def test_shipped_set_is_what_the_command_finds_and_predicts_what_the_papers_does_not(
    fowt: Callable[..., Outcome],
) -> None:
    ran = fowt("identify", "--format", "json", "--out", "found")
    assert ran.code == 0, ran.err
    found = json.loads(ran.out)
    shipped = {n: float(v.value) for n, v in read_parameters(case_folder() / "identified.ssv").items()}
    assert set(shipped) == set(NAMES)
    for name, value in shipped.items():
        assert found["unknowns"][name]["value"] == pytest.approx(value, abs=found["unknowns"][name]["standard_error"])
    assert found["identifiable"]
    last = found["records"][-1]
    assert last["record"] == "decay10-mtmd"
    for channel in ("PtfmPitch", "TTDspFA"):
        assert last["R2"][channel] > 0.98
        assert abs(last["R2_paper"][channel]) < 0.3  # as good as a straight line: its period is 7 % too long
    own = {n: float(v.value) for n, v in read_parameters(Path("found/identified.ssv")).items()}
    assert own == pytest.approx({n: u["value"] for n, u in found["unknowns"].items()}, rel=1e-5)
    assert Path("found/identify.png").stat().st_size > 10_000


def test_papers_set_is_table_3() -> None:
    paper = {n: float(v.value) for n, v in read_parameters(case_folder() / "paper.ssv").items()}
    assert paper == {u.name: u.paper for u in UNKNOWNS}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t, p, x: {"Time": t, "PtfmPitch": p}, "no channel 'TTDspFA'"),
        (lambda t, p, x: {"Time": t[:200], "PtfmPitch": p[:200], "TTDspFA": x[:200]}, "too short"),
        (lambda t, p, x: {"Time": t, "PtfmPitch": np.where(t == t[99], np.nan, p), "TTDspFA": x}, "not a finite"),
        (lambda t, p, x: {"Time": t[9:], "PtfmPitch": p[9:], "TTDspFA": x[9:]}, "does not begin at rest"),
        (lambda t, p, x: {"Time": t**1.01, "PtfmPitch": p, "TTDspFA": x}, "equally spaced"),
        (lambda t, p, x: {"Time": 10 * t, "PtfmPitch": p, "TTDspFA": x}, "too coarse"),
        (lambda t, p, x: {"Time": t, "PtfmPitch": p, "TTDspFA": 0 * x}, "TTDspFA does not move"),
    ],
)
def test_a_record_that_cannot_be_used_gets_one_line(
    fowt: Callable[..., Outcome], change: Callable[..., dict[str, np.ndarray]], message: str
) -> None:
    decay = synthetic("none", 5.0)
    time = SPACING * np.arange(len(decay.values))
    columns = change(time, *decay.values.T)
    np.savetxt(
        "record.csv", np.column_stack(list(columns.values())), delimiter=",", header=",".join(columns), comments=""
    )
    ended = fowt("identify", "--reference", "record.csv")
    assert ended.code == 1
    assert message in ended.err
    assert ended.err.count("\n") == 1


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--reference", "missing.csv"), "no such file"),
        (("--reference", "decay6"), "did you mean 'decay5'"),
        (("--damper", "tmd-q"), "no damper arrangement 'tmd-q'"),
        (("--set", "I_p=1e9"), "it is identified"),
        (("--set", "hub=90"), "no parameter 'hub'"),
    ],
)
def test_a_mistake_in_the_words_gets_one_line(
    fowt: Callable[..., Outcome], words: tuple[str, ...], message: str
) -> None:
    ended = fowt("identify", *words)
    assert ended.code == 1
    assert message in ended.err


def _nacelle_stroke(decay: Decay) -> np.ndarray:
    observer = Sensitivity(Simplified.make().equations, NAMES, ["nacelle_damper.relative_displacement"])
    values, _ = observer.trajectory({**decay.settings, **TRUE}, samples=801, spacing=SPACING, derivatives=False)
    return np.abs(values[:, 0])
