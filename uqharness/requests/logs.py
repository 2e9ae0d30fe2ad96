"""Requests about flight logs: contents, signal maps, records and playback."""

from __future__ import annotations

from typing import Any, ClassVar, Literal

from pydantic import model_validator

from uqharness.requests import fields
from uqharness.requests.base import FilePath, Files, Flag, Number, Request, option

PLAYBACK, PROTOCOL = "playback.csv", "uqharness-playback.xml"
"""Files of an export to FlightGear."""


def _log(text: str) -> Any:
    """Return the field of the log."""
    return option(..., text, flag="", metavar="LOG", positional=True)


def _card(positional: bool = False) -> Any:
    """Return the field of the aircraft whose card turns servo outputs into angles."""
    return option(
        None,
        "aircraft whose airframe.toml turns servo outputs into angles: name under aircraft/,"
        " folder, or airframe.toml",
        metavar="AIRCRAFT",
        kind="str, Path or Aircraft, optional",
        positional=positional,
    )


_ANY_LOG = (
    "DataFlash .bin or .log, MAVLink .tlog, PX4 .ulg, MATLAB .mat, JSBSim's CSV, a flight"
    " record in Parquet or CSV"
)


class _Reading(Request):
    """Fields by which a log is read."""

    log: FilePath = _log(_ANY_LOG)
    signal_map: fields.OptionalPath = fields.signal_map()
    flight_number: fields.Workers = fields.boot()
    from_s: Number | None = fields.from_s()
    to_s: Number | None = fields.to_s()
    aircraft: fields.AircraftSource = _card()
    cache: fields.OptionalPath = option(
        None,
        "cache of imported logs (default: UQ_CACHE, else uqharness in the user's cache folder)",
        metavar="DIR",
    )
    use_cache: Flag = option(
        True,
        "whether the cache is read and written",
        flag="--no-cache",
        off=True,
        help="neither read nor write the cache",
    )


class LogInfoRequest(_Reading):
    """List the contents and findings of a log, and the purposes it serves."""

    command: ClassVar[str] = "log info"
    examples: ClassVar[str] = """
  uqharness log info flight1.bin --aircraft aircraft/espaaro
  uqharness log info flight1.bin --aircraft aircraft/espaaro --out flight1.html"""
    no: ClassVar[str] = "the log serves no purpose"

    out: fields.Page = fields.page(
        "every channel over time, findings flagged, phases and manoeuvres shaded"
    )
    manoeuvres: fields.OptionalPath = fields.manoeuvres()

    @model_validator(mode="after")
    def _check_page(self) -> LogInfoRequest:
        """Refuse manoeuvres without the page that shows them."""
        if self.manoeuvres is not None and self.out is None:
            raise ValueError("{manoeuvres}: belongs to the page; add {out} FILE.html")
        return self


class LogMapRequest(Request):
    """Propose a signal map for a log by names, units and statistics, to be read and edited."""

    command: ClassVar[str] = "log map"
    examples: ClassVar[str] = """
  uqharness log map flight.csv --out map.toml
  uqharness log info flight.csv --map map.toml"""
    no: ClassVar[str] = "no signal was recognised"

    log: FilePath = _log(_ANY_LOG)
    aircraft: fields.AircraftSource = _card(positional=True)
    out: fields.OptionalPath = option(
        None,
        "the map; an existing file is never overwritten (default: nothing is written)",
        metavar="FILE.toml",
        provenance=False,
    )


class LogImportRequest(_Reading):
    """Turn a log into a flight record (Parquet or CSV by the suffix of --out)."""

    command: ClassVar[str] = "log import"
    examples: ClassVar[str] = (
        "  uqharness log import flight1.bin --aircraft aircraft/espaaro --out flight1.parquet"
    )

    out: fields.TableFile = option(
        ..., "FILE.parquet or FILE.csv", metavar="FILE", provenance=False
    )
    whole: Flag = option(False, "keep ground and tow (default: free flight only)")
    manoeuvres: fields.OptionalPath = fields.manoeuvres()


class ReadFlightsRequest(Request):
    """Read the free flight of logs or records, for the functions that take flights."""

    paths: Files = option(
        ...,
        f"files, each a {fields.FLIGHT_FILE}",
        positional=True,
        kind="str, Path or sequence of them",
        needed="a path or several",
    )
    aircraft: fields.AircraftSource = fields.aircraft()
    manoeuvres: fields.OptionalPath = fields.manoeuvres()
    signal_map: fields.OptionalPath = fields.signal_map()
    flight_number: fields.FlightNumbers | None = fields.flight_number()


class LogExportRequest(Request):
    """Write a flight as files that FlightGear plays back: position, attitude, airspeed."""

    command: ClassVar[str] = "log export"
    examples: ClassVar[str] = f"""
  uqharness log export flight1.bin --aircraft espaaro --out shown
  uqharness log export loiter.csv --aircraft espaaro --lat-deg 37.2 --lon-deg -80.4 --out shown

Writes DIR/{PLAYBACK} and DIR/{PROTOCOL}. Copy the latter to Protocol/ of FlightGear's
data folder, then
  fgfs --fdm=null --generic=file,in,30,shown/{PLAYBACK},uqharness-playback"""

    log: FilePath = _log(fields.FLIGHT_FILE)
    aircraft: fields.AircraftSource = option(
        ...,
        "aircraft of the log: name under aircraft/, or a folder",
        metavar="AIRCRAFT",
        kind="str, Path or Aircraft",
        positional=True,
    )
    format: Literal["flightgear"] = option("flightgear", "program that shows it")
    out: FilePath = fields.out(positional=True)
    signal_map: fields.OptionalPath = fields.signal_map()
    flight_number: fields.Workers = fields.boot()
    lat_deg: Number | None = option(
        None,
        "latitude of the start point, deg (default: the log's)",
        ge=-90,
        le=90,
        metavar="DEG",
    )
    lon_deg: Number | None = option(
        None,
        "longitude of the start point, deg (default: the log's)",
        ge=-180,
        le=180,
        metavar="DEG",
    )
    alt_m: Number | None = option(
        None,
        "height of the start point above sea level, m (default: the log's, or 0)",
        metavar="H",
    )
    rate_hz: Number = option(30.0, "rows per second", gt=0, le=1000, metavar="R")
