"""Section loads, kinematic outputs and steady states of the barge component: rates of momentum and closed forms."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from fmus_src.barge.model import component
from fmus_src.barge.turbine import DATA, nrel_5mw_barge
from fmus_src.equations import Equations, derive
from fmus_src.instance import Instance
from tests.barge_lagrange import CONE, GEAR, GENERATOR, HUB_INERTIA, HUB_MASS, NACELLE, TILT, G, System, blade_elements
from tests.barge_states import BLADE, SWITCHES, accelerations, named, put, started, vector, violent

ELEMENTS = blade_elements()
BLADE_MASS = ELEMENTS.mass.sum()
BLADE_FIRST, BLADE_SECOND = ELEMENTS.mass @ ELEMENTS.distance, ELEMENTS.mass @ ELEMENTS.distance**2  # about the apex
ROTOR_MASS = HUB_MASS + 3 * BLADE_MASS
RIGID_BLADES = tuple(name for name in SWITCHES if name not in BLADE)
AZIMUTH_AT, TORSION_AT = 17, 18  # among the states
PITCH = (0.1, 0.35, -0.2)


@pytest.fixture(scope="module")
def equations() -> Equations:
    return derive(component())


def outputs_by_momentum(b: System) -> dict[str, ca.MX]:
    """Section loads from the rates of linear and angular momentum about the global origin; motions by derivatives."""
    gravity = ca.DM([0, 0, -G])
    base_force, base_moment = b.load_about(b.origin, b.above)
    top_force, top_moment = b.load_about(b.top, b.carried)
    rotor_force, rotor_moment = b.load_about(b.apex, b.rotor)
    root_forces, root_moments = [], []
    for blade, A in zip(b.blades, b.coned, strict=True):
        force, moment = b.load_about(b.apex + 1.5 * A[:, 2], [blade])
        root_forces.append(A.T @ force)
        root_moments.append(A.T @ moment)

    def acceleration(point: ca.MX) -> ca.MX:
        return b.second_rate(b.rate(point))

    imu = b.top + b.nacelle @ ca.vertcat(-3.09528, 0, 2.23336)
    damper = b.origin + b.R @ ca.vertcat(3, -2, 1)
    return {
        "TwrBsF{}t": b.R.T @ base_force, "TwrBsM{}t": b.R.T @ base_moment,
        "YawBrF{}p": b.top_axes.T @ top_force, "YawBrM{}p": b.top_axes.T @ top_moment,
        "RotThrust": b.shaft[:, 0].T @ rotor_force, "RotTorq": b.shaft[:, 0].T @ rotor_moment,
        **{f"RootF{{}}c{k + 1}": f for k, f in enumerate(root_forces)},
        **{f"RootM{{}}c{k + 1}": m[:2] for k, m in enumerate(root_moments)},
        "YawBrTAxp": b.top_axes[:, 0].T @ acceleration(b.top), "NcIMUTAxs": b.shaft[:, 0].T @ acceleration(imu),
        "platform_damper.specific_force[{}]": b.R.T @ (acceleration(damper) - gravity),
        "nacelle_damper.angular_velocity[{}]": b.spin(b.nacelle), "hub.velocity[{}]": b.rate(b.apex),
        "hub.position[{}]": b.apex, "hub.orientation[{}]": ca.vec(b.shaft.T),
    }  # fmt: skip


def test_section_loads_are_rates_of_momentum(equations):
    """Of deflected, vibrating, pitched blades on a tumbling turbine."""
    system = System(PITCH)
    expected = outputs_by_momentum(system)
    function = ca.Function("loads", [system.q, system.qd, system.qdd], list(expected.values()))
    values = named("platform_damper.attachment", np.array([3.0, -2.0, 1.0])) | named("servo.pitch", np.array(PITCH))
    values |= {"hydro.force[3]": 6e7, "servo.generator_torque": 4e4, "dof.nacelle_yaw": 1.0}
    instance = started(equations, values)
    q, qd = violent(8)
    put(instance, q, qd)
    found = function(q, qd, accelerations(instance))
    out = instance.outputs()
    for name, value in zip(expected, found, strict=True):
        exact = np.asarray(value).ravel()
        labels = "xyz" if "F{}" in name or "M{}" in name else range(1, 10)
        actual = [out[name.format(label)] for _, label in zip(exact, labels, strict=False)]
        # Round-off only: sums of terms of the size of the largest component, or of the weight times 100 m.
        floor = 1e-9 * (1e9 if name[0] in "TYR" and "TA" not in name else 1.0)
        np.testing.assert_allclose(actual, exact, atol=1e-8 * np.abs(exact).max() + floor, err_msg=name)


def test_air_passes_from_roots_and_apex_to_the_tower(equations):
    """Loads of the air enter the sections as they are: nothing else changes while accelerations are locked."""
    rest = started(equations, {"initial.azimuth": 0.4}, free=()).outputs()
    root, moment, thrust = np.array([1e5, -2e4, 3e3]), np.array([4e5, 2e6, 0.0]), 3e5
    loads = named("blade2.root_force", root) | named("blade2.root_moment", moment) | {"aero.force[1]": thrust}
    out = started(equations, {"initial.azimuth": 0.4} | loads, free=()).outputs()
    gained = {name: out[name] - rest[name] for name in out}
    assert [gained[f"RootF{a}c2"] for a in "xyz"] == pytest.approx(root.tolist(), rel=1e-9)
    assert [gained[f"RootM{a}c2"] for a in "xy"] == pytest.approx(moment[:2].tolist(), rel=1e-9)
    assert gained["RotThrust"] == pytest.approx(thrust * np.cos(TILT), rel=1e-9)
    above_top = 1.96256 + 5.0191 * np.sin(TILT)
    assert gained["YawBrFxp"] == pytest.approx(thrust, rel=1e-9)
    assert gained["YawBrMyp"] == pytest.approx(thrust * above_top, rel=1e-9)
    assert gained["TwrBsMyt"] == pytest.approx(thrust * (87.6 + above_top), rel=1e-9)


def test_specific_force_is_the_velocitys_derivative(equations):
    """Attached at the rotor apex, the damper's specific force is d(hub.velocity)/dt - g; likewise its rotation."""
    at_apex = {"nacelle_damper.attachment[1]": -5.0191 * np.cos(TILT),
               "nacelle_damper.attachment[3]": 87.6 + 1.96256 + 5.0191 * np.sin(TILT)}  # fmt: skip
    instance = started(equations, at_apex | {"hydro.force[3]": 6e7, "aero.force[1]": 4e5, "dof.nacelle_yaw": 1.0})
    put(instance, *violent(5))
    x, rate, h = instance._values["x"].copy(), instance.derivative(), 1e-6
    now = instance.outputs()
    assert np.linalg.norm(vector(now, "hub.angular_velocity")) > 0.1

    def at(state: np.ndarray, name: str) -> np.ndarray:
        instance.set_states(state)
        return vector(instance.outputs(), name)

    shaft = np.array([now[f"hub.orientation[{i}]"] for i in range(1, 10)]).reshape(3, 3)
    c, s = np.cos(TILT), np.sin(TILT)
    nacelle = shaft @ np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]])
    for of, output, gravity in (
        ("hub.position", "hub.velocity", None),
        ("hub.velocity", "nacelle_damper.specific_force", [0, 0, G]),
        ("hub.angular_velocity", "nacelle_damper.angular_acceleration", [0, 0, 0]),
    ):
        slope = (at(x + h * rate, of) - at(x - h * rate, of)) / (2 * h)
        value = vector(now, output)
        expected = value if gravity is None else nacelle @ value - gravity
        # Central differences of step 1e-6 s: round-off 1e-16 * 100 m / 1e-6 s, truncation by rates of up to 1e3 rad/s.
        np.testing.assert_allclose(slope, expected, atol=1e-6)


def test_yawing_turns_the_rotors_spin_into_a_pitching_moment(equations):
    """Steady precession: the base carries -(I Omega + n J Omega) psi' cos(tilt) about y."""
    speed, yaw_rate = 1.2671, 0.05
    inertia = HUB_INERTIA + 3 * np.cos(CONE) ** 2 * BLADE_SECOND

    def moment(spin: float) -> float:
        instance = started(equations, {"initial.rotor_speed": spin}, free=())
        instance._values["x"][11] = yaw_rate
        return instance.get("TwrBsMyt")

    expected = -(inertia + GEAR * GENERATOR) * speed * yaw_rate * np.cos(TILT)
    assert (moment(speed) - moment(-speed)) / 2 == pytest.approx(expected, rel=1e-9)


def test_weight_at_rest(equations):
    out = started(equations, free=()).outputs()
    center = ROTOR_MASS * (-5.0191 * np.cos(TILT)) + 3 * np.sin(CONE) * BLADE_FIRST * np.cos(TILT)
    top = G * (NACELLE + ROTOR_MASS)
    moment = G * (NACELLE * 1.9 + center)
    assert out["YawBrFzp"] == pytest.approx(-top, rel=1e-12)
    assert out["TwrBsFzt"] == pytest.approx(-top - G * nrel_5mw_barge().tower.integrals.mass, rel=1e-12)
    assert out["YawBrMyp"] == pytest.approx(moment, rel=1e-9)
    assert out["TwrBsMyt"] == pytest.approx(moment, rel=1e-9)
    assert out["nacelle_damper.specific_force[3]"] == pytest.approx(G)
    # The shaft leans downwind and down by the tilt, so that the rotor's weight has a part along it.
    assert out["RotThrust"] == pytest.approx(G * ROTOR_MASS * np.sin(TILT), rel=1e-9)


def test_tower_under_steady_thrust(equations):
    """At the bent tower's equilibrium the base moment is thrust times height plus displaced weight (P-delta)."""
    free, thrust = ("tower_fore_aft_1", "tower_fore_aft_2"), 8e5
    instance = started(equations, {"aero.force[1]": thrust}, free=free)
    x = instance._values["x"]
    for _ in range(4):  # Newton; nearly linear
        residual = instance.derivative()[28:30]
        jacobian = np.empty((2, 2))
        for j in range(2):
            x[12 + j] += 1e-4
            jacobian[:, j] = (instance.derivative()[28:30] - residual) / 1e-4
            x[12 + j] -= 1e-4
        x[12:14] -= np.linalg.solve(jacobian, residual)
    out, tower = instance.outputs(), nrel_5mw_barge().tower
    deflected = float(tower.fore_aft.shape @ x[12:14])
    pitch = float(tower.fore_aft.slope @ x[12:14])
    nacelle_x = deflected + 1.9 * np.cos(pitch) + 1.75 * np.sin(pitch)
    rotor_x = out["hub.position[1]"] + 3 * np.sin(CONE) * BLADE_FIRST / ROTOR_MASS * np.cos(TILT + pitch)
    bent_tower = float(np.asarray(ca.DM(tower.integrals.shape))[0, :2] @ x[12:14])
    expected = thrust * out["hub.position[3]"] + G * (NACELLE * nacelle_x + ROTOR_MASS * rotor_x + bent_tower)
    assert out["TwrBsMyt"] == pytest.approx(expected, rel=1e-9)

    # Without gravity the two modes nearly reproduce the beam's own deflection, the integral of M (L - h) / EI, here
    # for the force and the moment that it makes about the tower top. Assumed modes are stiffer: within 2 %.
    table = np.loadtxt(DATA / "tower.csv", delimiter=",", skiprows=2)
    h = np.linspace(0, 1, 20001)
    arm = out["hub.position[3]"] - 87.6
    compliance = ((1 - h) * 87.6 + arm) * (1 - h) * 87.6 / np.interp(h, table[:, 0], table[:, 2])
    beam = thrust * np.trapezoid(compliance, h * 87.6)
    modal = np.linalg.solve(tower.fore_aft.stiffness, [thrust, thrust] + thrust * arm * tower.fore_aft.slope).sum()
    assert 0.98 * beam < modal <= beam * (1 + 1e-6)


def test_generator_torque_reacts_on_the_nacelle(equations):
    """Between stator and generator T acts; once the shaft is wound up the gearbox passes n T to the nacelle."""
    torque, aero = 4.3e4, GEAR * 4.3e4
    along = {"aero.moment[1]": aero * np.cos(TILT), "aero.moment[3]": -aero * np.sin(TILT)}
    free = ("generator", "drivetrain")

    def about_shaft(instance: Instance) -> float:
        out = instance.outputs()
        return out["TwrBsMxt"] * np.cos(TILT) - out["TwrBsMzt"] * np.sin(TILT)

    rest = about_shaft(started(equations, free=free))
    sudden = started(equations, {"servo.generator_torque": torque}, free=free)
    assert about_shaft(sudden) - rest == pytest.approx(torque, rel=1e-6)
    assert accelerations(sudden)[11] == pytest.approx(-torque / (GEAR * GENERATOR), rel=1e-9)
    steady = started(equations, along | {"servo.generator_torque": torque}, free=free)
    steady._values["x"][TORSION_AT] = aero / 867.637e6
    np.testing.assert_allclose(accelerations(steady)[11:13], 0, atol=1e-9)
    assert about_shaft(steady) - rest == pytest.approx(aero, rel=1e-9)
    assert steady.get("RotTorq") == pytest.approx(aero, rel=1e-9)


def test_shaft_torsion_moment_is_the_springs(equations):
    """Any motion, torsion free: what the rotor passes on by inertia is what drivetrain spring and damper carry."""
    instance = started(equations, {"hydro.force[3]": 6e7, "servo.generator_torque": 4e4, "aero.moment[1]": 3e6})
    q, qd = violent(9)
    put(instance, q, qd)
    assert instance.get("RotTorq") == pytest.approx(867.637e6 * q[12] + 6.215e6 * qd[12], rel=1e-8)


def test_root_moments_of_rigid_blades(equations):
    """Weight and centrifugal force of a coned blade."""
    speed, to_root = 1.2671, BLADE_FIRST - 1.5 * BLADE_MASS
    out = started(equations, {"initial.rotor_speed": speed}, free=()).outputs()
    # Upright blade: leans downwind by tilt + cone; centrifugal force straightens the upwind cone.
    stiffening = BLADE_SECOND - 1.5 * BLADE_FIRST
    expected = to_root * G * np.sin(TILT + CONE) - np.sin(CONE) * np.cos(CONE) * speed**2 * stiffening
    assert out["RootMyc1"] == pytest.approx(expected, rel=1e-9)
    level = started(equations, {"initial.azimuth": np.pi / 2}, free=()).outputs()
    assert level["RootMxc1"] == pytest.approx(to_root * G * np.cos(TILT), rel=1e-9)


def test_pitched_blade_bends_in_its_own_directions(equations):
    """Tip deflections of one modal shape turn with the pitch: at 90 degrees, flap has become in-plane."""
    found = {}
    for pitch in (0.0, np.pi / 2):
        instance = started(equations, {"servo.pitch[1]": pitch})
        instance._values["x"][19:22] = [2.0, 0.0, 0.0]
        found[pitch] = instance.get("OoPDefl1"), instance.get("IPDefl1")
    straight, feathered = found.values()
    # x_b = -y_c and y_b = x_c at 90 degrees.
    assert feathered == pytest.approx((straight[1], -straight[0]), abs=1e-12)
    assert straight[0] == pytest.approx(2.0, rel=0.02)  # unit tip deflection but for the twist


def test_yaw_bearing_turns_all_of_the_nacelle(equations):
    """At 90 degrees of nacelle yaw the overhung rotor is at the side, the damper's frame too."""
    instance = started(equations, {"initial.azimuth": 0.0}, free=())
    instance._values["x"][16] = np.pi / 2
    out = instance.outputs()
    assert out["hub.position[1]"] == pytest.approx(0.0, abs=1e-12)
    assert out["hub.position[2]"] == pytest.approx(-5.0191 * np.cos(TILT))
    moved = named("nacelle_damper.force", np.array([1e5, 0.0, 0.0]))
    pushed = started(equations, moved, free=())
    pushed._values["x"][16] = np.pi / 2
    assert pushed.get("YawBrFyp") - out["YawBrFyp"] == pytest.approx(1e5)
    turned = started(equations, moved | {"nacelle_damper.attachment[2]": -3.0}, free=("nacelle_yaw",))
    turned._values["x"][16] = 0.01
    # A force along the nacelle's x at y = -3 m turns it by +; the spring pulls back.
    assert turned.get("YawBrMzp") == pytest.approx(9.02832e9 * 0.01, rel=1e-9)
