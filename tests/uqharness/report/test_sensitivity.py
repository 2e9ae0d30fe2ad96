"""A campaign's sensitivity on its page and as files."""

from __future__ import annotations

import csv
import shutil

import pytest
from lxml import html

from tests.helpers import report_folders as folders
from tests.helpers.page_checks import page_of
from uqharness.cli.main import main

pytestmark = pytest.mark.usefixtures("flights_here")


@pytest.fixture(scope="module")
def campaigns(tmp_path_factory):
    return folders.campaigns(tmp_path_factory.mktemp("campaigns"))


def test_sensitivity_joins_the_page_once_it_was_computed(tmp_path, campaigns):
    folder = tmp_path / "copy"
    shutil.copytree(campaigns / "before", folder)
    assert ">Sensitivity<" not in page_of(folder)
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
