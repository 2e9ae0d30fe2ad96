"""``campaign status | report``: what they say and their exit codes."""

from __future__ import annotations

import json
import shutil

import pytest

from uqharness.campaign.manifest import read_manifest, write_manifest
from uqharness.campaign.store import run_lock
from uqharness.campaign.tables import read_cases
from uqharness.cli.main import run_words
from uqharness.errors import BadInputError
from uqharness.simulator.aircraft import find_aircraft

pytestmark = pytest.mark.usefixtures("flights_here")


def call(*words):
    return run_words(["campaign", *map(str, words)])


def test_status_of_complete_running_and_interrupted(flown, capsys):
    capsys.readouterr()
    out = flown / "out"
    assert call("status", out) == 0
    output = capsys.readouterr().out
    assert "complete, 192 of 192 flights done" in output
    assert "engine jsbsim, because " in output
    write_manifest(out, read_manifest(out) | {"state": "running", "cases": 200})
    assert call("status", out, "--json") == 1
    result = json.loads(capsys.readouterr().out)
    (answer,) = result.pop("answers")
    assert (answer["condition"], answer["answer"], answer["hours"]) == (
        "3 m/s moderate",
        "open",
        8.0,
    )
    assert (result.pop("engine"), bool(result.pop("engine_why"))) == ("jsbsim", True)
    # Bounds given as numbers have no confidence to join.
    assert (result.pop("joint"), result.pop("joint_level")) == ([], None)
    assert result == {
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


CAMPAIGN = """
[campaign]
aircraft = "plane"
mission = "loiter"
seed = 1
engine = "jsbsim"

[aleatory]
flights = 3
duration_s = 2
burn_in_s = 0
turbulence = "moderate"

[epistemic]
method = "none"
"""


def test_a_report_flies_the_worst_and_the_median_flight_again_once(tmp_path, capsys, caplog):
    shutil.copytree(find_aircraft("espaaro").folder, tmp_path / "plane")
    (tmp_path / "campaign.toml").write_text(CAMPAIGN)
    out = tmp_path / "out"
    assert call("run", tmp_path / "campaign.toml", "--out", out, "--serial") == 0
    errors = read_cases(out, read_manifest(out)).set_index("case_id")["cross_track_median_m"]
    xml = tmp_path / "plane" / "espaaro.xml"
    text = xml.read_text()
    xml.write_text(text + "<!-- changed -->")
    capsys.readouterr()
    assert call("report", out, "--json") == 0
    assert json.loads(capsys.readouterr().out)["flown_again"] == []
    assert "the page has no new ground track: " in caplog.text
    xml.write_text(text)
    for expected in ([errors.idxmax(), errors.sort_values().index[1]], []):
        assert call("report", out, "--json") == 0
        assert json.loads(capsys.readouterr().out)["flown_again"] == expected
    assert len(list((out / "rerun").glob("*/record.parquet"))) == 2


def test_salvage_refuses_a_size_without_its_campaign(tmp_path):
    with pytest.raises(BadInputError, match="--hours and --samples need --campaign"):
        call("salvage", tmp_path, "--hours", "1")
