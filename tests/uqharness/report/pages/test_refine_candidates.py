"""The chart of candidates holds every candidate that a refinement names."""

from __future__ import annotations

import pytest

from tests.helpers.report_folders import refinement
from uqharness.report.pages.refinement import (
    MAX_UNLISTED,
    candidate_figure,
)
from uqharness.results.refinement import Refinement


def effect(coefficient: str, term: str, t: float, alternatives=()) -> dict:
    return refinement()["effects"][0] | {
        "coefficient": coefficient,
        "term": term,
        "evidence": {"t": t},
        "alternatives": list(alternatives),
    }


@pytest.fixture
def done():
    other = {"subsystem": "mass", "term": "Ixz", "name": "Ixz", "separable": True}
    other |= {"evidence": {"twice_log_likelihood": 900.0}}
    scores = [
        {"effect": "Cm p_hat^2", "t": -50.0},
        *({"effect": f"CX alpha^{k}", "t": 5.0 - 0.1 * k} for k in range(20)),
    ]
    where = [
        {"coefficient": "Cl", "term": "de", "t": 12.0},
        {"coefficient": "CZ", "rms_over_noise": 1.3, "depends_on": []},
    ]
    harmful = refinement()["withdrawn"][0] | effect("CY", "da", 4.5)
    return refinement(
        effects=[effect("Cm", "p_hat^2", -48.0, [other])],
        withdrawn=[harmful | {"test": refinement()["withdrawn"][0]["test"]}],
        remaining=refinement()["remaining"] | {"where": where},
        best_refused={"effect": "Cn/beta^2", "t": 3.9, "why": "|t| 3.9 is not above 4.0"},
        candidates={"limit": 4.0, "scores": scores},
    )


def test_all_of_them_are_in_the_chart_and_few_of_the_others(done):
    figure = candidate_figure(Refinement.model_validate(done))
    assert figure is not None
    drawn = str(figure.svg)
    for name in ("Cm p_hat^2", "CY da", "mass Ixz", "Cl de", "Cn beta^2"):
        assert name in drawn
    assert sum(f"CX alpha^{k} " in drawn for k in range(20)) <= MAX_UNLISTED
    assert "CX alpha^19" not in drawn
