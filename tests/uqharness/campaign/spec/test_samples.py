"""Epistemic samples: every combination in order, Latin columns, draws of parameters."""

from __future__ import annotations

import itertools
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from uqharness.campaign import CampaignSpec
from uqharness.campaign.sampling import epistemic_samples, latin_column, parameter_draws
from uqharness.campaign.spec import EpistemicSection, Estimates, ParametersSection, VariableSection

LOAD = {"load/kg": VariableSection(distribution="normal", mean=(19.0, 22.0), std=0.5)}
ESTIMATES = Estimates(
    ("a", "b"), np.array([1.0, -2.0]), np.array([[0.36, 0.0084], [0.0084, 0.0004]])
)


def spec(variables=None, moved=("CX", "Cm"), estimates=None, **section):
    section = EpistemicSection.model_validate({"coefficients": moved, **section})
    # By default corners alone: tests of the other points ask for them.
    section = section.model_copy(
        update={"interior": section.interior_samples(0), "nominal": bool(section.nominal)}
    )
    return CampaignSpec(
        Path(),
        "",
        metrics=None,
        stop=None,
        epistemic=section,
        inputs=SimpleNamespace(
            coefficients=moved,
            walk_rates={"CX": 0.1, "Cm": 0.2},
            estimates=estimates,
            confidence=0.95,
        ),
        aleatory=SimpleNamespace(variables=variables or {}),
        campaign=SimpleNamespace(seed=7),
    )


BOUNDS = {"CX": 0.01, "Cm": 0.01}


def test_corners_in_order_with_means_fastest():
    found = epistemic_samples(spec(LOAD, method="corners", bounds=BOUNDS))
    assert [s.epistemic_id for s in found] == [
        f"{a}---{b}-+{c}" for a, b, c in itertools.product("01", repeat=3)
    ]
    assert found[3].levels == {"CX": 0.0, "Cm": 1.0}
    assert found[3].means == {"load/kg": 1.0}


def test_the_nominal_model_flies_last_with_means_in_the_middle():
    *corners, nominal = epistemic_samples(spec(LOAD, method="corners", bounds=BOUNDS, nominal=True))
    assert len(corners) == 8
    assert (nominal.epistemic_id, nominal.levels) == ("nominal", {})
    assert nominal.means == {"load/kg": 0.5}


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
    np.testing.assert_array_equal(
        parameter_draws(ParametersSection(fit="f"), ESTIMATES, 10, 7), drawn[:10]
    )
    box = parameter_draws(
        ParametersSection(fit="f", distribution="box", confidence=0.9), ESTIMATES, 1000, 7
    )
    reach = stats.norm.ppf(1.0 - 0.1 / 4.0) * np.sqrt(np.diag(ESTIMATES.covariance))
    far = np.abs(box - ESTIMATES.values).max(axis=0)
    assert (far <= reach).all()
    assert (far > 0.99 * reach).all()


def test_draws_of_parameters_multiply_corners():
    found = epistemic_samples(
        spec(
            method="corners", bounds=BOUNDS, samples=3, parameters={"fit": "f"}, estimates=ESTIMATES
        )
    )
    assert len(found) == 12
    assert found[4].epistemic_id == "0---1-+p000001"
    assert found[4].parameters == found[1].parameters != found[0].parameters


def test_interior_points_follow_the_corners_and_are_those_of_a_latin_hypercube():
    found = epistemic_samples(spec(LOAD, method="corners", bounds=BOUNDS, interior=16))
    alone = epistemic_samples(spec(LOAD, method="lhs", samples=16, bounds=BOUNDS))
    assert found[:8] == epistemic_samples(spec(LOAD, method="corners", bounds=BOUNDS))
    assert found[8:] == alone
    assert found[8].epistemic_id == "lhs-000000"
    drawn = epistemic_samples(
        spec(
            method="corners",
            bounds=BOUNDS,
            interior=2,
            samples=3,
            parameters={"fit": "f"},
            estimates=ESTIMATES,
        )
    )
    assert len(drawn) == 3 * (4 + 2)
    assert drawn[-1].epistemic_id == "lhs-000001+p000002"


def radii(found, names):
    """Distance from the intervals' middles in standard deviations."""
    sigma = stats.norm.ppf(0.975)
    return [sigma * np.linalg.norm([2.0 * s.levels[name] - 1.0 for name in names]) for s in found]


def test_an_ellipsoid_has_its_directions_and_axis_ends_on_it_and_the_rest_inside():
    names = ("CX", "CY", "CZ", "Cl", "Cm", "Cn")
    found = epistemic_samples(
        spec(moved=names, method="corners", bounds="model-form.json", set="ellipsoid")
    )
    directions, ends, inside = found[:64], found[64:76], found[76:]
    assert [s.epistemic_id for s in directions[:2]] == ["e000000", "e000001"]
    assert [s.epistemic_id for s in ends[:3]] == ["a0.....", "a1.....", "a.0...."]
    assert len(inside) == 16
    assert len({s.epistemic_id for s in found}) == len(found)
    assert radii(directions, names) == pytest.approx([3.5485] * 64, abs=1e-4)
    assert radii(ends, names) == pytest.approx([3.5485] * 12, abs=1e-4)
    assert directions[63].levels["CX"] == pytest.approx(
        0.5 + 0.5 * 3.54846 / 1.95996 / np.sqrt(6.0), abs=1e-5
    )
    assert ends[1].levels == {
        "CX": pytest.approx(0.5 + 0.5 * 3.54846 / 1.95996, abs=1e-5)
    } | dict.fromkeys(names[1:], 0.5)
    assert max(radii(inside, names)) < 3.5485
    # The box's own corners lie outside it, which is the point of it.
    corners = epistemic_samples(
        spec(moved=names, method="corners", bounds="model-form.json", interior=0)
    )
    assert radii(corners, names) == pytest.approx([np.sqrt(6.0) * stats.norm.ppf(0.975)] * 64)
    # One coefficient: its directions are its axis, and the joint set is the interval.
    one = epistemic_samples(
        spec(moved=("CX",), method="corners", bounds="model-form.json", set="ellipsoid", interior=0)
    )
    assert [(s.epistemic_id, s.levels["CX"]) for s in one] == [("e0-----", 0.0), ("e1-----", 1.0)]


def test_uncertain_means_stay_a_box_beside_an_ellipsoid():
    found = epistemic_samples(
        spec(LOAD, method="corners", bounds="model-form.json", set="ellipsoid", interior=2)
    )
    assert [s.epistemic_id for s in found[:3]] == ["e0---0-+0", "e0---0-+1", "e0---1-+0"]
    assert [s.epistemic_id for s in found[8:10]] == ["a0---.-+0", "a0---.-+1"]
    assert len(found) == 2 * (4 + 4) + 2
    hypercube = epistemic_samples(
        spec(method="lhs", samples=50, bounds="model-form.json", set="ellipsoid")
    )
    assert 2.0 < max(radii(hypercube, ("CX", "Cm"))) <= stats.chi2.ppf(0.95, 2) ** 0.5 + 1e-9
