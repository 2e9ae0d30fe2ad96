"""What one model varies by itself, in other air and within its bounds, counts as equal."""

import pytest

from uqharness.differences.ranking import (
    MatchedRequest,
    by_channel,
    differences,
    fly_matched,
)
from uqharness.errors import BadInputError
from uqharness.simulator import find_aircraft


def find(**request):
    one, two = find_aircraft("espaaro"), find_aircraft("espaaro_truth")
    channels, flights = fly_matched(
        one, two, MatchedRequest(speeds_mps=(22.0,), missions=("doublets",), **request)
    )
    return {d.channel: d for d in by_channel(differences(channels, flights, []))}, flights[0]


def test_variation_within_bounds_counts_as_equal():
    plain, _ = find()
    widened, flight = find(bounds=True)
    assert flight.varied["Cm"] > 1e-3
    assert set(widened) < set(plain)


def test_nothing_to_vary_is_refused():
    aircraft = find_aircraft("c172p")
    for request, output in (
        ({"repeats": 2}, "still air has no other seed"),
        ({"bounds": True}, "has none"),
    ):
        with pytest.raises(BadInputError, match=output):
            fly_matched(
                aircraft,
                aircraft,
                MatchedRequest(speeds_mps=(50.0,), missions=("steady",), **request),
            )
