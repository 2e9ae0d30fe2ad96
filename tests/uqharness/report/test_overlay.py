"""Two campaigns over each other: drawn where both have the same, told where they are not the same
flights.
"""

from __future__ import annotations

from dataclasses import replace

import pytest

from tests.helpers import report_folders as folders
from uqharness.report.campaign import overlay_section, read_campaign_report
from uqharness.report.parts import Figures, Table

pytestmark = pytest.mark.usefixtures("flights_here")

NAMES = {"before": "one", "after": "two"}


@pytest.fixture(scope="module")
def pair(tmp_path_factory):
    root = folders.campaigns(tmp_path_factory.mktemp("campaigns"))
    return [read_campaign_report(root / name) for name in ("before", "after")]


def test_each_quantity_in_common_has_a_figure_and_a_row(pair):
    section = overlay_section(*pair, NAMES)
    (figures,) = (block for block in section.blocks if isinstance(block, Figures))
    (table,) = (block for block in section.blocks if isinstance(block, Table))
    assert len(figures.items) == len(table.rows) == len(pair[0].findings)
    assert all(len(figure.cursor["boxes"]) == 2 for figure in figures.items)
    assert [box["name"] for box in figures.items[0].cursor["boxes"]] == ["after", "before"]
    # A width is a fact, and no tick stands beside it.
    changes = [row[-1] for row in table.rows]
    assert all(change.level == ("warn" if change.small == "wider" else "") for change in changes)
    fewer = replace(pair[1], findings=pair[1].findings[:1])
    (left,) = (
        block
        for block in overlay_section(pair[0], fewer, NAMES).blocks
        if isinstance(block, Figures)
    )
    assert len(left.items) == 1
    nothing = overlay_section(pair[0], replace(pair[1], findings=()), NAMES)
    assert [block.text for block in nothing.blocks] == [
        "The two campaigns share no quantity in the same condition."
    ]
