"""Which uncertainty to reduce first, how sure that is, and in which unit."""

from __future__ import annotations

import math

import numpy as np
import pytest

from uqharness.sensitivity.result import (
    Index,
    MethodResult,
    PairRange,
    Ranking,
    all_undefined,
    rank,
    unit_of,
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
        {
            "lead": np.array(lead),
            "area": 12.345,
            **{k: np.full(d, v) for k, v in ends.items()},
        },
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
    made = result(ranges, lead)
    found = rank(made)
    assert (found.first, found.by_ranges, found.by_sampling, found.certain) == (
        "b",
        by_ranges,
        by_sampling,
        False,
    )
    assert "Not certain: " in words(made, "m", found, 0, 20)


@pytest.mark.parametrize("low", [0.0, math.nan])
def test_a_shrinkage_that_may_be_nothing_is_never_certain(low):
    made = result({"a": (0.1, 0.2), "b": (0.6, 0.7)}, [[0.0, -0.5], [0.3, 0.0]], shrink_low=low)
    found = rank(made)
    assert (found.first, found.by_ranges, found.by_sampling, found.certain) == ("b", (), (), False)
    text = words(made, "m", found, 0, 8)
    assert "Not certain: by the sampling error of 8 flights b may have no effect." in text
    assert "Certain" not in text


def test_an_undefined_result_ranks_nothing():
    nothing = all_undefined("proposed", ("a", "b"), "no width")
    assert rank(nothing) == Ranking("")
    assert words(nothing, "speed", rank(nothing), 0, 5) == "speed: undefined: no width"


@pytest.mark.parametrize(
    ("metric", "unit"), [("excursions_roll", "per flight"), ("V_sd_mps", "m/s"), ("h_sd_m", "m")]
)
def test_units(metric, unit):
    assert unit_of(metric) == unit
