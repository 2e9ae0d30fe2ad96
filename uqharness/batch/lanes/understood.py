"""Whether the batch engine can fly a mission here, and if not, why."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

from uqharness.batch.lanes.fly import ready
from uqharness.errors import BadInputError
from uqharness.flight import FlightSpec


def refusals(spec: FlightSpec, varying: Collection[str] = ()) -> tuple[str, ...]:
    """Sentences, with file and line, on what is not understood of a flight's aircraft and mission; empty: it can be flown.

    varying: properties that differ between flights, beside those that ``spec`` sets.
    """
    properties = {**dict.fromkeys(varying, 0.0), **spec.properties}
    try:
        ready(replace(spec, properties=properties))
    except BadInputError as error:
        return tuple(str(error).splitlines())
    return ()
