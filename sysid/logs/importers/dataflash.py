"""ArduPilot DataFlash .bin: one pass in blocks, each message type decoded as a whole by numpy.

Memory: one block, plus the wanted fields in their stored width. A record is found by following the lengths that the FMT
records announce; where the chain breaks the reader looks for the next pair of records that fit together and reports
the bytes it skipped.
"""

from __future__ import annotations

import contextlib
import os
from collections import defaultdict
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from sysid.errors import Finding, LogError
from sysid.foreign.raw import Progress, RawLog, Wanted
from sysid.foreign.regular_files import open_regular
from sysid.logs.importers.dataflash_format import (
    CHARACTERS,
    FMT_LENGTH,
    FMT_TYPE,
    MAGIC,
    Format,
    make_format,
    scaled,
    text,
)
from sysid.logs.importers.dataflash_tables import ALWAYS, Columns, assemble

BLOCK_BYTES = 8 << 20
_FMT_FORMAT = Format(
    FMT_TYPE, FMT_LENGTH, "FMT", "BBnNZ", ("Type", "Length", "Name", "Format", "Columns")
)


class _Walker:
    """State that lives from block to block: known formats, collected columns, damage met."""

    def __init__(self, wanted: Wanted | None) -> None:
        self.wanted = wanted
        self.formats: dict[int, Format] = {FMT_TYPE: _FMT_FORMAT}
        self.lengths = [0] * 256
        self.lengths[FMT_TYPE] = FMT_LENGTH
        # One growing buffer per field: thousands of small arrays would leave the memory in pieces.
        self.collected: dict[str, dict[str, bytearray]] = defaultdict(
            lambda: defaultdict(bytearray)
        )
        # File offset of each record that was kept, by message.
        self.places: dict[str, bytearray] = defaultdict(bytearray)
        self.headers: list[int] = []
        self.base = 0
        # The format that a message's columns were collected by.
        self.kept: dict[str, Format] = {}
        self.counts: dict[str, int] = defaultdict(int)
        self.skipped_bytes = 0
        self.skips = 0
        self.first_skip = -1
        self.bad_formats = 0

    def block(self, data: bytes, base: int, last: bool) -> int:
        """Decode the whole records of `data` (file offset `base`); return the number of bytes used."""
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
        kind, length = record[3], record[4]
        made = make_format(kind, length, text(record[5:9]), text(record[9:25]), text(record[25:89]))
        if made is None or kind == FMT_TYPE:
            self.bad_formats += int(made is None)
            return
        known = self.formats.get(kind)
        if known is not None and known != made:
            # Two logs in one file: what was collected under the old format must be decoded with it.
            self._decode_type(data, offsets[kind], known)
            offsets[kind].clear()
        self.formats[kind] = made
        self.lengths[kind] = length

    def _resynchronise(self, data: bytes, pos: int, base: int) -> int:
        """Next position at which a known record is followed by another header (or the block ends)."""
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
        if self.first_skip < 0:
            self.first_skip = offset
        self.skips += 1
        self.skipped_bytes += count

    def _decode(self, data: bytes, offsets: list[list[int]]) -> None:
        for kind, found in enumerate(offsets):
            if found:
                self._decode_type(data, found, self.formats[kind])

    def _decode_type(self, data: bytes, found: list[int], fmt: Format) -> None:
        self.counts[fmt.name] += len(found)
        keep = self._fields(fmt)
        if not keep or not found:
            return
        columns = self.collected[fmt.name]
        known = self.kept.setdefault(fmt.name, fmt)
        if (known.characters, known.columns) != (fmt.characters, fmt.columns):
            columns.clear()  # the format changed: an array of one field must not fall out of step with the others
            self.places[fmt.name].clear()
        self.kept[fmt.name] = fmt
        buffer = np.frombuffer(data, dtype=np.uint8)
        starts = np.asarray(found, dtype=np.int64) + 3
        self.places[fmt.name] += (starts + self.base).astype("<i8").tobytes()
        for column in keep:
            base, offset = fmt.dtype.fields[column][:2]  # type: ignore[index]
            columns[column] += buffer[
                starts[:, None] + (offset + np.arange(base.itemsize))
            ].tobytes()

    def _fields(self, fmt: Format) -> list[str]:
        if fmt.name in ALWAYS or self.wanted is None:
            return list(fmt.columns)
        if fmt.name not in self.wanted:
            return []
        fields = set(self.wanted[fmt.name]) | {fmt.instance_column, (fmt.time_column or ("",))[0]}
        return [c for c in fmt.columns if c in fields]

    def tables(self) -> dict[str, Columns]:
        """Message name -> field -> scaled array."""
        out: dict[str, Columns] = {}
        for name, columns in self.collected.items():
            characters = dict(zip(self.kept[name].columns, self.kept[name].characters, strict=True))
            out[name] = {
                c: scaled(_array(data, characters[c]), characters[c]) for c, data in columns.items()
            }
        return out

    def findings(self, size: int) -> list[Finding]:
        """What was damaged, with the place of the first damage."""
        out = []
        if self.skipped_bytes:
            out.append(
                Finding(
                    "damaged-bytes",
                    "",
                    "warning",
                    f"{self.skipped_bytes} of {size} bytes could not be read ({self.skips} places, the first at offset"
                    f" {self.first_skip}): the log is damaged, cut short, or was not closed",
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
                    f"{self.bad_formats} FMT records contradict themselves; their messages were left out",
                    {"count": self.bad_formats},
                )
            )
        return out


def _array(data: bytearray, character: str) -> NDArray[Any]:
    values = np.frombuffer(data, dtype=CHARACTERS[character][0])
    return values.reshape(-1, 32) if character == "a" else values


def read(path: Path, wanted: Wanted | None = None, progress: Progress | None = None) -> RawLog:
    """Read a binary DataFlash log.

    wanted  message -> fields to keep (None keeps everything); messages that the checks need are kept always.
    Raises LogError when no record can be read.
    """
    walker = _Walker(wanted)
    with open_regular(path) as handle:
        size = os.fstat(handle.fileno()).st_size
        _blocks(handle, walker, size, progress)
    if sum(walker.counts.values()) - walker.counts["FMT"] <= 0:
        raise LogError(
            f"no DataFlash record could be read in {size} bytes ({walker.counts['FMT']} FMT records found); "
            "the log is empty, cut off in its header, or damaged: copy it from the autopilot again",
            path,
        )
    return assemble(
        "dataflash",
        walker.tables(),
        walker.kept,
        walker.counts,
        walker.findings(size),
        path,
        {name: np.frombuffer(data, dtype="<i8") for name, data in walker.places.items()},
        tuple(walker.headers),
    )


def _blocks(handle: BinaryIO, walker: _Walker, size: int, progress: Progress | None) -> None:
    rest, base = b"", 0
    while True:
        fresh = handle.read(BLOCK_BYTES)
        data = rest + fresh
        if not data:
            return
        used = walker.block(data, base, last=not fresh)
        rest, base = data[used:], base + used
        if progress is not None:
            with contextlib.suppress(ZeroDivisionError):
                progress(min(1.0, base / size))
        if not fresh:
            return
