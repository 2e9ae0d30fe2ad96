"""JSBSim takes alphadot from the run before: forces that go with it need shorter runs, or flights of nature contradict them."""

from dataclasses import replace

import numpy as np
import pytest

from sysid.effects import coefficient_effect
from tests.hidden_effects.cases import cards
from tests.hidden_effects.effects import Effect
from tests.hidden_effects.flights import NOISE, Flight, fly_and_tell
from tests.sixdof import Airframe
from uqharness.aircraft import find_aircraft
from uqharness.flights import prepare, segments
from uqharness.refine_xml import Written, write_effects
from uqharness.replay import CHANNELS, STATES, fly_segment, runs_per_row
from uqharness.replay_model import ReplayFolder

SURFACES = ("elevator", "aileron", "rudder")
VALUE = -7.5


@pytest.fixture(scope="module")
def aircraft(tmp_path_factory):
    """E-SPAARO with a normal force due to the rate of alpha."""
    target = tmp_path_factory.mktemp("rates") / "espaaro"
    effect = coefficient_effect("CZ", "alphadot_hat")
    write_effects(find_aircraft("espaaro"), [Written(effect, VALUE, "a remark", {})], {}, target)
    return find_aircraft(target)


@pytest.fixture(scope="module")
def record():
    """The same flown without JSBSim and without noise."""
    effect = Effect("CZ", "alphadot_hat", VALUE)
    card = cards("steps", "mixed", 0.0, 0.0, 50.0, positions=True)[0]
    return fly_and_tell([Flight(card, Airframe(), (effect,))])[0].record


def worst(model, record):
    """Largest rms of replay minus flight over its pitch manoeuvres, by channel, in Table 2.1's noise."""
    flight, found = prepare("f", record, SURFACES), dict.fromkeys(CHANNELS, 0.0)
    for segment in segments(flight, SURFACES):
        rows = record.between(segment.time_s[0] - 1e-6, segment.time_s[-1] + 1e-6)
        start = np.array([rows[c][0] for c in STATES])
        flown = fly_segment(model, replace(segment, start=start), {})
        for k, name in enumerate(CHANNELS):
            if name in ("alpha_rad", "q_radps", "az_mps2"):
                gap = float(np.sqrt(np.mean((flown[:, k] - rows[name]) ** 2)) / NOISE[name])
                found[name] = max(found[name], gap)
    return found


def test_runs_are_shorter_where_forces_go_with_the_rate_of_alpha(aircraft, record):
    with ReplayFolder(aircraft, measured=SURFACES) as model:
        assert model.by_rates
        short, long = worst(model, record), worst(replace(model, by_rates=False), record)
    assert [runs_per_row(dt, True) for dt in (0.005, 0.02, 0.04)] == [2, 8, 16]
    assert max(short.values()) < 0.2, short
    for channel in ("q_radps", "az_mps2"):
        assert short[channel] < 0.4 * long[channel], (channel, short, long)
