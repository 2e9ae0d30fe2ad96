"""A study's page before anything is unfolded: answer, track, p-box, effect, cells; a tick only
where a claim was tested.
"""

from __future__ import annotations

import json
import shutil
from dataclasses import replace

import pandas as pd
import pytest
from lxml import html

from tests.helpers import report_folders as folders
from tests.helpers.page_checks import page_of
from tests.helpers.report_folders import stage, study, write_document
from uqharness.campaign.rounds import KINDS
from uqharness.report.campaign import read_campaign_report
from uqharness.report.pages.study import cells_section

pytestmark = pytest.mark.usefixtures("flights_here")

ANSWER = {
    "level": "warn",
    "answer": "Yes in calm air.",
    "why": "Why: 0.1/h.",
    "lacked": "",
    "next": "Next: nothing.",
}


@pytest.fixture(scope="module")
def campaigns(tmp_path_factory):
    return folders.campaigns(tmp_path_factory.mktemp("campaigns"))


MADE: dict[str, html.HtmlElement] = {}


def page(tmp_path, campaigns, effect_test=None, **changes):
    """The page of a study with two campaigns and a refinement, as a tree that is only read: each is
    made once.
    """
    key = json.dumps([effect_test, changes])
    if key not in MADE:
        MADE[key] = build(tmp_path, campaigns, effect_test, **changes)
    return MADE[key]


def build(tmp_path, campaigns, effect_test=None, **changes):
    folder = tmp_path / "study"
    for name in ("before", "after"):
        shutil.copytree(campaigns / name, folder / name)
    done = folders.refinement()
    done["effects"][0]["test"] = effect_test
    folders.refined(folder / "refined")
    (folder / "refined" / "refinement.json").write_text(json.dumps(done))
    folders.tracks(folder)
    stages = [stage(name, "campaign", name) for name in ("before", "after")] + [
        stage("refine", "refine", "refined")
    ]
    document = (
        study(
            stages,
            before_after={"before": "before", "after": "after"},
            answer=ANSWER,
            tracks=folders.TRACKS,
        )
        | changes
    )
    return html.document_fromstring(page_of(write_document(folder, "study.json", document)))


def shrank():
    return {"gap": "shrank", "change_of_twice_log_likelihood": 40.0, "std": 5.0}


def test_the_question_the_answer_and_three_figures_stand_first(tmp_path, campaigns):
    tree = page(tmp_path, campaigns, shrank())
    assert tree.findtext(".//h1") == "Is it good enough?"
    output = [e.text_content().strip() for e in tree.findall(".//section[@class='verdict']//li")]
    assert output == ["! Yes in calm air.", "Why: 0.1/h.", "Next: nothing."]
    main = [e for e in tree.find(".//main") if isinstance(e.tag, str)]
    assert [e.get("id") for e in main[2].iter("figure")] == [
        "ground-track",
        "track-distance",
        "answer-pbox",
    ]
    assert [e.text for e in tree.findall(".//main/h2")] == [
        "The effect found",
        "Cells of wind and turbulence",
    ]


@pytest.mark.parametrize(
    ("test", "ticks"), [(shrank(), 1), (None, 0), ({**shrank(), "gap": "cannot tell"}, 0)]
)
def test_an_effect_has_a_tick_only_where_the_held_out_flight_tested_it(
    tmp_path, campaigns, test, ticks
):
    tree = page(tmp_path, campaigns, test)
    (table,) = [
        t
        for t in tree.iter("table")
        if t.findtext("caption") == "Effects that refinement added to the model."
    ]
    assert len(table.findall(".//td[@class='good']")) == ticks
    assert ("✓" in table.text_content()) == bool(ticks)


def test_inconclusive_cells_have_no_tick(tmp_path, campaigns):
    """Two flights of 150 s settle nothing."""
    tree = page(tmp_path, campaigns)
    (table,) = [
        t
        for t in tree.iter("table")
        if t.findtext("caption") == "Answer by wind, turbulence and radius."
    ]
    text = table.text_content()
    assert "inconclusive" in text
    assert "✓" not in text
    assert [e.text_content() for e in table.findall("thead//th")][2:4] == [
        "Answer before",
        "Answer after",
    ]


def test_aborted_flights_are_shown_by_kind_with_the_limit_of_their_rate(campaigns):
    sides = {when: read_campaign_report(campaigns / when) for when in ("before", "after")}
    item = sides["after"].signed[0]
    is_lost = {"loss_of_control": 3, "ground_contact": 0, "diverged": 1, "other": 0}
    after = replace(
        sides["after"],
        signed=(replace(item, aborted=is_lost, loss_upper_per_h=4.5), *sides["after"].signed[1:]),
    )
    table = cells_section(sides | {"after": after}).blocks[-1]
    assert table.head[5:] == (
        "Loss of control",
        "Ground contact",
        "Diverged",
        "Aborted flights, 95 % upper limit [1/h]",
    )
    assert table.rows[0][5:8] == ("0 / 3", "0 / 0", "0 / 1")
    assert table.rows[0][8].endswith(" / 4.5")
    single = cells_section({"": after}).blocks[-1]
    assert single.rows[0][4:] == ("3", "0", "1", "4.5")
    assert tuple(item.aborted) == KINDS == tuple(is_lost)
    other = replace(after, signed=(replace(item, aborted=is_lost | {"other": 2}),))
    assert cells_section({"": other}).blocks[-1].head[-2] == "Ended otherwise"


@pytest.mark.parametrize("content", [b"no parquet", None])
def test_damaged_tracks_are_told_and_leave_the_p_box(tmp_path, campaigns, content, monkeypatch):
    def damaged(folder):
        pd.DataFrame({"when": ["before"]}).to_parquet(folder / "tracks.parquet")
        if content is not None:
            (folder / "tracks.parquet").write_bytes(content)

    monkeypatch.setattr(folders, "tracks", damaged)
    tree = build(tmp_path, campaigns)
    assert not tree.xpath("//figure[@id='ground-track']")
    assert tree.xpath("//figure[@id='answer-pbox']")
    (heading,) = [e for e in tree.iter("h2") if e.text == "What could not be read"]
    assert "tracks.parquet" in heading.getnext().text_content()
