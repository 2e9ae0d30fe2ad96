"""Flights in Python: simulated, or read from logs and records.

`Flight` is what all functions of this package take and return. `aircraft_of` and `flights_of`
accept whatever a user passes for an aircraft or flights.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

from sysid.logs import LogInfo, MapProposal, check_units
from sysid.record import FlightRecord, Metadata
from sysid.vocabulary import SIGNALS
from uqharness.arguments import flag, integer, number, one_of
from uqharness.arguments import path as argument_path
from uqharness.arguments import properties as settings
from uqharness.commands import logs
from uqharness.commands.flights import (
    AnyAircraft,
    AnyPath,
    Flight,
    _content_sha256,
    aircraft_of,
    carded_aircraft,
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
from uqharness.isolation import isolated
from uqharness.requests.base import accepts
from uqharness.requests.logs import (
    LogExportRequest,
    LogInfoRequest,
    LogMapRequest,
    ReadFlightsRequest,
)
from uqharness.results.logs import Playback
from uqharness.simulator import find_script, read_script


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
        _content_sha256(record),
        recorded.status,
        recorded.reason,
        model,
        start_position(recorded),
    )


@accepts(ReadFlightsRequest)
def read_flights(request: ReadFlightsRequest) -> list[Flight]:
    """Read flight logs or records, the part that is free flight.

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
    return flights_of(
        request.paths,
        carded_aircraft(request.aircraft),
        manoeuvres=request.manoeuvres,
        signal_map=request.signal_map,
        flight_number=request.flight_number or (),
    )


@notebook_line("propose_map")
@accepts(LogMapRequest)
def propose_map(request: LogMapRequest) -> MapProposal:
    """Propose a signal map for a log, as ``uqharness log map`` does.

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
    return logs.propose_map(request).value


@notebook_line("log_info")
@accepts(LogInfoRequest)
def log_info(request: LogInfoRequest) -> LogInfo:
    """Check a flight log, and list its contents and purposes, as ``uqharness log info`` does.

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
    return logs.log_info(request).value


@notebook_line("export_log")
@accepts(LogExportRequest)
@isolated
def export_log(request: LogExportRequest) -> Playback:
    """Write a flight as files that FlightGear plays back, as ``uqharness log export`` does.

    Returns
    -------
    Playback
        ``files``, ``rows``, ``rate_hz`` [1/s] and ``columns``.

    Raises
    ------
    BadInputError
        For a log without position or attitude, and one that does not say where it began.

    Examples
    --------
    >>> import uqharness as uq
    >>> columns = uq.fly("espaaro", "doublet-elevator", duration_s=2).write("doublet.parquet")
    >>> uq.export_log("doublet.parquet", "espaaro", "shown", lat_deg=37.2, lon_deg=-80.4).rows
    61
    """
    return logs.export_log(request).value
