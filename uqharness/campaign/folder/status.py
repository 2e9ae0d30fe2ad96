"""How far a campaign is: its own folder, or the shards below it."""

from __future__ import annotations

import sqlite3
from collections import Counter
from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from uqharness.campaign.answers import Answer, as_json, read_answers
from uqharness.campaign.execution.flying import JSBSIM
from uqharness.campaign.folder.digests import DamageError
from uqharness.campaign.folder.files import is_sealed
from uqharness.campaign.folder.manifest import MANIFEST, has_digests, read_manifest
from uqharness.campaign.folder.manifest_content import COMPLETE, INTERRUPTED, RUNNING
from uqharness.campaign.folder.shards import shard_folders
from uqharness.campaign.folder.store import JOURNAL, Store, is_running
from uqharness.campaign.joint import joint_level, joint_words
from uqharness.errors import BadInputError


@dataclass(frozen=True)
class Status:
    """``state``: complete, running or interrupted; ``statuses``: number of finished flights by status.

    ``engine`` flies the campaign, ``why`` says for what reasons. ``joint`` says what its intervals hold together, ``joint_level``
    at which confidence; None where that of the intervals is not known.
    """

    state: str
    cases: int
    statuses: Mapping[str, int]
    answers: tuple[Answer, ...]
    command: str
    engine: str = JSBSIM
    why: tuple[str, ...] = ()
    joint: tuple[str, ...] = ()
    joint_level: float | None = None

    @property
    def done(self) -> int:
        """Number of finished flights."""
        return sum(self.statuses.values())

    def as_dict(self) -> dict[str, Any]:
        """The document of ``campaign status --json``."""
        return {
            "state": self.state,
            "cases": self.cases,
            "done": self.done,
            "failed": self.done - self.statuses.get("ok", 0),
            "statuses": dict(self.statuses),
            "engine": self.engine,
            "engine_why": list(self.why),
            "joint_level": self.joint_level,
            "joint": list(self.joint),
            "answers": as_json(self.answers),
        }


def read_status(folder: Path) -> Status:
    """Status of a campaign, running or not. Raises BadInputError."""
    folders = [folder]
    if not (folder / MANIFEST).exists() and shard_folders(folder):
        folders = shard_folders(folder)
    counted, cases, complete = Counter[str](), 0, True
    for part in folders:
        manifest = read_manifest(part)
        counted.update(_counted(part, manifest))
        cases += int(manifest["cases"])
        complete = complete and manifest["state"] == COMPLETE
    # A killed run could not say so itself; whether somebody holds the folder tells.
    state = COMPLETE if complete else RUNNING if any(map(is_running, folders)) else INTERRUPTED
    # Answers are of a campaign as a whole.
    answers = tuple(read_answers(folder, manifest)) if folders == [folder] else ()
    engine, why = (
        manifest["campaign"]["campaign"]["engine"],
        tuple(manifest.get("engine", {}).get("why", ())),
    )
    joint = tuple(joint_words(manifest))
    counts = dict(sorted(counted.items()))
    return Status(
        state,
        cases,
        counts,
        answers,
        manifest["command"],
        engine,
        why,
        joint,
        joint_level(manifest),
    )


def _counted(folder: Path, manifest: Mapping[str, Any]) -> Mapping[str, int]:
    if not has_digests(manifest):
        return _counted_without_digests(folder / JOURNAL)
    with Store(folder, read_only=True) as store:
        found = store.statuses()
    if is_sealed(manifest) and found.total() != manifest["journal"]["rows"]:
        rows = manifest["journal"]["rows"]
        raise DamageError(
            folder / JOURNAL,
            f"{found.total()} flights are in it, the manifest lists {rows}",
            folder,
        )
    return found


def _counted_without_digests(path: Path) -> Mapping[str, int]:
    """The journal of uqharness 0.1."""
    if not path.is_file():
        raise BadInputError(
            f"{path}: not there; the folder was made by uqharness 0.1 and is no longer whole"
        )
    try:
        with closing(
            sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True, timeout=30.0)
        ) as database:
            found = dict(
                database.execute("select status, count(*) from outcome group by status").fetchall()
            )
    except (sqlite3.Error, OverflowError, MemoryError, UnicodeError) as error:
        raise BadInputError(
            f"{path}: cannot be read: {error}; the folder was made by uqharness 0.1"
        ) from None
    if not all(isinstance(status, str) for status in found):
        raise BadInputError(
            f"{path}: damaged: a status is no text; the folder was made by uqharness 0.1"
        )
    return found
