"""What can still be read of a damaged journal: every row that fits its digest, wherever in the file it is found."""

from __future__ import annotations

import shutil
import sqlite3
from collections.abc import Collection, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

from uqharness.campaign.folder.store import (
    COLUMNS,
    JOURNAL,
    LONGEST_BYTES,
    create_tables,
    outcome_of,
    refuse_traps,
)

LEFTOVER = f"{JOURNAL}-journal"
"""What a writer that was killed leaves beside the journal; SQLite takes back what was half written by it."""

_UNREADABLE = (sqlite3.Error, OverflowError, MemoryError, UnicodeError)


class JournalScan:
    """Goes through a journal that may be damaged, without changing it; ``scratch`` is an empty folder for copies.

    ``damaged``: rows met that do not fit their digests. ``unreadable``: why not all of the file could be read, empty if it could.
    """

    def __init__(self, folder: Path, scratch: Path) -> None:
        self.damaged = 0
        self.unreadable = ""
        self._folder, self._scratch = folder, scratch

    def rows(self, wanted: Collection[str] = ()) -> Iterator[tuple[Any, ...]]:
        """Sound rows, each once: forwards, backwards, each of the case ids ``wanted`` by itself, as far as that is needed.

        Raises BadInputError where opening the journal would touch a file elsewhere.
        """
        refuse_traps(self._folder)
        seen = set[str]()
        for path in self._variants():
            with closing(_opened(path)) as database:
                for row in self._found(database, wanted, seen):
                    seen.add(row[0])
                    yield row
            if not self.unreadable:
                return

    def _variants(self) -> Iterator[Path]:
        """The file as SQLite opens it, then with a first page that says again where its tables begin."""
        source = self._folder / JOURNAL
        if (self._folder / LEFTOVER).is_file():
            source = copy_of(self._folder, self._scratch / "as-it-is")
        yield source
        begun = self._scratch / "first-page"
        begun.mkdir(parents=True, exist_ok=True)
        mended = begun / JOURNAL
        shutil.copyfile(source, mended)
        if _give_first_page(mended, begun / "empty.sqlite"):
            yield mended

    def _found(
        self, database: sqlite3.Connection, wanted: Collection[str], seen: Collection[str]
    ) -> Iterator[tuple[Any, ...]]:
        met = set[Any]()
        for direction in ("asc", "desc"):
            yield from self._sound(
                database,
                f"select {COLUMNS} from outcome order by case_id {direction}",
                (),
                seen,
                met,
            )
            if not self.unreadable:
                return
        for case_id in wanted:
            if case_id not in seen:
                yield from self._sound(
                    database,
                    f"select {COLUMNS} from outcome where case_id = ?",
                    (case_id,),
                    seen,
                    met,
                )

    def _sound(
        self,
        database: sqlite3.Connection,
        query: str,
        values: tuple[str, ...],
        seen: Collection[str],
        met: set[Any],
    ) -> Iterator[tuple[Any, ...]]:
        try:
            for row in database.execute(query, values):
                if row[0] in met:
                    continue
                met.add(row[0])
                try:
                    outcome_of(row)
                except ValueError:
                    self.damaged += row[0] not in seen
                else:
                    if row[0] not in seen:
                        yield row
        except _UNREADABLE as error:
            self.unreadable = self.unreadable or " ".join(str(error).split())


def copy_of(folder: Path, target: Path) -> Path:
    """The journal and what lies beside it, copied: opening the copy changes nothing in ``folder``."""
    refuse_traps(folder)
    target.mkdir(parents=True, exist_ok=True)
    for name in (JOURNAL, LEFTOVER):
        if (folder / name).is_file():
            shutil.copyfile(folder / name, target / name)
    return target / JOURNAL


def _opened(path: Path) -> sqlite3.Connection:
    database = sqlite3.connect(path, timeout=30.0)
    database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, LONGEST_BYTES)
    # Bytes that are no text make a row that does not fit its digest, and do not end the search.
    database.text_factory = lambda content: content.decode("utf-8", "surrogateescape")
    return database


def _give_first_page(path: Path, empty: Path) -> bool:
    """Put the first page of an empty journal over that of ``path``, for all begin alike. False for a file of no whole pages."""
    empty.unlink(missing_ok=True)
    with closing(sqlite3.connect(empty)) as database:
        database.execute("pragma page_size = 8192")
        create_tables(database)
    page = bytearray(empty.read_bytes()[:8192])
    pages, rest = divmod(path.stat().st_size, len(page))
    if rest or not pages:
        return False
    # Pages of the file; no free ones, which reading does not need.
    page[28:32], page[32:40] = pages.to_bytes(4, "big"), bytes(8)
    with path.open("r+b") as handle:
        handle.write(page)
    return True
