"""Which manoeuvres to fly: against every set that could be flown, and a budget of seconds."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from sysid.model_form.information_gain import Offer, choose, information, with_more_data
from tests.helpers.model_forms import bounds_from

STATE = "alpha_rad"


def test_the_choice_is_the_best_set_where_all_sets_can_be_tried():
    rng = np.random.default_rng(5)
    x = rng.normal(0.0, 0.5, 80)
    now = bounds_from(x, rng.standard_normal(80), order=2)
    mission = {STATE: rng.normal(2.0, 0.2, 300)}
    places = (-2.0, 0.0, 1.0, 2.0, 3.0)
    offers = [
        Offer(str(p), 10.0, information(now, {STATE: p + 0.1 * rng.standard_normal(50)}))
        for p in places
    ]
    chosen = choose(now, offers, mission, 30.0, 0.0)
    assert [c.seconds for c in chosen] == [10.0, 10.0, 10.0]
    halves = {
        s: float(
            np.mean(
                with_more_data(now, [offers[k].information for k in s]).interval(mission)[1]
                - with_more_data(now, [offers[k].information for k in s]).interval(mission)[0]
            )
        )
        / 2.0
        for s in itertools.combinations_with_replacement(range(5), 3)
    }
    got = halves[tuple(sorted(c.index for c in chosen))]
    assert chosen[-1].half_width == pytest.approx(got, rel=1e-9)
    assert got <= 1.01 * min(halves.values())
    assert got < 0.9 * halves[(1, 1, 1)]


def test_the_choice_minds_seconds_and_transitions():
    rng = np.random.default_rng(6)
    now = bounds_from(rng.normal(0.0, 0.5, 80), rng.standard_normal(80))
    mission = {STATE: np.full(20, 2.0)}
    told = information(now, {STATE: np.full(50, 2.0)})
    slow, quick = Offer("a", 30.0, told), Offer("b", 10.0, told)
    assert {c.index for c in choose(now, [slow, quick], mission, 60.0, 5.0)} == {1}
    first, *others = choose(now, [slow, quick], mission, 60.0, 5.0)
    assert (first.seconds, [c.seconds for c in others]) == (15.0, [10.0] * 4)
    assert choose(now, [slow, quick], mission, 12.0, 5.0) == []


def test_what_narrows_nothing_is_not_flown():
    rng = np.random.default_rng(7)
    now = bounds_from(rng.normal(0.0, 0.5, 80), rng.standard_normal(80))
    nothing = information(now, {STATE: np.full(50, 2.0)}, 0.0)
    told = information(now, {STATE: np.full(50, 2.0)})
    mission = {STATE: np.full(20, 2.0)}
    assert choose(now, [Offer("a", 10.0, nothing)], mission, 60.0, 0.0) == []
    assert {
        c.index
        for c in choose(
            now, [Offer("a", 10.0, nothing), Offer("b", 10.0, told)], mission, 60.0, 0.0
        )
    } == {1}
    assert choose(now, [], mission, 60.0, 0.0) == []
