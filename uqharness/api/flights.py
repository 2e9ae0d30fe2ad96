"""Flights in Python: simulated, or read from logs and records.

`Flight` is what all functions of this package take and return. `aircraft_of` and `flights_of`
accept whatever a user passes for an aircraft or flights.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from os import PathLike
from typing import TYPE_CHECKING, Literal

from sysid.logs import LogInfo, MapProposal, check_units, import_log
from sysid.logs import log_info as report_of_log
from sysid.logs import propose_map as proposed
from sysid.record import FlightRecord, Metadata
from sysid.vocabulary import SIGNALS
from uqharness.arguments import flag, instance, integer, number, one_of
from uqharness.arguments import path as argument_path
from uqharness.arguments import properties as settings
from uqharness.commands import (
    AnyAircraft,
    AnyPath,
    Flight,
    aircraft_of,
    carded_aircraft,
    content_sha256,
    flights_of,
)
from uqharness.flight import (
    DEFAULT_TURBULENCE_SOURCE,
    TURBULENCE_W20_KT,
    FlightSpec,
    recorded_flight,
    seeded_spec,
    start_position,
)
from uqharness.heartbeat import notebook_line
from uqharness.simulator import find_script, read_script

if TYPE_CHECKING:
    pass


def fly(
    aircraft: AnyAircraft,
    script: AnyPath = "loiter",
    *,
    mission: AnyPath | None = None,
    duration_s: float | None = None,
    wind_mps: float = 0.0,
    wind_from_deg: float = 270.0,
    turbulence: Literal["none", "light", "moderate", "severe"] = "none",
    turbulence_source: Literal["spec", "jsbsim"] = DEFAULT_TURBULENCE_SOURCE,
    seed: int = 0,
    noise: bool = False,
    properties: Mapping[str, float] | None = None,
    rate_hz: float = 50.0,
) -> Flight:
    """Fly a run script once, as ``uqharness fly`` does.

    Parameters
    ----------
    aircraft : str, Path or Aircraft
        Name under aircraft/ or of JSBSim's collection, a folder, or what `find_aircraft` gave.
    script : str or Path
        Run script, a file or a name under scripts/.
    mission : str or Path, optional
        The same under the name that campaigns have for it.
    duration_s : float, optional
        Length of the flight [s]; by default until the script's end.
    wind_mps, wind_from_deg : float
        Steady wind [m/s] and the true direction that it blows from [deg].
    turbulence : {"none", "light", "moderate", "severe"}
        Intensity after MIL-F-8785C.
    turbulence_source : {"spec", "jsbsim"}
        Which Dryden model: the one after the specification, or JSBSim's own.
    seed : int
        Seed of turbulence and of sensor noise; the same seed gives the same flight.
    noise : bool
        Whether sensor noise is added to the autopilot's inputs and to the record.
    properties : Mapping, optional
        JSBSim properties set before the flight, such as ``{"aero/Cm_q": -10.0}``.
    rate_hz : float
        Rows per second [1/s].

    Returns
    -------
    Flight
        The record, (duration_s * rate_hz + 1,) samples if it flew to the end, and how it ended. A
        flight that crashes or diverges is a result: its ``status`` says so.

    Raises
    ------
    BadInputError
        For an unknown aircraft, script or property, and for numbers that cannot be flown.

    References
    ----------
    MIL-F-8785C, 1980, section 3.7: the Dryden turbulence.

    Examples
    --------
    >>> import uqharness as uq
    >>> flight = uq.fly("espaaro", duration_s=10, wind_mps=3, turbulence="moderate", seed=7)
    >>> flight.status, len(flight)
    ('ok', 501)
    >>> table = flight.to_dataframe()
    >>> list(table.columns[:4])
    ['time_s', 'V_mps', 'alpha_rad', 'beta_rad']
    """
    if mission is not None:
        script = argument_path("mission", mission)
    model, run = aircraft_of(aircraft), read_script(find_script(argument_path("script", script)))
    for name, value in (
        ("wind_mps", wind_mps),
        ("wind_from_deg", wind_from_deg),
        ("rate_hz", rate_hz),
    ):
        number(name, value)
    if duration_s is not None:
        number("duration_s", duration_s)
    seed = integer("seed", seed)
    spec = FlightSpec(
        model.folder,
        run.path,
        run.end_s if duration_s is None else duration_s,
        wind_mps=wind_mps,
        wind_from_deg=wind_from_deg,
        turbulence=one_of("turbulence", turbulence, tuple(TURBULENCE_W20_KT)),
        turbulence_source=one_of("turbulence_source", turbulence_source, ("spec", "jsbsim")),
        sensor_noise=flag("noise", noise),
        properties=settings(properties),
        record_rate_hz=rate_hz,
    )
    frame, recorded = recorded_flight(model, run, seeded_spec(spec, seed))
    channels = {str(name): frame[name].to_numpy() for name in frame.columns if name in SIGNALS}
    # Unit checks need a record, and their findings belong to its metadata.
    record = FlightRecord(channels, Metadata(source=run.path.stem, dialect="record"))
    record = FlightRecord(
        channels,
        Metadata(source=run.path.stem, dialect="record", findings=tuple(check_units(record))),
    )
    return Flight(
        run.path.stem,
        record,
        content_sha256(record),
        recorded.status,
        recorded.reason,
        model,
        start_position(recorded),
    )


def read_flights(
    paths: AnyPath | Sequence[AnyPath],
    aircraft: AnyAircraft,
    *,
    manoeuvres: AnyPath | None = None,
    signal_map: AnyPath | None = None,
    flight_number: int | Sequence[int] | None = None,
) -> list[Flight]:
    """Read flight logs or records, the part that is free flight.

    Parameters
    ----------
    paths : str, Path or sequence of them
        Records (.parquet, .csv) or logs (ArduPilot .bin, .log, .tlog; PX4 .ulg), recognised by
        their content.
    aircraft : str, Path or Aircraft
        Whose airframe.toml turns servo outputs into angles.
    manoeuvres : str or Path, optional
        CSV table that labels the flights: columns manoeuvre, start_s, end_s (and flight).
    signal_map : str or Path, optional
        Signal map of your own, TOML (docs/logs.md).
    flight_number : int or sequence of int, optional
        Which flight of logs that hold several boots of the autopilot, from 1: one number, or one a
        file. Default: the longest.

    Returns
    -------
    list of Flight
        One a file, in order.

    Raises
    ------
    BadInputError
        For what is no log, damaged, of another aircraft, in degrees, or given twice.

    Examples
    --------
    >>> import uqharness as uq
    >>> columns = uq.fly("espaaro", "doublet-elevator", duration_s=5).write("doublet.parquet")
    >>> (flight,) = uq.read_flights("doublet.parquet", "espaaro")
    >>> flight.name, len(flight), "elevator_deg" in flight.record
    ('doublet', 251, True)
    """
    model = carded_aircraft(aircraft)
    several = [paths] if isinstance(paths, str | PathLike) else paths
    files = [
        argument_path("paths", p) for p in instance("paths", several, Iterable, "a path or several")
    ]
    table = None if manoeuvres is None else argument_path("manoeuvres", manoeuvres)
    own_map = None if signal_map is None else argument_path("signal_map", signal_map)
    chosen = () if flight_number is None else flight_number
    return flights_of(
        files,
        model,
        manoeuvres=table,
        signal_map=own_map,
        flight_number=[chosen] if isinstance(chosen, int) else chosen,
    )


def propose_map(log: AnyPath, aircraft: AnyAircraft | None = None) -> MapProposal:
    """Propose a signal map for a log, as ``uqharness log map`` does.

    Parameters
    ----------
    log : str or Path
        Table (CSV or Parquet), ArduPilot, MAVLink or PX4 log.
    aircraft : str, Path or Aircraft, optional
        Whose airframe.toml turns servo outputs into angles.

    Returns
    -------
    MapProposal
        ``signals`` holds each signal with its field, scale and evidence; ``to_toml()`` is the map
        as text.

    Raises
    ------
    LogError
        For a file that is no log or cannot be read.

    Examples
    --------
    >>> import math
    >>> import uqharness as uq
    >>> rows = [f"{20 * k};{20 + math.sin(0.1 * k):.3f}" for k in range(100)]
    >>> with open("air.csv", "w") as file:
    ...     _ = file.write("\\n".join(["time_ms;TAS [kt]", *rows]))
    >>> proposal = uq.propose_map("air.csv")
    >>> proposal.time.unit, proposal.signals[0].signal, round(proposal.signals[0].entry.scale, 4)
    ('ms', 'V_mps', 0.5144)
    """
    card = None if aircraft is None else carded_aircraft(aircraft).folder
    return proposed(argument_path("log", log), card)


def log_info(
    log: AnyPath,
    *,
    aircraft: AnyAircraft | None = None,
    signal_map: AnyPath | None = None,
    flight_number: int | None = None,
) -> LogInfo:
    """Check a flight log, and list its contents and purposes, as ``uqharness log info`` does.

    Parameters
    ----------
    log : str or Path
        A record (.parquet, .csv) or log (ArduPilot .bin, .log, .tlog; PX4 .ulg), recognised by its
        content.
    aircraft : str, Path or Aircraft, optional
        Whose airframe.toml turns servo outputs into angles.
    signal_map : str or Path, optional
        Signal map of your own, TOML (docs/logs.md).
    flight_number : int, optional
        Which flight of a log that holds several boots, from 1; by default the longest.

    Returns
    -------
    LogInfo
        ``channels``, ``rates_hz`` [1/s], ``flight_s`` [s], ``manoeuvres``, ``findings`` and
        ``purposes``; ``as_dict()`` is the document of ``--json``.

    Raises
    ------
    LogError
        For what is no log, or is damaged.

    Examples
    --------
    >>> import uqharness as uq
    >>> columns = uq.fly("espaaro", "doublet-elevator", duration_s=5).write("doublet.parquet")
    >>> uq.log_info("doublet.parquet").dialect
    'record'
    """
    own_map = None if signal_map is None else argument_path("signal_map", signal_map)
    card = None if aircraft is None else carded_aircraft(aircraft).folder
    boot = None if flight_number is None else integer("flight_number", flight_number, 1)
    with notebook_line("log_info"):
        record = import_log(argument_path("log", log), own_map, card, flight_number=boot)
        return report_of_log(record)
