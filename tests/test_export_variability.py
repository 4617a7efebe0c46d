"""What the model description says of how outputs change: at sample instants only, or all the time."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import fmpy
import fmpy.validation
import numpy as np

from fmus_src.component import Component


def component() -> Component:
    c = Component("variability", "Outputs of every dependency", sample_time=0.1)
    gain = c.parameter("gain", 2.0, description="a parameter")
    twice = c.calculated("twice", 2 * gain, description="a calculated parameter")
    u = c.input("u", description="an input")
    x = c.state("x", description="a state")
    z = c.sampled_state("z", description="a sampled state")
    curve = np.linspace(0.0, 1.0, 3)[None, :, None]
    of_z, of_x = (c.table(f"of_{n}", curve, 0.0, 1.0, [0], v)[0, 0] for n, v in (("z", z), ("x", x)))
    kept, moving = (c.intermediate(f"through_{n}", gain * v) for n, v in (("z", of_z), ("x", of_x)))
    c.derivative(x, u)
    c.update(z, x)
    for name, value in {
        "sampled": z, "looked_up": of_z, "through_lookups": kept, "constant": twice,
        "time": c.time, "state": x, "input": z + u, "state_looked_up": of_x, "state_through_lookups": moving,
    }.items():  # fmt: skip
        c.output(f"y.{name}", value, description="an output")
    return c


def test_outputs_of_sampled_states_and_parameters_alone_are_discrete(
    built: Callable[[Component], Path],
) -> None:
    """Through lookups too; what time, a state or an input moves is continuous."""
    path = built(component())
    assert fmpy.validation.validate_fmu(str(path)) == []
    variables = fmpy.read_model_description(str(path)).modelVariables
    found = {v.name[2:]: v.variability for v in variables if v.causality == "output"}
    discrete = {"sampled", "looked_up", "through_lookups", "constant"}
    assert found == {name: "discrete" if name in discrete else "continuous" for name in found}
    assert len(found) == 9
    assert {v.variability for v in variables if v.name in ("x", "z")} == {"continuous", "discrete"}
