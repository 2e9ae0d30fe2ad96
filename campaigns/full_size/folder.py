"""The folder of shards: per condition one parquet file a shard, and shards.csv, which says what each is and how it was flown.

A shard counts once its line stands there, and its file is as the line says; so a kill at any moment costs the shard in the air.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import pandas as pd

from campaigns.full_size.plan import Plan, Shard, cell_name, identity
from campaigns.full_size.sketch import unpacked
from sysid.digests import sha256_hex
from uqharness.campaign.conditions import Condition
from uqharness.errors import BadInputError
from uqharness.files import try_lock, write_bytes
from uqharness.parquet_files import parse_table
from uqharness.text_tables import csv_rows, csv_text

SHARDS = "shards.csv"
_LOCK = "run.lock"
_TEXTS = ("cases", "results", "file", "engine", "version", "jsbsim_worst")


@dataclass(frozen=True)
class Line:
    """A shard in shards.csv.

    ``cases`` digests what defines its flights, ``results`` every status and metric bit for bit, ``file`` the parquet file;
    ``engine`` a short flight, which tells engines apart whose bits differ. ``hours`` are scored ones over all corners. ``core_s``
    were spent flying in the batch engine, ``jsbsim_core_s`` re-flying ``jsbsim_flights`` of them in JSBSim. ``jsbsim_difference``
    is the largest difference of a metric over its spread, that of ``jsbsim_worst``; ``jsbsim_excused`` counts flights that
    rounding parts.
    """

    shard: int
    first_air: int
    airs: int
    flights: int
    failed: int
    hours: float
    core_s: float
    jsbsim_flights: int
    jsbsim_core_s: float
    jsbsim_excused: int
    jsbsim_difference: float
    jsbsim_worst: str
    cases: str
    results: str
    file: str
    engine: str
    version: str


def lines(folder: Path, condition: Condition) -> dict[int, Line]:
    """What shards.csv says of a condition, by shard number; nothing where there is none. Raises BadInputError."""
    path = folder / cell_name(condition) / SHARDS
    if not path.exists():
        return {}
    names = [field.name for field in fields(Line)]
    rows = csv_rows(path.read_bytes(), path, [name for name in names if name not in _TEXTS], _TEXTS)
    kinds: dict[str, Any] = {"int": int, "float": float, "str": str}
    found = [
        Line(**{field.name: kinds[str(field.type)](row[field.name]) for field in fields(Line)})
        for row in rows
    ]
    return {line.shard: line for line in found}


def add(folder: Path, shard: Shard, line: Line, content: bytes) -> None:
    """Keep a shard: its file first, then its line."""
    (folder / shard.cell).mkdir(parents=True, exist_ok=True)
    write_bytes(folder / shard.file, content)
    kept = lines(folder, shard.condition) | {shard.number: line}
    rows = [
        {name: str(value) for name, value in asdict(kept[number]).items()}
        for number in sorted(kept)
    ]
    write_bytes(folder / shard.cell / SHARDS, csv_text(rows).encode())


def is_whole(folder: Path, shard: Shard, line: Line | None) -> bool:
    """Whether a shard's file is there and as its line says."""
    path = folder / shard.file
    return line is not None and path.is_file() and sha256_hex(path.read_bytes()) == line.file


def refuse_other_flights(line: Line, cases: tuple[Any, ...], shard: Shard) -> None:
    """BadInputError where a shard holds flights other than the plan's."""
    if line.cases != identity(cases):
        raise BadInputError(
            f"{shard.file}: flown with another aircraft, script or campaign file than these; go on where those are, or remove "
            "the folder of shards and fly it again"
        )


def cell_table(plan: Plan, folder: Path, condition: Condition) -> tuple[pd.DataFrame, list[Line]]:
    """All flights of a condition that are there, as a case table in case order, and the lines of its shards.

    Raises BadInputError for a shard that is damaged or of other flights, and where there is none.
    """
    known, frames, used = lines(folder, condition), [], []
    for shard in plan.only([cell_name(condition)]):
        line = known.get(shard.number)
        if line is None:
            continue
        path = folder / shard.file
        if not is_whole(folder, shard, line):
            raise BadInputError(
                f"{path}: missing, or not as {SHARDS} says; fly it again (the command fly does)"
            )
        cases = plan.cases(shard)
        refuse_other_flights(line, cases, shard)
        frames.append(
            unpacked(parse_table(path.read_bytes(), path, rows=len(cases)), cases, plan.resolution)
        )
        used.append(line)
    if not frames:
        raise BadInputError(
            f"{folder / cell_name(condition)}: nothing flown yet; run the command fly"
        )
    return pd.concat(frames, ignore_index=True), used


@contextlib.contextmanager
def locked(folder: Path) -> Iterator[None]:
    """One run at a time in a folder. Raises BadInputError."""
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / _LOCK).open("a+b") as handle:
        if not try_lock(handle.fileno()):
            raise BadInputError(f"{folder}: another run is flying into it; wait for it, or end it")
        yield
