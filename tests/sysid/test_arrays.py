"""Inputs of estimators and the refusals of bad ones."""

from __future__ import annotations

import numpy as np
import pytest

from sysid.arrays import as_bounds, as_free, as_segments

NAMES = ("a", "b", "c")


@pytest.mark.parametrize(
    ("value", "output"),
    [
        ([np.ones((3, 2)), np.ones((3, 1))], "z, segment 1 has 1 columns, segment 0 has 2"),
        (np.ones((0, 2)), r"z has shape \(0, 2\)"),
        (np.ones((2, 2, 2)), "z, segment 0|shape"),
        ([[1.0, 2.0], [3.0]], "numeric and rectangular"),
        (["a", "b"], "numeric and rectangular"),
        ([[1.0, 2.0], [3.0, np.inf]], "1 value.s. that are not finite, first at row 1, column 1"),
    ],
)
def test_segments_that_are_none(value, output):
    with pytest.raises(ValueError, match=output):
        as_segments(value, "z", dropouts=True)


def test_every_form_of_bounds_says_the_same():
    theta = np.array([0.0, 1.0, 2.0])
    forms = [
        [(-1.0, 5.0), None, (None, 3.0)],
        {"a": (-1.0, 5.0), "c": (None, 3.0)},
        [np.array([-1.0, -np.inf, -np.inf]), np.array([5.0, np.inf, 3.0])],
    ]
    for form in forms:
        lower, upper = as_bounds(form, theta, NAMES)
        assert lower.tolist() == [-1.0, -np.inf, -np.inf]
        assert upper.tolist() == [5.0, np.inf, 3.0]
    # Two numbers stand for all, and two parameters take them as pairs.
    assert as_bounds([-1.0, 5.0], theta, NAMES)[1].tolist() == [5.0] * 3
    assert as_bounds([(-1.0, 5.0), (0.0, 2.0)], theta[:2], NAMES[:2])[0].tolist() == [-1.0, 0.0]


@pytest.mark.parametrize(
    ("bounds", "output"),
    [
        ({"d": (0, 1)}, "bounds names d; the parameters are a, b, c"),
        ([(0, 1)], "1 entries for 3"),
        ([(0, 1), (0, 1, 2), None], "one .lower, upper. for each"),
        ({"b": (2.0, 2.0)}, "bounds of b .* the lower must be below"),
        ({"c": (0.0, 1.0)}, "theta0 of c is 2.0, outside"),
        ({"c": (float("nan"), 3.0)}, "bounds of c"),
    ],
)
def test_bounds_that_are_none(bounds, output):
    with pytest.raises(ValueError, match=output):
        as_bounds(bounds, np.array([0.0, 1.0, 2.0]), NAMES)


def test_free_parameters_by_name_number_or_mask():
    assert as_free(None, NAMES).all()
    for form in (["c", "a"], [0, 2], [True, False, True], np.array([True, False, True])):
        assert as_free(form, NAMES).tolist() == [True, False, True]
    for invalid, output in (
        (["d"], "free names d"),
        ([3], "0 to 2"),
        ([-1], "0 to 2"),
        ([True], "1 entries for 3"),
        ([], "no parameter"),
    ):
        with pytest.raises(ValueError, match=output):
            as_free(invalid, NAMES)
