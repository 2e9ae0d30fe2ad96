"""The mean over repeats, against scipy's interval."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from uqharness.errors import BadInputError
from uqharness.sensitivity.analysis import Sensitivity, average
from uqharness.sensitivity.result import Index, MethodResult, PairRange, undefined

VALUES = np.array([0.2, 0.35, 0.3, 0.27])


def once(value, other=None) -> Sensitivity:
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
    found = average([once(v) for v in VALUES])["y"]["anova"]
    low, high = stats.t.interval(0.95, 3, VALUES.mean(), stats.sem(VALUES))
    index = found.indices["a"]
    assert (index.value, index.low, index.high) == pytest.approx((VALUES.mean(), low, high))
    assert found.details["std_of_one_run"] == pytest.approx([VALUES.std(ddof=1)] * 2)
    assert (found.runs, found.details["repeats"]) == (40, 4)
    # One more repeat far away widens it.
    wider = average([once(v) for v in [*VALUES, 0.9]])["y"]["anova"].indices["a"]
    assert wider.high - wider.low > high - low


def test_ranges_have_both_ends_averaged():
    found = average([once(v) for v in VALUES])["y"]["proposed"]
    pair = found.indices["a"]
    assert (pair.minimum.value, pair.maximum.value) == pytest.approx(
        (VALUES.mean(), 2.0 * VALUES.mean())
    )
    assert found.details["std_of_one_run"] == pytest.approx([2.0 * VALUES.std(ddof=1)] * 2)


def test_undefined_once_is_undefined_and_one_run_is_no_repeat():
    found = average([once(0.2), once(0.3, undefined("no width"))])["y"]["anova"]
    assert found.indices["b"].reason == "no width"
    assert np.isnan(found.indices["b"].value)
    assert found.indices["a"].value == pytest.approx(0.25)
    with pytest.raises(BadInputError, match="at least two"):
        average([once(0.2)])
