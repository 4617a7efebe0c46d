"""`fowt run --monolithic`: the same run with its components as one FMU."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cosim.cli.monolithic import as_one
from cosim.cli.run import Prepared
from cosim.errors import CosimError
from cosim.fmu import read_fmu
from cosim.recording import Channel
from cosim.run import RunSettings, simulate
from cosim.system import ComponentInstance, Connection, StartValue, System
from fmus_src.component import Component
from fmus_src.library import build_library
from tests.conftest import Outcome
from tests.cosim_fmus import carried, mass, two_masses


@pytest.fixture(scope="module")
def dampers() -> System:
    """One damper pushes another along: its force, in kN/t, is the other's acceleration."""
    tmd = build_library(["tmd"])[1]["tmd"]
    first = {"initial_displacement": StartValue(0.5), "c": StartValue(0.0)}
    parts = (ComponentInstance("first", tmd, first), ComponentInstance("second", tmd))
    wire = Connection("first", "force[1]", "second", "attachment.specific_force[1]", 1e-3, 0.1, convert_units=False)
    return System("dampers", parts, (wire,))


def test_results_are_those_of_the_coupled_run(dampers: System, tmp_path: Path) -> None:
    """Same channels, names, patterns and parameters; a connected input shows what feeds it where it is that value."""
    channels = (Channel("x", "first.displacement", "m"), Channel("gone", "third.displacement"))
    settings = RunSettings(stop=2.0, step=1e-3, channels=channels, record=("second.*", "first.force[1]"))
    prepared = Prepared("two", dampers, settings, 1e-3)
    one = as_one(prepared, quiet=True)
    results = [simulate(p.system, p.settings, tmp_path / p.label) for p in (prepared, one)]
    coupled, composed = (r.frame() for r in results)
    assert list(composed.columns) == [c for c in coupled.columns if c != "second.attachment.specific_force[1]"]
    assert "second.displacement" in composed
    for name in composed:
        # The coupled second damper sees the force interpolated linearly: second order in steps of 1 ms.
        np.testing.assert_allclose(
            composed[name], coupled[name], rtol=0, atol=2e-6 * max(1.0, coupled[name].abs().max())
        )
    assert composed["x"].iloc[-1] == pytest.approx(0.5 * np.cos(2.0 * np.sqrt(6302.0 / 20000.0)), rel=1e-9)
    said = json.loads((tmp_path / one.label / "run.json").read_text())
    assert said["settings"]["about"]["monolithic"] is True
    assert said["components"]["monolith"]["start"]["first.initial_displacement"] == 0.5
    assert as_one(prepared, quiet=True).system.components[0].fmu == one.system.components[0].fmu


def test_foreign_fmus_are_refused(built: Callable[[Component], Path], dampers: System) -> None:
    """Their equations are not at hand, nor are those of an own component that was built otherwise."""
    settings = RunSettings(stop=1.0)
    foreign = Prepared("two", two_masses(built(mass()), built(carried())), settings, 0.1)
    with pytest.raises(CosimError, match=r"structure: .*mass\.fmu is not this package's own build of 'mass'"):
        as_one(foreign, quiet=True)
    from fmus_src.tmd.model import component

    other = component()
    other.internal_step = 1e-3
    swapped = (dampers.components[0], ComponentInstance("second", built(other)))
    assert read_fmu(built(other)).guid != read_fmu(dampers.components[0].fmu).guid
    with pytest.raises(CosimError, match=r"second: .*tmd\.fmu is not this package's own build of 'tmd'"):
        as_one(Prepared("two", System("dampers", swapped), settings, 0.1), quiet=True)


def test_command_runs_a_case_as_one_fmu(fowt: Callable[..., Outcome], tmp_path: Path) -> None:
    words = ("run", "decay5-simplified", "--damper", "mtmd", "--until", "2", "--format", "json")
    coupled, composed = (json.loads(fowt(*words, *more).out) for more in ((), ("--monolithic",)))
    assert composed["folder"].endswith("decay5-simplified-mtmd-monolithic")
    assert composed["summary"].keys() == coupled["summary"].keys()
    for name, values in coupled["summary"].items():
        assert composed["summary"][name]["std"] == pytest.approx(values["std"], rel=1e-6)
    refused = fowt(*words, "--monolithic", "--algorithm", "jacobi")
    assert refused.code == 1
    assert "--algorithm is for coupled components" in refused.err
