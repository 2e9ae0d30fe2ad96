"""Sentences about what is left: of moments, and of candidates that are still asked for."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from sysid.effects import SelectedEffect
from sysid.effects.catalogue import coefficient_effect
from uqharness.refinement.document import strong_unreported, unexplained_moments
from uqharness.refinement.estimators import PredictionErrorEstimator, ReplayEstimator
from uqharness.refinement.sentences import reason_for
from uqharness.results.refinement import NearbyCandidate


@pytest.mark.parametrize(
    ("gains", "reports"), [((5.0, 99.0, np.nan), []), ((5.0, 400.0, 101.0), ["Cm", "Cn"])]
)
def test_moments_that_nothing_explains_are_told_by_their_axes(gains, reports):
    air = SimpleNamespace(moments=np.array(gains))
    result = SimpleNamespace(
        estimator=PredictionErrorEstimator(air),
        data=SimpleNamespace(outputs=("p_radps", "q_radps", "r_radps")),
    )
    output = unexplained_moments(result)
    assert [row["coefficient"] for row in output.values()] == reports
    assert all(f"{row['twice_log_likelihood']:.0f}" in row["words"] for row in output.values())
    assert not unexplained_moments(SimpleNamespace(estimator=ReplayEstimator(), data=result.data))


def test_of_the_nearest_candidates_those_are_told_that_are_strong_and_not_told_yet():
    close = [
        NearbyCandidate(coefficient="Cl", term="alpha^3", name="a", t=33.1, leaves=1.0),
        NearbyCandidate(coefficient="Cl", term="alpha*CT", name="b", t=-31.2, leaves=1.0),
        NearbyCandidate(subsystem="propulsion", term="torque", name="c", t=9.0, leaves=1.0),
    ]
    assert strong_unreported(close, {"effect/Cl/alpha*CT"}) == [("effect/Cl/alpha^3", 33.1)]
    assert strong_unreported(close, set()) == [
        ("effect/Cl/alpha^3", 33.1),
        ("effect/Cl/alpha*CT", -31.2),
    ]


@pytest.mark.parametrize(
    ("usual", "reports"), [("", "(negative)"), ("positive", "(negative; usual: positive)")]
)
def test_a_sign_that_is_usual_is_told(usual, reports):
    effect = replace(coefficient_effect("Cm", "p_hat^2"), sign=usual)
    assert f"Estimate -2 ± 0.1 {reports}, |t| 20.0" in reason_for(
        effect, SelectedEffect("k", -2.0, 0.1, -20.0, 400.0, 300.0, 0.5)
    )
