"""The page of a planned flight: what the plan says, and figures that show where the flight
helps.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from lxml import etree

from tests.helpers.model_forms import made_up_form
from uqharness.report.pages.next_flight import uncertainty_figures

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
