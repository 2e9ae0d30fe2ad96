"""Sensors of several channels: all of them late together, or one alone."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from sysid.effects.catalogue import subsystem_effects
from uqharness.identification.linearised.flight_data import ModelState
from uqharness.identification.linearised.linearise import (
    at_sensor_position,
    sensor_delay_s,
    vane_shift,
)
from uqharness.refinement.candidates import candidate_effects
from uqharness.replay import Segment

RATES = ("p_radps", "q_radps", "r_radps")


@pytest.mark.parametrize(
    ("late", "expected"),
    [
        ({"rates": 0.02}, (0.02, 0.02, 0.02)),
        ({"p_radps": 0.01}, (0.01, 0.0, 0.0)),
        ({"rates": 0.02, "q_radps": -0.005}, (0.02, 0.015, 0.02)),
        ({"alpha_rad": 0.03}, (0.0, 0.0, 0.0)),
    ],
)
def test_a_channel_is_late_with_its_sensor_and_by_itself(late, expected):
    point = ModelState(
        {}, {}, (), {f"effect/sensor.{name}/delay": value for name, value in late.items()}
    )
    segment = SimpleNamespace(flight="one", dt_s=0.02)
    assert tuple(sensor_delay_s(c, segment, point) for c in RATES) == pytest.approx(expected)


def test_one_sensor_alone_is_counted_once():
    point = ModelState(
        {}, {"delay/one/alpha_rad": 0.01}, (), {"effect/sensor.alpha_rad/delay": 0.03}
    )
    assert sensor_delay_s("alpha_rad", SimpleNamespace(flight="one"), point) == pytest.approx(0.04)


def test_candidates_hold_each_channel_of_a_sensor_but_none_where_logs_estimate_delays():
    outputs = ("alpha_rad", *RATES)
    keys = {
        e.key
        for e in candidate_effects(
            SimpleNamespace(servos={}, outputs=outputs, delayed_sensors={}), (), ()
        )
    }
    assert {f"effect/sensor.{s}/delay" for s in ("alpha_rad", "rates", *RATES)} <= keys
    logged = candidate_effects(
        SimpleNamespace(servos={}, outputs=outputs, delayed_sensors={"one": ["alpha_rad"]}), (), ()
    )
    assert not [
        e for e in logged if e.key.endswith("/delay") and (e.subsystem or "").startswith("sensor.")
    ]


def test_a_channel_alone_must_explain_more_than_its_sensor():
    penalty = {e.key: e.penalty for e in subsystem_effects([], [], ["rates"], ["p_radps"])}
    assert penalty["effect/sensor.p_radps/delay"] > penalty["effect/sensor.rates/delay"]


def test_vanes_ahead_of_the_centre_of_gravity_see_its_velocity_and_the_rotation():
    """Against the velocity of the vanes' own place, v + w x r, in angles."""
    outputs = ("V_mps", "alpha_rad", "beta_rad", "q_radps", "r_radps", "ax_mps2")
    V, alpha, beta, q, r, x = 20.0, 0.05, 0.02, 0.4, -0.3, 0.2
    u, v, w = V * np.cos(alpha) * np.cos(beta), V * np.sin(beta), V * np.sin(alpha) * np.cos(beta)
    present = np.array([u, v, w]) + np.cross([0.0, q, r], [x, 0.0, 0.0])
    observed = (
        np.arctan2(present[2], present[0]) - alpha,
        np.arcsin(present[1] / np.linalg.norm(present)) - beta,
    )
    y = np.array([[V, alpha, beta, q, r, 9.0]])
    change = x * vane_shift(y, outputs)[0]
    assert change[[1, 2]] == pytest.approx(observed, rel=0.02)
    assert not change[[0, 3, 4, 5]].any()
    assert vane_shift(-y, outputs)[0, 1] * vane_shift(y, outputs)[0, 1] < 0.0
    assert not vane_shift(y[:, 1:], outputs[1:]).any()  # without airspeed nothing is known of it


def test_accelerometers_are_where_a_point_says():
    segment = Segment(
        "a", "one", np.arange(3.0), np.zeros((3, 4)), np.zeros(9), 0.0, 0.0, arm_m=(0.1, 0.0, 0.0)
    )
    assert at_sensor_position(segment, ModelState({}, {}, ())) is segment
    moved = ModelState(
        {},
        {},
        (),
        {"effect/sensor.accelerometer/place_x": 0.2, "effect/sensor.accelerometer/place_z": -0.05},
    )
    assert at_sensor_position(segment, moved).arm_m == pytest.approx((0.3, 0.0, -0.05))
