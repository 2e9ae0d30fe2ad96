"""Report, seal and merge campaign folders: answers, status, digests, shards.

A campaign can be flown in shards by a scheduler without a process pool across machines: n jobs with
--shard 1/n ... n/n, each into a separate folder. A case belongs to a shard by its place in the
campaign, so the tables after `merge` are those of a single run.
"""

from __future__ import annotations

import contextlib
import re
import sqlite3
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sysid.foreign.regular_files import read_regular, sha256_hex
from sysid.units import counted, percent
from uqharness import checksums
from uqharness.campaign.cases import Case, Mission, build_cases
from uqharness.campaign.manifest import (
    COMPLETE,
    INTERRUPTED,
    MANIFEST,
    MIXED,
    RUNNING,
    DamageError,
    describe,
    has_digests,
    read_manifest,
    refuse_if_different,
    refuse_without_digests,
    spec_of,
    write_manifest,
)
from uqharness.campaign.rounds import ALL_CORNERS, Rounds
from uqharness.campaign.spec import CampaignSpec
from uqharness.campaign.statements import STATEMENTS, joint_level, joint_words
from uqharness.campaign.store import JOURNAL, Store, is_running, run_lock
from uqharness.campaign.tables import (
    ENGINE_CHECK,
    MAX_CHECK_BYTES,
    TABLE_NAMES,
    is_sealed,
    make_tables,
    merge_checks,
    read_checked,
    read_decisions,
    table_digests,
    write_tables,
)
from uqharness.errors import BadInputError
from uqharness.results.campaign import Answer, CampaignStatus, Merged
from uqharness.text_tables import csv_rows

# Answers per condition, during a run and after it.

_ORDER = ("yes", "no", "open", "flying")
_WORDS = {"open": "inconclusive"}


def read_answers(folder: Path, manifest: Mapping[str, Any]) -> list[Answer]:
    """Return the answers of a campaign, per condition, for the smallest radius.

    They come from decisions.csv, which a run with *decide* updates, or from the statements of a
    complete campaign; otherwise the list is empty. Raises BadInputError if a table is damaged.
    """
    rows = [row for row in read_decisions(folder, manifest) if row["epistemic_id"] == ALL_CORNERS]
    if not rows and (
        (folder / STATEMENTS).exists() or (is_sealed(manifest) and "shard" not in manifest)
    ):
        content = read_checked(folder, manifest, STATEMENTS)
        texts = ("condition", "distance", "answer")
        every = csv_rows(
            content, folder / STATEMENTS, ("radius_m", "acceptable_per_h", "hours"), texts
        )
        # Answer for the smallest radius, the one that the campaign asks about.
        smallest = min((float(row["radius_m"]) for row in every), default=0.0)
        rows = [
            row
            for row in every
            if row["distance"] == "horizontal" and float(row["radius_m"]) == smallest
        ]
    return [_answer(row) for row in rows]


def _answer(row: dict[str, str]) -> Answer:
    """Return the answer of a row."""
    share = row.get("flight_share_upper")
    return Answer(
        condition=row["condition"],
        radius_m=float(row["radius_m"]),
        acceptable_per_h=float(row["acceptable_per_h"]),
        answer=row["answer"],
        reason=row.get("reason", ""),
        hours=float(row["hours"]),
        flight_share_upper=float(share) if share else None,
    )


def lines(answers: Sequence[Answer]) -> list[str]:
    """Return a summary line, then one line per condition."""
    if not answers:
        return []
    first, count = answers[0], Counter(answer.answer for answer in answers)
    summary = ", ".join(f"{count[word]} {_WORDS.get(word, word)}" for word in _ORDER if count[word])
    result = [
        (
            f"at most {counted(first.acceptable_per_h, 'excursion')} per hour beyond"
            f" {first.radius_m:g} m? {summary}"
        )
    ]
    for answer in answers:
        reason = f" ({answer.reason})" if answer.reason else ""
        share = answer.flight_share_upper
        share_text = (
            ""
            if share is None
            else (
                f", at most {percent(share)} of flights with an excursion at the worst corner (95 %"
                " limit)"
            )
        )
        word = _WORDS.get(answer.answer, answer.answer)
        result.append(
            f"  {answer.condition}: {word}{reason}, {answer.hours:.4g} flight h{share_text}"
        )
    return result


# Completion of a campaign: digests of journal and tables, and whether they still fit.


def sealed(
    manifest: Mapping[str, Any], store: Store, tables: Mapping[str, bytes]
) -> dict[str, Any]:
    """Return the manifest of a complete campaign, with digests of journal and tables."""
    digests = dict(manifest.get("tables", {})) | {
        name: sha256_hex(content) for name, content in tables.items()
    }
    check = store.folder / ENGINE_CHECK
    with contextlib.suppress(OSError):
        digests[ENGINE_CHECK] = sha256_hex(read_regular(check, MAX_CHECK_BYTES))
    ending = {"state": COMPLETE, "tables": digests, "journal": store.summary()}
    return {**manifest, **ending, "sums": checksums.SUMS}


def seal_files(folder: Path, previous: checksums.DamageRecord | None = None) -> None:
    """Write SHA256SUMS of a complete campaign, the last file of a run. Raises BadInputError."""
    damaged = {} if previous is None else dict(previous.damaged)
    for name in (MANIFEST, JOURNAL, *TABLE_NAMES):
        damaged.pop(name, None)  # they have just been held against digests of their own, or written
    checksums.write_sums(folder, checksums.DamageRecord(damaged))


def refuse_if_changed(folder: Path, store: Store, manifest: Mapping[str, Any]) -> None:
    """Raise DamageError if the journal of a complete campaign is not the one that the manifest
    lists.
    """
    store.finished()
    if store.summary() != manifest["journal"]:
        raise DamageError(
            folder / JOURNAL, "its flights are not those that the manifest lists", folder
        )


def rewrite_damaged_tables(
    folder: Path,
    manifest: Mapping[str, Any],
    spec: CampaignSpec,
    cases: Sequence[Case],
    store: Store,
) -> tuple[str, ...]:
    """Write the tables of a complete campaign again if one is damaged; return the names of the
    damaged.

    The journal must be intact. Tables of other commands (sensitivity.csv) are left as they are.
    """
    digests = manifest.get("tables", {})
    damaged = {
        name for name, digest in table_digests(folder, manifest).items() if digest != digests[name]
    }
    if not damaged:
        return ()
    rounds = Rounds(spec, cases, None)
    # Replay the rounds to obtain decisions.csv.
    for _ in rounds(store):
        pass
    tables = make_tables(spec, cases, store.outcomes(), rounds.decisions)
    if not damaged & set(tables):
        return ()
    # Another library version may write other bytes for the same content, so all tables are
    # replaced.
    write_tables(folder, tables)
    write_manifest(folder, sealed(manifest, store, tables))
    return tuple(name for name in tables if name in damaged)


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


def parse_shard(text: str) -> Shard:
    """Parse ``2/8``. Raises BadInputError.

    Examples
    --------
    >>> parse_shard("2/8").folder
    '2-of-8'
    """
    match = re.fullmatch(r"(\d{1,6})/(\d{1,6})", text.strip())
    if not match or not 1 <= int(match.group(1)) <= int(match.group(2)):
        raise BadInputError(f"--shard {text}: must be i/n with 1 <= i <= n, such as 2/8")
    return Shard(int(match.group(1)), int(match.group(2)))


def shard_folders(folder: Path) -> list[Path]:
    """Return the folders of the shards in a campaign folder."""
    return sorted(path.parent for path in (folder / SHARDS).glob(f"*/{MANIFEST}"))


def merge(folder: Path) -> Merged:
    """Collect the flights of all shards in ``folder``; with the last one, write the tables.

    The call may be repeated and keeps what is there.

    Raises
    ------
    BadInputError
        For shards of different campaigns, and while a shard is being flown.
    DamageError
        If a journal is damaged; nothing is written then.
    """
    folders = shard_folders(folder)
    if not folders:
        raise BadInputError(
            f"{folder}: has no shards (no {SHARDS}/*/manifest.json); run them with: uqharness"
            f" campaign run CAMPAIGN.toml --out {folder} --shard 1/2 and so on"
        )
    first = read_manifest(folders[0])
    refuse_without_digests(folders[0], first)
    spec = spec_of(first)
    # The identity comes from the manifests: the files may lie elsewhere, or be gone, on this
    # machine.
    hashes = first["hashes"]
    mission = Mission(Path(), hashes["aircraft"], Path(), hashes["script"])
    cases = build_cases(spec, mission)
    case_ids = {case.case_id for case in cases}
    command = first["command"].partition(" --shard ")[0]
    manifest = describe(spec, mission, len(cases), command) | {
        name: first[name] for name in ("versions", "engine") if name in first
    }
    with run_lock(folder):
        # An earlier merge in the folder must be of the same campaign.
        old = _previous_merge(folder, manifest)
        for part in folders:
            part_manifest = read_manifest(part)
            refuse_without_digests(part, part_manifest)
            refuse_if_different(part, part_manifest, manifest)
            if part_manifest["state"] == MIXED:
                raise BadInputError(
                    f"{part}: aircraft or script was edited during the run; remove the folder and"
                    " run this shard again"
                )
        if old is not None and old["state"] == COMPLETE:
            with Store(folder) as store:
                refuse_if_changed(folder, store, old)
                rewritten = rewrite_damaged_tables(folder, old, spec, cases, store)
                return _merged(cases, store.statuses(), 0, folders, rewritten)
        manifest |= {"tables": old["tables"]} if old is not None and "tables" in old else {}
        # Check every journal before anything is written.
        for part in (*folders, *([folder] if old is not None else [])):
            _refuse_damage(part, read_manifest(part))
        previous_sums = checksums.remove_sums(folder)
        write_manifest(folder, manifest | {"state": INTERRUPTED})
        with Store(folder) as store:
            for part in folders:
                with run_lock(part), Store(part, read_only=True) as part_store:
                    store.add(
                        outcome for outcome in part_store.outcomes() if outcome.case_id in case_ids
                    )
            # Tables are written only when all flights are there.
            missing = len(case_ids - store.finished())
            if not missing:
                tables = make_tables(spec, cases, store.outcomes())
                write_tables(folder, tables)
                merge_checks(folder, folders)
                write_manifest(folder, sealed(manifest, store, tables))
            statuses = store.statuses()
        if not missing:
            seal_files(folder, previous_sums)
        return _merged(cases, statuses, missing, folders, ())


def _refuse_damage(folder: Path, manifest: Mapping[str, Any]) -> None:
    """Raise DamageError if a journal is not as it was written, before anything is changed."""
    with Store(folder, read_only=True) as store:
        if manifest["state"] == COMPLETE:
            refuse_if_changed(folder, store, manifest)
        else:
            store.finished()


def _previous_merge(folder: Path, manifest: Mapping[str, Any]) -> dict[str, Any] | None:
    """Return the manifest of an earlier merge; None without one.

    Raises BadInputError if it belongs to another campaign.
    """
    if not (folder / MANIFEST).exists():
        return None
    old = read_manifest(folder)
    refuse_without_digests(folder, old)
    if old["state"] != COMPLETE and not (folder / JOURNAL).exists():
        return None
    refuse_if_different(folder, old, manifest)
    return old


def _merged(
    cases: Sequence[Case],
    statuses: Mapping[str, int],
    missing: int,
    folders: Sequence[Path],
    rewritten: tuple[str, ...],
) -> Merged:
    """Return the report of a merge."""
    return Merged(
        cases=len(cases),
        done=len(cases) - missing,
        missing=missing,
        statuses=dict(sorted(statuses.items())),
        shards=[path.name for path in folders],
        rewritten=list(rewritten),
    )


# Status of a campaign folder, or of its shards.


def read_status(folder: Path) -> CampaignStatus:
    """Return the status of a campaign, running or not. Raises BadInputError."""
    folders = [folder]
    if not (folder / MANIFEST).exists() and shard_folders(folder):
        folders = shard_folders(folder)
    counted, cases, complete = Counter[str](), 0, True
    for part in folders:
        manifest = read_manifest(part)
        counted.update(_count_statuses(part, manifest))
        cases += int(manifest["cases"])
        complete = complete and manifest["state"] == COMPLETE
    # A killed run leaves the state "running"; the lock shows whether a process holds the folder.
    state = COMPLETE if complete else RUNNING if any(map(is_running, folders)) else INTERRUPTED
    # Only a merged campaign has answers.
    answers = read_answers(folder, manifest) if folders == [folder] else []
    return CampaignStatus(
        state=state,
        cases=cases,
        done=counted.total(),
        failed=counted.total() - counted["ok"],
        statuses=dict(sorted(counted.items())),
        engine=manifest["campaign"]["campaign"]["engine"],
        engine_why=list(manifest.get("engine", {}).get("why", ())),
        joint_level=joint_level(manifest),
        joint=joint_words(manifest),
        answers=answers,
        command=manifest["command"],
    )


def _count_statuses(folder: Path, manifest: Mapping[str, Any]) -> Mapping[str, int]:
    """Return the number of flights by status, from the tally of the journal. Raises DamageError."""
    if not has_digests(manifest):
        return _count_statuses_without_digests(folder / JOURNAL)
    with Store(folder, read_only=True) as store:
        statuses = store.statuses()
    if is_sealed(manifest) and statuses.total() != manifest["journal"]["rows"]:
        rows = manifest["journal"]["rows"]
        raise DamageError(
            folder / JOURNAL,
            f"{statuses.total()} flights are in it, the manifest lists {rows}",
            folder,
        )
    return statuses


def _count_statuses_without_digests(path: Path) -> Mapping[str, int]:
    """Return the number of flights by status in a journal of uqharness 0.1."""
    if not path.is_file():
        raise BadInputError(f"{path}: missing; the folder was made by uqharness 0.1 and is damaged")
    try:
        with closing(
            sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True, timeout=30.0)
        ) as database:
            statuses = dict(
                database.execute("select status, count(*) from outcome group by status").fetchall()
            )
    except (sqlite3.Error, OverflowError, MemoryError, UnicodeError) as error:
        raise BadInputError(
            f"{path}: cannot be read: {error}; the folder was made by uqharness 0.1"
        ) from None
    if not all(isinstance(status, str) for status in statuses):
        raise BadInputError(
            f"{path}: damaged: a status is no text; the folder was made by uqharness 0.1"
        )
    return statuses
