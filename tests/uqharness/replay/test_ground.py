"""The ground in replays: recorded heights where the aerodynamics ask for them, none where a record does not say."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from sysid.effects.subsystem_effects import subsystem_effects
from tests.helpers.flown import fly
from uqharness.refinement.writing.effects import Written, write_effects
from uqharness.replay.flights import prepare, segments
from uqharness.replay.force import force_states
from uqharness.replay.ground import altitudes, height_known
from uqharness.replay.model import CONTROLS, ReplayFolder
from uqharness.replay.replay import CHANNELS, fly_segment
from uqharness.simulator.aircraft import find_aircraft

LIFT, SPAN_M = 0.2, 3.66


@pytest.fixture(scope="module")
def record():
    return fly((("pitch-3211", 22.0),), seed=None)


@pytest.fixture(scope="module")
def near(tmp_path_factory):
    """E-SPAARO with lift from the ground."""
    target = tmp_path_factory.mktemp("near") / "espaaro"
    effect = {e.key: e for e in subsystem_effects([], [], [])}["effect/ground/lift"]
    write_effects(find_aircraft("espaaro"), [Written(effect, LIFT, "", {})], {}, target)
    return find_aircraft(target)


def lift(aircraft, record, height_m, above_ground):
    """First az of a replay that begins at a height, and CZ of the model forced there."""
    segment = segments(prepare("f", record, ()), ())[0]
    segment = replace(segment, h_m=height_m, above_ground=above_ground)
    with ReplayFolder(aircraft) as model, ReplayFolder(aircraft, ideal=CONTROLS) as straight:
        az = fly_segment(model, segment, {})[0, CHANNELS.index("az_mps2")]
        states = {name: np.full(2, v) for name, v in zip(
            ("V_mps", "alpha_rad", "beta_rad", "phi_rad", "theta_rad", "psi_rad", "p_radps", "q_radps", "r_radps"), segment.start,
            strict=True)}  # fmt: skip
        heights = altitudes(straight, segment, np.array([height_m, height_m + 2.0 * SPAN_M]))
        forced = force_states(straight, segment, states, np.repeat(segment.controls[:1], 2, axis=0), {}, heights)
    return float(az), forced.coefficients[:, 2]


def test_the_ground_is_where_the_record_says(near, record):
    plain, coefficient = lift(find_aircraft("espaaro"), record, 2.0, True)
    far, at_height = lift(near, record, 2.0, False)
    low, rising = lift(near, record, 2.0, True)
    share = LIFT * math.exp(-2.0 * 2.0 / SPAN_M)
    assert far == pytest.approx(plain, rel=1e-6)
    assert low / plain == pytest.approx(1.0 + share, rel=0.02)
    np.testing.assert_allclose(at_height, coefficient, rtol=1e-9)
    expected = [1.0 + LIFT * math.exp(-2.0 * h / SPAN_M) for h in (2.0, 2.0 + 2.0 * SPAN_M)]
    # The force that is multiplied is that of the frame before, and before the first there was none with the effect.
    np.testing.assert_allclose(rising / coefficient, expected, rtol=share**2)


def test_a_record_that_starts_in_the_air_at_its_own_zero_does_not_say(record):
    time = record["time_s"]
    climbing = 0.3 * (time - time[0])
    assert not height_known(record.with_columns({"h_m": climbing}))
    assert height_known(record.with_columns({"h_m": climbing + 3.0}))
    on_the_ground = record.with_columns({"h_m": climbing, "V_mps": np.where(time < time[0] + 1.0, 0.0, 20.0)})
    assert height_known(on_the_ground)
    assert not height_known(record.with_columns({"h_m": climbing - 100.0}))
    assert not height_known(record.with_columns({"h_m": np.full(len(time), np.nan)}))
