"""Flights in Python: simulated, or read from logs and records.

`Flight` is what all functions of this package take and return. `aircraft_of` and `flights_of`
accept whatever a user passes for an aircraft or flights.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

from numpy.typing import NDArray

from sysid.digests import file_sha256, sha256_hex
from sysid.logs import LogInfo, MapProposal, check_units, import_log
from sysid.logs import log_info as report_of_log
from sysid.logs import propose_map as proposed
from sysid.record import FlightRecord, Metadata
from sysid.vocabulary import LABELS, SIGNALS
from uqharness.arguments import flag, instance, integer, number, one_of
from uqharness.arguments import path as argument_path
from uqharness.arguments import properties as settings
from uqharness.errors import BadInputError
from uqharness.flight import (
    DEFAULT_TURBULENCE_SOURCE,
    TURBULENCE_W20_KT,
    FlightSpec,
    recorded_flight,
    seeded_spec,
    start_position,
    write_record,
)
from uqharness.heartbeat import notebook_line
from uqharness.plugin import with_card
from uqharness.replay import in_free_flight, numbers_of_files, read_flight, refuse_duplicates
from uqharness.simulator import Aircraft, find_aircraft, find_script, read_script
from uqharness.text_tables import TabularResult

if TYPE_CHECKING:
    import pandas as pd

AnyPath: TypeAlias = str | PathLike[str]
AnyAircraft: TypeAlias = str | PathLike[str] | Aircraft


@dataclass(frozen=True)
class Flight(TabularResult):
    """One flight: its record, and how it ended if it was flown here.

    Attributes
    ----------
    name : str
        What reports call it.
    record : FlightRecord
        Channels by name, (n,) each, SI units and body axes (docs/log-reference.md lists them).
        ``flight["q_radps"]`` reads one.
    sha256 : str
        Identity of its content, which model forms remember.
    status, reason : str
        ``ok``, or what ended a flown flight early (``diverged``, ``ground-contact``, ``crashed``)
        and why.
    aircraft : Aircraft or None
        What flew it; None for a log.
    start : Mapping
        Where a flown flight began: lat_deg [deg], lon_deg [deg], alt_m above sea level [m].
    """

    name: str
    record: FlightRecord
    sha256: str
    status: str = "ok"
    reason: str = ""
    aircraft: Aircraft | None = None
    start: Mapping[str, float] = field(default_factory=dict)

    def __repr__(self) -> str:
        time_s = self.record["time_s"]
        seconds = float(time_s[-1] - time_s[0]) if len(time_s) else 0.0
        return f"Flight({self.name!r}, {len(self)} rows, {seconds:g} s, {self.status})"

    def __len__(self) -> int:
        return len(self.record)

    def __getitem__(self, name: str) -> NDArray[Any]:
        """Return the channel (n,). Raises LogError naming the available ones."""
        return self.record[name]

    def to_dataframe(self) -> pd.DataFrame:
        """Return every column of the record as a table, one row a sample."""
        import pandas as pd

        return pd.DataFrame(dict(self.record.columns))

    def write(self, path: AnyPath) -> tuple[str, ...]:
        """Write .parquet, .csv or .bin (ArduPilot DataFlash); return the columns that the format
        cannot hold.

        An interrupted write leaves no file. Raises BadInputError for another suffix and a folder
        that cannot be written.
        """
        return write_record(
            self.to_dataframe(), argument_path("path", path), self.aircraft, self.start
        )


AnyFlight: TypeAlias = str | PathLike[str] | FlightRecord | Flight


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
    numbers = numbers_of_files([chosen] if isinstance(chosen, int) else chosen, len(files))
    records = [
        read_flight(path, model, table, own_map, number)
        for path, number in zip(files, numbers, strict=True)
    ]
    hashes = [file_sha256(path) for path in files]
    refuse_duplicates(files, hashes)
    return [
        Flight(path.stem, record, sha256)
        for path, record, sha256 in zip(files, records, hashes, strict=True)
    ]


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


def aircraft_of(aircraft: AnyAircraft) -> Aircraft:
    """Return the aircraft of a name or folder. Raises BadInputError."""
    return (
        aircraft
        if isinstance(aircraft, Aircraft)
        else find_aircraft(argument_path("aircraft", aircraft))
    )


def carded_aircraft(aircraft: AnyAircraft) -> Aircraft:
    """Return the aircraft with a card; one without airframe.toml is instrumented for this process.

    Raises BadInputError.
    """
    return with_card(aircraft_of(aircraft))


def flights_of(flights: AnyFlight | Iterable[AnyFlight], aircraft: Aircraft) -> list[Flight]:
    """Return one flight or several as a list, at least one and none twice.

    Raises BadInputError.
    """
    # A single flight is a sequence too (its path, its rows), so it is recognised first.
    if isinstance(flights, str | PathLike | FlightRecord | Flight):
        flights = [flights]
    several = instance(
        "flights", flights, Iterable, "a path, a FlightRecord, a Flight or several of them"
    )
    unique_flights = [_flight_of(flight, aircraft) for flight in several]
    if not unique_flights:
        raise BadInputError(
            "no flight was given; at least one is needed, such as uq.read_flights(['flight.bin'],"
            " aircraft)"
        )
    refuse_duplicates(
        [flight.name for flight in unique_flights], [flight.sha256 for flight in unique_flights]
    )
    return unique_flights


def _flight_of(flight: AnyFlight, aircraft: Aircraft) -> Flight:
    """Return one flight in whatever form it was given. Raises BadInputError."""
    if isinstance(flight, Flight):
        return flight
    if isinstance(flight, FlightRecord):
        name = Path(flight.metadata.source).stem or "flight"
        return Flight(name, in_free_flight(flight, aircraft, name), _content_sha256(flight))
    if not isinstance(flight, str | PathLike):
        raise BadInputError(
            "a flight is a path, a FlightRecord or what fly and read_flights give; received"
            f" {type(flight).__name__}"
        )
    return read_flights(flight, aircraft)[0]


def _content_sha256(record: FlightRecord) -> str:
    """Return the digest of a record's columns."""
    parts = []
    for name, values in record.columns.items():
        # The digest covers names, lengths and little-endian values, whatever the platform.
        content = "\0".join(values).encode() if name in LABELS else values.astype("<f8").tobytes()
        parts += [f"{name}\0{len(content)}\0".encode(), content]
    return sha256_hex(b"".join(parts))
