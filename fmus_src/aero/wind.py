"""Undisturbed wind at the points where the rotor and the tower meet it."""

from __future__ import annotations

from typing import Any

import casadi as ca

from fmus_src.aero.stations import each, either
from fmus_src.component import Component

#: Below it the power law is not continued, m.
LEAST_HEIGHT = 0.1


def wind_at(c: Component, points: Any, reference: float) -> Any:
    """Wind at the points, global frame, m/s, (3, n): the box in `wind_file`, or steady wind if none is named.

    Args:
        points: global frame, m, (3, n). reference: height of the steady wind's speed, m.
    """
    file = c.string_parameter(
        "wind_file", description="TurbSim .bts file (resources/ is searched first); empty: steady wind"
    )
    speed = c.parameter("wind_speed", 8.0, unit="m/s", description=f"steady wind at {reference:g} m", tunable=True)
    shear = c.parameter("shear_exponent", 0.2, min=0.0, max=1.0, description="power-law exponent of the steady wind")
    turbulent, loaded = c.field("box", file, points.T)

    def steady(point: Any, speed: Any, shear: Any) -> list[Any]:
        height = ca.fmax(point[2], LEAST_HEIGHT)
        return [ca.vertcat(speed * ca.exp(shear * ca.log(height / reference)), 0.0, 0.0)]

    return either(
        "wind", loaded, (turbulent.T, points, speed, shear),
        lambda turbulent, points, speed, shear: turbulent,
        lambda turbulent, points, speed, shear: each("power_law", steady, points, speed, shear)[0],
    )  # fmt: skip
