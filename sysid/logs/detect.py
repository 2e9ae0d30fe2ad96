"""Detect the format of a log by its content.

File names are not used: logs get renamed, and a .bin may be anything.
"""

from __future__ import annotations

import struct
from pathlib import Path

from sysid.errors import LogError
from sysid.foreign.regular_files import open_regular
from sysid.logs.channels import COMPONENTS
from sysid.logs.csv_dialects import csv_dialect_of
from sysid.logs.dataflash import FMT_LENGTH, FMT_TYPE, MAGIC
from sysid.logs.tables import SNIFFED_BYTES, decoded, sniff
from sysid.vocabulary import SIGNALS

_FOREIGN = {
    b"\x89PNG": "a PNG picture",
    b"PK\x03\x04": "a ZIP archive (unpack it first)",
    b"\x1f\x8b": "a gzip archive (unpack it first)",
    b"BZh": "a bzip2 archive (unpack it first)",
    b"\xfd7zXZ": "an xz archive (unpack it first)",
    b"7z\xbc\xaf": "a 7-Zip archive (unpack it first)",
    b"%PDF": "a PDF document",
    b"\xff\xd8\xff": "a JPEG picture",
    b"GIF8": "a GIF picture",
    b"\x7fELF": "a program",
    b"SQLite": "an SQLite database",
    b"PARE": "an encrypted Parquet file (export it without)",
}
_SUPPORTED = (
    "DataFlash .bin or .log, MAVLink .tlog, PX4 .ulg, MATLAB .mat, a flight record in Parquet or"
    " CSV, JSBSim's CSV"
)


def detect(path: Path) -> str:
    """Return the dialect of a log file.

    Parameters
    ----------
    path : Path
        Log file.

    Returns
    -------
    str
        dataflash, dataflash-text, tlog, ulog, mat, parquet, jsbsim-csv or csv.

    Raises
    ------
    LogError
        If the file cannot be read or is none of these; the message names what it is, if known.
    """
    try:
        with open_regular(path) as handle:
            head = handle.read(SNIFFED_BYTES)
    except FileNotFoundError:
        raise LogError("no such file", path) from None
    except IsADirectoryError:
        raise LogError(f"is a folder; give a file: {_SUPPORTED}", path) from None
    except OSError as e:
        raise LogError(f"cannot be read: {e.strerror}", path) from None
    if not head:
        raise LogError("the file is empty (0 bytes); copy the log again", path)
    for magic, description in _FOREIGN.items():
        if head.startswith(magic):
            raise LogError(
                f"this is {description}, not a flight log; allowed are {_SUPPORTED}", path
            )
    dialect = _binary(head) or _text(head)
    if dialect is None:
        raise LogError(_not_recognised(head), path)
    return dialect


def _not_recognised(head: bytes) -> str:
    """Return the message for a file of unknown format."""
    content = decoded(head)
    line = next((x for x in content[0].splitlines() if x.strip(" #")), "") if content else ""
    if line:
        return (
            f"not recognised as a flight log: a text whose first line is '{line.strip()[:80]}', and"
            " no table. A table has a line of names, then rows of numbers, separated by commas,"
            f" semicolons or tabs; allowed are also {_SUPPORTED}"
        )
    return (
        f"not recognised as a flight log (it begins with {head[:8].hex(' ')}); allowed are"
        f" {_SUPPORTED}. If this is one of them its beginning is damaged: copy the log again"
    )


def _binary(head: bytes) -> str | None:
    """Return the dialect of a binary log by its first bytes; None for others."""
    if head.startswith(b"PAR1"):
        return "parquet"
    if head.startswith(b"ULog\x01\x12\x35"):
        return "ulog"
    if head.startswith((b"MATLAB ", b"\x89HDF\r\n\x1a\n")):
        return "mat"
    if head.startswith(MAGIC) or MAGIC + bytes((FMT_TYPE, FMT_TYPE, FMT_LENGTH)) in head:
        return "dataflash"
    return "tlog" if _tlog_frames(head) >= min(3, max(1, len(head) // 300)) else None


def _tlog_frames(head: bytes) -> int:
    """Return the longest run of consecutive frames (8 bytes of time, then a MAVLink packet) near
    the begin.
    """
    best = 0
    for start in range(min(600, len(head) - 16)):
        if head[start + 8] not in (0xFE, 0xFD):
            continue
        pos, run = start, 0
        while pos + 12 < len(head) and head[pos + 8] in (0xFE, 0xFD):
            pos += 8 + frame_length(head, pos + 8)
            run += int(pos <= len(head))
        best = max(best, run)
        if best >= 10:
            break
    return best


def frame_length(data: bytes, pos: int) -> int:
    """Return the length of the MAVLink packet at ``pos`` by its header (version 1 or 2, signed or
    not).
    """
    if data[pos] == 0xFE:
        return 8 + data[pos + 1]
    return 12 + data[pos + 1] + (13 if data[pos + 2] & 1 else 0)


def frame_time(data: bytes, pos: int) -> float:
    """Return the big-endian time of 8 bytes before a packet, s since 1970."""
    return float(struct.unpack_from(">Q", data, pos)[0]) * 1e-6


def _text(head: bytes) -> str | None:
    """Return the dialect of a text log or table; None for other text."""
    content = decoded(head)
    if content is None:
        return None
    lines = [line for line in content[0].splitlines() if line.strip()]
    if any(line.startswith(("FMT,", "FMT, ")) for line in lines[:20]):
        return "dataflash-text"
    table = sniff(head)
    header = next((line for line in lines if not line.startswith("#")), "")
    names = (
        [name.strip().strip('"') for name in header.split(",")] if table is None else table.names
    )
    signals = sum(name in SIGNALS or name in COMPONENTS for name in names)
    if len(names) > 1 and ("time_s" in names or signals >= 2):
        return "csv"
    if table is None or table.numeric < 2:
        return None
    # A table of numbers with unknown names can be used with a user's map.
    return csv_dialect_of(table.names)
