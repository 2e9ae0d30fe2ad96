"""The reader process that `sysid.foreign.limited` starts.

It reads one file after another, each within its memory limit, and sends data only. An order is a
line of JSON on standard input. An answer is a sequence of frames on standard output: one letter, a
length of 8 bytes, and as many bytes. The letters are r (reading begins), p (share done), c (a
part, as `sysid.foreign.typed_files` writes it), d (done), e (refused, with a message), m (out of
memory) and x (failed, with a traceback).
"""

from __future__ import annotations

import importlib
import json
import os
import queue
import signal
import struct
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from sysid.errors import LogError
from sysid.foreign.limited import MemoryLimit
from sysid.foreign.raw import ProgressCallback, RawLog, TimeColumn
from sysid.foreign.typed_files import dump
from sysid.logs.csv_dialects import CSV_DIALECTS

_PROGRESS_S = 0.1


def main() -> None:
    """Serve orders until standard input ends, which happens when the parent ends."""
    # Ctrl-C reaches the whole process group; the parent decides what it means.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # Text that a library prints must not mix with the frames.
    answers = os.fdopen(os.dup(1), "wb")
    devnull = os.open(os.devnull, os.O_WRONLY)
    os.dup2(devnull, 1)
    orders: queue.Queue[bytes] = queue.Queue()
    threading.Thread(target=_receive, args=(orders,), daemon=True).start()
    while True:
        _serve(json.loads(orders.get()), answers)


def _receive(orders: queue.Queue[bytes]) -> None:
    """Queue orders; end this process, even in the middle of a file, when standard input ends."""
    for line in sys.stdin.buffer:
        orders.put(line)
    os._exit(0)


def _serve(order: Mapping[str, Any], answers: BinaryIO) -> None:
    """Read one file and send its parts, or the reason why it cannot be read."""
    try:
        # The time and memory for loading the libraries do not count for the file.
        module, read = _READERS[order["kind"]]
        importer = importlib.import_module(f"sysid.logs.{module}")
        _frame(answers, b"r")
        with MemoryLimit(int(order["memory"])):
            for part in read(importer, Path(order["path"]), order, _progress(answers)):
                _frame(answers, b"c", dump(part))
    except LogError as error:
        _frame(answers, b"e", str(error).encode("utf-8", "surrogatepass"))
    except MemoryError:
        _frame(answers, b"m")
    except BrokenPipeError:
        os._exit(0)
    except Exception:
        _frame(answers, b"x", traceback.format_exc().encode("utf-8", "replace"))
    else:
        _frame(answers, b"d")


def _frame(answers: BinaryIO, kind: bytes, content: bytes = b"") -> None:
    """Write one frame of an answer."""
    answers.write(kind + struct.pack("<Q", len(content)))
    answers.write(content)
    answers.flush()


def _progress(answers: BinaryIO) -> ProgressCallback:
    """Return a callback that sends the share done, at most every _PROGRESS_S."""
    last = time.monotonic()

    def send_progress(share: float) -> None:
        """Send the share done unless one was sent a moment ago."""
        nonlocal last
        if time.monotonic() - last >= _PROGRESS_S:
            last = time.monotonic()
            _frame(answers, b"p", struct.pack("<d", share))

    return send_progress


Parts = Iterator[tuple[Any, ...]]


def _messages(
    importer: Any, path: Path, order: Mapping[str, Any], callback: ProgressCallback
) -> Parts:
    """Read a ULog or telemetry log."""
    return _log_parts(importer.read(path, _selection(order), callback))


def _csv(tables: Any, path: Path, order: Mapping[str, Any], callback: ProgressCallback) -> Parts:
    """Read a CSV table."""
    return _log_parts(
        tables.read_csv(path, _selection(order), CSV_DIALECTS[order["kind"]], _time(order))
    )


def _parquet(
    tables: Any, path: Path, order: Mapping[str, Any], callback: ProgressCallback
) -> Parts:
    """Read a Parquet table."""
    memory = int(order["memory"])
    return _log_parts(tables.read_parquet(path, _selection(order), memory, _time(order)))


def _mat(importer: Any, path: Path, order: Mapping[str, Any], callback: ProgressCallback) -> Parts:
    """Read a MATLAB file."""
    return _log_parts(importer.read(path, _selection(order), _time(order)))


def _record(tables: Any, path: Path, order: Mapping[str, Any], callback: ProgressCallback) -> Parts:
    """Read a flight record."""
    columns, metadata = tables.read_record(path, int(order["memory"]))
    for name, values in columns.items():
        yield "column", name, values
    yield "metadata", metadata


def _table(tables: Any, path: Path, order: Mapping[str, Any], callback: ProgressCallback) -> Parts:
    """Read a small CSV table."""
    for name, values in tables.read_small_table(path).items():
        yield "column", name, values


_READERS: dict[str, tuple[str, Callable[..., Parts]]] = {
    "ulog": ("ulog", _messages),
    "tlog": ("tlog", _messages),
    "mat": ("mat", _mat),
    **dict.fromkeys(CSV_DIALECTS, ("tables", _csv)),
    "parquet": ("tables", _parquet),
    "record": ("tables", _record),
    "table": ("tables", _table),
}


def _selection(order: Mapping[str, Any]) -> dict[str, frozenset[str]] | None:
    """Return the message fields that an order asks for; None for all."""
    selection = order["selection"]
    return (
        None
        if selection is None
        else {message: frozenset(fields) for message, fields in selection.items()}
    )


def _time(order: Mapping[str, Any]) -> TimeColumn | None:
    """Return the time column that an order names; None to detect it."""
    time = order.get("time")
    return None if time is None else TimeColumn(*time)


def _log_parts(raw: RawLog) -> Parts:
    """Yield the tables of a log, then everything else about it."""
    for (name, instance), table in raw.messages.items():
        place = np.zeros(0, dtype=np.int64) if table.place is None else table.place
        yield "table", name, instance, table.time_s, dict(table.fields), place
    yield (
        "about",
        {
            "dialect": raw.dialect,
            "count_names": _texts(raw.counts),
            "counts": np.array(list(raw.counts.values()), dtype=np.int64),
            "parameters": _texts(raw.parameters),
            "values": np.array(list(raw.parameters.values()), dtype=np.float64),
            "text_time_s": np.array([t for t, _ in raw.texts], dtype=np.float64),
            "texts": _texts(text for _, text in raw.texts),
            "text_place": np.array(raw.text_places, dtype=np.int64),
            "parameter_place": np.array([at for at, _, _ in raw.parameter_log], dtype=np.int64),
            "parameter_name": _texts(name for _, name, _ in raw.parameter_log),
            "parameter_value": np.array([v for _, _, v in raw.parameter_log], dtype=np.float64),
            "headers": np.array(raw.headers, dtype=np.int64),
            "vehicle": raw.vehicle,
            "facts": dict(raw.facts),
            "findings": [finding.as_dict() for finding in raw.findings],
        },
    )


def _texts(texts: Any) -> np.ndarray[Any, Any]:
    """Return texts as an object array, which a data file stores as one buffer."""
    items = list(texts)
    out = np.empty(len(items), dtype=object)
    out[:] = items
    return out
