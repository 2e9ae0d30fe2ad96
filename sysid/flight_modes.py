"""Names of flight modes, and the text by which a log names a manoeuvre."""

from __future__ import annotations

# ArduPlane's mode numbers (its documentation's table).
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
# A text to the pilot that begins so names the manoeuvre from then on ("manoeuvre end": none).
MANOEUVRE_TEXT = "manoeuvre "
