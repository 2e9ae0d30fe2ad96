"""A campaign's worker: takes a case, flies it, sends what is kept of it. Imports little, for it starts often."""

from __future__ import annotations

import faulthandler
import math
import signal
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from multiprocessing.connection import Connection

from uqharness.errors import BadInputError
from uqharness.flight import STATUSES, FlightResult, FlightSpec
from uqharness.parallel import end_with_parent

FlightFunction = Callable[[FlightSpec], FlightResult]


@dataclass(frozen=True)
class CaseOutcome:
    """What is kept of one flight: its result without the signals. ``bad_input``: refused as input, not flown."""

    case_id: str
    status: str
    reason: str
    flown_s: float
    metrics: Mapping[str, float] = field(default_factory=dict)
    undefined: Mapping[str, str] = field(default_factory=dict)
    bad_input: bool = False


def attempt(fly: FlightFunction, case_id: str, flight: FlightSpec) -> CaseOutcome:
    """Fly one case; whatever it raises becomes a crashed outcome with its reason."""
    try:
        result = fly(flight)
        if result.status not in STATUSES:
            raise ValueError(f"the flight function returned status '{result.status}', not one of {', '.join(STATUSES)}")
        return CaseOutcome(
            case_id,
            result.status,
            result.reason,
            float(result.flown_s),
            # Text carries one NaN, so that tables have the same bytes wherever a case was flown.
            {name: math.nan if math.isnan(value) else float(value) for name, value in result.metrics.items()},
            dict(result.undefined),
        )
    except BadInputError as error:
        return CaseOutcome(case_id, "crashed", _one_line(str(error)), 0.0, bad_input=True)
    except Exception as error:
        return CaseOutcome(case_id, "crashed", _one_line(f"{type(error).__name__}: {error}"), 0.0)


def _one_line(text: str) -> str:
    return " ".join(text.split())


def work(pipe: Connection, fly: FlightFunction) -> None:
    """A worker's life: take a case, fly it, send the outcome; end with the parent."""
    # Ctrl-C reaches the whole group; the parent decides what it means.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    end_with_parent()
    # Python's own crash report would be noise: the parent records the signal.
    if faulthandler.is_enabled():
        faulthandler.disable()
    try:
        pipe.send(None)
        while True:
            case_id, flight = pipe.recv()
            pipe.send(attempt(fly, case_id, flight))
    except (EOFError, OSError):
        return
