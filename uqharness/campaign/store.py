"""Store the finished cases of a campaign in a journal, each on the disk before it counts.

The journal is one SQLite file with one writer. A rollback journal (DELETE, synchronous=EXTRA)
handles a torn last write, a full disk and a power cut; SQLite's write-ahead log would need shared
memory, which cluster file systems lack. A killed run leaves a file that the next opening rolls
back, so a batch is stored completely or not at all.

Damage is detected: each row carries a digest of its columns, a tally in the same transaction holds
the number of rows by status and the sum of their digests, and opening checks the structure of the
file. `JournalScan` recovers every intact row of a damaged journal.
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import socket
import sqlite3
import time
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

from sysid.foreign.regular_files import open_regular, require_regular
from uqharness.campaign.manifest import (
    DamageError,
    digest_of_rows,
    digest_of_text,
    row_digest,
    sum_digests,
)
from uqharness.campaign.processes import CaseOutcome
from uqharness.checksums import LOCK as LOCK
from uqharness.errors import BadInputError
from uqharness.files import open_without_links, try_lock
from uqharness.flight import STATUSES

JOURNAL = "journal.sqlite"

SCHEMA = (
    """CREATE TABLE outcome (
    case_id text primary key, status text not null, reason text not null, flown_s real not null,
    metrics text not null, undefined text not null, digest text not null) without rowid""",
    "CREATE TABLE tally (statuses text not null, digest_sum text not null, digest text not null)",
)
COLUMNS = "case_id, status, reason, flown_s, metrics, undefined, digest"
# Rows have about 1200 bytes. With pages of 4096 bytes a row would need an overflow page: 4.7 kB per
# flight instead of 1.4.
_PAGE_BYTES = 8192
_SIDE_FILES = ("-journal", "-wal", "-shm")
"""Endings of the files that SQLite keeps next to a database; the first is the rollback file."""
_ROLLBACK_MAGIC = bytes.fromhex("d9d505f920a163d7")
"""Bytes that begin a rollback file, and end one that names a super journal (SQLite file format,
section 3.1).
"""
# Far above any row, so that a damaged length does not allocate memory.
LONGEST_BYTES = 16_000_000

# Errors of the machine, not of the file: what was stored is still intact.
_MACHINE_ERRORS = {
    sqlite3.SQLITE_FULL,
    sqlite3.SQLITE_IOERR,
    sqlite3.SQLITE_READONLY,
    sqlite3.SQLITE_PERM,
    sqlite3.SQLITE_CANTOPEN,
    sqlite3.SQLITE_BUSY,
    sqlite3.SQLITE_LOCKED,
    sqlite3.SQLITE_NOMEM,
    sqlite3.SQLITE_AUTH,
}


class Store:
    """Access the journal of a campaign folder.

    Parameters
    ----------
    folder : Path
        Campaign folder.
    read_only : bool
        Whether nothing is written; a folder without a journal then appears empty.

    Raises
    ------
    BadInputError
        If the folder cannot be read or written.
    DamageError
        If the journal is not as it was written.
    """

    def __init__(self, folder: Path, read_only: bool = False) -> None:
        """Open the journal, create it if necessary, and check its structure."""
        self.folder = folder
        self._path = folder / JOURNAL
        exists = self._has_journal()
        with contextlib.ExitStack() as on_failure, self._explained("open"):
            self._database = self._connected(read_only, exists)
            on_failure.callback(self._database.close)
            self._database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, LONGEST_BYTES)
            if not read_only:
                self._database.execute(f"pragma page_size = {_PAGE_BYTES}")
                self._database.execute("pragma synchronous = extra")
            if self._schema():
                self._check_structure()
            elif not read_only:
                create_tables(self._database)
            on_failure.pop_all()

    def _has_journal(self) -> bool:
        """Return whether there is a journal file. Raises BadInputError for anything else in its
        place.
        """
        # The file is examined without opening it: closing a second handle would drop SQLite's
        # locks.
        refuse_traps(self.folder)
        try:
            require_regular(self._path)
        except FileNotFoundError:
            return False
        except OSError as error:
            raise BadInputError(
                f"{self._path}: cannot be read: {error.strerror or error}"
            ) from None
        return True

    def _connected(self, read_only: bool, exists: bool) -> sqlite3.Connection:
        """Open the database; an empty one in memory if there is nothing to read."""
        if read_only and not exists:
            return sqlite3.connect(":memory:")
        if read_only and not os.access(self._path, os.W_OK):
            return sqlite3.connect(
                f"{self._path.resolve().as_uri()}?mode=ro", uri=True, timeout=30.0
            )
        return sqlite3.connect(self._path, timeout=30.0)

    def _schema(self) -> bool:
        """Return whether the tables exist; False for a file whose creation was interrupted."""
        statements = [
            row[0] for row in self._database.execute("select sql from sqlite_master order by name")
        ]
        # No table: an empty file, or one whose creation was interrupted.
        if not statements:
            # Tables are created in one transaction: without them the file has no page.
            if self._database.execute("pragma page_count").fetchone() != (0,):
                raise self._damage("its tables are gone")
            return False
        if statements != list(SCHEMA):
            raise self._damage("its tables are not those that this program makes")
        return True

    def _check_structure(self) -> None:
        """Raise DamageError if SQLite's integrity check fails."""
        report = self._database.execute("pragma integrity_check(1)").fetchone()[0]
        if report != "ok":
            raise self._damage(" ".join(str(report).split()))

    def add(self, outcomes: Iterable[CaseOutcome]) -> None:
        """Store a batch; on return it is on the disk. On failure the journal is unchanged."""
        rows = {item.case_id: row_of(item) for item in outcomes}
        if rows:
            with self._explained("write"), self._database:
                self._database.execute("begin immediate")
                add_rows(self._database, rows.values(), *self._tally())

    def finished(self) -> set[str]:
        """Return the ids of all stored cases after checking every row. Raises DamageError."""
        return {outcome.case_id for outcome in self.outcomes()}

    def statuses(self) -> Counter[str]:
        """Return the number of cases by status from the tally, without reading rows. Raises
        DamageError.
        """
        with self._explained("read"):
            return self._tally()[0] if self._schema() else Counter()

    def outcomes(self) -> Iterator[CaseOutcome]:
        """Yield all outcomes, ordered by case id.

        Raises DamageError at a damaged row, and at the end if rows are missing.
        """
        with self._explained("read"):
            if not self._schema():
                return
            counted, total = Counter[str](), 0
            # A read transaction: rows and tally belong to the same state.
            self._database.execute("begin")
            try:
                expected = self._tally()
                for row in self._database.execute(
                    f"select {COLUMNS} from outcome order by case_id"
                ):
                    yield (outcome := self._outcome(row))
                    counted[outcome.status] += 1
                    total += int(row[-1], 16)
            finally:
                self._database.rollback()
            if (counted, sum_digests(f"{total:x}", ())) != expected:
                raise self._damage(
                    f"{counted.total()} flights are in it, {expected[0].total()} were stored, or"
                    " they are not the same"
                )

    def outcome(self, case_id: str) -> CaseOutcome | None:
        """Return the outcome of a case; None if it is not stored. Raises DamageError."""
        with self._explained("read"):
            if not self._schema():
                return None
            row = self._database.execute(
                f"select {COLUMNS} from outcome where case_id = ?", (case_id,)
            ).fetchone()
            return None if row is None else self._outcome(row)

    def summary(self) -> dict[str, Any]:
        """Return the number of ``rows`` and a ``digest`` over them in case-id order, for the
        manifest.

        The stored digests of the rows are used without recomputing them; `outcomes` checks them.
        """
        with self._explained("read"):
            digests = [
                row[0]
                for row in self._database.execute("select digest from outcome order by case_id")
            ]
            return {"rows": len(digests), "digest": digest_of_rows(digests)}

    def _tally(self) -> tuple[Counter[str], str]:
        """Read the tally. Raises DamageError."""
        try:
            return read_tally(self._database)
        except ValueError as error:
            raise self._damage(str(error)) from None

    def _outcome(self, row: Sequence[Any]) -> CaseOutcome:
        """Return the outcome of a row. Raises DamageError."""
        try:
            return outcome_of(row)
        except ValueError as error:
            raise self._damage(str(error)) from None

    def _damage(self, problem: str) -> DamageError:
        """Return the error for a damaged journal."""
        return DamageError(self._path, problem, self.folder)

    def close(self) -> None:
        """Close the database."""
        self._database.close()

    def __enter__(self) -> Store:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @contextlib.contextmanager
    def _explained(self, verb: str) -> Iterator[None]:
        """Turn errors of SQLite into BadInputError or DamageError."""
        try:
            yield
        except sqlite3.Error as error:
            # Errors without a code come from Python, e.g. for text that is not UTF-8.
            code = getattr(error, "sqlite_errorcode", sqlite3.SQLITE_CORRUPT) & 0xFF
            # A read-only error with write permission means that the file is damaged.
            forbidden = code == sqlite3.SQLITE_READONLY and os.access(self._path, os.W_OK)
            if code not in _MACHINE_ERRORS or (forbidden and os.access(self.folder, os.W_OK)):
                raise self._damage(" ".join(str(error).split())) from None
            raise BadInputError(
                f"{self._path}: cannot {verb}: {error}; everything counted so far is kept: "
                "free space or mend the folder's permissions, then run the same command again"
            ) from None
        except (OverflowError, MemoryError, ValueError) as error:
            # SQLite's message may quote a damaged name that is not text.
            raise self._damage(f"cannot be read ({type(error).__name__})") from None


def journal_trap(folder: Path) -> str:
    """Return what SQLite would change outside the folder if it opened the journal; "" if nothing.

    SQLite follows a link in place of the journal or of the files next to it. A rollback file may
    name a "super journal", which SQLite removes; journals of this program never have one.
    """
    for name in (JOURNAL, *(f"{JOURNAL}{ending}" for ending in _SIDE_FILES)):
        path = folder / name
        if path.is_symlink():
            return f"{path}: is a link to {os.readlink(path)}, and SQLite would write there"
    leftover = folder / f"{JOURNAL}{_SIDE_FILES[0]}"
    with contextlib.suppress(FileNotFoundError), open_regular(leftover) as handle:
        size = os.fstat(handle.fileno()).st_size
        handle.seek(max(size - len(_ROLLBACK_MAGIC), 0))
        if size >= 2 * len(_ROLLBACK_MAGIC) and handle.read() == _ROLLBACK_MAGIC:
            return f"{leftover}: names another file, which SQLite would remove"
    return ""


def refuse_traps(folder: Path) -> None:
    """Raise BadInputError if opening the journal would touch a file elsewhere."""
    try:
        trap = journal_trap(folder)
    except OSError as error:
        trap = f"{error.filename}: cannot be read: {error.strerror or error}"
    if trap:
        raise BadInputError(f"{trap}; remove that file, or use another --out")


def create_tables(database: sqlite3.Connection) -> None:
    """Create the tables of an empty journal in one transaction. Raises sqlite3.Error."""
    with database:
        database.execute("begin immediate")
        # Another process may have made them since this one looked.
        if database.execute("select count(*) from sqlite_master").fetchone() == (0,):
            for statement in SCHEMA:
                database.execute(statement)
            database.execute(
                "insert into tally values (?,?,?)", _tally_row(Counter(), sum_digests("0", ()))
            )


def add_rows(
    database: sqlite3.Connection, rows: Iterable[Sequence[Any]], statuses: Counter[str], total: str
) -> None:
    """Write rows within the open transaction and update the tally.

    ``statuses`` and ``total`` are the tally so far.
    """
    # A row that replaces another one is subtracted from the tally first.
    statuses, added, removed = statuses.copy(), [], []
    for row in rows:
        query = "select status, digest from outcome where case_id = ?"
        for status, digest in database.execute(query, (row[0],)).fetchall():
            statuses[status] -= 1
            removed.append(digest)
        database.execute("insert or replace into outcome values (?,?,?,?,?,?,?)", row)
        statuses[row[1]] += 1
        added.append(row[-1])
    total = sum_digests(total, added, removed)
    database.execute(
        "update tally set statuses = ?, digest_sum = ?, digest = ?", _tally_row(+statuses, total)
    )


def row_of(outcome: CaseOutcome) -> tuple[Any, ...]:
    """Return an outcome as the columns of the journal, digest last."""
    # SQLite has no negative zero.
    columns = (outcome.case_id, outcome.status, outcome.reason, float(outcome.flown_s) + 0.0)
    columns = (  # type: ignore[assignment]
        *columns,
        _json_text(outcome.metrics),
        _json_text(outcome.undefined),
    )
    return (*columns, row_digest(columns))


def outcome_of(row: Sequence[Any]) -> CaseOutcome:
    """Return the outcome of a row. Raises ValueError if the row is not as it was written."""
    case_id, status, reason, flown_s, metrics, undefined, digest = row
    has_texts = all(
        isinstance(item, str) for item in (case_id, status, reason, metrics, undefined, digest)
    )
    if not (has_texts and isinstance(flown_s, float) and row_digest(row[:-1]) == digest):
        name = f"flight {case_id}" if isinstance(case_id, str) and case_id.isalnum() else "a flight"
        raise ValueError(f"the row of {name} does not fit its digest")
    values, reasons = _mapping(metrics, {int, float}), _mapping(undefined, {str})
    if status not in STATUSES or values is None or reasons is None:
        raise ValueError("a row holds what no flight of this program leaves")
    return CaseOutcome(case_id, status, reason, flown_s, values, reasons)


def read_tally(database: sqlite3.Connection) -> tuple[Counter[str], str]:
    """Return the number of rows by status and the sum of their digests.

    Raises ValueError if the tally is not as it was written.
    """
    rows = database.execute("select statuses, digest_sum, digest from tally").fetchall()
    if (
        len(rows) != 1
        or not all(isinstance(item, str) for item in rows[0])
        or digest_of_text(rows[0][:2]) != rows[0][2]
    ):
        raise ValueError("its tally of flights does not fit its digest")
    statuses = _mapping(rows[0][0], {int})
    if statuses is None or not set(statuses) <= set(STATUSES):
        raise ValueError("its tally counts what is no status of a flight")
    return Counter(statuses), str(rows[0][1])


def _tally_row(statuses: Mapping[str, int], total: str) -> tuple[str, str, str]:
    """Return the row of the tally with its digest."""
    text = _json_text(statuses)
    return text, total, digest_of_text([text, total])


def _mapping(text: str, kinds: set[type]) -> dict[str, Any] | None:
    """Parse a flat JSON object with values of given types; None for anything else."""
    try:
        mapping = json.loads(text)
    except (ValueError, RecursionError):
        return None
    if not isinstance(mapping, dict) or not set(map(type, mapping.values())) <= kinds:
        return None
    return mapping


def _json_text(mapping: Mapping[str, object]) -> str:
    """Return canonical JSON of a flat mapping."""
    return json.dumps(dict(mapping), sort_keys=True)


@contextlib.contextmanager
def run_lock(folder: Path) -> Iterator[None]:
    """Hold the lock of a folder for one run. Raises BadInputError if another process has it.

    The system releases the lock when the process ends. It is a record lock because children do not
    inherit it: a worker that outlives a killed parent must not keep the folder locked.
    """
    path = folder / LOCK
    key = str(path.resolve())
    if key in _locked_here:
        # Do not open the file: closing a second handle would drop the lock of the first.
        raise _in_use(folder, f"process {os.getpid()}, this one")
    try:
        handle = os.fdopen(open_without_links(path), "r+", encoding="utf-8")
    except OSError as error:
        raise BadInputError(
            f"{path}: cannot be written: {error.strerror or error}; remove it or choose another"
            " --out"
        ) from None
    with handle:
        # `is_running` holds the lock for an instant, so one refusal is not conclusive.
        if not _try_lock(handle.fileno(), attempts=5):
            handle.seek(0)
            raise _in_use(folder, handle.read(200).strip() or "unknown process")
        _locked_here.add(key)
        try:
            handle.seek(0)
            handle.truncate()
            handle.write(f"process {os.getpid()} on {socket.gethostname()}\n")
            handle.flush()
            yield
        finally:
            _locked_here.discard(key)
            # Empty between runs: the content belongs to no result.
            with contextlib.suppress(OSError):
                handle.seek(0)
                handle.truncate()


def is_running(folder: Path) -> bool:
    """Return whether a run holds the folder now."""
    path = folder / LOCK
    if str(path.resolve()) in _locked_here:
        return True
    try:
        with os.fdopen(open_without_links(path, make=False), "r+b") as handle:
            # Closing the handle gives the lock back at once.
            return not _try_lock(handle.fileno())
    except OSError:
        return False


def _in_use(folder: Path, holder: str) -> BadInputError:
    """Return the error for a folder that is in use."""
    return BadInputError(
        f"{folder}: another run is using this folder ({holder}); wait for it, stop it, or choose"
        " another --out"
    )


# A record lock does not exclude its own process: a second run in another thread would pass.
_locked_here: set[str] = set()


def _try_lock(descriptor: int, attempts: int = 1) -> bool:
    """Try to lock a file, several times 50 ms apart."""
    for attempt in range(attempts):
        if attempt:
            time.sleep(0.05)
        if try_lock(descriptor):
            return True
    return False


# Recovery of a damaged journal: every row that fits its digest.

LEFTOVER = f"{JOURNAL}-journal"
"""Rollback file that a killed writer leaves; SQLite uses it to undo an incomplete write."""

_UNREADABLE = (sqlite3.Error, OverflowError, MemoryError, UnicodeError)


class JournalScan:
    """Reader of a journal that may be damaged, which it does not change.

    Parameters
    ----------
    folder : Path
        Folder of the journal.
    scratch : Path
        Empty folder for copies.

    Attributes
    ----------
    damaged : int
        Rows that do not fit their digests.
    unreadable : str
        Why part of the file could not be read; empty if all of it was.
    """

    def __init__(self, folder: Path, scratch: Path) -> None:
        self.damaged = 0
        self.unreadable = ""
        self._folder, self._scratch = folder, scratch

    def rows(self, case_ids: Collection[str] = ()) -> Iterator[tuple[Any, ...]]:
        """Yield intact rows, each once.

        The table is read forwards, then backwards, then by each of ``case_ids``, as far as
        necessary. Raises BadInputError if opening the journal would touch a file elsewhere.
        """
        refuse_traps(self._folder)
        yielded = set[str]()
        for path in self._variants():
            with closing(_open_for_scan(path)) as database:
                for row in self._scan_rows(database, case_ids, yielded):
                    yielded.add(row[0])
                    yield row
            if not self.unreadable:
                return

    def _variants(self) -> Iterator[Path]:
        """Yield the file as SQLite opens it, then a copy with a repaired first page."""
        source = self._folder / JOURNAL
        if (self._folder / LEFTOVER).is_file():
            source = copy_of(self._folder, self._scratch / "as-it-is")
        yield source
        patched_folder = self._scratch / "first-page"
        patched_folder.mkdir(parents=True, exist_ok=True)
        patched = patched_folder / JOURNAL
        shutil.copyfile(source, patched)
        if _replace_first_page(patched, patched_folder / "empty.sqlite"):
            yield patched

    def _scan_rows(
        self, database: sqlite3.Connection, case_ids: Collection[str], yielded: Collection[str]
    ) -> Iterator[tuple[Any, ...]]:
        """Yield intact rows of one variant of the file."""
        visited = set[Any]()
        # Forwards up to the damage, then backwards from the end.
        for direction in ("asc", "desc"):
            yield from self._sound_rows(
                database,
                f"select {COLUMNS} from outcome order by case_id {direction}",
                (),
                yielded,
                visited,
            )
            if not self.unreadable:
                return
        for case_id in case_ids:
            if case_id not in yielded:
                yield from self._sound_rows(
                    database,
                    f"select {COLUMNS} from outcome where case_id = ?",
                    (case_id,),
                    yielded,
                    visited,
                )

    def _sound_rows(
        self,
        database: sqlite3.Connection,
        query: str,
        values: tuple[str, ...],
        yielded: Collection[str],
        visited: set[Any],
    ) -> Iterator[tuple[Any, ...]]:
        """Yield intact rows of a query that were not met before."""
        try:
            for row in database.execute(query, values):
                if row[0] in visited:
                    continue
                visited.add(row[0])
                try:
                    outcome_of(row)
                except ValueError:
                    self.damaged += row[0] not in yielded
                else:
                    if row[0] not in yielded:
                        yield row
        except _UNREADABLE as error:
            self.unreadable = self.unreadable or " ".join(str(error).split())


def copy_of(folder: Path, target: Path) -> Path:
    """Copy the journal and the rollback file next to it, so that opening it changes nothing in
    ``folder``.
    """
    refuse_traps(folder)
    target.mkdir(parents=True, exist_ok=True)
    for name in (JOURNAL, LEFTOVER):
        if (folder / name).is_file():
            shutil.copyfile(folder / name, target / name)
    return target / JOURNAL


def _open_for_scan(path: Path) -> sqlite3.Connection:
    """Open a copy; invalid text becomes rows that do not fit their digests."""
    database = sqlite3.connect(path, timeout=30.0)
    database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, LONGEST_BYTES)
    # Invalid text must not end the search; such a row does not fit its digest.
    database.text_factory = lambda content: content.decode("utf-8", "surrogateescape")
    return database


def _replace_first_page(path: Path, empty: Path) -> bool:
    """Replace the first page, which is the same in all journals, by that of an empty journal.

    Returns False for a file that does not consist of complete pages.
    """
    empty.unlink(missing_ok=True)
    with closing(sqlite3.connect(empty)) as database:
        database.execute("pragma page_size = 8192")
        create_tables(database)
    # The first page names the roots of the tables, which are the same in all journals.
    page = bytearray(empty.read_bytes()[:8192])
    pages, remainder = divmod(path.stat().st_size, len(page))
    if remainder or not pages:
        return False
    # Write the number of pages; the list of free pages is not needed for reading.
    page[28:32], page[32:40] = pages.to_bytes(4, "big"), bytes(8)
    with path.open("r+b") as handle:
        handle.write(page)
    return True
