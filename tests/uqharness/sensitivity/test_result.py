"""What a method says, as plain JSON, undefined numbers with their reason."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from uqharness.sensitivity.result import (
    Index,
    MethodResult,
    PairRange,
    all_undefined,
    missing_values,
    number,
)


def test_results_are_plain_json_and_nan_is_null():
    index = Index(0.5, 0.25, math.nan)
    result = MethodResult(
        "m",
        3,
        {"a": index, "b": PairRange(index, Index(1.0, 0.5, 2.0))},
        None,
        "s",
        {
            "matrix": np.array([[1.0, np.nan]]),
            "single": np.float64(2.0),
        },
    )
    found = json.loads(json.dumps(result.as_dict(), allow_nan=False))
    assert found["indices"]["a"] == {"value": 0.5, "interval": [0.25, None]}
    assert found["indices"]["b"] == {"value": [0.5, 1.0], "interval": [0.25, 2.0]}
    assert found["details"] == {"matrix": [[1.0, None]], "single": 2.0}
    assert number(math.inf) is None


@pytest.mark.parametrize("method", ["anova", "proposed"])
def test_undefined_is_never_zero_and_says_why(method):
    found = all_undefined(method, ("a", "b"), "no width", 7)
    assert set(found.indices) == {"a", "b"}
    assert found.indices["a"].reason == "no width"
    assert found.indices["a"].as_dict()["reason"] == "no width"
    assert isinstance(found.indices["a"], PairRange) is (method == "proposed")
    assert found.runs == 7


def test_missing_values_are_counted_in_the_first_stage_that_has_any():
    whole, broken = np.ones((2, 3)), np.array([[1.0, np.nan, np.inf]])
    assert missing_values(a=whole) == ""
    assert missing_values(a=whole, b=broken) == "2 of 3 b runs gave no finite value"
