"""Local differences of functions whose slopes and ranges are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from uqharness.sensitivity.measures import local
from uqharness.sensitivity.study import run_study

BOX = {"a": (0.0, 2.0), "b": (-1.0, 1.0)}
AIR = {"w": stats.norm(0.0, 1.0)}


def study(model, methods=("local", "proposed"), **more):
    return run_study(model, BOX, AIR, samples=64, draws=16, methods=methods, **more)


def test_shares_of_a_linear_function_are_its_ranges():
    made = study(lambda a, b, w: 3.0 * a - b + w)
    runs = replace(made.outputs["output"], sampled=None)
    found = local(made, runs)
    assert found.details["slope"] == pytest.approx([3.0, 1.0])
    assert found.details["area"] == pytest.approx(8.0)
    assert [found.indices[n].value for n in "ab"] == pytest.approx([0.75, 0.25])
    assert found.holds
    assert found.runs == 3
    # All corners there are, and every draw the same shift: nothing is left to chance.
    assert found.indices["a"].low == pytest.approx(found.indices["a"].high)


def test_what_is_not_linear_is_said():
    made = study(lambda a, b, w: 3.0 * a + 5.0 * b**3 + w)
    found = local(made, made.outputs["output"])
    assert found.details["slope"] == pytest.approx([3.0, 5.0 * 0.02**2], rel=1e-6)
    assert found.holds is False
    assert "not linear" in found.statement


def test_without_width_or_runs_there_is_no_share():
    made = study(lambda a, b, w: w)
    assert np.isnan(local(made, made.outputs["output"]).indices["a"].value)
    assert "no width" in local(made, made.outputs["output"]).indices["a"].reason
    runs = replace(made.outputs["output"], nominal=None)
    assert "no runs about a nominal model" in local(made, runs).statement
    broken = study(lambda a, b, w: np.where(a > 1.5, np.nan, a + b + w))
    assert "gave no finite value" in local(broken, broken.outputs["output"]).statement


UNIT = {"a": (0.0, 1.0), "b": (0.0, 1.0)}


def test_a_maximum_between_the_corners_is_not_linear():
    """4 a (1 - a) + b / 2: the ranges of the slopes add up to the corners' width, and the width is
    a's, inside.
    """

    def said(model):
        made = run_study(model, UNIT, samples=64, draws=1, methods=("local", "proposed"))
        return local(made, made.outputs["output"])

    found = said(lambda a, b: 4.0 * a * (1.0 - a) + b / 2.0)
    assert found.holds is False
    assert "between the corners leave it" in found.statement
    assert said(lambda a, b: a + b / 2.0).holds is True


def test_a_campaigns_interior_samples_check_too():
    made = run_study(
        lambda a, b: 4.0 * a * (1.0 - a) + b / 2.0,
        UNIT,
        samples=64,
        draws=1,
        methods=("local", "proposed"),
    )
    runs = made.outputs["output"]
    inside = replace(runs, sampled=None, interior=np.array([[1.0], [0.9]]))
    assert local(made, inside).holds is False
    assert local(made, replace(runs, sampled=None, interior=None)).holds is True
