"""A campaign in parts: each shard flies its share into a folder of its own, and merging makes one campaign folder of them.

For schedulers without a process pool across machines: n jobs with --shard 1/n ... n/n, on a shared folder or on folders that are
copied together afterwards. A case belongs to a shard by its place in the campaign, so the merged tables are those of one run.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from uqharness import checksums
from uqharness.campaign.cases import Case, Mission, build_cases
from uqharness.campaign.folder.engine_file import merge_checks
from uqharness.campaign.folder.manifest import (
    MANIFEST,
    describe,
    read_manifest,
    refuse_if_different,
    refuse_without_digests,
    spec_of,
    write_manifest,
)
from uqharness.campaign.folder.manifest_content import COMPLETE, INTERRUPTED, SPOILT
from uqharness.campaign.folder.seal import mend_tables, refuse_if_not_whole, seal_files, sealed
from uqharness.campaign.folder.store import JOURNAL, Store, run_lock
from uqharness.campaign.folder.tables import make_tables, write_tables
from uqharness.errors import BadInputError

SHARDS = "shards"


@dataclass(frozen=True)
class Shard:
    """Part ``number`` of ``count``, counted from 1."""

    number: int
    count: int

    @property
    def folder(self) -> str:
        """Name of the shard's folder, ``3-of-16``."""
        return f"{self.number}-of-{self.count}"

    def __str__(self) -> str:
        return f"{self.number}/{self.count}"


@dataclass(frozen=True)
class Merged:
    """What a merge found: cases of the campaign, those that no shard has flown, failures; damaged tables that are whole again."""

    folder: Path
    cases: int
    missing: int
    statuses: dict[str, int]
    shards: tuple[str, ...]
    rewritten: tuple[str, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        """The document of ``campaign merge --json``."""
        return {
            "cases": self.cases,
            "done": self.cases - self.missing,
            "missing": self.missing,
            "statuses": self.statuses,
            "shards": list(self.shards),
        }


def parse_shard(text: str) -> Shard:
    """``2/8`` as a shard. Raises BadInputError."""
    found = re.fullmatch(r"(\d{1,6})/(\d{1,6})", text.strip())
    if not found or not 1 <= int(found.group(1)) <= int(found.group(2)):
        raise BadInputError(f"--shard {text}: must be i/n with 1 <= i <= n, such as 2/8")
    return Shard(int(found.group(1)), int(found.group(2)))


def shard_folders(folder: Path) -> list[Path]:
    """Folders of the shards that lie in a campaign's folder."""
    return sorted(path.parent for path in (folder / SHARDS).glob(f"*/{MANIFEST}"))


def merge(folder: Path) -> Merged:
    """Bring the flights of all shards in ``folder`` together; with the last one in, write the tables.

    May be repeated: what is already there is kept. Raises BadInputError for shards of different campaigns and while one of them is
    being flown.
    """
    folders = shard_folders(folder)
    if not folders:
        raise BadInputError(
            f"{folder}: has no shards (no {SHARDS}/*/manifest.json); fly them with: uqharness campaign run CAMPAIGN.toml "
            f"--out {folder} --shard 1/2 and so on"
        )
    first = read_manifest(folders[0])
    refuse_without_digests(folders[0], first)
    spec = spec_of(first)
    # Identity comes from the flights' own record: the files may lie elsewhere, or be gone, on the machine that merges.
    hashes = first["hashes"]
    mission = Mission(Path(), hashes["aircraft"], Path(), hashes["script"])
    cases = build_cases(spec, mission)
    wanted = {case.case_id for case in cases}
    command = first["command"].partition(" --shard ")[0]
    manifest = describe(spec, mission, len(cases), command) | {
        name: first[name] for name in ("versions", "engine") if name in first
    }
    with run_lock(folder):
        old = _merged_before(folder, manifest)
        for part in folders:
            found = read_manifest(part)
            refuse_without_digests(part, found)
            refuse_if_different(part, found, manifest)
            if found["state"] == SPOILT:
                raise BadInputError(
                    f"{part}: aircraft or script was edited while it flew; remove it and fly that shard again"
                )
        if old is not None and old["state"] == COMPLETE:
            with Store(folder) as store:
                refuse_if_not_whole(folder, store, old)
                rewritten = mend_tables(folder, old, spec, cases, store)
                return _merged(folder, cases, store.statuses(), 0, folders, rewritten)
        manifest |= {"tables": old["tables"]} if old is not None and "tables" in old else {}
        for part in (*folders, *([folder] if old is not None else [])):
            _refuse_damage(part, read_manifest(part))
        earlier = checksums.take_away(folder)
        write_manifest(folder, manifest | {"state": INTERRUPTED})
        with Store(folder) as store:
            for part in folders:
                with run_lock(part), Store(part, read_only=True) as flown:
                    store.add(outcome for outcome in flown.outcomes() if outcome.case_id in wanted)
            missing = len(wanted - store.finished())
            if not missing:
                tables = make_tables(spec, cases, store.outcomes())
                write_tables(folder, tables)
                merge_checks(folder, folders)
                write_manifest(folder, sealed(manifest, store, tables))
            statuses = store.statuses()
        if not missing:
            seal_files(folder, earlier)
        return _merged(folder, cases, statuses, missing, folders, ())


def _refuse_damage(folder: Path, manifest: Mapping[str, Any]) -> None:
    """Before anything is written: DamageError where the journal is not as it was written."""
    with Store(folder, read_only=True) as store:
        if manifest["state"] == COMPLETE:
            refuse_if_not_whole(folder, store, manifest)
        else:
            store.finished()


def _merged_before(folder: Path, manifest: Mapping[str, Any]) -> dict[str, Any] | None:
    """Manifest of the folder where an earlier merge left one with a journal. Raises BadInputError for that of another campaign."""
    if not (folder / MANIFEST).exists():
        return None
    old = read_manifest(folder)
    refuse_without_digests(folder, old)
    if old["state"] != COMPLETE and not (folder / JOURNAL).exists():
        return None
    refuse_if_different(folder, old, manifest)
    return old


def _merged(
    folder: Path,
    cases: Sequence[Case],
    statuses: Mapping[str, int],
    missing: int,
    folders: Sequence[Path],
    rewritten: tuple[str, ...],
) -> Merged:
    names = tuple(path.name for path in folders)
    return Merged(folder, len(cases), missing, dict(sorted(statuses.items())), names, rewritten)
