"""Read foreign formats in a child process with a time limit and a memory limit.

pyulog, pymavlink, pandas and pyarrow parse files only in that process. It returns data and no code
(`typed_files`), so that a malicious file can at most end the child. The child stays alive for the
next file. Systems without a limit of the address space (Windows, macOS) have the time limit alone.
"""

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

# Limits on time and memory grow with the size of the file: a long log is read, a decompression
# bomb is not.

MAX_COLUMNS = 5_000
"""Columns of a table. JSBSim writes about a thousand at most."""
MAX_LINE_BYTES = 1_000_000
"""Bytes of the header of a table, and of each of its first rows."""
MAX_COMMENT_BYTES = 50_000_000
"""Bytes of a comment above the header, where a flight record stores its metadata."""


@dataclass(frozen=True)
class Limit:
    """Time and memory that a reader may use.

    Attributes
    ----------
    base_s, bytes_per_s : float
        Allowed time: ``base_s + size / bytes_per_s``, s.
    base_bytes, per_byte : float
        Allowed memory above that of the reader itself: ``base_bytes + per_byte * size``.
    """

    base_s: float
    bytes_per_s: float
    base_bytes: int
    per_byte: float

    def seconds(self, size: int) -> float:
        """Return the allowed wall-clock time for a file of `size` bytes, s."""
        return self.base_s + size / self.bytes_per_s

    def bytes(self, size: int) -> int:
        """Return the allowed memory for a file of `size` bytes; the answer may be as large."""
        return int(self.base_bytes + self.per_byte * size)


LIMITS = {
    # pyulog reads 10 to 40 MB/s and holds each topic twice while it decodes. A damaged length
    # field can keep it busy for minutes.
    "ulog": Limit(10.0, 1e6, 400_000_000, 8.0),
    # pymavlink decodes 2 to 4 MB/s; a packet of 25 bytes becomes up to ten numbers of 8.
    "tlog": Limit(10.0, 0.25e6, 300_000_000, 8.0),
    # pandas reads 20 to 100 MB/s. A cell of two characters becomes a number of 8 bytes, of
    # which pandas holds two copies for a while.
    "csv": Limit(10.0, 2e6, 400_000_000, 16.0),
    # scipy and h5py read 20 MB/s and more of compressed files, which hold factors of two to ten.
    "mat": Limit(10.0, 1e6, 600_000_000, 40.0),
    # Parquet compresses: a factor of ten is usual for a flight, a factor of thousands is a bomb.
    "parquet": Limit(10.0, 1e6, 600_000_000, 40.0),
}


def memory_refusal(content: str, needed: float, allowed: float) -> str:
    """Return the message for a file that needs more memory than its size justifies."""
    return (
        f"{content} would take {in_words(needed)} of memory; a file of its size may take"
        f" {in_words(allowed)}: it is damaged or made to fill the memory; keep fewer rows and"
        " columns, or export it again"
    )


# The child loads its libraries only, so that a long wait means a slow disk.
_START_S = 120.0
_HOME = Path(__file__).parents[2]
# Import sysid from the folder of this file, and leave that folder on the path no longer than
# needed.
_READER_CODE = (
    "import sys; sys.path.insert(0, sys.argv[1]); import sysid; del sys.path[0]; "
    "from sysid.logs.limited_child import main; main()"
)


def read_raw(
    path: Path,
    dialect: str,
    selection: FieldSelection | None,
    callback: ProgressCallback | None = None,
    time: TimeColumn | None = None,
) -> RawLog:
    """Read a log in the child process.

    Parameters
    ----------
    path : Path
        File of one of the dialects ulog, tlog, mat, csv, jsbsim-csv and parquet.
    dialect : str
        Its dialect.
    selection : mapping or None
        Message name to field names that are returned; None returns everything.
    callback : callable, optional
        Called with the share that has been read, 0 to 1.
    time : TimeColumn, optional
        Column of the times of a table; None lets the reader choose.

    Raises
    ------
    LogError
        If the file cannot be read, or needs more time or memory than its size justifies.
    """
    # The request is JSON: sets become sorted lists.
    names = (
        None
        if selection is None
        else {message: sorted(fields) for message, fields in selection.items()}
    )
    details = {"selection": names, "time": None if time is None else [time.field, time.unit]}
    # The answer is a series of tables, and one object with everything else.
    messages: dict[tuple[str, int], MessageTable] = {}
    properties: dict[str, Any] = {}
    for kind, *content in _request(path, dialect, details, callback):
        if kind == "table":
            name, instance, time_s, fields, place = content
            rows = place if len(place) else None
            messages[name, instance] = MessageTable(time_s, fields, rows)
        else:
            (properties,) = content
    # Parallel arrays of the answer become the pairs and tuples of a RawLog.
    return RawLog(
        dialect=properties["dialect"],
        messages=messages,
        counts=dict(
            zip(properties["count_names"].tolist(), properties["counts"].tolist(), strict=True)
        ),
        parameters=dict(
            zip(properties["parameters"].tolist(), properties["values"].tolist(), strict=True)
        ),
        texts=tuple(
            zip(properties["text_time_s"].tolist(), properties["texts"].tolist(), strict=True)
        ),
        vehicle=properties["vehicle"],
        facts=properties["facts"],
        findings=tuple(finding_from_dict(row) for row in properties["findings"]),
        headers=tuple(properties["headers"].tolist()),
        parameter_log=tuple(
            zip(
                properties["parameter_place"].tolist(),
                properties["parameter_name"].tolist(),
                properties["parameter_value"].tolist(),
                strict=True,
            )
        ),
        text_places=tuple(properties["text_place"].tolist()),
    )


def read_record(path: Path) -> tuple[dict[str, NDArray[Any]], str]:
    """Return columns and metadata (JSON; "" if absent) of a flight record's file.

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
    """Return the columns of a small CSV table, each of float64 or of text.

    Raises LogError as `read_raw`.
    """
    return {name: values for _, name, values in _request(path, "table", {})}


class _ReaderProcess:
    """A reader process with the pipes to and from it."""

    def __init__(self) -> None:
        environment = {**os.environ, **ONE_THREAD, "ARROW_DEFAULT_MEMORY_POOL": "system"}
        # Its standard error is discarded: all errors come back in an answer.
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
        """Return kind (one byte) and length of the next part of the answer; raise _ReaderEnded."""
        head = self.content(9)
        return head[:1], struct.unpack("<Q", head[1:])[0]

    def content(self, length: int) -> bytes:
        """Return the next `length` bytes of the answer; raise _ReaderEnded if the process has
        ended.
        """
        received = self.answers.read(length)
        if len(received) < length:
            raise _ReaderEnded
        return received

    def end(self) -> None:
        """Kill the process. A second call has no effect."""
        self.process.kill()
        for pipe in (self.orders, self.answers):
            with contextlib.suppress(OSError):
                pipe.close()
        self.process.wait()


class _Deadline:
    """Kills a reader process that has not finished after a time; `expired` says whether it did."""

    def __init__(self, child: _ReaderProcess, seconds: float) -> None:
        self._child, self.expired = child, False
        self._timer = threading.Timer(seconds, self._end)
        self._timer.daemon = True

    def _end(self) -> None:
        """Kill the reader."""
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
    path: Path, kind: str, details: Mapping[str, Any], callback: ProgressCallback | None = None
) -> list[tuple[Any, ...]]:
    """Send one order to the reader and return the parts of its answer.

    Raises LogError with a reason if the reader refuses the file, ends, or exceeds a limit.
    """
    try:
        size = require_regular(path).st_size
    except OSError as error:
        raise LogError(f"cannot be read: {error.strerror}", path) from None
    limit = LIMITS[_limit_name(kind, path)]
    # An absolute path: this process may have changed its folder since the child started.
    file = os.path.abspath(path)
    order = {"kind": kind, "path": file, "memory": limit.bytes(size), **details}
    # One order at a time: the answers of a child come in the order of its requests.
    with _lock:
        child = _reader_process(path)
        try:
            _send_order(child, order, path)
            with _Deadline(child, limit.seconds(size)) as deadline:
                parts, refusal = _answers(child, limit.bytes(size), callback)
        # After any failure the pipes may hold half an answer: this child is not used again.
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
    """The reader process has ended, or must be ended; ``reason`` is text for the user, or ""."""

    def __init__(self, reason: str = "") -> None:
        self.reason = reason


def _send_order(child: _ReaderProcess, order: Mapping[str, Any], path: Path) -> None:
    """Send an order and wait until the reader has loaded its libraries.

    Raises LogError if it does not start within _START_S.
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
    child: _ReaderProcess, max_bytes: int, callback: ProgressCallback | None
) -> tuple[list[tuple[Any, ...]], str]:
    """Return the parts of an answer, and the message of a refusal ("" if there is none)."""
    parts: list[tuple[Any, ...]] = []
    received = 0
    while True:
        # Kinds: p progress, c content, d done, e refusal, m memory exceeded, anything else a
        # traceback.
        kind, length = child.frame()
        received += length
        if received > max_bytes:
            raise _ReaderEnded("memory")
        content = child.content(length)
        if kind == b"p":
            if callback is not None:
                callback(struct.unpack("<d", content)[0])
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
    """Return why the reader ended, for the user."""
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
        f"the reader of this format ended without an answer ({reason}): the file is damaged; copy"
        " the log again"
    )


def _limit_name(kind: str, path: Path) -> str:
    """Return the key of LIMITS; a record is Parquet or CSV by its first bytes."""
    if kind in LIMITS:
        return kind
    with open_regular(path) as handle:
        return "parquet" if handle.read(4) == b"PAR1" else "csv"


def _reader_process(path: Path) -> _ReaderProcess:
    """Return the reader of this process, started if there is none; raise LogError if it cannot
    start.
    """
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
    """Return the error for a reader process that does not start."""
    return LogError(
        "the process that reads this format could not be started; free some memory and try again",
        path,
    )


def _end_children() -> None:
    """Kill the reader of this process, if there is one."""
    child = _children.pop(os.getpid(), None)
    if child is not None:
        child.end()


atexit.register(_end_children)


# Memory limit, for the child process itself.


class MemoryLimit:
    """Allow this process ``extra_bytes`` of address space above its present use, inside ``with``.

    It has no effect on systems that cannot limit the address space.
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
    """Return the address space in use, bytes."""
    with open("/proc/self/statm", encoding="ascii") as handle:
        return int(handle.read().split()[0]) * os.sysconf("SC_PAGE_SIZE")


def _address_limit() -> tuple[int, int] | None:
    """Return soft and hard limit; None if the system has no limit or does not report the present
    use.
    """
    try:
        import resource

        _address_space()
        return resource.getrlimit(resource.RLIMIT_AS)
    except (ImportError, OSError, AttributeError):
        return None


def _set_address_limit(limit: tuple[int, int]) -> None:
    """Set soft and hard limit of the address space."""
    import resource

    resource.setrlimit(resource.RLIMIT_AS, limit)
