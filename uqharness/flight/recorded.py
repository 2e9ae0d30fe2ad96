"""A flight flown and written as a flight record: signals, sensor noise, names of manoeuvres."""

from __future__ import annotations

import sys
import zlib
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from uqharness.flight.fly import Recorded, record_mission
from uqharness.flight.spec import FlightSpec
from uqharness.simulator import signals as properties
from uqharness.simulator.aircraft import Aircraft
from uqharness.simulator.mission import MANOEUVRE_PROPERTY, Script, StagedMission
from uqharness.simulator.signals import Source

if TYPE_CHECKING:
    import pandas as pd

_NUMBER = "manoeuvre_number"
_OPTIONAL = {
    "north_m": Source("nav/north-m"),
    "east_m": Source("nav/east-m"),
    "cross_track_m": Source("nav/cross-track-m"),
    _NUMBER: Source(MANOEUVRE_PROPERTY),
}


def recorded_flight(aircraft: Aircraft, script: Script, spec: FlightSpec) -> tuple[pd.DataFrame, Recorded]:
    """Fly ``spec`` from its start on: the flight record, and how the flight ended. Raises BadInputError."""
    with StagedMission(aircraft, script.path) as mission:
        table = {name: source for name, source in properties.sources(aircraft).items() if name != "time_s"}
        optional = dict(_OPTIONAL)
        if not aircraft.has_card:
            # What a card would have promised is only hoped for: a glider has no throttle.
            controls = set(table) - set(properties.STANDARD)
            optional |= {name: table.pop(name) for name in controls} | properties.standard_positions()
            print(
                f"uqharness: note: {aircraft.folder} has no airframe.toml, so the record's commands are JSBSim's fcs/...-cmd-norm",
                file=sys.stderr,
            )
        recorded = record_mission(mission, spec, table, optional, keep_burn_in=True)
    return to_record(recorded, aircraft, spec, script.path.stem, script.manoeuvres), recorded


def two_seeds(seed: int) -> tuple[int, int]:
    """Seeds of turbulence and of noise: two streams from one number."""
    turbulence, noise = (int(x) for x in np.random.SeedSequence(seed).generate_state(2, np.uint32) % (2**31 - 2))
    return turbulence, noise


def to_record(
    recorded: Recorded, aircraft: Aircraft, spec: FlightSpec, manoeuvre: str, named: Mapping[int, str] | None = None
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
        for name, std in aircraft.card.sensors.noise_std.items():
            if name in columns:
                # One stream a channel, named by the channel: adding a sensor changes no other's noise.
                stream = np.random.Generator(np.random.Philox(np.random.SeedSequence([spec.seed_noise, zlib.crc32(name.encode())])))
                columns[name] = columns[name] + std * stream.standard_normal(columns[name].size)
    columns["psi_rad"] = np.mod(columns["psi_rad"], 2.0 * np.pi)
    frame = pd.DataFrame(columns)
    frame["manoeuvre"] = [named.get(int(k), "") for k in number] if named and number is not None else manoeuvre
    return frame
