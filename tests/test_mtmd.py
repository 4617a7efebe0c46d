"""Several dampers in one component are the same dampers."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from fmus_src.instance import simulate
from fmus_src.mtmd.model import component as mtmd
from fmus_src.tmd.model import component as tmd

UNITS: list[dict[str, Any]] = [
    {"m": 20_000.0, "k": 7653.0, "c": 4013.0, "stroke": 8.0, "initial_displacement": 7.9},
    {"m": 200_000.0, "k": 52_597.0, "c": 11_911.0, "stroke": 18.0, "initial_displacement": -2.0},
]


def motion(unit: int, t: float) -> dict[str, float]:
    return {
        "attachment.specific_force[1]": (unit + 1) * np.cos(0.5 * t) - 1.5,
        "attachment.specific_force[3]": 9.8 + 0.1 * unit * t,
        "attachment.angular_velocity[2]": 0.05 * (unit + 1) * np.sin(0.5 * t),
        "attachment.angular_acceleration[3]": 0.01 * t,
    }


def test_two_units_are_two_dampers() -> None:
    both = simulate(
        mtmd(), stop=2.0, step=0.05,
        parameters={f"unit{i + 1}.initial_displacement": UNITS[i]["initial_displacement"] for i in range(2)},
        inputs=lambda t: {f"unit{i + 1}.{n}": v for i in range(2) for n, v in motion(i, t).items()},
    )  # fmt: skip
    for i, parameters in enumerate(UNITS):
        alone = simulate(tmd(), stop=2.0, step=0.05, parameters=parameters, inputs=lambda t, i=i: motion(i, t))
        for name in alone.columns:
            # the same operations in the same order, but for the compiler's freedom to reorder sums
            expected = pytest.approx(alone[name].to_numpy(), rel=1e-12, abs=1e-9)
            assert both[f"unit{i + 1}.{name}"].to_numpy() == expected
        assert np.ptp(alone["displacement"]) > 0.2


def test_any_number_of_units() -> None:
    assert [v.name for v in mtmd(3).groups["state"].variables][-1] == "unit3.velocity"
    with pytest.raises(ValueError, match="give one or more"):
        mtmd(0)
