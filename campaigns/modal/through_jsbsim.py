"""The modal example's outputs from the nonlinear JSBSim model: trim, linearise, read the modes, for
changed coefficients.

Only the longitudinal motion is trimmed and linearised. The aircraft's small lateral constants
(CY_0, Cl_0, Cn_0) accelerate it sideways all the while, which the longitudinal derivatives do not
feel.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from sysid.arrays import FloatArray
from uqharness.errors import BadInputError
from uqharness.sensitivity import Evaluations, Study
from uqharness.sensitivity.modal import (
    ALEATORY,
    NOMINAL,
    OUTPUTS,
    V_MPS,
    intervals,
    longitudinal_modes,
    system_matrix,
)
from uqharness.sensitivity.study import corners
from uqharness.simulator.aircraft import Aircraft
from uqharness.simulator.forced_state import BodyState, force_state
from uqharness.simulator.trim import SteadyCondition, find_trim

_LONGITUDINAL = (0, 2, 4)
_STEPS = np.array([0.05, 0.05, 1e-3, 1e-3])  # u, w [m/s], q [rad/s], theta [rad]
_THRUST = "propulsion/thrust-N"


@dataclass(frozen=True)
class ModalTrim:
    """Level flight of the unchanged model and the matrix that leads back to it.

    ``x`` (3,): alpha [rad], elevator and throttle in the card's units; ``solve`` (3, 3): inverse of
    d(u', w', q')/dx.
    """

    aircraft: Aircraft
    V_mps: float
    x: FloatArray
    solve: FloatArray


def nominal_trim(aircraft: Aircraft, V_mps: float = V_MPS) -> ModalTrim:
    """Trim the model as it is. Raises BadInputError if there is no trim."""
    trim = find_trim(aircraft, SteadyCondition(V_mps))
    if not trim.converged:
        raise BadInputError(f"{aircraft.name}: {trim.reason}")
    x = np.array([trim.alpha_rad, trim.controls["elevator"], trim.controls["throttle"]])
    steps = np.array([1e-4, 1e-2, 1e-1])
    columns = [
        (_residual(aircraft, V_mps, x + h, {}) - _residual(aircraft, V_mps, x - h, {}))
        / (2.0 * step)
        for h, step in zip(np.diag(steps), steps, strict=True)
    ]
    return ModalTrim(aircraft, V_mps, x, np.linalg.inv(np.stack(columns, axis=1)))


def _controls(x: FloatArray) -> dict[str, float]:
    return {"elevator": float(x[1]), "throttle": float(x[2]), "aileron": 0.0, "rudder": 0.0}


def _level(V_mps: float, x: FloatArray) -> BodyState:
    alpha = float(x[0])
    return BodyState(V_mps * math.cos(alpha), 0.0, V_mps * math.sin(alpha), 0.0, alpha, 0.0)


def _residual(
    aircraft: Aircraft, V_mps: float, x: FloatArray, properties: Mapping[str, float]
) -> FloatArray:
    acceleration, _ = force_state(aircraft, _level(V_mps, x), _controls(x), 0.0, properties)
    return acceleration[list(_LONGITUDINAL)]


def trim_again(start: ModalTrim, properties: Mapping[str, float]) -> FloatArray:
    """Return the trim (3,) with changed properties, by chords from the nominal one. Raises
    BadInputError without convergence."""
    x = start.x
    for _ in range(15):
        residual = _residual(start.aircraft, start.V_mps, x, properties)
        if np.max(np.abs(residual)) < 1e-8:
            return x
        x = x - start.solve @ residual
    raise BadInputError(f"no level flight at {start.V_mps:g} m/s with {dict(properties)}")


def linear_model(start: ModalTrim, properties: Mapping[str, float]) -> tuple[FloatArray, float]:
    """Return A (4, 4) over (u, w, q, theta) about the trim with ``properties``, and the slope of
    thrust with u [N per m/s]."""
    x = trim_again(start, properties)
    centre, controls = _level(start.V_mps, x), _controls(x)

    def derivative(step: FloatArray) -> tuple[FloatArray, float]:
        u, w, theta = centre.u + step[0], centre.w + step[1], centre.theta + step[3]
        state = BodyState(u, 0.0, w, 0.0, theta, 0.0, q=float(step[2]))
        settings = (controls, 0.0, properties, (_THRUST,))
        acceleration, outputs = force_state(start.aircraft, state, *settings)
        rates = np.array([*acceleration[list(_LONGITUDINAL)], step[2]])
        return rates, outputs.get(_THRUST, math.nan)

    A, slope = np.empty((4, 4)), math.nan
    for column, step in enumerate(_STEPS):
        (plus, thrust_plus), (minus, thrust_minus) = (
            derivative(sign * step * np.eye(4)[column]) for sign in (1, -1)
        )
        A[:, column] = (plus - minus) / (2.0 * step)
        if column == 0:
            slope = (thrust_plus - thrust_minus) / (2.0 * step)
    return A, slope


def outputs_of(start: ModalTrim, values: Mapping[str, float]) -> FloatArray:
    """Return phugoid damping, short-period damping and frequency [rad/s] (3,) with these
    coefficients."""
    A, _ = linear_model(start, {f"aero/{name}": value for name, value in values.items()})
    phugoid_zeta, _, zeta, wn = longitudinal_modes(A)
    return np.array([phugoid_zeta, zeta, wn])


def jsbsim_study(
    aircraft: Aircraft, callback: Callable[[int, int], None] = lambda done, total: None
) -> Study:
    """Evaluate nominal, 1 % steps and all 2^10 corners by JSBSim, with mass, area, chord and
    inertia at their means."""
    start = nominal_trim(aircraft)
    names = tuple(NOMINAL)
    centre = np.array(list(NOMINAL.values()))
    lower, upper = np.array(list(intervals().values())).T
    points = np.vstack([centre, centre + np.diag(0.01 * centre), corners(lower, upper)])
    values = np.empty((len(points), len(OUTPUTS)))
    for k, point in enumerate(points):
        values[k] = outputs_of(start, dict(zip(names, point.tolist(), strict=True)))
        callback(k + 1, len(points))
    d = len(names)
    outputs = {
        output: Evaluations(
            nominal=values[:1, k], forward=values[1 : d + 1, k], corners=values[d + 1 :, k : k + 1]
        )
        for k, output in enumerate(OUTPUTS)
    }
    return Study(names, lower, upper, centre, 0.01 * centre, np.empty((0, d)), False, outputs)


def successive_models(aircraft: Aircraft) -> list[tuple[str, FloatArray]]:
    """Return models from the chapter's linear one to JSBSim's, one term after another.

    Each with its phugoid zeta and wn [rad/s] and short-period zeta and wn.
    """
    start = nominal_trim(aircraft)
    full, slope = linear_model(start, {})
    values: dict[str, float] = dict(NOMINAL) | {name: mean for name, (mean, _) in ALEATORY.items()}
    A = system_matrix(
        "as_corrected", {name: np.array(value) for name, value in values.items()}
    ).dense()
    rows = [("the chapter's linear model, as_corrected", A.copy())]
    A[0, 0] += slope / values["M_kg"]
    rows.append(("thrust that falls with speed at fixed throttle", A.copy()))
    A[0, 2], A[1, 2] = full[0, 2], full[1, 2]
    rows.append(("the axes' own motion: -w0 q in u', u0 = V cos alpha", A.copy()))
    A[:2, 3] = full[:2, 3]
    rows.append(("weight along inclined axes: -g sin theta in w'", A.copy()))
    A[:, :2] = full[:, :2]
    rows.append(("incidence that changes with u, and a trim along inclined axes", A.copy()))
    rows.append(("JSBSim, linearised", full))
    return [(name, np.array(longitudinal_modes(matrix))) for name, matrix in rows]
