"""The rotor of elastic blades: their modes are solved for, so that the rest of the turbine sees one body at the apex.

A blade obeys, about the apex and in its pitched frame, with a and alpha the accelerations of the rotor that are not
known yet, G its (linear, angular) columns and Q all that is known of its modal equations,

    q'' = M^-1 (Q - G' (a, alpha)),        load on the hub = known load - G M^-1 Q - (I - G M^-1 G') (a, alpha)

(static condensation of the modes, exact). M^-1 is constant, with zeros for locked modes; so are four of the six rows of
G, all but those of acceleration along the blade and of rotation about it. The kinematics leave out pitch rate and pitch
acceleration, as ElastoDyn's do: at 8 deg/s they are a tenth of the rotor's speed, about an axis of small inertia.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from fmus_src.barge.dynamics import Load, RigidMotion, rotation
from fmus_src.barge.elastic import BeamIntegrals, ElasticInertia, Inertia, elastic_inertia

BLADES = 3


# Rows of G: acceleration along and rotation about x, y, z of the blade.
FIXED, VARYING = [0, 1, 3, 4], [2, 5]


@dataclass(frozen=True)
class BladeProperties:
    """Symbols of one blade, all alike.

    Attributes:
        integrals: over its mass, distances from the apex; modal_inverse: M^-1 of the free modes, (3, 3).
        response: M^-1 G' of the fixed rows, (3, 4); condensed: G M^-1 G' of the same, (4, 4).
        stiffness, damping: of the modes, (3, 3).
    """

    integrals: BeamIntegrals
    modal_inverse: Any
    response: Any
    condensed: Any
    stiffness: Any
    damping: Any


@dataclass(frozen=True)
class BladeMotion:
    """One blade at an instant, in its pitched frame and about the apex.

    Attributes:
        axes: v_platform = axes v_blade, (3, 3); pitch_turn: v_coned = pitch_turn v_blade, (3, 3).
        known: q'' without the response to further accelerations, (3,); response: of q'' to (a, alpha), (3, 6).
        inertia: with the modes solved for; load: on the hub, without further accelerations.
    """

    axes: Any
    pitch_turn: Any
    known: Any
    response: Any
    inertia: Inertia
    load: Load

    def accelerations(self, a: Any, alpha: Any) -> Any:
        """q'' for further accelerations of the apex and of the rotor, platform axes, (3,)."""
        return self.known - self.response @ ca.vertcat(self.axes.T @ a, self.axes.T @ alpha)

    def on_hub(self, a: Any, alpha: Any) -> tuple[Any, Any]:
        """Force and moment about the apex on the hub, less the air's, in the blade's pitched frame."""
        force, moment = self.inertia.load(self.axes.T @ a, self.axes.T @ alpha)
        return self.load.force - force, self.load.moment - moment


def blade_axes(shaft: Any, azimuth: Any, cone: float, pitch: Any) -> list[tuple[Any, Any]]:
    """Axes of the pitched frame of each blade, in the frame of `shaft` (axes of the shaft frame) and in the coned one.

    Args:
        azimuth, cone: rad; pitch: towards feather, rad, (3,).
    """
    c, s = ca.cos(azimuth), ca.sin(azimuth)
    axes = []
    for k in range(BLADES):
        C, S = np.cos(2 * np.pi * k / BLADES), np.sin(2 * np.pi * k / BLADES)
        cos, sin = C * c - S * s, C * s + S * c
        turn = ca.SX(3, 3)
        turn[0, 0], turn[1, 1], turn[2, 2], turn[1, 2], turn[2, 1] = 1, cos, cos, -sin, sin
        # x_b = cos(pitch) x_c - sin(pitch) y_c: a turn about z against the right-hand rule.
        feather = rotation(2, pitch[k]).T
        axes.append((shaft @ (turn @ (rotation(1, cone) @ feather)), feather))
    return axes


def blade_motion(
    p: BladeProperties, axes: tuple[Any, Any], hub: RigidMotion, q: Any, rates: Any, air: Any
) -> BladeMotion:
    """A blade on the hub, whose motion is given at the apex.

    Args:
        axes: as `blade_axes`; air: modal force of the air, N, (3,).
    """
    to_blade = axes[0].T
    body = elastic_inertia(p.integrals, q, rates, to_blade @ hub.omega)
    force, moment, modal = body.resistance(to_blade @ hub.specific_force, to_blade @ hub.alpha)
    known = p.modal_inverse @ (air - p.stiffness @ q - p.damping @ rates - modal)
    response, condensed = _condensation(p, body)
    return BladeMotion(
        axes=axes[0],
        pitch_turn=axes[1],
        known=known,
        response=response,
        inertia=Inertia(
            body.rigid.linear - condensed[:3, :3],
            body.rigid.coupling - condensed[:3, 3:],
            body.rigid.angular - condensed[3:, 3:],
        ),
        load=Load(-force - body.linear @ known, -moment - body.angular @ known),
    )


def fixed_rows(b: BeamIntegrals) -> Any:
    """The constant rows of G, (4, 3)."""
    return ca.vertcat(b.shape, -b.moment[1, :], b.moment[0, :])


def _condensation(p: BladeProperties, body: ElasticInertia) -> tuple[Any, Any]:
    """M^-1 G', (3, 6), and G M^-1 G', (6, 6)."""
    varying = ca.vertcat(body.linear[2, :], body.angular[2, :])
    along = p.modal_inverse @ varying.T
    mixed = fixed_rows(p.integrals) @ along
    response, condensed = ca.SX(3, 6), ca.SX(6, 6)
    response[:, FIXED], response[:, VARYING] = p.response, along
    condensed[FIXED, FIXED], condensed[VARYING, VARYING] = p.condensed, varying @ along
    condensed[FIXED, VARYING], condensed[VARYING, FIXED] = mixed, mixed.T
    return response, condensed


def rotor_body(blades: list[BladeMotion]) -> tuple[Inertia, Load]:
    """Inertia and load of all blades about the apex, platform axes."""
    inertia = sum((b.inertia.turned(b.axes) for b in blades[1:]), blades[0].inertia.turned(blades[0].axes))
    force = sum((b.axes @ b.load.force for b in blades), ca.SX(3, 1))
    moment = sum((b.axes @ b.load.moment for b in blades), ca.SX(3, 1))
    return inertia, Load(force, moment)
