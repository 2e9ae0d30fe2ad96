"""Flights in Python: simulated, or read from logs and records.

`uqharness.commands.flights.Flight` is what all functions of this package take and return.
"""

from __future__ import annotations

from sysid.logs import LogInfo, MapProposal
from uqharness.commands import Flight, carded_aircraft, flights_of, logs, simulation
from uqharness.heartbeat import notebook_line
from uqharness.isolation import isolated
from uqharness.requests.base import accepts
from uqharness.requests.logs import (
    LogExportRequest,
    LogInfoRequest,
    LogMapRequest,
    ReadFlightsRequest,
)
from uqharness.requests.simulation import FlyRequest
from uqharness.results.logs import Playback


@notebook_line("fly")
@accepts(FlyRequest)
def fly(request: FlyRequest) -> Flight:
    """Fly a run script once, as ``uqharness fly`` does.

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
    # The flight itself runs in a worker, whose crash is a result.
    return simulation.fly(request).value


@accepts(ReadFlightsRequest)
def read_flights(request: ReadFlightsRequest) -> list[Flight]:
    """Read flight logs or records, the part that is free flight.

    Returns
    -------
    list of Flight
        One per file, in order.

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
