"""What estimators ask of their input, and the sentences with which they refuse the rest."""

from __future__ import annotations

import numpy as np
import pytest

from sysid.arrays import as_array, as_bounds, as_free, as_names, as_parameters, as_segments

NAMES = ("a", "b", "c")


def test_one_array_and_a_list_of_them_become_segments():
    series = np.arange(6.0)
    (one,) = as_segments(series, "z", dropouts=False)
    assert one.shape == (6, 1)
    (nested,) = as_segments([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]], "z", dropouts=False)
    assert nested.tolist() == [[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]]
    many = as_segments([series, series[:2]], "z", dropouts=False)
    assert [part.shape for part in many] == [(6, 1), (2, 1)]
    deep = as_segments([[[1.0, 2.0]], [[3.0, 4.0], [5.0, 6.0]]], "z", dropouts=False)
    assert [part.shape for part in deep] == [(1, 2), (2, 2)]


@pytest.mark.parametrize(
    ("value", "said"),
    [
        ([np.ones((3, 2)), np.ones((3, 1))], "z, segment 1 has 1 columns, segment 0 has 2"),
        (np.ones((0, 2)), r"z has shape \(0, 2\)"),
        (np.ones((2, 2, 2)), "z, segment 0|shape"),
        ([[1.0, 2.0], [3.0]], "numeric and rectangular"),
        (["a", "b"], "numeric and rectangular"),
        ([[1.0, 2.0], [3.0, np.inf]], "1 value.s. that are not finite, first at row 1, column 1"),
    ],
)
def test_segments_that_are_none(value, said):
    with pytest.raises(ValueError, match=said):
        as_segments(value, "z", dropouts=True)


def test_a_dropout_is_allowed_where_it_is_asked_for_alone():
    holes = np.array([1.0, np.nan, 2.0])
    assert np.isnan(as_segments(holes, "z", dropouts=True)[0][1, 0])
    with pytest.raises(ValueError, match="repair or cut these samples"):
        as_segments(holes, "u", dropouts=False)


def test_parameters_are_a_copy_of_finite_numbers():
    given = np.array([1.0, 2.0])
    taken = as_parameters(given)
    taken[0] = 9.0
    assert given[0] == 1.0
    assert as_parameters(3.0).tolist() == [3.0]
    for bad, said in (
        ([], "at least one"),
        ([[1.0]], "vector"),
        ([1.0, np.nan, np.inf], r"\[1, 2\]"),
    ):
        with pytest.raises(ValueError, match=said):
            as_parameters(bad)
    with pytest.raises(ValueError, match="numeric"):
        as_array(object(), "z")


def test_names_are_given_or_numbered():
    assert as_names(None, 2, "p") == ("p0", "p1")
    assert as_names(["x", "y"], 2, "p") == ("x", "y")
    for bad, said in (
        (["x"], "1 entries for 2"),
        (["x", "x"], "repeats x"),
        ("xy", "single string"),
    ):
        with pytest.raises(ValueError, match=said):
            as_names(bad, 2, "p")


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
    ("bounds", "said"),
    [
        ({"d": (0, 1)}, "bounds names d; the parameters are a, b, c"),
        ([(0, 1)], "1 entries for 3"),
        ([(0, 1), (0, 1, 2), None], "one .lower, upper. for each"),
        ({"b": (2.0, 2.0)}, "bounds of b .* the lower must be below"),
        ({"c": (0.0, 1.0)}, "theta0 of c is 2.0, outside"),
        ({"c": (float("nan"), 3.0)}, "bounds of c"),
    ],
)
def test_bounds_that_are_none(bounds, said):
    with pytest.raises(ValueError, match=said):
        as_bounds(bounds, np.array([0.0, 1.0, 2.0]), NAMES)


def test_free_parameters_by_name_number_or_mask():
    assert as_free(None, NAMES).all()
    for form in (["c", "a"], [0, 2], [True, False, True], np.array([True, False, True])):
        assert as_free(form, NAMES).tolist() == [True, False, True]
    for bad, said in (
        (["d"], "free names d"),
        ([3], "0 to 2"),
        ([-1], "0 to 2"),
        ([True], "1 entries for 3"),
        ([], "no parameter"),
    ):
        with pytest.raises(ValueError, match=said):
            as_free(bad, NAMES)
