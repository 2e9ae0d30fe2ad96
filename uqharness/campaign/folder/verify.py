"""Is a folder of results as it was written? Changes nothing.

Manifest, journal, tables and shards of a campaign are each looked at for themselves; every other file of a campaign, and those of a
study or a refinement, by the digest in SHA256SUMS.
"""

from __future__ import annotations

import contextlib
import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sysid.foreign.regular_files import require_regular
from uqharness.campaign.folder.digests import DamageError, digest_of_rows
from uqharness.campaign.folder.files import TABLE_NAMES, is_sealed, table_digests
from uqharness.campaign.folder.journal_recovery import LEFTOVER, JournalScan, copy_of
from uqharness.campaign.folder.manifest import MANIFEST, has_digests, read_manifest
from uqharness.campaign.folder.manifest_content import COMPLETE
from uqharness.campaign.folder.shards import SHARDS
from uqharness.campaign.folder.store import JOURNAL, Store, is_running, journal_trap
from uqharness.checksums import SUMS, SumsError, faults, read_sums, through_a_link
from uqharness.errors import BadInputError
from uqharness.scratch import scratch_folder

WHOLE, DAMAGED, MISSING, NO_DIGEST = "whole", "damaged", "missing", "no digests"


@dataclass(frozen=True)
class Item:
    """Manifest, journal or table: its state, a remark, and of a table the digest of its bytes as they are now."""

    name: str
    state: str
    remark: str = ""
    digest: str = ""


@dataclass(frozen=True)
class Verified:
    """What was found of one folder, and of the shards below it. ``complete`` None where the manifest cannot be read."""

    folder: Path
    complete: bool | None
    items: tuple[Item, ...]
    shards: tuple[Verified, ...] = ()

    @property
    def whole(self) -> bool:
        """Whether everything is as it was written."""
        return all(item.state == WHOLE for item in self.items) and all(
            part.whole for part in self.shards
        )


@dataclass(frozen=True)
class JournalFound:
    """Rows of a journal that fit their digests, that do not, and that are missing (None: not known how many there were)."""

    sound: int
    damaged: int
    missing: int | None
    problem: str

    @property
    def words(self) -> str:
        """The numbers, and what is wrong."""
        missing = "an unknown number" if self.missing is None else str(self.missing)
        counts = f"flights: {self.sound} sound, {self.damaged} damaged, {missing} missing"
        return f"{counts}; {self.problem}" if self.problem else counts


def verify(folder: Path) -> Verified:
    """Look at a folder of a campaign, study or refinement and those within. Raises BadInputError for any other folder."""
    own = (folder / MANIFEST).exists() or (folder / JOURNAL).exists()
    parts = [*part_folders(folder), *_sealed_within(folder)]
    sealed = (folder / SUMS).exists() or (folder / SUMS).is_symlink()
    if not own and not parts and not sealed:
        raise BadInputError(
            f"{folder}: not a folder of a campaign, a study or a refinement (no {MANIFEST}, no "
            f"{JOURNAL}, no {SHARDS}/, no {SUMS})"
        )
    complete, items = _verify_own(folder) if own else (None, ())
    # A campaign that is not complete has none yet, or those of an earlier end.
    files = _file_items(folder, items) if sealed and complete is not False else ()
    return Verified(
        folder, complete, (*items, *files), tuple(verify(part) for part in dict.fromkeys(parts))
    )


def _sealed_within(folder: Path) -> list[Path]:
    """Folders within a study or refinement that have sums of their own."""
    with contextlib.suppress(SumsError, OSError):
        sums = read_sums(folder)
        names = () if sums is None else sums.folders
        return [folder / name for name in names if not through_a_link(folder, name)]
    return []


def _file_items(folder: Path, items: Sequence[Item]) -> Iterator[Item]:
    """Files that are not as SHA256SUMS lists them, then the others, counted in one item."""
    known = {item.name: item for item in items}
    found = faults(folder, within=False)
    for fault in found:
        if fault.name not in known or known[fault.name].state == WHOLE:
            yield Item(fault.name, MISSING if fault.missing else DAMAGED, fault.problem)
    with contextlib.suppress(SumsError, OSError):
        if (sums := read_sums(folder)) is None:
            yield Item(SUMS, DAMAGED, "it is not this program's")
        else:
            whole = len(set(sums.files) - {fault.name for fault in found})
            yield Item(SUMS, WHOLE, f"{whole} of {len(sums.files)} files as they were written")


def part_folders(folder: Path) -> list[Path]:
    """Folders of shards, also of those that have lost their manifest."""
    found = {
        path.parent for name in (MANIFEST, JOURNAL) for path in (folder / SHARDS).glob(f"*/{name}")
    }
    return sorted(found)


def _verify_own(folder: Path) -> tuple[bool | None, tuple[Item, ...]]:
    manifest: dict[str, Any] | None = None
    try:
        manifest = read_manifest(folder)
        first = Item(MANIFEST, WHOLE)
    except DamageError as error:
        first = Item(MANIFEST, DAMAGED, error.what)
    except BadInputError as error:
        first = Item(MANIFEST, DAMAGED if (folder / MANIFEST).exists() else MISSING, str(error))
    if manifest is not None and not has_digests(manifest):
        names = (JOURNAL, *_there(folder))
        old = Item(MANIFEST, NO_DIGEST, "made by uqharness 0.1")
        return manifest["state"] == COMPLETE, (old, *(Item(name, NO_DIGEST) for name in names))
    journal = _journal_item(folder, manifest)
    tables = () if manifest is None else tuple(_table_items(folder, manifest))
    lost = manifest is not None and "sums" in manifest and not (folder / SUMS).exists()
    if lost and manifest is not None and is_sealed(manifest):
        tables = (*tables, Item(SUMS, MISSING, "the same run command writes it again"))
    return (None if manifest is None else manifest["state"] == COMPLETE), (first, journal, *tables)


def _journal_item(folder: Path, manifest: Mapping[str, Any] | None) -> Item:
    sealed = manifest is not None and is_sealed(manifest)
    try:
        if trap := journal_trap(folder):
            return Item(JOURNAL, DAMAGED, trap)
        require_regular(folder / JOURNAL)
    except FileNotFoundError:
        if manifest is None or sealed:
            return Item(JOURNAL, MISSING)
        return Item(JOURNAL, WHOLE, "no flight was counted yet")
    except OSError as error:
        return Item(JOURNAL, DAMAGED, f"{error.strerror or error}")
    found = look_at_journal(folder, manifest)
    return Item(JOURNAL, DAMAGED if found.problem else WHOLE, found.words)


def look_at_journal(folder: Path, manifest: Mapping[str, Any] | None) -> JournalFound:
    """Every row of a journal, damaged or not, and whether it is what the manifest of a complete campaign lists."""
    with scratch_folder("verify") as scratch:
        try:
            if (folder / LEFTOVER).is_file() and not is_running(folder):
                # Opening the journal itself would take back what was half written, which is for the next run to do.
                copy_of(folder, scratch.path / "opened")
                problem, expected = _opened(scratch.path / "opened", folder)
            else:
                problem, expected = _opened(folder, folder)
            scan = JournalScan(folder, scratch.path)
            digests = {row[0]: row[-1] for row in scan.rows()}
        except (sqlite3.Error, OSError, UnicodeError) as error:
            return JournalFound(0, 0, None, f"cannot be read: {error}")
    if manifest is not None and is_sealed(manifest):
        expected = int(manifest["journal"]["rows"])
        fits = (
            digest_of_rows(digests[name] for name in sorted(digests))
            == manifest["journal"]["digest"]
        )
        problem = problem or ("" if fits else "its flights are not those that the manifest lists")
    missing = None if expected is None else max(expected - len(digests) - scan.damaged, 0)
    return JournalFound(len(digests), scan.damaged, missing, problem)


def _opened(place: Path, folder: Path) -> tuple[str, int | None]:
    """What is wrong with a journal as every command opens it, and how many flights its tally counts."""
    expected = None
    try:
        with closing(Store(place, read_only=True)) as store:
            expected = store.statuses().total()
            store.finished()
    except DamageError as error:
        return error.what, expected
    except BadInputError as error:
        return str(error).replace(str(place), str(folder)), expected
    return "", expected


def _there(folder: Path) -> list[str]:
    return [name for name in TABLE_NAMES if (folder / name).exists()]


def _table_items(folder: Path, manifest: Mapping[str, Any]) -> Iterator[Item]:
    if not is_sealed(manifest):
        return
    written = manifest.get("tables", {})
    for name, digest in table_digests(folder, manifest).items():
        if digest is None:
            yield Item(name, MISSING)
        elif digest == written[name]:
            yield Item(name, WHOLE, "", digest)
        else:
            yield Item(name, DAMAGED, f"the manifest has {written[name]}", digest)
    for name in _there(folder):
        if name not in written:
            yield Item(name, DAMAGED, "the manifest knows of no such table")
