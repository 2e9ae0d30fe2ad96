"""Views of results for notebooks: well formed, numbers legible, foreign text harmless."""

from __future__ import annotations

import math
from xml.etree import ElementTree

import pandas as pd
import pytest

from sysid.display import MAX_ROWS, cell_text, frame_table, rows_table, view


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (1.23456789, "1.235"),
        (math.nan, ""),
        (True, "True"),
        (3, "3"),
        (math.inf, "inf"),
        ("a", "a"),
    ],
)
def test_numbers_in_cells(value: object, text: str):
    assert cell_text(value) == text


def test_a_view_is_well_formed_and_escapes_what_logs_say():
    evil = "<script>alert(1)</script>"
    table = rows_table([{evil: evil, "estimate": 0.5}, {evil: "b", "estimate": math.nan}])
    shown = view(evil, table, facts={evil: evil}, warnings=[evil])
    assert "<script" not in shown
    tree = ElementTree.fromstring(shown)
    assert [cell.text for cell in tree.iter("td")] == [evil, "0.5", "b", None]
    assert [item.text for item in tree.iter("li")] == [evil]
    # The same check sees a text that is not escaped.
    assert "<script" in view("a flight", evil)


def test_empty_parts_leave_nothing():
    assert rows_table([]) == ""
    assert view("a flight") == "<div><p><b>a flight</b></p></div>"


def test_long_tables_are_cut():
    shown = frame_table(pd.DataFrame({"a": range(1000)}))
    assert "1000 rows" in shown
    assert shown.count("<tr") <= MAX_ROWS + 3
