"""The page of a study: verdict, campaigns over each other, stages."""

from __future__ import annotations

import json
import shutil

import pytest
from lxml import html

from tests.helpers import report_folders as folders
from tests.helpers.page_checks import page_of, words_of
from tests.helpers.report_folders import stage, study, write_document

pytestmark = pytest.mark.usefixtures("flights_here")


@pytest.fixture
def refined(tmp_path):
    return folders.refined(tmp_path / "refined")


@pytest.fixture(scope="module")
def campaigns(tmp_path_factory):
    return folders.campaigns(tmp_path_factory.mktemp("campaigns"))


def test_a_study_with_two_campaigns_over_each_other(tmp_path, campaigns, refined):
    for place in (campaigns / "before", campaigns / "after", refined):
        shutil.copytree(place, tmp_path / "study" / place.name)
    stages = [stage(name, "campaign", name) for name in ("before", "after")]
    stages.append(stage("refine", "refine", refined.name, exit=1))
    stages.append(stage("bounds", "bounds", "gone"))
    stages.append(stage("later", "sensitivity", "later", state="waiting"))
    pair = {"before": "before", "after": "after"}
    folder = write_document(tmp_path / "study", "study.json", study(stages, before_after=pair))
    page = page_of(folder)
    words = words_of(page)
    assert (
        words.index("It holds.")
        < words.index("Is it good enough?")
        < words.index("P-boxes before (dashed")
    )
    tree = html.document_fromstring(page)
    overlays = [e for e in tree.iter("figure") if e.get("id").startswith("before-after-")]
    assert len(overlays) == 6
    for figure in overlays:
        assert len(json.loads(figure.findtext("script"))["boxes"]) == 2
    assert "The campaigns differ in flights" in words
    assert "ran, the answer is no" in words
    # That a stage ran proves nothing.
    (stages,) = [
        t
        for t in tree.iter("table")
        if t.findtext("caption") == "Stages in the order in which they run."
    ]
    assert not stages.xpath(".//td[@class='good']")
    assert "Pitching moment due to roll rate squared" in words
    # A stage whose folder cannot be read is named, not left out in silence.
    assert "What could not be read" in words
    assert "model-form.json" in words
    assert "cd" * 32 in words


@pytest.mark.parametrize(
    ("state", "stage_state", "output"),
    [("running", "running", "is not finished: 0 of 1"), ("failed", "failed", "fly failed")],
)
def test_a_study_that_is_not_done_says_so_first(tmp_path, state, stage_state, output):
    folder = write_document(
        tmp_path,
        "study.json",
        study([stage("fly", "fly", "fly", state=stage_state, error="no wind")], state=state),
    )
    first = html.document_fromstring(page_of(folder)).find(".//section[@class='verdict']//li")
    assert output in first.text_content()
    assert first.get("class") in ("warn", "bad")
