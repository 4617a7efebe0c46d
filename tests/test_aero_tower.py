"""The tower in the wind: flow around it, its shadow, drag, and the work of the drag on the tower's modes."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from numpy.polynomial import Polynomial

from fmus_src.aero import tower
from fmus_src.barge.model import component as barge
from fmus_src.equations import Equations
from fmus_src.instance import Instance

from .aero_rotor import RPM, STEP, TILTED, Run, Settings, settings, vector
from .loaded import Loaded

RADIUS_AT_TOP = 0.5 * tower.tower().top_diameter


def loads(aero: Equations, given: Settings) -> dict[str, float]:
    i = Instance(aero)
    i.set(given | {"tower_drag": 1.0, "rotor.speed": 1.0})
    i.initialise()
    return i.outputs()


def still(wind: float, shear: float = 0.0) -> Settings:
    return {"wind_speed": wind, "shear_exponent": shear}


# --- flow around the tower ------------------------------------------------------------------------------------------


def flow(x: float, y: float, beyond: float = 0.0, drag_coefficient: float = 1.0) -> tuple[float, float]:
    u, v = tower.tower_flow(*(ca.DM(a) for a in (x, y, beyond, drag_coefficient)))
    return float(u), float(v)


def test_flow_around_the_tower_is_that_of_a_cylinder() -> None:
    """No flow through its surface, stagnation ahead of it, twice the wind beside it; no sources, no rotation."""
    for angle in np.radians([95.0, 120.0, 180.0, 250.0]):  # ahead of the tower, where there is no shadow
        n = np.array([np.cos(angle), np.sin(angle)])
        u, v = flow(*n)
        assert (1.0 + u) * n[0] + v * n[1] == pytest.approx(0.0, abs=1e-12)
    assert flow(-1.0, 0.0)[0] == pytest.approx(-1.0)
    assert flow(-1e-9, 1.0)[0] == pytest.approx(1.0)
    x, y, h = -2.0, 1.3, 1e-5
    by_x = (np.array(flow(x + h, y)) - flow(x - h, y)) / (2 * h)
    by_y = (np.array(flow(x, y + h)) - flow(x, y - h)) / (2 * h)
    assert by_x[0] + by_y[1] == pytest.approx(0.0, abs=1e-8)
    assert by_x[1] - by_y[0] == pytest.approx(0.0, abs=1e-8)


def test_shadow_is_powles_bell() -> None:
    """Width and centre deficit at d radii: sqrt(d) and C_d / sqrt(d); never more than half the wind."""
    for x in (9.0, 16.0):
        potential = -1.0 / x**2
        assert flow(x, 0.0)[0] == pytest.approx(potential - 1.0 / np.sqrt(x))
        assert flow(x, 0.0, drag_coefficient=0.4)[0] == pytest.approx(potential - 0.4 / np.sqrt(x))
    d = np.hypot(9.0, 1.5)
    bell = np.cos(0.5 * np.pi * 1.5 / np.sqrt(d)) ** 2 / np.sqrt(d)
    assert flow(9.0, 1.5)[0] == pytest.approx((1.5**2 - 81.0) / d**4 - bell)
    assert flow(9.0, 3.5)[0] == pytest.approx((3.5**2 - 81.0) / (81.0 + 3.5**2) ** 2)  # beside it
    assert flow(1.5, 0.0)[0] == pytest.approx(-1.0 / 1.5**2 - tower.LARGEST_DEFICIT)


def test_influence_fades_over_one_radius_above_the_top() -> None:
    """AeroDyn stretches x and y by 1 / cos, which multiplies the potential flow by cos^2."""
    full = np.array(flow(-2.0, 0.7))
    assert flow(-2.0, 0.7, beyond=0.5) == pytest.approx(full * np.cos(0.25 * np.pi) ** 2)
    for x in (-2.0, 2.0, 30.0):
        assert flow(x, 0.1, beyond=1.0) == pytest.approx((0.0, 0.0), abs=1e-6)


def disturbed(points: np.ndarray, wind: np.ndarray, support: np.ndarray) -> np.ndarray:
    """Wind at the points, (3, n)."""
    air = tower.Air(1.225, ca.MX(1.0), ca.MX(1), ca.MX(0))
    given = [ca.MX.sym(f"a{i}", *a.shape) for i, a in enumerate((support[:, None], points, wind))]
    return np.asarray(ca.Function("f", given, [tower.disturbed(tower.tower(), air, *given)])(support, points, wind))


ORIGIN, UPRIGHT = np.zeros(3), np.eye(3)


def support(position: np.ndarray = ORIGIN, axes: np.ndarray = UPRIGHT, **more: np.ndarray) -> np.ndarray:
    given = {"velocity": np.zeros(3), "omega": np.zeros(3), "deflection": np.zeros(4), "rate": np.zeros(4)} | more
    return np.concatenate([position, axes.T.ravel(), *given.values()])


def test_wind_at_the_blades_meets_the_tower_where_it_stands() -> None:
    """A tower moved, turned and bent with its surroundings has the same flow around it."""
    height, wind = 60.0, np.array([11.0, 2.0, 0.5])
    t = tower.tower()
    radius = 0.5 * (6.0 + (3.87 - 6.0) * height / 87.6)
    offset = np.array([-4.0, 1.5])
    direction, speed = wind[:2] / np.hypot(*wind[:2]), np.hypot(*wind[:2])
    across = np.array([-direction[1], direction[0]])
    u, v = flow(direction @ offset / radius, across @ offset / radius)
    expected = wind + np.append(speed * (u * direction + v * across), 0.0)

    def one(point: np.ndarray, wind: np.ndarray, b: np.ndarray) -> np.ndarray:
        return disturbed(point[:, None], wind[:, None], b)[:, 0]

    assert one(np.append(offset, height), wind, support()) == pytest.approx(expected)
    # Bent by two metres, and bending at one metre a second into the wind, which then blows faster past the tower.
    modes = [Polynomial([0.0, 0.0, *c])(height / 87.6) for c in t.axis.coefficients]
    bent = np.array([offset[0] + 2.0 * modes[0], offset[1] - modes[2], height])
    q, rate = np.array([2.0, 0.0, -1.0, 0.0]), np.array([-1.0 / modes[0], 0.0, 0.0, 0.0])
    assert one(bent, wind - [1.0, 0.0, 0.0], support(deflection=q, rate=rate)) == pytest.approx(
        expected - [1.0, 0.0, 0.0]
    )
    # A platform moved, turned and moving; the wind turned with it, and as much more as the platform moves.
    c, s = np.cos(0.3), np.sin(0.3)
    axes = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ TILTED
    position, velocity = np.array([20.0, -7.0, 1.5]), np.array([0.5, -0.4, 0.2])
    point = position + axes @ np.append(offset, height)
    got = one(point, axes @ (wind + velocity), support(position, axes, velocity=velocity))
    assert got == pytest.approx(axes @ (expected + velocity))


def test_no_effect_well_above_the_tower_and_the_most_in_front_of_it() -> None:
    t = tower.tower()
    heights = np.array([30.0, 87.6, 87.6 + 1.01 * RADIUS_AT_TOP, 150.0])
    points = np.vstack([np.full(4, -5.0), np.zeros(4), heights])
    wind = np.tile([[10.0], [0.0], [0.0]], 4)
    change = disturbed(points, wind, support())[0] - 10.0
    radius = 0.5 * (t.base_diameter + (t.top_diameter - t.base_diameter) * np.minimum(heights / 87.6, 1.0))
    assert change[:2] == pytest.approx(-10.0 * (radius[:2] / 5.0) ** 2)
    assert change[2:] == pytest.approx([0.0, 0.0], abs=1e-9)


def test_blade_in_front_of_the_tower_loses_load(aero_fmu: Loaded) -> None:
    """The blade that hangs down, 5 m and more before the tower, feels it; the two above do not."""
    hub = {"hub.position[1]": -5.0, "hub.position[3]": 90.0}
    given = settings(wind=10.0, speed=11.0 * RPM, axes=TILTED, rotor__azimuth=np.pi, dynamic_inflow=False) | hub
    off, on = (Run(aero_fmu, given | {"tower_influence": switch}).settle(0.5) for switch in (False, True))
    loss = 1.0 - np.array([on[f"blade{k}.root_moment[2]"] / off[f"blade{k}.root_moment[2]"] for k in (1, 2, 3)])
    # (radius / distance)^2 = (2.4 m / 8 m)^2 = 9 % of the wind halfway down the blade, which makes some 7 % of the
    # angle of attack's wind and of the load.
    assert 0.02 < loss[0] < 0.12
    assert np.abs(loss[1:]).max() < 2e-3


# --- drag -----------------------------------------------------------------------------------------------------------


def test_drag_of_a_still_tower_is_its_integral(aero: Equations) -> None:
    """f = 1/2 rho C_d D V^2 with the power law, which Gauss' eight points integrate."""
    got = loads(aero, still(20.0, 0.2) | {"tower_drag_coefficient": 0.7})
    z = np.linspace(0.0, 87.6, 200_001)
    wind = 20.0 * (np.maximum(z, 0.1) / 90.0) ** 0.2
    f = 0.5 * 1.225 * 0.7 * (6.0 + (3.87 - 6.0) * z / 87.6) * wind**2
    # z^0.4 has no derivative at the sea: 5e-4 for eight points.
    assert got["tower.force[1]"] == pytest.approx(np.trapezoid(f, z), rel=1e-3)
    assert got["tower.moment[2]"] == pytest.approx(np.trapezoid(f * z, z), rel=1e-5)
    shape = Polynomial([0.0, 0.0, *tower.tower().axis.coefficients[0]])(z / 87.6)
    assert got["tower.modal_force[1]"] == pytest.approx(np.trapezoid(f * shape, z), rel=1e-5)
    others = ["force[2]", "force[3]", "moment[1]", "moment[3]", "modal_force[3]", "modal_force[4]"]
    assert all(got[f"tower.{name}"] == pytest.approx(0.0, abs=1e-6) for name in others)


def test_air_takes_energy_from_a_tower_that_moves_in_it(aero: Equations) -> None:
    """Power of the loads on the moving platform and modes = -1/2 rho C_d integral of D |v|^3; here only the bending and
    the sway of a tower whose points' velocity across it is known."""
    speed, rate = 0.8, np.array([1.5, 0.0, 0.0, 0.0])
    motion = {"platform.velocity[1]": speed, "tower.deflection_rate[1]": rate[0]}
    got = loads(aero, still(0.0) | motion)
    power = got["tower.force[1]"] * speed + vector(got, "tower.modal_force", 4) @ rate
    z = np.linspace(0.0, 87.6, 20_001)
    shape = Polynomial([0.0, 0.0, *tower.tower().axis.coefficients[0]])(z / 87.6)
    v = speed + rate[0] * shape
    lost = np.trapezoid(0.5 * 1.225 * (6.0 + (3.87 - 6.0) * z / 87.6) * np.abs(v) ** 3, z)
    assert power == pytest.approx(-lost, rel=1e-8)  # trapezoidal rule


def test_work_of_the_drag_is_complete(aero: Equations) -> None:
    """Everything moves, bends and turns. In still air each strip loses energy: the power is below zero and, since the
    drag turns with the motion, even in it: reversing all rates reverses all loads."""
    rng = np.random.default_rng(5)
    pose = {f"platform.rotation[{i}]": 0.1 * rng.normal() for i in (1, 2, 3)}
    pose |= {f"tower.deflection[{i}]": 0.5 * rng.normal() for i in (1, 2, 3, 4)}
    rates = {
        f"platform.{n}[{i}]": a * rng.normal()
        for n, a in (("velocity", 1.0), ("angular_velocity", 0.02))
        for i in (1, 2, 3)
    }
    rates |= {f"tower.deflection_rate[{i}]": rng.normal() for i in (1, 2, 3, 4)}

    def power(got: dict[str, float], rates: dict[str, float]) -> float:
        pairs = (("force", "platform.velocity"), ("moment", "platform.angular_velocity"))
        work = sum(vector(got, f"tower.{load}") @ vector(rates, rate) for load, rate in pairs)
        return float(work + vector(got, "tower.modal_force", 4) @ vector(rates, "tower.deflection_rate", 4))

    there, back = (loads(aero, still(0.0) | pose | {k: s * v for k, v in rates.items()}) for s in (1.0, -1.0))
    assert power(there, rates) < -100.0
    for name in ("force", "moment"):
        assert vector(back, f"tower.{name}") == pytest.approx(-vector(there, f"tower.{name}"), rel=1e-9)
    # The same power from the strips themselves.
    figures = tower.strips(tower.tower())
    b = ca.MX.sym("b", tower.SUPPORT.size)
    strips = ca.Function("strips", [b], [tower.strip_motion(b, figures)])
    euler = vector(pose, "platform.rotation")
    axes = np.asarray(ca.DM(tower._rotation(ca.DM(euler))))
    column = support(
        axes=axes, velocity=axes.T @ vector(rates, "platform.velocity"),
        omega=axes.T @ vector(rates, "platform.angular_velocity"),
        deflection=vector(pose, "tower.deflection", 4), rate=vector(rates, "tower.deflection_rate", 4),
    )  # fmt: skip
    s = tower.STRIP_MOTION.unpack(strips(column).full())
    across = s.velocity - (s.velocity * s.direction).sum(axis=0) * s.direction
    c = tower.STRIP.unpack(figures.full())
    lost = 0.5 * 1.225 * np.sum(c.diameter * c.length * np.linalg.norm(across, axis=0) ** 3)
    assert power(there, rates) == pytest.approx(-lost, rel=1e-12)
    # And their velocity is the rate of their position.
    h = 1e-4
    ahead, behind = (
        tower.STRIP_MOTION.unpack(
            strips(support(axes=axes, deflection=vector(pose, "tower.deflection", 4) + d * column[-4:])).full()
        ).position
        for d in (h, -h)
    )
    bending = (ahead - behind) / (2 * h)  # exact: the position is quadratic
    rigid = column[12:15, None] + np.cross(column[15:18], s.position, axis=0)
    assert s.velocity == pytest.approx(rigid + bending, abs=1e-8)


def test_platform_axes_and_top_agree_with_the_barge(aero: Equations) -> None:
    """Order of roll, pitch and yaw, and the tower's modes, are those of the component that moves them."""
    i = Instance(barge())
    names = ("roll", "pitch", "yaw", "tower_fore_aft")
    i.set({f"initial.{name}": v for name, v in zip(names, (0.05, -0.1, 0.2, 0.7), strict=True)})
    i.initialise()
    top = tower.tower().axis
    x = np.array([1.0])
    q = np.array([0.7, 0.0])
    s = top.shapes(0, x)
    along, fall = s.shape[0] @ q, 0.5 * q @ s.shortening[0] @ q
    axes = np.asarray(ca.DM(tower._rotation(ca.DM([0.05, -0.1, 0.2]))))
    expected = axes @ [along, 0.0, top.base_height + top.length - fall]
    # From the tower top to the apex in the frame that the top's slope turns.
    slope = s.slope[0] @ q
    turn = np.array([[np.cos(slope), 0.0, np.sin(slope)], [0.0, 1.0, 0.0], [-np.sin(slope), 0.0, np.cos(slope)]])
    tilt = np.radians(5.0)
    arm = np.array([-5.0191 * np.cos(tilt), 0.0, 1.96256 + 5.0191 * np.sin(tilt)])
    assert vector(i.outputs(), "hub.position") == pytest.approx(expected + axes @ turn @ arm, rel=1e-6)


def test_both_are_off_by_default(aero: Equations) -> None:
    i = Instance(aero)
    i.set(settings(wind=15.0, speed=1.2))
    i.initialise()
    i.do_step(STEP)
    assert all(i.get(f"tower.{n}[{k}]") == 0.0 for n in ("force", "moment", "modal_force") for k in (1, 2, 3))
