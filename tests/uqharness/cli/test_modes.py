"""``uqharness modes``: keys that other programs read, a table for people, and no trim as an answer."""

from __future__ import annotations

import json
import math

import pytest

from uqharness.cli.main import main
from uqharness.cli.modes import _measured
from uqharness.flight import Assessment


def test_json_has_the_contracted_keys(capsys):
    assert main(["modes", "espaaro", "--speed-mps", "22.2", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert {"V_mps", "alpha_deg", "elevator_deg", "throttle_pct", "thrust_N", "rpm"} <= set(found["trim"])
    assert {m["name"] for m in found["modes"]} == {"short_period", "phugoid", "dutch_roll", "roll", "spiral"}
    assert all(set(m) == {"name", "real", "imag", "wn_radps", "zeta"} for m in found["modes"])


def test_wind_moves_the_path_and_not_the_modes(capsys):
    seen = []
    for wind in ([], ["--wind-mps", "5", "--wind-from-deg", "180"]):
        assert main(["modes", "espaaro", "--speed-mps", "22.2", *wind, "--json"]) == 0
        seen.append(json.loads(capsys.readouterr().out))
    calm, windy = seen
    assert windy["trim"]["v_north_mps"] - calm["trim"]["v_north_mps"] > 4.9
    assert [round(m["real"], 4) for m in windy["modes"]] == [round(m["real"], 4) for m in calm["modes"]]


def test_the_table_names_every_mode(capsys):
    assert main(["modes", "espaaro", "--speed-mps", "22.2"]) == 0
    said = capsys.readouterr().out
    assert all(name in said for name in ("short_period", "phugoid", "dutch_roll", "MIL-F-8785C"))


@pytest.mark.parametrize(
    ("criterion", "value", "unit", "text"),
    [
        ("time to double", math.inf, "s", "stable"), ("time to double", 12.34, "s", "time to double 12.3 s"),
        ("time constant", math.nan, "s", "time constant undefined"), ("damping", 0.456, "1", "damping 0.456"),
    ],
)  # fmt: skip
def test_a_criterion_is_told_in_words(criterion, value, unit, text):
    assert _measured(Assessment("spiral", criterion, value, unit, 1, "3.3.1.3")) == text


def test_no_trim_is_an_answer_and_not_an_error(capsys):
    assert main(["modes", "espaaro", "--speed-mps", "5"]) == 1
    captured = capsys.readouterr()
    assert captured.out.startswith("no trim: ")
    assert captured.err == ""
    assert main(["modes", "espaaro", "--speed-mps", "5", "--json"]) == 1
    assert json.loads(capsys.readouterr().out)["trim"] is None
