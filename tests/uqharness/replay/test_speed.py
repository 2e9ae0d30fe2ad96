"""How finely replays step: where forces go with alphadot, which JSBSim takes from the run before,
and where a sensor is late.
"""

from dataclasses import replace

import numpy as np
import pytest

from sysid.effects.catalogue import coefficient_effect
from sysid.record import FlightRecord, Metadata
from tests.helpers.flown import _columns, _trim
from tests.helpers.sixdof import Airframe, simulate
from tests.hidden_effects.cases import cards
from tests.hidden_effects.effects import Effect
from tests.hidden_effects.flights import NOISE, Flight, fly_and_tell
from uqharness.identification.linearised import moved_later
from uqharness.refinement.write_xml import EffectToWrite, write_effects
from uqharness.replay import replay
from uqharness.replay.flights import prepare, segments
from uqharness.replay.model import ReplayFolder
from uqharness.replay.replay import CHANNELS, STATES, at_rows, fly_segment, late_rows, runs_per_row
from uqharness.simulator.aircraft import find_aircraft

SURFACES = ("elevator", "aileron", "rudder")
VALUE = -7.5


@pytest.fixture(scope="module")
def aircraft(tmp_path_factory):
    """E-SPAARO with a normal force due to the rate of alpha."""
    target = tmp_path_factory.mktemp("rates") / "espaaro"
    effect = coefficient_effect("CZ", "alphadot_hat")
    write_effects(
        find_aircraft("espaaro"), [EffectToWrite(effect, VALUE, "a remark", {})], {}, target
    )
    return find_aircraft(target)


@pytest.fixture(scope="module")
def record():
    """The same flown without JSBSim and without noise."""
    effect = Effect("CZ", "alphadot_hat", VALUE)
    card = replace(cards("steps", "mixed", 0.0, 0.0, 50.0, positions=True)[0], seconds=18.0)
    return fly_and_tell([Flight(card, Airframe(), (effect,))])[0].record


def worst(model, record):
    """Largest rms of replay minus flight over its pitch manoeuvres, by channel, in Table 2.1's
    noise.
    """
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


@pytest.mark.slow
def test_runs_are_short_enough_where_forces_go_with_the_rate_of_alpha(
    aircraft, record, monkeypatch
):
    assert [runs_per_row(dt, replay.SHORT_STEP_S) for dt in (0.005, 0.02, 0.04)] == [2, 8, 16]
    with ReplayFolder(aircraft, measured=SURFACES) as model:
        short = worst(model, record)
        monkeypatch.setattr(replay, "SHORT_STEP_S", 0.01)
        long = worst(model, record)
    assert max(short.values()) < 0.05, short
    for channel in ("q_radps", "az_mps2"):
        assert short[channel] < 0.7 * long[channel], (channel, short, long)


@pytest.fixture(scope="module")
def rolled():
    """A record of aileron steps without servos, of the independent equations, and its roll rate
    every millisecond.
    """
    x0, u0 = _trim(tuple(sorted(Airframe().coefficients.items())), 22.0, 100.0)
    u = np.repeat(np.asarray(u0)[None, :], 120, axis=0)
    u[20:45, 1], u[45:70, 1] = 14.0, -14.0
    x = simulate(Airframe(), x0, np.repeat(u, 20, axis=0), 0.001)[:-1]
    columns = _columns(x[::20], np.zeros((120, 3)), u, u, 0.02, 0.0)
    return FlightRecord(columns, Metadata(source="", dialect="simulation")), x[:, 3]


def replayed(model, record, **asked):
    (segment,) = segments(prepare("f", record, ()), ())
    segment = replace(
        segment, start=np.array([record[c][0] for c in STATES]), altitude_m=100.0, h_m=100.0
    )
    return fly_segment(model, segment, {}, **asked)[:, CHANNELS.index("p_radps")]


def test_runs_are_short_enough_where_a_surface_jumps(rolled, monkeypatch):
    record, p = rolled
    with ReplayFolder(find_aircraft("espaaro"), ideal=SURFACES) as model:
        assert np.abs(replayed(model, record) - p[::20]).max() < 0.5 * NOISE["p_radps"]
        monkeypatch.setattr(replay, "SHORT_STEP_S", 0.01)
        assert np.abs(replayed(model, record) - p[::20]).max() > 10.0 * NOISE["p_radps"]


def test_a_late_gyro_is_a_late_gyro_at_the_kinks_of_a_rate(rolled):
    record, p = rolled
    late, at = 0.0045 / 0.02, np.arange(len(p), dtype=float)
    seen = np.interp(at[::20] - 4.5, at, p)
    with ReplayFolder(find_aircraft("espaaro"), ideal=SURFACES) as model:
        between, rows = replayed(model, record, between=True), replayed(model, record)
    assert len(between) == 4 * (len(seen) - 1) + 1
    np.testing.assert_allclose(at_rows(between, len(seen)), rows, atol=0.5 * NOISE["p_radps"])
    assert np.abs(late_rows(between, len(seen), late) - seen).max() < 2.0 * NOISE["p_radps"]
    # A smooth curve through the rows rings at the steps, and one that is not moved is further off
    # than that.
    assert np.abs(moved_later(rows, late) - seen).max() > 8.0 * NOISE["p_radps"]
    assert np.abs(rows - seen).max() > 16.0 * NOISE["p_radps"]


def test_outputs_that_are_late_hold_the_ends():
    between = np.arange(9.0)
    assert at_rows(between, 5).tolist() == [0.0, 2.0, 4.0, 6.0, 8.0]
    assert late_rows(between, 5, 0.75).tolist() == [0.0, 0.5, 2.5, 4.5, 6.5]
    assert late_rows(between, 5, -0.75).tolist() == [1.5, 3.5, 5.5, 7.5, 8.0]
