"""The section of a smooth term: what it says, and that it is not there where none is offered."""

from __future__ import annotations

import numpy as np

from tests.helpers.report_folders import refinement
from uqharness.report.pages.refinement import smooth_sections
from uqharness.report.parts import Figures, Table, Words
from uqharness.results.refinement import Refinement

AT = np.linspace(-0.05, 0.1, 41)


def remaining(smooth):
    """A refinement with a smooth term, or none."""
    left = refinement()["remaining"] | {"smooth": smooth}
    return Refinement.model_validate(refinement(remaining=left))


def done(**changes):
    row = {"rms_before": 0.006, "rms_after": 0.0035, "noise_rms": 0.0034}
    gap = {"channels": {"q_radps": row}, "coefficients": {"Cm": row}}
    value = 0.01 * np.tanh((AT - 0.03) / 0.01)
    smooth = {
        "coefficient": "Cm",
        "state": "alpha",
        "times": None,
        "name": "smooth term of angle of attack in pitching moment",
        "property": "uq/unnamed/Cm_of_alpha",
        "unit": "rad",
        "model": "unnamed/aircraft/a/a.xml",
        "in_place_of": [],
        "effective_degrees_of_freedom": 7.3,
        "channel": "q_radps",
        "channel_on_train": 1.7,
        "leaves": 1.02,
        "shapes": [{"form": "step at 0.03", "correlation": 0.98, "leaves": 1.03}],
        "curve": {
            "at": AT.tolist(),
            "value": value.tolist(),
            "low": (value - 1e-3).tolist(),
            "high": (value + 1e-3).tolist(),
            "samples": [10] * 41,
        },
        "test": {
            "gap": "shrank",
            "change_of_twice_log_likelihood": 300.0,
            "std": 40.0,
            "rms_over_that_of_train": 1.0,
        },
        "gap": {"train": gap, "test": gap},
    }
    return remaining(smooth | changes)


def test_the_section_has_the_curve_its_gap_and_the_forms():
    (section,) = smooth_sections(done())
    words, figures, gap, shapes = section.blocks
    assert isinstance(words, Words)
    assert "7.3 effective degrees of freedom" in words.text
    assert isinstance(figures, Figures)
    assert figures.file == "unnamed"
    assert "which physics would make this shape?" in figures.items[0].caption
    assert "alpha [rad]" in figures.items[0].svg
    assert isinstance(gap, Table)
    assert [r[0] for r in gap.rows] == [
        "Train: q [deg/s]",
        "Train: Cm [-]",
        "Test: q [deg/s]",
        "Test: Cm [-]",
    ]
    assert isinstance(shapes, Table)
    assert shapes.rows == (("Step at 0.03", "0.980", "1.030"),)
