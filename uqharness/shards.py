"""A campaign in parts: each shard flies its share into a folder of its own, and merging makes one campaign folder of them.

For schedulers without a process pool across machines: n jobs with --shard 1/n ... n/n, on a shared folder or on folders that are
copied together afterwards. A case belongs to a shard by its place in the campaign, so the merged tables are those of one run.
"""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from uqharness.campaign_manifest import SPOILT, describe, read_manifest, refuse_if_different, spec_of, write_manifest
from uqharness.campaign_results import write_tables
from uqharness.cases import Mission, build_cases
from uqharness.errors import BadInputError
from uqharness.store import JOURNAL, Store, run_lock

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
    """What a merge found: cases of the campaign, those that no shard has flown, failures, and whether tables were written."""

    folder: Path
    cases: int
    missing: int
    statuses: dict[str, int]
    shards: tuple[str, ...]


def parse_shard(text: str) -> Shard:
    """``2/8`` as a shard. Raises BadInputError."""
    found = re.fullmatch(r"(\d{1,6})/(\d{1,6})", text.strip())
    if not found or not 1 <= int(found.group(1)) <= int(found.group(2)):
        raise BadInputError(f"--shard {text}: must be i/n with 1 <= i <= n, such as 2/8")
    return Shard(int(found.group(1)), int(found.group(2)))


def shard_folders(folder: Path) -> list[Path]:
    """Folders of the shards that lie in a campaign's folder."""
    return sorted(path.parent for path in (folder / SHARDS).glob("*/manifest.json"))


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
    spec = spec_of(first)
    # Identity comes from the flights' own record: the files may lie elsewhere, or be gone, on the machine that merges.
    hashes = first["hashes"]
    mission = Mission(Path(), hashes["aircraft"], Path(), hashes["script"])
    cases = build_cases(spec, mission)
    wanted = {case.case_id for case in cases}
    command = first.get("command", "").partition(" --shard ")[0]
    manifest = describe(spec, mission, len(cases), command) | {"versions": first["versions"]}
    with run_lock(folder):
        if (folder / JOURNAL).exists() and (folder / "manifest.json").exists():
            refuse_if_different(folder, read_manifest(folder), manifest)
        for part in folders:
            found = read_manifest(part)
            refuse_if_different(part, found, manifest)
            if found["state"] == SPOILT:
                raise BadInputError(
                    f"{part}: aircraft or script was edited while it flew; remove it and fly that shard again"
                )
        write_manifest(folder, manifest | {"state": "interrupted"})
        statuses: Counter[str] = Counter()
        with Store(folder) as store:
            for part in folders:
                with run_lock(part), Store(part, read_only=True) as flown:
                    store.add(outcome for outcome in flown.outcomes() if outcome.case_id in wanted)
            statuses.update(store.statuses())
            missing = len(wanted - store.finished())
            if not missing:
                write_tables(folder, spec, cases, store.outcomes())
        if not missing:
            write_manifest(folder, manifest | {"state": "complete"})
    return Merged(folder, len(cases), missing, dict(sorted(statuses.items())), tuple(path.name for path in folders))
