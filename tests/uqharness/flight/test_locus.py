"""Modes over airspeed: each point is what the modes at that speed are alone, and a speed without a
trim has its reason.
"""

from __future__ import annotations

from dataclasses import replace

import pytest

from uqharness.flight import handling
from uqharness.flight.handling import default_speeds, locus_point, root_locus
from uqharness.simulator import SteadyCondition, find_aircraft, find_trim, linearise, modes

CONDITION = SteadyCondition(22.0)


@pytest.fixture(scope="module")
def espaaro():
    return find_aircraft("espaaro")


@pytest.fixture(scope="module")
def first(espaaro):
    return locus_point(linearise(espaaro, find_trim(espaaro, CONDITION)), "B", "I")


def test_points_are_the_modes_at_their_speeds(espaaro, first):
    seen = []
    found = root_locus(
        espaaro,
        CONDITION,
        (18.0, 26.0),
        "B",
        "I",
        first=first,
        callback=lambda done, total: seen.append((done, total)),
    )
    assert [p.V_mps for p in found.points] == [18.0, 22.0, 26.0]
    assert found.refused == ()
    assert seen == [(1, 2), (2, 2)]
    alone = modes(linearise(espaaro, find_trim(espaaro, replace(CONDITION, V_mps=18.0))))
    assert [(m.name, m.real, m.imag) for m in found.points[0].modes] == [
        (m.name, m.real, m.imag) for m in alone
    ]
    assert found.points[1] is first
    # n/alpha = q S CLalpha / (m g) grows with the square of the airspeed.
    assert found.points[2].n_alpha / found.points[0].n_alpha == pytest.approx(
        (26.0 / 18.0) ** 2, rel=0.02
    )


def test_speeds_beyond_two_without_a_trim_are_not_tried(espaaro, first, monkeypatch):
    """Both ends of the range that flies, with a trim that is refused below 20 m/s."""
    tried = []

    def trim(aircraft, condition):
        tried.append(condition.V_mps)
        found = find_trim(aircraft, CONDITION)
        return (
            found if condition.V_mps >= 20.0 else replace(found, converged=False, reason="too slow")
        )

    monkeypatch.setattr(handling, "find_trim", trim)
    monkeypatch.setattr(
        handling,
        "locus_point",
        lambda model, category, aircraft_class: replace(first, V_mps=tried[-1]),
    )
    found = root_locus(espaaro, CONDITION, (10.0, 12.0, 15.0, 19.0, 21.0), "B", "I", first=first)
    assert tried == [21.0, 19.0, 15.0]
    assert [p.V_mps for p in found.points] == [21.0, 22.0]
    reasons = dict(found.refused)
    assert [reasons[V] for V in (19.0, 15.0)] == ["too slow"] * 2
    assert (
        reasons[12.0] == reasons[10.0] == "not tried: slower than 19 and 15 m/s, which do not trim"
    )


def test_usual_speeds():
    assert default_speeds(20.0)[0] == pytest.approx(14.0)
    assert default_speeds(20.0)[-1] == pytest.approx(32.0)
    assert default_speeds(20.0, 16.0, 28.0)[1] == pytest.approx(17.0)
