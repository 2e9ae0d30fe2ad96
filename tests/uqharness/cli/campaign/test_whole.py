"""``campaign verify | salvage``: exit codes and keys, of a whole folder and of a damaged one."""

from __future__ import annotations

import json

import pytest

from uqharness.cli.main import run_words

pytestmark = pytest.mark.usefixtures("flights_here")


def call(*words):
    return run_words(["campaign", *map(str, words)])


def test_a_whole_folder_is_whole_and_a_changed_table_is_named(flown, capsys):
    out = flown / "out"
    capsys.readouterr()
    assert call("verify", out, "--json") == 0
    found = json.loads(capsys.readouterr().out)
    assert set(found) == {"folder", "whole", "complete", "items", "shards"}
    assert (found["whole"], found["complete"]) == (True, True)
    with (out / "excursions.csv").open("a") as table:
        table.write("\n")
    assert call("verify", out) == 1
    said = capsys.readouterr().out
    assert f"{out}: NOT whole" in said
    assert "excursions.csv: " in said


def test_salvage_writes_again_what_was_damaged(flown, capsys):
    out = flown / "out"
    table = out / "excursions.csv"
    before = table.read_bytes()
    table.write_bytes(before + b"\n")
    capsys.readouterr()
    assert call("salvage", out, "--json") == 0
    found = json.loads(capsys.readouterr().out)
    assert set(found) == {
        "folder",
        "kept",
        "flown",
        "missing",
        "statuses",
        "rewritten",
        "aside",
        "shards",
    }
    assert (found["kept"], found["flown"]) == (192, 0)
    assert table.read_bytes() == before
