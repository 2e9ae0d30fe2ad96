"""report.html: complete in one file, true to the tables, safe, the same every time."""

from __future__ import annotations

import csv
import json
import re

import pyarrow.parquet as pq
import pytest
from lxml import etree, html

from tests.helpers import campaign_fakes as fakes
from tests.helpers.page_checks import problems
from uqharness.campaign.manifest import read_manifest, write_manifest
from uqharness.campaign.processes import SerialExecutor
from uqharness.campaign.read_spec import read_campaign
from uqharness.campaign.run import run_campaign
from uqharness.errors import BadInputError
from uqharness.report.write import write_campaign_report, write_report

pytestmark = pytest.mark.usefixtures("flights_here")

FIGURES = 6


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A complete campaign of an aircraft named like the published one, with failures and text that
    wants escaping.
    """
    root = tmp_path_factory.mktemp("report")
    fakes.campaign_file(root)
    (root / "espaaro").mkdir()
    (root / "espaaro" / "espaaro.xml").write_text(
        '<fdm_config><property value="0">sensor/V-mps</property></fdm_config>'
    )
    (root / "campaign.toml").write_text(fakes.CAMPAIGN.replace('"plane"', '"espaaro"'))
    out = root / "out"
    command = "uqharness campaign run 'a<b>&\"c\".toml' --out out"
    spec = read_campaign(root / "campaign.toml")
    run_campaign(
        spec, out, executor=SerialExecutor(), fly=fakes.hazardous_but_alive, command=command
    )
    write_report(out)
    return out


@pytest.fixture(scope="module")
def page(folder):
    return (folder / "report.html").read_text(encoding="utf-8")


def test_it_has_every_section_and_nothing_wrong(page):
    assert problems(page) == []
    tree = html.document_fromstring(page)
    assert [item.text for item in tree.iter("h2")] == [
        "Question",
        "Where the answer is yes, no or inconclusive",
        "P-boxes of the median errors",
        "Ground track",
        "Supportable claims",
        "Excursions per flight hour",
        "Failed flights",
        "Engine",
        "Provenance",
    ]
    assert len(tree.findall(".//table")) == 6


def test_all_figures_are_there_with_their_words(folder, page):
    tree = html.document_fromstring(page)
    figures = tree.findall(".//figure")
    assert len(figures) == FIGURES
    for figure in figures:
        assert "Half of the flights stay below" in figure.find(".//svg").get("aria-label")
        text = " ".join(figure.itertext())
        assert "cumulative probability" in text
        assert "p-box (envelope)" in text
        assert re.search(r"\[(m|m/s)\]", text)
    files = sorted((folder / "figures").glob("*.svg"))
    assert len(files) == FIGURES
    for file in files:
        assert etree.parse(str(file)).getroot().tag == "{http://www.w3.org/2000/svg}svg"
        assert "var(" not in file.read_text(), "a colour that drawing programs do not know"


def test_the_published_flight_is_marked_on_the_measured_figures_only(page):
    tree = html.document_fromstring(page)
    marks = {}
    for figure in tree.findall(".//figure"):
        caption = figure.find("figcaption").text
        marks[caption.split(",")[0], "sensors" in caption] = re.findall(
            r"published flight, ([\d.]+) m", " ".join(figure.itertext())
        )
    assert marks == {
        ("Median cross-track error", True): ["9.41"],
        ("Median altitude error", True): ["2.16"],
        ("Median speed error", True): ["0.61"],
        ("Median cross-track error", False): [],
        ("Median altitude error", False): [],
        ("Median speed error", False): [],
    }


def test_text_from_outside_is_escaped(page):
    assert "a&lt;b&gt;&amp;" in page
    assert "a<b>" not in page


def test_the_cursor_names_the_corner_behind_each_side(folder, page):
    """What the script reads out is what pbox.parquet has."""
    tree = html.document_fromstring(page)
    table = pq.read_table(folder / "pbox.parquet").to_pandas()
    figure = tree.get_element_by_id("pbox-cross-track-median-m-3mps-moderate")
    (box,) = json.loads(figure.findtext("script"))["boxes"]
    rows = table[
        (table["metric"] == "cross_track_median_m") & (table["condition"] == "3 m/s moderate")
    ]
    assert box["value"] == pytest.approx(rows["value"].tolist(), rel=1e-4)
    assert box["lower"] == pytest.approx(rows["lower"].tolist(), abs=1e-4)
    assert box["upper"] == pytest.approx(rows["upper"].tolist(), abs=1e-4)
    cases = (
        pq.read_table(folder / "cases.parquet")
        .to_pandas()
        .drop_duplicates("epistemic_id")
        .set_index("epistemic_id")
    )
    for side, corner in ((box["at_least"], "corner_lower"), (box["at_most"], "corner_upper")):
        for place, name in zip(side, rows[corner], strict=True):
            levels = {
                c: cases.loc[name, f"level_{c}"] for c in ("CX", "CY", "CZ", "Cl", "Cm", "Cn")
            }
            assert box["corners"][place] == " ".join(
                f"{c}{'+' if v else '−'}" for c, v in levels.items()
            )
    # Every corner that may be named is drawn under that name, unless none of its flights is known.
    drawing = {e.get("data-corner") for e in figure.iter("path")} - {None}
    assert {f"0.{k}" for k in (*box["at_least"], *box["at_most"])} & drawing


def test_the_grid_says_what_the_statements_say(folder, page):
    tree = html.document_fromstring(page)
    grids = [t for t in tree.iter("table") if t.findtext("caption").startswith("Excursions beyond")]
    signed = list(csv.DictReader((folder / "statements.csv").read_text().splitlines()))
    assert len(grids) == 2
    for grid, radius in zip(grids, ("15", "25"), strict=True):
        (answer,) = [
            r["answer"] for r in signed if (r["radius_m"], r["distance"]) == (radius, "horizontal")
        ]
        (cell,) = grid.findall("tbody/tr/td")
        sign, level = {"yes": ("✓", "good"), "no": ("✕", "bad"), "open": ("?", "warn")}[answer]
        assert cell.findtext("span") == sign
        assert cell.get("class") == level
        assert cell.text_content().split()[1] == answer
        assert "per h [" in cell.text_content()


def test_walks_are_not_called_corners(tmp_path, page):
    walks = fakes.CAMPAIGN.replace('"corners"', '"walk"\nsamples = 3\nwalk_rate_per_sqrt_s = 0.012')
    spec = read_campaign(fakes.campaign_file(tmp_path, walks))
    run_campaign(spec, tmp_path / "out", executor=SerialExecutor(), fly=fakes.steady)
    report = write_report(tmp_path / "out")
    text = re.sub(
        r"<(script|style|svg)\b.*?</\1>|<[^>]*>",
        " ",
        report.path.read_text(encoding="utf-8"),
        flags=re.DOTALL,
    )
    assert "best to worst walk" in text
    assert "Worst walk [1/h]" in text
    assert "corner" not in text.lower()
    assert "Worst corner [1/h]" in page


def test_an_incomplete_or_empty_folder_is_refused(tmp_path, folder):
    with pytest.raises(BadInputError, match="not a campaign folder"):
        write_campaign_report(tmp_path)
    write_manifest(tmp_path, read_manifest(folder) | {"state": "interrupted"})
    with pytest.raises(BadInputError, match="not complete; finish it first"):
        write_campaign_report(tmp_path)


def test_all_flights_failed_is_still_a_report(tmp_path):
    spec = fakes.small_spec(tmp_path, 1)
    run_campaign(spec, tmp_path / "out", executor=SerialExecutor(), fly=fakes.diverges)
    report = write_report(tmp_path / "out")
    assert problems(report.path.read_text(encoding="utf-8")) == []
    assert report.figures == ()
    assert "64 failed" in " ".join(report.verdict)
