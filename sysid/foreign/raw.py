"""RawLog: what an importer hands over, before any unit, sign or grid is chosen.

Pure data, no IO.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.errors import Finding

ProgressCallback = Callable[[float], None]  # called with the share done, 0..1


@dataclass(frozen=True)
class MessageTable:
    """All records of one message type and instance.

    time_s  (n,) log time of each record, s, as logged (it may repeat or run backwards:
    `time_base.clean` deals with it) fields  name -> (n,) array, in the log's own units with the
    format's own multipliers applied place   (n,) position of each record in the file, in any unit
    that orders all records of the log; None where it is not known"""

    time_s: NDArray[np.float64]
    fields: Mapping[str, NDArray[Any]]
    place: NDArray[np.integer[Any]] | None = None


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
    headers     places at which the header of a log stands again: several logs in one file
    parameter_log  (place, name, value) of every parameter logged, and `text_places` the place of
    each of `texts`, by which
                boots are told apart; empty where the dialect does not know them
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
    """The column of a table that holds its times, and its unit: s, ms, us, ns, min or h; "iso" for
    text.
    """

    field: str
    unit: str = "s"


FieldSelection = Mapping[str, frozenset[str]]  # message name -> field names to keep
