"""Slips that are made with a log's channels: what is multiplied by what, and what a check should
say.
"""

from __future__ import annotations

from collections.abc import Mapping

from sysid.record import FlightRecord
from sysid.units import FT_M, G0_MPS2, KT_MPS

ACCELERATIONS = ("ax_mps2", "ay_mps2", "az_mps2")
RATES = ("p_radps", "q_radps", "r_radps")
FAULTS: Mapping[str, Mapping[str, float]] = {
    "airspeed in knots": {"V_mps": 1.0 / KT_MPS},
    "airspeed in ft/s": {"V_mps": 1.0 / FT_M},
    "accelerations in g": dict.fromkeys(ACCELERATIONS, 1.0 / G0_MPS2),
    "height in feet": {"h_m": 1.0 / FT_M},
    "az reversed": {"az_mps2": -1.0},
    "ay reversed": {"ay_mps2": -1.0},
    "ax reversed": {"ax_mps2": -1.0},
    "q in deg/s": {"q_radps": 57.29578},
    "rates in deg/s": dict.fromkeys(RATES, 57.29578),
    "p reversed": {"p_radps": -1.0},
    "r reversed": {"r_radps": -1.0},
    "alpha reversed": {"alpha_rad": -1.0},
    "beta reversed": {"beta_rad": -1.0},
    "roll reversed": {"phi_rad": -1.0},
    "climb for sink": {"vd_mps": -1.0},
    "ground velocity in knots": dict.fromkeys(("vn_mps", "ve_mps", "vd_mps"), 1.0 / KT_MPS),
}
SURFACE_FAULTS: Mapping[str, Mapping[str, float]] = {
    f"{name} reversed": {f"{name}_deg": -1.0} for name in ("elevator", "aileron", "rudder")
}


def seeded(record: FlightRecord, fault: Mapping[str, float]) -> FlightRecord:
    """The record with a fault built in."""
    return record.with_columns({n: record[n] * factor for n, factor in fault.items()})
