"""TurbSim full-field files: round trip, refusal of damaged files, frozen-turbulence sampling."""

from __future__ import annotations

import struct
import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fmus_src.aero.turbsim_file import WindBox, WindRangeError, check_box, read_box, write_box

Change = Callable[[bytes], bytes]
HEADER_SIZE = struct.calcsize("<h4i6f6fi")


def small_box(*, periodic: bool = False, n_tower: int = 0, nt: int = 41) -> WindBox:
    rng = np.random.default_rng(3)
    return WindBox(
        velocity=rng.normal([12.0, 0.0, 0.0], [2.0, 1.5, 1.0], size=(nt, 4, 5, 3)).astype(np.float32),
        dt=0.25,
        dy=8.0,
        dz=10.0,
        z_bottom=20.0,
        hub_height=35.0,
        mean_speed=12.0,
        periodic=periodic,
        tower=rng.normal(6.0, 1.0, size=(nt, n_tower, 3)).astype(np.float32),
        description="a test box",
    )


@pytest.mark.parametrize(("periodic", "n_tower"), [(False, 0), (True, 0), (False, 2)])
def test_round_trip_loses_half_a_quantisation_step(tmp_path: Path, periodic: bool, n_tower: int) -> None:
    box = small_box(periodic=periodic, n_tower=n_tower)
    write_box(box, tmp_path / "wind.bts")
    back = read_box(tmp_path / "wind.bts")
    everything = np.concatenate([box.velocity.reshape(-1, 3), box.tower.reshape(-1, 3)])
    # 1 %: 32-bit arithmetic when unpacking, as in InflowWind.
    bound = 1.01 * 0.5 * np.ptp(everything, axis=0) / 65535
    assert (np.abs(back.velocity - box.velocity) <= bound).all()
    assert (np.abs(back.tower - box.tower) <= bound).all()
    assert back.periodic == periodic
    assert back.description == "a test box"
    for name in ("dt", "dy", "dz", "z_bottom", "hub_height", "mean_speed"):
        assert getattr(back, name) == pytest.approx(getattr(box, name), rel=1e-7)  # stored as 32-bit


def test_rewriting_a_file_keeps_every_stored_number(tmp_path: Path) -> None:
    write_box(small_box(), tmp_path / "a.bts")
    once = read_box(tmp_path / "a.bts")
    write_box(once, tmp_path / "b.bts")
    again = read_box(tmp_path / "b.bts")
    # One unit in the last place of the 32-bit offset (about 4e4, so 4e-3 of a quantisation step).
    step = np.ptp(once.velocity, axis=(0, 1, 2)) / 65535
    assert (np.abs(again.velocity - once.velocity) <= 0.02 * step).all()


def test_layout_is_the_one_of_the_turbsim_guide(tmp_path: Path) -> None:
    """Every byte packed by hand after TurbSim User's Guide, appendix D, table D-2."""
    # Two steps, two by two points; value = 1000 step + 100 row + 10 column + component, with unit scale, no
    # offset.
    values = [1000 * t + 100 * k + 10 * j + c for t in (0, 1) for k in (0, 1) for j in (0, 1) for c in (0, 1, 2)]
    data = struct.pack("<h4i", 8, 2, 2, 0, 2) + struct.pack("<6f", 5.0, 7.0, 0.5, 10.0, 30.0, 27.5)
    data += (
        struct.pack("<6f", *(1.0, 0.0) * 3) + struct.pack("<i", 3) + b"abc" + struct.pack(f"<{len(values)}h", *values)
    )
    (tmp_path / "hand.bts").write_bytes(data)
    box = read_box(tmp_path / "hand.bts")
    assert (box.dz, box.dy, box.dt, box.mean_speed, box.hub_height, box.z_bottom) == (
        5.0,
        7.0,
        0.5,
        10.0,
        30.0,
        27.5,
    )
    assert box.periodic
    assert box.velocity[1, 0, 1].tolist() == [1010.0, 1011.0, 1012.0]
    assert box.velocity[0, 1, 0].tolist() == [100.0, 101.0, 102.0]
    assert box.y.tolist() == [-3.5, 3.5]
    assert box.z.tolist() == [27.5, 32.5]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda b: b[:40], "shorter than"),
        (lambda b: b[:-1], "truncated"),
        (lambda b: b + b"\0\0", "truncated or corrupt"),
        (lambda b: struct.pack("<h", 9) + b[2:], "identifier 9"),
        (lambda b: b[:14] + struct.pack("<i", 2**31 - 1) + b[18:], "announces"),
        (lambda b: b[:2] + struct.pack("<2i", 2**30, 2**30) + b[10:], "grid of"),
        (lambda b: b[:26] + struct.pack("<f", float("nan")) + b[30:], "dt is nan"),
        (lambda b: b[:42] + struct.pack("<f", 0.0) + b[46:], "scales"),
        (lambda b: b[:42] + struct.pack("<f", 1e-38) + b[46:], "not finite"),
        (lambda b: b[: HEADER_SIZE - 4] + struct.pack("<i", -5) + b[HEADER_SIZE:], "description of -5"),
    ],
)
def test_damaged_files_are_refused_in_one_line(tmp_path: Path, change: Change, message: str) -> None:
    path = tmp_path / "wind.bts"
    write_box(small_box(), path)
    path.write_bytes(change(path.read_bytes()))
    with pytest.raises(ValueError, match=message) as caught:
        read_box(path)
    assert "wind.bts" in str(caught.value)
    assert "\n" not in str(caught.value)


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(st.tuples(st.integers(0, HEADER_SIZE - 1), st.integers(0, 255)), min_size=1, max_size=12))
def test_any_damaged_header_is_read_or_refused_within_bounded_memory(
    tmp_path: Path, patches: list[tuple[int, int]]
) -> None:
    path = tmp_path / "fuzz.bts"
    if not (tmp_path / "good").exists():
        write_box(small_box(), tmp_path / "good")
    data = bytearray((tmp_path / "good").read_bytes())
    for position, value in patches:
        data[position] = value
    path.write_bytes(data)
    tracemalloc.start()
    try:
        box = read_box(path)
    except ValueError as error:
        refusal = str(error)
    else:
        refusal = "fuzz.bts"
        assert 2 * (box.velocity.size + box.tower.size) <= len(data) - HEADER_SIZE
        assert np.isfinite(box.velocity).all()
        assert np.isfinite(box.tower).all()
    finally:
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    # The file holds 2460 values: unpacking takes a few arrays of that size, whatever the header announces.
    assert peak < 1_000_000
    assert "fuzz.bts" in refusal


def test_sampling_is_exact_for_a_trilinear_field() -> None:
    box = small_box()
    t, z, y = np.meshgrid(np.arange(41) * box.dt, box.z, box.y, indexing="ij")

    def field(t, y, z):  # type: ignore[no-untyped-def]
        return 1.0 + 0.3 * t - 0.02 * y + 0.05 * z + 0.001 * t * y * z

    linear = replace(box, velocity=np.stack([field(t, y, z)] * 3, axis=-1).astype(np.float32))
    points = np.array([[0.0, 0.0, 35.0], [-5.0, 11.3, 21.0], [6.0, -15.9, 49.9], [2.0, 16.0, 50.0]])
    # The front passes x = 0 at t = 0 half a grid width (16 m) late: box time t + (16 - x) / U.
    expected = field(3.1 + (16.0 - points[:, 0]) / 12.0, points[:, 1], points[:, 2])
    assert linear.sample(3.1, points)[:, 0] == pytest.approx(expected, rel=1e-6)  # velocities are 32-bit


def test_turbulence_is_carried_downwind_at_the_mean_speed() -> None:
    box = small_box()
    upwind, downwind = np.array([[-7.2, 3.0, 33.0]]), np.array([[4.8, 3.0, 33.0]])
    # 12 m further downwind the same wind arrives one second later (rounding only).
    assert box.sample(3.0, downwind) == pytest.approx(box.sample(2.0, upwind), rel=1e-9)


def test_periodic_box_repeats_and_starts_at_the_hub() -> None:
    box = small_box(periodic=True)
    hub = np.array([[0.0, 0.0, 35.0]])
    assert box.sample(0.0, hub)[0] == pytest.approx(box.velocity[0, 1:3, 2].mean(axis=0), rel=1e-6)
    for shift in (-1, 1, 5):
        later = box.sample(2.6 + shift * 41 * 0.25, hub)
        assert later == pytest.approx(box.sample(2.6, hub), rel=1e-9)
    # Between the last step and the first again.
    seam = box.sample(40.5 * 0.25, hub)[0]
    assert seam == pytest.approx(box.velocity[[40, 0], 1:3, 2].mean(axis=(0, 1)), rel=1e-6)


def test_below_the_grid() -> None:
    box = small_box(n_tower=2)  # tower points at z = 20 and 10 m
    at = box.sample(0.0, np.array([[16.0, 3.0, 15.0], [16.0, 3.0, 5.0], [16.0, 0.0, -1.0]]))  # box time 0
    assert at[0] == pytest.approx(box.tower[0].mean(axis=0), rel=1e-6)
    assert at[1] == pytest.approx(0.5 * box.tower[0, 1], rel=1e-6)
    assert at[2].tolist() == [0.0, 0.0, 0.0]
    bare = small_box()
    low, lowest_row = bare.sample(0.0, np.array([[16.0, 8.0, 3.0], [16.0, 8.0, 20.0]]))
    assert low == pytest.approx(lowest_row)


@pytest.mark.parametrize(
    ("t", "point", "message"),
    [
        (0.0, (0.0, 16.1, 30.0), r"y = 16.1 m .*\(-16 to 16 m\)"),
        (0.0, (0.0, 0.0, 50.2), r"z = 50.2 m .*\(20 to 50 m\)"),
        (9.0, (0.0, 0.0, 30.0), r"time 9 s .* covers 0 to 10 s"),
        (0.0, (17.0, 0.0, 30.0), "box time -0.08"),
        (float("nan"), (0.0, 0.0, 30.0), "not finite"),
        (0.0, (0.0, float("nan"), 30.0), "y = nan"),
    ],
)
def test_no_wind_is_invented_outside_the_box(t: float, point: tuple[float, float, float], message: str) -> None:
    with pytest.raises(WindRangeError, match=message):
        small_box().sample(t, np.array([point]))


def test_failed_write_leaves_nothing_behind(tmp_path: Path) -> None:
    box = small_box()
    bad = box.velocity.copy()
    bad[3, 2, 1, 0] = np.nan
    with pytest.raises(ValueError, match="not finite"):
        write_box(replace(box, velocity=bad), tmp_path / "wind.bts")
    assert list(tmp_path.iterdir()) == []
    write_box(box, tmp_path / "wind.bts")
    check_box(tmp_path / "wind.bts")
    assert [p.name for p in tmp_path.iterdir()] == ["wind.bts"]
