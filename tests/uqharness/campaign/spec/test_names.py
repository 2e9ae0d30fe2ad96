"""Names that sections share, in their one order."""

from __future__ import annotations

import itertools
from typing import get_args

import pytest

from uqharness.campaign.spec import Coefficient, Turbulence, ordered
from uqharness.flight.spec import COEFFICIENTS


def test_any_choice_comes_back_in_the_one_order():
    for size in (1, 3, 6):
        for chosen in itertools.permutations(COEFFICIENTS, size):
            assert ordered(chosen) == tuple(sorted(chosen, key=COEFFICIENTS.index))
            break
    assert ordered(("Cn", "CX", "Cl")) == ("CX", "Cl", "Cn")


@pytest.mark.parametrize("value", [(), ("CX", "CX")])
def test_none_and_one_twice_are_refused(value):
    with pytest.raises(ValueError, match="at least one coefficient, and none twice"):
        ordered(value)


def test_the_literals_are_what_flights_know():
    assert get_args(Coefficient) == COEFFICIENTS
    assert "none" in get_args(Turbulence)
