"""``campaign status | report``: what they say and their exit codes."""

from __future__ import annotations

import json
from types import SimpleNamespace

import pytest

from uqharness.campaign.manifest import read_manifest, write_manifest
from uqharness.campaign.store import run_lock
from uqharness.campaign.tables import read_cases
from uqharness.cli.main import run_words
from uqharness.commands import campaign as verbs
from uqharness.errors import BadInputError

pytestmark = pytest.mark.usefixtures("flights_here")


def call(*words):
    return run_words(["campaign", *map(str, words)])


def test_status_of_complete_running_and_interrupted(flown, capsys):
    capsys.readouterr()
    out = flown / "out"
    assert call("status", out) == 0
    said = capsys.readouterr().out
    assert "complete, 192 of 192 flights done" in said
    assert "engine jsbsim, because " in said
    write_manifest(out, read_manifest(out) | {"state": "running", "cases": 200})
    assert call("status", out, "--json") == 1
    found = json.loads(capsys.readouterr().out)
    (answer,) = found.pop("answers")
    assert (answer["condition"], answer["answer"], answer["hours"]) == (
        "3 m/s moderate",
        "open",
        8.0,
    )
    assert (found.pop("engine"), bool(found.pop("engine_why"))) == ("jsbsim", True)
    # Bounds given as numbers have no confidence to join.
    assert (found.pop("joint"), found.pop("joint_level")) == ([], None)
    assert found == {
        "state": "interrupted",
        "cases": 200,
        "done": 192,
        "failed": 0,
        "statuses": {"ok": 192},
    }
    assert call("status", out) == 1
    assert "resume with: uqharness campaign run" in capsys.readouterr().out
    with run_lock(out):
        assert call("status", out) == 1
    assert "running, 192 of 200" in capsys.readouterr().out


def test_report(flown, capsys):
    capsys.readouterr()
    assert call("report", flown / "out", "--no-tracks") == 0
    printed = capsys.readouterr().out
    assert "6 figures in " in printed
    assert printed.rstrip().endswith(f"Report: {flown / 'out' / 'report.html'}")
    assert call("report", flown / "out", "--json", "--no-tracks") == 0
    found = json.loads(capsys.readouterr().out)
    assert (len(found["figures"]), found["flown_again"]) == (6, [])


def test_a_report_flies_the_worst_and_the_median_flight_again_where_that_is_cheap(
    flown, capsys, caplog, monkeypatch
):
    asked = []

    def again(folder, case):
        if case == "refused":
            raise BadInputError("the aircraft has changed")
        asked.append(case)
        return case

    monkeypatch.setattr(verbs, "rerun_case", again)
    monkeypatch.setattr(verbs, "draw_rerun", lambda found: ())
    # The page itself is the last test's.
    page = SimpleNamespace(
        path=flown / "report.html", figures=(), verdict=(), damaged=(), warnings=()
    )
    monkeypatch.setattr(verbs, "write_campaign_report", lambda folder: page)
    out = flown / "out"
    capsys.readouterr()
    # 64 corners fly the same three flights, so that the ends of the table are the answer.
    rows = read_cases(out, read_manifest(out)).sort_values(
        ["cross_track_median_m", "case_id"], ascending=[False, True]
    )
    cases = rows["case_id"].tolist()
    monkeypatch.setattr(verbs, "MAX_REFLOWN_S", 1e6)
    assert call("report", out, "--json") == 0
    assert (
        json.loads(capsys.readouterr().out)["flown_again"]
        == asked
        == [cases[0], cases[len(cases) // 2]]
    )
    monkeypatch.setattr(verbs, "track_cases", lambda frame: ("refused",))
    assert call("report", out) == 0
    assert "the page has no new ground track: the aircraft has changed" in caplog.text
    asked.clear()
    monkeypatch.setattr(verbs, "track_cases", lambda frame: tuple(cases[:2]))
    monkeypatch.setattr(verbs, "MAX_REFLOWN_S", 1.0)
    assert call("report", out) == 0
    monkeypatch.setattr(verbs, "MAX_REFLOWN_S", 1e6)
    (out / "rerun" / "x").mkdir(parents=True)
    (out / "rerun" / "x" / "record.parquet").touch()
    assert call("report", out) == 0
    assert asked == []


@pytest.mark.parametrize("verb", ["status", "report", "merge"])
def test_a_folder_of_something_else_is_bad_input(tmp_path, verb):
    with pytest.raises(BadInputError):
        call(verb, tmp_path)
