"""What a notebook shows of a refinement."""

from __future__ import annotations

from tests.helpers.report_folders import refinement
from uqharness.refinement.document import refinement_view
from uqharness.results.refinement import Refinement

EFFECT = refinement()["effects"][0]


def document(**changes) -> Refinement:
    row = {"rms_before": 0.04, "rms_after": 0.0101, "noise_rms": 0.01} | changes.pop("row", {})
    slow = {"name": "a <slow> servo", "property": None, "value": None, "std": None, "unit": "s"}
    effects = [EFFECT | {"value": 3.02, "std": 0.03}, EFFECT | slow]
    gap = {"test": {"channels": {"q_radps": row}, "coefficients": {}}}
    return Refinement.model_validate(refinement(effects=effects, gap=gap) | changes)


def test_verdict_effects_and_residuals_are_shown():
    visible = refinement_view("Refinement", document())
    name = "pitching moment due to roll rate squared"
    for text in (
        "effects-found",
        name,
        "aero/Cm_p2",
        "3.02",
        "0.03",
        "<td>4</td>",
        "<td>1.01</td>",
    ):
        assert text in visible
    assert "&lt;slow&gt;" in visible
    assert "nan" not in visible
    assert "None" not in visible


def test_no_effect_and_no_noise_leave_cells_empty():
    empty = document(verdict="no-missing-effect", effects=[], row={"noise_rms": 0.0})
    visible = refinement_view("Refinement", empty)
    assert "Cm_p2" not in visible
    assert "<td>q_radps</td><td></td><td></td>" in visible
