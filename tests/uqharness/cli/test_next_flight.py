"""Request of ``uqharness next-flight``."""

from __future__ import annotations

import pytest

from uqharness.cli.main import build_parser
from uqharness.cli.request_command import request_of
from uqharness.errors import BadInputError
from uqharness.requests.next_flight import NextFlightRequest


def make_inputs(*words):
    arguments = build_parser().parse_args(["next-flight", "results", "--out", "next", *words])
    return request_of(NextFlightRequest, arguments)


def test_speeds_are_a_list_of_positive_numbers():
    assert make_inputs().speeds == ()
    assert make_inputs("--speeds", "19,22.5").speeds == (19.0, 22.5)
    assert NextFlightRequest.of(folder="results", out="next", speeds=[19, 22.5]).speeds == (
        19,
        22.5,
    )
    for text in ("fast", "19,,22", "0", "nan", ""):
        with pytest.raises(BadInputError, match=f"--speeds {text}: true airspeeds in m/s"):
            make_inputs("--speeds", text)
