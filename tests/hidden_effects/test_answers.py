"""Answers are judged as they are: made-up documents that pass, and ones that do not."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from tests.hidden_effects.__main__ import right
from tests.hidden_effects.answers import property_name
from tests.hidden_effects.effects import Effect
from tests.hidden_effects.questions import Wrong, question
from tests.hidden_effects.verdict import judge

NULL = question(8)
HIDDEN = (Effect("CX", "q_hat", 0.4),)
CLEAR = replace(NULL, kind="clear", entries=("CX:q_hat",), effects=HIDDEN, t=(20.0,))
CARD = replace(NULL, kind="card", wrong=Wrong("propulsion:thrust_scale", 0.10), t=(40.0,))
LATE = replace(NULL, kind="card", wrong=Wrong("record:delay", -0.02), t=(12.0,))
OFF = replace(question(14), t=(40.0,))


def effect(key: str, value: float = 0.4, std: float = 0.02) -> dict[str, Any]:
    """An effect of refinement.json."""
    subject, term = key.split(":")
    kind = "coefficient" if len(subject) == 2 else "subsystem"
    interval = [value - 1.96 * std, value + 1.96 * std]
    evidence = {"t": value / std, "interval_95": interval}
    row = {kind: subject, "term": term, "name": "", "why": "", "value": value, "std": std}
    name = {"property": property_name(subject, term)} if kind == "coefficient" else {}
    return {**row, **name, "evidence": evidence, "alternatives": []}


def document(*effects: dict[str, Any], after: float = 1.0, **changes: Any) -> dict[str, Any]:
    """A refinement.json."""
    channel = {"rms_before": 1.5, "rms_after": after, "noise_rms": 1.0}
    gap = {"channels": {"ax_mps2": channel}}
    verdict = "effects-found" if effects else "no-missing-effect"
    parts = {"verdict": verdict, "disagreement": [], "effects": list(effects), "remaining": {}}
    return {**parts, "gap": {"train": gap, "test": gap}, "model": "x", **changes}


@pytest.mark.parametrize(
    ("asked", "answer", "code", "expected"),
    [
        (CLEAR, document(effect("CX:q_hat")), 0, True),
        (CLEAR, document(effect("Cm:beta^2"), effect("CX:q_hat")), 0, False),
        (CLEAR, document(), 0, False),
        (CARD, document(effect("CX:CT", 0.11)), 0, True),
        (CARD, document(effect("propulsion:inflow", 0.11)), 0, False),
        (LATE, document(timing={"controls_late_s": -0.0201}), 0, True),
        (LATE, document(timing={"controls_late_s": 0.0201}), 0, False),
        (NULL, document(timing={"controls_late_s": -0.0201}), 0, False),
        (NULL, document(), 0, True),
        (NULL, document(verdict="unexplained"), 1, False),
        (OFF, document(verdict="unexplained"), 1, True),
        (OFF, document(effect(f"{OFF.effects[0].subject}:beta^2")), 0, True),
        (OFF, document(effect(f"{OFF.effects[0].subject}:beta^2"), after=1.3), 0, False),
    ],
)
def test_an_answer_is_right_if_it_names_what_is_hidden_alone(asked, answer, code, expected):
    verdict = judge(asked, answer, code)
    assert (right(asked, verdict), verdict.faults) == (expected, ())


def test_intervals_and_parameters_are_held_against_the_truth():
    verdict = judge(CLEAR, document(effect("CX:q_hat", 0.41, 0.02)), 0)
    assert (verdict.z, verdict.inside) == ((pytest.approx(0.5),), (True,))
    assert judge(CLEAR, document(effect("CX:q_hat", 0.41, 0.002)), 0).inside == (False,)
    truth = NULL.airframe.coefficients["Cm_q"]
    rows = {"aero/Cm_q": {"value": truth + 0.005, "std": 0.01}}
    assert judge(NULL, document(parameters=rows), 0).parameters == (pytest.approx(0.5),)
    assert judge(NULL, document(parameters=rows, verdict="unexplained"), 1).parameters == ()


def test_a_document_without_its_parts_is_faulty():
    assert judge(NULL, {}, 0).faults
    assert "exit code 1 with no-missing-effect" in judge(NULL, document(), 1).faults
