"""A campaign's journal: finished cases, each on the disk before it counts, in one SQLite file with one writer.

SQLite's rollback journal (DELETE, synchronous=EXTRA) is chosen over an append-only text file, because a torn last write,
a full disk and a power cut are then its tested business, and over its write-ahead log, because that needs shared memory,
which cluster file systems lack. A killed run leaves a journal that the next opening rolls back: a batch is there whole or
not at all.
"""

from __future__ import annotations

import contextlib
import json
import os
import socket
import sqlite3
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from uqharness.errors import BadInputError
from uqharness.worker import CaseOutcome

JOURNAL = "journal.sqlite"
LOCK = "run.lock"

_CREATE = """create table if not exists outcome (
    case_id text primary key, status text not null, reason text not null, flown_s real not null,
    metrics text not null, undefined text not null) without rowid"""
# Counting and listing what is done reads this index and not the results: a folder of 100,000 flights opens at once.
_INDEX = "create index if not exists outcome_by_status on outcome (status)"
_COLUMNS = "case_id, status, reason, flown_s, metrics, undefined"


class Store:
    """Outcomes of a campaign's cases. Raises BadInputError where the folder cannot be written or read."""

    def __init__(self, folder: Path, read_only: bool = False) -> None:
        self.folder = folder
        path = folder / JOURNAL
        with self._explained("open"):
            if read_only and not os.access(path, os.W_OK):
                self._database = sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True, timeout=30.0)
            else:
                self._database = sqlite3.connect(path, timeout=30.0)
                self._database.execute("pragma journal_mode = delete")
                self._database.execute("pragma synchronous = extra")
                if not read_only:
                    self._database.execute(_CREATE)
                    self._database.execute(_INDEX)
                    self._database.commit()

    def add(self, outcomes: Iterable[CaseOutcome]) -> None:
        """Store a batch; on return it is on the disk. On failure nothing of it is, and the journal is as before."""
        rows = [
            (item.case_id, item.status, item.reason, item.flown_s, _plain(item.metrics), _plain(item.undefined))
            for item in outcomes
        ]
        if rows:
            with self._explained("write"), self._database:
                self._database.executemany(f"insert or replace into outcome ({_COLUMNS}) values (?,?,?,?,?,?)", rows)

    def finished(self) -> set[str]:
        """Ids of all cases that are done."""
        with self._explained("read"):
            return {row[0] for row in self._rows("select case_id from outcome")}

    def statuses(self) -> Counter[str]:
        """Number of finished cases by status."""
        with self._explained("read"):
            return Counter(dict(self._rows("select status, count(*) from outcome group by status")))

    def outcomes(self) -> Iterator[CaseOutcome]:
        """All outcomes, ordered by case id."""
        with self._explained("read"):
            for row in self._rows(f"select {_COLUMNS} from outcome order by case_id"):
                yield _outcome(row)

    def outcome(self, case_id: str) -> CaseOutcome | None:
        """Outcome of one case; None if it is not there."""
        with self._explained("read"):
            row = next(self._rows(f"select {_COLUMNS} from outcome where case_id = ?", case_id), None)
        return None if row is None else _outcome(row)

    def _rows(self, query: str, *values: str) -> Iterator[tuple[Any, ...]]:
        # SQLite makes the file before the table: a reader in between, or after a run killed there, finds nothing counted.
        made = self._database.execute("select 1 from sqlite_master where name = 'outcome'").fetchone()
        return self._database.execute(query, values) if made else iter(())

    def close(self) -> None:
        """Close the journal's database."""
        self._database.close()

    def __enter__(self) -> Store:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @contextlib.contextmanager
    def _explained(self, verb: str) -> Iterator[None]:
        try:
            yield
        except sqlite3.Error as error:
            raise BadInputError(
                f"{self.folder / JOURNAL}: cannot {verb}: {error}; everything counted so far is kept: "
                "free space or mend the folder's permissions, then run the same command again"
            ) from None


def _outcome(row: tuple[str, str, str, float, str, str]) -> CaseOutcome:
    case_id, status, reason, flown_s, metrics, undefined = row
    return CaseOutcome(case_id, status, reason, flown_s, json.loads(metrics), json.loads(undefined))


def _plain(mapping: Mapping[str, object]) -> str:
    return json.dumps(dict(mapping), sort_keys=True)


@contextlib.contextmanager
def run_lock(folder: Path) -> Iterator[None]:
    """Hold the folder for one run. Raises BadInputError if another process has it.

    The system drops the lock when the process ends, however it ends. A record lock is used because children do not inherit
    it: a worker that outlives a killed parent for a moment must not keep the folder shut.
    """
    path = folder / LOCK
    key = str(path.resolve())
    if key in _held:
        # Not even opened: closing a second handle would drop the lock of the first.
        raise _in_use(folder, f"process {os.getpid()}, this one")
    try:
        handle = path.open("a+", encoding="utf-8")
    except OSError as error:
        raise BadInputError(f"{folder}: cannot be written: {error.strerror or error}; choose another --out") from None
    with handle:
        # Somebody who only asks whether a run is on holds the lock for an instant, so one refusal is not yet an answer.
        if not _try_lock(handle.fileno(), attempts=5):
            handle.seek(0)
            raise _in_use(folder, handle.read().strip() or "unknown process")
        _held.add(key)
        try:
            handle.seek(0)
            handle.truncate()
            handle.write(f"process {os.getpid()} on {socket.gethostname()}\n")
            handle.flush()
            yield
        finally:
            _held.discard(key)


def is_running(folder: Path) -> bool:
    """Whether a run holds the folder at this moment."""
    path = folder / LOCK
    if str(path.resolve()) in _held:
        return True
    try:
        with path.open("r+", encoding="utf-8") as handle:
            # Closing the handle gives the lock back at once.
            return not _try_lock(handle.fileno())
    except OSError:
        return False


def _in_use(folder: Path, holder: str) -> BadInputError:
    return BadInputError(
        f"{folder}: another run is using this folder ({holder}); wait for it, stop it, or choose another --out"
    )


# A record lock does not exclude its own process: a second run in another thread would pass.
_held: set[str] = set()


def _try_lock(descriptor: int, attempts: int = 1) -> bool:
    for attempt in range(attempts):
        if attempt:
            time.sleep(0.05)
        if _lock_at_once(descriptor):
            return True
    return False


def _lock_at_once(descriptor: int) -> bool:
    try:
        import fcntl
    except ImportError:  # Windows
        import msvcrt

        try:
            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined]
        except OSError:
            return False
        return True
    try:
        fcntl.lockf(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True
