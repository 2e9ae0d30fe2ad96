"""``campaign run``: exit codes, output for people and for machines, quiet in pipes."""

from __future__ import annotations

import json

import pytest

from tests.helpers import campaign_fakes as fakes
from uqharness.campaign.manifest import read_manifest
from uqharness.cli.main import run_words
from uqharness.errors import BadInputError

pytestmark = pytest.mark.usefixtures("flights_here")


def call(*words):
    return run_words(["campaign", *map(str, words)])


def test_run_says_one_line_and_nothing_else_in_a_pipe(tmp_path, monkeypatch, capsys, caplog):
    monkeypatch.setattr("uqharness.flight.fly.fly", fakes.steady)
    path = fakes.campaign_file(tmp_path)
    (tmp_path / "plane" / "plane.xml").write_text("<fdm_config/>")
    assert call("run", path, "--out", tmp_path / "out", "--serial") == 0
    captured = capsys.readouterr()
    note, cost = caplog.messages
    assert "no sensors system: it is simulated without sensor noise" in note
    assert "192 flights (64 epistemic samples, 1 condition, 3 each), 11.2 flight h" in cost
    line, remark = captured.out.splitlines()
    assert "bounds hold at the corners only" in remark
    assert "192 flights done, none failed" in line
    assert "flight h per core h" in line
    manifest = read_manifest(tmp_path / "out")
    assert manifest["command"].startswith("uqharness campaign run ")
    assert "--serial" not in manifest["command"]


def test_run_again_resumes_and_speaks_json(flown, capsys):
    capsys.readouterr()
    assert call("run", flown / "campaign.toml", "--out", flown / "out", "--serial", "--json") == 0
    result = json.loads(capsys.readouterr().out)
    assert (result["cases"], result["done_before"], result["failed"], result["statuses"]) == (
        192,
        192,
        0,
        {"ok": 192},
    )


def test_samples_replace_the_number_of_walks(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("uqharness.flight.fly.fly", fakes.steady)
    walks = fakes.CAMPAIGN.replace(
        '"corners"', '"walk"\nsamples = 500\nwalk_rate_per_sqrt_s = 0.012'
    )
    path = fakes.campaign_file(tmp_path, walks)
    words = ("run", path, "--out", tmp_path / "out", "--serial", "--samples", "4", "--json")
    assert call(*words) == 0
    assert json.loads(capsys.readouterr().out)["cases"] == 3 * 4
    assert "--samples 4" in read_manifest(tmp_path / "out")["command"]
    with pytest.raises(BadInputError, match="draws no epistemic samples"):
        call("run", fakes.campaign_file(tmp_path), "--out", tmp_path / "o2", "--samples", "4")
    with pytest.raises(BadInputError, match="--samples 0: a whole number of at least 1 and up"):
        call(
            "run", fakes.campaign_file(tmp_path, walks), "--out", tmp_path / "o2", "--samples", "0"
        )
