"""Dryden gusts as states of a filter: the air's own rotation, and the gusts that turn with the aircraft.

The filter's V, alpha and beta are relative to the air, so gusts reach them as near-white noise on their rates. The same
gusts do more, in heading axes (along the heading and level; index h), in which MIL-F-8785C gives them:

* the air rotates (3.7.5): p_h is a first-order process of its own; q_h = -dw/dx and r_h = +dv/dx, smoothed over the span,
  follow from what changes alpha and beta (and V on a sloping path). With alpha_g = -w/V, beta_g = -v/V in body axes and
  V_g = -u along the path (a dot is d/dt), gamma the path's angle of climb through the air,

    T_p dp_h/dt = -p_h + noise
    T_q dq_h/dt = -q_h + cos(phi) alpha_g. + sin(phi) beta_g. - sin(gamma) V_g./V
    T_r dr_h/dt = -r_h + sin(phi) alpha_g. - cos(phi) beta_g.          T_p = T_q = 4 b/(pi V), T_r = 3 b/(pi V)

* the axes turn with the aircraft at dpsi/dt, and the gusts u_h, v_h with them: the air seems to accelerate by dpsi/dt
  times them, without rotating. In a bank of 30 deg that is 0.01 rad/s of beta for seconds on end.

None of these states needs noise of its own: with along = cos(phi) alpha + sin(phi) beta, across = cos(phi) beta - sin(phi)
alpha, the states c_u = u_h + V, c_v = v_h/V + across, h_q = T_q q_h - along + sin(gamma) (1 - c_u/V) and h_r = T_r r_h + across
change by the deterministic part of V, alpha, beta alone.

Left out, in E-SPAARO's simulated flights: rolling gusts taken for noise on p pass for persistence of the aircraft (Cl_p at
two thirds); gradients along the body's axes in banked flight, or independent of alpha and beta, and gusts that do not
turn, leave moments that nothing explains, and intervals of the lateral damping terms (Cn_r above all) do not cover.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from sysid.aerodynamics.flight_equations import Trig, gust_lags_s, gust_rates, level, rotation, sines, turning

NOISY = (0, 1, 2, 3, 4, 5, 8)
"""States with process noise: V, alpha, beta as the gusts come; p_h; p, q, r a little, for what gusts so described leave over."""
STATE_STD = (1.0, 0.02, 0.02, 0.05, 0.05, 0.05, 0.05, 0.05, 0.08, 0.01, 0.01, 1.5, 0.06)
"""What a segment's first samples leave open of its start (13,); of the air, its own spread in light to moderate turbulence."""
NOISE_START = (0.5, 0.02, 0.02, 0.01, 0.01, 0.01, 0.1, 0.1, 0.2, 0.1, 0.1, 0.1, 0.1)
"""First guesses of the process noise, per root second, of NOISY states: light turbulence, roughly; the others' do not count."""


class GustStates(NamedTuple):
    """p_h [rad/s], h_q, h_r [rad], c_u [m/s], c_v [rad] behind V, alpha, beta, p, q, r, phi, theta; ``b`` the span [m].

    passing_mps: the speed at which the gusts pass, where they are simulated at one whatever the airspeed; 0: the airspeed, as in
    real air. Their rotation is then V over that speed times what alpha and beta say, behind that speed's lags.
    rotating: q_h, r_h follow from alpha and beta; turning_with: u_h, v_h turn with the heading. Neither is so in all air: some
    simulators' gusts do not rotate, and no real gust turns with an aircraft.
    """

    b: float
    passing_mps: float = 0.0
    rotating: bool = True
    turning_with: bool = True

    def lags_s(self, V: Any) -> tuple[Any, Any, Any]:
        """T_p, T_q, T_r at airspeed V."""
        return gust_lags_s(self, V)

    def start(self, V: Any, alpha: Any, beta: Any, phi: Any) -> tuple[Any, ...]:
        """The five states in air that neither moves nor rotates."""
        along, across = np.cos(phi) * alpha + np.sin(phi) * beta, np.cos(phi) * beta - np.sin(phi) * alpha
        return 0.0 * V, -self.rotating * along, self.rotating * across, V, across

    def level(self, x: Any) -> tuple[Any, Any, Any]:
        """p_h, q_h, r_h [rad/s], the air's rotation in heading axes, of a whole state x."""
        return level(self, x, sines(x))

    def rotation(self, x: Any, trig: Trig | None = None) -> tuple[Any, Any, Any]:
        """p_g, q_g, r_g [rad/s]: the air's rotation in body axes; ``trig``: `sines` of x, if known."""
        trig = trig or sines(x)
        return rotation(level(self, x, trig), trig)

    def turning(self, x: Any, trig: Trig | None = None) -> tuple[Any, Any, Any]:
        """What the turning of u_h, v_h with the heading adds to the rates of V [m/s2], alpha, beta [rad]."""
        return turning(self, x, trig or sines(x))

    def rates(self, x: Any, rated: tuple[Any, Any, Any, Any], trig: Trig | None = None) -> tuple[Any, ...]:
        """d/dt of the five states, given the deterministic rates of V, alpha, beta, phi (`turning` included)."""
        return gust_rates(self, x, rated, trig or sines(x))
