"""[epistemic]: methods, bounds, rates and samples that belong together."""

from __future__ import annotations

import pytest
from pydantic import ValidationError

from uqharness.campaign.spec import EpistemicSection, ParametersSection
from uqharness.flight.spec import COEFFICIENTS

BOUNDS = dict.fromkeys(COEFFICIENTS, 0.01)


def made(**section) -> EpistemicSection:
    return EpistemicSection.model_validate(section)


def test_one_number_is_both_bounds_and_a_pair_is_itself():
    found = made(
        method="corners", coefficients=["Cm", "CX"], bounds={"CX": 0.008, "Cm": [-0.01, 0.02]}
    )
    assert found.coefficients == ("CX", "Cm")
    assert found.bounds == {"CX": (-0.008, 0.008), "Cm": (-0.01, 0.02)}
    assert made(method="corners", bounds="model-form.json").bounds == "model-form.json"


def test_one_rate_is_everyones():
    found = made(method="walk", samples=3, bounds=BOUNDS, walk_rate_per_sqrt_s=0.012)
    assert found.walk_rate_per_sqrt_s == dict.fromkeys(COEFFICIENTS, 0.012)


@pytest.mark.parametrize(
    ("section", "said"),
    [
        ({"method": "corners", "bounds": {"CX": 0.01}}, "bounds lack CY, CZ"),
        (
            {"method": "corners", "coefficients": ["CX"], "bounds": {"CX": 0.01, "Cm": 0.01}},
            "given for Cm, which is not among",
        ),
        ({"method": "corners", "bounds": "wide"}, "must be numbers"),
        (
            {"method": "corners", "bounds": BOUNDS | {"CX": -0.01}},
            "half-width and cannot be negative",
        ),
        ({"method": "corners", "bounds": BOUNDS | {"CX": [0.01, 0.02]}}, "lower <= 0 <= upper"),
        ({"method": "corners", "bounds": BOUNDS | {"CX": [1, 2, 3]}}, "a number .±. or a pair"),
        ({"method": "levels", "bounds": BOUNDS}, "levels belongs to method"),
        ({"method": "corners", "bounds": BOUNDS, "levels": [0.0, 1.0]}, "levels belongs to method"),
        ({"method": "levels", "bounds": BOUNDS, "levels": [0.0, 1.5]}, "from 0 .lower bound. to 1"),
        ({"method": "levels", "bounds": BOUNDS, "levels": [0.5, 0.5]}, "none twice"),
        ({"method": "lhs", "bounds": BOUNDS}, 'method = "lhs" needs samples'),
        ({"method": "corners", "bounds": BOUNDS, "samples": 5}, "flies every combination"),
        (
            {"method": "walk", "samples": 5, "bounds": BOUNDS, "walk_rate_per_sqrt_s": 0.0},
            "a rate is a number above 0",
        ),
        (
            {"method": "walk", "samples": 5, "bounds": BOUNDS, "walk_rate_per_sqrt_s": {"CX": 0.1}},
            "lacks CY",
        ),
        (
            {"method": "white", "samples": 5, "bounds": BOUNDS, "walk_rate_per_sqrt_s": 0.1},
            'not to "white"',
        ),
        (
            {"method": "none", "parameters": {"fit": "fit.json"}},
            ".epistemic.parameters. needs samples",
        ),
        ({"method": "corners", "coefficients": ["CX", "CX"]}, "none twice"),
        ({"method": "corners", "coefficients": ["CQ"]}, "coefficients"),
        (
            {"method": "walk", "samples": 5, "bounds": "model-form.json", "set": "ellipsoid"},
            "belongs to the methods corners and lhs",
        ),
        ({"method": "lhs", "samples": 5, "bounds": BOUNDS, "interior": 4}, "flown with corners"),
        ({"method": "lhs", "samples": 5, "bounds": BOUNDS, "nominal": True}, "flies it alone"),
        ({"method": "corners", "bounds": BOUNDS, "interior": -1}, "interior"),
        ({"method": "corners", "bounds": BOUNDS, "set": "ball"}, "set"),
        ({"method": "none", "transient": True}, 'method = "none" flies no model error'),
    ],
)
def test_sections_that_contradict_themselves(section, said):
    with pytest.raises(ValidationError, match=said):
        made(**section)


def test_a_confidence_belongs_to_a_box():
    box = ParametersSection.model_validate(
        {"fit": "fit.json", "distribution": "box", "confidence": 0.9}
    )
    assert box.box_confidence == 0.9
    assert ParametersSection.model_validate({"fit": "fit.json"}).box_confidence == 0.95
    for section, said in (
        ({"confidence": 0.9}, "a normal distribution has no edge"),
        ({"parameters": []}, "at least one"),
    ):
        with pytest.raises(ValidationError, match=said):
            ParametersSection.model_validate({"fit": "fit.json", **section})


def test_interior_points_fly_beside_the_corners_of_a_model_form():
    assert made(method="corners", bounds="model-form.json").interior_samples(4) == 16
    assert made(method="corners", bounds="model-form.json", interior=0).interior_samples(4) == 0
    assert made(method="lhs", samples=5, bounds="model-form.json").interior_samples(4) == 0


def test_interior_points_and_the_nominal_model_fly_beside_corners_of_constant_bounds():
    corners = made(method="corners", bounds=BOUNDS)
    assert [corners.interior_samples(n) for n in (2, 8, 64)] == [2, 8, 16]
    assert corners.flies_nominal
    assert made(method="corners", bounds=BOUNDS, interior=3).interior_samples(64) == 3
    assert made(method="corners", bounds=BOUNDS, interior=0).interior_samples(64) == 0
    assert not made(method="corners", bounds=BOUNDS, nominal=False).flies_nominal
    assert not made(method="none").flies_nominal
