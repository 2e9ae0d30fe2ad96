"""How much narrower a p-box is with a parameter known: functions whose widths are known."""

from __future__ import annotations

import numpy as np
import pytest

from uqharness.sensitivity.measures import pinching
from uqharness.sensitivity.study import run_study

BOX = {"a": (0.0, 2.0), "b": (-1.0, 1.0)}


def pinched(model, samples=512, methods=("pbox", "proposed"), **more):
    made = run_study(model, BOX, samples=samples, draws=1, methods=methods)
    return pinching(made, made.outputs["output"], **more), made


def test_a_sum_of_ranges_loses_the_known_ones():
    found, made = pinched(lambda a, b: 3.0 * a + b, intervals=False)
    y = made.outputs["output"]
    assert found.details["area"] == pytest.approx(float(np.ptp(y.sampled)))
    for i, name in enumerate("ab"):
        assert found.indices[name].value == pytest.approx(
            1.0 - np.ptp(y.pinned[i]) / np.ptp(y.sampled)
        )
    assert [found.indices[n].value for n in "ab"] == pytest.approx([0.75, 0.25], abs=0.04)
    assert np.isnan(found.indices["a"].low)
    assert found.runs == 3 * 512


def test_few_samples_do_not_fill_the_corners_and_it_is_said():
    found, _ = pinched(lambda a, b: 3.0 * a + b, samples=16)
    assert found.holds is (found.details["area"] >= 0.9 * 8.0)
    thin, _ = pinched(lambda a, b: (a * (b + 1.0) / 4.0) ** 8, samples=16)
    assert thin.holds is False
    assert "samples seldom meet corners" in thin.statement
    unchecked, _ = pinched(lambda a, b: 3.0 * a + b, methods=("pbox",))
    assert unchecked.holds is None


def test_a_parameter_without_effect_frees_nothing():
    found, _ = pinched(lambda a, b: a, intervals=False)
    assert found.indices["b"].value == 0.0
    assert found.indices["a"].value == 1.0
    flat, _ = pinched(lambda a, b: 0.0 * a)
    assert np.isnan(flat.indices["a"].value)


def test_samples_that_leave_the_corners_are_said():
    """4 a (1 - a) + b / 2 is widest between the corners, where the sampled p-box fills theirs three
    times over.
    """
    unit = {"a": (0.0, 1.0), "b": (0.0, 1.0)}
    found = {}
    for name, model in (
        ("curved", lambda a, b: 4.0 * a * (1.0 - a) + b / 2.0),
        ("straight", lambda a, b: a + b / 2.0),
    ):
        made = run_study(model, unit, samples=512, draws=1, methods=("pbox", "proposed"))
        found[name] = pinching(made, made.outputs["output"])
    assert found["straight"].holds is True
    assert found["curved"].holds is False
    assert "extremum inside" in found["curved"].statement
