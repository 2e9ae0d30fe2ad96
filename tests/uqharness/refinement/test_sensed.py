"""Sensors of several channels: all of them late together, or one alone."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from sysid.effects.subsystem_effects import subsystem_effects
from uqharness.refinement.sensed import sensor_late_s
from uqharness.refinement.setup import candidates_for
from uqharness.refinement.types import Point

RATES = ("p_radps", "q_radps", "r_radps")


@pytest.mark.parametrize(
    ("late", "expected"),
    [
        ({"rates": 0.02}, (0.02, 0.02, 0.02)), ({"p_radps": 0.01}, (0.01, 0.0, 0.0)),
        ({"rates": 0.02, "q_radps": -0.005}, (0.02, 0.015, 0.02)), ({"alpha_rad": 0.03}, (0.0, 0.0, 0.0)),
    ],
)  # fmt: skip
def test_a_channel_is_late_with_its_sensor_and_by_itself(late, expected):
    point = Point({}, {}, (), {f"effect/sensor.{name}/delay": value for name, value in late.items()})
    segment = SimpleNamespace(flight="one", dt_s=0.02)
    assert tuple(sensor_late_s(c, segment, point) for c in RATES) == pytest.approx(expected)


def test_one_sensor_alone_is_counted_once():
    point = Point({}, {"delay/one/alpha_rad": 0.01}, (), {"effect/sensor.alpha_rad/delay": 0.03})
    assert sensor_late_s("alpha_rad", SimpleNamespace(flight="one"), point) == pytest.approx(0.04)


def test_candidates_hold_each_channel_of_a_sensor_but_none_where_logs_estimate_delays():
    outputs = ("alpha_rad", *RATES)
    keys = {e.key for e in candidates_for(SimpleNamespace(servos={}, outputs=outputs, late={}), (), ())}
    assert {f"effect/sensor.{s}/delay" for s in ("alpha_rad", "rates", *RATES)} <= keys
    logged = candidates_for(SimpleNamespace(servos={}, outputs=outputs, late={"one": ["alpha_rad"]}), (), ())
    assert not [e for e in logged if e.key.endswith("/delay") and (e.subsystem or "").startswith("sensor.")]


def test_a_channel_alone_must_explain_more_than_its_sensor():
    odds = {e.key: e.odds for e in subsystem_effects([], [], ["rates"], ["p_radps"])}
    assert odds["effect/sensor.p_radps/delay"] > odds["effect/sensor.rates/delay"]
