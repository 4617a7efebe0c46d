"""Several tuned mass dampers in one component: the paper's MTMD, a nacelle and a platform damper, or any number."""

from __future__ import annotations

from typing import Any

from fmus_src.component import Component
from fmus_src.tmd.model import declare_unit


def component(units: int = 2) -> Component:
    """N independent damper units, `unit1.`, `unit2.`, ..., each with an attachment and equations of its own.

    Defaults are the MTMD of Wang et al. (2022), table 4: unit 1 in the nacelle, unit 2 in the platform; further units
    are copies of unit 1, to be given their own values as parameters.

    Raises:
        ValueError: fewer than one unit.
    """
    if units < 1:
        raise ValueError(f"mtmd: {units} damper units asked for; give one or more")
    nacelle: dict[str, Any] = {"mass": 20_000.0, "stiffness": 7653.0, "damping": 4013.0, "stroke": 8.0}
    platform: dict[str, Any] = {"mass": 200_000.0, "stiffness": 52_597.0, "damping": 11_911.0, "stroke": 18.0}
    c = Component("mtmd", f"{units} tuned mass dampers, each moving along its body's x axis, with end stops")
    for i in range(1, units + 1):
        declare_unit(c, f"unit{i}.", **(platform if i == 2 else nacelle))
    return c
