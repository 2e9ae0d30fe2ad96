"""Random streams by name: the same for ever, and none another's."""

from __future__ import annotations

import pytest

from uqharness.flight.random_numbers import KINDS, flight_seed, named_stream, numbered_stream


def test_a_named_stream_is_the_one_that_published_campaigns_drew_from():
    assert named_stream(1, "variable", "inertia/mass-slugs").generate_state(2).tolist() == [
        2305002566,
        3369399767,
    ]
    assert named_stream(1, "variable", "a").generate_state(2).tolist() == [1457111318, 794892873]


def test_streams_of_other_names_kinds_numbers_and_roots_differ():
    streams = [
        named_stream(1, "variable", "a"),
        named_stream(1, "variable", "b"),
        named_stream(1, "levels", "a"),
        named_stream(2, "variable", "a"),
        numbered_stream(1, "variable", 0, "a"),
        numbered_stream(1, "variable", 1, "a"),
        numbered_stream(1, "variable", 0),
    ]
    first = [tuple(stream.generate_state(4)) for stream in streams]
    assert len(set(first)) == len(first)


def test_numbers_of_kinds_are_never_reused():
    assert {
        "turbulence": 1,
        "noise": 2,
        "walk": 3,
        "levels": 4,
        "parameters": 5,
        "variable": 6,
    }.items() <= KINDS.items()
    assert len(set(KINDS.values())) == len(KINDS)


def test_a_flight_has_a_seed_that_jsbsim_takes():
    found = {
        flight_seed(7, number, kind) for number in range(50) for kind in ("turbulence", "noise")
    }
    assert len(found) == 100
    assert all(1 <= seed <= 2**31 - 2 for seed in found)
    with pytest.raises(ValueError, match="must be turbulence or noise"):
        flight_seed(7, 0, "walk")
