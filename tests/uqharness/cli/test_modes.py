"""``uqharness modes``: keys that other programs read, a table for people, and no trim as an
answer.
"""

from __future__ import annotations

import json
import shlex

import pytest

from tests.helpers.page_checks import problems, words_of
from uqharness.cli.main import main
from uqharness.commands import simulation


def test_wind_moves_the_path_and_not_the_modes(capsys):
    observed = []
    for wind in ([], ["--wind-mps", "5", "--wind-from-deg", "180"]):
        assert main(["modes", "espaaro", "--speed-mps", "22.2", *wind, "--json"]) == 0
        observed.append(json.loads(capsys.readouterr().out))
    calm, windy = observed
    assert windy["trim"]["v_north_mps"] - calm["trim"]["v_north_mps"] > 4.9
    assert [round(m["real"], 4) for m in windy["modes"]] == [
        round(m["real"], 4) for m in calm["modes"]
    ]


def test_the_table_names_every_mode(capsys):
    assert main(["modes", "espaaro", "--speed-mps", "22.2"]) == 0
    output = capsys.readouterr().out
    assert all(name in output for name in ("short_period", "phugoid", "dutch_roll", "MIL-F-8785C"))


def test_no_trim_is_an_answer_and_not_an_error(capsys, monkeypatch):
    # The search for a trim that is none takes seconds: once for both ways of telling it.
    search, result = simulation.find_trim, []
    monkeypatch.setattr(
        simulation,
        "find_trim",
        lambda *request: result[0] if result else result.append(search(*request)) or result[0],
    )
    assert main(["modes", "espaaro", "--speed-mps", "5"]) == 1
    captured = capsys.readouterr()
    assert captured.out.startswith("no trim: ")
    assert captured.err == ""
    assert main(["modes", "espaaro", "--speed-mps", "5", "--json"]) == 1
    assert json.loads(capsys.readouterr().out)["trim"] is None


@pytest.mark.slow
def test_a_page_is_written_when_asked_and_json_stays_as_it_is(tmp_path, capsys):
    path = tmp_path / "new" / "modes.html"
    assert main(["modes", "espaaro", "--speed-mps", "22.2", "--json"]) == 0
    plain = capsys.readouterr().out
    assert (
        main(
            [
                *shlex.split("modes espaaro --speed-mps 22.2 --json --out"),
                str(path),
                "--speeds",
                "21:24",
            ]
        )
        == 0
    )
    assert capsys.readouterr().out == plain
    page = path.read_text(encoding="utf-8")
    assert problems(page) == []
    assert "uqharness modes espaaro --speed-mps 22.2 --speeds 21:24" in words_of(page)
    assert [p.name for p in path.parent.iterdir()] == ["modes.html"]


@pytest.mark.parametrize(
    ("words", "output"),
    [
        (["--out", "modes.txt"], "--out modes.txt: a page, FILE.html, is written"),
        (["--speeds", "20:30"], "--speeds: belongs to the page; add --out FILE.html"),
        (
            ["--out", "m.html", "--speeds", "30:20"],
            "--speeds 30:20: LO:HI, two true airspeeds in m/s above 0, LO below HI, is needed",
        ),
        (["--out", "m.html", "--speeds", "30"], "--speeds 30: LO:HI, two true airspeeds in m/s"),
        (
            ["--out", "m.html", "--speeds", "0:30"],
            "--speeds 0:30: LO:HI, two true airspeeds in m/s above 0",
        ),
    ],
)
def test_a_page_that_cannot_be_is_refused(tmp_path, monkeypatch, capsys, words, output):
    monkeypatch.chdir(tmp_path)
    assert main(["modes", "espaaro", "--speed-mps", "22.2", *words]) == 2
    assert output in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
