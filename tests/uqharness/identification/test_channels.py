"""Channel names as options give them."""

from __future__ import annotations

from typing import Any

import pytest

from uqharness.errors import BadInputError
from uqharness.requests.fields import CONTROL_DELAY, channel_names
from uqharness.requests.identification import IdentifyRequest


def requested(**channels: Any) -> IdentifyRequest:
    return IdentifyRequest.of(aircraft="espaaro", flights="a.csv", **channels)


def test_short_forms_and_long_ones():
    names = requested(biases="p,alpha_rad, ax ,p_radps").biases
    assert channel_names(names) == ("p_radps", "alpha_rad", "ax_mps2")
    assert channel_names(requested().biases) is None
    assert requested(biases="none").biases == requested(biases="").biases == ()


def test_controls_are_delayed_and_have_no_bias():
    assert channel_names(requested(delays=f"{CONTROL_DELAY},V").delays) == (CONTROL_DELAY, "V_mps")
    with pytest.raises(
        BadInputError, match=f"biases = '{CONTROL_DELAY}': unknown channel {CONTROL_DELAY}"
    ):
        requested(biases=CONTROL_DELAY)
    with pytest.raises(BadInputError, match="unknown channel speed; allowed are none, "):
        requested(delays=["V", "speed"])
