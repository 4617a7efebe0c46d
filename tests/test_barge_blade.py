"""The elastic blade: mode shapes against closed forms, integrals and frequencies against direct solutions."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from numpy.polynomial import Polynomial
from scipy.linalg import eigh

from fmus_src.barge.blade import blade_matrices, blade_structure, mode_shapes
from fmus_src.barge.elastic import elastic_inertia
from fmus_src.barge.model import component
from fmus_src.barge.turbine import nrel_5mw_barge
from fmus_src.equations import derive
from tests.barge_states import BLADE, UNDAMPED, started


def test_uniform_twist_turns_the_polynomial_shapes():
    blade = blade_structure()
    theta = 0.3
    span = np.array([61.5, 0.0, 17.3, 40.0])
    shapes = mode_shapes(replace(blade, twist=np.full(blade.span.size, theta)), span)
    flap = np.array([np.cos(theta), -np.sin(theta)])
    edge = np.array([np.sin(theta), np.cos(theta)])
    across = [flap, flap, edge]
    poly = [Polynomial([0, 0, *c]) for c in blade.coefficients]
    x = span / blade.length
    expected = np.array([[p(s) * a for p, a in zip(poly, across, strict=True)] for s in x]).transpose(0, 2, 1)
    slope = np.array([[p.deriv()(s) * a for p, a in zip(poly, across, strict=True)] for s in x]).transpose(0, 2, 1)
    # Polynomials of degree six are integrated exactly between the stations: round-off remains.
    np.testing.assert_allclose(shapes.shape, expected, atol=1e-12)
    np.testing.assert_allclose(shapes.slope, slope / blade.length, atol=1e-12)
    for i in range(3):
        for j in range(3):
            exact = (poly[i].deriv() * poly[j].deriv()).integ()(x) / blade.length * (across[i] @ across[j])
            np.testing.assert_allclose(shapes.shortening[:, i, j], exact, atol=1e-12)


def test_deflected_axis_keeps_its_length():
    """Along the twisted blade dx^2 + dy^2 + dz^2 = dr^2 but for terms of fourth order in the deflection."""
    blade = blade_structure()
    span = np.linspace(0.0, blade.length, 4001)
    shapes = mode_shapes(blade, span)

    def stretch(q: np.ndarray) -> float:
        across = shapes.shape @ q
        along = span - 0.5 * np.einsum("i,nij,j->n", q, shapes.shortening, q)
        points = np.column_stack([across, along])
        return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum() - blade.length)

    large, small = (stretch(size * np.array([4.0, 0.8, 1.2])) for size in (1.0, 0.5))
    assert large == pytest.approx(16 * small, rel=0.05)
    assert abs(large) < 0.02


def test_points_off_the_blade_are_refused():
    with pytest.raises(ValueError, match=r"between 0 and 61\.5 m"):
        mode_shapes(blade_structure(), np.array([62.0]))


def test_integrals_match_direct_summation():
    """Mass, first and second moments of the blade, and of a deflected one, against a fine trapezoidal sum."""
    blade = blade_structure()
    s = np.linspace(0.0, blade.length, 200001)
    mu = blade.mass_factor * np.interp(s, blade.span, blade.mass_density)

    def total(values: np.ndarray) -> float:
        return float(np.trapezoid(mu * values, s))

    b = blade_matrices(blade).integrals.scaled(blade.mass_factor)
    figures = [float(ca.DM(b.mass)), float(ca.DM(b.first)), float(ca.DM(b.second))]
    # The trapezoidal sum's own error: (step / length)^2, 1e-10.
    np.testing.assert_allclose(figures, [total((1.5 + s) ** k) for k in range(3)], rtol=1e-8)
    # Published integrated figures: 17,740 kg, 20.475 m, 11,776,047 kg.m2 about the root; the published table itself,
    # linear between its stations and times the published factor, makes 0.7 % less.
    assert total(np.ones_like(s)) == pytest.approx(17_740.0, rel=8e-3)
    assert total(s) / total(np.ones_like(s)) == pytest.approx(20.475, rel=3e-3)
    assert total(s**2) == pytest.approx(11_776_047.0, rel=8e-3)

    coarse = s[::100]
    shapes, line = mode_shapes(blade, coarse), mu[::100]
    q, distance = np.array([3.0, -0.4, 1.1]), 1.5 + coarse
    across = shapes.shape @ q
    drop = np.einsum("i,nij,j->n", q, shapes.shortening, q)
    body = elastic_inertia(b, ca.SX(q), ca.SX(3, 1), ca.SX(3, 1))
    moment = [np.trapezoid(line * v, coarse) for v in (across[:, 0], across[:, 1], distance - drop / 2)]
    found = np.asarray(ca.DM(body.rigid.coupling))
    np.testing.assert_allclose([found[1, 2], found[2, 0], found[0, 1]], moment, rtol=1e-5)
    about_x = np.trapezoid(line * (across[:, 1] ** 2 + distance**2 - distance * drop), coarse)
    products = np.trapezoid(line * across[:, 0] * distance, coarse)
    inertia = np.asarray(ca.DM(body.rigid.angular))
    np.testing.assert_allclose([inertia[0, 0], inertia[0, 2]], [about_x, -products], rtol=1e-5)


def beam_frequencies(speed: float) -> np.ndarray:
    """Frequencies (Hz) of the twisted blade spinning in a plane, by Hermitian beam elements."""
    blade = blade_structure()
    s = np.interp(np.arange(0, blade.span.size - 0.5, 0.5), np.arange(blade.span.size), blade.span)
    mid, length = (s[1:] + s[:-1]) / 2, np.diff(s)
    mu = blade.mass_factor * np.interp(mid, blade.span, blade.mass_density)
    theta, flap, edge = (
        np.interp(mid, blade.span, v) for v in (blade.twist, blade.flap_stiffness, blade.edge_stiffness)
    )
    pull = mu * length * (1.5 + mid) * speed**2
    tension = np.cumsum(pull[::-1])[::-1] - pull / 2
    x, w = np.polynomial.legendre.leggauss(4)
    t, w = (x + 1) / 2, w / 2
    K, M = np.zeros((4 * s.size,) * 2), np.zeros((4 * s.size,) * 2)
    for i, h in enumerate(length):
        value = np.array([1 - 3 * t**2 + 2 * t**3, h * (t - 2 * t**2 + t**3), 3 * t**2 - 2 * t**3, h * (t**3 - t**2)])
        slope = np.array([6 * t**2 - 6 * t, h * (1 - 4 * t + 3 * t**2), 6 * t - 6 * t**2, h * (3 * t**2 - 2 * t)]) / h
        bend = np.array([12 * t - 6, h * (6 * t - 4), 6 - 12 * t, h * (6 * t - 2)]) / h**2
        m, g, k = ((v * w) @ v.T * h for v in (value, slope, bend))
        c, d = np.cos(theta[i]), np.sin(theta[i])
        rigidity = flap[i] * np.outer([c, -d], [c, -d]) + edge[i] * np.outer([d, c], [d, c])
        # At each node: displacement and slope out of plane, then in plane.
        order = 4 * i + np.array([0, 1, 4, 5, 2, 3, 6, 7])
        place = np.ix_(order, order)
        K[place] += np.kron(rigidity, k) + np.kron(np.eye(2), tension[i] * g)
        # Spin relieves the in-plane motion: the centrifugal force has a part along the displacement.
        K[place] -= np.kron(np.diag([0.0, 1.0]), mu[i] * speed**2 * m)
        M[place] += np.kron(np.eye(2), mu[i] * m)
    values = eigh(K[4:, 4:], M[4:, 4:], eigvals_only=True, subset_by_index=(0, 2))
    return np.sqrt(values) / (2 * np.pi)


@pytest.mark.parametrize("speed", [0.0, 1.2671])
def test_spinning_blade_has_the_frequencies_of_a_finite_element_beam(speed):
    """Assumed modes bound a beam's frequencies from above; spin at rated speed stiffens the first flap mode by 7 %."""
    straight = replace(nrel_5mw_barge(), rotor=nrel_5mw_barge().rotor | {"precone_deg": 0.0})
    instance = started(
        derive(component(straight)), UNDAMPED | {"gravity": 0.0, "initial.rotor_speed": speed}, free=BLADE
    )
    x, h = instance._values["x"].copy(), 1e-5
    q, rates = slice(19, 22), slice(35, 38)
    A = np.zeros((6, 6))
    for j, i in enumerate([*range(19, 22), *range(35, 38)]):
        step = h * np.eye(x.size)[i]
        change = (instance.derivative(x + step) - instance.derivative(x - step)) / (2 * h)
        A[:, j] = np.r_[change[q], change[rates]]
    values = np.linalg.eigvals(A)
    found = np.sort(values.imag[values.imag > 0]) / (2 * np.pi)
    exact = beam_frequencies(speed)
    ratio = found / exact
    # Lower than 1 only by the elements' own error.
    assert np.all(ratio > 1 - 1e-4), ratio
    assert np.all(ratio < [1.01, 1.01, 1.025]), ratio
    if speed:
        # Southwell: f^2 = f_0^2 + B (Omega / 2 pi)^2, B between 1 and 2 for a first flap mode.
        B = (found[0] ** 2 - beam_frequencies(0.0)[0] ** 2) / (speed / (2 * np.pi)) ** 2
        assert 1.0 < B < 2.0
