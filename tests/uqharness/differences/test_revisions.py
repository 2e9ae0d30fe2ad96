"""An aircraft as it stood in a revision of a git repository."""

from __future__ import annotations

import shutil
import subprocess

import pytest

from tests.helpers.places import ROOT
from uqharness.differences import aircraft_at
from uqharness.differences.revisions import named_revision
from uqharness.errors import BadInputError

pytestmark = pytest.mark.skipif(shutil.which("git") is None, reason="git is not installed")


@pytest.fixture
def repository(tmp_path, monkeypatch):
    """Two revisions of an aircraft, the working copy being a third."""
    shutil.copytree(ROOT / "aircraft" / "espaaro", tmp_path / "models" / "espaaro")
    card = tmp_path / "models" / "espaaro" / "airframe.toml"

    def git(*words):
        own = ["-c", "user.name=x", "-c", "user.email=x@example.org", "-c", "commit.gpgsign=false"]
        subprocess.run(["git", *own, *words], cwd=tmp_path, check=True, capture_output=True)

    git("init", "-q")
    for number in (1, 2, 3):
        card.write_text(
            f"# revision {number}\n" + card.read_text(encoding="utf-8"), encoding="utf-8"
        )
        if number < 3:
            git("add", "-A")
            git("commit", "-q", "-m", str(number))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def first_line(aircraft) -> str:
    return (aircraft.folder / "airframe.toml").read_text(encoding="utf-8").splitlines()[0]


def test_revisions_and_the_working_copy(repository, tmp_path, monkeypatch):
    assert first_line(aircraft_at("HEAD~1:models/espaaro", tmp_path / "one")) == "# revision 1"
    assert first_line(aircraft_at("HEAD:models/espaaro", tmp_path / "two")) == "# revision 2"
    assert first_line(aircraft_at("models/espaaro", tmp_path / "three")) == "# revision 3"
    monkeypatch.chdir(repository / "models")
    assert first_line(aircraft_at("HEAD:espaaro", tmp_path / "four")) == "# revision 2"


@pytest.mark.parametrize("text", ["nowhere:models/espaaro", "HEAD:models/none"])
def test_what_is_not_there_is_told(repository, tmp_path, text):
    with pytest.raises(BadInputError, match="REVISION:FOLDER"):
        aircraft_at(text, tmp_path / "x")


@pytest.mark.parametrize(
    ("text", "found"),
    [("HEAD~1:a/b", ("HEAD~1", "a/b")), ("c172p", None), ("C:/x", None), ("HEAD:", None)],
)
def test_which_words_name_a_revision(text, found):
    assert named_revision(text) == found
