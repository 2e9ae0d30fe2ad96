"""The campaign commands: exit codes, output for people and for machines, quiet in pipes."""

from __future__ import annotations

import argparse
import io
import json

import pytest
from rich.console import Console

from tests.helpers import campaign_fakes as fakes
from uqharness.campaign.folder.manifest import read_manifest, write_manifest
from uqharness.campaign.folder.store import run_lock
from uqharness.campaign.run import Progress
from uqharness.cli import campaign as campaign_commands
from uqharness.cli.progress import ProgressView, clock, describe
from uqharness.errors import BadInputError


def call(*words):
    parser = argparse.ArgumentParser(prog="uqharness")
    campaign_commands.register(parser.add_subparsers(dest="command", required=True))
    args = parser.parse_args(["campaign", *map(str, words)])
    return args.handler(args)


@pytest.fixture
def flown(tmp_path, monkeypatch):
    monkeypatch.setattr("uqharness.flight.fly.fly", fakes.steady)
    path = fakes.campaign_file(tmp_path)
    assert call("run", path, "--out", tmp_path / "out", "--serial") == 0
    return tmp_path


def test_run_says_one_line_and_nothing_else_in_a_pipe(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("uqharness.flight.fly.fly", fakes.steady)
    assert call("run", fakes.campaign_file(tmp_path), "--out", tmp_path / "out", "--serial") == 0
    captured = capsys.readouterr()
    (cost,) = captured.err.splitlines()
    assert "192 flights (64 epistemic samples, 1 condition, 3 each), 11.2 flight h" in cost
    (line,) = captured.out.splitlines()
    assert "192 flights done, none failed" in line
    assert "flight h per core h" in line
    manifest = read_manifest(tmp_path / "out")
    assert manifest["command"].startswith("uqharness campaign run ")
    assert "--serial" not in manifest["command"]


def test_run_again_resumes_and_speaks_json(flown, capsys):
    capsys.readouterr()
    assert call("run", flown / "campaign.toml", "--out", flown / "out", "--serial", "--json") == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["cases"], found["done_before"], found["failed"], found["statuses"]) == (192, 192, 0, {"ok": 192})


def test_hours_replace_the_number_of_flights(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("uqharness.flight.fly.fly", fakes.steady)
    path = fakes.campaign_file(tmp_path)
    assert call("run", path, "--out", tmp_path / "out", "--serial", "--hours", "0.05", "--json") == 0
    assert json.loads(capsys.readouterr().out)["cases"] == 2 * 64


def test_samples_replace_the_number_of_walks(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("uqharness.flight.fly.fly", fakes.steady)
    walks = fakes.CAMPAIGN.replace('"corners"', '"walk"\nsamples = 500\nwalk_rate_per_sqrt_s = 0.012')
    path = fakes.campaign_file(tmp_path, walks)
    words = ("run", path, "--out", tmp_path / "out", "--serial", "--samples", "4", "--json")
    assert call(*words) == 0
    assert json.loads(capsys.readouterr().out)["cases"] == 3 * 4
    assert "--samples 4" in read_manifest(tmp_path / "out")["command"]
    with pytest.raises(BadInputError, match="draws no epistemic samples"):
        call("run", fakes.campaign_file(tmp_path), "--out", tmp_path / "o2", "--samples", "4")
    with pytest.raises(BadInputError, match="must be from 1"):
        call("run", fakes.campaign_file(tmp_path, walks), "--out", tmp_path / "o2", "--samples", "0")


def test_status_of_complete_running_and_interrupted(flown, capsys):
    capsys.readouterr()
    out = flown / "out"
    assert call("status", out) == 0
    assert "complete, 192 of 192 flights done" in capsys.readouterr().out
    write_manifest(out, read_manifest(out) | {"state": "running", "cases": 200})
    assert call("status", out, "--json") == 1
    found = json.loads(capsys.readouterr().out)
    (answer,) = found.pop("answers")
    assert (answer["condition"], answer["answer"], answer["hours"]) == ("3 m/s moderate", "open", 8.0)
    assert found == {"state": "interrupted", "cases": 200, "done": 192, "failed": 0, "statuses": {"ok": 192}}
    assert call("status", out) == 1
    assert "resume with: uqharness campaign run" in capsys.readouterr().err
    with run_lock(out):
        assert call("status", out) == 1
    assert "running, 192 of 200" in capsys.readouterr().out


def test_report(flown, capsys):
    capsys.readouterr()
    assert call("report", flown / "out") == 0
    assert "report.html: written, with 6 figures" in capsys.readouterr().out
    assert call("report", flown / "out", "--json") == 0
    assert len(json.loads(capsys.readouterr().out)["figures"]) == 6


def test_bad_input_is_for_the_command_line_to_print(tmp_path):
    for words in (("status", tmp_path), ("report", tmp_path), ("run", tmp_path / "no.toml", "--out", tmp_path / "o")):
        with pytest.raises(BadInputError):
            call(*words)
    path = fakes.campaign_file(tmp_path)
    with pytest.raises(BadInputError, match="workers = 0"):
        call("run", path, "--out", tmp_path / "o", "--workers", "0")


@pytest.mark.parametrize("verb", ["run", "status", "report", "merge", "rerun"])
def test_each_verb_has_help_with_an_example(verb, capsys):
    with pytest.raises(SystemExit) as left:
        call(verb, "--help")
    assert left.value.code == 0
    text = capsys.readouterr().out
    assert f"uqharness campaign {verb} " in text
    assert "--json" in text


def test_progress_on_a_terminal_and_silence_elsewhere():
    state = Progress(cases=100, done=60, done_before=0, failed=2, flown_s=36000.0, elapsed_s=30.0, workers=2)
    assert describe(state) == "0:20 to go, 600 flight h per core h, 2 failed"
    assert clock(3725.4) == "1:02:05"
    for terminal in (True, False):
        drawn = io.StringIO()
        console = Console(file=drawn, force_terminal=terminal, width=100, legacy_windows=False)
        with ProgressView(console) as view:
            view.update(state)
        assert ("60/100" in drawn.getvalue()) is terminal
        assert bool(drawn.getvalue()) is terminal
