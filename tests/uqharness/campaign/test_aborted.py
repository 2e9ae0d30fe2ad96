"""Aborted flights of a made-up case table."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from tests.helpers import campaign_fakes as fakes
from uqharness.campaign import CaseOutcome
from uqharness.campaign.cases import build_cases
from uqharness.campaign.rounds import KINDS, aborted_flight, count_aborted
from uqharness.campaign.run import find_mission

pytestmark = pytest.mark.usefixtures("flights_here")


def corner(*flights):
    """(status, share flown, loss of control) of each flight."""
    return pd.DataFrame(
        [{"status": s, "duration_s": 3600.0 * d, "loss_of_control": c} for s, d, c in flights]
    )


def test_each_aborted_flight_is_of_one_kind():
    first = corner(("ok", 1.0, 0), ("ok", 1.0, 1), ("diverged", 0.25, 1))
    second = corner(("ground-contact", 0.5, None), ("timeout", 0.0, None))
    found = count_aborted([first, second], 3600.0)
    assert found.kinds == dict.fromkeys(KINDS, 1)
    assert found.total == 4
    np.testing.assert_array_equal(found.is_aborted, [[0.0, 1.0, 1.0], [1.0, 1.0, np.nan]])
    np.testing.assert_allclose(found.missing_shares, [0.75, 1.5])


def test_a_flight_that_lost_control_and_flew_on_misses_nothing():
    assert count_aborted([corner(("ok", 1.0, 1))], 3600.0).missing_shares.tolist() == [0.0]


def test_limits_are_per_hour_flown():
    """Half of the flights end half way: 0.5 aborted flights in 0.75 flights' time."""
    half = corner(*[("diverged", 0.5, 1), ("ok", 1.0, 0)] * 200)
    kept_on = corner(*[("ok", 1.0, 1), ("ok", 1.0, 0)] * 200)
    (ended,), (flew_on,) = (
        count_aborted([group], 3600.0).upper(0.025, None) for group in (half, kept_on)
    )
    assert ended > 0.5 / 0.75
    assert 0.5 < flew_on < ended


def test_nothing_flown_bounds_nothing():
    assert count_aborted([corner(*[("diverged", 0.0, 1)] * 50)], 3600.0).upper(
        0.025, None
    ).tolist() == [np.inf]


@pytest.mark.parametrize(
    ("status", "flown_s", "lost", "expected"),
    [
        ("ok", 210.0, 0.0, (0.0, 0.0)),
        ("ok", 210.0, 1.0, (1.0, 0.0)),
        ("diverged", 135.0, 1.0, (1.0, 0.5)),
        ("crashed", 0.0, 0.0, (1.0, 1.0)),
    ],
)
def test_a_flight_by_itself(tmp_path, status, flown_s, lost, expected):
    spec = fakes.small_spec(tmp_path, flights=1)
    case = build_cases(spec, find_mission(spec))[0]
    outcome = CaseOutcome(case.case_id, status, "", flown_s, {"loss_of_control": lost})
    assert aborted_flight(
        outcome, replace(case.flight, burn_in_s=60.0, duration_s=150.0)
    ) == pytest.approx(expected)
