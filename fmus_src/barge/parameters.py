"""Parameters of the barge component, and what is calculated from them once, at initialisation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from fmus_src.barge.turbine import Bending, Turbine
from fmus_src.component import Component
from fmus_src.hydro import database

PLATFORM = ("surge", "sway", "heave", "roll", "pitch", "yaw")
RELATIVE = ("tower_fore_aft_1", "tower_fore_aft_2", "tower_side_1", "tower_side_2", "generator", "drivetrain")


@dataclass(frozen=True)
class Parameters:
    """Symbols of parameters and calculated parameters, SI units.

    Attributes:
        free: 1 for each free degree of freedom, in the order PLATFORM, RELATIVE, (12,).
        nacelle_inertia: about the vertical through the nacelle's mass centre.
        rotor_center: mass centre of the rotor from its apex along the shaft, downwind positive.
        rotor_axial_inertia, rotor_diametral_inertia: about the rotor's mass centre.
        blade_first_moment: of one blade about its root; blade_apex_moment: integral of mu s (s + hub radius).
    """

    gravity: Any
    free: Any
    added_mass: Any
    platform_mass: Any
    platform_center: Any
    platform_inertia: Any
    nacelle_mass: Any
    nacelle_center: Any
    nacelle_inertia: Any
    rotor_mass: Any
    rotor_center: Any
    rotor_axial_inertia: Any
    rotor_diametral_inertia: Any
    blade_first_moment: Any
    blade_apex_moment: Any
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
    free = [
        c.parameter(f"dof.{name}", 1.0, kind="boolean", description=f"whether {name.replace('_', ' ')} is free")
        for name in (*PLATFORM, *RELATIVE)
    ]
    added_mass = c.parameter(
        "added_mass", database.load().added_mass_infinite, nominal=1e7,
        description="infinite-frequency added mass about the platform reference point, global: kg, kg.m, kg.m2",
    )  # fmt: skip
    return Parameters(
        gravity=gravity,
        free=ca.vertcat(*free),
        added_mass=added_mass,
        **_platform(c, turbine),
        **_nacelle(c, turbine),
        **_rotor(c, turbine),
        **_drivetrain(c, turbine),
        **_tower(c, "fore_aft", turbine.tower.fore_aft, turbine.damping_ratio),
        **_tower(c, "side", turbine.tower.side, turbine.damping_ratio),
        **_attachments(c),
        **_initial(c),
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
    return {"nacelle_mass": mass, "nacelle_center": center, "nacelle_inertia": inertia}


def _rotor(c: Component, turbine: Turbine) -> dict[str, Any]:
    """Three rigid coned blades and a hub at the apex whose inertia acts about the shaft only."""
    figures, blade = turbine.rotor, turbine.blade
    mass = c.parameter("blade.mass", blade["mass"], unit="kg", min=0.0, description="mass of one blade")
    center = c.parameter(
        "blade.center_of_mass", blade["center_of_mass"], unit="m", description="blade's mass centre from its root"
    )
    inertia = c.parameter(
        "blade.inertia", blade["inertia"], unit="kg.m2", min=0.0, description="blade's inertia about its root"
    )
    hub_mass = c.parameter("hub.mass", figures["hub_mass"], unit="kg", min=1.0, description="mass of the hub")
    hub_inertia = c.parameter(
        "hub.inertia", figures["hub_inertia"], unit="kg.m2", min=0.0, description="inertia of the hub about the shaft"
    )
    radius, cone = figures["hub_radius"], np.radians(figures["precone_deg"])
    first = mass * center
    at_apex = inertia + 2 * radius * first + mass * radius**2
    total = hub_mass + 3 * mass
    offset = 3 * np.sin(cone) * (first + radius * mass) / total
    diametral = (1.5 * np.cos(cone) ** 2 + 3 * np.sin(cone) ** 2) * at_apex - total * offset**2
    axial = hub_inertia + 3 * np.cos(cone) ** 2 * at_apex
    calculated = c.calculated
    return {
        "rotor_mass": calculated("rotor.mass", total, unit="kg", description="mass of blades and hub"),
        "rotor_center": calculated(
            "rotor.center_of_mass", offset, unit="m", description="rotor's mass centre from the apex, along the shaft"
        ),
        "rotor_axial_inertia": calculated(
            "rotor.axial_inertia", axial, unit="kg.m2", description="inertia of the rotor about the shaft"
        ),
        "rotor_diametral_inertia": calculated(
            "rotor.diametral_inertia", diametral, unit="kg.m2",
            description="inertia of the rotor about a diameter through its mass centre",
        ),
        "blade_first_moment": calculated(
            "blade.first_moment", first, unit="kg.m", description="first mass moment of a blade about its root"
        ),
        "blade_apex_moment": calculated(
            "blade.apex_moment", inertia + radius * first, unit="kg.m2",
            description="integral of mass times distances from root and apex over a blade",
        ),
    }  # fmt: skip


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
