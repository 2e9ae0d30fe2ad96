"""One flight of one model, every frame of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from uqharness.differences.channels import Channel
from uqharness.flight import FlightSpec, as_asked, record_mission
from uqharness.simulator import Aircraft, StagedMission, read_script

Array = NDArray[np.float64]


def flown(
    aircraft: Aircraft, path: Path, channels: Sequence[Channel], most_s: float, dt_s: float, turbulence: str, seed: int,
    one_ulp_off: bool = False,
) -> dict[str, Array]:  # fmt: skip
    """time_s and channels of a flight of at most ``most_s`` in steps of ``dt_s`` [s], a row a frame."""
    script = read_script(path)
    if dt_s != aircraft.dt_s:
        section = aircraft.card.aircraft.model_copy(update={"dt_s": dt_s})
        aircraft = replace(aircraft, card=aircraft.card.model_copy(update={"aircraft": section}))
    spec = FlightSpec(
        aircraft=aircraft.folder, script=path, duration_s=min(script.end_s, most_s), turbulence=turbulence,
        record_rate_hz=1.0 / aircraft.dt_s,
    )  # fmt: skip
    with StagedMission(aircraft, path) as mission:
        optional = {c.name: c.source for c in channels}
        recorded = record_mission(mission, as_asked(spec, seed), {}, optional, keep_burn_in=True, one_ulp_off=one_ulp_off)
    return recorded.signals
