"""The signals of a flight record: name, unit, sign and plausible range.

Every module uses these names. The fields of each log dialect that supply a signal are listed in
``sysid/logs/signal_maps/*.toml``; `sysid.logs.signal_map` joins both to the table of
docs/log-reference.md.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Signal:
    """One column of a flight record.

    Attributes
    ----------
    name, unit, meaning : str
        Column name, its unit, and the quantity with its sign.
    kind : str
        "state" (interpolated), "heading" (interpolated on the circle), "command" (held) or "label"
        (text, held).
    low, high : float
        Plausible range in the signal's unit. Values outside indicate a wrong unit or a broken
        sensor.
    core : bool
        True for the columns that every complete record has.
    """

    name: str
    unit: str
    meaning: str
    kind: str
    low: float
    high: float
    core: bool = True


_INF = float("inf")
_SIGNALS = (
    Signal("time_s", "s", "log time, increasing", "state", -_INF, _INF),
    Signal("V_mps", "m/s", "true airspeed", "state", -5.0, 800.0),
    Signal("alpha_rad", "rad", "angle of attack, + nose above the air path", "state", -1.6, 1.6),
    Signal("beta_rad", "rad", "sideslip, + air from the right", "state", -1.6, 1.6),
    Signal("phi_rad", "rad", "roll angle, + right wing down", "state", -3.1417, 3.1417),
    Signal("theta_rad", "rad", "pitch angle, + nose up", "state", -1.5709, 1.5709),
    Signal(
        "psi_rad",
        "rad",
        "true heading, + clockwise from north, 0 to 2 pi",
        "heading",
        -0.001,
        6.2833,
    ),
    Signal("p_radps", "rad/s", "roll rate, + right wing down", "state", -20.0, 20.0),
    Signal("q_radps", "rad/s", "pitch rate, + nose up", "state", -20.0, 20.0),
    Signal("r_radps", "rad/s", "yaw rate, + nose right", "state", -20.0, 20.0),
    Signal("ax_mps2", "m/s2", "specific force at the sensor, + forward", "state", -160.0, 160.0),
    Signal("ay_mps2", "m/s2", "specific force at the sensor, + right", "state", -160.0, 160.0),
    Signal(
        "az_mps2",
        "m/s2",
        "specific force at the sensor, + down (level: -9.8)",
        "state",
        -160.0,
        160.0,
    ),
    Signal("h_m", "m", "height above the start point, + up", "state", -500.0, 30000.0),
    Signal(
        "elevator_deg",
        "deg",
        "elevator command, + trailing edge down (nose down)",
        "command",
        -90.0,
        90.0,
    ),
    Signal("aileron_deg", "deg", "aileron command, + rolls right", "command", -90.0, 90.0),
    Signal(
        "rudder_deg",
        "deg",
        "rudder command, + trailing edge left (nose left)",
        "command",
        -90.0,
        90.0,
    ),
    Signal("throttle_pct", "%", "throttle command, 0 to 100", "command", -5.0, 105.0),
    Signal("elevator_pos_deg", "deg", "elevator, measured", "state", -90.0, 90.0, False),
    Signal("aileron_pos_deg", "deg", "aileron, measured", "state", -90.0, 90.0, False),
    Signal("rudder_pos_deg", "deg", "rudder, measured", "state", -90.0, 90.0, False),
    Signal("north_m", "m", "position north of the start point", "state", -1e6, 1e6, False),
    Signal("east_m", "m", "position east of the start point", "state", -1e6, 1e6, False),
    Signal("vn_mps", "m/s", "ground velocity, north", "state", -900.0, 900.0, False),
    Signal("ve_mps", "m/s", "ground velocity, east", "state", -900.0, 900.0, False),
    Signal("vd_mps", "m/s", "ground velocity, down", "state", -400.0, 400.0, False),
    Signal("rpm", "1/min", "propeller speed, measured", "state", -10.0, 60000.0, False),
    Signal(
        "thrust_N",
        "N",
        "thrust of all engines, measured or from a simulation",
        "state",
        -5e6,
        5e6,
        False,
    ),
    Signal("rho_kgpm3", "kg/m3", "air density", "state", 0.01, 1.6, False),
    Signal(
        "manoeuvre", "-", "name of the manoeuvre, empty between them", "label", -_INF, _INF, False
    ),
    # Beyond the contract: what loiter metrics need, and the flight mode.
    Signal(
        "mode", "-", "flight mode, name or number of the autopilot", "label", -_INF, _INF, False
    ),
    Signal(
        "cross_track_m",
        "m",
        "cross-track error of the autopilot's guidance",
        "state",
        -1e5,
        1e5,
        False,
    ),
    Signal(
        "h_demand_m", "m", "height demand above the start point", "command", -500.0, 30000.0, False
    ),
    Signal("V_demand_mps", "m/s", "demanded airspeed, true", "command", -5.0, 800.0, False),
)

SIGNALS: dict[str, Signal] = {s.name: s for s in _SIGNALS}
"""Signals by name, in the order of the columns of a record."""
LABELS = frozenset(s.name for s in _SIGNALS if s.kind == "label")
"""Names of the columns of text."""
COMMANDS = frozenset(s.name for s in _SIGNALS if s.kind == "command")
"""Names of the columns that are held between samples."""
SURFACES = ("elevator_deg", "aileron_deg", "rudder_deg")
"""Commands of the control surfaces, deg."""


# Flight modes and texts of ArduPilot. PLANE_MODES has the mode numbers of its documentation.
PLANE_MODES = {
    0: "MANUAL",
    1: "CIRCLE",
    2: "STABILIZE",
    3: "TRAINING",
    4: "ACRO",
    5: "FBWA",
    6: "FBWB",
    7: "CRUISE",
    8: "AUTOTUNE",
    10: "AUTO",
    11: "RTL",
    12: "LOITER",
    13: "TAKEOFF",
    14: "AVOID_ADSB",
    15: "GUIDED",
    17: "QSTABILIZE",
    18: "QHOVER",
    19: "QLOITER",
    20: "QLAND",
    21: "QRTL",
    24: "THERMAL",
}
MODE_NUMBERS = {name: number for number, name in PLANE_MODES.items()}
# A message to the pilot that begins with this text names the manoeuvre from then on;
# "manoeuvre end" ends it.
MANOEUVRE_TEXT = "manoeuvre "
