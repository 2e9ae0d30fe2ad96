"""engine-check.csv comes back as it was written; what is not this program's counts for nothing."""

from __future__ import annotations

import math

import pytest

from uqharness.campaign.tables import (
    ENGINE_CHECK,
    CheckRow,
    as_number,
    as_text,
    merge_checks,
    read_check,
    write_check,
)

ROW = CheckRow(
    "whole",
    "3 m/s moderate",
    "00ff",
    "cross_track_median_m",
    as_text(0.1 + 0.2),
    "1.0",
    "2.0",
    "0.35",
    "excused",
    "a, b",
)
STATUS = CheckRow("whole", "3 m/s moderate", "00ff", "status", "ok", "ok", "", "", "alike")


def test_it_comes_back(tmp_path):
    write_check(tmp_path, [ROW, STATUS])
    assert read_check(tmp_path) == [ROW, STATUS]
    assert as_number(read_check(tmp_path)[0].batch) == 0.1 + 0.2
    assert (as_text(math.nan), math.isnan(as_number(""))) == ("", True)
    assert as_number(as_text(-math.inf)) == -math.inf


@pytest.mark.parametrize("content", [b"", b"x,y\n1,2\n", b"\xff\xfe"])
def test_anything_else_is_no_row(tmp_path, content):
    assert read_check(tmp_path) == []
    (tmp_path / ENGINE_CHECK).write_bytes(content)
    assert read_check(tmp_path) == []


def test_a_number_that_is_none_is_not_believed(tmp_path):
    write_check(tmp_path, [ROW])
    path = tmp_path / ENGINE_CHECK
    path.write_text(path.read_text().replace("0.30000000000000004", "thirty"))
    assert read_check(tmp_path) == []


def test_shards_are_put_together(tmp_path):
    for name, row in (("a", ROW), ("b", STATUS), ("c", ROW)):
        (tmp_path / name).mkdir()
        write_check(tmp_path / name, [row])
    (tmp_path / "none").mkdir()
    merge_checks(tmp_path, [tmp_path / name for name in ("a", "b", "c", "none")])
    assert read_check(tmp_path) == [ROW, STATUS]
    merge_checks(tmp_path / "none", [])
    assert not (tmp_path / "none" / ENGINE_CHECK).exists()
