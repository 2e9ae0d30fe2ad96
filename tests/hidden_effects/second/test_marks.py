"""The second examination's marks can say no: made-up answers and tables that pass, and ones that do
not.
"""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from tests.hidden_effects.effects import Effect
from tests.hidden_effects.second.drawn import DEVELOPMENT, drawn
from tests.hidden_effects.second.marks import covered, marks
from tests.hidden_effects.second.verdict import judge
from tests.hidden_effects.second.wrongs import Wrong
from tests.hidden_effects.test_answers import effect, refinement

NULL = drawn(DEVELOPMENT, 8)
CLEAR = replace(
    NULL, kind="clear", entries=("CX:q_hat",), effects=(Effect("CX", "q_hat", 0.4),), t=(20.0,)
)
CARD = replace(NULL, kind="card", wrong=Wrong("propulsion:thrust_scale", 0.10), t=(40.0,))
LATE = replace(NULL, kind="card", wrong=Wrong("record:delay", -0.02), t=(12.0,))
OFF = replace(drawn(DEVELOPMENT, 14), t=(40.0,))


def named(key, value, std, reach=1.96):
    return {
        **effect(key, value, std),
        "evidence": {"t": value / std, "interval_95": [value - reach * std, value + reach * std]},
    }


def test_a_named_effect_and_a_missed_one():
    found = judge(CLEAR, refinement(named("CX:q_hat", 0.41, 0.02)), 0)
    assert (found.named, found.spurious, found.inside, found.left_out) == ((True,), 0, (True,), 0)
    assert found.z == (pytest.approx(0.5),)
    assert judge(CLEAR, refinement(named("CX:q_hat", 0.41, 0.002)), 0).inside == (False,)
    wrong = judge(CLEAR, refinement(named("Cm:beta^2", 0.1, 0.01)), 0)
    # A hidden effect of |t| 20 of which the answer says nothing was dropped.
    assert (wrong.named, wrong.spurious, wrong.left_out) == ((False,), 1, 1)
    weak = replace(CLEAR, t=(6.0,))
    assert judge(weak, refinement(), 0).left_out == 0
    large = effect(
        "CX:de", alternatives=tuple((f"CX:{k}", False) for k in ("q_hat", "alpha*de", "V_rel"))
    )
    assert judge(CLEAR, refinement(large), 0).named == (False,)
    second = judge(
        CLEAR, refinement(named("Cm:beta^2", 0.1, 0.01), named("CX:q_hat", 0.4, 0.02)), 0
    )
    assert (second.named, second.spurious) == ((True,), 1)


def test_a_wrong_card_is_named_by_what_is_the_same():
    assert judge(CARD, refinement(named("propulsion:thrust_scale", 0.11, 0.02)), 0).card is True
    alias = judge(CARD, refinement(named("CX:CT", 0.11, 0.02)), 0)
    assert (alias.card, alias.spurious, alias.inside) == (True, 0, (True,))
    assert alias.z == (pytest.approx(0.5),)
    place = replace(NULL, kind="card", wrong=Wrong("sensor.accelerometer:place_x", 0.2), t=(40.0,))
    assert judge(place, refinement(named("mass:cg_x", -0.2, 0.02)), 0).z == (pytest.approx(0.0),)
    assert judge(place, refinement(named("mass:cg_x", 0.2, 0.02)), 0).inside == (False,)
    missed = judge(CARD, refinement(named("propulsion:inflow", 0.11, 0.02)), 0)
    assert (missed.card, missed.spurious, missed.left_out) == (False, 1, 1)
    assert judge(NULL, refinement(), 0).card is None


def test_a_clock_is_named_by_the_timing_that_was_put_right():
    said = {**refinement(), "timing": {"controls_late_s": -0.0201}}
    found = judge(LATE, said, 0)
    assert (found.card, found.effects, found.spurious) == (True, 1, 0)
    assert judge(LATE, {**refinement(), "timing": {"controls_late_s": 0.0201}}, 0).card is False
    assert judge(LATE, refinement(), 0).card is False
    # Where nothing is wrong with the clock, to move it is a false effect.
    assert judge(NULL, said, 0).spurious == 1


def test_parameters_count_where_the_answer_vouches_for_them():
    truth = NULL.airframe.coefficients
    own = {f"aero/{k}": {"value": truth[k] + 0.5 * 0.01, "std": 0.01} for k in ("Cm_q", "Cl_p")}
    assert judge(NULL, {**refinement(), "parameters": own}, 0).parameters == pytest.approx(
        (0.5, 0.5)
    )
    assert judge(NULL, {**refinement(verdict="unexplained"), "parameters": own}, 1).parameters == ()
    assert (
        judge(
            NULL, {**refinement(), "parameters": {"aero/Cm_q": {"value": 0.0, "std": None}}}, 0
        ).parameters
        == ()
    )


def unexplained(**place):
    candidates = [
        {"coefficient": "CX", "term": t, "t": 4.0, "leaves": 1.2} for t in ("beta^2", "de", "dr^2")
    ]
    told = {
        "channel": "ax_mps2",
        "from_s": 1.0,
        "to_s": 2.0,
        "from_Hz": 0.1,
        "to_Hz": 2.0,
        "candidates": candidates,
        **place,
    }
    remaining = {
        "unexplained": True,
        "where": [{"coefficient": "CX", "term": "beta^2", "t": 12.0}],
        "place": told,
    }
    return {**refinement(verdict="unexplained"), "remaining": remaining}


def test_something_else_is_told_with_its_place():
    found = judge(OFF, unexplained(), 1)
    assert (found.fair, found.placed, found.left_out) == (True, True, 0)
    assert judge(OFF, unexplained(from_Hz=None), 1).placed is False
    assert judge(OFF, unexplained(from_Hz=None, reason="by chance"), 1).placed is True
    assert judge(OFF, unexplained(candidates=[]), 1).placed is False
    strong = [
        {"coefficient": "CX", "term": t, "t": 30.0, "leaves": 1.2} for t in ("beta^2", "de", "dr^2")
    ]
    assert judge(OFF, unexplained(candidates=strong), 1).left_out == 2
    subject = OFF.hidden[0].subject
    assert judge(OFF, refinement(effect(f"{subject}:beta^2")), 0).fair
    assert not judge(OFF, refinement(effect(f"{subject}:beta^2"), after=1.3), 0).fair
    assert not judge(OFF, refinement(), 0).fair


def test_what_the_file_shows_and_does_not_list_is_left_out():
    withdrawn = {**refinement(), "withdrawn": [named("Cl:beta*CT", 0.2, 0.01)]}
    assert judge(NULL, withdrawn, 0).left_out == 1
    assert (
        judge(
            NULL, {**refinement(), "best_refused": {"effect": "CZ/q_hat", "t": -11.0, "why": ""}}, 0
        ).left_out
        == 1
    )
    assert (
        judge(
            NULL, {**refinement(), "best_refused": {"effect": "CZ/q_hat", "t": -3.0, "why": ""}}, 0
        ).left_out
        == 0
    )


def row(kind="clear", air="calm", **change):
    one = {
        "kind": kind,
        "air": air,
        "commit": "a",
        "case": "c",
        "named": "1",
        "card": "",
        "effects": 1,
        "spurious": 0,
        "z": "0.5",
        "inside": "1",
        "parameters": " ".join(["0.5"] * 19 + ["2.4"]),
        "left_out": 0,
        "placed": "",
        "fair": "",
        "apart": "0.001",
        "cpu_s": 12.0 if air == "calm" else 50.0,
        "peak_MB": 800.0,
        "faults": "",
    }
    return {**one, **change}


def whole():
    rows = []
    for kind, count, change in (
        ("clear", 80, {}),
        ("marginal", 60, {}),
        ("weak", 10, {"named": "0", "effects": 0, "inside": "", "z": ""}),
        ("null", 50, {"named": "", "effects": 0, "inside": "", "z": ""}),
        ("card", 40, {"named": "", "card": 1}),
        (
            "off-form",
            12,
            {
                "named": "",
                "fair": 1,
                "placed": 1,
                "effects": 0,
                "inside": "",
                "z": "",
                "parameters": "",
            },
        ),
    ):
        rows += [row(kind, "light" if i % 3 == 0 else "calm", **change) for i in range(count)]
    chosen = [i for i, r in enumerate(rows) if r["inside"]]
    for air in ("calm", "light"):
        for i in [i for i in chosen if rows[i]["air"] == air][::15]:
            rows[i] = {**rows[i], "inside": "0"}
    return rows


def spoilt(kind, count, **change):
    rows, left = whole(), count
    for i, r in enumerate(rows):
        if left and (kind is None or r["kind"] == kind):
            rows[i], left = {**r, **change}, left - 1
    return rows


def test_a_draw_that_reaches_every_mark():
    reached, text = marks(whole())
    assert reached, text
    assert "MISSED" not in text
    assert "|t| 3 to 4 named 0 of 10" in text


@pytest.mark.parametrize(
    ("kind", "passes", "fails", "change", "words"),
    [
        ("clear", 1, 2, {"named": "0"}, "clear effects"),
        ("marginal", 12, 13, {"named": "0"}, "marginal effects"),
        ("null", 1, 2, {"effects": 1}, "nulls"),
        ("card", 3, 4, {"card": 0}, "wrong cards"),
        ("off-form", 1, 2, {"fair": 0}, "off the catalogue"),
        ("clear", 3, 4, {"spurious": 1}, "false effects"),
        ("clear", 0, 20, {"inside": "0"}, "intervals of effects"),
        (None, 0, 120, {"parameters": " ".join(["3.0"] * 20)}, "intervals of parameters"),
        ("null", 0, 1, {"left_out": 1}, "leaves out"),
        ("off-form", 0, 1, {"placed": 0}, "channel, interval"),
        ("null", 0, 1, {"apart": "0.2"}, "compare"),
        ("null", 0, 1, {"faults": "no gap"}, "contract"),
        (None, 5, 90, {"cpu_s": 900.0}, "CPU seconds"),
        (None, 5, 90, {"peak_MB": 3000.0}, "peak memory"),
    ],
)
def test_each_mark_says_no(kind, passes, fails, change, words):
    reached, text = marks(spoilt(kind, passes, **change))
    assert reached, text
    reached, text = marks(spoilt(kind, fails, **change))
    assert not reached
    assert any(words in line for line in text.splitlines() if line.startswith("MISSED")), text


def test_the_commits_that_met_the_cases_are_told():
    assert "commits" not in marks(whole())[1]
    reached, text = marks(spoilt("null", 50, commit="b"))
    assert reached
    assert "met by 2 commits: 202 by a, 50 by b" in text


def test_intervals_that_are_too_wide_miss_as_well():
    rows = [{**r, "inside": r["inside"].replace("0", "1")} for r in whole()]
    assert not marks(rows)[0]
    assert covered(19, 20)
    assert not covered(17, 20)
    assert covered(98, 100)
    assert not covered(99, 100)
    rows = [{**r, "parameters": r["parameters"].replace("2.4", "0.1")} for r in whole()]
    assert not marks(rows)[0]


def test_a_draw_that_is_not_whole_reaches_nothing_and_a_part_is_judged_in_proportion():
    some = [r for r in whole() if r["kind"] != "card"]
    reached, text = marks(some)
    assert not reached
    assert "wrong cards named as such: 0 of 0" in text
    assert marks(some, whole=False)[0]
    assert not marks(spoilt("clear", 30, named="0"), whole=False)[0]
    assert math.isfinite(len(text))
