"""Induced velocity at blade stations: blade-element momentum theory, skewed wake and dynamic inflow, sampled.

Sources: Hansen, "Aerodynamics of Wind Turbines", 2nd ed. (2008), chapters 6 and 9; Ning, Wind Energy 17 (2014) 1327;
Buhl, NREL/TP-500-36834 (2005); Moriarty & Hansen, NREL/TP-500-36881 (2005). Scalar expressions for one station.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

BLADES = 3
#: Coupling constant of the two filters of dynamic inflow, Hansen eq. 9.17.
OYE_K = 0.6
#: Glauert / Pitt-Peters constant of the skewed wake.
SKEW_CONSTANT = 15.0 * np.pi / 32.0
#: Bounds of the axial induction factor, and the largest change of induced velocity at one sample, m/s.
INDUCTION = (-1.0, 1.5)
LARGEST_CHANGE = 1.0
_LEAST_LOSS = 1e-4
_LARGEST_EXPONENTIAL = 1.0 - 1e-10


@dataclass(frozen=True)
class Place:
    """A blade element in its wind.

    Attributes:
        normal, tangential: undisturbed relative wind, m/s. chord, radius: m.
        tip, hub: (B / 2) (R - r) / r and (B / 2) (r - R_hub) / R_hub.
    """

    normal: Any
    tangential: Any
    chord: Any
    radius: Any
    tip: Any
    hub: Any


def prandtl_factor(sine: Any, tip: Any, hub: Any) -> Any:
    """Tip loss times hub loss, Hansen eq. 6.34 and its mirror image at the hub.

    Args:
        sine: sine of the inflow angle.
        tip, hub: as in `Place`.
    """
    bounded = ca.fmax(ca.fabs(sine), 1e-6)

    def factor(distance: Any) -> Any:
        return 2.0 / np.pi * ca.acos(ca.fmin(ca.exp(-distance / bounded), _LARGEST_EXPONENTIAL))

    return ca.fmax(factor(tip) * factor(hub), _LEAST_LOSS)


def momentum_thrust(normal: Any, induced: Any, loss: Any) -> tuple[Any, Any]:
    """Thrust per area over 2 rho, m2/s2, that momentum theory gives an induced velocity, and its slope, m/s.

    F w |V - w| up to an induction of 0.4; above it Buhl's eq. 18, C_T = 8/9 + (4 F - 40/9) a + (50/9 - 4 F) a^2, which
    continues value and slope.

    Args:
        normal: V, at least zero. induced: w along V.
        loss: Prandtl's factor F.
    """
    light, light_slope = loss * induced * (normal - induced), loss * (normal - 2.0 * induced)
    b, c = 4.0 * loss - 40.0 / 9.0, 50.0 / 9.0 - 4.0 * loss
    heavy = (8.0 / 9.0 * normal**2 + b * normal * induced + c * induced**2) / 4.0
    heavy_slope = (b * normal + 2.0 * c * induced) / 4.0
    is_heavy = induced > 0.4 * normal
    return ca.if_else(is_heavy, heavy, light), ca.if_else(is_heavy, heavy_slope, light_slope)


def induction_step(e: Place, axial: Any, around: Any, lift: Any, slope: Any) -> tuple[Any, Any]:
    """One step of Newton's method towards the induced velocities in equilibrium with the blade elements.

    The loss factor and the other velocity are held, so that one step at each sample lags a changing wind a little:
    1e-4 m/s in gusts of 2 m/s within 3 s, at 0.0125 s. Drag induces nothing, as in AeroDyn.

    Args:
        axial, around: induced velocities, m/s: against the normal wind, and adding to the tangential one.
        lift, slope: lift coefficient and its derivative (1/rad) at these.
    """
    sign = ca.if_else(e.normal < 0, -1.0, 1.0)
    V, w = ca.fabs(e.normal), sign * axial
    un, ut = e.normal - axial, e.tangential + around
    speed = ca.sqrt(un**2 + ut**2 + 1e-6)
    loss = prandtl_factor(un / speed, e.tip, e.hub)
    loading = BLADES * e.chord / (8.0 * np.pi * e.radius)
    thrust, thrust_slope = momentum_thrust(V, w, loss)
    residual = thrust - sign * loading * speed * lift * ut
    stiffness = thrust_slope + loading * ut * (un * lift + ut * slope) / speed
    # The lift's slope is negative in stall: the bound keeps the step in its direction.
    step = -residual / ca.fmax(stiffness, 0.25 * loss * V + 0.1)
    w_next = w + ca.fmin(ca.fmax(step, -LARGEST_CHANGE), LARGEST_CHANGE)
    axial_next = sign * ca.fmin(ca.fmax(w_next, INDUCTION[0] * V), INDUCTION[1] * V)
    bound = ca.fabs(e.tangential)
    around_next = sign * loading * speed * lift / loss
    return axial_next, ca.fmin(ca.fmax(around_next, -bound), bound)


def skew_factor(axial: Any, normal: Any, skew: Any, downwind: Any, ratio: Any) -> Any:
    """Factor on the axial induced velocity in oblique flow: more of it on the downwind side.

    w (1 + K tan(chi / 2) r / R cos(psi - psi_0)), chi = (1 + 0.6 a) chi_0 (Burton et al.; AeroDyn).

    Args:
        skew: chi_0, angle of the wind to the rotor's axis, rad.
        downwind: cosine of the station's azimuth from the downwind direction. ratio: r / R.
    """
    a = axial / (normal + ca.if_else(normal < 0, -1e-3, 1e-3))
    chi = ca.fmin((1.0 + 0.6 * ca.fmin(ca.fmax(a, INDUCTION[0]), INDUCTION[1])) * skew, 0.5 * np.pi)
    return 1.0 + SKEW_CONSTANT * ca.tan(0.5 * chi) * ratio * downwind


def oye_filter(quasi_steady: Any, intermediate: Any, induced: Any, tau: Any, ratio: Any, dt: float) -> tuple[Any, Any]:
    """Oye's dynamic inflow over one sample with the present quasi-steady velocity, Hansen eqs. 9.15-9.16 and 9.19.

    Eq. 9.15, W_int + tau_1 dW_int/dt = W_qs + k tau_1 dW_qs/dt, with the state s = W_int - k W_qs, so that W_qs
    need not be differentiated.

    Args:
        tau: tau_1, s. ratio: r / R, from which tau_2 follows.

    Returns:
        s and the induced velocity at the end of the sample.
    """
    aim = (1.0 - OYE_K) * quasi_steady
    later = aim + (intermediate - aim) * ca.exp(-dt / tau)
    passed = 0.5 * (intermediate + later) + OYE_K * quasi_steady
    return later, passed + (induced - passed) * ca.exp(-dt / ((0.39 - 0.26 * ratio**2) * tau))


def oye_time_constant(wind: Any, induction: Any, tip_radius: float) -> Any:
    """tau_1 of dynamic inflow, s: Hansen eq. 9.18.

    Args:
        wind: rotor-averaged relative wind, m/s; at least 1 m/s is used.
        induction: rotor-averaged axial induction; from 0 to 0.5 is used.
    """
    bounded = ca.fmin(ca.fmax(induction, 0.0), 0.5)
    return 1.1 / (1.0 - 1.3 * bounded) * tip_radius / ca.fmax(wind, 1.0)
