"""Where imported logs are kept."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import pytest

from sysid.logs.card import AirframeCard
from sysid.logs.load import cached_file, default_cache, store
from sysid.record import FlightRecord
from tests.helpers.synthetic import flight


def test_the_folder_is_the_users_unless_the_environment_says_otherwise(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    for name in ("UQ_CACHE", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(Path, "home", lambda: tmp_path)
    monkeypatch.setattr(sys, "platform", "linux")
    assert default_cache() == tmp_path / ".cache" / "uqharness"
    monkeypatch.setattr(sys, "platform", "darwin")
    assert default_cache() == tmp_path / "Library" / "Caches" / "uqharness"
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "xdg"))
    assert default_cache() == tmp_path / "xdg" / "uqharness"
    monkeypatch.setenv("UQ_CACHE", str(tmp_path / "own"))
    assert default_cache() == tmp_path / "own"


def test_log_map_and_card_each_name_another_file(tmp_path: Path, card: AirframeCard) -> None:
    signal_map = tmp_path / "map.toml"
    signal_map.write_text("a = 1")
    found = [
        cached_file(tmp_path, "12", None, None),
        cached_file(tmp_path, "13", None, None),
        cached_file(tmp_path, "12", signal_map, None),
        cached_file(tmp_path, "12", None, card),
        cached_file(tmp_path, "12", None, replace(card, servos={})),
    ]
    assert cached_file(tmp_path, "12", None, card) == found[3]
    signal_map.write_text("a = 2")
    found.append(cached_file(tmp_path, "12", signal_map, None))
    assert len(set(found)) == len(found)


def test_a_record_is_kept_whole_and_what_cannot_be_written_is_let_go(tmp_path: Path) -> None:
    record = flight(1.0)
    store(record, tmp_path / "new" / "a.parquet")
    assert [p.name for p in (tmp_path / "new").iterdir()] == ["a.parquet"]
    assert len(FlightRecord.read(tmp_path / "new" / "a.parquet")) == len(record)
    (tmp_path / "file").write_text("")
    store(record, tmp_path / "file" / "a.parquet")
    (tmp_path / "b.parquet").mkdir()  # cannot be replaced by a file
    store(record, tmp_path / "b.parquet")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["b.parquet", "file", "new"]
