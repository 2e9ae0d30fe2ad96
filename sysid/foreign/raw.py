"""RawLog: the content of a log as an importer returns it.

Messages keep the names, units and time stamps of the log. Signals, SI units, signs and a common
time grid are chosen later, by `sysid.logs.assemble`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.errors import Finding

ProgressCallback = Callable[[float], None]
"""Called with the share of the work that is done, 0 to 1."""


@dataclass(frozen=True)
class MessageTable:
    """All records of one message type and instance.

    Attributes
    ----------
    time_s : ndarray of shape (n,)
        Log time of each record, s, as logged. It may repeat or run backwards; `time_base.clean`
        selects the usable records.
    fields : mapping
        Name to array of shape (n,), in the units of the log, with the format's multipliers
        applied.
    place : ndarray of shape (n,) or None
        Position of each record in the file, in any unit that orders all records of the log; None
        if unknown.
    """

    time_s: NDArray[np.float64]
    fields: Mapping[str, NDArray[Any]]
    place: NDArray[np.integer[Any]] | None = None


@dataclass(frozen=True)
class RawLog:
    """Content of one log.

    Attributes
    ----------
    dialect : str
        As in the metadata of a FlightRecord.
    messages : mapping
        (message name, instance) to table; only the requested ones.
    counts : mapping
        Message name to number of records in the log, requested or not.
    parameters : mapping
        Vehicle parameters, last logged value.
    texts : tuple of (time_s, text)
        Messages to the pilot.
    vehicle : str
        Name of the vehicle in the log; "" if there is none.
    facts : mapping
        Further values for the checks, such as "mav_type".
    findings : tuple of Finding
        Damage that the importer met.
    headers : tuple of int
        Places at which a log header occurs again: several logs in one file.
    parameter_log : tuple of (place, name, value)
        Every logged parameter; with ``text_places`` it separates the boots of the autopilot. Empty
        if the dialect has no places.
    text_places : tuple of int
        Place of each of ``texts``.
    """

    dialect: str
    messages: Mapping[tuple[str, int], MessageTable]
    counts: Mapping[str, int] = field(default_factory=dict)
    parameters: Mapping[str, float] = field(default_factory=dict)
    texts: tuple[tuple[float, str], ...] = ()
    vehicle: str = ""
    facts: Mapping[str, float | str] = field(default_factory=dict)
    findings: tuple[Finding, ...] = ()
    headers: tuple[int, ...] = ()
    parameter_log: tuple[tuple[int, str, float], ...] = ()
    text_places: tuple[int, ...] = ()


@dataclass(frozen=True)
class TimeColumn:
    """The column of a table that holds its times, and their unit.

    The unit is one of s, ms, us, ns, min and h, or "iso" for times written as text.
    """

    field: str
    unit: str = "s"


FieldSelection = Mapping[str, frozenset[str]]
"""Message name to the fields that an importer returns."""
