"""The guide "Bring your own damper", run from top to bottom as it stands."""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

GUIDE = Path(__file__).parent.parent / "docs/own-damper.md"


def test_the_guide_runs(fowt: Callable[..., Any], tmp_path: Path) -> None:
    blocks = re.findall(r"```(python|sh)\n(.*?)```", GUIDE.read_text(), re.S)
    assert [kind for kind, _ in blocks] == ["python", "python", "python", "sh", "sh", "python"]
    names: dict[str, Any] = {}  # of one session, in the folder that `fowt` made the present one
    errors = ""
    for kind, text in blocks:
        if kind == "python":
            exec(compile(text, str(GUIDE), "exec"), names)
            continue
        for line in text.splitlines():
            done = fowt(*shlex.split(line)[1:])
            assert done.code == 0, done.err
            errors += done.err
    # half a period of a pendulum, which lags a mass on a spring by (2 / 36.6)^2 / 16 of it: 6e-4 rad, 2e-7 of 2 m
    assert names["damper"].get("displacement") == pytest.approx(-2.0, abs=1e-5)
    # at the turn the rail carries m g cos(x / R)^2 upwards, and so less than the weight by (2 / 36.6)^2
    assert names["damper"].get("force[3]") == pytest.approx(-200_000 * 9.80665 * (1 - (2 / 36.6) ** 2), rel=1e-5)
    assert "no stroke" in " ".join(errors.split())  # of tmd-p's values, which is said
    runs = [pd.read_parquet(tmp_path / name / "results.parquet") for name in ("rail", "rail-tuned")]
    assert all(run["SStC1_XQ"].abs().max() > 1.0 for run in runs)  # it moves in the barge,
    assert not runs[0].equals(runs[1])  # otherwise with the tuned values
    moved = names["result"]["displacement"]
    # pushed from rest it goes to some 2 a / omega^2 against the push, and comes to rest in the middle after ten periods
    assert -2 * 0.5 * 200_000 / 50_400 < moved.min() < -0.5 * 200_000 / 50_400
    assert abs(moved[-1]) < 0.5 * abs(moved.min())


@pytest.mark.parametrize(("damper", "channel"), [("tlcd-p", "SStC1_XQ"), ("tmdi-n", "NStC1_XQ")])
def test_arrangements_with_other_dampers(
    fowt: Callable[..., Any], tmp_path: Path, damper: str, channel: str
) -> None:  # fmt: skip
    """Their force follows the structure's acceleration: the loop is solved, as iterated steps (1e-7) show."""
    words = ("run", "decay5", "--until", "20", "--damper", damper, "--out")
    assert fowt(*words, "coupled").code == 0
    assert fowt(*words, "iterated", "--algorithm", "iterated").code == 0
    coupled, iterated = (pd.read_parquet(tmp_path / name / "results.parquet") for name in ("coupled", "iterated"))
    assert iterated[channel].abs().max() > 0.5
    for name in (channel, "PtfmPitch", "TTDspFA"):
        # 9e-5 of a standard deviation as found (docs/coupling.md: 4e-5 with mass dampers)
        assert (coupled[name] - iterated[name]).abs().max() < 2e-4 * iterated[name].std()
