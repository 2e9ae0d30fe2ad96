"""The page of two models flown side by side."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from uqharness.differences import Channel, MatchedFlight, Term, by_channel, differences
from uqharness.report.pages import difference_page
from uqharness.report.parts import render
from uqharness.simulator import Source

TIME = np.arange(0.0, 1.0, 0.01)
CHANNELS = (Channel("Cm", "-", "moment coefficients", Source("Cm"), 1e-4),)
A = {"Cm": np.sin(TIME)}
TERM = Term(
    "aerodynamics / axis PITCH / function Cmq / value",
    "-12.0",
    "12.0",
    "x.xml:9",
    "y.xml:11",
    "force coefficients",
    "Cm",
)


def page_of(flight: MatchedFlight, terms=(TERM,)) -> str:
    result = by_channel(differences(CHANNELS, [flight], terms))
    return render(
        difference_page(("old", "new"), CHANNELS, [flight], result, terms, "uqharness diff old new")
    )


def test_a_difference_has_its_history_and_its_line():
    html = page_of(
        MatchedFlight("doublets", TIME, A, {"Cm": A["Cm"] + np.where(TIME >= 0.5, 0.1, 0.0)}, A)
    )
    assert "The models differ in 1 channels, first in Cm at 0.5 s of doublets." in html
    assert "Likeliest cause: B y.xml:11" in html
    assert 'class="chart"' in html
    assert "✓" not in html


def test_nothing_differs():
    same = MatchedFlight("doublets", TIME, A, A, A)
    assert "No output differs beyond rounding." in page_of(same, ())
    assert "1 elements of the XML differ; these flights do not show them." in page_of(same)
    assert 'class="chart"' not in page_of(same)


def test_a_flight_that_b_cannot_fly_is_said():
    html = page_of(replace(MatchedFlight("doublets", TIME, A, {}, A), reason="no aerodynamics"))
    assert "doublets: no aerodynamics." in html
    assert "No output differs" not in html
