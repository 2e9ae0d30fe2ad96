"""What a notebook shows of a refinement."""

from __future__ import annotations

import copy

from uqharness.refinement.document import refinement_view

DOCUMENT = {
    "verdict": "effects-found",
    "effects": [
        {
            "name": "pitching moment due to roll rate squared",
            "property": "aero/Cm_p2",
            "value": 3.02,
            "std": 0.03,
            "unit": "-",
        },
        {"name": "a <slow> servo", "property": None, "value": None, "std": None, "unit": "s"},
    ],
    "gap": {
        "test": {
            "channels": {"q_radps": {"rms_before": 0.04, "rms_after": 0.0101, "noise_rms": 0.01}}
        }
    },
}


def test_verdict_effects_and_residuals_are_shown():
    shown = refinement_view("Refinement", DOCUMENT)
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
        assert text in shown
    assert "&lt;slow&gt;" in shown
    assert "nan" not in shown
    assert "None" not in shown


def test_no_effect_and_no_noise_leave_cells_empty():
    document = copy.deepcopy(DOCUMENT) | {"verdict": "no-missing-effect", "effects": []}
    document["gap"]["test"]["channels"]["q_radps"]["noise_rms"] = 0.0
    shown = refinement_view("Refinement", document)
    assert "Cm_p2" not in shown
    assert "<td>q_radps</td><td></td><td></td>" in shown
