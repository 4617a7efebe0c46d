"""Parameters of the barge component, and what is calculated from them once, at initialisation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from fmus_src.barge.blade import BladeMatrices, blade_matrices
from fmus_src.barge.rotor import BladeProperties, fixed_rows
from fmus_src.barge.tower import Bending
from fmus_src.barge.turbine import Turbine
from fmus_src.component import Component

PLATFORM = ("surge", "sway", "heave", "roll", "pitch", "yaw")
RELATIVE = (
    "tower_fore_aft_1", "tower_fore_aft_2", "tower_side_1", "tower_side_2", "nacelle_yaw", "generator", "drivetrain",
)  # fmt: skip
BLADE = ("blade_flap_1", "blade_flap_2", "blade_edge_1")
LOCKED = ("nacelle_yaw",)


@dataclass(frozen=True)
class Parameters:
    """Symbols of parameters and calculated parameters, SI units.

    Attributes:
        free: 1 for each free degree of freedom, in the order PLATFORM, RELATIVE, (13,).
        nacelle_inertia: about the vertical through the nacelle's mass centre.
        hub_mass, hub_inertia: at the rotor apex; about the shaft.
    """

    gravity: Any
    free: Any
    platform_mass: Any
    platform_center: Any
    platform_inertia: Any
    nacelle_mass: Any
    nacelle_center: Any
    nacelle_inertia: Any
    yaw_stiffness: Any
    yaw_damping: Any
    hub_mass: Any
    hub_inertia: Any
    blade: BladeProperties
    gear_ratio: Any
    generator_inertia: Any
    shaft_stiffness: Any
    shaft_damping: Any
    stiffness_fore_aft: Any
    stiffness_side: Any
    damping_fore_aft: Any
    damping_side: Any
    nacelle_damper_position: Any
    platform_damper_position: Any
    initial_position: Any
    initial_rotation: Any
    initial_tower_fore_aft: Any
    initial_azimuth: Any
    initial_rotor_speed: Any


def declare_parameters(c: Component, turbine: Turbine) -> Parameters:
    """Declare all parameters of the component with the turbine's figures as start values."""
    gravity = c.parameter("gravity", 9.80665, unit="m/s2", min=0.0, description="acceleration of gravity")
    free = [_switch(c, name) for name in (*PLATFORM, *RELATIVE)]
    blade_free = [_switch(c, name, " of every blade") for name in BLADE]
    return Parameters(
        gravity=gravity,
        free=ca.vertcat(*free),
        **_platform(c, turbine),
        **_nacelle(c, turbine),
        **_rotor(c, turbine, ca.vertcat(*blade_free)),
        **_drivetrain(c, turbine),
        **_tower(c, "fore_aft", turbine.tower.fore_aft, turbine.damping_ratio),
        **_tower(c, "side", turbine.tower.side, turbine.damping_ratio),
        **_attachments(c),
        **_initial(c),
    )


def _switch(c: Component, name: str, where: str = "") -> Any:
    words = name.replace("_", " ")
    return c.parameter(
        f"dof.{name}", float(name not in LOCKED), kind="boolean", description=f"whether {words}{where} is free"
    )


def _platform(c: Component, turbine: Turbine) -> dict[str, Any]:
    figures = turbine.platform
    return {
        "platform_mass": c.parameter(
            "platform.mass", figures["mass"], unit="kg", min=1.0, description="mass of the platform"
        ),
        "platform_center": c.parameter(
            "platform.center_of_mass", figures["center_of_mass"], unit="m",
            description="mass centre of the platform, from its reference point, platform frame",
        ),
        "platform_inertia": c.parameter(
            "platform.inertia", figures["inertia"], unit="kg.m2", min=0.0,
            description="roll, pitch and yaw inertia of the platform about its mass centre",
        ),
    }  # fmt: skip


def _nacelle(c: Component, turbine: Turbine) -> dict[str, Any]:
    figures = turbine.nacelle
    mass = c.parameter("nacelle.mass", figures["mass"], unit="kg", min=1.0, description="mass of the nacelle")
    center = c.parameter(
        "nacelle.center_of_mass", figures["center_of_mass"], unit="m",
        description="mass centre of the nacelle from the tower top, nacelle frame",
    )  # fmt: skip
    about_axis = c.parameter(
        "nacelle.yaw_inertia", figures["yaw_inertia"], unit="kg.m2", min=0.0,
        description="inertia of the nacelle about the yaw axis (no roll or pitch inertia is published)",
    )  # fmt: skip
    inertia = c.calculated(
        "nacelle.central_yaw_inertia", about_axis - mass * (center[0] ** 2 + center[1] ** 2), unit="kg.m2",
        description="inertia of the nacelle about the vertical through its mass centre",
    )  # fmt: skip
    stiffness = c.parameter(
        "nacelle.yaw_stiffness", figures["yaw_stiffness"], unit="N.m/rad", min=0.0, description="stiffness of yaw drive"
    )
    damping = c.parameter(
        "nacelle.yaw_damping", figures["yaw_damping"], unit="N.m.s/rad", min=0.0, description="damping of the yaw drive"
    )
    return {
        "nacelle_mass": mass, "nacelle_center": center, "nacelle_inertia": inertia,
        "yaw_stiffness": stiffness, "yaw_damping": damping,
    }  # fmt: skip


def _rotor(c: Component, turbine: Turbine, free: Any) -> dict[str, Any]:
    """Three elastic coned blades and a hub at the apex whose inertia acts about the shaft only."""
    figures = turbine.rotor
    factor = c.parameter(
        "blade.mass_factor", turbine.blade.mass_factor, min=1e-6, description="factor on the blades' mass density"
    )
    hub_mass = c.parameter("hub.mass", figures["hub_mass"], unit="kg", min=1.0, description="mass of the hub")
    hub_inertia = c.parameter(
        "hub.inertia", figures["hub_inertia"], unit="kg.m2", min=0.0, description="inertia of the hub about the shaft"
    )
    matrices = blade_matrices(turbine.blade)
    integrals = matrices.integrals.scaled(factor)
    stiffness, damping = _blade_bending(c, turbine, matrices, factor)
    # A locked mode has its row and column replaced by the identity's, and no response.
    inverse = ca.inv(integrals.modal * (free @ free.T) + ca.diag(1 - free)) * (free @ free.T)
    rows = fixed_rows(integrals)
    condensed = {
        "modal_inverse": (inverse, "inverse modal mass matrix of its free modes, zero for locked ones"),
        "response": (inverse @ rows.T, "response of its modes to the hub's acceleration"),
        "condensed": (rows @ inverse @ rows.T, "inertia that its moving modes take from the hub"),
    }
    blade = BladeProperties(
        integrals=integrals,
        **{
            name: c.calculated(f"blade.{name}", value, internal=True, description=f"blade: {words}")
            for name, (value, words) in condensed.items()
        },
        stiffness=stiffness,
        damping=damping,
    )  # fmt: skip
    straight = {
        "blade.mass": (integrals.mass, "kg", "mass of one blade"),
        "rotor.mass": (hub_mass + 3 * integrals.mass, "kg", "mass of blades and hub"),
        "rotor.axial_inertia": (
            hub_inertia + 3 * np.cos(turbine.cone) ** 2 * integrals.second, "kg.m2",
            "inertia about the shaft of the rotor with straight blades",
        ),
    }  # fmt: skip
    for name, (value, unit, words) in straight.items():
        c.calculated(name, value, unit=unit, description=words)
    return {"hub_mass": hub_mass, "hub_inertia": hub_inertia, "blade": blade}


def _blade_bending(c: Component, turbine: Turbine, matrices: BladeMatrices, mass_factor: Any) -> tuple[Any, Any]:
    """Stiffness and damping of the modes; the ratios hold for any factors on stiffness and mass."""
    factor = {
        name: c.parameter(f"blade.{name}_stiffness_factor", 1.0, min=1e-6, description=f"factor on {name} stiffness")
        for name in ("flap", "edge")
    }
    ratio = turbine.blade.damping_ratio
    flap_damping = c.parameter(
        "blade.flap_damping", [ratio, ratio], min=0.0, description="structural damping ratio of the flap modes"
    )
    edge_damping = c.parameter(
        "blade.edge_damping", ratio, min=0.0, description="structural damping ratio of the edge mode"
    )
    on_stiffness = ca.vertcat(factor["flap"], factor["flap"], factor["edge"])
    on_damping = ca.sqrt(mass_factor * on_stiffness) * ca.vertcat(flap_damping, edge_damping)
    stiffness = c.calculated(
        "blade.stiffness", ca.SX(matrices.stiffness) @ ca.diag(on_stiffness), unit="N/m",
        description="stiffness of a blade's modes flap 1, flap 2, edge 1",
    )  # fmt: skip
    damping = c.calculated(
        "blade.damping", ca.SX(matrices.damping) @ ca.diag(on_damping), unit="N.s/m",
        description="damping of a blade's modes flap 1, flap 2, edge 1",
    )  # fmt: skip
    return stiffness, damping


def _drivetrain(c: Component, turbine: Turbine) -> dict[str, Any]:
    figures = turbine.drivetrain
    return {
        "gear_ratio": c.parameter(
            "drivetrain.gear_ratio", figures["gear_ratio"], min=1e-3, description="generator speed over rotor speed"
        ),
        "generator_inertia": c.parameter(
            "generator.inertia", figures["generator_inertia"], unit="kg.m2", min=1e-3,
            description="inertia of the generator about the high-speed shaft",
        ),
        "shaft_stiffness": c.parameter(
            "drivetrain.stiffness", figures["stiffness"], unit="N.m/rad", min=0.0,
            description="torsional stiffness of the drivetrain, low-speed side",
        ),
        "shaft_damping": c.parameter(
            "drivetrain.damping", figures["damping"], unit="N.m.s/rad", min=0.0,
            description="torsional damping of the drivetrain, low-speed side",
        ),
    }  # fmt: skip


def _tower(c: Component, direction: str, bending: Bending, ratio: float) -> dict[str, Any]:
    """Stiffness and damping matrices of two modes: a stiffness factor scales damping by its root, as in ElastoDyn."""
    words = direction.replace("_", "-")
    factor = c.parameter(
        f"tower.{direction}_stiffness_factor", 1.0, min=1e-6, description=f"factor on the tower's {words} stiffness"
    )
    damping = c.parameter(
        f"tower.{direction}_damping", [ratio, ratio], min=0.0,
        description=f"structural damping ratio of the tower's {words} modes",
    )  # fmt: skip
    return {
        f"stiffness_{direction}": c.calculated(
            f"tower.{direction}_stiffness", factor * bending.stiffness, unit="N/m",
            description=f"stiffness of the tower's {words} modes",
        ),
        f"damping_{direction}": c.calculated(
            f"tower.{direction}_damping_matrix",
            ca.sqrt(factor) * ca.SX(bending.damping) @ ca.diag(damping), unit="N.s/m",
            description=f"damping of the tower's {words} modes",
        ),
    }  # fmt: skip


def _attachments(c: Component) -> dict[str, Any]:
    return {
        "nacelle_damper_position": c.parameter(
            "nacelle_damper.attachment", [0.0, 0.0, 90.0], unit="m",
            description="nacelle damper's attachment in the undisplaced turbine, global",
        ),
        "platform_damper_position": c.parameter(
            "platform_damper.attachment", [0.0, 0.0, -0.281768], unit="m",
            description="platform damper's attachment, platform frame",
        ),
    }  # fmt: skip


def _initial(c: Component) -> dict[str, Any]:
    def start(name: str, unit: str, description: str, degrees: bool = False) -> Any:
        return c.parameter(
            f"initial.{name}", 0.0, unit=unit, description=description, display_unit="deg" if degrees else None
        )

    position = [start(n, "m", f"{n} at the start") for n in PLATFORM[:3]]
    rotation = [start(n, "rad", f"{n} at the start", degrees=True) for n in PLATFORM[3:]]
    return {
        "initial_position": ca.vertcat(*position),
        "initial_rotation": ca.vertcat(*rotation),
        "initial_tower_fore_aft": start("tower_fore_aft", "m", "tower-top displacement in mode 1 at the start"),
        "initial_azimuth": start("azimuth", "rad", "rotor azimuth at the start, 0: blade 1 up", degrees=True),
        "initial_rotor_speed": start("rotor_speed", "rad/s", "rotor speed at the start"),
    }
