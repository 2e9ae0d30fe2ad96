"""``uqharness dossier``: the file, the exit codes, the JSON."""

import json

import pytest

from tests.helpers import report_folders as folders
from uqharness.cli.main import main


@pytest.fixture
def refined(tmp_path):
    folder = folders.refined(tmp_path / "refined")
    (folder / "aircraft").mkdir()
    (folder / "aircraft" / "plane.xml").write_text("<fdm_config/>\n")
    return folder


def test_json_and_another_place(refined, tmp_path, capsys):
    out = tmp_path / "evidence.html"
    assert main(["dossier", str(refined), "--out", str(out), "--json"]) == 0
    output = json.loads(capsys.readouterr().out)
    assert output["dossier"] == str(out)
    assert output["missing"] == []
    assert output["not_in_the_data"]["2.c.9"]
    assert {"file", "sha256", "command", "version"} == set(output["sources"][0])
    assert out.is_file()
    assert not (refined / "dossier.html").exists()


def test_an_incomplete_folder_gives_a_dossier_and_1(refined, capsys):
    (refined / "histories.parquet").unlink()
    assert main(["dossier", str(refined)]) == 1
    assert "histories.parquet is not there" in capsys.readouterr().out
    assert (refined / "dossier.html").is_file()


def test_dossier_refuses_bad_input(refined, tmp_path, capsys):
    assert main(["dossier", str(tmp_path / "nothing")]) == 2
    (tmp_path / "other").mkdir()
    assert main(["dossier", str(tmp_path / "other")]) == 2
    assert "no results of this program" in capsys.readouterr().err
    assert main(["dossier", str(refined), "--out", str(tmp_path / "x.pdf")]) == 2
    assert "a file whose name ends with .html is needed" in capsys.readouterr().err
