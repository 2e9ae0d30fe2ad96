"""Verify a folder of results, and salvage a damaged campaign.

`verify` changes nothing. It checks manifest, journal, tables and shards of a campaign separately,
and all other files of a campaign, a study or a refinement by SHA256SUMS. `salvage` keeps the intact
flights, gives damaged files another name and flies the missing flights again.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import shutil
import sqlite3
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sysid.foreign.regular_files import read_regular, require_regular
from uqharness.campaign.cases import Mission, build_cases
from uqharness.campaign.cost import Cost
from uqharness.campaign.engines import Engines, with_default_noise
from uqharness.campaign.manifest import (
    COMPLETE,
    INTERRUPTED,
    MANIFEST,
    MIXED,
    DamageError,
    binding_versions,
    describe,
    digest_of_rows,
    has_digests,
    read_manifest,
    refuse_if_different,
    refuse_without_digests,
    spec_of,
    write_manifest,
)
from uqharness.campaign.processes import BATCH, JSBSIM, CaseOutcome, Executor, FlightFunction
from uqharness.campaign.run import find_mission, run_campaign
from uqharness.campaign.shards import SHARDS, Shard, merge, parse_shard, refuse_if_changed
from uqharness.campaign.spec import CampaignSpec
from uqharness.campaign.store import (
    JOURNAL,
    LEFTOVER,
    JournalScan,
    Store,
    copy_of,
    is_running,
    journal_trap,
    outcome_of,
    run_lock,
)
from uqharness.campaign.tables import ENGINE_CHECK, TABLE_NAMES, is_sealed, table_digests
from uqharness.checksums import SUMS, SumsError, faults, is_behind_link, read_sums, update_sums
from uqharness.errors import BadInputError
from uqharness.files import scratch_folder
from uqharness.results.campaign import FolderCheck, Item, Salvaged

INTACT, DAMAGED, MISSING, NO_DIGEST = "whole", "damaged", "missing", "no digests"


@dataclass(frozen=True)
class JournalScanResult:
    """Numbers of intact, damaged and missing rows of a journal.

    ``missing`` is None if the original number is not known; ``problem`` says what is wrong.
    """

    sound: int
    damaged: int
    missing: int | None
    problem: str

    @property
    def words(self) -> str:
        """The counts and the problem as a phrase."""
        missing = "an unknown number" if self.missing is None else str(self.missing)
        counts = f"flights: {self.sound} sound, {self.damaged} damaged, {missing} missing"
        return f"{counts}; {self.problem}" if self.problem else counts


def verify(folder: Path) -> FolderCheck:
    """Check a folder of a campaign, study or refinement, and the folders within.

    Parameters
    ----------
    folder : Path
        Folder of results.

    Returns
    -------
    FolderCheck
        State of each item.

    Raises
    ------
    BadInputError
        For any other folder.
    """
    is_campaign = (folder / MANIFEST).exists() or (folder / JOURNAL).exists()
    parts = [*part_folders(folder), *_sealed_within(folder)]
    sealed = (folder / SUMS).exists() or (folder / SUMS).is_symlink()
    if not is_campaign and not parts and not sealed:
        raise BadInputError(
            f"{folder}: not a folder of a campaign, a study or a refinement (no {MANIFEST}, no "
            f"{JOURNAL}, no {SHARDS}/, no {SUMS})"
        )
    # Manifest, journal and tables first; other files by SHA256SUMS.
    complete, items = _verify_campaign(folder) if is_campaign else (None, ())
    # An incomplete campaign has no SHA256SUMS, or those of an earlier completion.
    files = _file_items(folder, items) if sealed and complete is not False else ()
    every = [*items, *files]
    inner = [verify(part) for part in dict.fromkeys(parts)]
    return FolderCheck(
        folder=str(folder),
        whole=all(item.state == INTACT for item in every) and all(part.whole for part in inner),
        complete=complete,
        items=every,
        shards=inner,
    )


def _item(name: str, state: str, remark: str = "", digest: str | None = None) -> Item:
    """Return the state of a manifest, journal, table or other file."""
    return Item(name=name, state=state, remark=remark, digest=digest)


def _sealed_within(folder: Path) -> list[Path]:
    """Return the folders within a study or refinement that have their own SHA256SUMS."""
    with contextlib.suppress(SumsError, OSError):
        sums = read_sums(folder)
        names = () if sums is None else sums.folders
        return [folder / name for name in names if not is_behind_link(folder, name)]
    return []


def _file_items(folder: Path, items: Sequence[Item]) -> Iterator[Item]:
    """Yield files that differ from SHA256SUMS, then one item that counts the others."""
    items_by_name = {item.name: item for item in items}
    file_faults = faults(folder, include_inner=False)
    for fault in file_faults:
        if fault.name not in items_by_name or items_by_name[fault.name].state == INTACT:
            yield _item(fault.name, MISSING if fault.missing else DAMAGED, fault.problem)
    with contextlib.suppress(SumsError, OSError):
        if (sums := read_sums(folder)) is None:
            yield _item(SUMS, DAMAGED, "it is not this program's")
        else:
            intact = len(set(sums.files) - {fault.name for fault in file_faults})
            yield _item(SUMS, INTACT, f"{intact} of {len(sums.files)} files as they were written")


def part_folders(folder: Path) -> list[Path]:
    """Return the folders of shards, including those without a manifest."""
    folders = {
        path.parent for name in (MANIFEST, JOURNAL) for path in (folder / SHARDS).glob(f"*/{name}")
    }
    return sorted(folders)


def _verify_campaign(folder: Path) -> tuple[bool | None, tuple[Item, ...]]:
    """Check manifest, journal and tables.

    Return whether the campaign is complete, and the items.
    """
    manifest: dict[str, Any] | None = None
    try:
        manifest = read_manifest(folder)
        first = _item(MANIFEST, INTACT)
    except DamageError as error:
        first = _item(MANIFEST, DAMAGED, error.what)
    except BadInputError as error:
        first = _item(MANIFEST, DAMAGED if (folder / MANIFEST).exists() else MISSING, str(error))
    if manifest is not None and not has_digests(manifest):
        names = (JOURNAL, *_existing_tables(folder))
        old = _item(MANIFEST, NO_DIGEST, "made by uqharness 0.1")
        return manifest["state"] == COMPLETE, (old, *(_item(name, NO_DIGEST) for name in names))
    journal = _journal_item(folder, manifest)
    tables = () if manifest is None else tuple(_table_items(folder, manifest))
    sums_missing = manifest is not None and "sums" in manifest and not (folder / SUMS).exists()
    if sums_missing and manifest is not None and is_sealed(manifest):
        tables = (*tables, _item(SUMS, MISSING, "the same run command writes it again"))
    return (None if manifest is None else manifest["state"] == COMPLETE), (first, journal, *tables)


def _journal_item(folder: Path, manifest: Mapping[str, Any] | None) -> Item:
    """Check the journal."""
    sealed = manifest is not None and is_sealed(manifest)
    try:
        if trap := journal_trap(folder):
            return _item(JOURNAL, DAMAGED, trap)
        require_regular(folder / JOURNAL)
    except FileNotFoundError:
        if manifest is None or sealed:
            return _item(JOURNAL, MISSING)
        return _item(JOURNAL, INTACT, "no flight was counted yet")
    except OSError as error:
        return _item(JOURNAL, DAMAGED, f"{error.strerror or error}")
    scan_result = scan_journal(folder, manifest)
    return _item(JOURNAL, DAMAGED if scan_result.problem else INTACT, scan_result.words)


def scan_journal(folder: Path, manifest: Mapping[str, Any] | None) -> JournalScanResult:
    """Read every row of a journal and compare it with the manifest of a complete campaign."""
    with scratch_folder("verify") as scratch:
        try:
            if (folder / LEFTOVER).is_file() and not is_running(folder):
                # Opening the journal itself would undo an incomplete write; that is left to the
                # next run.
                copy_of(folder, scratch.path / "opened")
                # First as every command opens it, then row by row.
                problem, expected = _opened(scratch.path / "opened", folder)
            else:
                problem, expected = _opened(folder, folder)
            scan = JournalScan(folder, scratch.path)
            digests = {row[0]: row[-1] for row in scan.rows()}
        except (sqlite3.Error, OSError, UnicodeError) as error:
            return JournalScanResult(0, 0, None, f"cannot be read: {error}")
    if manifest is not None and is_sealed(manifest):
        expected = int(manifest["journal"]["rows"])
        fits = (
            digest_of_rows(digests[name] for name in sorted(digests))
            == manifest["journal"]["digest"]
        )
        problem = problem or ("" if fits else "its flights are not those that the manifest lists")
    missing = None if expected is None else max(expected - len(digests) - scan.damaged, 0)
    return JournalScanResult(len(digests), scan.damaged, missing, problem)


def _opened(place: Path, folder: Path) -> tuple[str, int | None]:
    """Open a journal as every command does; return the problem and the number of flights in its
    tally.
    """
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


def _existing_tables(folder: Path) -> list[str]:
    """Return the names of the tables that exist."""
    return [name for name in TABLE_NAMES if (folder / name).exists()]


def _table_items(folder: Path, manifest: Mapping[str, Any]) -> Iterator[Item]:
    """Yield the state of each table."""
    if not is_sealed(manifest):
        return
    digests = manifest.get("tables", {})
    for name, digest in table_digests(folder, manifest).items():
        if digest is None:
            yield _item(name, MISSING)
        elif digest == digests[name]:
            yield _item(name, INTACT, "", digest)
        else:
            yield _item(name, DAMAGED, f"the manifest has {digests[name]}", digest)
    for name in _existing_tables(folder):
        if name not in digests:
            yield _item(name, DAMAGED, "the manifest knows of no such table")


# Salvage. At every moment the folder is one that `salvage` can be called on again: the new journal
# is made in a separate folder and moved into place at once, after the old one has got another
# name and the manifest says that the campaign is not complete.

_WORK = ".salvage"
_BATCH = 1000
_OWN_TABLES = ("sensitivity.csv", "convergence.csv", "area.csv", ENGINE_CHECK)


@dataclass(frozen=True)
class RunOptions:
    """The options with which missing flights are flown, see `run_campaign`."""

    executor: Executor
    before_flying: Callable[[Cost], None] = lambda _: None
    on_progress: Callable[[Any], object] | None = None
    fly: FlightFunction | Engines | None = None


def salvage(
    folder: Path, flying: RunOptions, campaign: CampaignSpec | None = None, command: str = ""
) -> Salvaged:
    """Make a damaged campaign intact again.

    Parameters
    ----------
    folder : Path
        Campaign folder.
    flying : RunOptions
        How to fly missing flights.
    campaign : CampaignSpec, optional
        Campaign to use if the manifest is damaged or gone.
    command : str
        Command line for a new manifest.

    Raises
    ------
    BadInputError
        If the campaign cannot be restored; nothing is lost then.
    """
    parts = part_folders(folder)
    if not parts:
        return _salvage_campaign(folder, flying, campaign, command)
    # Shards first: merging needs them intact.
    done = [
        _salvage_campaign(part, flying, campaign, command) for part in parts if not _is_whole(part)
    ]
    renamed: list[str] = []
    if (folder / MANIFEST).exists() or (folder / JOURNAL).exists():
        with run_lock(folder):
            renamed = _mend_merged(folder)
    merged = merge(folder)
    return Salvaged(
        folder=str(folder),
        kept=sum(merged.statuses.values()) - sum(part.flown for part in done),
        flown=0,
        missing=merged.missing,
        statuses=merged.statuses,
        rewritten=merged.rewritten,
        aside=renamed,
        shards=done,
    )


def _is_whole(folder: Path) -> bool:
    """Return whether manifest and journal of a shard are intact."""
    if not (folder / MANIFEST).exists():
        return False
    try:
        manifest = read_manifest(folder)
        refuse_without_digests(folder, manifest)
        _refuse_damage(folder, manifest)
    except DamageError:
        return False
    return True


def _refuse_damage(folder: Path, manifest: Mapping[str, Any]) -> None:
    """Raise DamageError if the journal is not intact.

    One with a rollback file is read in a copy.
    """
    if is_sealed(manifest) and not (folder / JOURNAL).exists():
        raise DamageError(folder / JOURNAL, "it is gone", folder)
    if is_sealed(manifest):
        # Intact flights do not exclude damage in unused pages.
        for fault in faults(folder, include_inner=False):
            if fault.name == JOURNAL:
                raise DamageError(folder / JOURNAL, fault.problem, folder)
    with _work_folder(folder) as work:
        place = folder
        if (folder / LEFTOVER).exists():
            copy_of(folder, work / "look")
            place = work / "look"
        with Store(place, read_only=True) as store:
            if is_sealed(manifest):
                refuse_if_changed(folder, store, manifest)
            else:
                store.finished()


def _mend_merged(folder: Path) -> list[str]:
    """Rename damaged files of a folder of merged shards; merging writes them again."""
    renamed: list[str] = []
    try:
        manifest = read_manifest(folder)
        refuse_without_digests(folder, manifest)
    except DamageError:
        renamed.append(_rename_damaged(folder / MANIFEST))
        manifest = None
    except BadInputError:
        if (folder / MANIFEST).exists():
            raise
        manifest = None
    try:
        _refuse_damage(
            folder, {"state": INTERRUPTED, "format": 2} if manifest is None else manifest
        )
    except DamageError:
        if manifest is not None:
            write_manifest(folder, _not_complete(manifest))
        renamed += _replace_journal(folder, None)
    return renamed + ([] if manifest is None else _rename_damaged_tables(folder, manifest))


def _salvage_campaign(
    folder: Path, flying: RunOptions, campaign: CampaignSpec | None, command: str
) -> Salvaged:
    """Salvage one campaign folder without shards."""
    if not (folder / MANIFEST).exists() and not (folder / JOURNAL).exists():
        raise BadInputError(
            f"{folder}: not a campaign folder (no {MANIFEST}, no {JOURNAL}); nothing to salvage"
        )
    with run_lock(folder):
        # Identify the campaign, then replace what is damaged.
        spec, manifest, renamed = _identify_campaign(folder, campaign, command)
        if manifest["state"] == MIXED:
            raise BadInputError(
                f"{folder}: aircraft or script was edited while this campaign flew; remove it and"
                " run again"
            )
        case_ids = _case_ids(folder, spec, manifest)
        try:
            _refuse_damage(folder, manifest)
        except DamageError:
            write_manifest(folder, _not_complete(manifest))
            renamed += _replace_journal(folder, case_ids)
        if not (folder / MANIFEST).exists():
            write_manifest(folder, _not_complete(manifest))
        renamed += _rename_damaged_tables(folder, manifest)
        with Store(folder) as store:
            retained = store.statuses().total()
    # Fly what is missing now.
    shard = None if "shard" not in manifest else parse_shard(manifest["shard"])
    summary = run_campaign(
        spec,
        _out_of(folder, shard),
        executor=flying.executor,
        on_progress=flying.on_progress,
        fly=flying.fly,
        command=manifest["command"],
        shard=shard,
        before_flying=flying.before_flying,
    )
    return Salvaged(
        folder=str(folder),
        kept=retained,
        flown=sum(summary.statuses.values()) - retained,
        missing=0,
        statuses=dict(summary.statuses),
        rewritten=list(summary.rewritten),
        aside=renamed,
        shards=[],
    )


def _identify_campaign(
    folder: Path, campaign: CampaignSpec | None, command: str
) -> tuple[CampaignSpec, dict[str, Any], list[str]]:
    """Return the campaign of a folder, its manifest and the names of renamed files.

    A damaged manifest is rebuilt from ``campaign``.
    """
    try:
        manifest = read_manifest(folder)
    except BadInputError as error:
        if campaign is None:
            raise BadInputError(
                f"{error}. Give the campaign file of the run: uqharness campaign salvage"
                f" {folder} --campaign CAMPAIGN.toml"
            ) from None
        _refuse_other_versions(folder)
        shard = _shard_of(folder)
        # Rebuild the manifest from the campaign file.
        mission = find_mission(campaign, folder)
        campaign = with_default_noise(campaign, mission)
        campaign = _with_engine_of_journal(folder, campaign, mission)
        cases = build_cases(campaign, mission)
        if shard is None:
            rebuilt = describe(campaign, mission, len(cases), command)
        else:
            share = len(cases[shard.number - 1 :: shard.count])
            rebuilt = describe(campaign, mission, share, f"{command} --shard {shard}") | {
                "shard": str(shard)
            }
        _refuse_foreign_flights(folder, campaign, rebuilt)
        renamed = [_rename_damaged(folder / MANIFEST)] if (folder / MANIFEST).exists() else []
        return campaign, rebuilt | {"state": INTERRUPTED}, renamed
    refuse_without_digests(folder, manifest)
    return spec_of(manifest), manifest, []


def _refuse_other_versions(folder: Path) -> None:
    """Raise BadInputError if a damaged manifest still shows that other versions flew."""
    with contextlib.suppress(OSError, ValueError, RecursionError, AttributeError):
        old_versions = json.loads(read_regular(folder / MANIFEST)).get("versions")
        differences = [
            f"{name} {old_versions[name]} then, {installed} now"
            for name, installed in binding_versions()
            if old_versions.get(name, installed) != installed
        ]
        if differences:
            raise BadInputError(
                f"{folder}: this folder holds flights of other versions: {'; '.join(differences)}"
            )


def _refuse_foreign_flights(
    folder: Path, campaign: CampaignSpec, manifest: Mapping[str, Any]
) -> None:
    """Raise BadInputError if the journal holds flights of another campaign."""
    case_ids = _case_ids(folder, campaign, manifest)
    sound_ids = _sound_ids(folder, case_ids)
    foreign = len(sound_ids - case_ids)
    if foreign:
        raise BadInputError(
            f"{folder}: {foreign} of its {len(sound_ids)} undamaged flights do not belong to"
            f" {campaign.path}; give the campaign file, the aircraft and the --hours or --samples"
            " of the run"
        )


def _sound_ids(folder: Path, case_ids: Collection[str]) -> set[str]:
    """Return the case ids of all intact rows."""
    with _work_folder(folder) as work:
        return {
            row[0]
            for source in _sources(folder)
            for row in JournalScan(source, work / "scan").rows(case_ids)
        }


def _with_engine_of_journal(folder: Path, campaign: CampaignSpec, mission: Mission) -> CampaignSpec:
    """Return the campaign in the engine whose case ids the journal holds."""
    if campaign.campaign.engine != "auto":
        return campaign
    ids_by_engine = {
        engine: {case.case_id for case in build_cases(campaign.with_engine(engine), mission)}
        for engine in (JSBSIM, BATCH)
    }
    sound_ids = _sound_ids(folder, set().union(*ids_by_engine.values()))
    # The engine with most of its case ids in the journal.
    hits = {engine: len(sound_ids & ids) for engine, ids in ids_by_engine.items()}
    return (
        campaign.with_engine(max(hits, key=lambda engine: hits[engine]))
        if any(hits.values())
        else campaign
    )


def _case_ids(folder: Path, spec: CampaignSpec, manifest: Mapping[str, Any]) -> set[str]:
    """Return the ids of a campaign's cases.

    Raises BadInputError if aircraft, script or versions have changed.
    """
    mission = find_mission(spec, folder)
    refuse_if_different(folder, manifest, describe(spec, mission, manifest["cases"], ""))
    return {case.case_id for case in build_cases(spec, mission)}


def _not_complete(manifest: Mapping[str, Any]) -> dict[str, Any]:
    """Return the manifest in the state interrupted."""
    return {name: value for name, value in manifest.items() if name != "journal"} | {
        "state": INTERRUPTED
    }


def _replace_journal(folder: Path, case_ids: Collection[str] | None) -> list[str]:
    """Replace the journal by a new one with all intact rows; return the new name of the damaged
    one.
    """
    with _work_folder(folder) as work:
        with Store(work) as store:
            for source in _sources(folder):
                rows = JournalScan(source, work / "scan").rows(case_ids or ())
                for batch in _batches(
                    # Rows of other campaigns are left out.
                    outcome_of(row)
                    for row in rows
                    if case_ids is None or row[0] in case_ids
                ):
                    store.add(batch)
        renamed = _rename_journal(folder)
        # Next to a new journal the rollback file would be applied to it.
        (folder / LEFTOVER).unlink(missing_ok=True)
        os.replace(work / JOURNAL, folder / JOURNAL)
    return renamed


def _sources(folder: Path) -> Iterator[Path]:
    """Yield folders with a journal to read, those of an earlier salvage first: the last one
    counts.
    """
    for number in itertools.count(1):
        damaged = folder / f"journal.damaged-{number}.sqlite"
        if not damaged.exists():
            break
        with _work_folder(folder, f"{_WORK}-{number}") as work:
            shutil.copyfile(damaged, work / JOURNAL)
            if (leftover := Path(f"{damaged}-journal")).exists():
                shutil.copyfile(leftover, work / LEFTOVER)
            yield work
    if (folder / JOURNAL).exists():
        yield folder


def _batches(outcomes: Iterator[CaseOutcome]) -> Iterator[list[CaseOutcome]]:
    """Yield outcomes in batches."""
    while batch := list(itertools.islice(outcomes, _BATCH)):
        yield batch


def _rename_journal(folder: Path) -> list[str]:
    """Give the damaged journal, and its rollback file, a second name."""
    if not (folder / JOURNAL).exists():
        return []
    new_path = _free_name(folder / JOURNAL)
    for source, target in (
        (folder / LEFTOVER, Path(f"{new_path}-journal")),
        (folder / JOURNAL, new_path),
    ):
        if source.exists():
            try:
                os.link(source, target)
            except OSError:  # a file system without second names
                part = target.with_name(f".{target.name}.part")
                part.unlink(missing_ok=True)  # it may be a link
                shutil.copyfile(source, part)
                os.replace(part, target)
    return [new_path.name]


def _rename_damaged_tables(folder: Path, manifest: Mapping[str, Any]) -> list[str]:
    """Rename damaged tables of other commands, which cannot be computed again here."""
    expected = manifest.get("tables", {})
    digests = table_digests(folder, manifest)
    damaged = [name for name in _OWN_TABLES if name in digests and digests[name] != expected[name]]
    unknown = [name for name in _OWN_TABLES if name not in expected and (folder / name).exists()]
    renamed = [
        _rename_damaged(folder / name) for name in (*damaged, *unknown) if (folder / name).exists()
    ]
    if damaged and (folder / MANIFEST).exists():
        current = read_manifest(folder)
        write_manifest(
            folder,
            current | {"tables": {k: v for k, v in current["tables"].items() if k not in damaged}},
        )
    return renamed


def _rename_damaged(path: Path) -> str:
    """Rename a damaged file and return the new name."""
    new_path = _free_name(path)
    os.replace(path, new_path)
    update_sums(path)
    return new_path.name


def _free_name(path: Path) -> Path:
    """Return an unused name for a damaged file."""
    names = (
        path.with_name(f"{path.stem}.damaged-{number}{path.suffix}")
        for number in itertools.count(1)
    )
    return next(name for name in names if not name.exists())


@contextlib.contextmanager
def _work_folder(folder: Path, name: str = _WORK) -> Iterator[Path]:
    """Yield an empty folder within ``folder``, removed afterwards."""
    work = folder / name
    _remove(work)
    try:
        work.mkdir()
    except OSError as error:
        raise BadInputError(f"{work}: cannot be made: {error.strerror or error}") from None
    try:
        yield work
    finally:
        _remove(work)


def _remove(work: Path) -> None:
    """Remove a file, link or folder."""
    if work.is_symlink() or work.is_file():
        work.unlink()
    shutil.rmtree(work, ignore_errors=True)


def _shard_of(folder: Path) -> Shard | None:
    """Return the shard that a folder's name indicates."""
    if folder.resolve().parent.name != SHARDS:
        return None
    return parse_shard(folder.resolve().name.replace("-of-", "/"))


def _out_of(folder: Path, shard: Shard | None) -> Path:
    """Return the output folder with which a run flies into ``folder``."""
    if shard is None:
        return folder
    # A shard lies two levels below its campaign.
    place = folder.resolve()
    if (place.parent.name, place.name) != (SHARDS, shard.folder):
        raise BadInputError(
            f"{folder}: holds shard {shard} and must lie in {SHARDS}/{shard.folder} of the"
            " campaign's folder"
        )
    return place.parent.parent
