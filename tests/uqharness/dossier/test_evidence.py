"""What is read from a folder, and what is said of one that is incomplete or damaged."""

import json
import shutil
from pathlib import Path

import pytest

from sysid.foreign.regular_files import file_sha256
from tests.helpers import report_folders as folders
from uqharness.dossier.evidence import read_evidence
from uqharness.errors import BadInputError

pytestmark = pytest.mark.usefixtures("flights_here")


@pytest.fixture
def chain(tmp_path):
    """A study's folder with an identification and a refinement."""
    root = tmp_path / "study"
    for name, make in (("identify", folders.identified), ("zz-refine", folders.refined)):
        result = make(root / name)
        (result / "aircraft").mkdir()
        (result / "aircraft" / "plane.xml").write_text("<fdm_config/>\n")
    (root / "flights").mkdir()
    (root / "flights" / "a.bin").write_bytes(b"a log")
    outputs = {"flights/a.bin": file_sha256(root / "flights" / "a.bin")}
    stages = [
        folders.stage("import", "import", "flights", outputs=outputs),
        folders.stage("refine", "refine", "zz-refine"),
        folders.stage("identify", "identify", "identify"),
    ]
    (root / "study.json").write_text(json.dumps(folders.study(stages)))
    return root


def test_steps_in_the_order_of_the_study(chain):
    result = read_evidence(chain)
    assert [(s.kind, s.place) for s in result.steps] == [
        ("refine", "zz-refine"),
        ("identify", "identify"),
        ("study", "."),
    ]
    assert result.missing == []
    files = {s.file: s for s in result.sources}
    assert files["flights/a.bin"].sha256 == file_sha256(chain / "flights" / "a.bin")
    assert files["identify/fit.json"].command.startswith("uqharness identify")
    assert "identify/aircraft/plane.xml" in files
    assert len(result.histories(result.of("refine")[0])) == 2


def test_without_a_study_a_refinement_follows_what_it_began_from(tmp_path):
    folders.identified(tmp_path / "fit")
    for name, began in (("a-second", "b-first/aircraft/plane"), ("b-first", "fit/aircraft")):
        result = folders.refined(tmp_path / name)
        document = folders.refinement(
            command=f"uqharness refine results/{began} --train a --test b"
        )
        (result / "refinement.json").write_text(json.dumps(document))
    assert [s.place for s in read_evidence(tmp_path).steps] == ["fit", "b-first", "a-second"]


def damage(root: Path, kind: str) -> str:
    """Do it, and give words that the dossier has to say."""
    if kind == "another log":
        (root / "flights" / "a.bin").write_bytes(b"another")
        return "flights/a.bin is not the file that was written"
    if kind == "no log":
        (root / "flights" / "a.bin").unlink()
        return "flights/a.bin is not there"
    if kind == "no folder":
        shutil.rmtree(root / "zz-refine")
        return "stage refine: its folder zz-refine is not there"
    if kind == "no mark":
        (root / "zz-refine" / "refinement.json").unlink()
        return "zz-refine/refinement.json is missing, but model.diff"
    if kind == "torn mark":
        path = root / "identify" / "fit.json"
        path.write_text(path.read_text()[:200])
        return "identify/fit.json"
    if kind == "no histories":
        (root / "identify" / "histories.parquet").unlink()
        return "identify/histories.parquet is not there"
    document = json.loads((root / "study.json").read_text())
    document["stages"][1] |= {"state": "failed", "error": "no trim"}
    (root / "study.json").write_text(json.dumps(document))
    return "stage refine is failed: no trim"


@pytest.mark.parametrize(
    "kind",
    ["another log", "no log", "no folder", "no mark", "torn mark", "no histories", "failed stage"],
)
def test_damaged_evidence_is_named(chain, kind):
    words = damage(chain, kind)
    result = read_evidence(chain)
    assert any(words in line for line in result.missing), result.missing
    assert not any(str(chain) in line for line in result.missing)


def test_torn_histories_are_said_when_they_are_read(chain):
    path = chain / "identify" / "histories.parquet"
    path.write_bytes(path.read_bytes()[:100])
    result = read_evidence(chain)
    assert result.histories(result.of("identify")[0]) == []
    assert any("identify/histories.parquet" in line for line in result.missing)


def test_a_folder_of_something_else(tmp_path):
    (tmp_path / "notes.txt").write_text("notes")
    with pytest.raises(
        BadInputError, match=r"no results of this program; looked for study\.json, fit\.json"
    ):
        read_evidence(tmp_path)
    with pytest.raises(BadInputError, match="is no folder"):
        read_evidence(tmp_path / "notes.txt")
