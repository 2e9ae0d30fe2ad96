"""Aircraft and flights in any form that a request may hold, ready for replay.

`Flight` is what Python functions take and return. A request holds names, paths, records or objects;
`carded_aircraft` and `flights_of` turn them into aircraft and flights, `replay_flights` prepares
the flights of a request.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias

from numpy.typing import NDArray

from sysid.foreign.regular_files import file_sha256, sha256_hex
from sysid.record import FlightRecord
from sysid.vocabulary import LABELS
from uqharness.arguments import instance
from uqharness.arguments import path as argument_path
from uqharness.errors import BadInputError
from uqharness.flight import write_record
from uqharness.plugin import with_card
from uqharness.replay import flights as replayed
from uqharness.replay import in_free_flight, numbers_of_files, read_flight, refuse_duplicates
from uqharness.simulator import Aircraft, find_aircraft
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
    path : Path or None
        File that it was read from.
    """

    name: str
    record: FlightRecord
    sha256: str
    status: str = "ok"
    reason: str = ""
    aircraft: Aircraft | None = None
    start: Mapping[str, float] = field(default_factory=dict)
    path: Path | None = None

    def __repr__(self) -> str:
        time_s = self.record["time_s"]
        seconds = float(time_s[-1] - time_s[0]) if len(time_s) else 0.0
        return f"Flight({self.name!r}, {len(self)} rows, {seconds:g} s, {self.status})"

    def __len__(self) -> int:
        return len(self.record)

    @property
    def source(self) -> str:
        """Return the name of the file, or of the flight in memory."""
        return self.name if self.path is None else self.path.name

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


def aircraft_of(aircraft: AnyAircraft) -> Aircraft:
    """Return the aircraft of a name or folder. Raises BadInputError."""
    return (
        aircraft
        if isinstance(aircraft, Aircraft)
        else find_aircraft(argument_path("aircraft", aircraft))
    )


def carded_aircraft(aircraft: AnyAircraft) -> Aircraft:
    """Return the aircraft with a card; one without airframe.toml is instrumented for this process.

    A note says so. Raises BadInputError for one that does not fly or cannot be instrumented.
    """
    model = aircraft_of(aircraft)
    if not model.has_card:
        logging.getLogger("uqharness").info(
            "%s has no airframe.toml; its controls are measured in short flights. To see and keep"
            " the card: uqharness instrument %s --out DIR",
            model.name,
            aircraft if isinstance(aircraft, str | PathLike) else model.name,
        )
    return with_card(model)


def flights_of(
    flights: AnyFlight | Iterable[AnyFlight],
    aircraft: Aircraft,
    *,
    manoeuvres: Path | None = None,
    signal_map: Path | None = None,
    flight_number: Sequence[int] = (),
) -> list[Flight]:
    """Return one flight or several as a list, at least one and none twice.

    The options say how files are read; flights in memory are taken as they are.

    Raises BadInputError.
    """
    # A single flight is a sequence too (its path, its rows), so it is recognised first.
    if isinstance(flights, str | PathLike | FlightRecord | Flight):
        flights = [flights]
    several = list(
        instance(
            "flights", flights, Iterable, "a path, a FlightRecord, a Flight or several of them"
        )
    )
    files = [flight for flight in several if isinstance(flight, str | PathLike)]
    numbers = iter(numbers_of_files(flight_number, len(files)))
    unique_flights = [
        read_flight_file(Path(flight), aircraft, manoeuvres, signal_map, next(numbers))
        if isinstance(flight, str | PathLike)
        else _flight_in_memory(flight, aircraft)
        for flight in several
    ]
    if not unique_flights:
        raise BadInputError(
            "no flight was given; at least one is needed, such as uq.read_flights(['flight.bin'],"
            " aircraft)"
        )
    refuse_duplicates(
        [flight.source for flight in unique_flights], [flight.sha256 for flight in unique_flights]
    )
    return unique_flights


def read_flight_file(
    path: Path,
    aircraft: Aircraft,
    manoeuvres: Path | None = None,
    signal_map: Path | None = None,
    flight_number: int | None = None,
) -> Flight:
    """Read one log or record. Raises BadInputError."""
    record = read_flight(path, aircraft, manoeuvres, signal_map, flight_number)
    return Flight(path.stem, record, file_sha256(path), path=path)


def _flight_in_memory(flight: AnyFlight, aircraft: Aircraft) -> Flight:
    """Return a record or flight as a flight. Raises BadInputError."""
    if isinstance(flight, Flight):
        return flight
    if not isinstance(flight, FlightRecord):
        raise BadInputError(
            "a flight is a path, a FlightRecord or what fly and read_flights give; received"
            f" {type(flight).__name__}"
        )
    name = Path(flight.metadata.source).stem or "flight"
    return Flight(name, in_free_flight(flight, aircraft, name), content_sha256(flight))


@dataclass(frozen=True)
class ReplayFlights:
    """The flights of a request, ready for replay.

    Attributes
    ----------
    sources : list of Flight
        As they were read.
    flights : list of replay.Flight
        Prepared: aligned, cut into pieces.
    measured : tuple of str
        Surfaces whose measured positions are used.
    """

    sources: list[Flight]
    flights: list[replayed.Flight]
    measured: tuple[str, ...]

    @property
    def sha256(self) -> list[str]:
        """Return the digest of each flight, which results remember."""
        return [flight.sha256 for flight in self.sources]

    @property
    def files(self) -> list[str]:
        """Return the name of each flight's file, or of the flight in memory."""
        return [flight.source for flight in self.sources]


def replay_flights(request: FlightOptions, aircraft: Aircraft, align: bool = True) -> ReplayFlights:
    """Read and prepare the flights of a request.

    Parameters
    ----------
    request : FlightOptions
        Flights and how their files are read.
    aircraft : Aircraft
        The model that will replay them.
    align : bool
        Whether late channels are moved to where they belong.
    """
    sources = flights_of(
        request.flights,
        aircraft,
        manoeuvres=request.manoeuvres,
        signal_map=request.signal_map,
        flight_number=request.flight_number,
    )
    flights, measured = replayed.prepare_together(
        [f.name for f in sources], [f.record for f in sources], aircraft, align=align
    )
    return ReplayFlights(sources, flights, measured)


class FlightOptions(Protocol):
    """Fields that all requests with flights have."""

    @property
    def flights(self) -> Sequence[AnyFlight]:
        """Files, records or flights."""

    @property
    def manoeuvres(self) -> Path | None:
        """Table of manoeuvres."""

    @property
    def signal_map(self) -> Path | None:
        """Signal map."""

    @property
    def flight_number(self) -> Sequence[int]:
        """Boots of logs."""


def content_sha256(record: FlightRecord) -> str:
    """Return the digest of a record's columns."""
    parts = []
    for name, values in record.columns.items():
        # The digest covers names, lengths and little-endian values, whatever the platform.
        content = "\0".join(values).encode() if name in LABELS else values.astype("<f8").tobytes()
        parts += [f"{name}\0{len(content)}\0".encode(), content]
    return sha256_hex(b"".join(parts))
