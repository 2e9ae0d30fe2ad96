"""``uqharness fly``: what it says of a flight, and the properties that it takes."""

from __future__ import annotations

import json
import shlex

import pytest

from tests.helpers.page_checks import problems, words_of
from uqharness.cli.main import build_parser, main
from uqharness.cli.request_command import request_of
from uqharness.errors import BadInputError
from uqharness.requests.simulation import FlyRequest


def test_the_summary_is_one_line_or_json(tmp_path, capsys):
    words = [
        *shlex.split("fly espaaro --duration-s 1 --rate-hz 10 --out"),
        str(tmp_path / "a" / "flight.csv"),
    ]
    assert main(words) == 0
    assert "11 rows, 1.0 s" in capsys.readouterr().out
    assert main([*words, "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert set(result) >= {"status", "reason", "flown_s", "rows", "out", "left_out", "autopilot"}
    assert result["autopilot"] is None
    assert (result["status"], result["rows"]) == ("ok", 11)


def request(*words: str) -> FlyRequest:
    arguments = build_parser().parse_args(["fly", "espaaro", *words])
    return request_of(FlyRequest, arguments)


def test_settings_are_properties_with_finite_numbers():
    words = [part for text in ("p/q=-10", "uq/active=1", "p/q=-9") for part in ("--set", text)]
    assert request(*words).properties == {"p/q": -9.0, "uq/active": 1.0}
    for text in ("aero/Cm_q", "=1", "aero/Cm_q=", "aero/Cm_q=nan", "aero/Cm_q=ten"):
        with pytest.raises(BadInputError, match=f"--set {text}: PROP=VALUE"):
            request("--set", text)


def test_a_page_is_written_beside_the_record_when_asked(tmp_path, capsys):
    page = tmp_path / "flight.html"
    words = [
        *shlex.split("fly espaaro --duration-s 60 --rate-hz 10 --wind-mps 3 --out"),
        str(tmp_path / "flight.parquet"),
    ]
    assert main([*words, "--page", str(page), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["status"] == "ok"
    text = page.read_text(encoding="utf-8")
    assert problems(text) == []
    output = words_of(text)
    assert "Wind 3 m/s from 270 deg, no turbulence, without sensor noise, seed 0." in output
    assert "commanded circle, radius 120 m" in output
    assert "--page" not in output
