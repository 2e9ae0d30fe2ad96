"""Results about flight logs."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from uqharness.results.base import Ends, Number, Numbers, Part, Texts

_S = "of log time, s"


class Finding(Part):
    """A property of a log that the user must know."""

    code: str = Field(description="stable key, such as sample-and-hold")
    channel: str | None = Field(description="signal that it concerns; empty for the whole log")
    severity: Literal["info", "warning", "error"] = Field(
        description="know it, look at it, or do not use the channel for what it spoils"
    )
    message: str = Field(description="one sentence with the figures in it")
    numbers: Numbers = Field(description="the same figures by name")
    spoils: str = Field(default="", description="results that would be wrong; empty if none")
    mend: str = Field(default="", description="lines of a signal map that correct it")


class Boot(Part):
    """One boot of the autopilot in a log, on its own clock."""

    number: int = Field(description="counted from 1 in the order of the file")
    start_s: float = Field(description=f"beginning {_S}")
    end_s: float = Field(description=f"end {_S}")
    free_flight_s: Ends | None = Field(description="start and end of its free flight, s, or null")


class LoggedChannel(Part):
    """Where a channel comes from."""

    source: str = Field(description="field of the log")
    rate_hz: Number = Field(description="logged rate, Hz")


class LoggedManoeuvre(Part):
    """A manoeuvre that was found in the commands of free flight."""

    kind: Literal["doublet", "3-2-1-1", "pulse", "pulses"] = Field(description="shape")
    axis: Literal["pitch", "roll", "yaw", "throttle"] = Field(description="control")
    start_s: float = Field(description=f"beginning {_S}")
    end_s: float = Field(description=f"end {_S}")
    size: float = Field(description="largest deviation, with the sign of the first pulse")
    unit: Literal["deg", "%"] = Field(description="unit of the size")


class CommandedLoiter(Part):
    """A circle that the autopilot was commanded to fly; its centre from the start point."""

    start_s: float = Field(description=f"beginning {_S}")
    end_s: float = Field(description=f"end {_S}")
    north_m: float = Field(description="centre north of the start point, m")
    east_m: float = Field(description="centre east of the start point, m")
    radius_m: float = Field(description="radius, m")
    clockwise: bool = Field(description="sense, seen from above")
    source: str = Field(description="fields and parameters that it was read from")


class ServedPurpose(Part):
    """Whether a log serves a purpose."""

    serves: bool = Field(description="whether it does")
    reason: str = Field(description="why, or why not")


class LogContents(Part):
    """Contents and findings of a log (`uqharness log info`)."""

    source: str = Field(description="file name")
    dialect: str = Field(description="format of the log")
    vehicle: str | None = Field(description="vehicle that the log names")
    flights: list[Boot] = Field(default=[], description="boots of a log that holds several")
    flight_number: int = Field(default=1, description="boot that was read")
    duration_s: float = Field(description="length of the record, s")
    start_s: float = Field(description="first time of the record, s")
    free_flight_s: Ends | None = Field(description="start and end of free flight, s, or null")
    grid_hz: Number = Field(description="rate of the record, Hz")
    channels: dict[str, LoggedChannel] = Field(description="channels by name")
    findings: list[Finding] = Field(description="results of the checks")
    manoeuvres: list[LoggedManoeuvre] = Field(description="found in the commands of free flight")
    loiters: list[CommandedLoiter] = Field(description="commanded circles")
    purposes: dict[str, ServedPurpose] = Field(
        description="loiter-metrics, replay and identification"
    )
    serves: bool = Field(description="whether it serves a purpose; false: exit code 1")


class ProposedSignal(Part):
    """A recognised signal of a log."""

    source: str = Field(description="field of the log")
    scale: float = Field(description="factor to the signal's unit")
    evidence: Texts = Field(description="why it was recognised")
    unsure: Texts = Field(description="what a reader should check")


class ProposedMap(Part):
    """A proposed signal map (`uqharness log map`)."""

    out: str | None = Field(description="the map's file; null if none was written")
    signals: dict[str, ProposedSignal] = Field(description="recognised signals by name")
    absent: Texts = Field(
        description="signals of a complete record for which no field was recognised"
    )


class ImportedLog(Part):
    """A flight record made from a log (`uqharness log import`)."""

    out: str = Field(description="file of the record")
    rows: int = Field(description="rows written")
    grid_hz: Number = Field(description="rate, Hz; null for a record without a grid")
    kept_s: Ends = Field(description=f"beginning and end of the record {_S}")
    log_s: Ends = Field(description=f"beginning and end of the log {_S}")
    columns: Texts = Field(description="columns written")
    findings: list[Finding] = Field(description="results of the checks")


class Playback(Part):
    """Files that FlightGear plays back (`uqharness log export`)."""

    format: Literal["flightgear"] = Field(description="program that shows them")
    files: Texts = Field(description="rows of the flight, and the protocol that describes them")
    rows: int = Field(description="rows written")
    rate_hz: float = Field(description="rows per second")
    columns: Texts = Field(description="columns of the rows")
