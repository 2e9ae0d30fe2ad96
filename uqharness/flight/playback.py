"""A flight record as the lines of a FlightGear playback: position on the ellipsoid, attitude, airspeed, at a constant rate."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from sysid.arrays import FloatArray
from sysid.record import FlightRecord
from sysid.units import FT_M, KT_MPS, RAD_DEG
from uqharness.errors import BadInputError

NEEDED = ("north_m", "east_m", "h_m", "phi_rad", "theta_rad", "psi_rad", "V_mps")
_RADIUS_M, _ECCENTRICITY_2 = 6378137.0, 6.69437999014e-3
"""Of the WGS 84 ellipsoid: equatorial radius [m] and first eccentricity squared [-]."""


def playback_rows(record: FlightRecord, start: Mapping[str, float], rate_hz: float) -> FloatArray:
    """Rows (n, 7) of the fields of `uqharness.xml.flightgear.FIELDS`.

    Parameters
    ----------
    record
        The flight; ``h_m`` is height above its start.
    start
        lat_deg, lon_deg [deg] and alt_m above sea level [m] of the start point.
    rate_hz
        Rows per second [1/s]; each row is the nearest sample, and a dropout holds the last value.

    Raises
    ------
    BadInputError
        For a record without one of ``NEEDED``, or with nothing known in it.
    """
    missing = [name for name in NEEDED if name not in record]
    if missing:
        raise BadInputError(
            f"FlightGear needs {', '.join(missing)}, which the record does not have; it needs {', '.join(NEEDED)}"
        )
    time_s = np.asarray(record["time_s"])
    at = np.arange(time_s[0], time_s[-1] + 0.5 / rate_hz, 1.0 / rate_hz)
    right = np.clip(np.searchsorted(time_s, at), 1, len(time_s) - 1)
    rows = np.where(at - time_s[right - 1] <= time_s[right] - at, right - 1, right)
    north, east, h, phi, theta, psi, airspeed = (
        _held(name, np.asarray(record[name]))[rows] for name in NEEDED
    )
    latitude, longitude = geodetic(north, east, start["lat_deg"], start["lon_deg"])
    heading = np.mod(psi * RAD_DEG, 360.0)
    altitude = (start["alt_m"] + h) / FT_M
    return np.column_stack(
        [latitude, longitude, altitude, phi * RAD_DEG, theta * RAD_DEG, heading, airspeed / KT_MPS]
    )


def geodetic(
    north_m: FloatArray, east_m: FloatArray, lat_deg: float, lon_deg: float
) -> tuple[FloatArray, FloatArray]:
    """Latitude and longitude (n,) [deg] of points on the local plane of a start point, from its two radii of curvature."""
    lat0 = math.radians(lat_deg)
    w = 1.0 - _ECCENTRICITY_2 * math.sin(lat0) ** 2
    meridian = _RADIUS_M * (1.0 - _ECCENTRICITY_2) / w**1.5
    parallel = _RADIUS_M / math.sqrt(w) * math.cos(lat0)
    return lat_deg + np.degrees(north_m / meridian), lon_deg + np.degrees(east_m / parallel)


def _held(name: str, values: FloatArray) -> FloatArray:
    known = np.isfinite(values)
    if not known.any():
        raise BadInputError(f"FlightGear needs {name}, and the record has no value of it")
    last = np.maximum.accumulate(np.where(known, np.arange(len(values)), -1))
    return values[np.where(last < 0, int(np.argmax(known)), last)]
