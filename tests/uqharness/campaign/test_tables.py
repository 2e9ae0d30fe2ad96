"""Tables of a folder: engine-check.csv, digests, decisions."""

from __future__ import annotations

from pathlib import Path

import pytest

from sysid.foreign.regular_files import sha256_hex
from uqharness.campaign.manifest import DamageError
from uqharness.campaign.tables import (
    read_checked,
    table_digests,
)
from uqharness.errors import BadInputError

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
    with pytest.raises(DamageError, match="lists no such table"):
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
