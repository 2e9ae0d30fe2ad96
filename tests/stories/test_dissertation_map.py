"""The map from the dissertation to this project: nothing left out, nothing that is not there."""

from __future__ import annotations

import re

import pytest

from tests.helpers.doc_names import check_commands, rows, wrong_places
from tests.helpers.places import ROOT

PAGE = (ROOT / "docs" / "dissertation-map.md").read_text(encoding="utf-8")
# Last number of each chapter, as printed.
LAST = {
    "Equations": {2: 50, 3: 38, 4: 35},
    "Tables": {2: 6, 3: 2, 4: 7},
    "Figures": {2: 13, 3: 10, 4: 4},
}


def numbers(cell: str) -> list[tuple[int, int]]:
    """Numbers that a cell names: `2.1, 2.7 to 2.13`."""
    result = []
    for part in cell.split(","):
        ends = [tuple(map(int, end.split("."))) for end in re.findall(r"\d+\.\d+", part)]
        first, last = ends[0], ends[-1]
        assert first[0] == last[0]
        result += [(first[0], k) for k in range(first[1], last[1] + 1)]
    return result


def section(title: str) -> list[list[str]]:
    return rows(PAGE.split(f"## {title}\n")[1].split("\n## ")[0])


@pytest.mark.parametrize("title", LAST)
def test_every_numbered_item_has_one_row(title: str):
    listed = [number for row in section(title) for number in numbers(row[0])]
    printed = {(chapter, k) for chapter, last in LAST[title].items() for k in range(1, last + 1)}
    assert set(listed) == printed
    assert len(listed) == len(printed)


def test_every_row_says_where_or_why_not():
    for title in (*LAST, "Other items"):
        for row in section(title):
            assert len(row) == 3
            done = row[2]
            where = re.search(r"`[^`]+`|\]\([^)]+\)", done)
            why_not = re.search(r"(not done|not drawn): \w+ \w+", done)
            assert where or why_not or "same" in done or re.match(r"as \d", done), row


def test_every_file_function_and_command_exists():
    assert wrong_places(PAGE) == []
    assert check_commands(PAGE, "dissertation-map.md") >= 15


def test_what_does_not_exist_is_seen():
    assert wrong_places(
        "`sysid/estimation/noise.py:concentrated_cost` `sysid/estimation/noise.py:nothing`"
        " `sysid/nowhere.py`"
    ) == ["sysid/estimation/noise.py:nothing", "sysid/nowhere.py"]
    with pytest.raises(AssertionError):
        check_commands("`uqharness bounds AIRCRAFT --rolling-terms`", "here")
    with pytest.raises(AssertionError):
        check_commands("`python -m uqharness.study_nothing --out DIR`", "here")
    assert numbers("2.7 to 2.9, 3.1") == [(2, 7), (2, 8), (2, 9), (3, 1)]
