"""The dossier's page: its sections, what it says of what is missing, the same bytes from the same
folder.
"""

import json

import pytest

from tests.helpers import report_folders as folders
from uqharness.dossier import read_evidence
from uqharness.report.pages.dossier import dossier_of
from uqharness.report.parts import render

pytestmark = pytest.mark.usefixtures("flights_here")


def page_of(folder):
    return dossier_of(read_evidence(folder))


def complete(folder):
    """The folder with what its command writes beside."""
    (folder / "aircraft").mkdir()
    (folder / "aircraft" / "plane.xml").write_text("<fdm_config/>\n")
    return folder


@pytest.fixture
def refined(tmp_path):
    return complete(folders.refined(tmp_path / "refined"))


def test_dossier_page_sections(refined):
    dossier = page_of(refined)
    assert [s.title for s in dossier.page.sections] == [
        "Contents",
        "1. Provenance of the model",
        "2. Proof of match",
        "3. Credibility",
        "4. Statements and their assumptions",
        "5. Validity envelope",
        "6. What was not done",
        "7. Sources",
    ]
    assert dossier.missing == ()
    text = render(dossier.page)
    assert "It claims no compliance with any regulation or standard." in text
    assert "pitching moment due to roll rate squared" in text
    assert "confounded with aileron squared" in text
    assert "withdrawn" in text
    assert text.count("not assessed") >= 4
    assert "uqharness refine plane --train a --test b" in text


def test_names_with_markup_stay_text(tmp_path):
    text = render(page_of(complete(folders.identified(tmp_path / "i"))).page)
    assert "a<b>.parquet" not in text
    assert "a&lt;b&gt;.parquet" in text
    assert "Not identified, left at their initial values: aero/Cn_p." in text


def test_what_is_missing_comes_first(refined):
    (refined / "histories.parquet").unlink()
    dossier = page_of(refined)
    assert dossier.page.sections[1].title == "Missing or damaged"
    assert dossier.source is None
    assert dossier.missing == ("histories.parquet is not there, which refine writes",)
    assert "Not in the data: the folder has no time histories" in render(dossier.page)


def test_dossier_page_of_a_campaign(tmp_path):
    folder = folders.campaigns(tmp_path) / "before"
    dossier = page_of(folder)
    assert dossier.source is None
    text = render(dossier.page)
    assert "The campaign:" in text
    assert "No identification is in this folder." in text
    manifest = json.loads((folder / "manifest.json").read_text())
    manifest["state"] = "running"
    (folder / "manifest.json").write_text(json.dumps(manifest))
    assert page_of(folder).missing
