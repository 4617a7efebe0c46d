"""Results in other tools' formats: independent readers find the same names, units and values."""

from __future__ import annotations

import dataclasses
import json
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.io import loadmat

import cases
from cosim.errors import CosimError
from cosim.formats import convert, format_names, history
from cosim.formats.history import open_history, openfast_unit
from cosim.formats.mat import matlab_names, write_mat
from cosim.formats.outb import HALF_RANGE, scaling
from cosim.recording import Recorder, read_channels, read_results
from cosim.verification.reference import fmi_unit, read_history

from .conftest import Outcome

Array = npt.NDArray[np.float64]
STEP = 0.05
# OpenFAST's units of the channels that we name as it does (OutListParameters.xlsx of OpenFAST v3 to v5).
OPENFAST_UNITS = {
    "PtfmSurge": "m", "PtfmSway": "m", "PtfmHeave": "m", "PtfmRoll": "deg", "PtfmPitch": "deg", "PtfmYaw": "deg",
    "TTDspFA": "m", "TTDspSS": "m", "TwrBsFxt": "kN", "TwrBsMxt": "kN-m", "TwrBsMyt": "kN-m", "YawBrMyp": "kN-m",
    "RootMxc1": "kN-m", "RootMyc1": "kN-m", "OoPDefl1": "m", "IPDefl1": "m", "RotSpeed": "rpm", "GenSpeed": "rpm",
    "GenTq": "kN-m", "GenPwr": "kW", "BldPitch1": "deg", "RotThrust": "kN", "RotTorq": "kN-m", "RtAeroFxh": "N",
    "Wind1VelX": "m/s", "Wave1Elev": "m", "NStC1_XQ": "m", "NStC1_XQD": "m/s", "SStC1_XQ": "m", "SStC1_XQD": "m/s",
}  # fmt: skip


def record(
    folder: Path, channels: Mapping[str, tuple[str, Array]], *, close: bool = True, time: Array | None = None
) -> Path:
    """A run's folder as the recorder leaves it; not closed: as a run leaves it that was killed."""
    folder.mkdir(parents=True)
    about: list[Any] = [SimpleNamespace(name=n, unit=u, description=f"about {n}") for n, (u, _) in channels.items()]
    recorder = Recorder(folder, about, 0.0)
    rows = len(next(iter(channels.values()))[1])
    times = STEP * np.arange(rows) if time is None else time
    for part in np.array_split(np.column_stack([times, *(v for _, v in channels.values())]), 3):
        recorder.add(part)
        recorder._flush()
    if close:
        recorder.close()
    return folder


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """Channels of usual and awkward kinds: an offset far larger than the range, constant, long name, indices."""
    t = STEP * np.arange(400)
    noise = np.random.default_rng(1).standard_normal(400)
    return record(tmp_path / "run", {
        "PtfmPitch": ("deg", 1.9 + 2.5 * np.sin(0.5 * t) + 0.1 * noise),
        "TwrBsMyt": ("kN.m", 7.7e4 * noise),
        "offset": ("m/s2", 1e7 + noise),
        "constant": ("1", np.full(400, 9.80665)),
        "zero": ("N.m.s/rad", np.zeros(400)),
        "barge.platform.position[1]": ("m", 1e-9 * noise),
        "barge.platform.matrix[1,2]": ("kg.m2", noise),
    })  # fmt: skip


def outb_tolerance(values: Array) -> float:
    """Half of one of 2^16 - 2 steps over the range, the range's widening by 2^-22 of the magnitude included."""
    return float(np.ptp(values) / 131_000 + 2e-12 * np.abs(values).max())


def test_csv_has_units_in_its_header_and_every_digit(run: Path) -> None:
    (path,) = convert(run, ["csv"])
    read, ours = pd.read_csv(path, float_precision="round_trip"), read_results(run)
    assert list(read.columns)[:4] == ["Time_[s]", "PtfmPitch_[deg]", "TwrBsMyt_[kN-m]", "offset_[m/s^2]"]
    assert list(read.columns)[-1] == "barge.platform.matrix[1,2]_[kg-m^2]"
    np.testing.assert_array_equal(read.to_numpy(), ours.reset_index().to_numpy())
    again = read_history(path)  # `fowt verify --against` reads it too, with the units
    np.testing.assert_allclose(again.values("TwrBsMyt", "N.m"), 1e3 * ours["TwrBsMyt"].to_numpy(), rtol=1e-12)


def test_mat_holds_what_was_recorded(run: Path) -> None:
    (path,) = convert(run, ["mat"])
    read, ours = loadmat(path, simplify_cells=True), read_results(run)
    columns = ["Time", *ours.columns]
    assert list(read["names"].values()) == columns
    for field, name in read["names"].items():
        expected = ours.index.to_numpy() if name == "Time" else ours[name].to_numpy()
        np.testing.assert_array_equal(read["channels"][field], expected)
    assert read["units"]["TwrBsMyt"] == "kN-m"
    assert read["units"]["barge_platform_matrix_1_2"] == "kg-m^2"
    assert read["descriptions"]["barge_platform_position_1"] == "about barge.platform.position[1]"
    assert loadmat(path)["channels"]["Time"][0, 0].shape == (400, 1)  # a column, as MATLAB plots it


def test_outb_is_what_openfast_readers_read(run: Path) -> None:
    reader = pytest.importorskip("openfast_io.FAST_output_reader")
    (path,) = convert(run, ["outb"])
    file, ours = reader.FASTOutputFile(str(path)), read_results(run)
    assert file.info["attribute_names"] == ["Time", *ours.columns]
    assert file.info["attribute_units"] == ["s", "deg", "kN-m", "m/s^2", "-", "N-m-s/rad", "m", "kg-m^2"]
    np.testing.assert_allclose(file.data[:, 0], ours.index.to_numpy(), rtol=1e-14)
    for k, name in enumerate(ours.columns):
        values = ours[name].to_numpy()
        assert np.abs(file.data[:, k + 1] - values).max() <= outb_tolerance(values), name


def test_outb_and_csv_open_in_weio_as_in_pydatview(run: Path) -> None:
    """weio's reader is pyDatView's and openfast_toolbox's; by its own unit convention both files have one header."""
    weio = pytest.importorskip("weio")
    ours = read_results(run)
    binary, text = (weio.read(str(path)).toDataFrame() for path in convert(run, ["outb", "csv"]))
    assert list(binary.columns)[:3] == ["Time_[s]", "PtfmPitch_[deg]", "TwrBsMyt_[kN-m]"]
    assert len(text) == len(binary) == 400
    for k, name in enumerate(ours.columns):
        values = ours[name].to_numpy()
        assert np.abs(binary.iloc[:, k + 1].to_numpy() - values).max() <= outb_tolerance(values), name


finite = st.floats(-1e29, 1e29, allow_nan=False)


@given(st.lists(finite, min_size=1, max_size=5))
def test_outb_integers_never_overflow_and_keep_the_stated_error(values: list[float]) -> None:
    """Whatever a channel's offset and range: in single precision a large offset alone can exceed the 16 bits."""
    x = np.array(values)
    scale, offset = scaling(np.array([x.min()]), np.array([x.max()]))
    packed = np.rint(x * scale + offset)
    assert np.abs(packed).max() <= HALF_RANGE
    # below 1e-30 a range is not resolved: single precision has no larger scale
    assert np.abs((packed - offset) / scale - x).max() <= outb_tolerance(x) + 1e-30


def test_shipped_channels_have_the_units_that_openfast_prints() -> None:
    """A moment in kN-m in one file and N-m in another of the same channel would go unnoticed in a plot."""
    folder = Path(cases.__path__[0])
    channels = [c for name in ("channels", "channels-simplified") for c in read_channels(folder / f"{name}.toml")]
    assert {c.name: openfast_unit(str(c.unit)) for c in channels} == OPENFAST_UNITS


@pytest.mark.parametrize("unit", ["kN.m", "deg/s2", "kg.m2", "N.m.s/rad", "m", "1", "rpm", "N/(m/s)2", "kW"])
def test_units_come_back_as_they_went(unit: str) -> None:
    assert fmi_unit(f"({openfast_unit(unit)})") == unit


def test_a_broken_off_run_is_converted_as_far_as_it_got(tmp_path: Path) -> None:
    values = np.sin(np.arange(30.0))
    folder = record(tmp_path / "killed", {"x": ("m", values)}, close=False)
    assert not (folder / "results.parquet").exists()
    csv, mat = convert(folder, ["csv", "mat"])
    np.testing.assert_array_equal(pd.read_csv(csv, float_precision="round_trip")["x_[m]"], values)
    np.testing.assert_array_equal(loadmat(mat, simplify_cells=True)["channels"]["x"], values)


def test_batches_leave_no_seam(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = [path.read_bytes() for path in convert(run, ["csv", "outb"], run / "whole")]
    monkeypatch.setattr(history, "BATCH", 7)
    assert [path.read_bytes() for path in convert(run, ["csv", "outb"], run / "pieces")] == whole


def test_what_is_no_number_is_kept_or_refused(tmp_path: Path) -> None:
    values = np.array([1.0, np.nan, np.inf, -np.inf])
    with np.errstate(invalid="ignore"):  # of the recorder's statistics
        folder = record(tmp_path / "run", {"x": ("m", values)})
    csv, mat = convert(folder, ["csv", "mat"])
    np.testing.assert_array_equal(pd.read_csv(csv)["x_[m]"], values)
    np.testing.assert_array_equal(loadmat(mat, simplify_cells=True)["channels"]["x"], values)
    with pytest.raises(
        CosimError, match=r"results\.outb: x is nan at 0\.05 s, which \.outb cannot hold; use csv or mat"
    ):
        convert(folder, ["outb"])
    assert sorted(p.name for p in folder.iterdir()) == ["results.csv", "results.mat", "results.parquet"]


def test_refusals_name_the_file_and_the_remedy(tmp_path: Path, run: Path) -> None:
    uneven = record(tmp_path / "uneven", {"x": ("m", np.arange(4.0))}, time=np.array([0.0, 0.1, 0.25, 0.3]))
    damaged = tmp_path / "damaged"
    damaged.mkdir()
    (damaged / "results.parquet").write_bytes((run / "results.parquet").read_bytes()[:-200])
    killed = record(tmp_path / "killed", {"x": ("m", np.array([]))}, close=False)
    empty = record(tmp_path / "empty", {"x": ("m", np.array([]))})
    for call, words in (
        (lambda: convert(uneven, ["outb"]), r"times are not equidistant near 0\.25 s, as \.outb needs; use csv or mat"),
        (lambda: convert(tmp_path / "none", ["csv"]), r"none: no such folder; give that of a run"),
        (lambda: convert(tmp_path, ["csv"]), r"no readable results"),
        (lambda: convert(damaged, ["csv"]), r"damaged: no readable results"),
        (lambda: convert(killed, ["csv"]), r"killed: no readable results"),
        (lambda: convert(empty, ["csv"]), r"empty: its results have no rows; the run broke off before its first"),
        (lambda: convert(run, ["cvs"]), r"no format 'cvs'; did you mean 'csv'\?"),
        (lambda: format_names("parquet,xls", "--also"), r"--also parquet,xls: no format 'xls'; there are 'csv', "),
        (lambda: format_names(" , ", "--to"), r"--to names no format; there are 'csv', 'mat', 'outb'"),
    ):
        with pytest.raises(CosimError, match=words) as refused:
            call()
        assert "\n" not in str(refused.value)


def test_more_than_a_matlab_variable_holds_is_refused_unread(run: Path, tmp_path: Path) -> None:
    large = dataclasses.replace(open_history(run), rows=2**28)
    with pytest.raises(CosimError, match=r"17\.2 GB are more than .* \(2 GB\); record fewer channels, or read results"):
        write_mat(large, tmp_path / "large.mat")


@pytest.mark.skipif(sys.platform == "win32", reason="needs a file size limit of the operating system")
@pytest.mark.parametrize("name", ["csv", "mat", "outb"])
def test_a_full_disk_leaves_the_former_file(run: Path, name: str) -> None:
    import resource

    (path,) = convert(run, [name])
    before, files = path.read_bytes(), sorted(run.iterdir())
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (1024, hard))
        with pytest.raises(
            CosimError, match=rf"results\.{name}: writing failed: .*; choose another folder, or free space"
        ):
            convert(run, [name])
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert path.read_bytes() == before
    assert sorted(run.iterdir()) == files


@given(st.lists(st.text(max_size=80), max_size=6))
def test_matlab_names_are_names_and_differ(names: Sequence[str]) -> None:
    found = matlab_names(names)
    assert len(set(found)) == len(names)
    assert all(re.fullmatch(r"[A-Za-z][A-Za-z0-9_]{0,62}", name) for name in found)


def test_matlab_names_stay_readable() -> None:
    long = "a" * 70
    found = matlab_names(["Time", "barge.hub[1]", "barge.hub_1", "der(x)", "1st", long, long])
    assert found == ("Time", "barge_hub_1", "barge_hub_1_2", "der_x", "x1st", "a" * 63, "a" * 61 + "_2")


def test_commands_write_every_format(fowt: Callable[..., Outcome], tmp_path: Path) -> None:
    refused = fowt("run", "decay5-simplified", "--also", "csv,out")
    assert refused.code == 1
    assert "--also csv,out: no format 'out'; did you mean 'outb'?" in refused.err
    assert not (tmp_path / "runs").exists()  # nothing was run
    words = ("decay5-simplified", "--damper", "mtmd", "--until", "20", "--format", "json")
    ran = json.loads(fowt("run", *words, "--also", "parquet,csv,mat,outb", "--out", "study/one").out)
    assert [Path(f).name for f in ran["files"]] == ["results.csv", "results.mat", "results.outb"]
    ours = read_results(tmp_path / "study/one")
    text = pd.read_csv(tmp_path / "study/one/results.csv", index_col=0, float_precision="round_trip")
    np.testing.assert_array_equal(text.to_numpy(), ours.to_numpy())
    assert "case decay5-simplified, damper mtmd" in loadmat(tmp_path / "study/one/results.mat")["about"][0]
    assert fowt("run", *words, "--out", "study/two").code == 0
    done = json.loads(fowt("convert", "study", "--to", "outb", "--out", "sent", "--format", "json").out)
    assert not done["failed"]
    assert sorted(p.name for p in (tmp_path / "sent").iterdir()) == ["one.outb", "two.outb"]
    assert (tmp_path / "sent/two.outb").read_bytes() == (tmp_path / "study/one/results.outb").read_bytes()
    again = fowt("convert", "study", "--to", "outb", "--out", "sent")
    assert again.code == 1
    assert "one.outb: exists; choose another --out (nothing is overwritten)" in again.err


def test_one_damaged_run_does_not_keep_the_others(fowt: Callable[..., Outcome], tmp_path: Path, run: Path) -> None:
    broken = tmp_path / "study/runs/broken"
    broken.mkdir(parents=True)
    (broken / "results.parquet").write_text("torn")
    run.rename(tmp_path / "study/runs/whole")
    outcome = fowt("convert", "study", "--to", "csv")
    assert outcome.code == 1
    assert "1 of 2 runs converted to csv" in outcome.out
    assert re.search(r"error: study/runs/broken: no readable results", outcome.err)
    assert (tmp_path / "study/runs/whole/results.csv").is_file()
