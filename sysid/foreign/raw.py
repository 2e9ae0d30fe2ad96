"""RawLog: what an importer hands over, before any unit, sign or grid is chosen. Pure data, no IO."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.errors import Finding

Progress = Callable[[float], None]  # called with the share done, 0..1


@dataclass(frozen=True)
class MessageTable:
    """All records of one message type and instance.

    time_s  (n,) log time of each record, s, as logged (it may repeat or run backwards: `time_base.clean` deals with it)
    fields  name -> (n,) array, in the log's own units with the format's own multipliers applied
    """

    time_s: NDArray[np.float64]
    fields: Mapping[str, NDArray[Any]]


@dataclass(frozen=True)
class RawLog:
    """Content of one log.

    dialect     as in FlightRecord's metadata
    messages    (message name, instance) -> table; only what was asked for
    counts      message name -> number of records in the whole log, asked for or not
    parameters  vehicle parameters, last value logged
    texts       (time_s, text) of the log's messages to the pilot
    vehicle     what the log calls itself, "" when it does not say
    facts       anything else the checks need (e.g. "mav_type")
    findings    damage met while reading
    """

    dialect: str
    messages: Mapping[tuple[str, int], MessageTable]
    counts: Mapping[str, int] = field(default_factory=dict)
    parameters: Mapping[str, float] = field(default_factory=dict)
    texts: tuple[tuple[float, str], ...] = ()
    vehicle: str = ""
    facts: Mapping[str, float | str] = field(default_factory=dict)
    findings: tuple[Finding, ...] = ()


@dataclass(frozen=True)
class TimeColumn:
    """The column of a table that holds its times, and its unit: s, ms, us, ns, min or h; "iso" for text."""

    field: str
    unit: str = "s"


Wanted = Mapping[str, frozenset[str]]  # message name -> field names to keep
