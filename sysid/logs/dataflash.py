"""Read ArduPilot DataFlash logs, binary (.bin) and text (.log).

`read` passes once through a binary log in blocks and decodes each message type with numpy; memory
is one block plus the selected fields in their stored width. Records are found by the lengths that
FMT records announce. Where this chain breaks, the reader searches for the next two records that
fit together and reports the bytes it skipped. `read_text` reads the text form line by line.
"""

from __future__ import annotations

import contextlib
import os
import re
from array import array
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from sysid.errors import Finding, LogError
from sysid.foreign.raw import FieldSelection, MessageTable, ProgressCallback, RawLog
from sysid.foreign.regular_files import open_regular

# Record format: FMT records as numpy types, for both readers and the writer.

MAGIC = b"\xa3\x95"
FMT_TYPE = 128
FMT_LENGTH = 89

# Format character to numpy type and multiplier from the stored integer to the field's unit.
CHARACTERS: dict[str, tuple[str, float]] = {
    "a": ("<i2", 1.0),
    "b": ("<i1", 1.0),
    "B": ("<u1", 1.0),
    "h": ("<i2", 1.0),
    "H": ("<u2", 1.0),
    "i": ("<i4", 1.0),
    "I": ("<u4", 1.0),
    "q": ("<i8", 1.0),
    "Q": ("<u8", 1.0),
    "f": ("<f4", 1.0),
    "d": ("<f8", 1.0),
    "g": ("<f2", 1.0),
    "M": ("<u1", 1.0),
    "c": ("<i2", 0.01),
    "C": ("<u2", 0.01),
    "e": ("<i4", 0.01),
    "E": ("<u4", 0.01),
    "L": ("<i4", 1e-7),
    "n": ("S4", 1.0),
    "N": ("S16", 1.0),
    "Z": ("S64", 1.0),
}
INSTANCE_NAMES = ("I", "C", "Instance", "Inst")


@dataclass(frozen=True)
class Format:
    """One FMT record: type number, length in bytes with header, name, format characters, column
    names.
    """

    type: int
    length: int
    name: str
    characters: str
    columns: tuple[str, ...]

    @property
    def dtype(self) -> np.dtype[Any]:
        """Structured type of the payload, without the three header bytes."""
        fields: list[Any] = []
        for column, character in zip(self.columns, self.characters, strict=True):
            base = CHARACTERS[character][0]
            fields.append((column, base, (32,)) if character == "a" else (column, base))
        return np.dtype(fields)

    @property
    def instance_column(self) -> str | None:
        """Column that numbers the instances of a sensor; None without one."""
        for column, character in zip(self.columns, self.characters, strict=True):
            if column in INSTANCE_NAMES and character in "bBhHiI":
                return column
        return None

    @property
    def time_column(self) -> tuple[str, float] | None:
        """Time column and seconds per unit; None without one.

        In the GPS message of logs before version 3.4, TimeMS is the GPS time of week and T the
        clock of the autopilot.
        """
        if self.name.startswith("GPS") and "TimeUS" not in self.columns and "T" in self.columns:
            return "T", 1e-3
        for name, scale in (("TimeUS", 1e-6), ("TimeMS", 1e-3)):
            if name in self.columns:
                return name, scale
        return None


def make_format(kind: int, length: int, name: str, characters: str, columns: str) -> Format | None:
    """Return a Format; None if the record contradicts itself, since damage must not misguide the
    reader.
    """
    names = tuple(columns.split(",")) if columns else ()
    printable = name.isascii() and name.isidentifier() and len(name) <= 4
    if (
        not printable
        or len(names) != len(characters)
        or len(set(names)) != len(names)
        or not all(names)
    ):
        return None
    if any(c not in CHARACTERS for c in characters):
        return None
    message_format = Format(kind, length, name, characters, names)
    return message_format if message_format.dtype.itemsize + 3 == length else None


def scaled(values: NDArray[Any], character: str) -> NDArray[Any]:
    """Return values in the field's unit: multiplied if the format says so, text decoded."""
    kind, multiplier = CHARACTERS[character]
    if kind.startswith("S"):
        return np.array(
            [v.split(b"\0", 1)[0].decode("latin-1") for v in values.tolist()], dtype=object
        )
    return values.astype(np.float64) * multiplier if multiplier != 1.0 else values


def text(raw: bytes) -> str:
    """Return the text of a field of fixed length up to its first NUL."""
    return raw.split(b"\0", 1)[0].decode("latin-1")


# Assembly of a RawLog from the columns of a binary or text log.

Columns = dict[str, NDArray[Any]]
# ALWAYS are messages that identify vehicle, parameters and modes; they are small in every log.
MAX_INSTANCES = 256  # of one kind of message
ALWAYS = frozenset({"PARM", "MSG", "MODE", "VER", "ARM", "EV", "ORGN"})
# VER.BU, the number of the firmware's build type.
_BUILD = {
    1: "ArduRover",
    2: "ArduCopter",
    3: "ArduPlane",
    4: "AntennaTracker",
    7: "ArduSub",
    12: "Blimp",
    13: "Heli",
}
_VEHICLE_PARAMETERS = {
    "ATC_RAT_RLL_P": "ArduCopter",
    "RATE_RLL_P": "ArduCopter",
    "WPNAV_SPEED": "ArduCopter",
    "ATC_STR_RAT_P": "ArduRover",
    "RLL2SRV_TCONST": "ArduPlane",
    "ARSPD_FBW_MIN": "ArduPlane",
}
_VEHICLE = re.compile(
    r"^(Ardu|APM[: ]?)(Plane|Copter|Rover|Sub)|^(AntennaTracker|Blimp|Rover)", re.IGNORECASE
)


def assemble(
    dialect: str,
    columns: dict[str, Columns],
    formats: Mapping[str, Format],
    counts: Mapping[str, int],
    findings: list[Finding],
    path: Path,
    *,
    places: Mapping[str, NDArray[np.int64]] | None = None,
    headers: tuple[int, ...] = (),
) -> RawLog:
    """Build the RawLog: separate instances and extract parameters, texts and vehicle.

    Parameters
    ----------
    dialect : str
        dataflash or dataflash-text.
    columns : dict
        Message to field to values; emptied on the way to save memory.
    formats, counts : mapping
        Format and number of records of each message.
    findings : list of Finding
        Damage found by the reader.
    path : Path
        File, for messages.
    places : mapping, optional
        Message to the position of each record in the file.
    headers : tuple of int
        Positions of further log headers.

    Raises
    ------
    LogError
        If no message has a time stamp.
    """
    places = places or {}
    messages: dict[tuple[str, int], MessageTable] = {}
    for name in list(columns):
        fmt = formats[name]
        stamp = fmt.time_column
        if stamp is None or stamp[0] not in columns[name]:
            continue
        table = columns[name]
        # Instances (two IMUs, three compasses) become separate messages.
        time_s = table[stamp[0]] / np.float64(round(1.0 / stamp[1]))
        for instance, rows in _instances(table, fmt.instance_column):
            fields = {
                c: v[rows] for c, v in table.items() if c not in (stamp[0], fmt.instance_column)
            }
            place = places.get(name)
            order = place[rows] if place is not None and len(place) == len(time_s) else None
            messages[(name, instance)] = MessageTable(time_s[rows], fields, order)
        if name not in ALWAYS:
            del columns[name]  # the messages hold what is needed; a big log must not be there twice
    if not messages:
        raise LogError(
            "no message carries a time stamp (TimeUS or TimeMS); nothing can be placed in time",
            path,
        )
    # Parameters and texts keep the place in the file at which they were set.
    texts, parameters = _texts(messages), _parameters(columns)
    text_table = messages.get(("MSG", 0))
    set_at = places.get("PARM")
    return RawLog(
        headers=headers,
        text_places=()
        if text_table is None or text_table.place is None
        else tuple(text_table.place.tolist()),
        parameter_log=(
            ()
            if set_at is None or not parameters
            else tuple(
                (int(at), str(n), float(v))
                for at, n, v in zip(
                    set_at, columns["PARM"]["Name"], columns["PARM"]["Value"], strict=False
                )
            )
        ),
        dialect=dialect,
        messages=messages,
        counts=dict(counts),
        parameters=parameters,
        texts=texts,
        vehicle=_vehicle(texts, columns, parameters),
        findings=tuple(findings),
    )


def _instances(table: Columns, column: str | None) -> list[tuple[int, Any]]:
    """Return (instance, rows); one instance if the column has more values than any vehicle has
    sensors.
    """
    if column is None or column not in table:
        return [(0, slice(None))]
    numbers = table[column]
    if len(numbers) and numbers.min() == numbers.max():
        return [(int(numbers[0]), slice(None))]
    unique_numbers = np.unique(numbers)
    return (
        [(int(i), numbers == i) for i in unique_numbers]
        if len(unique_numbers) <= MAX_INSTANCES
        else [(0, slice(None))]
    )


def _texts(messages: Mapping[tuple[str, int], MessageTable]) -> tuple[tuple[float, str], ...]:
    """Return (time, text) of the messages to the pilot."""
    table = messages.get(("MSG", 0))
    if table is None or "Message" not in table.fields:
        return ()
    return tuple(
        (float(t), str(m)) for t, m in zip(table.time_s, table.fields["Message"], strict=True)
    )


def _parameters(columns: dict[str, Columns]) -> dict[str, float]:
    """Return the parameters, last value logged."""
    table = columns.get("PARM", {})
    if "Name" not in table or "Value" not in table:
        return {}
    return {str(n): float(v) for n, v in zip(table["Name"], table["Value"], strict=True)}


def _vehicle(
    texts: tuple[tuple[float, str], ...],
    columns: dict[str, Columns],
    parameters: Mapping[str, float],
) -> str:
    """Return the vehicle as the log names it, else by its parameters; "VTOL" is added for
    Q_ENABLE.
    """
    vehicle = _firmware_name(texts, columns)
    if not vehicle:
        # Parameters that one kind of vehicle alone has.
        vehicle = next(
            (kind for name, kind in _VEHICLE_PARAMETERS.items() if name in parameters), ""
        )
    return (
        f"{vehicle or 'ArduPlane'} VTOL"
        if parameters.get("Q_ENABLE", 0.0) > 0.0 and "VTOL" not in vehicle
        else vehicle
    )


def _firmware_name(texts: tuple[tuple[float, str], ...], columns: dict[str, Columns]) -> str:
    """Return the firmware's name by a message to the pilot or the build type."""
    build = columns.get("VER", {}).get("BU")
    for _, message in texts:
        if _VEHICLE.match(message):
            return message
    if build is not None and len(build):
        return _BUILD.get(int(build[0]), "")
    return ""


BLOCK_BYTES = 8 << 20
_FMT_FORMAT = Format(
    FMT_TYPE, FMT_LENGTH, "FMT", "BBnNZ", ("Type", "Length", "Name", "Format", "Columns")
)


class _BinaryReader:
    """State between blocks: known formats, collected columns, damage."""

    def __init__(self, selection: FieldSelection | None) -> None:
        self.wanted = selection
        self.formats: dict[int, Format] = {FMT_TYPE: _FMT_FORMAT}
        self.lengths = [0] * 256
        self.lengths[FMT_TYPE] = FMT_LENGTH
        # One growing buffer per field: thousands of small arrays would fragment the memory.
        self.collected: dict[str, dict[str, bytearray]] = defaultdict(
            lambda: defaultdict(bytearray)
        )
        # File offset of each record that was kept, by message.
        self.places: dict[str, bytearray] = defaultdict(bytearray)
        self.headers: list[int] = []
        self.base = 0
        # The format that a message's columns were collected by.
        self.collected_formats: dict[str, Format] = {}
        self.counts: dict[str, int] = defaultdict(int)
        self.skipped_bytes = 0
        self.skips = 0
        self.first_skip = -1
        self.bad_formats = 0

    def block(self, data: bytes, base: int, last: bool) -> int:
        """Decode the complete records of ``data``, which begins at file offset ``base``.

        Returns the number of bytes used; the rest belongs to the next block.
        """
        self.base = base
        offsets: list[list[int]] = [[] for _ in range(256)]
        lengths = self.lengths
        size = len(data)
        pos = 0
        while pos + 3 <= size:
            length = lengths[data[pos + 2]]
            if data[pos] == 0xA3 and data[pos + 1] == 0x95 and length:
                end = pos + length
                if end > size:
                    break
                kind = data[pos + 2]
                if kind == FMT_TYPE:
                    # The header of a log begins with the format of FMT itself.
                    if data[pos + 3] == FMT_TYPE and base + pos > 0:
                        self.headers.append(base + pos)
                    self._learn(data[pos:end], offsets, data)
                offsets[kind].append(pos)
                pos = end
                continue
            pos = self._resynchronise(data, pos, base)
        if last and pos < size:
            self._note_skip(base + pos, size - pos)
            pos = size
        self._decode(data, offsets)
        return pos

    def _learn(self, record: bytes, offsets: list[list[int]], data: bytes) -> None:
        """Register the format of an FMT record."""
        kind, length = record[3], record[4]
        new_format = make_format(
            kind, length, text(record[5:9]), text(record[9:25]), text(record[25:89])
        )
        if new_format is None or kind == FMT_TYPE:
            self.bad_formats += int(new_format is None)
            return
        old_format = self.formats.get(kind)
        if old_format is not None and old_format != new_format:
            # Two logs in one file: decode the records collected so far with the old format.
            self._decode_type(data, offsets[kind], old_format)
            offsets[kind].clear()
        self.formats[kind] = new_format
        self.lengths[kind] = length

    def _resynchronise(self, data: bytes, pos: int, base: int) -> int:
        """Return the next position where a known record is followed by a header, or by the end of
        the block.
        """
        start = pos
        pos = data.find(MAGIC, pos + 1)
        while pos >= 0 and pos + 3 <= len(data):
            length = self.lengths[data[pos + 2]]
            after = pos + length
            if length and (after + 2 > len(data) or data[after : after + 2] == MAGIC):
                break
            pos = data.find(MAGIC, pos + 1)
        if pos < 0:
            # The last byte may be the first half of a header that the next block completes.
            pos = max(start + 1, len(data) - 2)
        self._note_skip(base + start, pos - start)
        return pos

    def _note_skip(self, offset: int, count: int) -> None:
        """Count bytes that could not be read."""
        if self.first_skip < 0:
            self.first_skip = offset
        self.skips += 1
        self.skipped_bytes += count

    def _decode(self, data: bytes, offsets: list[list[int]]) -> None:
        """Decode all records of a block."""
        for kind, kind_offsets in enumerate(offsets):
            if kind_offsets:
                self._decode_type(data, kind_offsets, self.formats[kind])

    def _decode_type(self, data: bytes, offsets: list[int], fmt: Format) -> None:
        """Append the selected fields of the records of one type."""
        self.counts[fmt.name] += len(offsets)
        keep = self._fields(fmt)
        if not keep or not offsets:
            return
        columns = self.collected[fmt.name]
        old_format = self.collected_formats.setdefault(fmt.name, fmt)
        if (old_format.characters, old_format.columns) != (fmt.characters, fmt.columns):
            # The format changed: columns of different lengths must not be mixed.
            columns.clear()
            self.places[fmt.name].clear()
        self.collected_formats[fmt.name] = fmt
        buffer = np.frombuffer(data, dtype=np.uint8)
        starts = np.asarray(offsets, dtype=np.int64) + 3
        self.places[fmt.name] += (starts + self.base).astype("<i8").tobytes()
        # Gather the bytes of one field of all records by fancy indexing.
        for column in keep:
            base, offset = fmt.dtype.fields[column][:2]  # type: ignore[index]
            columns[column] += buffer[
                starts[:, None] + (offset + np.arange(base.itemsize))
            ].tobytes()

    def _fields(self, fmt: Format) -> list[str]:
        """Return the columns of a message to keep: those selected, its time and its instance."""
        if fmt.name in ALWAYS or self.wanted is None:
            return list(fmt.columns)
        if fmt.name not in self.wanted:
            return []
        fields = set(self.wanted[fmt.name]) | {fmt.instance_column, (fmt.time_column or ("",))[0]}
        return [c for c in fmt.columns if c in fields]

    def tables(self) -> dict[str, Columns]:
        """Return message to field to values in the field's unit."""
        out: dict[str, Columns] = {}
        for name, columns in self.collected.items():
            characters = dict(
                zip(
                    self.collected_formats[name].columns,
                    self.collected_formats[name].characters,
                    strict=True,
                )
            )
            out[name] = {
                c: scaled(_array(data, characters[c]), characters[c]) for c, data in columns.items()
            }
        return out

    def findings(self, size: int) -> list[Finding]:
        """Return findings on damage, with the place of the first."""
        # Bytes that belong to no record, then definitions that contradict themselves.
        out = []
        if self.skipped_bytes:
            out.append(
                Finding(
                    "damaged-bytes",
                    "",
                    "warning",
                    f"{self.skipped_bytes} of {size} bytes could not be read ({self.skips} places,"
                    f" the first at offset {self.first_skip}): the log is damaged, cut short, or"
                    " was not closed",
                    {
                        "bytes": self.skipped_bytes,
                        "places": self.skips,
                        "first_offset": self.first_skip,
                    },
                )
            )
        if self.bad_formats:
            out.append(
                Finding(
                    "damaged-format",
                    "FMT",
                    "warning",
                    f"{self.bad_formats} FMT records contradict themselves; their messages were"
                    " left out",
                    {"count": self.bad_formats},
                )
            )
        return out


def _array(data: bytearray, character: str) -> NDArray[Any]:
    """Return the values of a collected field; arrays have 32 elements a record."""
    values = np.frombuffer(data, dtype=CHARACTERS[character][0])
    return values.reshape(-1, 32) if character == "a" else values


def read(
    path: Path, selection: FieldSelection | None = None, callback: ProgressCallback | None = None
) -> RawLog:
    """Read a binary DataFlash log.

    Parameters
    ----------
    path : Path
        File.
    selection : mapping or None
        Message to fields; None keeps all. Messages that the checks need are always kept.
    callback : callable, optional
        Called with the share read, 0 to 1.

    Raises
    ------
    LogError
        If no record can be read.
    """
    reader = _BinaryReader(selection)
    with open_regular(path) as handle:
        size = os.fstat(handle.fileno()).st_size
        _blocks(handle, reader, size, callback)
    if sum(reader.counts.values()) - reader.counts["FMT"] <= 0:
        raise LogError(
            f"no DataFlash record could be read in {size} bytes ({reader.counts['FMT']} FMT records"
            " found); the log is empty, cut off in its header, or damaged: copy it from the"
            " autopilot again",
            path,
        )
    return assemble(
        "dataflash",
        reader.tables(),
        reader.collected_formats,
        reader.counts,
        reader.findings(size),
        path,
        places={name: np.frombuffer(data, dtype="<i8") for name, data in reader.places.items()},
        headers=tuple(reader.headers),
    )


def _blocks(
    handle: BinaryIO, reader: _BinaryReader, size: int, callback: ProgressCallback | None
) -> None:
    """Read the file block by block."""
    unread, base = b"", 0
    while True:
        fresh = handle.read(BLOCK_BYTES)
        data = unread + fresh
        if not data:
            return
        used = reader.block(data, base, last=not fresh)
        unread, base = data[used:], base + used
        if callback is not None:
            with contextlib.suppress(ZeroDivisionError):
                callback(min(1.0, base / size))
        if not fresh:
            return


# Text logs: one record a line, values in the field's unit, read line by line.

_MAX_LINE = 4096
_MAX_FORMATS = 1000  # the binary form can number 256
_INTEGER_CHARACTERS = frozenset("bBhHiIqQM")


class _Collector:
    """Columns of one message of a text log."""

    def __init__(self, fmt: Format, keep: list[str]) -> None:
        self.where = [fmt.columns.index(c) for c in keep]
        self.text = [CHARACTERS[fmt.characters[i]][0].startswith("S") for i in self.where]
        self.whole = [fmt.characters[i] in _INTEGER_CHARACTERS for i in self.where]
        self.keep = keep
        self.values: list[Any] = [[] if text else array("d") for text in self.text]
        self.place = array("q")

    def add(self, cells: list[str], place: int) -> bool:
        """Append one record; return False, and append nothing, if a number cannot be read."""
        row: list[Any] = []
        try:
            for i, text, is_integer in zip(self.where, self.text, self.whole, strict=True):
                value = cells[i].strip() if text else float(cells[i])
                if is_integer and not float(value).is_integer():  # nan and inf are none either
                    return False
                row.append(value)
        except (ValueError, IndexError):
            return False
        for store, value in zip(self.values, row, strict=True):
            store.append(value)
        self.place.append(place)
        return True

    def columns(self) -> Columns:
        """Return field to values."""
        pairs = zip(self.keep, self.values, self.text, strict=True)
        return {
            c: np.array(v, dtype=object) if text else np.frombuffer(v, dtype=np.float64)
            for c, v, text in pairs
        }


def read_text(
    path: Path, selection: FieldSelection | None = None, callback: ProgressCallback | None = None
) -> RawLog:
    """Read a text DataFlash log; parameters and errors as for `read`."""
    formats: dict[str, Format] = {}
    collectors: dict[str, _Collector | None] = {}
    counts: dict[str, int] = defaultdict(int)
    headers: list[int] = []
    bad_lines, first_bad_line, done, line_number = 0, 0, 0, 0
    with open_regular(path) as handle:
        size = max(1, os.fstat(handle.fileno()).st_size)
        while raw := handle.readline(_MAX_LINE):
            line_number += 1
            done += len(raw)
            if callback is not None and line_number % 20000 == 0:
                callback(done / size)
            line = raw.decode("latin-1").rstrip("\r\n")
            if not line.strip():
                continue
            # Every line begins with the name of its message.
            name, _, content = line.partition(",")
            name = name.strip()
            # A format line describes the lines that follow; a second header begins another log.
            if name == "FMT":
                fmt = _format(content)
                if fmt is not None and fmt.name == "FMT" and counts:
                    headers.append(line_number)
                if fmt is not None and fmt.name not in formats and len(formats) >= _MAX_FORMATS:
                    fmt = None
                if fmt is not None and formats.get(fmt.name) != fmt:
                    formats[fmt.name] = fmt
                    keep = _keep(fmt, selection)
                    collectors[fmt.name] = _Collector(fmt, keep) if keep else None
                is_valid = fmt is not None
            elif name in formats:
                collector = collectors[name]
                # The last column takes the remainder: a message to the pilot may contain commas.
                cells = content.split(",", len(formats[name].columns) - 1)
                is_valid = collector is None or collector.add(cells, line_number)
            else:
                is_valid = False
            if is_valid:
                counts[name] += 1
            else:
                bad_lines += 1
                first_bad_line = first_bad_line or line_number
    # Damaged lines are counted; a file without any sound record is refused.
    if not any(n for name, n in counts.items() if name != "FMT"):
        raise LogError(
            f"no DataFlash record could be read in {line_number} lines; copy the log again", path
        )
    findings = []
    if bad_lines:
        message = (
            f"{bad_lines} of {line_number} lines could not be read (the first is line"
            f" {first_bad_line})"
        )
        numbers = {"lines": float(bad_lines), "first_line": float(first_bad_line)}
        findings.append(Finding("damaged-lines", "", "warning", message, numbers))
    # Columns of the messages that were read, and the line of each row.
    columns = {
        name: c.columns() for name, c in collectors.items() if c is not None and counts[name]
    }
    places = {
        name: np.frombuffer(c.place, dtype=np.int64)
        for name, c in collectors.items()
        if c is not None and counts[name]
    }
    return assemble(
        "dataflash-text",
        columns,
        formats,
        dict(counts),
        findings,
        path,
        places=places,
        headers=tuple(headers),
    )


def _keep(fmt: Format, selection: FieldSelection | None) -> list[str]:
    """Return the columns of a message to keep."""
    if selection is None or fmt.name in ALWAYS:
        return [c for c, k in zip(fmt.columns, fmt.characters, strict=True) if k != "a"]
    if fmt.name not in selection:
        return []
    fields = set(selection[fmt.name]) | {fmt.instance_column, (fmt.time_column or ("",))[0]}
    return [c for c, k in zip(fmt.columns, fmt.characters, strict=True) if c in fields and k != "a"]


def _format(content: str) -> Format | None:
    """Return the format of an FMT line; None if it contradicts itself."""
    cells = [c.strip() for c in content.split(",")]
    if len(cells) < 4 or not cells[0].isdigit() or not cells[1].isdigit():
        return None
    columns = tuple(c for c in cells[4:] if c)
    if (
        len(columns) != len(cells[3])
        or any(c not in CHARACTERS for c in cells[3])
        or len(set(columns)) != len(columns)
    ):
        return None
    return Format(int(cells[0]), int(cells[1]), cells[2], cells[3], columns)
