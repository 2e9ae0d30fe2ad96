"""Channel names as options give them."""

from __future__ import annotations

import pytest

from uqharness.errors import BadInputError
from uqharness.identification.replay_fit import parse_channels
from uqharness.replay.replay import CONTROL_DELAY


def test_short_forms_and_long_ones():
    assert parse_channels("--biases", "p,alpha_rad, ax ,p_radps") == (
        "p_radps",
        "alpha_rad",
        "ax_mps2",
    )
    assert parse_channels("--biases", None) is None
    assert parse_channels("--biases", "none") == parse_channels("--biases", "") == ()


def test_controls_are_delayed_and_have_no_bias():
    assert parse_channels("--delays", f"{CONTROL_DELAY},V") == (CONTROL_DELAY, "V_mps")
    with pytest.raises(
        BadInputError, match=f"--biases {CONTROL_DELAY}: unknown channel {CONTROL_DELAY}"
    ):
        parse_channels("--biases", CONTROL_DELAY)
    with pytest.raises(BadInputError, match="unknown channel speed; allowed are none, "):
        parse_channels("--delays", "V,speed")
