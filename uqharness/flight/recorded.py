"""A flight flown and written as a flight record: signals, sensor noise, names of manoeuvres."""

from __future__ import annotations

import math
import zlib
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from uqharness.errors import BadInputError
from uqharness.flight.fly import Recorded, record_mission
from uqharness.flight.normals import drawn
from uqharness.flight.spec import FlightSpec
from uqharness.isolation import ProcessEndedError, run_isolated
from uqharness.simulator import (
    MANOEUVRE_PROPERTY,
    MEMS_NOISE_STD,
    Aircraft,
    Script,
    Source,
    StagedMission,
)
from uqharness.simulator import signals as properties

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
    aircraft: Aircraft, script: Script, spec: FlightSpec
) -> tuple[pd.DataFrame, Recorded]:
    """Fly ``spec`` from its start on, in a worker process: the flight record, and how the flight ended.

    A flight that ends its process is flown again up to the last row before: the same seeds give the same rows. Raises
    BadInputError.
    """
    try:
        recorded = run_isolated(_recorded, aircraft, script, spec)
    except ProcessEndedError as error:
        if error.time_s is None:
            raise
        until_s = math.floor(error.time_s * spec.record_rate_hz + 0.5) / spec.record_rate_hz
        recorded = run_isolated(
            _recorded, aircraft, script, replace(spec, duration_s=until_s, burn_in_s=0.0)
        )
        recorded.status, recorded.reason = "crashed", error.reason
    return to_record(recorded, aircraft, spec, script.path.stem, script.manoeuvres), recorded


def _recorded(aircraft: Aircraft, script: Script, spec: FlightSpec) -> Recorded:
    with StagedMission(aircraft, script.path) as mission:
        table = {
            name: source
            for name, source in properties.sources(aircraft).items()
            if name != "time_s"
        }
        optional = dict(_OPTIONAL)
        if not aircraft.has_card:
            # What a card would have promised is only hoped for: a glider has no throttle.
            controls = set(table) - set(properties.STANDARD)
            optional |= {
                name: table.pop(name) for name in controls
            } | properties.standard_positions()
        # Without a sensors system nothing in the aircraft is told of noise; the record has it all the same.
        has_sensors = mission.open().get_property_manager().hasNode("sensor/V-mps")
        flown = spec if has_sensors else replace(spec, sensor_noise=False)
        return record_mission(mission, flown, table, optional, keep_burn_in=True)


def as_asked(spec: FlightSpec, seed: int) -> FlightSpec:
    """A flight as a person asks for it: both streams from one ``seed``, turbulence filters of second order.

    Raises BadInputError for a duration, wind, direction, rate or seed that cannot be flown.
    """
    for name, value, least, most in (
        ("duration_s", spec.duration_s, 0.0, 1e6),
        ("wind_mps", spec.wind_mps, None, 100.0),
        ("rate_hz", spec.record_rate_hz, 0.0, 1e5),
    ):
        if not (
            math.isfinite(value)
            and (value >= 0.0 if least is None else value > least)
            and value <= most
        ):
            low = "of at least 0" if least is None else f"above {least:g}"
            raise BadInputError(f"{name} = {value:g}: a number {low} and up to {most:g} is needed")
    if not math.isfinite(spec.wind_from_deg):
        raise BadInputError(f"wind_from_deg = {spec.wind_from_deg}: an angle in degrees is needed")
    if seed < 0:
        raise BadInputError(f"seed = {seed}: an integer of at least 0 is needed")
    turbulence, noise = two_seeds(seed)
    settings = {**properties.SECOND_ORDER, **spec.properties}
    return replace(spec, seed_turbulence=turbulence, seed_noise=noise, properties=settings)


def start_of(recorded: Recorded) -> dict[str, float]:
    """Where a recorded flight began, as a log says it: latitude, longitude [deg] and altitude above sea level [m]."""
    return {"lat_deg": 45.0, "lon_deg": 0.0, "alt_m": float(recorded.signals["h_m"][0])}


def two_seeds(seed: int) -> tuple[int, int]:
    """Seeds of turbulence and of noise: two streams from one number."""
    turbulence, noise = (
        int(x) for x in np.random.SeedSequence(seed).generate_state(2, np.uint32) % (2**31 - 2)
    )
    return turbulence, noise


def to_record(
    recorded: Recorded,
    aircraft: Aircraft,
    spec: FlightSpec,
    manoeuvre: str,
    named: Mapping[int, str] | None = None,
) -> pd.DataFrame:
    """The flight record of a recorded flight: heights from the start, headings within 0..2 pi, noise where asked for.

    The column ``manoeuvre`` follows the script's count of ``named`` manoeuvres, empty in between; without any it is ``manoeuvre``.
    """
    # Imported here: a second of loading that no other command should pay.
    import pandas as pd

    columns = dict(recorded.signals)
    columns["h_m"] = columns["h_m"] - columns["h_m"][0]
    # A script may name manoeuvres and never declare the property that counts them.
    number = columns.pop(_NUMBER, None)
    if spec.sensor_noise:
        for name, std in (aircraft.card.sensors.noise_std or MEMS_NOISE_STD).items():
            if name in columns:
                # One stream a channel, named by the channel: adding a sensor changes no other's noise.
                stream = np.random.SeedSequence([spec.seed_noise, zlib.crc32(name.encode())])
                columns[name] = columns[name] + std * drawn(stream, columns[name].size)
    columns["psi_rad"] = np.mod(columns["psi_rad"], 2.0 * np.pi)
    frame = pd.DataFrame(columns)
    frame["manoeuvre"] = (
        [named.get(int(k), "") for k in number] if named and number is not None else manoeuvre
    )
    return frame
