"""The elastic blade: distributed figures, mode shapes in the blade's own frame, and the integrals of its motion.

Blade frame "b": z along the undeflected blade outwards, x downwind and y towards the trailing edge at zero pitch; it
turns with the pitch. Modes, always in the order flap_1, flap_2, edge_1: assumed shapes phi(x) = sum c_k x^k, k = 2..6,
across the local structural axes. With the structural twist theta (towards feather) their curvatures have the components

    flap:  phi'' (cos theta, -sin theta)        edge:  phi'' (sin theta, cos theta)          along (x_b, y_b),

and integrating these twice from the root gives the twisted shapes (Jonkman, FAST theory; ElastoDyn). The axis does not
stretch, so that bending draws it in by 1/2 q' S q with S_ij(r) = integral of phi_i' . phi_j' from the root to r.
"""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from numpy.polynomial import Polynomial

from fmus_src.barge.beam import cumulative, quadrature, stations
from fmus_src.barge.elastic import BeamIntegrals, beam_integrals

Array = npt.NDArray[np.float64]

DATA = Path(__file__).parent / "data"

MODES = ("flap_1", "flap_2", "edge_1")
EDGE = (False, False, True)


@dataclass(frozen=True, eq=False)
class Blade:
    """Distributed figures of a blade, linear between n stations.

    Attributes:
        length: from root to tip, m; hub_radius: from apex to root, m.
        span: of the stations from the root, m, (n,).
        twist: structural twist towards feather, rad, (n,).
        mass_density: before `mass_factor`, kg/m, (n,).
        flap_stiffness, edge_stiffness: EI, N.m2, (n,).
        coefficients: c_2..c_6 of flap_1, flap_2, edge_1, (3, 5).
        mass_factor: on the mass density; damping_ratio: structural, of every mode.
    """

    length: float
    hub_radius: float
    span: Array
    twist: Array
    mass_density: Array
    flap_stiffness: Array
    edge_stiffness: Array
    coefficients: Array
    mass_factor: float
    damping_ratio: float


@dataclass(frozen=True, eq=False)
class BladeShapes:
    """The modes at n points of the blade, per metre of modal coordinate.

    Attributes:
        shape: displacement along x_b and y_b, (n, 2, 3); slope: its derivative along the span, 1/m, (n, 2, 3).
        shortening: S, 1/m, (n, 3, 3): the point moves by -1/2 q' S q along z_b.
    """

    shape: Array
    slope: Array
    shortening: Array


@cache
def blade_structure() -> Blade:
    """The blade of the NREL 5-MW turbine, from this folder's data files."""
    figures = tomllib.loads((DATA / "turbine.toml").read_text(encoding="utf-8"))
    return read_blade(figures, DATA / "blade.csv")


def read_blade(figures: dict[str, Any], table: Path) -> Blade:
    """A blade from the sections [blade] and [rotor] of a turbine's figures and its table of stations.

    Raises:
        ValueError: the table's stations do not run from 0 to 1.
    """
    blade, columns = figures["blade"], stations(table)
    return Blade(
        length=blade["length"],
        hub_radius=figures["rotor"]["hub_radius"],
        span=columns["span_fraction"] * blade["length"],
        twist=np.radians(columns["twist_deg"]),
        mass_density=columns["mass_density"],
        flap_stiffness=columns["flap_stiffness"],
        edge_stiffness=columns["edge_stiffness"],
        coefficients=np.array([blade[mode] for mode in MODES]),
        mass_factor=blade["mass_factor"],
        damping_ratio=blade["damping_ratio"],
    )


def mode_shapes(blade: Blade, span: Array) -> BladeShapes:
    """The twisted mode shapes at distances `span` (m, any order) from the blade root.

    Raises:
        ValueError: a point lies off the blade.
    """
    points = np.asarray(span, dtype=float)
    if np.any(points < -1e-9) or np.any(points > blade.length * (1 + 1e-9)):
        raise ValueError(f"points of the blade must lie between 0 and {blade.length} m from its root, got {span}")
    breaks = np.union1d(blade.span, np.clip(points, 0.0, blade.length))
    slope_inside, slope = cumulative(breaks, _curvature(blade, quadrature(breaks)[0]))
    _, shape = cumulative(breaks, slope_inside)
    _, shortening = cumulative(breaks, np.einsum("ndi,ndj->nij", slope_inside, slope_inside))
    at = np.searchsorted(breaks, np.clip(points, 0.0, blade.length))
    return BladeShapes(shape[at], slope[at], shortening[at])


def _polynomials(blade: Blade) -> list[Polynomial]:
    """Untwisted shapes over the span fraction."""
    return [Polynomial([0.0, 0.0, *c]) for c in blade.coefficients]


def _curvature(blade: Blade, span: Array) -> Array:
    """Second derivatives of the modes along x_b and y_b, 1/m2 per metre, (n, 2, 3)."""
    theta = np.interp(span, blade.span, blade.twist)
    across = {False: np.array([np.cos(theta), -np.sin(theta)]), True: np.array([np.sin(theta), np.cos(theta)])}
    bending = [p.deriv(2)(span / blade.length) / blade.length**2 for p in _polynomials(blade)]
    return np.stack([(across[edge] * b).T for b, edge in zip(bending, EDGE, strict=True)], axis=2)


@dataclass(frozen=True, eq=False)
class BladeMatrices:
    """Constants of the modes in the order MODES; inertia without the mass factor.

    Attributes:
        integrals: over the mass, distances from the rotor apex.
        tip: displacement of the tip along x_b and y_b, (2, 3).
        stiffness: integrals of EI phi_i'' phi_j'', N/m; flap and edge do not couple, (3, 3).
        frequency: of each untwisted shape alone, not rotating, Hz, (3,).
    """

    integrals: BeamIntegrals
    tip: Array
    stiffness: Array
    frequency: Array

    @property
    def damping(self) -> Array:
        """Modal damping at unit damping ratio, (3, 3), N.s/m: C_ij = K_ij / (pi f_j) as ElastoDyn."""
        return np.asarray(self.stiffness / (np.pi * self.frequency))


def blade_matrices(blade: Blade) -> BladeMatrices:
    """Integrate the distributed figures, linear between the stations."""
    span, weight = quadrature(blade.span)
    mass = np.interp(span, blade.span, blade.mass_density) * weight
    shapes = mode_shapes(blade, span)
    modes, x = _polynomials(blade), span / blade.length
    bending = np.array([p.deriv(2)(x) for p in modes]) / blade.length**2
    rigidity = {
        False: np.interp(span, blade.span, blade.flap_stiffness) * weight,
        True: np.interp(span, blade.span, blade.edge_stiffness) * weight,
    }
    stiffness = np.array([
        [rigidity[i] @ (a * b) if i == j else 0.0 for b, j in zip(bending, EDGE, strict=True)]
        for a, i in zip(bending, EDGE, strict=True)
    ])  # fmt: skip
    modal_mass = np.array([mass @ p(x) ** 2 for p in modes])
    return BladeMatrices(
        integrals=beam_integrals(mass, blade.hub_radius + span, shapes.shape, shapes.shortening),
        tip=mode_shapes(blade, np.array([blade.length])).shape[0],
        stiffness=stiffness,
        frequency=np.sqrt(np.diag(stiffness) / modal_mass) / (2 * np.pi),
    )
