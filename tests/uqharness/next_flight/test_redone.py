"""What a flight has brought: widths before and after, beside what was predicted."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from tests.helpers.model_forms import LONGITUDINAL, MEAN, made_up_form
from uqharness.next_flight.plan import achieved, as_text
from uqharness.next_flight.points import Occupancy

FORM = made_up_form({"CZ": LONGITUDINAL, "Cm": LONGITUDINAL})
MISSION = Occupancy(
    {name: np.full(20, MEAN.get(name, 0.0)) for name in LONGITUDINAL}, 1, 0, 2.0, "the mission"
)


def narrowed(factor: float):
    """The same bounds with their scatter and their terms' error so much smaller, and no part that
    holds zero.
    """
    rows = {
        n: replace(b, s2=b.s2 * factor**2, beta_hat=b.beta_hat * factor)
        for n, b in FORM.coefficients.items()
    }
    return replace(FORM, coefficients=rows)


def test_half_the_scatter_is_half_the_width(tmp_path):
    found = achieved(FORM, narrowed(0.5), MISSION, tmp_path / "none.json")
    assert set(found) == {"CZ", "Cm"}
    for row in found.values():
        assert row["narrowing"] == pytest.approx(0.5)
        assert row["width_after"] == pytest.approx(0.5 * row["width"])
        assert row["parameter_narrowing"] == pytest.approx(0.5)
        assert row["predicted"] is None
    same = achieved(FORM, FORM, MISSION, tmp_path / "none.json")
    assert same["CZ"]["narrowing"] == 0.0


def test_what_was_predicted_stands_beside_it(tmp_path):
    plan = tmp_path / "next-flight.json"
    plan.write_text(
        json.dumps({"prospects": {"Cm": {"narrowing_redone": 0.4, "parameter_narrowing": 0.6}}})
    )
    found = achieved(FORM, narrowed(0.5), MISSION, plan)
    assert (found["Cm"]["predicted"], found["Cm"]["predicted_parameter"]) == (0.4, 0.6)
    assert found["CZ"]["predicted"] is None
    header, first, second = as_text(found).splitlines()
    assert header.split()[:3] == ["coefficient", "width", "width_after"]
    assert "40 %" in second
    assert "–" in first
    plan.write_text("[]")
    assert achieved(FORM, FORM, MISSION, plan)["Cm"]["predicted"] is None


def test_a_coefficient_without_new_bounds_is_left_out(tmp_path):
    after = replace(FORM, coefficients={"Cm": FORM.coefficients["Cm"]})
    assert set(achieved(FORM, after, MISSION, tmp_path / "none.json")) == {"Cm"}
