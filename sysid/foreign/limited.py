"""Foreign formats read in a child process with a time and a memory limit: pyulog, pymavlink, pandas
and pyarrow meet a file there.

What they make of it comes back as data, never as code, so that a file that leads one of them astray
can end the child and nothing else. The child is kept for the files that follow. Where the system
has no limit of address space (Windows, macOS) the time limit holds alone."""

from __future__ import annotations

import atexit
import contextlib
import json
import os
import struct
import subprocess
import sys
import threading
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from sysid.errors import LogError, finding_from_dict
from sysid.foreign.raw import FieldSelection, MessageTable, ProgressCallback, RawLog, TimeColumn
from sysid.foreign.regular_files import in_words, open_regular, require_regular
from sysid.foreign.typed_files import DataFileError, load
from sysid.parallel import ONE_THREAD

# What reading a foreign file may cost: time and memory that grow with the file, so that a long
# log is read and a bomb is not.

MAX_COLUMNS = 5_000
"""Columns of a table. JSBSim's fullest output has about a thousand; a header of a million is no
flight.
"""
MAX_LINE_BYTES = 1_000_000
"""Bytes of a table's header and first rows, each."""
MAX_COMMENT_BYTES = 50_000_000
"""Bytes of a comment before the header, where a flight record keeps what is known of it."""


@dataclass(frozen=True)
class Limit:
    """base_s, bytes_per_s: time allowed; base_bytes, per_byte: memory above what the reader itself
    takes.
    """

    base_s: float
    bytes_per_s: float
    base_bytes: int
    per_byte: float

    def seconds(self, size: int) -> float:
        """Wall-clock time for a file of `size` bytes."""
        return self.base_s + size / self.bytes_per_s

    def bytes(self, size: int) -> int:
        """Memory for a file of `size` bytes; the values that are handed over may take as much."""
        return int(self.base_bytes + self.per_byte * size)


LIMITS = {
    # pyulog reads 10 to 40 MB/s and holds each topic twice while it decodes; a damaged length held
    # it for minutes.
    "ulog": Limit(10.0, 1e6, 400_000_000, 8.0),
    # pymavlink decodes 2 to 4 MB/s; a packet of 25 bytes becomes up to ten numbers of 8.
    "tlog": Limit(10.0, 0.25e6, 300_000_000, 8.0),
    # pandas reads 20 to 100 MB/s; a cell of two characters becomes a number of 8 bytes, and is held
    # twice on the way.
    "csv": Limit(10.0, 2e6, 400_000_000, 16.0),
    # Parquet packs: ten times is usual for a flight, thousands of times is a bomb.
    "parquet": Limit(10.0, 1e6, 600_000_000, 40.0),
}


def memory_refusal(content: str, needed: float, allowed: float) -> str:
    """The sentence for a file that asks for more memory than one of its size should."""
    return (
        f"{content} would take {in_words(needed)} of memory; a file of its size may take"
        f" {in_words(allowed)}: it is damaged or made to fill the memory; keep fewer rows and"
        " columns, or export it again"
    )


_START_S = 120.0  # nothing of a stranger's is read yet: only a busy disk makes this long
_HOME = Path(__file__).parents[2]
# The package is found where this one is, and its folder is on the path for no longer than that
# takes.
_READER_CODE = (
    "import sys; sys.path.insert(0, sys.argv[1]); import sysid; del sys.path[0]; "
    "from sysid.logs.importers.limited_child import main; main()"
)


def read_raw(
    path: Path,
    dialect: str,
    selection: FieldSelection | None,
    progress: ProgressCallback | None = None,
    time: TimeColumn | None = None,
) -> RawLog:
    """A log of dialect ulog, tlog, csv, jsbsim-csv or parquet; `selection` and `time` as in the
    importers.

    Raises LogError for what cannot be read, and for what takes more time or memory than a file of
    its size should."""
    names = (
        None
        if selection is None
        else {message: sorted(fields) for message, fields in selection.items()}
    )
    details = {"selection": names, "time": None if time is None else [time.field, time.unit]}
    messages: dict[tuple[str, int], MessageTable] = {}
    about: dict[str, Any] = {}
    for kind, *content in _request(path, dialect, details, progress):
        if kind == "table":
            name, instance, time_s, fields, place = content
            rows = place if len(place) else None
            messages[name, instance] = MessageTable(time_s, fields, rows)
        else:
            (about,) = content
    return RawLog(
        dialect=about["dialect"],
        messages=messages,
        counts=dict(zip(about["count_names"].tolist(), about["counts"].tolist(), strict=True)),
        parameters=dict(zip(about["parameters"].tolist(), about["values"].tolist(), strict=True)),
        texts=tuple(zip(about["text_time_s"].tolist(), about["texts"].tolist(), strict=True)),
        vehicle=about["vehicle"],
        facts=about["facts"],
        findings=tuple(finding_from_dict(row) for row in about["findings"]),
        headers=tuple(about["headers"].tolist()),
        parameter_log=tuple(
            zip(
                about["parameter_place"].tolist(),
                about["parameter_name"].tolist(),
                about["parameter_value"].tolist(),
                strict=True,
            )
        ),
        text_places=tuple(about["text_place"].tolist()),
    )


def read_record(path: Path) -> tuple[dict[str, NDArray[Any]], str]:
    """Columns and metadata (JSON, "" where there is none) of a flight record's file.

    Raises LogError as `read_raw`.
    """
    columns: dict[str, NDArray[Any]] = {}
    metadata = ""
    for kind, *content in _request(path, "record", {}):
        if kind == "column":
            name, values = content
            columns[name] = values
        else:
            (metadata,) = content
    return columns, metadata


def read_table(path: Path) -> dict[str, NDArray[Any]]:
    """Columns of a small CSV table, each of float64 or of texts. Raises LogError as `read_raw`."""
    return {name: values for _, name, values in _request(path, "table", {})}


class _ReaderProcess:
    """A reader process, and the pipes to and from it."""

    def __init__(self) -> None:
        environment = {**os.environ, **ONE_THREAD, "ARROW_DEFAULT_MEMORY_POOL": "system"}
        # It says nothing on the terminal: what is wrong comes back as a sentence.
        self.process = subprocess.Popen(
            [sys.executable, "-P", "-c", _READER_CODE, str(_HOME)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=environment,
        )
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.orders, self.answers = self.process.stdin, self.process.stdout

    def frame(self) -> tuple[bytes, int]:
        """Kind and length of the next answer. Raises _Ended when the child has ended."""
        head = self.content(9)
        return head[:1], struct.unpack("<Q", head[1:])[0]

    def content(self, length: int) -> bytes:
        """That many bytes of the answer. Raises _Ended."""
        received = self.answers.read(length)
        if len(received) < length:
            raise _ReaderEnded
        return received

    def end(self) -> None:
        """Kill it. Safe to call again."""
        self.process.kill()
        for pipe in (self.orders, self.answers):
            with contextlib.suppress(OSError):
                pipe.close()
        self.process.wait()


class _Deadline:
    """Kills a child that is not done in time."""

    def __init__(self, child: _ReaderProcess, seconds: float) -> None:
        self._child, self.expired = child, False
        self._timer = threading.Timer(seconds, self._end)
        self._timer.daemon = True

    def _end(self) -> None:
        self.expired = True
        self._child.process.kill()

    def __enter__(self) -> _Deadline:
        self._timer.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._timer.cancel()


_lock = threading.Lock()
_children: dict[int, _ReaderProcess] = {}  # by process: a forked one must not talk to its parent's


def _request(
    path: Path, kind: str, details: Mapping[str, Any], progress: ProgressCallback | None = None
) -> list[tuple[Any, ...]]:
    """What the child has to say of one file, part by part."""
    try:
        size = require_regular(path).st_size
    except OSError as error:
        raise LogError(f"cannot be read: {error.strerror}", path) from None
    limit = LIMITS[_limit_name(kind, path)]
    # A path of its own kind: this process may have changed its folder since the child began.
    file = os.path.abspath(path)
    order = {"kind": kind, "path": file, "memory": limit.bytes(size), **details}
    with _lock:
        child = _reader_process(path)
        try:
            _send_order(child, order, path)
            with _Deadline(child, limit.seconds(size)) as deadline:
                parts, refusal = _answers(child, limit.bytes(size), progress)
        except BaseException as error:
            _end_children()
            if isinstance(error, _ReaderEnded):
                raise LogError(_ending_message(error, child, deadline, limit, size), path) from None
            raise
        if deadline.expired:
            _end_children()
    if refusal:
        raise LogError(
            f"{path}{refusal.removeprefix(file)}" if refusal.startswith(f"{file}: ") else refusal
        )
    return parts


class _ReaderEnded(Exception):
    """The child has ended, or must: `reason` says why in words where it is known."""

    def __init__(self, reason: str = "") -> None:
        self.reason = reason


def _send_order(child: _ReaderProcess, order: Mapping[str, Any], path: Path) -> None:
    """Give an order and wait until the reader has loaded what it needs.

    Raises LogError where it has not.
    """
    with contextlib.suppress(OSError, _ReaderEnded), _Deadline(child, _START_S):
        child.orders.write(json.dumps(order).encode() + b"\n")
        child.orders.flush()
        kind, length = child.frame()
        if kind == b"r":
            return
        raise RuntimeError(
            f"{path}: the reader failed:\n{child.content(length).decode('utf-8', 'replace')}"
        )
    raise _not_started(path)


def _answers(
    child: _ReaderProcess, max_bytes: int, progress: ProgressCallback | None
) -> tuple[list[tuple[Any, ...]], str]:
    """The parts of an answer, and the sentence of a refusal ("" if there is none)."""
    parts: list[tuple[Any, ...]] = []
    received = 0
    while True:
        kind, length = child.frame()
        received += length
        if received > max_bytes:
            raise _ReaderEnded("memory")
        content = child.content(length)
        if kind == b"p":
            if progress is not None:
                progress(struct.unpack("<d", content)[0])
        elif kind == b"c":
            try:
                parts.append(load(content))
            except DataFileError as error:
                raise _ReaderEnded(str(error)) from None
        elif kind == b"d":
            return parts, ""
        elif kind == b"e":
            return [], content.decode("utf-8", "surrogatepass")
        elif kind == b"m":
            raise _ReaderEnded("memory")
        else:
            raise RuntimeError(f"the reader of a log failed:\n{content.decode('utf-8', 'replace')}")


def _ending_message(
    ended: _ReaderEnded, child: _ReaderProcess, deadline: _Deadline, limit: Limit, size: int
) -> str:
    advice = "it is damaged or made to do so; copy the log again"
    if deadline.expired:
        return (
            f"reading took longer than the {limit.seconds(size):.0f} s that a file of"
            f" {in_words(size)} may take: {advice}"
        )
    if ended.reason == "memory":
        allowed = in_words(limit.bytes(size))
        return (
            f"reading took more than the {allowed} of memory that a file of {in_words(size)} may"
            f" take: {advice}"
        )
    reason = ended.reason or f"code {child.process.returncode}"
    return (
        f"the reader of this format ended without an answer ({reason}): the file is damaged; copy the"
        " log again"
    )


def _limit_name(kind: str, path: Path) -> str:
    if kind in LIMITS:
        return kind
    with open_regular(path) as handle:
        return "parquet" if handle.read(4) == b"PAR1" else "csv"


def _reader_process(path: Path) -> _ReaderProcess:
    """The reader of this process, started if there is none. Raises LogError where it cannot be."""
    child = _children.get(os.getpid())
    if child is not None and child.process.poll() is None:
        return child
    _end_children()
    try:
        child = _children[os.getpid()] = _ReaderProcess()
    except (OSError, MemoryError):
        raise _not_started(path) from None
    return child


def _not_started(path: Path) -> LogError:
    return LogError(
        "the process that reads this format could not be started; free some memory and try again",
        path,
    )


def _end_children() -> None:
    child = _children.pop(os.getpid(), None)
    if child is not None:
        child.end()


atexit.register(_end_children)


# A limit on the memory that this process may take, for a child that works on a stranger's file.


class MemoryLimit:
    """Lets this process take so many bytes of address space more than it has, where the system can
    hold it to that.
    """

    def __init__(self, extra_bytes: int) -> None:
        self._more = extra_bytes

    def __enter__(self) -> None:
        self._before = _address_limit()
        if self._before is not None:
            hard = self._before[1]
            soft = _address_space() + self._more
            _set_address_limit((soft if hard < 0 else min(soft, hard), hard))

    def __exit__(self, *_: object) -> None:
        if self._before is not None:
            _set_address_limit(self._before)


def _address_space() -> int:
    with open("/proc/self/statm", encoding="ascii") as handle:
        return int(handle.read().split()[0]) * os.sysconf("SC_PAGE_SIZE")


def _address_limit() -> tuple[int, int] | None:
    """Soft and hard limit; None where there is none, or where what is used already is not known."""
    try:
        import resource

        _address_space()
        return resource.getrlimit(resource.RLIMIT_AS)
    except (ImportError, OSError, AttributeError):
        return None


def _set_address_limit(limit: tuple[int, int]) -> None:
    import resource

    resource.setrlimit(resource.RLIMIT_AS, limit)
