"""AeroDyn's files of a rotor: the same rotor read back, constants found from polars, tables, bad and damaged files."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from hypothesis import given

from fmus_src.aero.aerodyn_file import files_of, read_aerodyn, read_tables
from fmus_src.aero.dynamic_stall import Aerofoil, Attached, Separated, attached_flow, separated_flow
from fmus_src.aero.geometry import Rotor, read_rotor, rotor, section_tables
from fmus_src.aero.model import component
from fmus_src.aero.polars import LIFT, Polar, StallConstants, constants_of_polar
from fmus_src.barge.turbine import DATA
from fmus_src.equations import derive
from fmus_src.library import _labels, make

from .aero_rotor import RPM, STEP, TILTED, first_sample, settings
from .aerodyn_files import Kirchhoff, blade_file, constants, polar_file, primary_file, table, write_rotor
from .test_fuzz_files import brief, damaged

HUB = {"hub_radius": 1.5, "precone": np.radians(-2.5)}


def outputs(r: Rotor | Path | None, samples: int = 3, **given: float) -> dict[str, float]:
    """All outputs of the rotor component after a few samples on a turning, tilted rotor."""
    i = first_sample(derive(component(r)), settings(wind=9.0, speed=10.0 * RPM, shear=0.1, axes=TILTED, **given))
    for n in range(1, samples):
        i.set({"rotor.azimuth": n * 10.0 * RPM * STEP})
        i.do_step(STEP)
    return i.outputs()


def test_own_rotor_written_in_aerodyn_s_form_is_the_same_rotor(tmp_path: Path) -> None:
    own, read = rotor(), read_aerodyn(write_rotor(rotor(), tmp_path), **HUB)
    for name in ("span", "chord", "twist", "offset", "prebend", "section"):
        # twelve digits are written
        assert getattr(read, name) == pytest.approx(getattr(own, name), rel=1e-11, abs=1e-14), name
    assert section_tables(read)[0] == pytest.approx(section_tables(own)[0], abs=1e-9)
    for mine, theirs in zip(own.polars, read.polars, strict=True):
        assert (mine.unsteady is None) == (theirs.unsteady is None)
        if mine.unsteady and theirs.unsteady:
            assert vars(theirs.unsteady) == pytest.approx(vars(mine.unsteady), rel=1e-10)
    ours, again = outputs(None), outputs(tmp_path / "rotor.dat")
    # The file ends at the last station, 0.1 mm before the tip: 2e-6 of the radius.
    scale = {name: max(abs(value), 1e3) for name, value in ours.items()}
    assert max(abs(again[n] - ours[n]) / scale[n] for n in ours) < 1e-5


def test_a_folder_in_the_package_s_form_is_the_same_rotor(tmp_path: Path) -> None:
    source = Path(read_rotor.__code__.co_filename).parent / "data"
    for name in ("blade.toml", "sections.toml"):
        (tmp_path / name).write_text((source / name).read_text())
    assert derive(component(str(tmp_path))).variables == derive(component()).variables
    assert outputs(tmp_path) == outputs(None)
    text = (tmp_path / "blade.toml").read_text()
    (tmp_path / "blade.toml").write_text(text.replace("hub_radius = 1.5", ""))
    with pytest.raises(ValueError, match="lacks 'hub_radius'"):
        component(tmp_path)


@pytest.mark.filterwarnings("ignore:.*blades are rigid")
def test_straight_blade_bent_upwind_is_a_coned_blade() -> None:
    """Prebend in a straight line through the apex is the cone's geometry, so the loads are the same."""
    cone = np.radians(-4.0)
    coned = replace(rotor(), precone=cone, offset=np.zeros_like(rotor().offset), name="coned")
    axis = coned.hub_radius + coned.span
    bent = replace(
        coned,
        name="bent",
        precone=0.0,
        hub_radius=coned.hub_radius * np.cos(cone),
        tip_radius=coned.tip_radius * np.cos(cone),
        span=coned.span * np.cos(cone),
        offset=np.column_stack([axis * np.sin(cone), np.zeros_like(axis)]),
        prebend=np.full(axis.size, cone),
    )
    assert bent.load_lumping == pytest.approx(coned.load_lumping, rel=1e-12)
    # The time constant of dynamic inflow goes with the tip's distance along z.
    one, other = outputs(coned, dynamic_inflow=False), outputs(bent, dynamic_inflow=False)
    for name in ("thrust", "torque", "power", "force[2]", "force[3]", "moment[2]", "moment[3]"):
        assert other[name] == pytest.approx(one[name], rel=1e-10), name


def test_polars_in_aerodyn_s_form_may_be_splines(tmp_path: Path) -> None:
    """InterpOrd 3: a natural cubic spline; between the points of a parabola it is closer than straight lines."""
    alpha = np.radians([-180.0, -10.0, -5.0, 0.0, 5.0, 10.0, 180.0])
    p = Polar("s", alpha, np.cos(alpha), np.full(7, 0.01), np.zeros(7))
    found = {}
    for order in ("1", "3"):
        (tmp_path / "s.dat").write_text(polar_file([table(p, "")], order))
        found[order] = float(read_tables(tmp_path / "s.dat")[0].polar.at(np.radians([2.5]))[0, LIFT])
    exact = np.cos(np.radians(2.5))
    assert found["1"] == pytest.approx(0.5 * (1.0 + np.cos(np.radians(5.0))), rel=1e-9)
    assert abs(found["3"] - exact) < 0.2 * abs(found["1"] - exact)


def test_constants_are_found_from_a_polar_of_known_separation() -> None:
    section = Kirchhoff()
    found = constants_of_polar(section.polar(), {})
    assert found is not None
    # Smoothing over 2 deg does not change a straight line.
    assert found.slope == pytest.approx(section.slope, rel=1e-9)
    assert found.drag_0 == pytest.approx(0.01)
    assert found.alpha_0 == pytest.approx(0.0, abs=1e-9)
    critical = section.end - 0.7 * (section.end - section.begin)  # where the separation factor is 0.7
    # Attached flow is held to end where the slope has fallen to 90 %, up to 2 deg from where it does: a few per cent.
    assert found.stall == pytest.approx(float(section.normal(np.array([critical]))[0]), rel=0.06)
    # A symmetric section: up to the side on which a point at a limit lies.
    assert found.negative_stall == pytest.approx(-found.stall, rel=0.02)


def test_constants_found_are_near_the_published_ones() -> None:
    """NREL's sections: published stall loads were read off by hand; AeroDyn's rule finds them within 12 %."""
    for p in rotor().polars:
        found = constants_of_polar(p, {})
        assert (found is None) == (p.unsteady is None), p.name
        if found and p.unsteady:
            assert found.stall == pytest.approx(p.unsteady.stall, rel=0.12), p.name
            kept = constants_of_polar(p, {"stall": 1.5, "T_f": 5.0})
            assert kept is not None
            assert (kept.stall, kept.T_f, kept.slope) == (1.5, 5.0, found.slope)


def test_constants_of_a_file_are_taken_with_their_units(tmp_path: Path) -> None:
    given = {
        "alpha0": "-3", "C_nalpha": "6.5D0", "Cn1": "1.2", "Cn2": "-0.9", "Cd0": "0.008", "T_f0": "4", "T_V0": "7",
        "T_p": "1.5", "T_VL": "9", "b1": "0.2", "b2": "0.6", "A1": "0.4", "A2": "0.6", "St_sh": "0.25",
        "UACutout": "30", "UACutout_delta": "10", "filtCutOff": "0.7",
    }  # fmt: skip
    (tmp_path / "s.dat").write_text(polar_file([table(Kirchhoff().polar(1.0), constants(None, **given))]))
    assert read_tables(tmp_path / "s.dat")[0].polar.unsteady == StallConstants(
        alpha_0=np.radians(-3.0), slope=6.5, drag_0=0.008, stall=1.2, negative_stall=-0.9, T_p=1.5, T_f=4.0, T_v=7.0,
        T_vl=9.0, strouhal=0.25, A1=0.4, A2=0.6, b1=0.2, b2=0.6, filter_cut_off=0.7,
        fade_from=pytest.approx(np.radians(20.0)), cut_out=np.radians(30.0),
    )  # fmt: skip
    (tmp_path / "s.dat").write_text(polar_file([table(Kirchhoff().polar(1.0), "")]))
    found = read_tables(tmp_path / "s.dat")[0].polar
    assert found.unsteady == constants_of_polar(found, {})  # a file without constants


def test_time_constants_of_the_file_act_in_the_model() -> None:
    """Deficiencies of attached and separated flow die away with the section's own constants, in closed form."""
    speed, chord, dt = 50.0, 2.0, 0.01
    ds, mach = 2.0 * speed * dt / chord, speed / 335.0
    for c in (StallConstants(0.0, 6.0, 0.01, 1.4, -1.0), StallConstants(0.0, 6.0, 0.01, 1.4, -1.0, T_f=5.0, b1=0.3)):
        s = Aerofoil(**{k: ca.SX(v) for k, v in vars(c).items()}, chord=ca.SX(chord))
        rest = Attached(**dict.fromkeys(Attached.__annotations__, ca.SX(0)))
        flow, now = attached_flow(s, replace(rest, X1=ca.SX(1.0)), 1.0, 0.0, speed, dt)
        assert float(ca.DM(now.X1)) == pytest.approx(np.exp(-c.b1 * (1.0 - mach**2) * ds))
        before = Separated(**dict.fromkeys(Separated.__annotations__, ca.SX(0)))
        old = replace(before, D_f=ca.SX(0.5), f=ca.SX(0.25), sigma=ca.SX(1.0))
        *_, later = separated_flow(s, (rest, old), 1.0, flow, now, 0.0, (ca.SX(0.0), ca.SX(0.01)))
        change = float(ca.DM(later.f)) - 0.25
        assert float(ca.DM(later.D_f)) == pytest.approx(0.5 * np.exp(-ds / c.T_f) + change * np.exp(-0.5 * ds / c.T_f))


def several(tmp_path: Path, kind: str, pairs: list[tuple[float, float]], mode: int) -> Path:
    p = Kirchhoff().polar(1.0)
    texts = [table(replace(p, lift=factor * p.lift), "", **{kind: at}) for at, factor in pairs]
    (tmp_path / "s.dat").write_text(polar_file(texts))
    (tmp_path / "blade.dat").write_text(blade_file(replace(rotor(), section=np.zeros(19, dtype=int))))
    (tmp_path / "rotor.dat").write_text(primary_file(["s.dat"], AFTabMod=mode))
    return tmp_path / "rotor.dat"


def test_tables_are_used_at_a_reynolds_number_or_user_property(tmp_path: Path) -> None:
    alpha = np.radians([5.0])
    one = float(Kirchhoff().polar(1.0).at(alpha)[0, LIFT])

    def lift(path: Path, **at: float) -> float:
        return float(read_aerodyn(path, **HUB, **at).polars[0].at(alpha)[0, LIFT]) / one

    path = several(tmp_path, "reynolds", [(1.0, 1.0), (4.0, 1.2), (16.0, 1.3)], 2)
    # linear in the logarithm, held beyond the tables
    wanted = {1e6: 1.0, 2e6: 1.1, 4e6: 1.2, 8e6: 1.25, 1e5: 1.0, 1e8: 1.3}
    assert {re_: lift(path, reynolds=re_) for re_ in wanted} == pytest.approx(wanted)
    with pytest.raises(ValueError, match=r"rotor.dat: AFTabMod 2, and s has 3 tables; .*option reynolds, here "):
        lift(path)
    path = several(tmp_path, "user_property", [(-1.0, 0.9), (1.0, 1.1)], 3)
    assert lift(path, user_property=0.5) == pytest.approx(1.05)
    with pytest.raises(ValueError, match="exclude each other"):
        lift(path, user_property=0.5, reynolds=1e6)
    path = several(tmp_path, "user_property", [(-1.0, 0.9), (1.0, 1.1)], 1)
    assert lift(path) == pytest.approx(0.9)  # AFTabMod 1: the first
    assert "first of several" in read_aerodyn(path, **HUB).note
    path = several(tmp_path, "reynolds", [(1.0, 1.0)], 2)
    with pytest.raises(ValueError, match="one table each; leave reynolds"):
        lift(path, reynolds=1e6)


def test_unsteady_flow_only_between_the_radii_of_the_primary_file(tmp_path: Path) -> None:
    r = read_aerodyn(write_rotor(rotor(), tmp_path, UAStartRad=0.5, UAEndRad=0.9), **HUB)
    share = r.radius_along / r.tip_radius
    active = np.array([r.polars[s].unsteady is not None for s in r.section])
    assert (active == ((share >= 0.5) & (share <= 0.9))).all()
    assert [r.polars[s].name for s in r.section] == [rotor().polars[s].name for s in rotor().section]
    (tmp_path / "rotor.dat").write_text((tmp_path / "rotor.dat").read_text().replace("True UseBlCm", "False UseBlCm"))
    assert not any(p.moment.any() for p in read_aerodyn(tmp_path / "rotor.dat", **HUB).polars)


def test_files_of_all_versions_and_makers_are_read(tmp_path: Path) -> None:
    """Lines that came and went with the versions, included and inline shapes, CRLF, other paths, Latin-1 comments."""
    path = write_rotor(rotor(), tmp_path)
    expected = section_tables(rotor())[0]
    file = tmp_path / "Airfoils" / "DU21_A17.dat"
    text = file.read_text()
    (tmp_path / "Airfoils" / "shape.txt").write_text("! x y\n3 NumCoords ! points\n0 0\n1 0.1\n1 -0.1\n")
    for new in (
        text.replace("0 NumCoords", '@"shape.txt" NumCoords'),
        text.replace("0 NumCoords", "@nowhere.txt NumCoords"),
        text.replace("0 NumCoords ! no shape", '2 NumCoords\n0 0\n1 0.1\n"DU21_BL.txt" BL_file'),
        text.replace("1 NonDimArea", "0.21 RelThickness\n1 NonDimArea").replace("UserProp", "Ctrl"),
        text.replace("\n", "\r\n").replace("a section", "Winkel in \xb0"),
    ):
        file.write_bytes(new.encode("latin-1"))
        assert section_tables(read_aerodyn(path, **HUB))[0] == pytest.approx(expected, abs=1e-9)
    assert tmp_path / "Airfoils" / "shape.txt" not in files_of(path)
    (tmp_path / "rows.txt").write_text("".join(text.splitlines(keepends=True)[-142:]))
    file.write_text("".join(text.splitlines(keepends=True)[:-142]) + '@"../rows.txt"\n')
    assert tmp_path / "Airfoils/../rows.txt" in files_of(path)
    path.write_text(path.read_text().replace("Airfoils/", "Airfoils\\"))
    assert section_tables(read_aerodyn(path, **HUB))[0] == pytest.approx(expected, abs=1e-9)


BAD: list[tuple[str, str, str, str]] = [
    ("Airfoils/DU21_A17.dat", "1 NumTabs", "one NumTabs", r"DU21_A17.dat, line 6: needs 1 finite numbers \(NumTabs\)"),
    ("Airfoils/DU21_A17.dat", "1 NumTabs", "0 NumTabs", "line 6: NumTabs must be a whole number from 1"),
    ("Airfoils/DU21_A17.dat", "142 NumAlf", "143 NumAlf", r"ends before 143 rows \(NumAlf\)"),
    ("Airfoils/DU21_A17.dat", "142 NumAlf", "141 NumAlf", "go from -180 to 175 deg; extend"),
    ("Airfoils/DU21_A17.dat", "\n180 ", "\n170 ", "line 185: the angles of attack must rise"),
    ("Airfoils/DU21_A17.dat", "\n180 ", "\n180 x ", "line 185: needs 4 finite numbers"),
    ("Airfoils/DU21_A17.dat", "\n180 ", "\nnan ", "line 185: needs 4 finite numbers"),
    ("Airfoils/DU21_A17.dat", 'Default" T_f0', "-3 T_f0", "line 15: T_f0 must be above 0; or write Default"),
    ("Airfoils/DU21_A17.dat", "C_nalpha", "C_nalfa", "line 14: not a line of an AirfoilInfo file v1.01"),
    ("Airfoils/DU21_A17.dat", "InterpOrd", "Something", "line 3: not a line of an AirfoilInfo file .*convert older"),
    ("Airfoils/DU21_A17.dat", "0 NumCoords", '@"nowhere.txt"', "line 5: there is no such file"),
    ("Airfoils/DU21_A17.dat", "0 NumCoords", '@"DU21_A17.dat"', "at most 5 files within another"),
    ("blade.dat", "NumBlNds", "Nodes", "blade.dat ends before NumBlNds"),
    ("blade.dat", "BlCrvAng", "Angle", "blade.dat, line 5: lacks the column blcrvang"),
    ("blade.dat", "19 NumBlNds", "20 NumBlNds", "ends before 20 rows"),
    ("blade.dat", "3.542 1\n", "3.542 1.5\n", "BlAFID must be whole numbers"),
    ("blade.dat", "3.542 1\n", "3.542 9\n", "blade.dat: BlAFID 9 where rotor.dat names 8 polars"),
    ("blade.dat", "\n1.3667 ", "\n0 ", "rotor.dat: give 4 or more stations whose span rises"),
    ("blade.dat", "3.542 1\n", "0 1\n", "chord must be above 0"),
    ("rotor.dat", "AFNames", "FoilNm", "rotor.dat lacks NumAFfiles, AFNames"),
    ("rotor.dat", "8 NumAFfiles", "80 NumAFfiles", "needs 80 names of polar files"),
    ("rotor.dat", "DU21_A17.dat", "DU20_A17.dat", "DU20_A17.dat cannot be read; check the name"),
    ("rotor.dat", '"blade.dat" ADBlFile(2)', '"other.dat" ADBlFile(2)', "blades are alike; name one file"),
    ("rotor.dat", "True UseBlCm", "Maybe UseBlCm", "write True or False"),
    ("rotor.dat", "2 InCol_Cl", "1 InCol_Cl", "Cylinder1.dat, line 44: a coefficient above 20; check InCol_Cl"),
    ("rotor.dat", "4 InCol_Cm", "7 InCol_Cm", r"needs 7 numbers \(a row of the polar\)"),
]


@pytest.mark.parametrize(("name", "old", "new", "words"), BAD, ids=[f"{b[0].split('/')[-1]}-{b[2][:14]}" for b in BAD])
def test_bad_files_are_refused_in_one_line(name: str, old: str, new: str, words: str, tmp_path: Path) -> None:
    path = write_rotor(rotor(), tmp_path)
    file = tmp_path / name
    text = re.sub(" +", " ", file.read_text())
    assert old in text
    file.write_text(text.replace(old, new, 1))
    with pytest.raises(ValueError, match=words) as refused:
        read_aerodyn(path, **HUB)
    assert str(refused.value).startswith("aero: ")
    assert "\n" not in str(refused.value)


def test_rotor_and_turbine_must_fit(tmp_path: Path) -> None:
    longer = replace(rotor(), span=2.0 * rotor().span, tip_radius=126.0)
    path = write_rotor(longer, tmp_path / "long")
    with pytest.raises(ValueError, match="options hub_radius and precone_deg"):
        make("aero", {"rotor": path})
    with pytest.warns(UserWarning, match=r"blades are rigid in this FMU.*barge.dof.blade_flap_1"):
        c = make("aero", {"rotor": path, "hub_radius": 3.0, "precone_deg": -4.0})
    assert "Rotor rotor.dat, radius 126 m, 19 stations, 8 polars. Blades rigid" in c.description
    with pytest.raises(ValueError, match=r"blades of 123 m, hub radius 1.5 m.* where the turbine has 61.5 m"):
        make("aero", {"rotor": path, "turbine": DATA})
    with pytest.raises(ValueError, match="option reynolds is for AeroDyn's files; the rotor NREL 5-MW has its own"):
        make("aero", {"reynolds": 1e6})
    with pytest.raises(ValueError, match="there is no rotor 'nowhere'"):
        make("aero", {"rotor": "nowhere"})
    with pytest.raises(ValueError, match=r"turbine.toml cannot be read; a turbine's folder has turbine.toml, tower"):
        make("barge", {"turbine": tmp_path})
    assert derive(make("aero", {"turbine": DATA})).variables == derive(component()).variables
    assert derive(make("barge", {"turbine": DATA})).variables == derive(make("barge")).variables
    (tmp_path / "turbine.toml").write_text((DATA / "turbine.toml").read_text().replace("overhang", "overhung"))
    with pytest.raises(ValueError, match=r"turbine.toml: \[rotor\] lacks overhang"):
        make("barge", {"turbine": tmp_path})


def test_an_fmu_s_key_follows_every_file_of_the_rotor(tmp_path: Path) -> None:
    path = write_rotor(rotor(), tmp_path)
    before = _labels({"rotor": str(path)})
    for file in sorted(tmp_path.rglob("*.dat")):
        text = file.read_text()
        file.write_text(text + "! changed\n")
        assert _labels({"rotor": str(path)}) != before, file
        file.write_text(text)
    assert _labels({"rotor": str(path)}) == before


WHOLE = {
    "rotor.dat": primary_file(["s.dat"]),
    "blade.dat": blade_file(replace(rotor(), section=np.zeros(19, dtype=int))),
    "s.dat": polar_file([table(Kirchhoff().polar(10.0), constants(None, Cn1="1.2", UACutout="30"))] * 2),
}


@pytest.mark.filterwarnings("ignore:coefficients at")
@pytest.mark.parametrize("name", WHOLE)
def test_damaged_files_are_read_or_refused_in_one_line(name: str, tmp_path: Path) -> None:
    for other, text in WHOLE.items():
        (tmp_path / other).write_text(text)
    read_aerodyn(tmp_path / "rotor.dat", **HUB)

    @given(text=damaged(WHOLE[name]))
    @brief
    def check(text: str) -> None:
        (tmp_path / name).write_bytes(text.encode("utf-8", "surrogateescape" if "\udcff" in text else "strict"))
        words = "read"
        try:
            r = read_aerodyn(tmp_path / "rotor.dat", **HUB)
            assert np.isfinite(section_tables(r)[0]).all()
        except ValueError as error:
            words = str(error)
        assert words == "read" or words.startswith("aero: ")
        assert words.isprintable()
        assert len(words) < 400

    check()


def test_the_short_primary_file_of_the_documents_is_enough(tmp_path: Path) -> None:
    page = Path(__file__).parent.parent / "docs/another-turbine.md"
    example = re.search(r"```text\n(.*?)```", page.read_text(), re.S)
    assert example
    write_rotor(rotor(), tmp_path)
    for name, polar in (("Cylinder", "Cylinder1"), ("DU21", "DU21_A17")):
        (tmp_path / f"Airfoils/{name}.dat").write_text((tmp_path / f"Airfoils/{polar}.dat").read_text())
    (tmp_path / "blade.dat").write_text(blade_file(replace(rotor(), section=np.minimum(rotor().section, 1))))
    (tmp_path / "short.dat").write_text(example.group(1))
    assert [p.name for p in read_aerodyn(tmp_path / "short.dat", **HUB).polars] == ["Cylinder", "DU21"]
