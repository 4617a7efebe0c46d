"""Compute the hydrodynamic database of the ITI Energy barge with Capytaine (optional extra `[hydro]`).

    python -m fmus_src.hydro.compute_database               moonpool closed by the deck  -> data/barge.json
    python -m fmus_src.hydro.compute_database --moonpool    moonpool open                -> data/barge_moonpool.json
    python -m fmus_src.hydro.compute_database --deep        closed, in deep water        -> data/barge_deep.json

Geometry, draft, depth and displaced volume: Jonkman, NREL/TP-500-41958 (2007), table 2-4. In the first variant the 10 m
moonpool is open below and closed at the waterline, so that its water moves with the barge: this is what the published
coefficients are of (volume 6000 m3 and waterplane 1600 m2 together; added masses agree to 2 %, while a flush bottom
lacks 0.23e6 kg in surge and 0.41e6 kg in heave). Method:

* Boundary elements in the direct formulation (the indirect one needs far more panels: with it A15 and A51 differ by
  several per cent), one quarter of the hull with two symmetry planes, panels graded towards every edge, and a lid on
  the inner waterplane against irregular frequencies (the first is at 1.62 rad/s). The deck over the moonpool lies
  0.2 m below the waterline; its thin gap to the lid needs a quadrature of 2 x 2 points.
* Radiation damping from the far field, that is from the energy that the radiated waves carry away, which by
  Haskind's relation is the mean over headings of the exciting force squared (Newman, Marine Hydrodynamics, 1977,
  6.175; Falnes, Ocean Waves and Oscillating Systems, 2002, 5.135 ff.). Integrating the pressure gives the same to 1 %
  where it is large; but where it is small (above 2 rad/s in heave and pitch) a difference of large numbers remains,
  of either sign, that depends on the lid. The far field's is never negative.
* Depth 150 m up to k h = 6; above, infinite depth, which differs by exp(-2 k h) < 1e-5 and is computed faster.
* Phases: Capytaine's exp(-i w t) is conjugated to exp(+i w t); incident wave a cos(w t - k x'), x' along the heading.
"""

from __future__ import annotations

import argparse
import logging
from collections.abc import Callable, Sequence
from functools import partial
from itertools import pairwise
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from fmus_src.hydro.database import HydroDatabase, save, wave_number

Array = npt.NDArray[np.float64]

LENGTH, DRAFT, MOONPOOL = 40.0, 4.0, 10.0  # m
DEPTH, DENSITY, GRAVITY = 150.0, 1025.0, 9.80665  # m, kg/m3, m/s2
DEEP = 1e5  # m, deep water for every frequency: the published coefficients are those of infinite depth
VOLUME = 6000.0  # m3: the box less its moonpool, in both variants
DECK = -0.2  # m, level of the deck that closes the moonpool
# Index pairs of added mass and damping that are not zero by the symmetry of a square barge.
SQUARE_PAIRS = [(0, 0), (0, 4), (4, 0), (4, 4), (1, 1), (1, 3), (3, 1), (3, 3), (2, 2), (5, 5)]
DOFS = ("Surge", "Sway", "Heave", "Roll", "Pitch", "Yaw")
HEADINGS = np.radians(np.arange(0.0, 91.0, 3.0))  # the far-field integral needs 3 deg; every third is kept
KEPT_HEADINGS = 3
PANELS = {"outside": 14, "draft": 7, "moonpool": 10, "lid": 13}  # moonpool's wall to side, draft, half the moonpool


def graded(start: float, stop: float, count: int, both_ends: bool = False) -> Array:
    """Panel edges from start to stop, finer towards `stop` or towards both ends; shape (count + 1,)."""
    t = np.linspace(0.0, 1.0, count + 1)
    s = (1.0 - np.cos(np.pi * t)) / 2.0 if both_ends else np.sin(np.pi * t / 2.0)
    weight = 0.7 if both_ends else 0.5
    return np.asarray(start + (stop - start) * (weight * s + (1.0 - weight) * t))


def patch(u: Array, v: Array, point: Callable[[float, float], tuple[float, ...]], normal: Array) -> list[Array]:
    """Quadrilaterals over the grid u x v on the plane `point(u, v)`, oriented along `normal`."""
    faces = []
    for u0, u1 in pairwise(u):
        for v0, v1 in pairwise(v):
            quad = np.array([point(u0, v0), point(u1, v0), point(u1, v1), point(u0, v1)])
            upright = np.dot(np.cross(quad[1] - quad[0], quad[2] - quad[0]), normal) > 0.0
            faces.append(quad if upright else quad[::-1])
    return faces


def quarter_mesh(moonpool: bool) -> tuple[list[Array], list[Array]]:
    """Panels of the quarter x > 0, y > 0 of the hull and of the lid on its inner waterplane.

    Args:
        moonpool: open; else the deck closes it.
    """
    half, hole = LENGTH / 2.0, MOONPOOL / 2.0
    inner = graded(0.0, hole, PANELS["moonpool"])
    outer = graded(hole, half, PANELS["outside"], both_ends=True)
    # The lid's panels lie over the deck's, edge on edge, because the gap between them is thin.
    x, x_lid = np.r_[inner, outer[1:]], np.r_[inner, np.linspace(hole, half, PANELS["lid"] + 1)[1:]]
    z = graded(0.0, -DRAFT, PANELS["draft"], both_ends=True)
    z_inner = z if moonpool else graded(DECK, -DRAFT, PANELS["draft"], both_ends=True)
    ex, ey, ez = np.eye(3)

    def horizontal(edges: Array, level: float) -> list[Array]:
        return patch(edges, edges, lambda a, b: (a, b, level), -ez)

    def around(faces: list[Array]) -> list[Array]:
        return [f for f in faces if f[:, 0].mean() > hole or f[:, 1].mean() > hole]

    hull = around(horizontal(x, -DRAFT))
    hull += patch(x, z, lambda a, b: (half, a, b), ex) + patch(x, z, lambda a, b: (a, half, b), ey)
    hull += patch(inner, z_inner, lambda a, b: (hole, a, b), -ex) + patch(
        inner, z_inner, lambda a, b: (a, hole, b), -ey
    )
    lid = horizontal(x_lid, 0.0)
    return (hull, around(lid)) if moonpool else (hull + horizontal(inner, DECK), lid)


def barge_body(moonpool: bool, with_lid: bool = True) -> Any:
    """The barge as a Capytaine body with rigid-body modes about the PRP, with or without the lid."""
    import capytaine as cpt
    from capytaine.meshes.symmetric_meshes import ReflectionSymmetricMesh

    def whole(faces: list[Array]) -> Any:
        quarter = cpt.Mesh.from_list_of_faces(faces)
        mesh = ReflectionSymmetricMesh(half=ReflectionSymmetricMesh(half=quarter, plane="xOz"), plane="yOz")
        return mesh.with_quadrature("Gauss-Legendre 2")

    hull, lid = quarter_mesh(moonpool)
    dofs = cpt.rigid_body_dofs(rotation_center=(0.0, 0.0, 0.0))
    return cpt.FloatingBody(mesh=whole(hull), lid_mesh=whole(lid) if with_lid else None, dofs=dofs)


def frequencies(moonpool: bool) -> Array:
    """Angular frequencies, rad/s; finer about the piston resonance of an open moonpool."""
    if not moonpool:
        return np.asarray(np.round(np.arange(1, 61) * 0.05, 4))
    parts: list[Array] = [
        np.array([0.05]), np.arange(0.1, 0.9, 0.1), np.arange(0.9, 3.01, 0.05),
        np.arange(1.04, 1.165, 0.01), np.arange(1.08, 1.1225, 0.0025),
    ]  # fmt: skip
    return np.asarray(np.unique(np.round(np.concatenate(parts), 4)))


def far_field_damping(excitation: Array, omega: float, depth: float = DEPTH) -> Array:
    """Radiation damping (6, 6) from the excitation (headings 0..90 deg, 6) of a body with two symmetry planes.

    B_ij = k / (8 pi rho g c_g) * integral over all headings of X_i conj(X_j); the products that survive the
    symmetries are even in every quadrant.
    """
    k = float(wave_number(np.array([omega]), depth, GRAVITY)[0])
    group_velocity = 0.5 * omega / k * (1.0 + 2.0 * k * depth / np.sinh(min(2.0 * k * depth, 700.0)))
    weight = np.full(len(HEADINGS), 4.0 * (HEADINGS[1] - HEADINGS[0]))
    weight[[0, -1]] /= 2.0
    total = np.einsum("b,bi,bj->ij", weight, excitation, np.conj(excitation)).real
    return np.asarray(k / (8.0 * np.pi * DENSITY * GRAVITY * group_velocity) * total)


def solve_frequency(omega: float, moonpool: bool, depth: float = DEPTH) -> tuple[Array, Array, Array]:
    """Added mass (6, 6), damping from pressure (6, 6) and excitation (headings, 6), lead positive, at omega."""
    import capytaine as cpt
    from capytaine.bem.airy_waves import froude_krylov_force

    logging.getLogger("capytaine").setLevel(logging.ERROR)
    finite = bool(np.isfinite(omega))
    # At infinite frequency the potential vanishes at z = 0: the lid's equations would be 0 = 0.
    body = barge_body(moonpool, with_lid=finite)
    green_function = cpt.Delhommeau(gf_singularities="high_freq" if finite else "low_freq")
    solver = cpt.BEMSolver(method="direct", green_function=green_function)
    k = float(wave_number(np.array([omega]), depth, GRAVITY)[0]) if finite else np.inf
    solved = depth if k * depth < 6.0 else np.inf
    common = {"body": body, "omega": omega, "water_depth": solved, "rho": DENSITY, "g": GRAVITY}
    problems = [cpt.RadiationProblem(radiating_dof=d, **common) for d in DOFS]
    waves = [cpt.DiffractionProblem(wave_direction=b, **common) for b in HEADINGS] if finite else []
    results = [solver.solve(p, keep_details=False, _check_wavelength=False) for p in problems + waves]
    added_mass = np.array([[r.added_masses[d] for d in DOFS] for r in results[:6]]).T
    damping = np.array([[r.radiation_dampings[d] for d in DOFS] for r in results[:6]]).T
    excitation = np.zeros((len(waves), 6), dtype=complex)
    for i, (problem, result) in enumerate(zip(waves, results[6:], strict=True)):
        incident = froude_krylov_force(problem)
        excitation[i] = [np.conj(result.forces[d] + incident[d]) for d in DOFS]
    return added_mass, damping, excitation


def hydrostatic_stiffness(moonpool: bool) -> Array:
    """Buoyancy and waterplane parts of the restoring matrix about the PRP, shape (6, 6); the weight's is not in."""
    hole = MOONPOOL if moonpool else 0.0
    area, second_moment = LENGTH**2 - hole**2, (LENGTH**4 - hole**4) / 12.0
    roll = second_moment - VOLUME * DRAFT / 2.0
    return np.diag(DENSITY * GRAVITY * np.array([0.0, 0.0, area, roll, roll, 0.0]))


def square_mean(matrix: Array) -> Array:
    """A reciprocal matrix of a square barge: symmetric, unchanged by a quarter turn, other couplings zero."""
    turn = np.zeros((6, 6))
    for i, (j, sign) in enumerate([(1, -1), (0, 1), (2, 1), (4, -1), (3, 1), (5, 1)]):
        turn[i, j] = sign
    symmetric = (matrix + matrix.T) / 2.0
    mean = (symmetric + turn @ symmetric @ turn.T) / 2.0
    mask = np.zeros((6, 6))
    for i, j in SQUARE_PAIRS:
        mask[i, j] = 1.0
    return np.asarray(mean * mask)


def compute(moonpool: bool, depth: float = DEPTH) -> HydroDatabase:
    """Solve all problems; half an hour on two cores."""
    import capytaine

    omega = frequencies(moonpool)
    added_mass, damping, excitation = [], [], []
    asymmetry = pressure_difference = 0.0
    # Capytaine 3.0 keeps the matrices of every frequency (an lru_cache on a method): a new process every few of them.
    with get_context("spawn").Pool(1, maxtasksperchild=5) as pool:
        solve = partial(solve_frequency, moonpool=moonpool, depth=depth)
        infinite, _, _ = pool.apply(solve, (np.inf,))
        for w, (a, b, x) in zip(omega, pool.imap(solve, omega), strict=True):
            b_far = square_mean(far_field_damping(x, float(w), depth))
            asymmetry = max(asymmetry, abs(a[0, 4] - a[4, 0]) / np.sqrt(abs(a[0, 0] * a[4, 4])))
            difference = abs(b[2, 2] / b_far[2, 2] - 1.0)
            pressure_difference = max(pressure_difference, difference if 0.3 < w < 1.0 else 0.0)
            added_mass.append(square_mean(a))
            damping.append(b_far)
            excitation.append(x[::KEPT_HEADINGS])
            print(f"{w:6.4f} rad/s  A33 {a[2, 2]:.4g}  B33 {b_far[2, 2]:.4g} (pressure {b[2, 2]:.4g})", flush=True)
    panels = [4 * len(faces) for faces in quarter_mesh(moonpool)]
    return HydroDatabase(
        name="moonpool" if moonpool else "closed" if depth == DEPTH else "deep",
        omega=omega,
        heading=HEADINGS[::KEPT_HEADINGS],
        added_mass=np.array(added_mass),
        added_mass_infinite=square_mean(infinite),
        damping=np.array(damping),
        excitation=np.array(excitation),
        stiffness=hydrostatic_stiffness(moonpool),
        volume=VOLUME,
        depth=depth,
        density=DENSITY,
        gravity=GRAVITY,
        provenance=(
            f"Capytaine {capytaine.__version__}, direct method, high_freq singularities",
            f"{panels[0]} panels on the hull, {panels[1]} on the lid, graded, 2 x 2 points",
            f"box {LENGTH:g} x {LENGTH:g} x {DRAFT:g} m, moonpool {MOONPOOL:g} x {MOONPOOL:g} m "
            + ("open" if moonpool else f"closed {-DECK:g} m below the waterline"),
            f"depth {depth:g} m up to k h = 6, infinite above; about the PRP (0, 0, 0)",
            "damping from the far field (Haskind); added mass and excitation from pressure",
            f"before averaging: |A15 - A51| at most {asymmetry:.1e} of sqrt(A11 A55)",
            f"B33 from pressure within {pressure_difference:.1%} of the far field's, 0.3 to 1 rad/s",
        ),
    )


def main(arguments: Sequence[str] | None = None) -> None:
    """Command line: compute one variant and write it to the data folder (or to `--output`)."""
    parser = argparse.ArgumentParser(description="hydrodynamic database of the barge")
    parser.add_argument("--moonpool", action="store_true", help="leave the moonpool open")
    parser.add_argument("--deep", action="store_true", help="deep water at every frequency")
    parser.add_argument("--output", type=Path, help="file to write (default: the package's data folder)")
    options = parser.parse_args(arguments)
    name = "barge_moonpool.json" if options.moonpool else "barge_deep.json" if options.deep else "barge.json"
    database = compute(options.moonpool, DEEP if options.deep else DEPTH)
    save(database, options.output or Path(__file__).parent / "data" / name)


if __name__ == "__main__":
    main()
