"""Heights of the ground in replays."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from sysid.effects.catalogue import subsystem_effects
from tests.helpers.flown import fly
from uqharness.refinement.write_xml import EffectToWrite, write_effects
from uqharness.replay.flights import prepare, segments
from uqharness.replay.force import force_states
from uqharness.replay.model import CONTROLS, ReplayFolder, altitudes, heights
from uqharness.replay.replay import CHANNELS, fly_segment
from uqharness.simulator.aircraft import find_aircraft

LIFT, SPAN_M, DT_S = 0.2, 3.66, 0.02


@pytest.fixture(scope="module")
def record():
    return fly((("pitch-3211", 22.0),), seed=None)


@pytest.fixture(scope="module")
def close_model(tmp_path_factory):
    """E-SPAARO with lift from the ground."""
    target = tmp_path_factory.mktemp("near") / "espaaro"
    effect = {e.key: e for e in subsystem_effects([], [], [])}["effect/ground/lift"]
    write_effects(find_aircraft("espaaro"), [EffectToWrite(effect, LIFT, "", {})], {}, target)
    return find_aircraft(target)


def lift(aircraft, record, height_m, above_ground):
    """First az of a replay that begins at a height, and CZ of the model forced there."""
    segment = segments(prepare("f", record, ()), ())[0]
    segment = replace(segment, h_m=height_m, above_ground=above_ground)
    with ReplayFolder(aircraft) as model, ReplayFolder(aircraft, ideal=CONTROLS) as level:
        az = fly_segment(model, segment, {})[0, CHANNELS.index("az_mps2")]
        states = {
            name: np.full(2, v)
            for name, v in zip(
                (
                    "V_mps",
                    "alpha_rad",
                    "beta_rad",
                    "phi_rad",
                    "theta_rad",
                    "psi_rad",
                    "p_radps",
                    "q_radps",
                    "r_radps",
                ),
                segment.start,
                strict=True,
            )
        }
        heights = altitudes(level, segment, np.array([height_m, height_m + 2.0 * SPAN_M]))
        forced = force_states(
            level, segment, states, np.repeat(segment.controls[:1], 2, axis=0), {}, heights
        )
    return float(az), forced.coefficients[:, 2]


def test_the_ground_is_where_the_record_says(close_model, record):
    plain, coefficient = lift(find_aircraft("espaaro"), record, 2.0, True)
    distant, at_height = lift(close_model, record, 2.0, False)
    low, rising = lift(close_model, record, 2.0, True)
    share = LIFT * math.exp(-2.0 * 2.0 / SPAN_M)
    assert distant == pytest.approx(plain, rel=1e-6)
    assert low / plain == pytest.approx(1.0 + share, rel=0.02)
    np.testing.assert_allclose(at_height, coefficient, rtol=1e-9)
    expected = [1.0 + LIFT * math.exp(-2.0 * h / SPAN_M) for h in (2.0, 2.0 + 2.0 * SPAN_M)]
    # The force that is multiplied is that of the frame before, and before the first there was none
    # with the effect.
    np.testing.assert_allclose(rising / coefficient, expected, rtol=share**2)


def climbing(
    seconds: float, wrong_pitch_rad: float = 0.0, seed: int = 0
) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Channels of a banked flight 4 m up that pitches up and down, its heights 1.5 m off (rms), and
    the true heights.
    """
    n = round(seconds / DT_S)
    t = DT_S * np.arange(n)
    channels = {
        "V_mps": np.full(n, 21.0),
        "alpha_rad": 0.04 + 0.03 * np.sin(2.0 * t),
        "beta_rad": np.full(n, 0.02),
        "phi_rad": 0.3 * np.sin(0.5 * t),
        "theta_rad": 0.05 + 0.1 * np.sin(1.3 * t),
    }
    V, a, b, phi, theta = channels.values()
    air = np.stack([V * np.cos(a) * np.cos(b), V * np.sin(b), V * np.sin(a) * np.cos(b)])
    up = np.stack([np.sin(theta), -np.sin(phi) * np.cos(theta), -np.cos(phi) * np.cos(theta)])
    climb = np.sum(air * up, axis=0)
    true = 4.0 + DT_S * np.concatenate([[0.0], np.cumsum(0.5 * (climb[1:] + climb[:-1]))])
    noise = 1.5 * np.random.default_rng(seed).normal(size=n)
    return {**channels, "theta_rad": theta + wrong_pitch_rad, "h_m": true + noise}, true


@pytest.mark.parametrize(("wrong_pitch_rad", "most_m"), [(0.0, 0.2), (0.03, 0.2)])
def test_noise_of_heights_is_averaged_over_seconds_and_a_wrong_pitch_does_not_drift(
    wrong_pitch_rad: float, most_m: float
) -> None:
    every = [climbing(8.0, wrong_pitch_rad, seed) for seed in range(20)]
    result = [heights(channels, DT_S) - true for channels, true in every]
    assert np.sqrt(np.mean(np.square(result))) < most_m
    # At the first row; taken for level over two seconds, what climbs is higher there.
    assert np.std([f[0] for f in result]) < 0.35
    assert abs(np.mean([f[0] for f in result])) < 0.15
    assert np.mean([np.median(channels["h_m"][:100]) - true[0] for channels, true in every]) > 0.8
