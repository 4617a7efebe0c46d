"""Waves and potential flow on a floating platform: hydrostatics, radiation memory, wave excitation, viscous drag.

Linear theory about the mean position, as HydroDyn's (Jonkman, NREL/TP-500-41958, 2007, section 2.3); all loads at the
platform reference point (PRP) and in global axes. The force -A_inf * acceleration is NOT in the outputs: it belongs to
the platform's mass matrix, to which the output `added_mass` goes. Neither is the weight.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import numpy.typing as npt

from fmus_src.component import Component
from fmus_src.hydro import excitation, given_sea, headings, waves
from fmus_src.hydro.database import DEFAULTS, HydroDatabase, load, positive, stated, warn_of_scale, wave_number
from fmus_src.hydro.radiation import RadiationModel, radiation_model

Array = npt.NDArray[np.float64]

COMPONENTS = 360  # of the irregular sea
STIFFNESS = (
    ("heave", 2, 2, "N/m"), ("roll", 3, 3, "N.m/rad"), ("pitch", 4, 4, "N.m/rad"), ("heave_roll", 2, 3, "N/rad"),
    ("heave_pitch", 2, 4, "N/rad"), ("roll_pitch", 3, 4, "N.m/rad"),
)  # fmt: skip
# What a database must reach, rad/s, for waves of a spectrum: its tails beyond would be missed.
SPECTRUM = (0.3, 1.5)


@dataclass(frozen=True)
class _Motion:
    """Inputs: position (m) and velocity (m/s) of the PRP, roll, pitch, yaw (rad), angular velocity (rad/s)."""

    position: Any
    rotation: Any
    velocity: Any
    angular_velocity: Any


@dataclass(frozen=True)
class _Train:
    """Loads and kinematics of a train of waves at time t: all linear in a cos(w t + e) and a sin(w t + e)."""

    elevation: Any
    loads: Any  # (6,), N and N m
    along: list[Any]  # horizontal water velocity along the heading at the Gauss points, m/s
    up: list[Any]  # vertical one


@dataclass(frozen=True)
class _Water:
    """What the parts share: coefficients, their headings, and where the drag is integrated."""

    database: HydroDatabase
    headings: headings.Headings
    sums: tuple[excitation.HeadingSum, ...]  # per degree of freedom
    draft: float  # m
    gauss: tuple[tuple[float, float], ...]  # depth of a point (m), its share of the draft


def component(
    database: str | HydroDatabase = "closed",
    sea: str | Path | waves.WaveComponents | None = None,
    displaced_volume: float | None = None,
    water_depth: float | None = None,
    water_density: float | None = None,
    gravity: float | None = None,
    unit_length: float = 1.0,
    draft: float = 4.0,
) -> Component:
    """The platform's hydrodynamics.

    Args:
        database: coefficients: "closed", "moonpool" or "deep" (the ITI Energy barge), or a path as `database.load`
            takes it: a JSON file, Capytaine's NetCDF (`.nc`), or the root of WAMIT's files ("DIR/Barge").
        sea: a given sea in place of the irregular one from Hs, Tp, gamma and seed: components, or a file of components
            or of an elevation record (see `given_sea.read`).
        displaced_volume, water_depth, water_density, gravity: m3, m, kg/m3, m/s2: what the file lacks (default: the
            barge's 6000, 150, 1025, 9.80665).
        unit_length: m, ULEN of WAMIT's files; other databases have none.
        draft: m, length of the drag member from mean sea level down.

    Raises:
        ValueError: as `database.load`; a sea outside the database's frequencies; a draft beyond the water depth.
    """
    positive("draft", draft)
    given = {"volume": displaced_volume, "depth": water_depth, "density": water_density, "gravity": gravity}
    if isinstance(database, HydroDatabase):
        stated(database.name, {key: getattr(database, key) for key in DEFAULTS}, given)
        if unit_length != 1.0:
            raise ValueError(f"hydro: unit_length {unit_length:g} is for WAMIT's files; leave it out")
    else:
        database = load(database, **given, unit_length=unit_length)
    if not draft <= database.depth:
        raise ValueError(f"hydro: draft {draft:g} m must not be above the water depth, {database.depth:g} m")
    warn_of_scale(database)
    c = Component("hydro", "Waves, hydrostatics, radiation and viscous drag of the platform", symbols="MX")
    water = _water(database, draft)
    heading = _heading(c, water)
    if sea is None:
        irregular = _irregular(c, water, heading)
        sea_note = f"JONSWAP sea of {COMPONENTS} components"
    else:
        found = sea if isinstance(sea, waves.WaveComponents) else given_sea.read(Path(sea))
        found, sea_note = given_sea.within(found, float(database.omega[0]), float(database.omega[-1]))
        irregular = _given(c, water, heading, found)
    regular = _regular(c, water, heading)
    motion = _motion(c)
    memory = radiation_model(database)
    static = _hydrostatics(c, database, motion)
    loads = static + _radiation(c, memory, motion) + irregular.loads + regular.loads
    along = [a + b for a, b in zip(irregular.along, regular.along, strict=True)]
    up = [a + b for a, b in zip(irregular.up, regular.up, strict=True)]
    drag_force, drag_moment = _drag(c, water, motion, heading, along, up)
    c.output("force", loads[:3] + drag_force, unit="N", nominal=1e6, description="force on the platform, global frame")
    c.output(
        "moment", loads[3:] + drag_moment, unit="N.m", nominal=1e7,
        description="moment on the platform about its reference point, global frame",
    )  # fmt: skip
    c.output(
        "wave_elevation", irregular.elevation + regular.elevation, unit="m", description="wave elevation at x = y = 0"
    )
    c.output(
        "added_mass", database.added_mass_infinite, nominal=1e7,
        description="infinite-frequency added mass about the platform reference point, constant: kg, kg.m, kg.m2",
    )  # fmt: skip
    facts = (f"database {database.name}", *database.provenance, water.headings.note, memory.statement, sea_note)
    c.description += ". " + ". ".join(fact[:1].upper() + fact[1:] for fact in facts)
    return c


def _water(database: HydroDatabase, draft: float) -> _Water:
    covered = headings.covered(database)
    # Three Gauss points integrate the drag over depth.
    points = zip(*np.polynomial.legendre.leggauss(3), strict=True)
    gauss = tuple((draft * (-0.5 + 0.5 * float(x)), 0.5 * float(w)) for x, w in points)
    sums = tuple(excitation.heading_sum(covered, dof) for dof in range(6))
    return _Water(database, covered, sums, draft, gauss)


def _heading(c: Component, water: _Water) -> Any:
    """The waves' heading, bounded to what the database covers."""
    covered = water.headings
    low, high, start = None, None, 0.0
    if not covered.circle:
        low, high = float(covered.angle[0]) - headings.TOUCH, float(covered.angle[-1]) + headings.TOUCH
        start = min(max(0.0, float(covered.angle[0])), float(covered.angle[-1]))
    return c.parameter(
        "heading", start, unit="rad", display_unit="deg", min=low, max=high, description="direction the waves travel to"
    )


def _motion(c: Component) -> _Motion:
    return _Motion(
        c.input("platform.position", 3, unit="m", description="platform reference point, global frame"),
        c.input("platform.rotation", 3, unit="rad", display_unit="deg", description="roll, pitch, yaw; R = Rz Ry Rx"),
        c.input("platform.velocity", 3, unit="m/s", description="velocity of the reference point, global frame"),
        c.input("platform.angular_velocity", 3, unit="rad/s", description="angular velocity, global frame"),
    )


def _hydrostatics(c: Component, database: HydroDatabase, motion: _Motion) -> Any:
    """Buoyancy at rest and linear restoring; roll and pitch turn with the yawed barge, so that no work is gained."""
    weight = database.density * database.gravity
    volume = c.parameter(
        "displaced_volume", database.volume, unit="m3", min=0.0, description="displaced volume at rest"
    )
    stiffness = {
        name: c.parameter(f"{name}_stiffness", database.stiffness[i, j], unit=unit, min=0.0 if i == j == 2 else None,
                          description=f"C{i + 1}{j + 1} = C{j + 1}{i + 1}: waterplane and buoyancy, without the weight")
        for name, i, j, unit in STIFFNESS
    }  # fmt: skip
    matrix = ca.MX.zeros(3, 3)
    for name, i, j, _ in STIFFNESS:
        matrix[i - 2, j - 2] = stiffness[name]
        matrix[j - 2, i - 2] = stiffness[name]
    cos, sin = ca.cos(motion.rotation[2]), ca.sin(motion.rotation[2])
    heave, roll, pitch = ca.vertsplit(-ca.mtimes(matrix, ca.vertcat(motion.position[2], motion.rotation[:2])))
    return ca.vertcat(0, 0, weight * volume + heave, cos * roll - sin * pitch, sin * roll + cos * pitch, 0)


def _radiation(c: Component, model: RadiationModel, motion: _Motion) -> Any:
    """Radiation memory -c x of the fitted state-space model."""
    active = c.parameter(
        "radiation_memory", 1.0, kind="boolean", description="0: infinite-frequency added mass only (no memory)"
    )
    # States are scaled to the order of a metre per second times a second.
    x = c.state("radiation_state", len(model.a), description="state of the radiation memory")
    a, b, out = (ca.sparsify(ca.DM(m)) for m in (model.a, model.b, model.c))
    velocity = ca.vertcat(motion.velocity, motion.angular_velocity)
    c.derivative(x, ca.mtimes(a, x) + ca.mtimes(b, velocity))
    return -active * ca.mtimes(out, x)


def _irregular(c: Component, water: _Water, heading: Any) -> _Train:
    """The JONSWAP sea."""
    low, high = (float(water.database.omega[n]) for n in (0, -1))
    if low > SPECTRUM[0] or high < SPECTRUM[1]:
        raise ValueError(
            f"hydro: {water.database.name}: {low:g} to {high:g} rad/s is too narrow for a wave spectrum, which needs "
            f"{SPECTRUM[0]:g} to {SPECTRUM[1]:g} rad/s; compute more frequencies or give a sea"
        )
    hs = c.parameter("Hs", 4.0, unit="m", min=0.0, description="significant wave height; 0: still water")
    tp = c.parameter("Tp", 12.5, unit="s", min=4.0, max=25.0, description="peak period")
    gamma = c.parameter("gamma", 0.0, min=0.0, max=10.0, description="peak enhancement; 0: formula of IEC 61400-3")
    seed = c.parameter("seed", 1, kind="integer", min=0, max=2**31 - 1, description="seed of the random phases")
    omega, width = waves.frequency_cells(COMPONENTS, max(low, waves.LOWEST), min(high, waves.HIGHEST))
    enhancement = ca.if_else(gamma > 0, ca.fmax(gamma, 1e-3), waves.peak_enhancement(hs, tp))
    amplitude = c.calculated(
        "wave.amplitude", waves.amplitudes(omega, width, hs, tp, enhancement), unit="m", internal=True,
        description="of the components",
    )  # fmt: skip
    phase = c.calculated(
        "wave.phase", waves.phases(seed, COMPONENTS), unit="rad", internal=True,
        description="e in cos(w t + e) at x = y = 0",
    )  # fmt: skip
    angle = ca.DM(omega) * c.time + phase
    return _spectrum(c, water, heading, omega, amplitude * ca.cos(angle), amplitude * ca.sin(angle))


def _given(c: Component, water: _Water, heading: Any, sea: waves.WaveComponents) -> _Train:
    """A given sea; of evenly spaced frequencies, as Fourier series have them, it costs less."""
    step = waves.spacing(sea.omega)
    grid = waves.on_grid(sea, step) if step else sea
    if step and len(grid.omega) < 3 * len(sea.omega) + waves.COLUMNS:
        cosine, sine = waves.grid_oscillations(grid, step, c.time)
        # What fills the grid has no amplitude: its frequency is of no account but must be the database's.
        omega = np.clip(grid.omega, water.database.omega[0], water.database.omega[-1])
    else:
        cosine, sine = waves.oscillations(sea, c.time)
        omega = sea.omega
    return _spectrum(c, water, heading, omega, cosine, sine)


def _spectrum(c: Component, water: _Water, heading: Any, omega: Array, cosine: Any, sine: Any) -> _Train:
    """Waves a cos(w t + e) and a sin(w t + e) of frequencies known when the component is built."""
    database = water.database
    # Summing the waves into the spline's basis first takes four products a wave instead of twelve, and few parameters.
    basis = ca.sparsify(ca.DM(excitation.spline_basis(database, omega).toarray().T))
    cosine_sums, sine_sums = ca.mtimes(basis, cosine), ca.mtimes(basis, sine)
    loads = []
    for dof, name in enumerate(excitation.DOFS):
        over_heading = excitation.functions(water.sums[dof].terms, water.headings, heading)
        points = excitation.control_points(database, water.sums[dof].coefficients)
        real, imag = (
            c.calculated(
                f"wave.{name}_{part}", ca.mtimes(ca.DM(values), over_heading), unit="N/m" if dof < 3 else "N",
                internal=True,
                description=f"{part} part of the {name} excitation (lead positive): spline over frequency",
            )
            for part, values in (("real", points.real), ("imaginary", points.imag))
        )  # fmt: skip
        loads.append(ca.dot(real, cosine_sums) - ca.dot(imag, sine_sums))
    along, up = [], []
    for horizontal, vertical in _kinematics(water):
        along.append(ca.dot(ca.DM(horizontal), cosine_sums))
        up.append(-ca.dot(ca.DM(vertical), sine_sums))
    # The basis functions add up to one at every frequency.
    return _Train(ca.sum1(cosine_sums), ca.vertcat(*loads), along, up)


def _kinematics(water: _Water) -> list[tuple[Array, Array]]:
    """Control points over frequency of w cosh k(z + h) / sinh k h and w sinh k(z + h) / sinh k h, per Gauss point."""
    omega = water.database.omega
    k = wave_number(omega, water.database.depth, water.database.gravity)
    profiles = [waves.depth_profiles(ca.DM(k), z, water.database.depth) for z, _ in water.gauss]
    return [
        (_points(water.database, omega * np.array(h).ravel()), _points(water.database, omega * np.array(v).ravel()))
        for h, v in profiles
    ]


def _points(database: HydroDatabase, values: Array) -> Array:
    return np.asarray(excitation.control_points(database, values[:, None].astype(complex)).real)


def _regular(c: Component, water: _Water, heading: Any) -> _Train:
    """A regular wave added to the sea."""
    database = water.database
    amplitude = c.parameter("regular_wave.amplitude", 0.0, unit="m", min=0.0, description="0: no regular wave")
    period = c.parameter(
        "regular_wave.period", 12.5, unit="s", min=2.0 * np.pi / float(database.omega[-1]),
        max=2.0 * np.pi / float(database.omega[0]), description="period of the regular wave",
    )  # fmt: skip
    phase = c.parameter("regular_wave.phase", 0.0, unit="rad", description="e in cos(w t + e) at x = y = 0")
    omega = 2.0 * ca.pi / period
    terms: list[Any] = []
    for dof in range(6):
        over_heading = excitation.functions(water.sums[dof].terms, water.headings, heading)
        parts = excitation.at_frequency(database, excitation.DOFS[dof], water.sums[dof].coefficients, omega)
        terms += [ca.dot(part, over_heading) for part in parts]
    per_metre = c.calculated(
        "regular_wave.excitation", ca.vertcat(*terms),
        description="real and imaginary parts of the excitation per metre of amplitude, surge to yaw, N/m and N",
    )  # fmt: skip
    k = c.calculated(
        "regular_wave.number", waves.dispersion(omega, database.depth, database.gravity), unit="rad/m",
        description="wave number",
    )  # fmt: skip
    angle = omega * c.time + phase
    cosine, sine = amplitude * ca.cos(angle), amplitude * ca.sin(angle)
    loads = ca.vertcat(*[per_metre[2 * i] * cosine - per_metre[2 * i + 1] * sine for i in range(6)])
    profiles = [waves.depth_profiles(k, z, database.depth) for z, _ in water.gauss]
    return _Train(
        cosine, loads, [omega * h * cosine for h, _ in profiles], [-omega * v * sine for _, v in profiles]
    )  # fmt: skip


def _drag(
    c: Component, water: _Water, motion: _Motion, heading: Any, along: list[Any], up: list[Any]
) -> tuple[Any, Any]:
    """Morison drag on a vertical circular member: force (3,) and moment about the PRP (3,).

    Only the relative velocity normal to the member counts (Jonkman 2007, eq. 2-28), with the water's at the undisplaced
    position.
    """
    coefficient = c.parameter("drag_coefficient", 1.0, min=0.0, description="transverse drag coefficient", tunable=True)
    diameter = c.parameter("drag_diameter", 45.1352, unit="m", min=0.0, description="diameter of the drag member")
    factor = 0.5 * water.database.density * coefficient * diameter * water.draft
    sines, cosines = ca.sin(motion.rotation), ca.cos(motion.rotation)
    # Third column of Rz Ry Rx: the platform's z axis.
    axis = ca.vertcat(
        cosines[2] * sines[1] * cosines[0] + sines[2] * sines[0],
        sines[2] * sines[1] * cosines[0] - cosines[2] * sines[0],
        cosines[1] * cosines[0],
    )
    force, moment = ca.MX.zeros(3), ca.MX.zeros(3)
    for (z, share), horizontal, vertical in zip(water.gauss, along, up, strict=True):
        arm = z * axis
        flow = ca.vertcat(ca.cos(heading) * horizontal, ca.sin(heading) * horizontal, vertical)
        relative = flow - motion.velocity - ca.cross(motion.angular_velocity, arm)
        normal = relative - ca.dot(relative, axis) * axis
        # The small term keeps the derivative finite where the relative velocity vanishes.
        part = factor * share * ca.sqrt(ca.sumsqr(normal) + 1e-12) * normal
        force += part
        moment += ca.cross(arm, part)
    return force, moment
