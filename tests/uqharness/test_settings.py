"""What settings files share: strict sections, numbers, lists."""

from __future__ import annotations

import math

import pytest
from pydantic import ValidationError

from uqharness.toml import Number, Section


class Wing(Section):
    """A section."""

    span_m: Number
    count: int = 1


def test_types_are_not_bent_and_unknown_keys_are_refused():
    assert Wing.model_validate({"span_m": 3}).span_m == 3.0
    curved = [{"span_m": value} for value in ("3", math.nan, math.inf, True)]
    for invalid in (*curved, {"span_m": 1.0, "spam": 1}, {"span_m": 1.0, "count": 1.0}, {}):
        with pytest.raises(ValidationError):
            Wing.model_validate(invalid)
    with pytest.raises(ValidationError, match="frozen"):
        Wing(span_m=1.0).span_m = 2.0
