"""Request of ``uqharness next-flight``."""

from __future__ import annotations

import pytest

from uqharness.cli.main import build_parser
from uqharness.cli.request_command import request_of
from uqharness.commands.next_flight import DOCUMENT, SCRIPT, TABLE
from uqharness.errors import BadInputError
from uqharness.requests.next_flight import NextFlightRequest


def given(*words):
    arguments = build_parser().parse_args(["next-flight", "results", "--out", "next", *words])
    return request_of(NextFlightRequest, arguments)


def test_speeds_are_a_list_of_positive_numbers():
    assert given().speeds == ()
    assert given("--speeds", "19,22.5").speeds == (19.0, 22.5)
    assert NextFlightRequest.of(folder="results", out="next", speeds=[19, 22.5]).speeds == (
        19,
        22.5,
    )
    for text in ("fast", "19,,22", "0", "nan", ""):
        with pytest.raises(BadInputError, match=f"--speeds {text}: true airspeeds in m/s"):
            given("--speeds", text)


@pytest.mark.parametrize(
    ("option", "value"),
    [("--minutes", "0"), ("--minutes", "121"), ("--cases", "0"), ("--seed", "-1")],
)
def test_numbers_have_limits(option, value):
    with pytest.raises(BadInputError, match=f"{option} {value}: "):
        given(option, value)


def test_names_of_the_files_are_the_documented_ones():
    assert (DOCUMENT, SCRIPT, TABLE) == ("next-flight.json", "next-flight.xml", "test-points.csv")
