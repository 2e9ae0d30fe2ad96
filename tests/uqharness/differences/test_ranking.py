"""Where two models part: beyond rounding alone, the earliest first, and cause before effect."""

from __future__ import annotations

import numpy as np
import pytest

from uqharness.differences import Channel, MatchedFlight, Term, differences, scale_of
from uqharness.simulator import Source

TIME = np.arange(0.0, 2.0, 0.01)


def channel(name: str, group: str) -> Channel:
    return Channel(name, "-", group, Source(name), 1e-4)


CHANNELS = (
    channel("q", "rates"),
    channel("Cm", "moment coefficients"),
    channel("CZ", "force coefficients"),
)


def flight(**changed: np.ndarray) -> MatchedFlight:
    a = {c.name: np.sin(TIME * (k + 1)) for k, c in enumerate(CHANNELS)}
    nudged = {name: values * (1.0 + 1e-15) for name, values in a.items()}
    return MatchedFlight(
        "doublets",
        TIME,
        a,
        {name: values + changed.get(name, 0.0) for name, values in a.items()},
        nudged,
    )


def test_what_a_nudged_start_does_is_benign():
    grown = 1e-12 * np.exp(12.0 * TIME)
    exact = flight(q=100.0 * grown)
    assert len(differences(CHANNELS, [exact], ())) == 1
    a = exact.a["q"]
    assert (
        differences(
            CHANNELS,
            [MatchedFlight("d", TIME, exact.a, exact.b, {**exact.nudged, "q": a + grown})],
            (),
        )
        == []
    )


def test_the_earliest_comes_first_and_cause_before_effect():
    late, early = np.where(TIME >= 1.0, 0.1, 0.0), np.where(TIME >= 0.5, 0.01, 0.0)
    result = differences(CHANNELS, [flight(q=early, Cm=early, CZ=late)], ())
    assert [d.channel for d in result] == ["Cm", "q", "CZ"]
    assert [d.from_s for d in result] == pytest.approx([0.5, 0.5, 1.0])
    # A force off the centre of gravity makes a moment as well.
    assert [d.channel for d in differences(CHANNELS, [flight(Cm=early, CZ=early)], ())] == [
        "CZ",
        "Cm",
    ]


def test_a_difference_has_its_size_and_share():
    (d,) = differences(CHANNELS, [flight(Cm=np.where(TIME >= 1.0, -0.2, 0.0))], ())
    assert (d.size, d.flight, d.unit) == (pytest.approx(0.2), "doublets", "-")
    assert d.share == pytest.approx(0.2 / scale_of(CHANNELS[1], flight().a["Cm"]))
    assert d.b - d.a == pytest.approx(-0.2)


def test_the_likeliest_element_is_that_of_its_own_axis():
    def term(path: str, group: str, name: str = "") -> Term:
        return Term(path, "1", "2", "a.xml:1", "b.xml:1", group, name)

    mass = term("mass_balance / emptywt", "mass and CG")
    lift = term(
        "aerodynamics / axis LIFT / function aero/coefficient/CLalpha / value",
        "force coefficients",
        "CZ",
    )
    pitch = term(
        "aerodynamics / axis PITCH / function aero/coefficient/Cmq / value",
        "force coefficients",
        "Cm",
    )
    changed = flight(Cm=np.where(TIME >= 1.0, 0.2, 0.0))
    (d,) = differences(CHANNELS, [changed], (mass, lift, pitch))
    assert d.terms[0] == pitch
    (d,) = differences(CHANNELS, [flight(CZ=np.where(TIME >= 1.0, 0.2, 0.0))], (mass, pitch, lift))
    assert d.terms[0] == lift
