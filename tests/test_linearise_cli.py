"""`fowt linearise`: from a load case to a model on file, and misuse."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from optimisation.receptance import LinearModel
from optimisation.spectral import SpectralResponse


def test_a_case_becomes_a_model_once(fowt: Callable[..., Any], tmp_path: Path) -> None:
    words = ("linearise", "lc1", "--until", "90", "--channels", "PtfmPitch,TTDspFA", "--format", "json")
    done = fowt(*words)
    assert done.code == 0, done.err
    row = json.loads(done.out)["models"][0]
    file = tmp_path / "linear" / "linear-lc1-seed1.npz"
    model = LinearModel.load(file)
    assert model.channels == ("PtfmPitch", "TTDspFA")
    assert model.masses.tolist() == [20_000.0, 200_000.0]
    assert (tmp_path / row["picture"]).exists()
    # from the same springs and dashpots, without stops: less pitch than with the masses held
    response = SpectralResponse([model], ["nacelle_damper.k", "nacelle_damper.c"],
                                {"platform_damper.k": 52_597.0, "platform_damper.c": 11_911.0})  # fmt: skip
    assert response(np.array([[7653.0, 4013.0]]))[0, 0, 0] < row["channels"]["PtfmPitch"]["held"]

    tuned = fowt("optimise", "mtmd", "--objective", "spectral", "--models", "linear", "--relative-to", "mtmd",
                 "--method", "cma-es", "--evaluations", "300", "--aggregate", "mean", "--format", "json")  # fmt: skip
    assert tuned.code == 0, tuned.err
    assert json.loads(tuned.out)["fitness"] < 1.0  # better than table 4 in these 90 s

    before = file.stat().st_mtime_ns
    again = fowt(*words)
    assert again.code == 0, again.err
    assert file.stat().st_mtime_ns == before
    other = fowt(*words, "--set", "hydro.Hs=3")
    assert other.code == 1
    assert "other settings or components; choose another folder with --out" in other.err


def test_misuse(fowt: Callable[..., Any]) -> None:
    for words, message in (
        (("lc1", "--damper", "none"), "has no dampers to move"),
        (("lc1", "--seeds", "a"), "--seeds a: 'a' is no seed; write whole numbers from 0"),
        (("lc1", "--vary", "barge.gravity=1,2"), "write 3 rising numbers"),
        (("lc1", "--channels", "Pitch"), "has no channel 'Pitch'"),
        (("lc1", "--mode", "0.2"), "write 2 rising numbers"),
    ):
        outcome = fowt("linearise", *words)
        assert outcome.code == 1, outcome.err
        assert message in " ".join(outcome.err.split())
