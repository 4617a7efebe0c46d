"""Momentum theory and dynamic inflow at blade stations, as CasADi expressions.

Sources: Hansen, "Aerodynamics of Wind Turbines", 2nd ed. (2008), chapters 6 and 9; Buhl, NREL/TP-500-36834 (2005).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

#: Coupling constant of the two filters, Hansen eq. 9.17.
OYE_K = 0.6
# Least momentum velocity, m/s: bounds the induced velocity of a rotor turning in still air at its first instant.
_LEAST_VELOCITY = 0.05
# exp(-f) above which Prandtl's factor stays at 0.02: only where the flow is normal to the very tip.
_LARGEST_EXPONENTIAL = 0.9995


def prandtl_factor(sine: Any, radius: Any, tip_radius: float, hub_radius: float, blades: int) -> Any:
    """Tip loss times hub loss, Hansen eq. 6.34 and its mirror image at the hub.

    Args:
        sine: sine of the inflow angle, non-negative.
        radius: distance from the shaft, m, between the two radii.
    """

    def factor(distance: Any) -> Any:
        exponential = ca.exp(-0.5 * blades * distance / ca.fmax(sine, 1e-6))
        return 2.0 / np.pi * ca.acos(ca.fmin(exponential, _LARGEST_EXPONENTIAL))

    return factor((tip_radius - radius) / radius) * factor((radius - hub_radius) / hub_radius)


def momentum_velocity(normal: Any, induced: Any, loss: Any) -> Any:
    """F times the velocity that multiplies the induced one in momentum theory: thrust per area is 2 rho w times it.

    Up to an induction of 0.4, F |V - w| (Glauert's momentum theory); above it Buhl's eq. 18,
    C_T = 8/9 + (4 F - 40/9) a + (50/9 - 4 F) a^2, divided by 4 a / V. Both give the same value and slope of C_T at 0.4.

    Args:
        normal: undisturbed relative wind normal to the rotor, m/s (of either sign).
        induced: axial induced velocity, positive against the positive normal direction, m/s.
        loss: Prandtl's factor F.
    """
    v = ca.fabs(normal)
    w = ca.if_else(normal < 0, -induced, induced)
    light = loss * ca.fabs(v - w)
    bounded = ca.fmax(w, ca.fmax(0.4 * v, 1e-3))
    heavy = (8.0 / 9.0 * v**2 / bounded + (4.0 * loss - 40.0 / 9.0) * v + (50.0 / 9.0 - 4.0 * loss) * bounded) / 4.0
    return ca.fmax(ca.if_else(w > 0.4 * v, heavy, light), _LEAST_VELOCITY)


@dataclass(frozen=True)
class WakeRates:
    """Time derivatives of the two filter states of one induced-velocity component."""

    intermediate: Any
    induced: Any


def oye_rates(quasi_steady: Any, intermediate: Any, induced: Any, tau_1: Any, tau_2: Any) -> WakeRates:
    """Oye's dynamic inflow, Hansen eqs. 9.15-9.16.

    Eq. 9.15, W_int + tau_1 dW_int/dt = W_qs + k tau_1 dW_qs/dt, with the state s = W_int - k W_qs, so that W_qs
    need not be differentiated.
    """
    passed = intermediate + OYE_K * quasi_steady
    return WakeRates(((1.0 - OYE_K) * quasi_steady - intermediate) / tau_1, (passed - induced) / tau_2)


def oye_time_constants(wind: Any, induction: Any, radius: Any, tip_radius: float, factor: Any) -> tuple[Any, Any]:
    """Time constants tau_1 (scalar) and tau_2 (by station), s: Hansen eqs. 9.18-9.19, times `factor`.

    Args:
        wind: rotor-averaged relative wind, m/s; at least 1 m/s is used.
        induction: rotor-averaged axial induction; from 0 to 0.5 is used.
    """
    bounded = ca.fmin(ca.fmax(induction, 0.0), 0.5)
    tau_1 = factor * 1.1 / (1.0 - 1.3 * bounded) * tip_radius / ca.fmax(wind, 1.0)
    return tau_1, (0.39 - 0.26 * (radius / tip_radius) ** 2) * tau_1
