"""The rotor component as an FMU: first sample, agreement with Python, saved state, outputs held between samples."""

from __future__ import annotations

import numpy as np
import pytest

from fmus_src.aero.sections import SAMPLE_TIME
from fmus_src.equations import Equations

from .aero_rotor import STEP, TILTED, Run, first_sample, settings
from .loaded import Loaded


def swaying(t: float) -> dict[str, float]:
    """Inputs at time t, everything moving."""
    return {
        "rotor.azimuth": 1.2 * t + 0.3,
        "servo.pitch[1]": 0.1 + 0.02 * np.sin(3 * t),
        "hub.velocity[1]": 0.8 * np.cos(2 * t),
        "blade2.deflection[1]": 3.0 + 0.5 * np.sin(2 * t),
        "blade2.deflection_rate[1]": np.cos(2 * t),
        "platform.velocity[1]": 0.2 * np.cos(t),
        "tower.deflection[1]": 0.4,
        "tower.deflection_rate[3]": 0.3 * np.sin(t),
    }


ALL_ON = {"tower_influence": True, "tower_drag": True}


def test_fmu_agrees_with_its_python_definition_from_the_start(aero_fmu: Loaded, aero: Equations) -> None:
    """The first sample is taken with the inputs at the end of initialisation, whatever was read and set before."""
    given = settings(wind=13.0, speed=1.2, shear=0.2, axes=TILTED, **ALL_ON)
    slave = aero_fmu.instance()
    slave.setupExperiment(startTime=0.0)
    slave.setBoolean(aero_fmu.vr("tower_influence", "tower_drag"), [True, True])
    reals = {k: v for k, v in given.items() if k not in ALL_ON}
    slave.setReal(aero_fmu.vr(*reals), list(reals.values()))
    names = [v.name for v in aero_fmu.description.modelVariables if v.causality == "output"]
    slave.enterInitializationMode()
    seen = []
    for t in (2.0, 0.0):
        slave.setReal(aero_fmu.vr(*swaying(t)), list(swaying(t).values()))
        seen.append(slave.getReal(aero_fmu.vr(*names)))
        twin = first_sample(aero, given | swaying(t)).outputs()
        # The same operations; the rounding of library functions and sums differs.
        assert seen[-1] == pytest.approx([twin[n] for n in names], rel=1e-9, abs=1e-6)
    slave.exitInitializationMode()
    assert slave.getReal(aero_fmu.vr(*names)) == seen[1]
    i = first_sample(aero, given | swaying(0.0))
    for n in range(1, 25):
        slave.setReal(aero_fmu.vr(*swaying(n * STEP)), list(swaying(n * STEP).values()))
        slave.doStep((n - 1) * STEP, STEP)
        i.set(swaying(n * STEP))
        i.do_step(STEP)
    ours = i.outputs()
    assert slave.getReal(aero_fmu.vr(*names)) == pytest.approx([ours[n] for n in names], rel=1e-9, abs=1e-6)
    assert SAMPLE_TIME == STEP
    slave.freeInstance()


def test_state_saved_in_mid_run_holds_wake_and_stall(aero_fmu: Loaded) -> None:
    run = Run(aero_fmu, settings(wind=14.0, speed=1.2, shear=0.2, axes=TILTED, pitch=0.1))

    def advance() -> list[float]:
        first = run.samples
        for _ in range(30):
            run.set(swaying(run.samples * STEP))
            run.sample(turning=False)
        run.samples = first
        return list(run.outputs().values())

    advance()
    run.samples += 30
    state = run.slave.getFMUstate()
    stored = run.slave.serializeFMUstate(state)
    expected = advance()
    run.slave.setFMUstate(state)
    assert advance() == expected
    other = Run(aero_fmu, settings(wind=14.0, speed=1.2, shear=0.2, axes=TILTED, pitch=0.1))
    other.slave.setFMUstate(other.slave.deSerializeFMUstate(stored))
    run, other.samples = other, run.samples
    assert advance() == expected


def test_outputs_hold_between_samples_and_do_not_depend_on_the_inputs_now(aero_fmu: Loaded) -> None:
    run = Run(aero_fmu, settings(wind=14.0, speed=1.2, shear=0.2))
    run.settle(0.1)
    before = run.outputs()
    run.set({"hub.velocity[1]": 3.0})
    run.slave.doStep(0.1, 0.5 * STEP)
    assert run.outputs() == before
    run.slave.doStep(0.1 + 0.5 * STEP, 0.5 * STEP)
    assert run.outputs()["thrust"] < before["thrust"] - 1e4
    names = aero_fmu.vr("thrust", "moment[2]", "blade1.modal_force[1]")
    assert run.slave.getDirectionalDerivative(names, aero_fmu.vr("hub.velocity[1]"), [1.0]) == [0.0, 0.0, 0.0]
    assert all(not u.dependencies for u in aero_fmu.description.outputs)
    listed = {v.name.split("[")[0] for v in aero_fmu.description.modelVariables}
    assert not listed & {"flow", "separated", "started"}
