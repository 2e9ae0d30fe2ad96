"""Where actuators stand at a segment's first row: against a first-order lag's solution, and in
replays of independent flights.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from tests.helpers.sixdof import Airframe
from tests.hidden_effects.cases import cards
from tests.hidden_effects.flights import Flight
from tests.hidden_effects.flights import fly as fly_hidden
from uqharness.replay.flights import prepare, segments
from uqharness.replay.model import CONTROLS, ReplayFolder, ReplayModel
from uqharness.replay.positions import surface_positions
from uqharness.replay.replay import CHANNELS, fly_segment, initial_actuator_positions
from uqharness.replay.segments import Segment
from uqharness.simulator.aircraft import find_aircraft

DT_S = 0.02
LIMITS = np.array([[-25.0, 25.0], [-25.0, 25.0], [-25.0, 25.0], [0.0, 100.0]])
STEPS = (100, 3)
"""Rows before a segment, and those of them behind a step of the command."""


@pytest.fixture(scope="module")
def model():
    with ReplayFolder(find_aircraft("espaaro")) as made:
        yield made


def piece(step_deg: float = 2.0, throttle_pct: float = 4.0) -> Segment:
    """Commands that stepped three rows before the first one and stay."""
    count, behind = STEPS
    begin, step = (
        np.array([1.0, -2.0, 0.5, 50.0]),
        np.array([step_deg, -step_deg, step_deg, throttle_pct]),
    )
    before = begin + step * (np.arange(count)[:, None] >= count - behind)
    start = np.array([22.2, 0.015, 0.01, 0.1, 0.05, 1.0, 0.05, -0.02, 0.03])
    time_s = DT_S * np.arange(60)
    return Segment(
        "m", "f", time_s, np.tile(begin + step, (60, 1)), start, 130.0, 100.0, before=before
    )


def test_a_lag_has_gone_as_far_as_its_time_constant_says(model: ReplayModel) -> None:
    made, held_s = piece(), STEPS[1] * DT_S
    lags = {"elevator": 25.0, "aileron": 25.0, "rudder": 25.0, "throttle": 6.0}
    assert {c: float(lag) for c, (lag, _) in model.lags.items()} == lags
    short = [math.exp(-held_s * lags[c]) for c in model.controls]
    step = made.before[-1] - made.before[0]
    assert made.before[-1] - initial_actuator_positions(model, made, {}, LIMITS) == pytest.approx(
        step * short, abs=0.01 * np.abs(step).max()
    )


def test_a_rate_limit_holds_it_back(model: ReplayModel) -> None:
    given = {c: (lag, "10.0") for c, (lag, _) in model.lags.items()}
    stood = initial_actuator_positions(
        replace(model, lags=given, identity="slow"), piece(20.0), {}, LIMITS
    )
    assert stood[0] - 1.0 == pytest.approx(10.0 * STEPS[1] * DT_S, abs=0.05)
    assert stood[1] + 2.0 == pytest.approx(-10.0 * STEPS[1] * DT_S, abs=0.05)


def test_a_lag_that_is_a_property_counts_as_it_is_in_force(model: ReplayModel) -> None:
    named = replace(model, lags={"elevator": ("my/lag", "")}, servos=(), identity="named")
    slow, fast = (
        initial_actuator_positions(named, piece(), {"my/lag": value}, LIMITS)
        for value in (2.0, 200.0)
    )
    assert slow[0] < 1.4 < 2.99 < fast[0]
    assert np.isnan(slow[1:]).all()
    assert np.isnan(initial_actuator_positions(named, piece(), {}, LIMITS)).all()


def test_without_commands_before_nothing_is_said(model: ReplayModel) -> None:
    assert np.isnan(
        initial_actuator_positions(model, replace(piece(), before=None), {}, LIMITS)
    ).all()
    lost = piece()
    lost.before[-2, 0] = np.nan
    assert np.isnan(initial_actuator_positions(model, lost, {}, LIMITS)[0])
    assert np.isfinite(initial_actuator_positions(model, lost, {}, LIMITS)[1:]).all()


def test_positions_begin_where_the_actuators_stand(model: ReplayModel) -> None:
    made = piece()
    stood = initial_actuator_positions(model, made, {}, LIMITS)
    (moved,), (still,) = (
        surface_positions(model, [s], CONTROLS) for s in (made, replace(made, before=None))
    )
    assert moved[0] == pytest.approx(stood, abs=1e-6)
    assert still[0] == pytest.approx(made.controls[0], abs=1e-6)
    assert moved[-1] == pytest.approx(made.controls[-1], abs=5e-3)


def test_the_beginnings_of_replays_are_those_of_independent_flights(model: ReplayModel) -> None:
    """A motor of 1/6 s and a throttle that moves: without what came before, ax at the first rows is
    off by a part of its noise.
    """
    card = replace(cards("begun", "mixed", 0.0, 1.0, 50.0)[0], noise=1e-4)
    flight = prepare("f", fly_hidden([Flight(card, Airframe())])[0], ())
    k, noise = CHANNELS.index("ax_mps2"), 0.16
    known, forgotten = [], []
    for segment, part in zip(segments(flight, ()), flight.pieces, strict=True):
        seen = flight.record["ax_mps2"][part.rows][:10]
        for left, own in ((known, segment), (forgotten, replace(segment, before=None))):
            left.append(np.abs(fly_segment(model, own, {})[:10, k] - seen).max() / noise)
    assert max(known) < 0.02
    assert max(forgotten) > 0.1
