"""Tables of a folder: engine-check.csv, digests, decisions."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from sysid.foreign.regular_files import sha256_hex
from uqharness.campaign.manifest import DamageError
from uqharness.campaign.tables import (
    ENGINE_CHECK,
    CheckRow,
    as_number,
    as_text,
    merge_checks,
    read_check,
    read_checked,
    read_decisions,
    table_digests,
    write_check,
)
from uqharness.errors import BadInputError

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


def test_engine_check_survives_a_round_trip(tmp_path):
    write_check(tmp_path, [ROW, STATUS])
    assert read_check(tmp_path) == [ROW, STATUS]
    assert as_number(read_check(tmp_path)[0].batch) == 0.1 + 0.2
    assert (as_text(math.nan), math.isnan(as_number(""))) == ("", True)
    assert as_number(as_text(-math.inf)) == -math.inf


def test_shards_are_merged(tmp_path):
    for name, row in (("a", ROW), ("b", STATUS), ("c", ROW)):
        (tmp_path / name).mkdir()
        write_check(tmp_path / name, [row])
    (tmp_path / "none").mkdir()
    merge_checks(tmp_path, [tmp_path / name for name in ("a", "b", "c", "none")])
    assert read_check(tmp_path) == [ROW, STATUS]
    merge_checks(tmp_path / "none", [])
    assert not (tmp_path / "none" / ENGINE_CHECK).exists()


TEXT = b"a,b\n1,2\n"


SEALED = {"format": 2, "state": "complete", "tables": {"area.csv": sha256_hex(TEXT)}}


def test_a_changed_byte_and_an_unknown_table_are_damage(tmp_path: Path):
    path = tmp_path / "area.csv"
    path.write_bytes(TEXT)
    assert read_checked(tmp_path, SEALED, "area.csv") == TEXT
    path.write_bytes(TEXT.replace(b"1", b"7"))
    with pytest.raises(DamageError, match="does not fit the digest"):
        read_checked(tmp_path, SEALED, "area.csv")
    # Before the end of a campaign there is no digest to hold it against.
    assert read_checked(tmp_path, SEALED | {"state": "running"}, "area.csv") != TEXT
    (tmp_path / "pbox.parquet").write_bytes(b"x")
    with pytest.raises(DamageError, match="knows of no such table"):
        read_checked(tmp_path, SEALED, "pbox.parquet")


def test_a_table_that_is_not_there(tmp_path: Path):
    with pytest.raises(BadInputError, match="not there; run the campaign first"):
        read_checked(tmp_path, SEALED, "area.csv")
    assert table_digests(tmp_path, SEALED) == {"area.csv": None}
    (tmp_path / "area.csv").write_bytes(TEXT)
    assert table_digests(tmp_path, SEALED) == SEALED["tables"]
    (tmp_path / "area.csv").unlink()
    (tmp_path / "area.csv").mkdir()
    with pytest.raises(BadInputError, match="cannot be read"):
        read_checked(tmp_path, SEALED, "area.csv")


def test_decisions_are_read_where_there_are_any(tmp_path: Path):
    head = b"condition,epistemic_id,radius_m,acceptable_per_h,answer,reason,hours\n"
    content = head + b"3 m/s none,all,15,2,yes,,1\n"
    manifest = SEALED | {"tables": {"decisions.csv": sha256_hex(content)}}
    assert read_decisions(tmp_path, SEALED) == []
    (tmp_path / "decisions.csv").write_bytes(content)
    assert [row["answer"] for row in read_decisions(tmp_path, manifest)] == ["yes"]
    # A sealed campaign that has no such table does not take a stranger's.
    assert read_decisions(tmp_path, SEALED) == []
    running = {"format": 2, "state": "running", "tables": {}}
    assert len(read_decisions(tmp_path, running)) == 1
