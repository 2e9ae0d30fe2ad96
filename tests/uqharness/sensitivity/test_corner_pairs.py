"""Areas between corners of functions whose ranges are known, and samples that leave the corners'
envelope.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from uqharness.sensitivity.measures import corner_pairs
from uqharness.sensitivity.study import run_study

BOX = {"a": (0.0, 2.0), "b": (-1.0, 1.0)}


def paired(model, draws=16, aleatory=True, **more):
    air = {"w": stats.norm(0.0, 1.0)} if aleatory else None
    made = run_study(model, BOX, air, samples=16, draws=draws, methods=("proposed",))
    return corner_pairs(made, made.outputs["output"], **more)


def test_a_sums_shares_are_the_same_at_every_corner():
    found = paired(lambda a, b, w: 3.0 * a + b + w)
    a, b = found.indices["a"], found.indices["b"]
    assert (a.minimum.value, a.maximum.value) == pytest.approx((0.75, 0.75))
    assert (b.minimum.value, b.maximum.value) == pytest.approx((0.25, 0.25))
    assert found.details["area"] == pytest.approx(8.0)
    assert found.details["shrink_min"] == pytest.approx([0.75, 0.25])
    assert found.holds
    assert found.details["lead"][0, 1] > 0.0 > found.details["lead"][1, 0]
    assert found.runs == 4 * 16


def test_an_interaction_makes_a_range():
    """y = a (b + 2): corners 0, 0, 2, 6."""
    found = paired(lambda a, b: a * (b + 2.0), draws=1, aleatory=False)
    assert sorted(found.indices["a"].pairs) == pytest.approx([2.0 / 6.0, 1.0])
    assert sorted(found.indices["b"].pairs) == pytest.approx([0.0, 4.0 / 6.0])
    assert (found.details["shrink_min"][0], found.details["shrink_max"][0]) == pytest.approx(
        (2.0 / 6.0, 1.0)
    )
    # One column without chance is exact.
    assert found.indices["a"].minimum.low == pytest.approx(2.0 / 6.0)


def test_what_lies_between_the_corners_is_looked_at():
    found = paired(lambda a, b, w: 3.0 * a + 6.0 * (1.0 - b**2) + w)
    assert found.holds is False
    assert "these ranges are too small" in found.statement
    hidden = paired(lambda a, b, w: 1.0 - b**2 + w)
    assert np.isnan(hidden.indices["b"].minimum.value)
    assert "not monotone and the corners do not show it" in hidden.statement


def test_few_draws_and_no_wish_give_no_interval():
    few = paired(lambda a, b, w: 3.0 * a + b + w, draws=4)
    assert np.isnan(few.indices["a"].minimum.low)
    assert "at least 8 are needed" in few.indices["a"].minimum.reason
    assert few.indices["a"].minimum.value == pytest.approx(0.75)
    unasked = paired(lambda a, b, w: 3.0 * a + b + w, intervals=False)
    assert np.isnan(unasked.indices["a"].minimum.low)
    assert unasked.indices["a"].minimum.reason == ""
