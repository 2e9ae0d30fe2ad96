"""The end of a campaign: digests in its manifest, tables that are made again, a journal that must
be whole.
"""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import pytest

from sysid.digests import sha256_hex
from uqharness.campaign import shards
from uqharness.campaign.manifest import DamageError
from uqharness.campaign.shards import refuse_if_changed, rewrite_damaged_tables, sealed

SUMMARY = {"rows": 2, "digest": "a" * 64}


def store(summary=SUMMARY):
    return SimpleNamespace(summary=lambda: summary, finished=dict, folder=Path("nowhere"))


def test_a_sealed_manifest_holds_the_digest_of_every_table():
    old = {"state": "running", "cases": 2, "tables": {"area.csv": "b" * 64, "x.csv": "c" * 64}}
    found = sealed(old, store(), {"x.csv": b"new"})
    assert found == {
        "state": "complete",
        "cases": 2,
        "journal": SUMMARY,
        "tables": {"area.csv": "b" * 64, "x.csv": sha256_hex(b"new")},
        "sums": "SHA256SUMS",
    }
    assert old["tables"]["x.csv"] == "c" * 64


def test_another_journal_is_refused(tmp_path: Path):
    refuse_if_changed(tmp_path, store(), {"journal": SUMMARY})
    with pytest.raises(DamageError, match="not those that the manifest lists"):
        refuse_if_changed(tmp_path, store(), {"journal": SUMMARY | {"rows": 3}})


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A table of the campaign's own and one of another command; what flew would give the first
    again.
    """
    for name in ("pbox.parquet", "area.csv"):
        (tmp_path / name).write_bytes(b"x")
    monkeypatch.setattr(shards, "Rounds", _NoRounds)
    monkeypatch.setattr(shards, "make_tables", lambda *given: {"pbox.parquet": b"x"})
    return tmp_path


class _NoRounds:
    decisions = None

    def __init__(self, *given: object) -> None:
        pass

    def __call__(self, store: object) -> tuple[()]:
        return ()


def mended(folder: Path) -> tuple[str, ...]:
    manifest = {"tables": {name: sha256_hex(b"x") for name in ("pbox.parquet", "area.csv")}}
    journal = SimpleNamespace(summary=SUMMARY.copy, outcomes=tuple, folder=folder)
    return rewrite_damaged_tables(folder, manifest, None, (), journal)


def test_a_table_that_was_changed_or_lost_is_made_again(folder: Path):
    assert mended(folder) == ()
    (folder / "pbox.parquet").write_bytes(b"y")
    assert mended(folder) == ("pbox.parquet",)
    assert (folder / "pbox.parquet").read_bytes() == b"x"
    (folder / "pbox.parquet").unlink()
    assert mended(folder) == ("pbox.parquet",)
    assert (folder / "pbox.parquet").read_bytes() == b"x"


def test_a_table_of_another_command_is_left_as_it_is(folder: Path):
    (folder / "area.csv").write_bytes(b"y")
    assert mended(folder) == ()
    assert (folder / "area.csv").read_bytes() == b"y"
