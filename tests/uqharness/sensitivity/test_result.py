"""Results of methods: plain JSON, reasons, ranking, words, means over repeats."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from uqharness.errors import BadInputError
from uqharness.sensitivity.analysis import Sensitivity, average
from uqharness.sensitivity.measures import (
    Index,
    MethodResult,
    PairRange,
    Ranking,
    rank,
    undefined,
    words,
)


def result(ranges, lead, shrink_low=0.4) -> MethodResult:
    indices = {n: PairRange(Index(a, a, a), Index(b, b, b)) for n, (a, b) in ranges.items()}
    d = len(ranges)
    ends = {"shrink_min": 0.5, "shrink_max": 0.6, "shrink_low": shrink_low, "shrink_high": 0.7}
    return MethodResult(
        "proposed",
        1,
        indices,
        True,
        "s",
        {"lead": np.array(lead), "area": 12.345, **{k: np.full(d, v) for k, v in ends.items()}},
    )


def test_a_clear_lead_is_certain():
    clear = result({"a": (0.1, 0.2), "b": (0.6, 0.7)}, [[0.0, -0.5], [0.3, 0.0]])
    assert rank(clear) == Ranking("b", certain=True)
    assert not rank(clear, n_lost=1).certain
    text = words(clear, "cross_track_m", rank(clear), 0, 20)
    assert text.startswith("cross_track_m: reduce b first. The p-box is 12.3 m wide")
    assert "shrink by 50 to 60 % (40 to 70 % with sampling error)" in text
    assert "Certain: it holds at every corner of the other coefficients" in text
    assert "3 of 20 aleatory samples are left out" in words(
        clear, "cross_track_m", rank(clear, 3), 3, 20
    )


@pytest.mark.parametrize(
    ("ranges", "lead", "by_ranges", "by_sampling"),
    [
        ({"a": (0.1, 0.6), "b": (0.6, 0.7)}, [[0.0, 0.0], [-0.1, 0.0]], ("a",), ()),
        ({"a": (0.1, 0.5), "b": (0.6, 0.7)}, [[0.0, 0.0], [-0.1, 0.0]], (), ("a",)),
        ({"a": (0.1, 0.5), "b": (0.6, 0.7)}, [[0.0, 0.0], [math.nan, 0.0]], (), ("a",)),
    ],
)
def test_rivals_by_ranges_and_by_sampling(ranges, lead, by_ranges, by_sampling):
    output = result(ranges, lead)
    outcome = rank(output)
    assert (outcome.first, outcome.by_ranges, outcome.by_sampling, outcome.certain) == (
        "b",
        by_ranges,
        by_sampling,
        False,
    )
    assert "Not certain: " in words(output, "m", outcome, 0, 20)


@pytest.mark.parametrize("low", [0.0, math.nan])
def test_a_shrinkage_that_may_be_nothing_is_never_certain(low):
    output = result({"a": (0.1, 0.2), "b": (0.6, 0.7)}, [[0.0, -0.5], [0.3, 0.0]], shrink_low=low)
    outcome = rank(output)
    assert (outcome.first, outcome.by_ranges, outcome.by_sampling, outcome.certain) == (
        "b",
        (),
        (),
        False,
    )
    text = words(output, "m", outcome, 0, 8)
    assert "Not certain: by the sampling error of 8 flights b may have no effect." in text
    assert "Certain" not in text


VALUES = np.array([0.2, 0.35, 0.3, 0.27])


def run_once(value, other=None) -> Sensitivity:
    index = Index(value, 0.0, 1.0)
    pairs = PairRange(index, Index(2.0 * value, 0.0, 1.0))
    single = {"a": index, "b": other or index}
    return Sensitivity(
        {
            "y": {
                "anova": MethodResult("anova", 10, single, True, "fine", {"total_sum": 1.0}),
                "proposed": MethodResult("proposed", 4, {"a": pairs, "b": pairs}, True, "fine"),
            }
        }
    )


def test_the_interval_is_that_of_the_mean():
    outcome = average([run_once(v) for v in VALUES])["y"]["anova"]
    low, high = stats.t.interval(0.95, 3, VALUES.mean(), stats.sem(VALUES))
    index = outcome.indices["a"]
    assert (index.value, index.low, index.high) == pytest.approx((VALUES.mean(), low, high))
    assert outcome.details["std_of_one_run"] == pytest.approx([VALUES.std(ddof=1)] * 2)
    assert (outcome.runs, outcome.details["repeats"]) == (40, 4)
    # One more repeat far away widens it.
    wider = average([run_once(v) for v in [*VALUES, 0.9]])["y"]["anova"].indices["a"]
    assert wider.high - wider.low > high - low


def test_undefined_once_is_undefined_and_one_run_is_no_repeat():
    outcome = average([run_once(0.2), run_once(0.3, undefined("no width"))])["y"]["anova"]
    assert outcome.indices["b"].reason == "no width"
    assert np.isnan(outcome.indices["b"].value)
    assert outcome.indices["a"].value == pytest.approx(0.25)
    with pytest.raises(BadInputError, match="at least two"):
        average([run_once(0.2)])
