"""Databases and seas from files: formats agree with each other, and a bad file says in one line what is wrong."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import casadi as ca
import fmpy
import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest

from fmus_src.equations import derive
from fmus_src.hydro import excitation, given_sea, headings, radiation, waves
from fmus_src.hydro.compute_database import far_field_damping
from fmus_src.hydro.database import HydroDatabase, checked, load, save, warn_of_scale
from fmus_src.hydro.model import component
from fmus_src.hydro.radiation import groups, radiation_model
from fmus_src.instance import Instance
from fmus_src.library import build_variant, make

Array = npt.NDArray[np.float64]
RANK = np.array([1, 1, 1, 2, 2, 2])
COEFFICIENTS = ("added_mass", "added_mass_infinite", "damping", "excitation", "stiffness")


def write_wamit(d: HydroDatabase, root: Path, length: float = 1.0, infinite: bool = True) -> Path:
    """WAMIT's files of a database, non-dimensional as its manual has it (chapter 4), written here on their own."""
    power = np.add.outer(RANK, RANK)
    mass, weight = d.density * length ** (power + 1.0), d.density * d.gravity * length**power
    pairs = [(i, j) for i in range(6) for j in range(6) if np.abs(d.added_mass[:, i, j]).max() > 0.0]
    rows = [f"-1.0 {i + 1} {j + 1} {d.added_mass[0, i, j] / mass[i, j]:.9e}" for i, j in pairs]
    if infinite:
        rows += [f"0.0 {i + 1} {j + 1} {d.added_mass_infinite[i, j] / mass[i, j]:.9e}" for i, j in pairs]
    force = []
    for n, w in reversed(list(enumerate(d.omega))):
        period = f"{2.0 * np.pi / w:.9e}"
        rows += [
            f"{period} {i + 1} {j + 1} {d.added_mass[n, i, j] / mass[i, j]:.9e} "
            f"{d.damping[n, i, j] / mass[i, j] / w:.9e}" for i, j in pairs
        ]  # fmt: skip
        for m, b in enumerate(d.heading):
            for i in range(6):
                x = d.excitation[n, m, i] / (d.density * d.gravity * length ** (RANK[i] + 1.0))
                force.append(
                    f"{period} {np.degrees(b):.6f} {i + 1} {abs(x):.9e} {np.degrees(np.angle(x)):.4f} "
                    f"{x.real:.9e} {x.imag:.9e}"
                )
    stiffness = [f"{i + 1} {j + 1} {d.stiffness[i, j] / weight[i, j]:.9e}" for i in range(6) for j in range(6)]
    for suffix, lines in ((".1", rows), (".3", force), (".hst", stiffness)):
        root.with_name(root.name + suffix).write_text("\n".join(lines) + "\n")
    return root


def every(d: HydroDatabase, step: int) -> HydroDatabase:
    """The database at every step-th frequency."""
    return replace(
        d, omega=d.omega[::step], added_mass=d.added_mass[::step], damping=d.damping[::step],
        excitation=d.excitation[::step],
    )  # fmt: skip


def assert_same(found: HydroDatabase, expected: HydroDatabase, tolerance: float) -> None:
    assert found.omega == pytest.approx(expected.omega, rel=tolerance)
    assert found.heading == pytest.approx(expected.heading, abs=1e-7)
    for key in COEFFICIENTS:
        a, b = getattr(found, key), getattr(expected, key)
        axes = tuple(range(a.ndim - (1 if key == "excitation" else 2)))
        scale = np.maximum(np.abs(b).max(axis=axes), 1e-9 * np.abs(b).max())
        assert (np.abs(a - b) / scale).max() < tolerance, key
    for key in ("volume", "depth", "density", "gravity"):
        assert getattr(found, key) == pytest.approx(getattr(expected, key))


# --- databases --------------------------------------------------------------------------------------------------


def test_json_and_wamit_give_the_same_database(tmp_path: Path) -> None:
    closed = load("closed")
    save(closed, tmp_path / "own.json")
    # Five digits are written, and were read: nothing changes.
    assert_same(load(tmp_path / "own.json"), closed, 1e-12)
    # Another unit length must cancel; nine digits are written.
    write_wamit(closed, tmp_path / "Box", length=20.0)
    for what in ("Box", "Box.1"):
        assert_same(load(tmp_path / what, unit_length=20.0), closed, 1e-7)
    assert load(tmp_path / "Box", volume=5000.0, depth=80.0, unit_length=20.0).volume == 5000.0
    with pytest.raises(ValueError, match=r"own\.json states gravity 9\.80665, not 9\.81; leave the option out"):
        load(tmp_path / "own.json", gravity=9.81)


def test_capytaine_s_own_exports_give_the_same_database(tmp_path: Path) -> None:
    """One dataset in Capytaine's conventions, written by Capytaine as NetCDF and as WAMIT files."""
    cpt = pytest.importorskip("capytaine")
    xr = pytest.importorskip("xarray")
    from capytaine.io.wamit import export_to_wamit

    closed = every(load("closed"), 6)
    dofs = ["Surge", "Sway", "Heave", "Roll", "Pitch", "Yaw"]
    omega = np.r_[closed.omega, np.inf]
    added_mass = np.concatenate([closed.added_mass, closed.added_mass_infinite[None]])
    damping = np.concatenate([closed.damping, np.zeros((1, 6, 6))])
    # exp(-i w t): the conjugate. Nothing is known of the excitation at infinite frequency.
    force = np.conj(np.concatenate([closed.excitation, np.full((1, len(closed.heading), 6), np.nan)]))
    # Capytaine's stiffness holds the weight at the centre of mass, here 3 m above the PRP.
    height = 3.0
    stiffness = (
        closed.stiffness - np.diag([0, 0, 0, 1, 1, 0]) * closed.density * closed.gravity * closed.volume * height
    )
    matrix = ("omega", "influenced_dof", "radiating_dof")
    dataset = xr.Dataset(
        {
            "added_mass": (matrix, added_mass),
            "radiation_damping": (matrix, damping),
            "Froude_Krylov_force": (("omega", "wave_direction", "influenced_dof"), 0.3 * force),
            "diffraction_force": (("omega", "wave_direction", "influenced_dof"), 0.7 * force),
            "excitation_force": (("omega", "wave_direction", "influenced_dof"), force),
            "hydrostatic_stiffness": (("influenced_dof", "radiating_dof"), stiffness),
            "disp_mass": closed.volume * closed.density,
        },
        coords={
            "omega": omega, "influenced_dof": dofs, "radiating_dof": dofs, "wave_direction": closed.heading,
            "rho": closed.density, "g": closed.gravity, "water_depth": closed.depth, "forward_speed": 0.0,
            "center_of_mass": ("space_coordinate", [0.0, 0.0, height]), "period": ("omega", 2.0 * np.pi / omega),
        },
    )  # fmt: skip
    cpt.export_dataset(str(tmp_path / "barge.nc"), dataset.isel(omega=slice(None, None, -1)), format="netcdf")
    assert_same(load(tmp_path / "barge.nc"), closed, 1e-12)
    without_weight = dataset.isel(omega=slice(0, -1))
    without_weight["hydrostatic_stiffness"] = (("influenced_dof", "radiating_dof"), closed.stiffness)
    export_to_wamit(without_weight, str(tmp_path / "wamit"), exports=("1", "3", "hst"))
    exported = load(tmp_path / "wamit")
    # Seven digits are written; the infinite frequency was left out: see the next test.
    assert_same(replace(exported, added_mass_infinite=closed.added_mass_infinite), closed, 2e-6)
    broken = dataset.drop_vars("hydrostatic_stiffness")
    cpt.export_dataset(str(tmp_path / "broken.nc"), broken, format="netcdf")
    with pytest.raises(ValueError, match=r"broken\.nc lacks hydrostatic_stiffness; assemble it with hydrostatics=True"):
        load(tmp_path / "broken.nc")


def test_infinite_frequency_follows_from_the_others(tmp_path: Path) -> None:
    closed = load("closed")
    found = load(write_wamit(closed, tmp_path / "Box", infinite=False))
    scale = np.sqrt(np.multiply.outer(*2 * (closed.added_mass_infinite.diagonal(),)))
    # Ogilvie's relation; to the accuracy to which A and B of two methods are one causal function.
    assert (np.abs(found.added_mass_infinite - closed.added_mass_infinite) / scale).max() < 0.025
    assert "no infinite frequency in the file: A_inf from damping" in found.provenance[-1]


def test_damping_follows_from_the_excitation(tmp_path: Path) -> None:
    # Haskind's relation through the file and back: 36 headings about the circle against the quadrant's integral.
    database = load(write_wamit(load("closed"), tmp_path / "Box"))
    covered = headings.covered(database)
    assert covered.circle
    quadrant = np.radians(np.arange(0.0, 91.0, 3.0))
    sums = [excitation.heading_sum(covered, dof) for dof in range(6)]
    n = int(np.argmin(np.abs(database.omega - 0.8)))
    x = np.array([
        [sum(c * getattr(np, f)(m * b) for (f, m), c in zip(s.terms, s.coefficients[n], strict=True)) for s in sums]
        for b in quadrant
    ])  # fmt: skip
    damping = far_field_damping(x, 0.8)
    # The trapezoidal rule over a period is exact for such sums; five digits were stored.
    assert damping.diagonal() == pytest.approx(database.damping[n].diagonal(), rel=1e-3)


def about(d: HydroDatabase, x: float, y: float) -> HydroDatabase:
    """The same hull's database about a reference point that lies off its middle, which couples everything.

    The hull's middle moves with v + w x (-r), r the offset: velocities there are T times those of the reference point,
    hence matrices T' M T and forces T' X.
    """
    transform = np.eye(6)
    transform[:3, 3:] = -np.array([[0.0, 0.0, -y], [0.0, 0.0, x], [y, -x, 0.0]])
    changed = {
        key: transform.T @ getattr(d, key) @ transform
        for key in ("added_mass", "added_mass_infinite", "damping", "stiffness")
    }
    return replace(d, excitation=d.excitation @ transform, **changed)


@pytest.mark.parametrize(("x", "y", "coupled"), [(5.0, 0.0, [(0, 2, 4), (1, 3, 5)]), (5.0, 3.0, [(0, 1, 2, 3, 4, 5)])])
def test_couplings_of_an_unsymmetric_hull_are_kept(
    x: float, y: float, coupled: list[tuple[int, ...]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    closed = every(load("closed"), 2)
    off = load(write_wamit(about(closed, x, y), tmp_path / "Off"))
    assert groups(off) == coupled
    monkeypatch.setattr(radiation, "POLES", (10,))  # what trying fewer comes to, in a third of the time
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        model = radiation_model(off)
    # Ten poles common to all six modes fit yaw, the weakest, to 8 %; common to three they fit all to 5 %.
    assert max(model.retardation_error.values()) < (0.06 if y == 0.0 else 0.09)
    # Turned back to the hull's middle, the fitted memory is that of the symmetric hull, to the fits' accuracy.
    omega = closed.omega[closed.omega < 1.5]
    found = about(replace(closed, damping=model.response(omega)), -x, -y).damping
    expected = closed.damping[: len(omega)] + 1j * omega[:, None, None] * (
        closed.added_mass[: len(omega)] - closed.added_mass_infinite
    )
    scale = np.sqrt(np.multiply.outer(*2 * (closed.damping.max(axis=0).diagonal(),)))
    assert (np.abs(found - expected) / scale)[:, :5, :5].max() < 0.12
    # It only takes energy.
    real = model.response(np.linspace(0.01, 8.0, 800)).real / scale
    assert np.linalg.eigvalsh((real + np.swapaxes(real, 1, 2)) / 2.0).min() > -1e-9
    # Symmetric fore and aft or to port no more, headings of a quadrant reach no further.
    covered = headings.covered(off)
    assert not covered.circle
    assert np.degrees(covered.angle[[0, -1]]) == pytest.approx([-90.0 if y == 0.0 else 0.0, 90.0])


def test_headings_that_are_not_covered_are_refused() -> None:
    # A hull that is not symmetric fore and aft, and waves from ahead only.
    off = about(every(load("closed"), 4), 5.0, 0.0)
    ahead = replace(off, heading=off.heading[:1], excitation=off.excitation[:, :1])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the fit, to a quarter of the frequencies
        c = component(ahead)
    heading = next(v for v in derive(c).of("parameter") if v.name == "heading")
    assert np.degrees([heading.min, heading.max]) == pytest.approx([-0.01, 0.01])
    assert "covered: 0 deg only" in c.description
    # One heading twice, with different forces.
    twice = replace(off, heading=np.radians([0.0, 360.0]), excitation=off.excitation[:, [0, 3]])
    with pytest.raises(ValueError, match="a heading stands twice"):
        headings.covered(twice)


def test_heading_interpolation_between_uneven_headings() -> None:
    closed = load("closed")
    full = headings.covered(closed)
    some = np.flatnonzero(np.abs(np.degrees(full.angle) - 9.0) > 1.0)
    uneven = headings.covered(replace(closed, heading=full.angle[some], excitation=full.excitation[:, some]))
    b = ca.MX.sym("b")
    total = excitation.heading_sum(uneven, 2)
    weights = ca.Function("weights", [b], [excitation.functions(total.terms, uneven, b)])

    def at(degrees: float) -> npt.NDArray[np.complex128]:
        return np.asarray(total.coefficients @ np.array(weights(np.radians(degrees))).ravel())

    # The excitation itself at every heading, turned round or not; half of each neighbour in between.
    assert at(18.0) == pytest.approx(closed.excitation[:, 2, 2])
    assert at(18.0 - 720.0) == pytest.approx(at(18.0))
    assert at(9.0) == pytest.approx((closed.excitation[:, 0, 2] + closed.excitation[:, 2, 2]) / 2.0)
    assert at(180.0) == pytest.approx(at(-180.0))


def drop(lines: list[str], start: str) -> list[str]:
    at = next(n for n, line in enumerate(lines) if line.startswith(start))
    return lines[:at] + lines[at + 1 :]


PERIOD = f"{2.0 * np.pi / 0.65:.9e}"
BAD: list[tuple[str, Callable[[list[str]], list[str]], str]] = [
    (".1", lambda x: drop(x, f"{PERIOD} 3 3"), r"Box\.1: period 9\.66644 s lacks the pair 3 3"),
    (".1", lambda x: [v for v in x if " 5 1 " not in v], "added mass 15 and 51 differ by .* are both in the file"),
    (".1", lambda x: [*x, x[-1]], "stands twice"),
    (".1", lambda x: [v.replace(" 6 6 ", " 7 7 ") for v in x], "mode 7 is not one of 1 to 6"),
    (".1", lambda x: [*x[:20], "1.0 2 three 4", *x[20:]], r"Box\.1, line 21: needs 4 or 5 numbers"),
    (".3", lambda x: drop(x, f"{PERIOD} 45"), r"Box\.3: period 9\.66644 s, heading 45 deg lacks mode 1"),
    (".hst", lambda x: [v.replace("1 1 0.0", "1 1 9999") for v in x], "stiffness 11 is not zero"),
]


@pytest.mark.parametrize(("suffix", "change", "message"), BAD)
def test_bad_wamit_files(tmp_path: Path, suffix: str, change: Callable[[list[str]], list[str]], message: str) -> None:
    root = write_wamit(every(load("closed"), 4), tmp_path / "Box")
    file = root.with_name(root.name + suffix)
    file.write_text("\n".join(change(file.read_text().splitlines())))
    with pytest.raises(ValueError, match=message) as error:
        load(root)
    assert "\n" not in str(error.value)


def test_bad_databases(tmp_path: Path) -> None:
    closed = load("closed")
    turned = replace(closed, omega=closed.omega[np.r_[0, 2, 1, 3 : len(closed.omega)]])
    for database, message in (
        (turned, r"turned\.json|closed: eight or more frequencies must rise from above zero; they do not after 0\.15"),
        (replace(closed, damping=-closed.damping), "damping .. is negative by more than 2 %"),
    ):
        save(database, tmp_path / "turned.json")
        with pytest.raises(ValueError, match=message):
            load(tmp_path / "turned.json")
    n = int(np.searchsorted(closed.omega, 1.01))
    short = replace(
        closed, omega=closed.omega[:n], added_mass=closed.added_mass[:n], damping=closed.damping[:n],
        excitation=closed.excitation[:n],
    )  # fmt: skip
    with pytest.raises(ValueError, match=r"0\.05 to 1 rad/s is too narrow for a wave spectrum"):
        component(short)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("bad.json", b'{"name": ', r"bad\.json is no JSON \(Expecting value"),
        ("bad.json", b"\xff\x00", r"bad\.json is no JSON \('utf-8' codec"),
        ("bad.json", b"[1, 2]", r"bad\.json: lists of unlike length or no numbers"),
        ("bad.nc", b"no NetCDF", r"bad\.nc cannot be read"),
        ("bad.nc", b"CDF\x01\x00\x00", r"bad\.nc cannot be read"),
        ("bad.nc", b"\x89HDF\r\n\x1a\n" + bytes(90), r"bad\.nc cannot be read"),
    ],
)
def test_broken_databases_are_named(tmp_path: Path, name: str, content: bytes, message: str) -> None:
    if name.endswith(".nc"):
        pytest.importorskip("xarray")
    (tmp_path / name).write_bytes(content)
    with pytest.raises(ValueError, match=message) as error:
        load(tmp_path / name)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, np.inf])
@pytest.mark.parametrize(
    "option", ["displaced_volume", "water_depth", "water_density", "gravity", "unit_length", "draft"]
)
def test_figures_must_be_finite_and_above_zero(option: str, value: float, tmp_path: Path) -> None:
    message = rf"^hydro: {option} {value:g} must be a finite number above 0, e\.g\. "
    root = write_wamit(every(load("closed"), 20), tmp_path / "Box")
    for database in ("closed", str(root)):
        with pytest.raises(ValueError, match=message):
            component(database, **{option: value})


def test_figures_that_contradict_are_refused(tmp_path: Path) -> None:
    closed = load("closed")
    with pytest.raises(ValueError, match="for deep water a large finite depth such as 1e5 m"):
        component(water_depth=np.inf)
    with pytest.raises(ValueError, match="draft 151 m must not be above the water depth, 150 m"):
        component(draft=151.0)
    for database in ("closed", closed):
        with pytest.raises(ValueError, match=r"unit_length 2 is for WAMIT's files.*; leave it out"):
            component(database, unit_length=2.0)
        with pytest.raises(ValueError, match="closed states gravity"):
            component(database, gravity=1.0)
    save(replace(closed, gravity=np.nan), tmp_path / "own.json")
    with pytest.raises(ValueError, match=r"own\.json: gravity nan must be a finite number above 0"):
        load(tmp_path / "own.json")
    omega = closed.omega.copy()
    omega[5] = np.nan
    with pytest.raises(ValueError, match="frequencies must rise from above zero; they do not after"):
        checked(replace(closed, omega=omega))


def test_wrong_unit_length_is_warned_of(tmp_path: Path) -> None:
    # Added mass goes with the cube of the unit length: 20 m for 1 m is 8000 times the mass.
    root = write_wamit(load("closed"), tmp_path / "Box")
    with pytest.warns(UserWarning, match="Box: heave added mass .* check unit_length and displaced_volume"):
        warn_of_scale(load(root, unit_length=20.0))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for name in ("closed", "moonpool", "deep"):
            warn_of_scale(load(name))


def test_poor_fit_is_warned_of() -> None:
    # Damping in spikes that the frequencies do not resolve is beyond twelve poles.
    closed = every(load("closed"), 2)
    spiky = replace(
        closed, damping=closed.damping * (1.0 + 0.9 * (-1.0) ** np.arange(len(closed.omega)))[:, None, None]
    )
    with pytest.warns(UserWarning, match=r"closed: poor fit of 11, .*; resonances need finer frequencies"):
        radiation_model(spiky)


# --- seas -------------------------------------------------------------------------------------------------------


def record(path: Path, low: float, high: float, seed: int = 2) -> tuple[Array, Array]:
    """A record of 200 s, step 0.1 s, of all multiples of 2 pi / 200 s from low to high (rad/s); written to the path."""
    rng = np.random.default_rng(seed)
    time = 0.1 * np.arange(2000)
    omega = 2.0 * np.pi / 200.0 * np.arange(1, 1000)
    omega = omega[(omega >= low) & (omega <= high)]
    angle = np.multiply.outer(time, omega) + rng.uniform(0.0, 2.0 * np.pi, len(omega))
    elevation = np.cos(angle) @ rng.uniform(0.0, 0.2, len(omega))
    pd.DataFrame({"time_s": time + 30.0, "elevation_m": elevation}).to_csv(path, index=False)
    return time + 30.0, elevation


def test_record_is_reproduced_by_its_components(tmp_path: Path) -> None:
    time, elevation = record(tmp_path / "sea.csv", 0.2, 2.5)
    instance = Instance(derive(component(sea=str(tmp_path / "sea.csv"))))
    instance.initialise()
    found = []
    for n in (0, 1, 777, 1999):
        instance.time = time[n]
        found.append(instance.get("wave_elevation"))
    assert found == pytest.approx(elevation[[0, 1, 777, 1999]], abs=1e-9)
    # It repeats after its own length; a last sample that closes the period counts once.
    closing = given_sea.from_record(np.r_[time, time[-1] + 0.1], np.r_[elevation, elevation[0]])
    assert closing.omega[0] == pytest.approx(2.0 * np.pi / 200.0)
    instance.time = time[777] + 200.0
    assert instance.get("wave_elevation") == pytest.approx(elevation[777], abs=1e-9)
    # Parseval: the components have the record's variance.
    assert 0.5 * np.sum(closing.amplitude**2) == pytest.approx(np.var(elevation))


def test_what_is_left_out_of_a_sea_is_told(tmp_path: Path) -> None:
    _, whole = record(tmp_path / "sea.csv", 0.2, 5.0)
    with pytest.warns(UserWarning, match="above 3 rad/s: use a database of more frequencies or filter the record"):
        kept, note = given_sea.within(given_sea.read(tmp_path / "sea.csv"), 0.05, 3.0)
    share = 1.0 - 0.5 * np.sum(kept.amplitude**2) / np.var(whole)
    assert f"{share:.2%} above 3 rad/s" in note
    with pytest.raises(ValueError, match=r"no component has its frequency between 0\.05 and 0\.1 rad/s"):
        given_sea.within(waves.WaveComponents(kept.omega, 0.0 * kept.amplitude, kept.phase), 0.05, 0.1)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a,b\n1,2\n", r"bad\.csv needs the columns omega_rad_s, amplitude_m, phase_rad, or time_s and elevation_m"),
        ("omega_rad_s,amplitude_m,phase_rad\n0.5,x,0\n", r"bad\.csv: column amplitude_m is no number in row 1"),
        (
            "time_s,elevation_m\n" + "".join(f"{t},0.1\n" for t in [*range(20), 19.5]),
            "they do not at 19 s: resample",
        ),
        ("time_s,elevation_m\n0,1\n1,2\n", r"bad\.csv: 2 samples make no record of a sea"),
    ],
)
def test_bad_seas(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "bad.csv").write_text(text)
    with pytest.raises(ValueError, match=message):
        component(sea=tmp_path / "bad.csv")


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("bad.csv", b"", r"sea: bad\.csv cannot be read \(No columns"),
        ("bad.csv", b"\xff\xfe\x00\x80,\x81\n", r"sea: bad\.csv cannot be read \('utf-8' codec"),
        ("bad.parquet", b"no Parquet", r"sea: bad\.parquet cannot be read \("),
        ("bad.csv", b"time_s,elevation_m\n" + b"".join(b"%d,0.1\n" % t for t in range(20)),
         r"sea: bad\.csv: the elevation does not move: all 20 samples are 0\.1 m"),
        ("bad.csv", b"time_s,elevation_m\n0,x\n", r"^sea: bad\.csv: column elevation_m is no number in row 1"),
    ],
)  # fmt: skip
def test_broken_seas_are_named(tmp_path: Path, name: str, content: bytes, message: str) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(ValueError, match=message) as error:
        given_sea.read(tmp_path / name)
    assert "\n" not in str(error.value)


def test_frequencies_of_six_digits_are_known_as_even() -> None:
    # As in files of components: 0.00628319, 0.0125664, ... and without the lowest.
    omega = np.array([float(f"{2.0 * np.pi / 1000.0 * k:.6g}") for k in range(20, 900)])
    assert waves.spacing(omega) == pytest.approx(2.0 * np.pi / 1000.0, rel=1e-7)
    assert waves.spacing(omega * np.linspace(1.0, 1.01, len(omega))) is None
    assert waves.spacing(omega[:1]) is None


# --- options of `fowt build` ------------------------------------------------------------------------------------


def test_options_make_another_fmu_that_says_what_it_is(tmp_path: Path) -> None:
    (tmp_path / "sea.csv").write_text("omega_rad_s,amplitude_m,phase_rad\n0.5,1.0,0.0\n")
    options = {"sea": str(tmp_path / "sea.csv")}
    first = build_variant("hydro", options)
    text = fmpy.read_model_description(str(first), validate=False).description
    assert text == make("hydro", options).description
    assert "Built with sea=sea.csv (sha256 " in text
    assert "relative L2 error of K(t) by pair: 11 " in text
    assert build_variant("hydro", options) == first
    # Another content makes another FMU, of which the description tells.
    (tmp_path / "sea.csv").write_text("omega_rad_s,amplitude_m,phase_rad\n0.5,1.1,0.0\n")
    assert make("hydro", options).description.split("sha256")[1] != text.split("sha256")[1]
    with pytest.raises(ValueError, match="no option 'seas'; its options are database, sea, "):
        make("hydro", {"seas": "x"})
    with pytest.raises(ValueError, match="option draft='deep' is no number"):
        make("hydro", {"draft": "deep"})
