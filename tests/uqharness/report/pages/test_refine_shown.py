"""What a refinement did to the intervals: widths and coverage drawn and told, undefined where they
are not known.
"""

from __future__ import annotations

import re

from lxml import etree

from tests.helpers import report_folders as folders
from uqharness.report.pages.refinement import interval_section, mission_section
from uqharness.report.parts import Figures, Table, Words
from uqharness.results.refinement import ResidualTables

KNOWN = {"width_before": 0.04, "width_after": 0.03, "coverage_before": 0.97, "coverage_after": 0.9}
ROW = KNOWN | {"coverage_std_before": 0.01, "coverage_std_after": None}


def tables(**parts):
    return ResidualTables.model_validate({"channels": {}, "coefficients": {}} | parts)


def intervals(**rows):
    return tables(intervals={"reason": None, "confidence": 0.95, "coefficients": rows})


def test_widths_and_coverage_are_drawn():
    section = interval_section(intervals(Cm=ROW, CX=dict.fromkeys(ROW)), "p-")
    (figures,) = (block for block in section.blocks if isinstance(block, Figures))
    (table,) = (block for block in section.blocks if isinstance(block, Table))
    assert (figures.file, table.key) == ("intervals", True)
    assert [figure.name for figure in figures.items] == ["p-interval-widths", "p-interval-coverage"]
    assert "Cm 0.75." in figures.items[0].svg
    coverage = etree.fromstring(str(figures.items[1].svg))
    # Two marks for the coefficient whose coverage is known, with limits where the standard error
    # is.
    assert len(coverage.findall(".//circle")) == 2
    lines = [
        e.get("d") for e in coverage.iter("path") if e.get("class") in ("line second", "line first")
    ]
    ends = [[float(v) for v in re.findall(r"[ML]([\d.]+)", d)] for d in lines]
    lengths = [last - first for first, last in ends]
    assert lengths[0] > 10.0
    assert lengths[1:] == [0.0]
    cells = [[cell.text for cell in row] for row in table.cells]
    assert cells[0] == ["Cm", "0.04", "0.03", "97.0 ± 1.0", "90.0 ± undefined"]
    assert cells[1] == ["CX", *["undefined"] * 4]


def test_why_it_is_not_shown_is_said(tmp_path):
    for section in (
        interval_section(tables()),
        interval_section(tables(intervals={"reason": "no noise"})),
        mission_section(tmp_path, tables()),
    ):
        (words,) = section.blocks
        assert isinstance(words, Words)
        assert words.text.startswith("Not shown: ")


def test_the_mission_is_drawn_into_one_file_and_its_table_is_key(tmp_path):
    root = folders.campaigns(tmp_path)
    pbox = {
        "mission": "loiter",
        "corners": 64,
        "flights_per_corner": 2,
        "duration_s": 30.0,
        "folders": ["before", "after"],
    }
    pbox |= {"before": {"failed": 0}, "after": {"failed": 1}}
    section = mission_section(root, tables(pbox=pbox))
    assert "Failed flights: 0 before, 1 after." in section.blocks[0].text
    (figures,) = (block for block in section.blocks if isinstance(block, Figures))
    (table,) = (block for block in section.blocks if isinstance(block, Table))
    assert figures.file == "pbox"
    assert table.key
    alone = mission_section(root, tables(pbox=pbox | {"folders": ["before"]}))
    assert "nothing to compare" in alone.blocks[0].text
