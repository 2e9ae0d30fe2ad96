"""One flight of one model, every frame of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from sysid.arrays import FloatArray
from uqharness.differences.channels import Channel
from uqharness.flight import FlightSpec, as_asked, record_mission
from uqharness.isolation import run_isolated
from uqharness.simulator import Aircraft, StagedMission, read_script


@dataclass(frozen=True)
class How:
    """A flight of at most ``most_s`` in steps of ``dt_s`` [s], its air and its seed.

    one_ulp_off: from a start that is one unit in the last place away; properties: set before the flight.
    """

    most_s: float
    dt_s: float
    turbulence: str = "none"
    seed: int = 1
    one_ulp_off: bool = False
    properties: Mapping[str, float] = field(default_factory=dict)


def flown(
    aircraft: Aircraft, path: Path, channels: Sequence[Channel], how: How
) -> dict[str, FloatArray]:
    """time_s and channels of a flight in a worker process, a row a frame. Raises BadInputError."""
    return run_isolated(_flown, aircraft, path, channels, how)


def _flown(
    aircraft: Aircraft, path: Path, channels: Sequence[Channel], how: How
) -> dict[str, FloatArray]:
    script = read_script(path)
    if how.dt_s != aircraft.dt_s:
        section = aircraft.card.aircraft.model_copy(update={"dt_s": how.dt_s})
        aircraft = replace(aircraft, card=aircraft.card.model_copy(update={"aircraft": section}))
    spec = FlightSpec(
        aircraft=aircraft.folder,
        script=path,
        duration_s=min(script.end_s, how.most_s),
        turbulence=how.turbulence,
        record_rate_hz=1.0 / aircraft.dt_s,
        properties=dict(how.properties),
    )
    with StagedMission(aircraft, path) as mission:
        optional = {c.name: c.source for c in channels}
        recorded = record_mission(
            mission,
            as_asked(spec, how.seed),
            {},
            optional,
            keep_burn_in=True,
            one_ulp_off=how.one_ulp_off,
        )
    return recorded.signals
