"""The barge's equations of motion against Lagrange's equations, conservation laws and closed forms."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from fmus_src.barge.model import component
from fmus_src.barge.parameters import PLATFORM, RELATIVE
from fmus_src.barge.turbine import DATA, load, nrel_5mw_barge
from fmus_src.equations import Equations, derive
from fmus_src.instance import Instance

G = 9.80665
NO_ADDED_MASS = {f"added_mass[{i},{j}]": 0.0 for i in range(1, 7) for j in range(1, 7)}
UNDAMPED = {f"tower.{d}_damping[{i}]": 0.0 for d in ("fore_aft", "side") for i in (1, 2)} | {"drivetrain.damping": 0.0}
TILT, CONE = np.radians(5.0), np.radians(-2.5)
BLADE = {"m": 17740.0, "cm": 20.475, "I": 11776047.0, "R": 1.5}
ROTOR_MASS = 56780.0 + 3 * BLADE["m"]
ROTOR_INERTIA = 115926.0 + 3 * np.cos(CONE) ** 2 * (
    BLADE["I"] + 2 * BLADE["R"] * BLADE["m"] * BLADE["cm"] + BLADE["m"] * BLADE["R"] ** 2
)


@pytest.fixture(scope="module")
def equations() -> Equations:
    return derive(component())


def started(equations: Equations, values: dict[str, float] | None = None, free: tuple[str, ...] | None = None):
    instance = Instance(equations)
    switches = {} if free is None else {f"dof.{n}": float(n in free) for n in (*PLATFORM, *RELATIVE)}
    instance.set(switches | (values or {}))
    instance.initialise()
    return instance


def put(instance: Instance, coordinates: np.ndarray, rates: np.ndarray) -> None:
    """Set the state; storage order is position, rotation, velocity, rotation rate, relative, relative rate."""
    x = instance._values["x"]
    x[0:6], x[6:12], x[12:18], x[18:24] = coordinates[:6], rates[:6], coordinates[6:], rates[6:]


def accelerations(instance: Instance) -> np.ndarray:
    rate = instance.derivative()
    return np.concatenate([rate[6:12], rate[18:24]])


def vector(outputs: dict[str, float], name: str) -> np.ndarray:
    return np.array([outputs[f"{name}[{i}]"] for i in (1, 2, 3)])


def turn(axis: int, angle: ca.SX) -> ca.SX:
    c, s = ca.cos(angle), ca.sin(angle)
    if axis == 0:
        return ca.blockcat([[1, 0, 0], [0, c, -s], [0, s, c]])
    return (
        ca.blockcat([[c, 0, s], [0, 1, 0], [-s, 0, c]])
        if axis == 1
        else ca.blockcat([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    )


class Kinematics:
    """Positions and orientations of all parts as functions of the coordinates, from rotation matrices alone.

    Order of the coordinates: surge, sway, heave, roll, pitch, yaw, 2 fore-aft, 2 side-to-side, generator, torsion.
    Each blade is three point masses on its axis with the blade's mass, first and second moments about the apex.
    """

    def __init__(self) -> None:
        self.q, self.qd, self.qdd = (ca.SX.sym(n, 12) for n in ("q", "qd", "qdd"))
        q, tower = self.q, nrel_5mw_barge().tower
        self.origin = q[:3]
        self.R = turn(2, q[5]) @ turn(1, q[4]) @ turn(0, q[3])

        def tower_point(k: int) -> ca.SX:
            a, b = q[6:8], q[8:10]
            drop = (a.T @ tower.fore_aft.shortening[k] @ a + b.T @ tower.side.shortening[k] @ b) / 2
            x, y = ca.dot(tower.fore_aft.shape[k], a), ca.dot(tower.side.shape[k], b)
            return self.origin + self.R @ ca.vertcat(x, y, tower.height[k] - drop)

        slopes = ca.dot(tower.fore_aft.slope[-1], q[6:8]), ca.dot(tower.side.slope[-1], q[8:10])
        self.top, self.nacelle = tower_point(-1), self.R @ turn(1, slopes[0]) @ turn(0, -slopes[1])
        self.shaft = self.nacelle @ turn(1, ca.SX(TILT))
        self.apex = self.top + self.nacelle @ ca.vertcat(0, 0, 1.96256) - 5.0191 * self.shaft[:, 0]
        azimuth = q[10] + q[11]
        self.blade_axes = [self.shaft @ turn(0, azimuth + 2 * np.pi * k / 3) @ turn(1, ca.SX(CONE)) for k in range(3)]
        distance = np.array([0.0, 30.0, 60.0])
        first = BLADE["m"] * (BLADE["cm"] + BLADE["R"])
        second = BLADE["I"] + 2 * BLADE["R"] * BLADE["m"] * BLADE["cm"] + BLADE["m"] * BLADE["R"] ** 2
        mass = np.linalg.solve(np.vander(distance, 3, increasing=True).T, [BLADE["m"], first, second])
        self.blades = [
            [(m, self.apex + s * A[:, 2]) for s, m in zip(distance, mass, strict=True)] for A in self.blade_axes
        ]
        self.above = [(m, tower_point(k)) for k, m in enumerate(tower.mass)]
        self.above += [(240000.0, self.top + self.nacelle @ ca.vertcat(1.9, 0, 1.75)), (56780.0, self.apex)]
        self.above += [point for blade in self.blades for point in blade]
        self.platform = (5.452e6, self.origin + self.R @ ca.vertcat(0, 0, -0.281768))
        # (axes, principal inertias) of what is not made of point masses
        self.above_spin = [
            (self.nacelle, [0, 0, 2607890.0 - 240000.0 * 1.9**2]),
            (self.shaft @ turn(0, azimuth), [115926.0, 0, 0]),
            (self.shaft @ turn(0, 97 * q[10]), [534.116, 0, 0]),
        ]

    def rate(self, value: ca.SX) -> ca.SX:
        return ca.jtimes(value, self.q, self.qd)

    def second_rate(self, value: ca.SX) -> ca.SX:
        velocity = self.rate(value)
        return ca.jtimes(velocity, self.q, self.qd) + ca.jtimes(velocity, self.qd, self.qdd)

    def spin(self, A: ca.SX) -> ca.SX:
        """Angular velocity of a body with axes A, in its own axes."""
        S = A.T @ ca.reshape(self.rate(ca.vec(A)), 3, 3)
        return ca.vertcat(S[2, 1], S[0, 2], S[1, 0])


def lagrangian() -> tuple[ca.Function, ca.Function]:
    """Lagrange's equations (M, f) and the energy of the undamped structure with a constant upward force at the PRP."""
    b, t, lift = Kinematics(), nrel_5mw_barge(), ca.SX.sym("lift")
    q, qd = b.q, b.qd
    masses = [*b.above, b.platform]
    spins = [*b.above_spin, (b.R, [726.9e6, 726.9e6, 1453.9e6])]
    T = sum(m * ca.sumsqr(b.rate(r)) / 2 for m, r in masses)
    T += sum(ca.dot(ca.SX(inertia), b.spin(A) ** 2) / 2 for A, inertia in spins)
    V = sum(m * G * r[2] for m, r in masses) - lift * q[2] + 867.637e6 * q[11] ** 2 / 2
    for stiffness, mode in ((t.tower.fore_aft.stiffness, q[6:8]), (t.tower.side.stiffness, q[8:10])):
        V += mode.T @ stiffness @ mode / 2
    momentum = ca.gradient(T, qd)
    M = ca.jacobian(momentum, qd)
    force = ca.gradient(T - V, q) - ca.jacobian(momentum, q) @ qd
    return ca.Function("system", [q, qd, lift], [M, force]), ca.Function("energy", [q, qd, lift], [T + V])


def section_loads(b: Kinematics) -> dict[str, ca.SX]:
    """Loads and accelerations from the rates of linear and angular momentum about the global origin."""
    gravity = ca.vertcat(0, 0, -G)

    def load_about(point: ca.SX, masses: list, spins: list) -> tuple[ca.SX, ca.SX]:
        momentum = sum(ca.cross(r, m * b.rate(r)) for m, r in masses)
        momentum += sum((A @ (ca.SX(inertia) * b.spin(A)) for A, inertia in spins), ca.SX.zeros(3))
        change = ca.jtimes(momentum, b.q, b.qd) + ca.jtimes(momentum, b.qd, b.qdd)
        force = sum(m * (gravity - b.second_rate(r)) for m, r in masses)
        moment = sum(ca.cross(r, m * gravity) for m, r in masses) - change
        return force, moment - ca.cross(point, force)

    force, moment = load_about(b.origin, b.above, b.above_spin)
    roots = []
    for blade, A in zip(b.blades, b.blade_axes, strict=True):
        roots.append(A.T @ load_about(b.apex + BLADE["R"] * A[:, 2], blade, [])[1])
    imu = b.top + b.nacelle @ ca.vertcat(-3.09528, 0, 2.23336)
    damper = b.origin + b.R @ ca.vertcat(3, -2, 1)
    return {
        "base_force": b.R.T @ force, "base_moment": b.R.T @ moment, "roots": ca.horzcat(*roots)[:2, :],
        "top": b.nacelle[:, 0].T @ b.second_rate(b.top), "imu": b.shaft[:, 0].T @ b.second_rate(imu),
        "platform_damper": b.R.T @ (b.second_rate(damper) - gravity),
        "nacelle_spin": b.spin(b.nacelle), "hub_velocity": b.rate(b.apex),
    }  # fmt: skip


@pytest.fixture(scope="module")
def lagrange() -> tuple[ca.Function, ca.Function]:
    return lagrangian()


def violent(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """A state far from equilibrium: angles of half a radian, metres of tower deflection, all rates large."""
    rng = np.random.default_rng(seed)
    q = rng.uniform(-1, 1, 12) * [5, 5, 5, 0.6, 0.6, 0.6, 2, 0.1, 2, 0.1, 3, 0.01]
    return q, rng.uniform(-1, 1, 12) * [3, 3, 3, 0.3, 0.3, 0.3, 2, 0.3, 2, 0.3, 1.5, 0.05]


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_accelerations_are_those_of_lagranges_equations(equations, lagrange, seed):
    q, qd = violent(seed)
    instance = started(equations, NO_ADDED_MASS | UNDAMPED | {"hydro.force[3]": 4e7})
    put(instance, q, qd)
    M, force = (np.asarray(v) for v in lagrange[0](q, qd, 4e7))
    expected = np.linalg.solve(M, force).ravel()
    # Both are exact; what remains is round-off times the mass matrix' condition (about 1e7).
    np.testing.assert_allclose(accelerations(instance), expected, rtol=1e-7, atol=1e-8)


def test_energy_drifts_at_the_order_of_the_integrator_only(equations, lagrange):
    energy, q, qd = lagrange[1], *violent(4)

    def drift(step: float) -> float:
        instance = started(equations, NO_ADDED_MASS | UNDAMPED | {"hydro.force[3]": 6.03e7})
        put(instance, q, qd)
        for _ in range(round(2.0 / step)):
            instance.do_step(step)
        x = instance._values["x"]
        end = energy(np.r_[x[:6], x[12:18]], np.r_[x[6:12], x[18:24]], 6.03e7)
        return abs(float(end - energy(q, qd, 6.03e7)))

    coarse, fine = drift(0.0125), drift(0.00625)
    kinetic_scale = 1e8  # J, of this motion
    assert coarse < 1e-4 * kinetic_scale
    # Runge-Kutta 4 loses energy at order 4 to 5: halving the step divides the drift by 16 to 32.
    assert 12 < coarse / fine < 40


def test_free_fall_leaves_every_part_weightless(equations):
    instance = started(
        equations, NO_ADDED_MASS | {"initial.pitch": 0.3, "initial.roll": -0.2, "initial.rotor_speed": 1.2}
    )
    out = instance.outputs()
    # No relative acceleration, hence no specific force and no load at the tower base (weight 6.8e6 N) to round-off.
    np.testing.assert_allclose(accelerations(instance), [0, 0, -G, *[0] * 9], atol=1e-9)
    np.testing.assert_allclose(vector(out, "nacelle_damper.specific_force"), 0, atol=1e-9)
    assert max(abs(out[f"TwrBsF{a}t"]) for a in "xyz") < 1e-2


def test_response_is_reciprocal_and_positive(equations):
    """Betti: the map from loads to accelerations at their points is symmetric; kinetic energy: it is not negative."""
    instance = started(equations, {"initial.pitch": 0.2, "initial.yaw": 0.4})
    instance._values["x"][12:16] = [1.5, 0.05, -1.0, 0.03]
    ports = [(f"{p}.{q}", r) for p, r in (
        ("hydro", ("platform.acceleration", "platform.angular_acceleration")),
        ("nacelle_damper", ("nacelle_damper.specific_force", "nacelle_damper.angular_acceleration")),
        ("platform_damper", ("platform_damper.specific_force", "platform_damper.angular_acceleration")),
    ) for q, r in zip(("force", "moment"), r, strict=True)]  # fmt: skip

    def response() -> np.ndarray:
        out = instance.outputs()
        return np.concatenate([vector(out, name) for _, name in ports])

    rest, columns = response(), []
    for load_name, _ in ports:
        for i in (1, 2, 3):
            instance.set({f"{load_name}[{i}]": 1e6})
            columns.append((response() - rest) / 1e6)
            instance.set({f"{load_name}[{i}]": 0.0})
    compliance = np.array(columns)
    size = np.sqrt(np.outer(np.diag(compliance), np.diag(compliance)))
    # Differences of accelerations of order g: 1e-16 g / (1e6 N) against compliances of 1e-10 to 1e-7 per N.
    np.testing.assert_allclose(compliance / size, compliance.T / size, atol=1e-8)
    assert np.linalg.eigvalsh((compliance + compliance.T) / (2 * size)).min() > -1e-8


def test_added_mass_adds_to_the_platforms_own(equations):
    # All but one platform axis locked, so that the rigid turbine's mass or inertia about the PRP stays.
    added = np.asarray(next(v for v in equations.variables if v.name == "added_mass").start).reshape(6, 6)
    assert np.diag(added).min() > 0
    total = 5.452e6 + 240000.0 + ROTOR_MASS + nrel_5mw_barge().tower.mass.sum()
    for i, name in ((0, "surge"), (2, "heave")):
        instance = started(equations, {f"hydro.force[{i + 1}]": 1e6, "gravity": 0.0}, free=(name,))
        assert accelerations(instance)[i] == pytest.approx(1e6 / (total + added[i, i]), rel=1e-12)


def test_added_mass_is_the_force_of_accelerated_water(equations):
    """With any symmetric A: the same motion follows from -A times the global accelerations, applied as a force."""
    half = np.random.default_rng(7).uniform(-1, 1, (6, 6))
    A = np.diag([1e6, 1e6, 2e7, 1e9, 1e9, 1e8]) + 1e6 * (half + half.T)
    with_mass = {f"added_mass[{i + 1},{j + 1}]": A[i, j] for i in range(6) for j in range(6)}
    instance = started(equations, with_mass)
    put(instance, *violent(6))
    out, moving = instance.outputs(), accelerations(instance)
    load = -A @ np.r_[vector(out, "platform.acceleration"), vector(out, "platform.angular_acceleration")]
    names = [f"hydro.{q}[{i}]" for q in ("force", "moment") for i in (1, 2, 3)]
    forced = started(equations, NO_ADDED_MASS | dict(zip(names, load.tolist(), strict=True)))
    put(forced, *violent(6))
    np.testing.assert_allclose(accelerations(forced), moving, rtol=1e-8, atol=1e-9)


def test_section_loads_are_rates_of_momentum(equations):
    kinematics = Kinematics()
    expected = section_loads(kinematics)
    names = list(expected)
    function = ca.Function("loads", [kinematics.q, kinematics.qd, kinematics.qdd], list(expected.values()))
    position = {f"platform_damper.attachment[{i}]": v for i, v in ((1, 3.0), (2, -2.0), (3, 1.0))}
    instance = started(equations, position | {"hydro.force[3]": 6e7, "servo.generator_torque": 4e4})
    q, qd = violent(8)
    put(instance, q, qd)
    values = function(q, qd, accelerations(instance))
    exact = {n: np.asarray(v).squeeze() for n, v in zip(names, values, strict=True)}
    out = instance.outputs()

    def close(actual: object, name: str) -> None:
        # Round-off only: sums of terms of the size of the largest component.
        np.testing.assert_allclose(actual, exact[name], atol=1e-8 * np.abs(exact[name]).max())

    close([out[f"TwrBsF{a}t"] for a in "xyz"], "base_force")
    close([out[f"TwrBsM{a}t"] for a in "xyz"], "base_moment")
    close([[out[f"RootM{a}c{k}"] for k in (1, 2, 3)] for a in "xy"], "roots")
    close(out["YawBrTAxp"], "top")
    close(out["NcIMUTAxs"], "imu")
    close(vector(out, "platform_damper.specific_force"), "platform_damper")
    close(vector(out, "nacelle_damper.angular_velocity"), "nacelle_spin")
    close(vector(out, "hub.velocity"), "hub_velocity")


def test_locked_degrees_of_freedom_stay_put_exactly(equations):
    free = ("roll", "pitch", "tower_fore_aft_1", "generator")
    loads = {"hydro.moment[1]": 1e8, "hydro.moment[2]": -1e8, "hydro.moment[3]": 1e8, "hydro.force[1]": 1e6}
    instance = started(equations, loads | {"aero.force[1]": 5e5, "initial.rotor_speed": 1.0}, free=free)
    start = instance._values["x"].copy()
    for _ in range(40):
        instance.do_step(0.0125)
    moved = instance._values["x"] - start
    names = (*PLATFORM, *RELATIVE)
    where = [*range(6), *range(12, 18)]
    for name, i in zip(names, where, strict=True):
        assert (moved[i] != 0.0) == (name in free), name


def test_specific_force_is_the_velocitys_derivative(equations):
    """Attached at the rotor apex, the damper's specific force is d(hub.velocity)/dt - g; likewise its rotation."""
    at_apex = {"nacelle_damper.attachment[1]": -5.0191 * np.cos(TILT),
               "nacelle_damper.attachment[3]": 87.6 + 1.96256 + 5.0191 * np.sin(TILT)}  # fmt: skip
    instance = started(equations, at_apex | {"hydro.force[3]": 6e7, "aero.force[1]": 4e5})
    put(instance, *violent(5))
    x, rate, h = instance._values["x"].copy(), instance.derivative(), 1e-6
    now = instance.outputs()
    assert np.linalg.norm(vector(now, "hub.angular_velocity")) > 0.1

    def at(state: np.ndarray, name: str) -> np.ndarray:
        instance._values["x"] = state
        return vector(instance.outputs(), name)

    shaft = np.array([now[f"hub.orientation[{i}]"] for i in range(1, 10)]).reshape(3, 3)
    nacelle = shaft @ np.asarray(ca.DM(turn(1, ca.SX(-TILT))))
    for of, output, gravity in (
        ("hub.position", "hub.velocity", None),
        ("hub.velocity", "nacelle_damper.specific_force", [0, 0, G]),
        ("hub.angular_velocity", "nacelle_damper.angular_acceleration", [0, 0, 0]),
    ):
        slope = (at(x + h * rate, of) - at(x - h * rate, of)) / (2 * h)
        value = vector(now, output)
        expected = value if gravity is None else nacelle @ value - gravity
        # Central differences of steps 1e-6 s: round-off 1e-16 * 100 m / 1e-6 s.
        np.testing.assert_allclose(slope, expected, atol=1e-7)


def test_yawing_turns_the_rotors_spin_into_a_pitching_moment(equations):
    """Steady precession: the base carries -(I Omega + n J Omega) psi' cos(tilt) about y."""
    speed, yaw_rate = 1.2671, 0.05

    def moment(spin: float) -> float:
        instance = started(equations, {"initial.rotor_speed": spin}, free=())
        instance._values["x"][11] = yaw_rate
        return instance.get("TwrBsMyt")

    expected = -(ROTOR_INERTIA + 97 * 534.116) * speed * yaw_rate * np.cos(TILT)
    assert (moment(speed) - moment(-speed)) / 2 == pytest.approx(expected, rel=1e-9)


def test_tower_base_carries_the_weight_at_rest(equations):
    out = started(equations, free=()).outputs()
    apex = -5.0191 * np.cos(TILT)
    offset = 3 * np.sin(CONE) * BLADE["m"] * (BLADE["cm"] + BLADE["R"]) / ROTOR_MASS
    weight = G * (nrel_5mw_barge().tower.mass.sum() + 240000.0 + ROTOR_MASS)
    moment = G * (240000.0 * 1.9 + ROTOR_MASS * (apex + offset * np.cos(TILT)))
    assert out["TwrBsFzt"] == pytest.approx(-weight, rel=1e-12)
    assert out["TwrBsMyt"] == pytest.approx(moment, rel=1e-9)
    assert out["nacelle_damper.specific_force[3]"] == pytest.approx(G)


def test_tower_under_steady_thrust(equations):
    """At the bent tower's equilibrium the base moment is thrust times height plus displaced weight (P-delta)."""
    free = ("tower_fore_aft_1", "tower_fore_aft_2")
    thrust = 8e5
    instance = started(equations, {"aero.force[1]": thrust}, free=free)
    x = instance._values["x"]
    for _ in range(4):  # Newton; nearly linear
        residual = instance.derivative()[18:20]
        jacobian = np.empty((2, 2))
        for j in range(2):
            x[12 + j] += 1e-4
            jacobian[:, j] = (instance.derivative()[18:20] - residual) / 1e-4
            x[12 + j] -= 1e-4
        x[12:14] -= np.linalg.solve(jacobian, residual)
    out, tower = instance.outputs(), nrel_5mw_barge().tower
    deflected = tower.fore_aft.shape @ x[12:14]
    pitch = float(tower.fore_aft.slope[-1] @ x[12:14])
    nacelle_x = deflected[-1] + 1.9 * np.cos(pitch) + 1.75 * np.sin(pitch)
    offset = 3 * np.sin(CONE) * BLADE["m"] * (BLADE["cm"] + BLADE["R"]) / ROTOR_MASS
    rotor_x = out["hub.position[1]"] + offset * np.cos(TILT + pitch)
    expected = thrust * out["hub.position[3]"] + G * (
        240000.0 * nacelle_x + ROTOR_MASS * rotor_x + tower.mass @ deflected[:-1]
    )
    assert out["TwrBsMyt"] == pytest.approx(expected, rel=1e-9)

    # Without gravity the two modes nearly reproduce the beam's own deflection, the integral of M (L - h) / EI, here
    # for the force and the moment that it makes about the tower top. Assumed modes are stiffer: within 2 %.
    table = np.loadtxt(DATA / "tower.csv", delimiter=",", skiprows=2)
    h = np.linspace(0, 1, 20001)
    arm = out["hub.position[3]"] - 87.6
    compliance = ((1 - h) * 87.6 + arm) * (1 - h) * 87.6 / np.interp(h, table[:, 0], table[:, 2])
    beam = thrust * np.trapezoid(compliance, h * 87.6)
    modal = np.linalg.solve(tower.fore_aft.stiffness, [thrust, thrust] + thrust * arm * tower.fore_aft.slope[-1]).sum()
    assert 0.98 * beam < modal <= beam * (1 + 1e-6)


def test_generator_torque_reacts_on_the_nacelle(equations):
    """Between stator and generator T acts; once the shaft is wound up the gearbox passes n T to the nacelle."""
    torque, aero = 4.3e4, 97 * 4.3e4
    along = {"aero.moment[1]": aero * np.cos(TILT), "aero.moment[3]": -aero * np.sin(TILT)}

    def about_shaft(instance: Instance) -> float:
        out = instance.outputs()
        return out["TwrBsMxt"] * np.cos(TILT) - out["TwrBsMzt"] * np.sin(TILT)

    rest = about_shaft(started(equations, free=("generator", "drivetrain")))
    sudden = started(equations, {"servo.generator_torque": torque}, free=("generator", "drivetrain"))
    assert about_shaft(sudden) - rest == pytest.approx(torque, rel=1e-6)
    assert accelerations(sudden)[10] == pytest.approx(-torque / (97 * 534.116), rel=1e-9)
    steady = started(equations, along | {"servo.generator_torque": torque}, free=("generator", "drivetrain"))
    steady._values["x"][17] = aero / 867.637e6
    np.testing.assert_allclose(accelerations(steady)[10:], 0, atol=1e-9)
    assert about_shaft(steady) - rest == pytest.approx(aero, rel=1e-9)


def test_blade_root_moments(equations):
    """Weight and centrifugal force of a coned blade; the air's moment passes through unchanged."""
    weight = BLADE["m"] * BLADE["cm"] * G
    speed = 1.2671
    out = started(equations, {"initial.rotor_speed": speed, "blade1.root_moment[2]": 1e6}, free=()).outputs()
    # Upright blade: leans downwind by tilt + cone; centrifugal force straightens the upwind cone.
    stiffening = BLADE["I"] + BLADE["R"] * BLADE["m"] * BLADE["cm"]
    expected = 1e6 + weight * np.sin(TILT + CONE) - np.sin(CONE) * np.cos(CONE) * speed**2 * stiffening
    assert out["RootMyc1"] == pytest.approx(expected, rel=1e-9)
    level = started(equations, {"initial.azimuth": np.pi / 2}, free=()).outputs()
    assert level["RootMxc1"] == pytest.approx(weight * np.cos(TILT), rel=1e-9)


def test_tower_quadrature_matches_fine_integration():
    tower = nrel_5mw_barge().tower
    for bending in (tower.fore_aft, tower.side):
        shape = bending.shape[:-1]
        # Gauss points are exact for products of two shapes (degree 12).
        np.testing.assert_allclose((shape.T * tower.mass) @ shape, bending.mass, rtol=1e-9)
        # Every shape has unit deflection at the top to the four digits published.
        np.testing.assert_allclose(bending.shape[-1], 1.0, atol=2e-4)
    table = np.loadtxt(DATA / "tower.csv", delimiter=",", skiprows=2)
    h = table[:, 0] * 87.6
    # The line mass is linear between stations, so that the trapezoidal rule gives the mass exactly.
    assert tower.mass.sum() == pytest.approx(np.trapezoid(table[:, 1], h), rel=1e-12)


def test_bad_data_is_named(tmp_path):
    text = (DATA / "turbine.toml").read_text(encoding="utf-8")
    (tmp_path / "turbine.toml").write_text(text.replace("[blade]", "[blades]"), encoding="utf-8")
    (tmp_path / "tower.csv").write_text((DATA / "tower.csv").read_text(encoding="utf-8"), encoding="utf-8")
    with pytest.raises(ValueError, match=r"section \[blade\] is missing"):
        load(tmp_path)
    (tmp_path / "turbine.toml").write_text(text, encoding="utf-8")
    (tmp_path / "tower.csv").write_text("height_fraction,mass_density\n0,1\n0.5,1\n", encoding="utf-8")
    with pytest.raises(ValueError, match="must increase from 0 to 1"):
        load(tmp_path)
