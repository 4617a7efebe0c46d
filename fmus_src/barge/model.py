"""Barge, tower, nacelle, rotor and drivetrain as a multibody system (Kane's method); see README.md.

Degrees of freedom: six of the platform, two fore-aft and two side-to-side tower modes, nacelle yaw, generator azimuth,
drivetrain torsion, and two flap modes and an edge mode of each blade. Frames and signs as OpenFAST: X downwind, Z up,
origin at mean sea level.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import casadi as ca

from fmus_src.barge.assembly import Loads, State, equations_of_motion
from fmus_src.barge.outputs import declare_outputs
from fmus_src.barge.parameters import Parameters, declare_parameters
from fmus_src.barge.turbine import Turbine, load, nrel_5mw_barge
from fmus_src.component import Component


def component(turbine: Turbine | str | Path | None = None) -> Component:
    """The floating turbine's structure; by default the NREL 5-MW turbine on the ITI Energy barge.

    Args:
        turbine: figures and tower constants of another machine, or the folder of its `turbine.toml`, `tower.csv` and
            `blade.csv` in the form of this package's own (`data/`).

    Raises:
        ValueError: as `fmus_src.barge.turbine.load`.
    """
    c = Component("barge", "Floating barge, tower, nacelle, rotor and drivetrain: structural dynamics")
    figures = turbine if isinstance(turbine, Turbine) else load(Path(turbine)) if turbine else nrel_5mw_barge()
    p = declare_parameters(c, figures)
    loads = _declare_loads(c)
    state = _declare_states(c, p)
    motion = equations_of_motion(figures, p, loads, state)
    c.derivative(state.position, state.velocity)
    c.derivative(state.angles, state.angle_rates)
    c.derivative(state.velocity, motion.acceleration[:3])
    c.derivative(state.angle_rates, motion.acceleration[3:6])
    first = 6
    for coordinate, rate in zip(state.groups, state.group_rates, strict=True):
        last = first + coordinate.numel()
        c.derivative(coordinate, rate)
        c.derivative(rate, motion.acceleration[first:last])
        first = last
    for coordinate, rate, acceleration in zip(state.blades, state.blade_rates, motion.blade_accelerations, strict=True):
        c.derivative(coordinate, rate)
        c.derivative(rate, acceleration)
    declare_outputs(c, figures, p, loads, state, motion)
    for port, place in (("hydro", "platform"), ("mooring", "platform"), ("aero", "hub")):
        c.port(port, place)
    return c


def _declare_loads(c: Component) -> Loads:
    def pair(port: str, where: str, force: str = "force", moment: str = "moment") -> tuple[Any, Any]:
        return (
            c.input(f"{port}.{force}", 3, unit="N", nominal=1e6, description=f"force {where}"),
            c.input(f"{port}.{moment}", 3, unit="N.m", nominal=1e7, description=f"moment {where}"),
        )

    root = "of the air on the deflected blade {} about its root, coned blade frame; for root loads only"
    return Loads(
        hydro=pair("hydro", "of the water (less that of the added mass) at the platform reference point, global"),
        mooring=pair("mooring", "of the mooring lines at the platform reference point, global"),
        aero=pair("aero", "of the air on the rotor at its apex, global"),
        tower=pair("tower", "of the air on the tower at the platform reference point, global"),
        tower_modal=c.input(
            "tower.modal_force", 4, unit="N", nominal=1e4,
            description="work of the air on the tower per metre of the modes fore-aft 1, 2, side-to-side 1, 2",
        ),
        blade_roots=[pair(f"blade{k}", root.format(k), "root_force", "root_moment") for k in (1, 2, 3)],
        modal=[
            c.input(
                f"blade{k}.modal_force", 3, unit="N", nominal=1e5,
                description=f"work of the air on blade {k} per metre of flap mode 1, flap mode 2, edge mode 1",
            )
            for k in (1, 2, 3)
        ],
        nacelle_damper=pair("nacelle_damper", "of the nacelle damper at its attachment, nacelle frame"),
        platform_damper=pair("platform_damper", "of the platform damper at its attachment, platform frame"),
        generator_torque=c.input(
            "servo.generator_torque", unit="N.m", nominal=4e4,
            description="generator torque, high-speed side, positive against the rotation",
        ),
        pitch=c.input("servo.pitch", 3, unit="rad", display_unit="deg", description="pitch of the blades to feather"),
        added_mass=c.input(
            "hydro.added_mass", (6, 6), nominal=1e7,
            description="constant added mass about the platform reference point, global: kg, kg.m, kg.m2",
        ),
    )  # fmt: skip


def _declare_states(c: Component, p: Parameters) -> State:
    """States; the first tower mode has unit deflection at the top, so that its start is the top's displacement."""
    position = c.state(
        "motion.position", 3, unit="m", start=p.initial_position, description="platform reference point, global"
    )
    angles = c.state(
        "motion.rotation", 3, unit="rad", start=p.initial_rotation, display_unit="deg",
        description="roll, pitch and yaw of the platform",
    )  # fmt: skip
    velocity = c.state("motion.velocity", 3, unit="m/s", description="velocity of the platform reference point, global")
    angle_rates = c.state("motion.rotation_rate", 3, unit="rad/s", description="rates of roll, pitch and yaw")
    relative = (
        ("fore_aft", 2, "m", ca.vertcat(p.initial_tower_fore_aft, 0), 0.0, "deflections of the tower's fore-aft modes"),
        ("side", 2, "m", 0.0, 0.0, "deflections of the tower's side-to-side modes"),
        ("nacelle_yaw", (), "rad", 0.0, 0.0, "nacelle yaw"),
        ("generator", (), "rad", p.initial_azimuth, p.initial_rotor_speed, "generator angle over the gear ratio"),
        ("torsion", (), "rad", 0.0, 0.0, "torsion of the drivetrain, rotor less generator"),
    )  # fmt: skip
    blades = [(f"blade{k}", f"deflections of blade {k} in flap mode 1, flap mode 2, edge mode 1") for k in (1, 2, 3)]
    return State(
        position, velocity, angles, angle_rates,
        groups=[
            c.state(f"motion.{name}", shape, unit=unit, start=start, description=words)
            for name, shape, unit, start, _, words in relative
        ],
        blades=[c.state(f"motion.{name}", 3, unit="m", description=words) for name, words in blades],
        group_rates=[
            c.state(f"motion.{name}_rate", shape, unit=f"{unit}/s", start=start, description=f"rate of {words}")
            for name, shape, unit, _, start, words in relative
        ],
        blade_rates=[
            c.state(f"motion.{name}_rate", 3, unit="m/s", description=f"rates of {words}") for name, words in blades
        ],
    )  # fmt: skip
