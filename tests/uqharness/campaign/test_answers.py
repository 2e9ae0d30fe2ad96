"""How far a question is answered, in lines and as plain types."""

from __future__ import annotations

from pathlib import Path

import pytest

from uqharness.campaign.shards import Answer, lines, read_answers
from uqharness.errors import BadInputError

MANIFEST = {"format": 1, "state": "complete"}
HEAD = "condition,epistemic_id,radius_m,acceptable_per_h,answer,reason,hours,distance\n"
ANSWERS = [
    Answer(
        condition=condition,
        radius_m=15.0,
        acceptable_per_h=2.0,
        answer=answer,
        reason=reason,
        hours=hours,
    )
    for condition, answer, reason, hours in (
        ("3 m/s none", "yes", "", 12.3456),
        ("5 m/s none", "open", "too few flights", 4.0),
        ("7 m/s none", "yes", "", 1.0),
    )
]


def test_a_summary_and_a_line_a_condition():
    assert lines(ANSWERS) == [
        "at most 2 excursions per hour beyond 15 m? 2 yes, 1 inconclusive",
        "  3 m/s none: yes, 12.35 flight h",
        "  5 m/s none: inconclusive (too few flights), 4 flight h",
        "  7 m/s none: yes, 1 flight h",
    ]
    assert lines([]) == []
    assert ANSWERS[1].as_json()["reason"] == "too few flights"


def test_decisions_are_read_for_whole_cells_alone(tmp_path: Path):
    rows = "3 m/s none,all,15,2,yes,,12.5,horizontal\n3 m/s none,000000,15,2,no,x,1,horizontal\n"
    (tmp_path / "decisions.csv").write_text(HEAD + rows)
    (answer,) = read_answers(tmp_path, MANIFEST)
    assert (answer.condition, answer.answer, answer.hours) == ("3 m/s none", "yes", 12.5)


def test_statements_tell_of_the_smallest_radius(tmp_path: Path):
    rows = "a,,25,2,yes,,1,horizontal\na,,15,2,no,,1,horizontal\na,,15,2,open,,1,3d\n"
    (tmp_path / "statements.csv").write_text(HEAD + rows)
    assert [(x.radius_m, x.answer) for x in read_answers(tmp_path, MANIFEST)] == [(15.0, "no")]


def test_nothing_flown_is_no_answer_and_a_damaged_table_is_refused(tmp_path: Path):
    assert read_answers(tmp_path, MANIFEST) == []
    (tmp_path / "statements.csv").write_text(HEAD + "a,,wide,2,yes,,1,horizontal\n")
    with pytest.raises(BadInputError, match=r"statements\.csv:2: radius_m is 'wide'"):
        read_answers(tmp_path, MANIFEST)


def test_a_statement_tells_how_many_flights_may_have_an_excursion(tmp_path: Path):
    head = HEAD.replace("distance\n", "distance,flight_share_upper\n")
    rows = (
        "a,,15,2,yes,,1,horizontal,0.00746\nb,,15,2,open,clusters beyond the carried"
        " limit,1,horizontal,\n"
    )
    (tmp_path / "statements.csv").write_text(head + rows)
    assert lines(read_answers(tmp_path, MANIFEST))[1:] == [
        (
            "  a: yes, 1 flight h, at most 0.75 % of flights with an excursion at the worst corner"
            " (95 % limit)"
        ),
        "  b: inconclusive (clusters beyond the carried limit), 1 flight h",
    ]
