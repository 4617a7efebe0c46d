"""Rotor aerodynamics: blade elements, momentum theory with dynamic inflow, dynamic stall, turbulent or steady wind.

Sampled: at each instant flow, wake and loads follow from the inputs then, and the loads hold until the next. So does
AeroDyn, after which the treatment of stations, skewed wake, angle of attack and tower is modelled (Moriarty & Hansen,
NREL/TP-500-36881, 2005; OpenFAST documentation). Frames: `kinematics.py`. Matrices have a column for each station,
blade after blade.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from fmus_src.aero import kinematics as kin
from fmus_src.aero import momentum, tower
from fmus_src.aero import sections as sec
from fmus_src.aero.geometry import Array, Rotor, aerofoil_constants, section_tables
from fmus_src.aero.loads import HeldOutputs, blade_load, declare_rotor_loads
from fmus_src.aero.machine import Figures, machine
from fmus_src.aero.stations import each
from fmus_src.aero.wind import wind_at
from fmus_src.barge.turbine import Turbine
from fmus_src.component import Component


def component(
    rotor: str | Path | Rotor | None = None,
    turbine: str | Path | Turbine | None = None,
    hub_radius: float | None = None,
    precone_deg: float | None = None,
    reynolds: float | None = None,
    user_property: float | None = None,
) -> Component:
    """The rotor, and the tower as far as the air is concerned; by default the NREL 5-MW turbine's.

    Args:
        rotor: AeroDyn's primary file, from which and from the files that it names stations and polars are taken; or a
            folder of `blade.toml` and `sections.toml` in the form of this package's own (`data/`).
        turbine: folder of the structure that carries it (blade modes, tower, hub height), as the barge component's.
        hub_radius, precone_deg: m, deg, negative upwind: AeroDyn's files have neither (default: the turbine's).
        reynolds, user_property: where polars have several tables, at which Reynolds number or property they are used.

    Raises:
        ValueError: a file is missing or malformed, or rotor, turbine and figures do not fit together.
    """
    found = machine(rotor, turbine, Figures(hub_radius, precone_deg, reynolds, user_property))
    c = Component(
        "aero",
        "Rotor aerodynamics by blade-element momentum theory with dynamic inflow and dynamic stall",
        symbols="MX",
        sample_time=sec.SAMPLE_TIME,
        sample_at_start=True,
    )
    r, t = found.rotor, found.tower
    m = kin.declare_motion(c, r.blades)
    radial = kin.radial_directions(r, m.azimuth)
    blades = c.intermediate("blades", ca.horzcat(*[kin.blade_motion(r, m, k, radial[k]) for k in range(r.blades)]))
    place = kin.places(r, found.shapes)
    motion = c.intermediate("motion", kin.station_motion(r, _of_each_blade(r, blades), ca.repmat(place, 1, r.blades)))
    support = c.intermediate("support", tower.declare_support(c))
    strips = c.intermediate("strips", tower.strip_motion(support, tower.strips(t)))

    points = motion[kin.MOTION.rows("point"), :]
    mast = ca.DM([0.0, 0.0, found.hub_height])
    places = ca.horzcat(points, mast, strips[tower.STRIP_MOTION.rows("point"), :])
    wind = c.intermediate("wind", wind_at(c, places, found.hub_height))
    stations, hub = slice(0, points.shape[1]), points.shape[1]
    air = tower.declare_air(c, t)
    at_blades = c.intermediate("disturbed_wind", tower.disturbed(t, air, support, points, wind[:, stations]))
    flow = _flow(c, r, m, blades, motion, at_blades, radial)
    per_length = _forces(c, r, flow, motion, air.density)

    held = HeldOutputs(c)
    loads = [blade_load(r, motion[:, _of(r, k)], per_length[:, _of(r, k)]) for k in range(r.blades)]
    declare_rotor_loads(held, r, m, blades, loads)
    tower.declare_loads(held, tower.drag(t, air, support, strips, wind[:, hub + 1 :]))
    held(
        "wind_speed_hub",
        wind[0, hub],
        "m/s",
        f"wind along X at (0, 0, {found.hub_height:g} m), where the undisplaced hub is",
    )
    held("rotor_averaged_wind", flow.mean_wind, "m/s", "wind along the shaft, area average")
    c.description = ". ".join([c.description, *(fact[:1].upper() + fact[1:] for fact in found.facts)])
    return c


@dataclass(frozen=True)
class _RotorFlow:
    """Flow at all stations.

    Attributes:
        element: constants of the stations. state: of the rotor as a whole, a column of ROTOR_STATE for each station.
        now, before: columns of STATION_FLOW at this and the last sample. mean_wind: area average along the shaft.
    """

    element: Any
    state: Any
    now: Any
    before: Any
    mean_wind: Any


def _flow(
    c: Component, r: Rotor, m: kin.HubMotion, blades: Any, motion: Any, wind: Any, radial: list[Any]
) -> _RotorFlow:
    """Wake, section flow and attached flow of this sample."""
    element = ca.repmat(_elements(r), 1, r.blades)
    start = c.parameter(
        "initial_induced_velocity", 2.0, unit="m/s", description="axial induced velocity at the start, everywhere"
    )
    first = np.zeros(sec.STATION_FLOW.size)
    first[sec.STATION_FLOW.rows("wake")] = [1.0, 0.0, 1.0 - momentum.OYE_K, 1.0, 0.0, 0.0]  # in equilibrium
    before = _station_states(c, r, "flow", "wake and flow at the sections", first, start)
    started = c.sampled_state("started", internal=True, description="0 at the first sample, later 1")
    c.update(started, 1.0)

    axes = _of_each_blade(r, blades[kin.BLADE.rows("axes"), :])
    free = c.intermediate("undisturbed", each("undisturbed", sec.undisturbed, axes, motion, wind, before)[0])
    static = _section_table(c, r, "induction", sec.INDUCTION_COLUMNS, free[sec.UNDISTURBED.rows("alpha"), :])
    state, mean_wind = _rotor_state(
        c, r, m, wind, before[sec.STATION_FLOW.row("wake", "axial", sec.WAKE), :], radial, started
    )
    now = c.intermediate("flow_now", each("sections", sec.sections, element, motion, free, static, before, state)[0])
    c.update(ca.vec(before), ca.vec(now))
    return _RotorFlow(element, state, now, before, mean_wind)


def _forces(c: Component, r: Rotor, f: _RotorFlow, motion: Any, density: Any) -> Any:
    """Force and pitching moment per length at the stations, "c" frame, (4, n)."""
    active = c.parameter(
        "dynamic_stall", 1.0, kind="boolean",
        description="whether section forces are unsteady (Beddoes-Leishman); 0: static coefficients",
    )  # fmt: skip
    before = _station_states(c, r, "separated", "memory of separated flow", np.zeros(sec.SEPARATED.size), 1.0)
    angles = [f.now[sec.STATION_FLOW.row("section", name, sec.SECTION), :] for name in ("alpha_34", "alpha_lagged")]
    found = _section_table(c, r, "sections", sec.FORCE_COLUMNS, ca.horzcat(*angles))
    n = r.blades * r.span.size
    force, separated = each(
        "forces", sec.forces, f.element, motion, f.now, f.before, before, found[:, :n], found[:, n:], f.state,
        ca.vertcat(active, density),
    )  # fmt: skip
    c.update(ca.vec(before), ca.vec(separated))
    return force


def _rotor_state(
    c: Component, r: Rotor, m: kin.HubMotion, wind: Any, axial: Any, radial: list[Any], started: Any
) -> tuple[Any, Any]:
    """Columns of ROTOR_STATE for every station, and the averaged wind along the shaft.

    Args:
        axial: induced velocity at the last sample, (1, n).
    """
    dynamic = c.parameter(
        "dynamic_inflow", 1.0, kind="boolean", description="whether the wake takes time to follow; 0: quasi-steady wake"
    )
    weights = ca.DM(np.tile(r.area_weights, r.blades) / r.blades)
    average = m.axes.T @ (wind @ weights)
    relative = average - m.axes.T @ m.velocity
    across = ca.sqrt(ca.sumsqr(relative[1:3]) + 1e-8)
    direction = relative[1:3] / across
    inner = np.tile([0.0, *r.area_weights[1:-1], 0.0], r.blades)
    induced = axial @ ca.DM(inner / inner.sum())
    tau = momentum.oye_time_constant(relative[0], induced / ca.fmax(relative[0], 1.0), r.tip_radius)
    skew = ca.atan2(across, ca.fabs(relative[0]))
    columns = [
        sec.ROTOR_STATE.pack(sec.RotorState(tau, dynamic, skew, ca.dot(direction, radial[k]), started))
        for k in range(r.blades)
    ]
    stored = c.intermediate("rotor_state", ca.horzcat(*columns))
    return _of_each_blade(r, stored), average[0]


def _elements(r: Rotor) -> Any:
    """Constants of the stations of one blade, (ELEMENT.size, n)."""
    inner = np.array([0.0, *np.ones(r.span.size - 2), 0.0])
    rows = {
        "chord": r.chord,
        "inner": inner,
        "tip": np.where(inner > 0, r.tip_distance, 1.0),
        "hub": np.where(inner > 0, r.hub_distance, 1.0),
        "ratio": r.radius_along / r.tip_radius,
        **aerofoil_constants(r),
    }
    return ca.DM(np.array([rows[name] for name in sec.ELEMENT.sizes]))


def _section_table(c: Component, r: Rotor, name: str, columns: tuple[int, ...], alpha: Any) -> Any:
    """Section coefficients at angles of attack (1, k n), the stations once or several times over; (columns, k n)."""
    data, first, spacing = section_tables(r)
    which = np.tile(r.section, alpha.shape[1] // r.span.size).tolist()
    return c.table(name, data[:, :, columns], first, spacing, which, alpha.T).T


def _station_states(c: Component, r: Rotor, name: str, description: str, first: Array, factor: Any) -> Any:
    """A sampled state of (rows, stations) that starts as `factor` times the column `first`, (rows,)."""
    n = r.blades * r.span.size
    start = ca.DM(np.tile(first, n)) * factor
    state = c.sampled_state(name, first.size * n, start=start, internal=True, description=description)
    return ca.reshape(state, first.size, n)


def _of(r: Rotor, blade: int) -> slice:
    """Columns of a blade."""
    return slice(blade * r.span.size, (blade + 1) * r.span.size)


def _of_each_blade(r: Rotor, columns: Any) -> Any:
    """The column of each station's blade, from one for each blade."""
    return ca.horzcat(*[ca.repmat(columns[:, k], 1, r.span.size) for k in range(r.blades)])
