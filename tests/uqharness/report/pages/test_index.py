"""`uqharness report`: what a folder is, is told by its files; what is none is refused."""

from __future__ import annotations

import json

import pytest

from tests.helpers import report_folders as folders
from tests.helpers.page_checks import problems
from uqharness.cli.main import main
from uqharness.errors import BadInputError
from uqharness.report.write import KINDS, write_report


@pytest.fixture
def identified(tmp_path):
    return folders.identified(tmp_path / "identified")


def test_report_command(identified, capsys):
    assert main(["report", str(identified), "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["kind"] == "identify"
    assert result["report"] == str(identified / "report.html")
    first = (identified / "report.html").read_bytes()
    assert main(["report", str(identified)]) == 0
    assert (identified / "report.html").read_bytes() == first
    assert capsys.readouterr().out.endswith(f"Report: {identified / 'report.html'}\n")


def test_a_folder_of_nothing_is_refused_with_what_was_looked_for(tmp_path, capsys):
    assert main(["report", str(tmp_path)]) == 2
    output = capsys.readouterr().err
    assert all(name in output for name, _ in KINDS)
    assert main(["report", str(tmp_path / "gone")]) == 2
    assert "is no folder" in capsys.readouterr().err


def test_a_folder_of_next_flight_is_told_apart_from_a_folder_of_nothing(tmp_path, capsys):
    (tmp_path / "next-flight.json").write_text("{}")
    assert main(["report", str(tmp_path)]) == 2
    output = capsys.readouterr().err
    assert "run uqharness next-flight again" in output
    assert "no results to report on" not in output


@pytest.mark.parametrize("text", ["", "[]", '{"effects": []}', "{"])
def test_a_spoilt_document_is_refused_by_name(tmp_path, text):
    (tmp_path / "refinement.json").write_text(text)
    with pytest.raises(BadInputError, match=r"refinement\.json.*run its command again"):
        write_report(tmp_path)


def test_page_checks_find_faults(identified):
    page = write_report(identified).path.read_text(encoding="utf-8")
    for old, new, output in (
        ("<figcaption>", "<figcaption><img src='http://example.org/a.png'/>", "fetches"),
        ('role="img" ', "", "no label"),
        ("<caption>", "<caption/><b>", "not well formed"),
        ("[deg/s]", "", "without a unit"),
        ('scope="col"', "", "without a head"),
        ("undefined", "nan", "'nan' in the text"),
        ("<h3>", "<h4>", "not well formed"),
        ('<span class="sign"', "<span", "colour alone"),
        ('id="parameters"', 'id="fit-history-0-V_mps"', "twice"),
    ):
        assert old in page
        assert any(output in text for text in problems(page.replace(old, new))), output
