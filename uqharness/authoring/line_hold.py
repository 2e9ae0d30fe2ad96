"""Autopilot of an authored aircraft: holds the straight line, height and speed of the start.

Linear-quadratic regulators of the trimmed model give the gains, one for pitch and throttle, one for
roll and yaw, with integrals of height, speed and cross-track error. A glider holds its speed by the
elevator. Weights are Bryson's: one over
the square of the greatest deviation that counts as harmless.
"""

from __future__ import annotations

import importlib.resources
import math

import jinja2
import numpy as np
import scipy.linalg

from sysid.arrays import FloatArray
from sysid.units import FT_M
from uqharness.errors import BadInputError
from uqharness.simulator import STATE_NAMES, Aircraft, LinearModel, Trim, linearise

LINE_HOLD_SYSTEM = "line-hold"
LONGITUDINAL = ("speed", "alpha", "q", "theta", "height", "speed-integral", "height-integral")
GLIDE = ("speed", "alpha", "q", "theta", "speed-integral")
LATERAL = ("beta", "p", "r", "phi", "drift", "cross-track", "cross-track-integral")
_UNITS = {
    "speed": "m/s",
    "alpha": "rad",
    "beta": "rad",
    "p": "rad/s",
    "q": "rad/s",
    "r": "rad/s",
    "theta": "rad",
    "phi": "rad",
    "height": "m",
    "drift": "m/s",
    "cross-track": "m",
    "speed-integral": "m",
    "height-integral": "m s",
    "cross-track-integral": "m s",
}
_CONTROLS: dict[tuple[str, ...], tuple[str, ...]] = {
    LONGITUDINAL: ("elevator", "throttle"),
    GLIDE: ("elevator",),
    LATERAL: ("aileron", "rudder"),
}
_HARMLESS_TRAVEL = 0.2
"""Share of a control's range that counts as harmless."""
_LAG_RADPS = {"elevator": 25.0, "aileron": 25.0, "rudder": 25.0, "throttle": 6.0}
"""Actuators of the written XML [1/s]."""


def _harmless(speed_mps: float) -> dict[str, float]:
    """Return the deviation of each state that counts as harmless; lengths grow with speed."""
    return {
        "speed": 0.1 * speed_mps,
        "alpha": 0.1,
        "beta": 0.1,
        "p": 1.0,
        "q": 0.5,
        "r": 0.5,
        "theta": 0.1,
        "phi": 0.3,
        "height": 0.2 * speed_mps,
        "drift": 0.1 * speed_mps,
        "cross-track": 0.4 * speed_mps,
        "speed-integral": 0.4 * speed_mps,
        "height-integral": 0.8 * speed_mps,
        "cross-track-integral": 3.0 * speed_mps,
    }


def regulator(model: LinearModel, states: tuple[str, ...]) -> tuple[FloatArray, tuple[str, ...]]:
    """Return the gains of LONGITUDINAL, GLIDE or LATERAL states, and the controls in their rows.

    Parameters
    ----------
    model : LinearModel
        Of straight flight with wings level.
    states : tuple of str
        LONGITUDINAL, GLIDE or LATERAL.

    Returns
    -------
    gains : ndarray
        (m, n), units of the control per unit of the state; command = trim - gains @ states.
    controls : tuple of str
        The m controls that move the aircraft.

    Raises
    ------
    BadInputError
        If the controls do not stabilise the model.

    Notes
    -----
    The actuators' lags are states of the design without feedback of their own: their gains are left
    out, which a lag well above the closed loop allows. `regulator` checks the loop with the lags.
    """
    trim = model.trim
    V, theta = trim.condition.V_mps, trim.theta_rad
    index = {name: i for i, name in enumerate(STATE_NAMES)}
    names = ("v", "p", "r", "phi") if states is LATERAL else ("u", "w", "q", "theta")
    rows = [index[name] for name in names]
    columns = [
        model.controls.index(control)
        for control in _CONTROLS[states]
        if control in model.controls and np.any(model.B[rows, model.controls.index(control)])
    ]
    controls = tuple(model.controls[column] for column in columns)
    u, w = V * math.cos(trim.alpha_rad), V * math.sin(trim.alpha_rad)
    # body: rigid-body states; the other states are kinematic: x' = kinematic @ x.
    A, B = np.zeros((7, 7)), np.zeros((7, len(columns)))
    body_A, body_B = model.A[np.ix_(rows, rows)], model.B[np.ix_(rows, columns)]
    if states is not LATERAL:
        # u, w from V, alpha.
        turn = np.array([[u / V, -w, 0, 0], [w / V, u, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
        turn_back = np.linalg.inv(turn)
        A[:4, :4], B[:4] = turn_back @ body_A @ turn, turn_back @ body_B
        A[4, 1], A[4, 3] = -V, V  # climb rate of level flight
        A[5, 0] = A[6, 4] = 1.0
    else:
        turn = np.diag([V, 1.0, 1.0, 1.0])
        A[:4, :4], B[:4] = np.linalg.inv(turn) @ body_A @ turn, np.linalg.inv(turn) @ body_B
        # Drift across the line: V (heading + sideslip); heading' = r / cos theta.
        A[4, :4] = V * A[0, :4]
        A[4, 2] += V / math.cos(theta)
        B[4] = V * B[0]
        A[5, 4] = A[6, 5] = 1.0
    if states is GLIDE:
        states_of_glide = [LONGITUDINAL.index(name) for name in GLIDE]
        A, B = A[np.ix_(states_of_glide, states_of_glide)], B[states_of_glide]
    # Actuators: position' = lag (command - position).
    lag = np.array([_LAG_RADPS[control] for control in controls])
    m, n = len(controls), len(states)
    full_A = np.block([[A, B], [np.zeros((m, n)), -np.diag(lag)]])
    full_B = np.vstack([np.zeros((n, m)), np.diag(lag)])
    harmless = _harmless(V)
    Q = np.diag([1.0 / harmless[name] ** 2 for name in states] + [0.0] * m)
    R = np.diag([1.0 / (_HARMLESS_TRAVEL * _RANGE[control]) ** 2 for control in controls])
    try:
        if not m:
            raise ValueError("no control moves it")
        riccati = scipy.linalg.solve_continuous_are(full_A, full_B, Q, R)
    except (ValueError, np.linalg.LinAlgError) as error:
        raise BadInputError(f"no regulator of {', '.join(states)}: {error}") from None
    gains = np.linalg.solve(R, full_B.T @ riccati)[:, :n]
    closed = full_A - full_B @ np.hstack([gains, np.zeros((m, m))])
    if np.max(np.linalg.eigvals(closed).real) >= 0.0:
        raise BadInputError(f"no regulator of {', '.join(states)}: the loop with lags diverges")
    return gains, controls


_RANGE = {"elevator": 25.0, "aileron": 25.0, "rudder": 25.0, "throttle": 100.0}
"""Travel of a control to one side [deg], and of the throttle [percent]."""

IDLE_XML = f"""<?xml version="1.0" encoding="UTF-8"?>
<!-- No line hold: no steady level flight was found from which its gains could be computed. -->
<system name="{LINE_HOLD_SYSTEM}"/>
""".encode()


def line_hold_xml(aircraft: Aircraft, trim: Trim) -> bytes:
    """Return the system that holds the line, height and speed of the start.

    Raises BadInputError if the controls do not stabilise the aircraft.
    """
    # Without thrust the path is that of a glide.
    longitudinal = LONGITUDINAL if trim.condition.climb_rad == 0.0 else GLIDE
    model = linearise(aircraft, trim)
    laws: dict[str, list[dict[str, str]]] = {control: [] for control in _RANGE}
    for states in (longitudinal, LATERAL):
        gains, controls = regulator(model, states)
        for control, row in zip(controls, gains, strict=True):
            unit = "pct" if control == "throttle" else "deg"
            laws[control] = [
                {"state": state, "gain": f"{gain:.5g}", "unit": f"{unit} per {_UNITS[state]}"}
                for state, gain in zip(states, row, strict=True)
            ]
    folder = importlib.resources.files("uqharness.authoring") / "templates"
    text = (folder / "line-hold.xml.j2").read_text("utf-8")
    template = jinja2.Environment(
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    ).from_string(text)
    return template.render(
        name=LINE_HOLD_SYSTEM,
        speed=f"{trim.condition.V_mps:g}",
        laws=laws,
        limits={
            control: tuple(f"{end:g}" for end in aircraft.card.inputs[control].limits)
            for control in laws
        },
        foot=FT_M,
        # The control whose end stops each integral.
        integrals=[
            ("speed", "elevator" if longitudinal is GLIDE else "throttle"),
            *([] if longitudinal is GLIDE else [("height", "elevator")]),
            ("cross-track", "aileron" if laws["aileron"] else "rudder"),
        ],
    ).encode()
