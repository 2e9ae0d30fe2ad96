"""Dryden gusts as states of a filter: the air's own rotation, and the gusts that turn with the aircraft.

The filter's V, alpha and beta are relative to the air, so gusts reach them as near-white noise on their rates. The same
gusts do more, in heading axes (along the heading and level; index h), in which MIL-F-8785C gives them:

* the air rotates (3.7.5): p_h is a first-order process of its own; q_h = -dw/dx and r_h = +dv/dx follow from the gusts down
  and to the right, w and v, smoothed over the span by k_q b = 4 b/pi and k_r b = 3 b/pi. Gusts pass at a speed V_g, that of
  the aircraft or, where they were made beforehand, one of their own:

    k_q b/V_g dp_h/dt = -p_h + noise                                                                    (1)
    k_q b dq_h/dt = -V_g q_h - dw/dt           k_r b dr_h/dt = -V_g r_h + dv/dt                         (2)

* the axes turn with the aircraft at dpsi/dt, and the gusts u, v along and across them with it: the air seems to accelerate by
  dpsi/dt times them, without rotating. In a bank of 30 deg that is 0.01 rad/s of beta for seconds on end.

Velocity relative to the air is (U, S, W) in these axes, that over the ground is U + u, S + v, W + w, and no gust changes that. So
none of these states needs noise of its own: c_u = U + u and c_v = S + v, h_q = k_q b q_h - W and h_r = k_r b r_h + S change by the
deterministic part of U, S, W alone, which is that of V, alpha, beta and the attitude:

    dh_q/dt = -V_g q_h - dW/dt                 dh_r/dt = -V_g r_h + dS/dt                               (3)

These are velocities, and not angles as the vanes see them: gusts along the path change the airspeed, and with an angle per airspeed
as the state the air's rotation went with that noise. In strong air (20 kt at 20 ft) it was a moment that nothing explained.

Left out, in E-SPAARO's simulated flights: rolling gusts taken for noise on p pass for persistence of the aircraft (Cl_p at
two thirds); gradients along the body's axes in banked flight, or independent of alpha and beta, and gusts that do not
turn, leave moments that nothing explains, and intervals of the lateral damping terms (Cn_r above all) do not cover.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from sysid.aerodynamics.flight_equations import (
    Trig,
    gust_lags_s,
    gust_rates,
    heading,
    level,
    rotation,
    sines,
    turning,
)


class GustStates(NamedTuple):
    """p_h [rad/s], h_q, h_r, c_u, c_v [m/s] behind V, alpha, beta, p, q, r, phi, theta; ``b`` the span [m].

    passing_mps: the speed at which the gusts pass, where they are simulated at one whatever the airspeed; 0: the airspeed, as in
    real air.
    rotating: q_h, r_h follow from gusts down and to the right; turning_with: u, v turn with the heading. Neither is so in all air:
    some simulators' gusts do not rotate, and no real gust turns with an aircraft.
    """

    b: float
    passing_mps: float = 0.0
    rotating: bool = True
    turning_with: bool = True

    def lags_s(self, V: Any) -> tuple[Any, Any, Any]:
        """T_p, T_q, T_r at airspeed V."""
        return gust_lags_s(self, V)

    def start(self, x: Any) -> tuple[Any, ...]:
        """The five states in air that neither moves nor rotates, by the eight others."""
        U, S, W = heading(x, sines(x))
        return 0.0 * U, -self.rotating * W, self.rotating * S, U, S

    def level(self, x: Any) -> tuple[Any, Any, Any]:
        """p_h, q_h, r_h [rad/s], the air's rotation in heading axes, of a whole state x."""
        return level(self, x, sines(x))

    def rotation(self, x: Any, trig: Trig | None = None) -> tuple[Any, Any, Any]:
        """p_g, q_g, r_g [rad/s]: the air's rotation in body axes; ``trig``: `sines` of x, if known."""
        trig = trig or sines(x)
        return rotation(level(self, x, trig), trig)

    def turning(self, x: Any, trig: Trig | None = None) -> tuple[Any, Any, Any]:
        """What the turning of u, v with the heading adds to the acceleration relative to the air, in body axes [m/s2]."""
        return turning(self, x, trig or sines(x))

    def rates(
        self, x: Any, rated: tuple[Any, Any, Any, Any, Any], trig: Trig | None = None
    ) -> tuple[Any, ...]:
        """d/dt of the five states, given the deterministic rates of V, alpha, beta (`turning` included), phi and theta."""
        return gust_rates(self, x, rated, trig or sines(x))
