"""ArduPilot DataFlash as text (.log): one line a record, values already in the field's unit. Streamed line by line."""

from __future__ import annotations

import os
from array import array
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np

from sysid.errors import Finding, LogError
from sysid.foreign.raw import Progress, RawLog, Wanted
from sysid.foreign.regular_files import open_regular
from sysid.logs.importers.dataflash_format import CHARACTERS, Format
from sysid.logs.importers.dataflash_tables import ALWAYS, Columns, assemble

_MAX_LINE = 4096
_MOST_FORMATS = 1000  # the binary form can number 256
_WHOLE = frozenset("bBhHiIqQM")


class _Collector:
    def __init__(self, fmt: Format, keep: list[str]) -> None:
        self.where = [fmt.columns.index(c) for c in keep]
        self.text = [CHARACTERS[fmt.characters[i]][0].startswith("S") for i in self.where]
        self.whole = [fmt.characters[i] in _WHOLE for i in self.where]
        self.keep = keep
        self.values: list[Any] = [[] if text else array("d") for text in self.text]
        self.place = array("q")

    def add(self, cells: list[str], place: int) -> bool:
        """Append one record; False, and nothing appended, when a number cannot be read."""
        row: list[Any] = []
        try:
            for i, text, whole in zip(self.where, self.text, self.whole, strict=True):
                value = cells[i].strip() if text else float(cells[i])
                if whole and not float(value).is_integer():  # nan and inf are none either
                    return False
                row.append(value)
        except (ValueError, IndexError):
            return False
        for store, value in zip(self.values, row, strict=True):
            store.append(value)
        self.place.append(place)
        return True

    def columns(self) -> Columns:
        pairs = zip(self.keep, self.values, self.text, strict=True)
        return {
            c: np.array(v, dtype=object) if text else np.frombuffer(v, dtype=np.float64)
            for c, v, text in pairs
        }


def read(path: Path, wanted: Wanted | None = None, progress: Progress | None = None) -> RawLog:
    """Read a text DataFlash log; arguments and errors as in `dataflash_binary.read`."""
    formats: dict[str, Format] = {}
    collectors: dict[str, _Collector | None] = {}
    counts: dict[str, int] = defaultdict(int)
    headers: list[int] = []
    bad_lines, first_bad, done, line_number = 0, 0, 0, 0
    with open_regular(path) as handle:
        size = max(1, os.fstat(handle.fileno()).st_size)
        while raw := handle.readline(_MAX_LINE):
            line_number += 1
            done += len(raw)
            if progress is not None and line_number % 20000 == 0:
                progress(done / size)
            line = raw.decode("latin-1").rstrip("\r\n")
            if not line.strip():
                continue
            name, _, rest = line.partition(",")
            name = name.strip()
            if name == "FMT":
                fmt = _format(rest)
                if fmt is not None and fmt.name == "FMT" and counts:
                    headers.append(line_number)
                if fmt is not None and fmt.name not in formats and len(formats) >= _MOST_FORMATS:
                    fmt = None
                if fmt is not None and formats.get(fmt.name) != fmt:
                    formats[fmt.name] = fmt
                    keep = _keep(fmt, wanted)
                    collectors[fmt.name] = _Collector(fmt, keep) if keep else None
                good = fmt is not None
            elif name in formats:
                collector = collectors[name]
                # The last column takes what is left: a text message may hold commas.
                cells = rest.split(",", len(formats[name].columns) - 1)
                good = collector is None or collector.add(cells, line_number)
            else:
                good = False
            if good:
                counts[name] += 1
            else:
                bad_lines += 1
                first_bad = first_bad or line_number
    if not any(n for name, n in counts.items() if name != "FMT"):
        raise LogError(
            f"no DataFlash record could be read in {line_number} lines; copy the log again", path
        )
    findings = []
    if bad_lines:
        message = (
            f"{bad_lines} of {line_number} lines could not be read (the first is line {first_bad})"
        )
        numbers = {"lines": float(bad_lines), "first_line": float(first_bad)}
        findings.append(Finding("damaged-lines", "", "warning", message, numbers))
    columns = {
        name: c.columns() for name, c in collectors.items() if c is not None and counts[name]
    }
    places = {
        name: np.frombuffer(c.place, dtype=np.int64)
        for name, c in collectors.items()
        if c is not None and counts[name]
    }
    return assemble(
        "dataflash-text", columns, formats, dict(counts), findings, path, places, tuple(headers)
    )


def _keep(fmt: Format, wanted: Wanted | None) -> list[str]:
    if wanted is None or fmt.name in ALWAYS:
        return [c for c, k in zip(fmt.columns, fmt.characters, strict=True) if k != "a"]
    if fmt.name not in wanted:
        return []
    fields = set(wanted[fmt.name]) | {fmt.instance_column, (fmt.time_column or ("",))[0]}
    return [c for c, k in zip(fmt.columns, fmt.characters, strict=True) if c in fields and k != "a"]


def _format(rest: str) -> Format | None:
    cells = [c.strip() for c in rest.split(",")]
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
