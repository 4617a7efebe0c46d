"""Exported wind fields: agreement with Python, state, broken files."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from fmus_src.aero.turbsim_file import WindBox, write_box
from fmus_src.component import Component
from fmus_src.instance import Instance

from .loaded import Loaded, refusal


def wind_probe() -> Component:
    c = Component("wind_probe", "Wind speed at a point")
    file = c.string_parameter("file", description="a wind file")
    height = c.parameter("height", 50.0, unit="m", description="height of the point")
    velocity, loaded = c.field("wind", file, ca.horzcat(0, 0, height))
    c.output("u", velocity[0, 0], unit="m/s", description="downwind speed")
    c.output("loaded", loaded, description="whether a file is loaded")
    return c


@pytest.fixture
def wind_file(tmp_path: Path) -> Path:
    """Rows at 40 and 60 m whose speeds change with height and time; tower points far off the grid's."""
    velocity = np.zeros((50, 2, 2, 3), dtype=np.float32)
    velocity[:, 0, :, 0] = 8.0 + np.sin(np.arange(50))[:, None]
    velocity[:, 1, :, 0] = 10.0
    write_box(
        WindBox(
            velocity=velocity, dt=0.1, dy=20.0, dz=20.0, z_bottom=40.0, hub_height=50.0, mean_speed=9.0,
            periodic=True, tower=np.full((50, 2, 3), 3.0, dtype=np.float32),
        ),
        tmp_path / "wind.bts",
    )  # fmt: skip
    return tmp_path / "wind.bts"


def test_state_brings_its_wind_file_to_a_new_instance(
    built: Callable[[Component], Path], tmp_path: Path, wind_file: Path
) -> None:
    """FMI allows fmi2SetFMUstate right after fmi2Instantiate, in another process: the file is part of the state."""
    fmu = Loaded(built(wind_probe()), tmp_path / "fmu")
    slave = fmu.instance()
    slave.setupExperiment(startTime=0.0)
    slave.setString(fmu.vr("file"), [str(wind_file)])
    slave.enterInitializationMode()
    slave.exitInitializationMode()
    slave.doStep(0.0, 0.25)
    expected = slave.getReal(fmu.vr("u", "loaded"))
    assert expected[1] == 1.0
    stored = slave.serializeFMUstate(slave.getFMUstate())
    other = fmu.instance()
    restored = other.deSerializeFMUstate(stored)
    other.setFMUstate(restored)
    assert other.getReal(fmu.vr("u", "loaded")) == expected
    other.doStep(0.25, 0.25)
    slave.doStep(0.25, 0.25)
    assert other.getReal(fmu.vr("u")) == slave.getReal(fmu.vr("u"))
    foreign = bytes(stored).replace(fmu.description.guid.encode(), b"{" + b"0" * 36 + b"}")
    assert "no state of this FMU" in refusal(fmu, lambda: other.deSerializeFMUstate(foreign))
    slave.freeInstance()
    other.freeInstance()


@pytest.mark.parametrize("height", [30.0, 47.0])
def test_wind_box_agrees_with_python_below_the_grid_too(
    built: Callable[[Component], Path], tmp_path: Path, wind_file: Path, height: float
) -> None:
    fmu = Loaded(built(wind_probe()), tmp_path / "fmu")
    twin = Instance(wind_probe())
    twin.set({"file": str(wind_file), "height": height})
    twin.initialise()
    slave = fmu.instance()
    slave.setupExperiment(startTime=0.0)
    slave.setString(fmu.vr("file"), [str(wind_file)])
    slave.setReal(fmu.vr("height"), [height])
    slave.enterInitializationMode()
    slave.exitInitializationMode()
    # Python holds the velocities as 32-bit numbers: 10 m/s to 1e-6.
    assert slave.getReal(fmu.vr("u")) == pytest.approx([twin.get("u")], abs=2e-6)
    slave.freeInstance()
    with pytest.raises(KeyError):
        twin.set({"flie": str(wind_file)})


def test_wind_file_with_an_absurd_time_step_is_read_within_its_bounds(
    built: Callable[[Component], Path], tmp_path: Path, wind_file: Path
) -> None:
    """dt = 1e-36 s puts the present 1e36 steps ahead; the sample is still one of the repeating box."""
    data = bytearray(wind_file.read_bytes())
    data[26:30] = np.float32(1e-36).tobytes()
    wind_file.write_bytes(data)
    fmu = Loaded(built(wind_probe()), tmp_path / "fmu")
    slave = fmu.instance()
    slave.setupExperiment(startTime=0.0)
    slave.setString(fmu.vr("file"), [str(wind_file)])
    slave.enterInitializationMode()
    slave.exitInitializationMode()
    for i in range(20):
        slave.doStep(1.7 * i, 1.7)
        assert 8.4 < slave.getReal(fmu.vr("u"))[0] < 9.6  # half of (8 +- 1) m/s and 10 m/s
    slave.freeInstance()
