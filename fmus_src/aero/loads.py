"""From forces per length at the stations to the loads of the blades and the rotor, which are the outputs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca

from fmus_src.aero.geometry import Rotor
from fmus_src.aero.kinematics import BLADE, MOTION, HubMotion
from fmus_src.component import Component


@dataclass(frozen=True)
class BladeLoad:
    """Aerodynamic load of one blade, "c" frame: resultant, moment about the blade root, and forces on the modes."""

    force: Any
    root_moment: Any
    modal: Any


def blade_load(r: Rotor, motion: Any, per_length: Any) -> BladeLoad:
    """Integrate the forces over a blade.

    Args:
        motion: columns of MOTION. per_length: force and pitching moment per length, "c" frame, (4, n).
    """
    here = MOTION.unpack(motion)
    lumped = per_length @ ca.sparsify(ca.DM(r.load_lumping))
    fx, fy, fz = lumped[0, :], lumped[1, :], lumped[2, :]
    x, y, arm = here.position[0, :], here.position[1, :], here.position[2, :] - r.hub_radius
    moment = ca.vertcat(ca.dot(y, fz) - ca.dot(arm, fy), ca.dot(arm, fx) - ca.dot(x, fz), ca.dot(x, fy) - ca.dot(y, fx))
    total, pitching = ca.sum2(lumped), lumped[3, :]
    # About the bent blade's axis: a nose-down moment takes torque from a rotor whose blades bend downwind.
    along = ca.vertcat(ca.dot(here.sin_cant, pitching), 0, ca.dot(here.cos_cant, pitching))
    modal = here.shape_x @ fx.T + here.shape_y @ fy.T + here.shape_z @ fz.T
    return BladeLoad(total[:3], moment + along, modal)


class HeldOutputs:
    """Declares outputs that keep the value of the last sample."""

    def __init__(self, c: Component) -> None:
        self._component = c

    def __call__(self, name: str, value: Any, unit: str, description: str, nominal: float | None = None) -> None:
        c, shape = self._component, () if value.numel() == 1 else value.numel()
        state = c.sampled_state(f"held.{name}", shape, unit=unit, internal=True, description=description)
        c.update(state, value)
        c.output(name, state, unit=unit, description=description, nominal=nominal)


def declare_rotor_loads(held: HeldOutputs, r: Rotor, m: HubMotion, blades: Any, loads: list[BladeLoad]) -> None:
    """Declare loads and power of the rotor and of its blades.

    Args:
        blades: columns of BLADE.
    """
    root = ca.DM([0.0, 0.0, r.hub_radius])
    axes = [ca.reshape(blades[BLADE.rows("axes"), k], 3, 3) for k in range(r.blades)]
    forces = [a @ load.force for a, load in zip(axes, loads, strict=True)]
    moments = [a @ (load.root_moment + ca.cross(root, load.force)) for a, load in zip(axes, loads, strict=True)]
    force, moment = sum(forces[1:], forces[0]), sum(moments[1:], moments[0])
    torque = ca.dot(m.axes[:, 0], moment)
    held("force", force, "N", "rotor force at the apex, global frame", 1e5)
    held("moment", moment, "N.m", "rotor moment about the apex, global frame", 1e6)
    for i, load in enumerate(loads, start=1):
        where = f"of blade {i}, coned unpitched blade frame"
        held(f"blade{i}.root_force", load.force, "N", f"aerodynamic force {where}", 1e5)
        held(f"blade{i}.root_moment", load.root_moment, "N.m", f"aerodynamic moment about the root {where}", 1e6)
        held(f"blade{i}.modal_force", load.modal, "N", f"force of the air on the modes of blade {i}", 1e5)
    held("thrust", ca.dot(m.axes[:, 0], force), "N", "force along the shaft", 1e5)
    held("torque", torque, "N.m", "moment about the shaft", 1e6)
    held("power", torque * m.speed, "W", "aerodynamic power", 1e6)
