"""``uqharness diff``: exit code 0 where nothing differs, 1 where something does, 2 for what cannot
be asked.
"""

from __future__ import annotations

import json
import shutil

import pytest

from tests.helpers.places import ROOT
from uqharness.cli.main import main


@pytest.fixture
def other(tmp_path):
    """The E-SPAARO with 3 % more pitching moment of inertia."""
    out = shutil.copytree(ROOT / "aircraft" / "espaaro", tmp_path / "espaaro")
    path = out / "espaaro.xml"
    text = path.read_text(encoding="utf-8")
    start, end = text.index("<iyy"), text.index("</iyy>")
    specific = text[text.index(">", start) + 1 : end]
    path.write_text(
        text[: end - len(specific)] + repr(1.03 * float(specific)) + text[end:], encoding="utf-8"
    )
    return out


def test_a_heavier_nose_shows_in_words_numbers_and_a_page(other, tmp_path, capsys):
    page = tmp_path / "diff.html"
    words = ["diff", "espaaro", str(other), "--speed-mps", "22"]
    assert main([*words, "--out", str(page), "--json"]) == 1
    html = page.read_text(encoding="utf-8")
    assert "The models differ in" in html
    assert html.count('class="chart"') >= 4
    assert "first in Iyy" in html
    document = json.loads(capsys.readouterr().out)
    assert document["differ"] is True
    assert document["differences"][0]["channel"] == "Iyy"
    assert document["differences"][0]["share_of_range"] == pytest.approx(0.03, rel=0.01)
    assert document["differences"][0]["likeliest"] == [f"B {document['terms'][0]['b_where']}"]


def test_a_tolerance_is_ones_own_choice(other, capsys):
    assert main(["diff", "espaaro", str(other), "--speed-mps", "22", "--tolerance", "0.5"]) == 0
    assert "these flights do not show them" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "output"),
    [
        (["espaaro", "espaaro"], "give --speed-mps"),
        (["espaaro", "nowhere", "--speed-mps", "22"], "nowhere"),
        pytest.param(
            ["espaaro", "espaaro", "--speed-mps", "300"], "no steady flight", marks=pytest.mark.slow
        ),
        (["espaaro", "espaaro", "--speed-mps", "22", "--out", "x.txt"], "FILE.html"),
        (["HEAD:no/such", "espaaro", "--speed-mps", "22"], "HEAD:no/such"),
    ],
)
def test_diff_refuses_bad_input(words, output, capsys):
    assert main(["diff", *words]) == 2
    assert output in capsys.readouterr().err


def test_an_environment_that_cannot_fly_is_bad_input(tmp_path, capsys):
    python = tmp_path / "python"
    python.write_text("#!/bin/sh\necho no JSBSim here >&2\nexit 1\n")
    python.chmod(0o755)
    assert main(["diff", "espaaro", "espaaro", "--speed-mps", "22", "--python-b", str(python)]) == 2
    assert "no JSBSim here" in capsys.readouterr().err
