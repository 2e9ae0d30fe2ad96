"""Total effects of functions whose variance is known in closed form."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from uqharness.sensitivity.measures import anova
from uqharness.sensitivity.study import run_study


def total(model, samples=2048, draws=4, **more):
    box = {"a": (0.0, 1.0), "b": (0.0, 1.0), "c": (0.0, 1.0)}
    made = run_study(
        model, box, {"w": stats.norm(0.0, 1.0)}, samples=samples, draws=draws, methods=("anova",)
    )
    found = anova(made, made.outputs["output"], **more)
    return [found.indices[n].value for n in "abc"], found


def test_shares_of_a_sum_are_its_variances():
    values, found = total(lambda a, b, c, w: 3.0 * a + b + 7.0 * w, intervals=False)
    assert values == pytest.approx([0.9, 0.1, 0.0], abs=0.05)
    assert found.details["total_sum"] == pytest.approx(1.0, abs=0.05)
    assert found.details["first_order"] == pytest.approx([0.9, 0.1, 0.0], abs=0.06)
    assert np.isnan(found.indices["a"].low)


def test_an_interaction_counts_for_both():
    """y = ab: Var = 7/144, of which each alone makes 3/144 and both together 1/144."""
    values, found = total(lambda a, b, c, w: a * b, intervals=False)
    assert values == pytest.approx([4.0 / 7.0, 4.0 / 7.0, 0.0], abs=0.05)
    assert found.details["total_sum"] > 1.1


def test_the_interval_holds_the_truth_and_shrinks_with_samples():
    _, wide = total(lambda a, b, c, w: 3.0 * a + b, samples=64)
    _, tight = total(lambda a, b, c, w: 3.0 * a + b, samples=1024)
    for found in (wide, tight):
        assert found.indices["a"].low < 0.9 < found.indices["a"].high
    assert tight.indices["a"].high - tight.indices["a"].low < 0.5 * (
        wide.indices["a"].high - wide.indices["a"].low
    )


def test_a_mean_without_variance_is_undefined_and_no_zero():
    values, found = total(lambda a, b, c, w: w, samples=64)
    assert np.isnan(values).all()
    assert "no variance" in found.statement
    made = run_study(lambda a: a, {"a": (0.0, 1.0)}, samples=16, methods=("local",))
    assert "no pair of sampled matrices" in anova(made, made.outputs["output"]).statement
