"""Throttle of a record that has thrust or propeller speed in its place: the one at which the model's own engines have the measured
value at the measured airspeed, in their steady state.

So the engines' torque and gyroscopic moments act as the model has them. How fast the engines follow is the model's, too: a thrust
that changes faster than they do comes late in a replay.
"""

from __future__ import annotations

import numpy as np

from sysid.arrays import FloatArray
from sysid.record import FlightRecord
from sysid.units import FT_M, LBF_N
from uqharness.errors import BadInputError
from uqharness.replay.model import CONTROLS, ReplayFolder, control_setters
from uqharness.simulator import TRIM_LATITUDE_DEG, Aircraft, engine

SOURCES = {"thrust_N": ("thrust", "N"), "rpm": ("propeller speed", "1/min")}
"""Columns that can stand for the throttle, the better first."""
THROTTLE = "throttle_pct"
_THROTTLES, _SPEEDS = 21, 5
"""Points of the engines' map: curves between 0 and 100 % and over the airspeeds of one flight are smooth."""
_BEYOND, _BEYOND_SHARE = 0.02, 0.05
"""Of the largest value: noise beyond the engines' range is cut off. Share of rows beyond it from which on it is not noise."""
_CLEARANCE_M = 500.0


def with_throttle(record: FlightRecord, aircraft: Aircraft, name: str) -> tuple[FlightRecord, str]:
    """The record with throttle_pct [%] made of its thrust_N or rpm, and a sentence that says so; the record itself and "" where it
    has a throttle, or none of them.

    Raises BadInputError where the model's engines cannot have the measured values at any throttle.
    """
    if _has(record, THROTTLE) or "throttle" not in aircraft.card.inputs:
        return record, ""
    column = next((c for c in SOURCES if _has(record, c)), None)
    if column is None or not _has(record, "V_mps"):
        return record, ""
    V, wanted = record["V_mps"], record[column]
    height = record["h_m"] if _has(record, "h_m") else np.zeros(1)
    altitude = float(record.metadata.start.get("alt_m", 0.0)) + float(np.nanmedian(height))
    speeds = np.linspace(
        float(np.nanmin(V)), max(float(np.nanmax(V)), float(np.nanmin(V)) + 1.0), _SPEEDS
    )
    throttles = np.linspace(0.0, 100.0, _THROTTLES)
    curves = engine_map(aircraft, column, speeds, throttles, altitude)
    what, unit = SOURCES[column]
    if not np.ptp(curves) > 0.0:
        raise BadInputError(
            f"{name}: the record has {column} and no {THROTTLE}, and {aircraft.name}'s {what} does not change with its throttle; "
            f"give the record {THROTTLE}"
        )
    throttle = throttle_at(V, wanted, speeds, throttles, curves)
    low, high = float(curves.min()), float(curves.max())
    known = np.isfinite(wanted) & np.isfinite(V)
    margin = _BEYOND * high
    outside = (wanted[known] > high + margin) | (wanted[known] < low - margin)
    if outside.mean() > _BEYOND_SHARE:
        raise BadInputError(
            f"{name}: {column} is {np.nanmin(wanted):.0f} to {np.nanmax(wanted):.0f} {unit}, and {aircraft.name}'s engines have "
            f"{low:.0f} to {high:.0f} {unit} between no and full throttle at {speeds[0]:.0f} to {speeds[-1]:.0f} m/s; check its "
            "unit and that it is of all engines together, or correct the engine in the aircraft's XML"
        )
    return record.with_columns({THROTTLE: throttle}), (
        f"{THROTTLE} was made of {column}: the throttle at which {aircraft.name}'s engines have the measured {what} at the "
        f"measured airspeed, {np.nanmin(throttle):.0f} to {np.nanmax(throttle):.0f} %"
    )


def throttle_at(
    V: FloatArray, wanted: FloatArray, speeds: FloatArray, throttles: FloatArray, curves: FloatArray
) -> FloatArray:
    """(n,) throttle at airspeeds V [m/s] and values wanted (n,), NaN where either is; curves (speeds, throttles), cut off at the
    ends of the range."""
    rising = np.maximum.accumulate(curves, axis=1)
    out = np.full(len(V), np.nan)
    for k in np.flatnonzero(np.isfinite(V) & np.isfinite(wanted)):
        curve = np.array([np.interp(V[k], speeds, column) for column in rising.T])
        out[k] = np.interp(wanted[k], curve, throttles)
    return out


def engine_map(
    aircraft: Aircraft,
    column: str,
    speeds_mps: FloatArray,
    throttles_pct: FloatArray,
    altitude_m: float,
) -> FloatArray:
    """(speeds, throttles) what the model's engines have in level, straight flight in their steady state: ``thrust_N``, the force
    along x that is not aerodynamic, or ``rpm``, of the first engine. Raises BadInputError for an aircraft without propeller."""
    out = np.empty((len(speeds_mps), len(throttles_pct)))
    with ReplayFolder(aircraft, ideal=CONTROLS) as model:
        fdm = model.open(aircraft.dt_s)
        read = [
            engine.handle(fdm, name).get_double_value
            for name in ("forces/fbx-total-lbs", "forces/fbx-aero-lbs")
        ]
        turning = aircraft.card.outputs.get("rpm", "propulsion/engine/propeller-rpm")
        if column == "rpm":
            if not fdm.get_property_manager().hasNode(turning):
                raise BadInputError(
                    f"the record has rpm, and {aircraft.name} has no propeller whose speed it could be"
                )
            read = [engine.handle(fdm, turning).get_double_value]
        setters = control_setters(fdm, model)[CONTROLS.index("throttle")]
        fdm["ic/lat-geod-deg"] = TRIM_LATITUDE_DEG
        fdm["ic/terrain-elevation-ft"] = (altitude_m - _CLEARANCE_M) / FT_M
        for i, speed in enumerate(speeds_mps):
            for k, percent in enumerate(throttles_pct):
                value = float(
                    model.to_property(np.array([0.0, 0.0, 0.0, percent]))[
                        CONTROLS.index("throttle")
                    ]
                )
                fdm["ic/h-sl-ft"] = altitude_m / FT_M
                for axis, part in zip("uvw", (speed, 0.0, 0.0), strict=True):
                    fdm[f"ic/{axis}-fps"] = float(part) / FT_M
                if model.engines:
                    engine.start_engines(fdm)
                for setter in setters:
                    setter(value)
                engine.run_ic(fdm)
                if model.engines:
                    engine.settle_engines(fdm)
                out[i, k] = read[0]() if column == "rpm" else (read[0]() - read[1]()) * LBF_N
    return out


def _has(record: FlightRecord, column: str) -> bool:
    return column in record and bool(np.isfinite(record[column]).any())
