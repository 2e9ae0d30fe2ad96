"""Simulated flights as flight records: flying, sensor noise, files, and FlightGear playback.

`recorded_flight` flies a script in a worker process and returns the record as a table.
`write_record` writes CSV, Parquet or DataFlash, and `playback_rows` converts to FlightGear.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from sysid.arrays import FloatArray
from sysid.record import FlightRecord
from sysid.units import FT_M, KT_MPS, RAD_DEG
from uqharness.errors import BadInputError
from uqharness.files import write_atomically
from uqharness.flight.autopilot_process import AutopilotSettings
from uqharness.flight.fly import RecordedFlight, record_mission
from uqharness.flight.random_numbers import draw_normals
from uqharness.flight.spec import FlightSpec
from uqharness.flight.waypoints import WaypointMission
from uqharness.isolation import ProcessEndedError, run_isolated
from uqharness.simulator import (
    MANOEUVRE_PROPERTY,
    MEMS_NOISE_STD,
    Aircraft,
    Script,
    Source,
    StagedMission,
)
from uqharness.simulator import aircraft as properties

if TYPE_CHECKING:
    import pandas as pd

_NUMBER = "manoeuvre_number"
_OPTIONAL = {
    "north_m": Source("nav/north-m"),
    "east_m": Source("nav/east-m"),
    "cross_track_m": Source("nav/cross-track-m"),
    _NUMBER: Source(MANOEUVRE_PROPERTY),
}


def recorded_flight(
    aircraft: Aircraft,
    script: Script,
    spec: FlightSpec,
    autopilot: AutopilotSettings | WaypointMission | None = None,
) -> tuple[pd.DataFrame, RecordedFlight]:
    """Fly a spec from its start in a worker process and return the flight record.

    Parameters
    ----------
    aircraft : Aircraft
        The aircraft.
    script : Script
        Its script names the manoeuvres.
    spec : FlightSpec
        Conditions, seeds and duration.
    autopilot : AutopilotSettings or WaypointMission, optional
        A real autopilot that commands the aircraft in lock step, or a mission of waypoints.

    Returns
    -------
    frame : DataFrame
        The flight record. A flight that crashes its process is flown again up to the row before;
        equal seeds give equal rows.
    recorded : Recorded
        Signals without noise, and how the flight ended.

    Raises
    ------
    BadInputError
        If the flight cannot start.
    """
    try:
        recorded = run_isolated(_record_in_worker, aircraft, script, spec, autopilot)
    except ProcessEndedError as error:
        if error.time_s is None:
            raise
        # The last row before the crash.
        until_s = math.floor(error.time_s * spec.record_rate_hz + 0.5) / spec.record_rate_hz
        recorded = run_isolated(
            _record_in_worker,
            aircraft,
            script,
            replace(spec, duration_s=until_s, burn_in_s=0.0),
            autopilot,
        )
        recorded.status, recorded.reason = "crashed", error.reason
    return to_record(recorded, aircraft, spec, script.path.stem, script.manoeuvres), recorded


def _record_in_worker(
    aircraft: Aircraft,
    script: Script,
    spec: FlightSpec,
    autopilot: AutopilotSettings | WaypointMission | None,
) -> RecordedFlight:
    """Fly and record all signals of a record."""
    with StagedMission(aircraft, script.path) as mission:
        table = {
            name: source
            for name, source in properties.sources(aircraft).items()
            if name != "time_s"
        }
        optional = dict(_OPTIONAL)
        if not aircraft.has_card:
            # Without a card, controls may not exist: a glider has no throttle.
            controls = set(table) - set(properties.STANDARD)
            optional |= {
                name: table.pop(name) for name in controls
            } | properties.standard_positions()
        if isinstance(autopilot, WaypointMission):
            # It counts from the script's circle, which the mission moves.
            optional.pop("cross_track_m", None)
        # Without a sensors system nothing in the aircraft needs noise; the record gets it anyway.
        has_sensors = mission.open().get_property_manager().hasNode("sensor/V-mps")
        flight = spec if has_sensors else replace(spec, sensor_noise=False)
        return record_mission(
            mission, flight, table, optional, keep_burn_in=True, autopilot=autopilot
        )


def seeded_spec(spec: FlightSpec, seed: int) -> FlightSpec:
    """Return a spec with both streams from one seed and second-order integrators.

    Parameters
    ----------
    spec : FlightSpec
        The flight as requested.
    seed : int
        Seed of turbulence and noise, at least 0.

    Raises
    ------
    BadInputError
        For a duration, wind, direction, rate or seed out of range.
    """
    for name, value, minimum, maximum in (
        ("duration_s", spec.duration_s, 0.0, 1e6),
        ("wind_mps", spec.wind_mps, None, 100.0),
        ("rate_hz", spec.record_rate_hz, 0.0, 1e5),
    ):
        if not (
            math.isfinite(value)
            and (value >= 0.0 if minimum is None else value > minimum)
            and value <= maximum
        ):
            low = "of at least 0" if minimum is None else f"above {minimum:g}"
            raise BadInputError(
                f"{name} = {value:g}: a number {low} and up to {maximum:g} is needed"
            )
    if not math.isfinite(spec.wind_from_deg):
        raise BadInputError(f"wind_from_deg = {spec.wind_from_deg}: an angle in degrees is needed")
    if seed < 0:
        raise BadInputError(f"seed = {seed}: an integer of at least 0 is needed")
    turbulence, noise = turbulence_and_noise_seeds(seed)
    settings = {**properties.SECOND_ORDER, **spec.properties}
    return replace(spec, seed_turbulence=turbulence, seed_noise=noise, properties=settings)


def start_position(recorded: RecordedFlight) -> dict[str, float]:
    """Return latitude, longitude [deg] and altitude above sea level [m] of the start."""
    return {"lat_deg": 45.0, "lon_deg": 0.0, "alt_m": float(recorded.signals["h_m"][0])}


def turbulence_and_noise_seeds(seed: int) -> tuple[int, int]:
    """Return seeds of turbulence and of noise from one number."""
    turbulence, noise = (
        int(x) for x in np.random.SeedSequence(seed).generate_state(2, np.uint32) % (2**31 - 2)
    )
    return turbulence, noise


def to_record(
    recorded: RecordedFlight,
    aircraft: Aircraft,
    spec: FlightSpec,
    manoeuvre: str,
    manoeuvre_names: Mapping[int, str] | None = None,
) -> pd.DataFrame:
    """Return the flight record of recorded signals.

    Parameters
    ----------
    recorded : Recorded
        Signals; heights become relative to the start, headings 0 to 2 pi.
    aircraft : Aircraft
        Its card gives the noise.
    spec : FlightSpec
        Whether to add noise, and its seed.
    manoeuvre : str
        Name of the flight if it has no numbered manoeuvres.
    manoeuvre_names : mapping, optional
        Number to name; the column ``manoeuvre`` is empty between manoeuvres.
    """
    # Imported here, because loading pandas takes a second.
    import pandas as pd

    columns = dict(recorded.signals)
    columns["h_m"] = columns["h_m"] - columns["h_m"][0]
    # A script may name manoeuvres without declaring the property that counts them.
    number = columns.pop(_NUMBER, None)
    if spec.sensor_noise:
        for name, std in (aircraft.card.sensors.noise_std or MEMS_NOISE_STD).items():
            if name in columns:
                # One stream per channel, so that adding a sensor does not change the noise of
                # others.
                stream = np.random.SeedSequence([spec.seed_noise, zlib.crc32(name.encode())])
                columns[name] = columns[name] + std * draw_normals(stream, columns[name].size)
    columns["psi_rad"] = np.mod(columns["psi_rad"], 2.0 * np.pi)
    frame = pd.DataFrame(columns)
    frame["manoeuvre"] = (
        [manoeuvre_names.get(int(k), "") for k in number]
        if manoeuvre_names and number is not None
        else manoeuvre
    )
    return frame


# Files of flight records, written atomically.

FORMATS = (".csv", ".parquet", ".bin")


def write_record(
    table: pd.DataFrame,
    path: Path,
    aircraft: Aircraft | None = None,
    start: Mapping[str, float] | None = None,
) -> tuple[str, ...]:
    """Write a flight record in the format of the path's suffix.

    Parameters
    ----------
    table : DataFrame
        The record.
    path : Path
        File with a suffix of `FORMATS`.
    aircraft : Aircraft, optional
        For DataFlash: its card turns surface angles into servo pulses.
    start : mapping, optional
        For DataFlash: lat_deg, lon_deg [deg] and alt_m [m] of the start.

    Returns
    -------
    tuple of str
        Columns that the format cannot hold.

    Raises
    ------
    BadInputError
        For another suffix, a path that cannot be written, or a card without servo tables.
    """
    suffix = path.suffix.lower()
    if suffix not in FORMATS:
        raise BadInputError(
            f"--out {path}: the format follows the name's ending, {', '.join(FORMATS)}; received"
            f" '{path.suffix}'"
        )
    if suffix == ".bin":
        return _write_dataflash(table, path, aircraft, start or {})
    if suffix == ".csv":
        # 17 digits restore every double.
        write_atomically(
            path,
            lambda target: table.to_csv(
                target, index=False, float_format="%.17g", lineterminator="\n"
            ),
        )
    else:
        write_atomically(path, lambda target: table.to_parquet(target, index=False))
    return ()


def _write_dataflash(
    table: pd.DataFrame, path: Path, aircraft: Aircraft | None, start: Mapping[str, float]
) -> tuple[str, ...]:
    """Write a DataFlash log; return the columns that it cannot hold."""
    from sysid.errors import LogError
    from sysid.logs import read_card, write_dataflash
    from sysid.record import FlightRecord, Metadata
    from sysid.vocabulary import SIGNALS

    columns = {str(name): table[name].to_numpy() for name in table.columns if name in SIGNALS}
    left_out: list[str] = [str(name) for name in table.columns if name not in SIGNALS]
    try:
        card = (
            read_card(aircraft.folder)
            if aircraft is not None and (aircraft.folder / "airframe.toml").is_file()
            else None
        )
        record = FlightRecord(columns, Metadata(dialect="simulation", start=dict(start)))
        write_atomically(
            path,
            lambda target: left_out.extend(write_dataflash(record, target, card, surfaces=True)),
        )
    except LogError as error:
        raise BadInputError(str(error)) from None
    return tuple(left_out)


# FlightGear playback: position on the ellipsoid, attitude and airspeed at a constant rate.

PLAYBACK_COLUMNS = ("north_m", "east_m", "h_m", "phi_rad", "theta_rad", "psi_rad", "V_mps")
_RADIUS_M, _ECCENTRICITY_2 = 6378137.0, 6.69437999014e-3
"""Equatorial radius [m] and first eccentricity squared of the WGS 84 ellipsoid."""


def playback_rows(record: FlightRecord, start: Mapping[str, float], rate_hz: float) -> FloatArray:
    """Return the rows (n, 7) of the fields of `uqharness.xml.document.FIELDS`.

    Parameters
    ----------
    record : FlightRecord
        The flight; ``h_m`` is the height above its start.
    start : mapping
        lat_deg, lon_deg [deg] and alt_m above sea level [m] of the start.
    rate_hz : float
        Rows per second [Hz]; each row is the nearest sample, and gaps hold the last value.

    Raises
    ------
    BadInputError
        For a record without one of ``PLAYBACK_COLUMNS``, or without any value of it.
    """
    missing = [name for name in PLAYBACK_COLUMNS if name not in record]
    if missing:
        raise BadInputError(
            f"FlightGear needs {', '.join(missing)}, which the record does not have; it needs"
            f" {', '.join(PLAYBACK_COLUMNS)}"
        )
    time_s = np.asarray(record["time_s"])
    at = np.arange(time_s[0], time_s[-1] + 0.5 / rate_hz, 1.0 / rate_hz)
    right = np.clip(np.searchsorted(time_s, at), 1, len(time_s) - 1)
    # Nearest sample of each row.
    rows = np.where(at - time_s[right - 1] <= time_s[right] - at, right - 1, right)
    north, east, h, phi, theta, psi, airspeed = (
        _fill_gaps(name, np.asarray(record[name]))[rows] for name in PLAYBACK_COLUMNS
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
    """Return latitude and longitude (n,) [deg] of points on the local plane of a start point.

    Parameters
    ----------
    north_m, east_m : ndarray
        Distances from the start (n,) [m].
    lat_deg, lon_deg : float
        Start point [deg]; its two radii of curvature are used.
    """
    lat0 = math.radians(lat_deg)
    w = 1.0 - _ECCENTRICITY_2 * math.sin(lat0) ** 2
    # Radii of curvature in the meridian and of the parallel.
    meridian = _RADIUS_M * (1.0 - _ECCENTRICITY_2) / w**1.5
    parallel = _RADIUS_M / math.sqrt(w) * math.cos(lat0)
    return lat_deg + np.degrees(north_m / meridian), lon_deg + np.degrees(east_m / parallel)


def _fill_gaps(name: str, values: FloatArray) -> FloatArray:
    """Return values with NaN replaced by the last finite value, or the first at the start."""
    finite = np.isfinite(values)
    if not finite.any():
        raise BadInputError(f"FlightGear needs {name}, and the record has no value of it")
    # Index of the last finite value at each sample; -1 before the first.
    last = np.maximum.accumulate(np.where(finite, np.arange(len(values)), -1))
    return values[np.where(last < 0, int(np.argmax(finite)), last)]
