"""Epistemic samples: every combination in order, Latin columns, draws of parameters."""

from __future__ import annotations

import itertools
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from uqharness.campaign.inputs import Estimates
from uqharness.campaign.spec.epistemic import EpistemicSection, ParametersSection
from uqharness.campaign.spec.samples import epistemic_samples, latin_column, parameter_draws
from uqharness.campaign.spec.variables import VariableSection

LOAD = {"load/kg": VariableSection(distribution="normal", mean=(19.0, 22.0), std=0.5)}
ESTIMATES = Estimates(("a", "b"), np.array([1.0, -2.0]), np.array([[0.36, 0.0084], [0.0084, 0.0004]]))


def spec(variables=None, moved=("CX", "Cm"), estimates=None, **section):
    section = EpistemicSection.model_validate({"coefficients": moved, **section})
    return SimpleNamespace(
        epistemic=section, inputs=SimpleNamespace(coefficients=moved, walk_rates={"CX": 0.1, "Cm": 0.2}, estimates=estimates),
        aleatory=SimpleNamespace(variables=variables or {}), campaign=SimpleNamespace(seed=7),
    )  # fmt: skip


BOUNDS = {"CX": 0.01, "Cm": 0.01}


def test_corners_in_order_with_means_fastest():
    found = epistemic_samples(spec(LOAD, method="corners", bounds=BOUNDS))
    assert [s.epistemic_id for s in found] == [f"{a}---{b}-+{c}" for a, b, c in itertools.product("01", repeat=3)]
    assert found[3].levels == {"CX": 0.0, "Cm": 1.0}
    assert found[3].means == {"load/kg": 1.0}


def test_levels_and_none():
    found = epistemic_samples(spec(method="levels", levels=[0.0, 0.5, 1.0], bounds=BOUNDS))
    assert len(found) == 9
    assert found[1].epistemic_id == "0/-/-/-/0.5/-"
    (nominal,) = epistemic_samples(spec(method="none"))
    assert (nominal.epistemic_id, nominal.levels) == ("nominal", {})


def test_drawn_samples_stay_when_more_are_drawn_or_a_dimension_joins():
    lhs = epistemic_samples(spec(LOAD, method="lhs", samples=16, bounds=BOUNDS))
    alone = epistemic_samples(spec(method="lhs", samples=16, bounds=BOUNDS))
    assert [s.levels for s in lhs] == [s.levels for s in alone]
    assert sorted(int(16 * s.means["load/kg"]) for s in lhs) == list(range(16))
    walks = epistemic_samples(spec(method="walk", samples=3, bounds=BOUNDS))
    assert epistemic_samples(spec(method="walk", samples=5, bounds=BOUNDS))[:3] == walks
    assert walks[2].driver.rates_per_sqrt_s == (0.1, 0.2)
    assert walks[2].epistemic_id == "walk-000002"


def test_a_latin_column_has_one_value_in_every_cell():
    column = latin_column(7, "CX", 100)
    assert sorted(np.floor(100 * column)) == list(range(100))
    assert stats.kstest(100 * column % 1.0, "uniform").pvalue > 1e-3
    assert not np.array_equal(column, latin_column(7, "CY", 100))
    assert not np.array_equal(column, latin_column(8, "CX", 100))


def test_draws_have_the_covariance_and_a_box_its_edges():
    drawn = parameter_draws(ParametersSection(fit="f"), ESTIMATES, 4000, 7)
    assert np.cov(drawn.T) == pytest.approx(ESTIMATES.covariance, rel=0.15)
    assert drawn.mean(axis=0) == pytest.approx(ESTIMATES.values, abs=0.04)
    np.testing.assert_array_equal(parameter_draws(ParametersSection(fit="f"), ESTIMATES, 10, 7), drawn[:10])
    box = parameter_draws(ParametersSection(fit="f", distribution="box", confidence=0.9), ESTIMATES, 1000, 7)
    reach = stats.norm.ppf(1.0 - 0.1 / 4.0) * np.sqrt(np.diag(ESTIMATES.covariance))
    far = np.abs(box - ESTIMATES.values).max(axis=0)
    assert (far <= reach).all()
    assert (far > 0.99 * reach).all()


def test_draws_of_parameters_multiply_corners():
    found = epistemic_samples(spec(method="corners", bounds=BOUNDS, samples=3, parameters={"fit": "f"}, estimates=ESTIMATES))
    assert len(found) == 12
    assert found[4].epistemic_id == "0---1-+p000001"
    assert found[4].parameters == found[1].parameters != found[0].parameters
