"""What settings files share: strict sections, numbers, lists."""

from __future__ import annotations

import math
import sys

import pytest
from pydantic import ValidationError

from uqharness.toml import Number, Section, as_tuple, is_number, list_as_tuple


class Wing(Section):
    """A section."""

    span_m: Number
    count: int = 1


def test_types_are_not_bent_and_unknown_keys_are_refused():
    assert Wing.model_validate({"span_m": 3}).span_m == 3.0
    bent = [{"span_m": value} for value in ("3", math.nan, math.inf, True)]
    for bad in (*bent, {"span_m": 1.0, "spam": 1}, {"span_m": 1.0, "count": 1.0}, {}):
        with pytest.raises(ValidationError):
            Wing.model_validate(bad)
    with pytest.raises(ValidationError, match="frozen"):
        Wing(span_m=1.0).span_m = 2.0


def test_lists_become_tuples():
    assert as_tuple([1, 2]) == list_as_tuple([1, 2]) == (1, 2)
    assert as_tuple(3) == (3,)
    assert list_as_tuple(3) == 3
    assert as_tuple("ab") == ("ab",)


@pytest.mark.parametrize("value", [0, -1.5, sys.float_info.max, 10**300])
def test_numbers(value):
    assert is_number(value)


@pytest.mark.parametrize(
    "value", [True, False, math.nan, math.inf, -math.inf, 10**400, "1", None, [1]]
)
def test_what_is_no_number(value):
    assert not is_number(value)
