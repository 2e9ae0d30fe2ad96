"""A campaign's sensitivity on its page and as files."""

from __future__ import annotations

import csv
import shutil

import pytest
from lxml import etree, html

from tests.helpers import report_folders as folders
from tests.helpers.page_checks import page_of
from uqharness.cli.main import main
from uqharness.report.campaign import condition_sections

pytestmark = pytest.mark.usefixtures("flights_here")


@pytest.fixture(scope="module")
def campaigns(tmp_path_factory):
    return folders.campaigns(tmp_path_factory.mktemp("campaigns"))


def test_sensitivity_joins_the_page_once_it_was_computed(tmp_path, campaigns):
    folder = tmp_path / "copy"
    shutil.copytree(campaigns / "before", folder)
    assert "Which uncertainty makes the width" not in page_of(folder)
    assert main(["sensitivity", str(folder), "--json"]) == 0
    tree = html.document_fromstring(page_of(folder))
    table = csv.DictReader((folder / "sensitivity.csv").read_text().splitlines())
    rows = [row for row in table if row["metric"] == "cross_track_median_m"]
    assert len(rows) == 6
    for row in rows:
        ends = f"{float(row['share_min']):.2g} to {float(row['share_max']):.2g}"
        cells = tree.xpath(
            "//tr[th='median cross-track error'][td[1]=$name]/td[2]", name=row["coefficient"]
        )
        assert [cell.text for cell in cells] == [ends]
    assert tree.get_element_by_id("sensitivity-cross-track-median-m") is not None


def test_each_condition_has_a_file_of_what_can_be_compared(tmp_path):
    head = (
        "wind_mps,turbulence,metric,coefficient,share_min,share_max,share_low,share_high,reason\n"
    )
    rows = (
        "0,none,cross_track_median_m,CX,0.1,0.2,0.0,0.3,\n0,none,cross_track_median_m,CY,0.7,0.8,,,\n0,none,speed_median_mps,CX,,,,,no"
        " width\n3,light,speed_median_mps,CX,,,,,no width\n"
    )
    (section,) = condition_sections((head + rows).encode())
    (figures,) = section.blocks
    assert figures.file == "sensitivity-0mps-none"
    assert [figure.name for figure in figures.items] == ["sensitivity-cross-track-median-m"]
    names = [
        e.text
        for e in etree.fromstring(str(figures.items[0].svg)).iter("text")
        if e.text in ("CX", "CY")
    ]
    assert names == ["CY", "CX"]
