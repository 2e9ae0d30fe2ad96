"""The page of a planned flight: what the plan says, and figures that show where the flight
helps.
"""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from lxml import etree

from sysid.model_form.information_gain import parameter_variance
from tests.helpers.model_forms import made_up_form
from tests.helpers.page_checks import problems, words_of
from uqharness.next_flight.points import Condition, Steps, TestPoint
from uqharness.report.pages.next_flight import next_flight_page, uncertainty_figures
from uqharness.report.parts import first_lines, render
from uqharness.results.next_flight import NextFlightPlan, PlannedAircraft

NOW = made_up_form().coefficients["CY"]
THEN = replace(NOW, XtX_inv=0.25 * NOW.XtX_inv)


def states(rng, spread):
    middle = NOW.hull.middle[:, 1]
    return {
        s: middle[k] + spread * NOW.scale[k] * rng.standard_normal(3000)
        for k, s in enumerate(NOW.states)
    }


MISSION, FLOWN = states(np.random.default_rng(1), 1.0), states(np.random.default_rng(2), 0.3)


def lines(figure, kind):
    found = [
        e
        for e in etree.fromstring(str(figure.svg)).iter("path")
        if e.get("class") == f"line {kind}"
    ]
    return [
        np.array([[float(v) for v in pair.split()] for pair in e.get("d")[1:].split("L")])
        for e in found
    ]


def cells(figure):
    """Place -> density of a map's cells."""
    found = (e for e in etree.fromstring(str(figure.svg)).iter("rect") if e.get("fill-opacity"))
    return {(e.get("x"), e.get("y")): float(e.get("fill-opacity")) for e in found}


def test_half_widths_halve_where_the_flight_divides_the_variance_by_four():
    figures = uncertainty_figures(NOW, THEN, MISSION, FLOWN, "grow", "CY")
    assert [figure.name for figure in figures] == [
        *(f"half-width-{s}" for s in NOW.states),
        "variance-now",
        "variance-after",
    ]
    for figure in figures[:4]:
        _, top, _, height = (
            float(v) for v in etree.fromstring(str(figure.svg)).get("data-plot").split(",")
        )
        (before,), (after,) = lines(figure, "second"), lines(figure, "first")
        half = [top + height - curve[:, 1] for curve in (before, after)]
        assert half[1] == pytest.approx(0.5 * half[0], abs=0.2)
    # The first map is a quarter as dense in the second.
    dense = [cells(figure) for figure in figures[4:]]
    assert max(dense[0].values()) == 1.0
    assert all(
        dense[1].get(place, 0.0) == pytest.approx(0.25 * share, abs=2e-3)
        for place, share in dense[0].items()
    )


def test_bounds_of_one_state_have_no_map():
    one = made_up_form({"CY": ("V_mps",)}).coefficients["CY"]
    figures = uncertainty_figures(one, one, MISSION, FLOWN, "grow", "CY")
    assert [figure.name for figure in figures] == ["half-width-V_mps"]
    assert np.all(parameter_variance(one, MISSION, "grow") > 0.0)


def test_the_page_says_what_the_plan_says():
    point = TestPoint("doublet <1>", (Steps("elevator", 2.0, 0.8),), Condition(22.0, 0.0))
    where = SimpleNamespace(
        state="beta_rad",
        data=np.radians([1.0, 2.0, 3.0]),
        mission=np.zeros(3),
        variance=np.full(3, np.nan),
    )
    plan = [SimpleNamespace(start_s=18.0, point=point, gain=0.026)]
    found = SimpleNamespace(coefficient="CY", refused=[1, 2], n_points=9, where=[where], plan=plan)
    document = NextFlightPlan.model_construct(
        aircraft=PlannedAircraft(name="plane", sha256=""),
        words=["Fly it.", "It helps."],
        warnings=["old bounds"],
    )
    figures = uncertainty_figures(NOW, THEN, MISSION, FLOWN, "grow", "CY")
    page = next_flight_page(found, document, figures, "uqharness next-flight results")
    text = render(page)
    assert problems(text) == []
    words = words_of(text)
    for said in (
        "Fly it. It helps.",
        "2 of 9 test points were refused",
        "old bounds",
        "doublet <1>",
        "2.6 %",
        "1 / 2 / 3",
    ):
        assert said in words
    assert "undefined / undefined / undefined" in words
    shown = first_lines(page)
    assert shown[:2] == ["Fly it.", "It helps."]
    assert "old bounds" not in shown
    assert "<figure" not in render(next_flight_page(found, document, (), "x"))
