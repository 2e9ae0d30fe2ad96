"""A flight of one model: a row a frame, at the step that is asked for."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from uqharness.differences.elsewhere import FlightSettings, channels_of, fly_frames
from uqharness.simulator import find_aircraft, open_aircraft

LOITER = Path("scripts/loiter.xml").resolve()


def test_an_ulp_moves_it_and_a_seed_of_the_air_does():
    aircraft = find_aircraft("espaaro")
    channels = channels_of(aircraft, open_aircraft(aircraft))
    options = FlightSettings(max_s=1.0, dt_s=0.01)
    changed = (
        options,
        options,
        replace(options, one_ulp_off=True),
        replace(options, turbulence="light"),
    )
    calm, repeat, close, gusty = (fly_frames(aircraft, LOITER, channels, each) for each in changed)
    assert all(np.array_equal(calm[k], repeat[k]) for k in calm)
    assert 0.0 < np.max(np.abs(calm["V"] - close["V"])) < 1e-9
    assert np.max(np.abs(calm["V"] - gusty["V"])) > 1e-6
