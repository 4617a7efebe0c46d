"""Mooring lines: closed forms, independent integration, energy, symmetry, and MoorPy's figures."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from fmus_src.instance import Instance
from fmus_src.lookups import ImplicitLookup, LookupMemory
from fmus_src.mooring.model import catenary, component, first_guess, layout

LENGTH, WEIGHT, EA = 473.312, 1227.16, 589e6


def tensions(rows):
    """Horizontal and vertical fairlead tension (N) for rows of (span, height, L, w, EA, friction)."""
    rows = np.atleast_2d(np.asarray(rows, dtype=float))
    lookup = ImplicitLookup("line", catenary(), first_guess(), len(rows))
    y = lookup.evaluate(rows.ravel(), LookupMemory([])).reshape(-1, 2)
    return np.exp(y) * (rows[:, 3] * rows[:, 2])[:, None]


def line(span, height=146.0, friction=1.0, ea=EA):
    return (span, height, LENGTH, WEIGHT, ea, friction)


@pytest.fixture(scope="module")
def mooring():
    instance = Instance(component())
    instance.initialise()
    return instance


def load(instance, pose):
    """Force and moment (6,) at a pose (x, y, z, roll, pitch, yaw)."""
    names = [f"platform.{kind}[{i}]" for kind in ("position", "rotation") for i in (1, 2, 3)]
    instance.set(dict(zip(names, map(float, pose), strict=True)))
    outputs = instance.outputs()
    return np.array([outputs[f"{kind}[{i}]"] for kind in ("force", "moment") for i in (1, 2, 3)])


def tension_array(instance, name):
    outputs = instance.outputs()
    return np.array([outputs[f"{name}[{i + 1}]"] for i in range(8)])


@pytest.mark.parametrize("span", [370.0, 397.15, 415.0])
def test_inelastic_line_with_seabed_contact_is_the_textbook_catenary(span):
    ((h, v),) = tensions(line(span, ea=1e15, friction=0.0))
    hanging = np.sqrt(146.0**2 + 2 * 146.0 * h / WEIGHT)
    assert v == pytest.approx(WEIGHT * hanging, rel=1e-9)  # EA 1e15 N: strains of 1e-10
    assert LENGTH - hanging + h / WEIGHT * np.arccosh(1 + 146.0 * WEIGHT / h) == pytest.approx(span, rel=1e-9)


@pytest.mark.parametrize("span", [446.0, 448.0, 449.0])
def test_inelastic_hanging_line_is_the_textbook_catenary(span):
    ((h, v),) = tensions(line(span, ea=1e15))
    assert v > WEIGHT * LENGTH
    sag = 2 * h / WEIGHT * np.sinh(WEIGHT * span / (2 * h))
    assert sag**2 == pytest.approx(LENGTH**2 - 146.0**2, rel=1e-8)  # strains of 1e-9 at these tensions


@pytest.mark.parametrize("friction", [0.0, 0.01, 1.0])
@pytest.mark.parametrize("span", [360.0, 397.15, 430.0, 441.0, 455.0])
def test_integration_along_the_line_ends_at_the_anchor(span, friction):
    """The differential equations of an elastic line on a rough seabed, from the fairlead down to the anchor."""
    ((h, v),) = tensions(line(span, friction=friction))

    def hanging(s, y):
        vertical = v - WEIGHT * s
        tension = np.hypot(h, vertical)
        return np.array([h, vertical]) / tension * (1 + tension / EA)

    touch = min(v / WEIGHT, LENGTH)
    x, z = solve_ivp(hanging, (0.0, touch), [0.0, 0.0], rtol=1e-10, atol=1e-9).y[:, -1]
    rest = np.linspace(0.0, LENGTH - touch, 200_001)
    x += np.trapezoid(1 + np.maximum(h - friction * WEIGHT * rest, 0.0) / EA, rest)
    # The integrator is asked for 1e-9 m a step; of the closed form nothing is lost above 1e-9 of the length.
    assert x == pytest.approx(span, abs=1e-6)
    assert z == pytest.approx(146.0, abs=1e-6)


def test_figures_of_moorpy():
    """catenary(X, Z, 473.312, 589e6, 1227.16, CB=CB, Tol=1e-10) of MoorPy 1.3.0."""
    rows = [
        line(397.1502),
        line(397.1502, friction=0.0),
        line(372.0, 140.0, 0.5),
        line(440.0, 146.0, 0.01),
        line(450.0),
    ]
    expected = [
        (95253.65597496994, 257296.90378956383),
        (95117.89389954758, 257202.42391642177),
        (27107.44057290403, 197020.8201162071),
        (684140.6027735465, 526158.819387409),
        (1771958.764596833, 869918.4084712106),
    ]
    # MoorPy stops at errors of some 1e-10 in span and height.
    np.testing.assert_allclose(tensions(rows), expected, rtol=1e-8)


def test_tension_and_stiffness_are_continuous_at_lift_off_of_the_anchor():
    height = 146.0
    spans = np.array([440.0, 449.0])
    for _ in range(60):  # bisection for the span at which the last link leaves the seabed
        middle = spans.mean()
        ((_, v),) = tensions(line(middle, height))
        spans[int(v > WEIGHT * LENGTH)] = middle
    assert v == pytest.approx(WEIGHT * LENGTH, rel=1e-9)
    step = 1e-4
    h = tensions([line(spans[0] + i * step, height) for i in (-2, -1, 0, 1, 2)])
    slopes = np.diff(h, axis=0) / step
    # The stiffness itself grows by some 1e4 N/m2: 2.7e-5 over the 2e-4 m between the two slopes.
    np.testing.assert_allclose(slopes[:2].mean(axis=0), slopes[2:].mean(axis=0), rtol=1e-4)
    assert np.all(slopes > 0.0)


def test_newton_converges_quadratically():
    lookup = ImplicitLookup("line", catenary(), first_guess(), 1)
    system, guess = lookup.functions
    a = np.array(line(397.15))
    y, errors = guess(a).full().ravel(), []
    for _ in range(6):
        r, by_y, _ = (m.full() for m in system(y, a))
        errors.append(np.linalg.norm(r))
        y = y - np.linalg.solve(by_y, r).ravel()
    errors = np.array([e for e in errors if e > 1e-13])  # above round-off
    assert errors[-1] < 1e-6
    assert np.all(errors[1:] < 5.0 * errors[:-1] ** 2)


def test_newton_converges_from_any_earlier_solution():
    """Jumps between slack, touching, hanging and overstretched lines, with and without friction."""
    random = np.random.default_rng(3)
    lookup = ImplicitLookup("line", catenary(), first_guess(), 1)
    memory = LookupMemory([])
    system, _ = lookup.functions
    for _ in range(200):
        a = np.array(line(random.uniform(250, 550), random.uniform(120, 180), random.choice([0.0, 1.0])))
        y = lookup.evaluate(a, memory)
        assert np.linalg.norm(system(y, a)[0].full()) < 1e-8


def test_slack_line_carries_its_hanging_weight_only():
    ((h, v),) = tensions(line(300.0))
    assert h < 2e-5 * WEIGHT * LENGTH  # the margin of the model: 6 N of 581 kN
    assert v == pytest.approx(WEIGHT * 146.0, rel=3e-4)  # hanging length less elastic stretch (1.5e-4)


def test_loads_at_rest_are_symmetric(mooring):
    force = load(mooring, np.zeros(6))
    tension = tension_array(mooring, "fairlead_tension")
    assert np.abs(force[[0, 1, 3, 4]]).max() < 1e-9 * tension.sum()
    # The two anchors of a corner are no exact mirror images (386.92 m and 386.95 m): a small yaw moment remains.
    assert abs(force[5]) < 1e-3 * 8 * 95e3 * 20.0
    np.testing.assert_allclose(tension[2:], tension[:-2], rtol=1e-9)
    np.testing.assert_allclose(tension[0], tension[1], rtol=1e-3)


def test_fairlead_and_anchor_tensions_balance_the_weight_in_water(mooring):
    force = load(mooring, [40.0, 40.0, 0.0, 0.0, 0.0, 0.0])
    fairleads, anchors = layout()
    away = anchors[:, :2] - fairleads[:, :2] - 40.0
    span = np.linalg.norm(away, axis=1)
    weight = (130.403 - 1025.0 * np.pi * 0.0809**2 / 4) * 9.80665
    h, v = tensions([(s, 146.0, LENGTH, weight, EA, 1.0) for s in span]).T
    hanging = v > weight * LENGTH
    assert 0 < hanging.sum() < 8  # some lines are lifted off, some not
    np.testing.assert_allclose(tension_array(mooring, "fairlead_tension"), np.hypot(h, v), rtol=1e-9)
    held = np.hypot(np.where(hanging, h, np.maximum(h - LENGTH * weight + v, 0)), np.maximum(v - weight * LENGTH, 0))
    np.testing.assert_allclose(tension_array(mooring, "anchor_tension"), held, rtol=1e-8, atol=1e-6)
    np.testing.assert_allclose(force[:2], (away / span[:, None] * h[:, None]).sum(axis=0), rtol=1e-9)
    assert force[2] == pytest.approx(-v.sum(), rel=1e-9)


def test_surge_stiffness_gives_the_published_natural_frequency(mooring):
    """0.0076 Hz (Wang et al. 2022, table 2): barge 5.452e6 kg, turbine 0.697e6 kg, added mass 0.749e6 kg."""
    step = np.eye(6)[0] * 0.1
    k = -(load(mooring, step)[0] - load(mooring, -step)[0]) / 0.2
    frequency = np.sqrt(k / (5.452e6 + 0.6975e6 + 0.749e6)) / (2 * np.pi)
    assert frequency == pytest.approx(0.0076, abs=1e-4)  # printed digits, and coupling with pitch left out


def test_offsets_of_forty_metres_are_restored(mooring):
    for angle in np.linspace(0.0, 2 * np.pi, 8, endpoint=False):
        direction = np.array([np.cos(angle), np.sin(angle)])
        pull = [-load(mooring, [*(r * direction), 0, 0, 0, 0])[:2] @ direction for r in (0, 10, 20, 30, 40)]
        assert np.all(np.diff(pull, n=2) > 0.0)  # ever stiffer


@pytest.mark.parametrize(("friction", "bound"), [(0.0, 1e-11), (1.0, 1e-4)])
def test_no_work_around_a_closed_loop(friction, bound):
    """Without friction the lines are elastic; all six motions take part, so the moment is tested as well.

    The stretch of a rough resting line breaks reciprocity (dx/dV - dz/dH = friction * resting length / EA), which is
    small beside 1 / w: measured 1.4e-5 of the exchanged energy here.
    """
    instance = Instance(component())
    instance.set({"seabed_friction": friction})
    instance.initialise()
    turn = np.linspace(0.0, 2 * np.pi, 96, endpoint=False)
    amplitude = np.array([8.0, 5.0, 3.0, 0.1, 0.15, 0.2])
    phase = np.array([0.0, 1.5, 0.7, 0.3, 2.0, 1.0])
    pose = amplitude * np.sin(turn[:, None] + phase)
    rate = amplitude * np.cos(turn[:, None] + phase)
    power = np.empty(turn.size)
    for i, (p, dp) in enumerate(zip(pose, rate, strict=True)):
        pitch, yaw = p[4], p[5]
        # w = yaw' ez + pitch' Rz ey + roll' Rz Ry ex
        about_x = np.array([np.cos(yaw) * np.cos(pitch), np.sin(yaw) * np.cos(pitch), -np.sin(pitch)])
        about_y = np.array([-np.sin(yaw), np.cos(yaw), 0.0])
        velocity = np.concatenate([dp[:3], dp[3] * about_x + dp[4] * about_y + [0.0, 0.0, dp[5]]])
        power[i] = load(instance, p) @ velocity
    # The trapezoidal rule is spectrally accurate on a period.
    assert abs(power.sum()) < bound * np.abs(power).sum()


def test_load_has_fourfold_symmetry():
    """An offset turned by 90 degrees turns the load by 90 degrees."""
    instance = Instance(component())
    instance.initialise()
    pose = np.array([6.0, -3.0, 1.0, 0.0, 0.0, 0.0])
    force = load(instance, pose)
    turned = load(instance, [3.0, 6.0, 1.0, 0.0, 0.0, 0.0])
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    np.testing.assert_allclose(turned, np.concatenate([turn @ force[:3], turn @ force[3:]]), rtol=1e-8, atol=1e-3)
