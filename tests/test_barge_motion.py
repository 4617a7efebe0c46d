"""The barge's equations of motion against Lagrange's equations and conservation laws."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from fmus_src.barge.model import component
from fmus_src.barge.parameters import BLADE
from fmus_src.barge.turbine import nrel_5mw_barge
from fmus_src.equations import Equations, derive
from tests.barge_lagrange import G, System, lagrange
from tests.barge_states import NAMES, SWITCHES, UNDAMPED, accelerations, named, put, started, taken, vector, violent

PITCH = (0.1, 0.35, -0.2)
PITCHED = named("servo.pitch", np.array(PITCH))


@pytest.fixture(scope="module")
def equations() -> Equations:
    return derive(component())


@pytest.fixture(scope="module")
def system() -> System:
    return System(PITCH)


@pytest.fixture(scope="module")
def exact(system) -> tuple[ca.Function, ca.Function]:
    return lagrange(system)


@pytest.mark.parametrize(
    "locked",
    [(), BLADE, ("roll", "tower_side_2", "blade_flap_2"), ("pitch", "drivetrain", "nacelle_yaw", "blade_edge_1")],
)
def test_accelerations_are_those_of_lagranges_equations(equations, exact, locked):
    """In all 22 coordinates, with rigid blades, and with others locked: Lagrange's equations of the free ones."""
    q, qd = violent(1 + len(locked))
    free = np.array([name not in locked for name in NAMES])
    qd = np.where(free, qd, 0.0)
    switches = tuple(name for name in SWITCHES if name not in locked)
    instance = started(equations, UNDAMPED | PITCHED | {"hydro.force[3]": 4e7}, free=switches)
    put(instance, q, qd)
    M, force = (np.asarray(v) for v in exact[0](q, qd, 4e7))
    expected = np.zeros(22)
    expected[free] = np.linalg.solve(M[np.ix_(free, free)], force[free]).ravel()
    # Both are exact; what remains is round-off times the mass matrix' condition (about 1e5), of the largest, 1e4 m/s2.
    np.testing.assert_allclose(accelerations(instance), expected, rtol=1e-9, atol=1e-8)
    assert np.all(accelerations(instance)[~free] == 0.0)


def test_energy_of_the_free_turbine_is_kept(equations, exact):
    """All 22 coordinates free, spinning, blades and tower ringing, drifting and tumbling for 10 s."""
    every, load = {"hydro.force[3]": 6.03e7, "dof.nacelle_yaw": 1.0}, 6.03e7
    rng = np.random.default_rng(4)
    q = rng.uniform(-1, 1, 22) * [1, 1, 1, 0.1, 0.1, 0.1, 0.3, 0.02, 0.3, 0.02, 0, 3, 0.004, *[2, 0.1, 0.3] * 3]
    qd = np.zeros(22)
    qd[[3, 4, 5, 11]] = 0.02, 0.05, 0.03, 1.2

    def drift(step: float) -> float:
        instance = started(equations, UNDAMPED | PITCHED | every)
        put(instance, q, qd)
        for _ in range(round(10.0 / step)):
            instance.do_step(step)
        return abs(float(exact[1](*taken(instance), load) - exact[1](q, qd, load)))

    # The blades' bending holds 2e4 J, their spin 3e7 J. Runge-Kutta 4 loses energy at order 5 in the step, so that
    # halving it divides the drift by 32: nothing else drifts.
    coarse, fine = drift(0.01), drift(0.005)
    assert fine < 1e-3 * 2e4
    assert 28 < coarse / fine < 36


def test_energy_goes_where_air_and_dampers_send_it(equations, exact):
    """Power of the air's forces on the elements = power of apex load and modal forces, in any state, coordinate by
    coordinate: what the loads add to the accelerations, times the mass matrix, is the elements' generalised force."""
    system = System(PITCH)
    rng = np.random.default_rng(3)
    q, qd = violent(11)
    chosen = rng.choice(system.elements.mass.size, 12, replace=False)
    part = type(system.elements)(
        *(getattr(system.elements, n)[chosen] for n in ("mass", "distance", "shape", "shortening"))
    )
    positions = [
        ca.repmat(system.apex, 1, 12) + A @ part.position(mode)
        for A, (mode, _) in zip(system.blade_axes, system.modes, strict=True)
    ]
    forces = rng.normal(size=(3, 3, 12)) * 1e5
    power = sum(ca.dot(system.rate(ca.vec(p)), ca.DM(f.T.ravel())) for p, f in zip(positions, forces, strict=True))
    read = ca.Function("read", [system.q, system.qd], [
        ca.gradient(power, system.qd), system.apex, *positions,
        *[ca.gradient(power, system.qd)[13 + 3 * k : 16 + 3 * k] for k in range(3)],
    ])  # fmt: skip
    generalised, apex, *rest = (np.asarray(v) for v in read(q, qd))
    at_apex = sum(f.sum(axis=1) for f in forces)
    moment = sum(np.cross((p - apex).T, f.T).sum(axis=0) for p, f in zip(rest[:3], forces, strict=True))
    loads = named("aero.force", at_apex) | named("aero.moment", moment)
    for k, modal in enumerate(rest[3:], start=1):
        loads |= named(f"blade{k}.modal_force", modal.ravel())
    M = np.asarray(exact[0](q, qd, 0.0)[0])
    gained = []
    for values in ({}, loads):
        instance = started(equations, PITCHED | {"dof.nacelle_yaw": 1.0} | values)
        put(instance, q, qd)
        gained.append(accelerations(instance))
    # Differences of accelerations of 1e4 m/s2 times masses of 1e7 kg against forces of 1e6 N.
    np.testing.assert_allclose(M @ (gained[1] - gained[0]), generalised.ravel(), atol=1e-6 * np.abs(generalised).max())


@pytest.mark.parametrize(("speed", "free"), [(0.0, None), (1.2, tuple(n for n in SWITCHES if n not in BLADE))])
def test_free_fall_leaves_every_part_weightless(equations, speed, free):
    """Spinning with rigid blades; with elastic ones at rest, for spin bends coned blades."""
    instance = started(equations, {"initial.pitch": 0.3, "initial.roll": -0.2, "initial.rotor_speed": speed}, free=free)
    out = instance.outputs()
    # No relative acceleration, hence no specific force and no load at the tower base (weight 6.8e6 N) to round-off.
    np.testing.assert_allclose(accelerations(instance), [0, 0, -G, *[0] * 19], atol=1e-9)
    np.testing.assert_allclose(vector(out, "nacelle_damper.specific_force"), 0, atol=1e-9)
    assert max(abs(out[name]) for a in "xyz" for name in (f"TwrBsF{a}t", f"YawBrF{a}p")) < 1e-2


def test_response_is_reciprocal_and_positive(equations):
    """Betti: the map from loads to accelerations at their points is symmetric; kinetic energy: it is not negative."""
    instance = started(equations, {"initial.pitch": 0.2, "initial.yaw": 0.4, "dof.nacelle_yaw": 1.0})
    instance._values["x"][12:17] = [1.5, 0.05, -1.0, 0.03, 0.3]
    instance._values["x"][19:22] = [3.0, 0.2, -0.5]
    ports = [(f"{p}.{q}", r) for p, r in (
        ("hydro", ("platform.acceleration", "platform.angular_acceleration")),
        ("nacelle_damper", ("nacelle_damper.specific_force", "nacelle_damper.angular_acceleration")),
        ("platform_damper", ("platform_damper.specific_force", "platform_damper.angular_acceleration")),
    ) for q, r in zip(("force", "moment"), r, strict=True)]  # fmt: skip

    def response() -> np.ndarray:
        out = instance.outputs()
        return np.concatenate([*(vector(out, name) for _, name in ports), accelerations(instance)[13:16]])

    loads = [f"{name}[{i}]" for name, _ in ports for i in (1, 2, 3)] + [f"blade1.modal_force[{i}]" for i in (1, 2, 3)]
    rest, columns = response(), []
    for name in loads:
        instance.set({name: 1e6})
        columns.append((response() - rest) / 1e6)
        instance.set({name: 0.0})
    compliance = np.array(columns)
    size = np.sqrt(np.outer(np.diag(compliance), np.diag(compliance)))
    # Differences of accelerations of order 1e3 m/s2: 1e-13 / (1e6 N) against compliances of 1e-10 to 1e-3 per N.
    np.testing.assert_allclose(compliance / size, compliance.T / size, atol=1e-8)
    assert np.linalg.eigvalsh((compliance + compliance.T) / (2 * size)).min() > -1e-8


def test_added_mass_is_the_force_of_accelerated_water(equations):
    """With any symmetric A: the same motion follows from -A times the global accelerations, applied as a force."""
    half = np.random.default_rng(7).uniform(-1, 1, (6, 6))
    A = np.diag([1e6, 1e6, 2e7, 1e9, 1e9, 1e8]) + 1e6 * (half + half.T)
    with_mass = {f"hydro.added_mass[{i + 1},{j + 1}]": A[i, j] for i in range(6) for j in range(6)}
    instance = started(equations, with_mass)
    put(instance, *violent(6))
    out, moving = instance.outputs(), accelerations(instance)
    load = -A @ np.r_[vector(out, "platform.acceleration"), vector(out, "platform.angular_acceleration")]
    forced = started(equations, named("hydro.force", load[:3]) | named("hydro.moment", load[3:]))
    put(forced, *violent(6))
    np.testing.assert_allclose(accelerations(forced), moving, rtol=1e-8, atol=1e-8)
    # In heave alone it adds to the mass of the whole.
    total = 5.452e6 + 240000.0 + instance.get("rotor.mass") + nrel_5mw_barge().tower.integrals.mass
    lifted = started(equations, with_mass | {"hydro.force[3]": 1e6, "gravity": 0.0}, free=("heave",))
    assert accelerations(lifted)[2] == pytest.approx(1e6 / (total + A[2, 2]), rel=1e-12)


def test_locked_degrees_of_freedom_stay_put_exactly(equations):
    free = ("roll", "pitch", "tower_fore_aft_1", "generator", "blade_flap_1")
    loads = {"hydro.moment[1]": 1e8, "hydro.moment[2]": -1e8, "hydro.moment[3]": 1e8, "hydro.force[1]": 1e6}
    loads |= named("blade2.modal_force", np.array([1e4, 1e4, 1e4]))
    instance = started(equations, loads | {"aero.force[1]": 5e5, "initial.rotor_speed": 1.0}, free=free)
    start = taken(instance)[0]
    for _ in range(40):
        instance.do_step(0.0125)
    for name, moved in zip(NAMES, taken(instance)[0] - start, strict=True):
        assert (moved != 0.0) == (name in free), name
