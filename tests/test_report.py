"""report.html: complete in one file, true to the tables, safe, the same every time."""

from __future__ import annotations

import re
from dataclasses import replace

import pytest
from lxml import etree, html

from tests import campaign_fakes as fakes
from uqharness.campaign import run_campaign
from uqharness.campaign_spec import read_campaign
from uqharness.errors import BadInputError
from uqharness.executor import SerialExecutor
from uqharness.report import write_report

FIGURES = 6


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A complete campaign of an aircraft named like the published one, with failures and text that wants escaping."""
    root = tmp_path_factory.mktemp("report")
    fakes.campaign_file(root)
    (root / "espaaro").mkdir()
    (root / "espaaro" / "espaaro.xml").write_text("<fdm_config/>")
    (root / "campaign.toml").write_text(fakes.CAMPAIGN.replace('"plane"', '"espaaro"'))
    out = root / "out"
    command = "uqharness campaign run 'a<b>&\"c\".toml' --out out"
    spec = read_campaign(root / "campaign.toml")
    run_campaign(spec, out, executor=SerialExecutor(), fly=fakes.hazardous_but_alive, command=command)
    write_report(out)
    return out


@pytest.fixture(scope="module")
def page(folder):
    return (folder / "report.html").read_text(encoding="utf-8")


def test_it_is_well_formed_and_has_every_section(page):
    tree = html.document_fromstring(page)
    assert [item.text for item in tree.iter("h2")] == [
        "What was asked", "P-boxes of the median errors", "Excursions per flight hour", "Failed flights", "Where it came from",
    ]  # fmt: skip
    assert len(tree.findall(".//table")) == 3
    assert all(table.find(".//th") is not None for table in tree.iter("table"))
    # Tags that were opened are closed: an XML parser agrees once the few void elements are made so.
    strict = re.sub(r"<(meta[^>]*)>", r"<\1/>", page.replace("<!DOCTYPE html>", ""))
    etree.fromstring(strict.encode())


def test_nothing_is_fetched_from_anywhere(page):
    tree = html.document_fromstring(page)
    for element in tree.iter():
        for name, value in element.attrib.items():
            if name.rpartition("}")[2] in ("src", "href", "xlink:href", "data", "srcset"):
                assert value.startswith("#"), (element.tag, name, value)
    assert not re.search(r"@import|url\((?!#)|<script|<link|<iframe|<img", page)


def test_all_figures_are_there_with_their_words(folder, page):
    tree = html.document_fromstring(page)
    figures = tree.findall(".//figure")
    assert len(figures) == FIGURES
    for figure in figures:
        assert figure.find(".//svg").get("aria-label")
        text = " ".join(figure.itertext())
        assert "probability of at most" in text
        assert "p-box (envelope)" in text
        assert re.search(r"\[(m|m/s)\]", text)
    files = sorted((folder / "figures").glob("*.svg"))
    assert len(files) == FIGURES
    for file in files:
        assert etree.parse(str(file)).getroot().tag == "{http://www.w3.org/2000/svg}svg"
        assert "var(--" not in file.read_text()
        assert not re.search(r"#0[1-5]0[1-5]0[1-5]", file.read_text()), "a placeholder colour was left"


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


def test_another_aircraft_or_wind_has_no_published_flight(tmp_path):
    spec = fakes.small_spec(tmp_path, 2)
    run_campaign(spec, tmp_path / "out", executor=SerialExecutor(), fly=fakes.steady)
    write_report(tmp_path / "out")
    page = (tmp_path / "out" / "report.html").read_text()
    assert "9.41" not in page


def test_text_from_outside_is_escaped(page):
    assert "a&lt;b&gt;&amp;" in page
    assert "a<b>" not in page


def test_ids_are_unique_across_the_figures(page):
    tree = html.document_fromstring(page)
    shared = {}
    for number, svg in enumerate(tree.findall(".//figure/svg")):
        for element in svg.iter():
            if element.get("clip-path"):
                shared.setdefault(element.get("clip-path"), set()).add(number)
    assert shared
    assert all(len(users) == 1 for users in shared.values())


def test_the_verdict_comes_first_and_agrees_with_the_tables(folder, page):
    report = write_report(folder)
    assert page.index('class="verdict"') < page.index("What was asked")
    assert report.verdict[1] in html.document_fromstring(page).text_content()
    text = " ".join(report.verdict)
    assert text.startswith("Hardest condition flown: 3 m/s wind and moderate turbulence.")
    assert re.search(
        r"Median cross-track error of a typical 150 s flight, .*: at least [\d.]+ m in truth, .* measured", text
    )
    assert re.search(
        r"published flight's 9.41 m lies (below|within|above) what single flights measured, [\d.]+ to", text
    )
    assert re.search(r"beyond 15 m per flight hour: [\d.]+ at the best corner, [\d.]+ at the worst", text)
    assert re.search(r"Of 192 flights, \d+ failed", text)
    rows = (folder / "excursions.csv").read_text().splitlines()
    header = rows[0].split(",")
    horizontal = [dict(zip(header, row.split(","), strict=True)) for row in rows[1:] if ",15,horizontal," in row]
    assert len(horizontal) == 64
    worst = max(float(row["rate_upper_per_h"]) for row in horizontal)
    assert f"{worst:.3g} at the worst" in text
    assert [row["worst"] for row in horizontal].count("1") == 1


def test_it_reads_on_a_phone_and_in_the_dark(page):
    assert 'name="viewport" content="width=device-width' in page
    assert "prefers-color-scheme: dark" in page
    assert "overflow-x: auto" in page
    assert "minmax(min(100%, 24rem), 1fr)" in page
    assert not re.search(r"<svg[^>]*style=\"[^\"]*width", page)


def test_same_folder_same_bytes(folder, page):
    before = {file.name: file.read_bytes() for file in (folder / "figures").iterdir()}
    write_report(folder)
    assert (folder / "report.html").read_text(encoding="utf-8") == page
    assert {file.name: file.read_bytes() for file in (folder / "figures").iterdir()} == before


def test_many_conditions_are_tabled_and_the_first_drawn(tmp_path):
    spec = fakes.small_spec(tmp_path, 1, wind_mps=(0.0, 1.0, 2.0, 3.0, 4.0))
    spec = replace(spec, epistemic=spec.epistemic.model_copy(update={"method": "none", "bounds": None}))
    run_campaign(spec, tmp_path / "out", executor=SerialExecutor(), fly=fakes.steady)
    report = write_report(tmp_path / "out")
    assert len(report.figures) == 4 * FIGURES
    assert "Further conditions, not drawn: 1;" in report.path.read_text()


def test_an_incomplete_or_empty_folder_is_refused(tmp_path, folder):
    with pytest.raises(BadInputError, match="not a campaign folder"):
        write_report(tmp_path)
    manifest = (folder / "manifest.json").read_text()
    (tmp_path / "manifest.json").write_text(manifest.replace('"complete"', '"interrupted"'))
    with pytest.raises(BadInputError, match="not complete; finish it first"):
        write_report(tmp_path)


def test_all_flights_failed_is_still_a_report(tmp_path):
    spec = fakes.small_spec(tmp_path, 1)
    run_campaign(spec, tmp_path / "out", executor=SerialExecutor(), fly=fakes.diverges)
    report = write_report(tmp_path / "out")
    assert report.figures == ()
    assert "64 failed" in " ".join(report.verdict)
