"""The flights of a campaign of full size: a folder of shards while they are flown, one Parquet file
when the study is finished.

``shards/CELL/NNN.parquet`` holds a shard and ``shards/CELL/shards.csv`` its record. A shard counts
once its record stands there and its file has the digest of the record: an interruption costs the
shard in the air. ``pack`` puts all shards into ``flights.parquet`` beside the folder, a row group
per cell, their records in the file's metadata; a shard of the folder takes precedence over it.
"""

from __future__ import annotations

import contextlib
import io
import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass, fields
from functools import lru_cache
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from campaigns.library.grid import unpacked
from campaigns.library.plan import Plan, Shard, cell_name, identity
from campaigns.library.study import write_csv
from sysid.digests import sha256_hex
from uqharness.campaign.cases import Case
from uqharness.campaign.conditions import Condition
from uqharness.errors import BadInputError
from uqharness.files import try_lock, write_bytes
from uqharness.parquet_files import parse_table
from uqharness.text_tables import csv_rows

SHARDS, FLIGHTS = "shards.csv", "flights.parquet"
PLACE = ("turbulence", "wind_mps", "epistemic_id", "aleatory_id", "shard")
"""Columns of flights.parquet before those of a shard: which flight a row is."""
_LOCK, _METADATA = "run.lock", b"shards"
_TEXTS = ("cases", "results", "file", "engine", "version", "jsbsim_worst")


@dataclass(frozen=True)
class ShardRecord:
    """A shard in shards.csv.

    ``cases`` digests what defines its flights, ``results`` every status and metric bit for bit,
    ``file`` the parquet file; ``engine`` a short flight, which distinguishes engines whose bits
    differ. ``hours`` are scored ones over all corners. ``core_s`` were spent flying in the batch
    engine, ``jsbsim_core_s`` re-flying ``jsbsim_flights`` of them in JSBSim. ``jsbsim_difference``
    is the largest difference of a metric over its spread, that of ``jsbsim_worst``;
    ``jsbsim_excused`` counts flights that rounding parts.
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

    @classmethod
    def from_row(cls, row: dict[str, Any]) -> ShardRecord:
        """Read a row of texts or numbers."""
        kinds = {"int": int, "float": float, "str": str}
        return cls(**{f.name: kinds[str(f.type)](row[f.name]) for f in fields(cls)})


def records(folder: Path, condition: Condition) -> dict[int, ShardRecord]:
    """Read the records of a condition's shards, by number, in flights.parquet and in the folder.
    Raises BadInputError."""
    cell = cell_name(condition)
    return _packed_records(folder).get(cell, {}) | _folder_records(folder, cell)


def _folder_records(folder: Path, cell: str) -> dict[int, ShardRecord]:
    path = folder / cell / SHARDS
    if not path.exists():
        return {}
    numbers = [f.name for f in fields(ShardRecord) if f.name not in _TEXTS]
    rows = [ShardRecord.from_row(r) for r in csv_rows(path.read_bytes(), path, numbers, _TEXTS)]
    return {row.shard: row for row in rows}


def _packed_records(folder: Path) -> dict[str, dict[int, ShardRecord]]:
    path = folder.parent / FLIGHTS
    return _metadata(path, path.stat().st_mtime_ns) if path.exists() else {}


@lru_cache
def _metadata(path: Path, modified_ns: int) -> dict[str, dict[int, ShardRecord]]:
    try:
        cells = json.loads(pq.read_metadata(path).metadata[_METADATA])
        rows = {cell: [ShardRecord.from_row(row) for row in rows] for cell, rows in cells.items()}
    except (pa.ArrowException, OSError, KeyError, TypeError, ValueError) as error:
        raise BadInputError(f"{path}: not the flights of a study ({error}); restore it") from error
    return {cell: {row.shard: row for row in part} for cell, part in rows.items()}


def _packed_cell(folder: Path, cell: str) -> pa.Table:
    """Read a cell's row group, its pages compared with their checksums. Raises BadInputError."""
    path = folder.parent / FLIGHTS
    number = list(_packed_records(folder)).index(cell)
    try:
        with pq.ParquetFile(path, page_checksum_verification=True) as file:
            names = [name for name in file.schema_arrow.names if name not in PLACE]
            return file.read_row_group(number, columns=names, use_threads=False)
    except (pa.ArrowException, OSError) as error:
        raise BadInputError(f"{path}: damaged ({error}); restore it") from error


def shard_table(folder: Path, shard: Shard, packed: pa.Table | None = None) -> pa.Table:
    """Read a shard's table; ``packed``: its cell's row group, where that was read before. Raises
    BadInputError."""
    path = folder / shard.file
    record = _folder_records(folder, shard.cell).get(shard.number)
    if record is not None:
        if not path.is_file() or sha256_hex(path.read_bytes()) != record.file:
            raise BadInputError(
                f"{path}: missing, or not as {SHARDS} records it; fly it again (the command fly "
                "does)"
            )
        return parse_table(path.read_bytes(), path)
    table = _packed_cell(folder, shard.cell) if packed is None else packed
    index = _packed_records(folder)[shard.cell]
    start = sum(other.flights for other in index.values() if other.shard < shard.number)
    return table.slice(start, index[shard.number].flights)


def add(folder: Path, shard: Shard, record: ShardRecord, content: bytes) -> None:
    """Keep a shard: its file first, then its record."""
    (folder / shard.cell).mkdir(parents=True, exist_ok=True)
    write_bytes(folder / shard.file, content)
    by_number = _folder_records(folder, shard.cell) | {shard.number: record}
    rows = [asdict(by_number[number]) for number in sorted(by_number)]
    texts = [{name: str(value) for name, value in row.items()} for row in rows]
    write_csv(folder / shard.cell / SHARDS, texts)


def is_intact(folder: Path, shard: Shard) -> bool:
    """Return whether a shard was flown and can be read as it was."""
    if shard.number not in records(folder, shard.condition):
        return False
    if shard.number not in _folder_records(folder, shard.cell):
        return True
    try:
        shard_table(folder, shard)
    except BadInputError:
        return False
    return True


def refuse_other_flights(record: ShardRecord, cases: tuple[Case, ...], shard: Shard) -> None:
    """Raise BadInputError where a shard holds flights other than the plan's."""
    if record.cases != identity(cases):
        raise BadInputError(
            f"{shard.file}: flown with another aircraft, script or campaign file than these; go on "
            f"where those are, or remove the folder of shards and {FLIGHTS} and fly it again"
        )


def cell_table(
    plan: Plan, folder: Path, condition: Condition
) -> tuple[pd.DataFrame, list[ShardRecord]]:
    """Read all flights of a condition that were flown, as a case table in case order, and the
    records of their shards.

    Raises BadInputError for a shard that is damaged or of other flights, and where there is none.
    """
    cell, index = cell_name(condition), records(folder, condition)
    packed = _packed_cell(folder, cell) if cell in _packed_records(folder) else None
    frames, read = [], []
    for shard in (s for s in plan.only([cell]) if s.number in index):
        table, cases = shard_table(folder, shard, packed), plan.cases(shard)
        refuse_other_flights(index[shard.number], cases, shard)
        frames.append(unpacked(table, cases, plan.resolution))
        read.append(index[shard.number])
    if not frames:
        raise BadInputError(f"{folder / cell}: nothing flown yet; run the command fly")
    return pd.concat(frames, ignore_index=True), read


def pack(plan: Plan, folder: Path) -> Path:
    """Write flights.parquet of all flights so far, and return its path; the shards stay. Raises
    BadInputError."""
    path, index, groups = folder.parent / FLIGHTS, {}, []
    for condition in plan.conditions:
        cell, by_number = cell_name(condition), records(folder, condition)
        packed = _packed_cell(folder, cell) if cell in _packed_records(folder) else None
        tables = []
        for shard in (s for s in plan.only([cell]) if s.number in by_number):
            table, cases = shard_table(folder, shard, packed), plan.cases(shard)
            refuse_other_flights(by_number[shard.number], cases, shard)
            tables.append(_with_place(table, shard, cases))
        if tables:
            index[cell] = [asdict(by_number[number]) for number in sorted(by_number)]
            groups.append(pa.concat_tables(tables))
    if not groups:
        raise BadInputError(f"{folder}: nothing flown yet; run the command fly")
    buffer, schema = io.BytesIO(), groups[0].schema
    options = {"compression": "zstd", "compression_level": 19, "write_page_checksum": True}
    with pq.ParquetWriter(buffer, schema, store_schema=False, **options) as writer:
        for group in groups:
            writer.write_table(group, row_group_size=group.num_rows)
        writer.add_key_value_metadata(
            {_METADATA: json.dumps(index), "grid": f"resolution {plan.resolution:g}"}
        )
    write_bytes(path, buffer.getvalue())
    return path


def _with_place(table: pa.Table, shard: Shard, cases: tuple[Case, ...]) -> pa.Table:
    """Put the columns of PLACE before those of a shard."""
    rows = table.num_rows
    columns = (
        pa.array([shard.condition.turbulence] * rows),
        pa.array([shard.condition.wind_mps] * rows, pa.float32()),
        pa.array([case.epistemic_id for case in cases]),
        pa.array([case.aleatory_id for case in cases], pa.int32()),
        pa.array([shard.number] * rows, pa.int16()),
    )
    return pa.table([*columns, *table.columns], names=[*PLACE, *table.column_names])


@contextlib.contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold a folder for one run. Raises BadInputError where another holds it."""
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / _LOCK).open("a+b") as handle:
        if not try_lock(handle.fileno()):
            raise BadInputError(f"{folder}: another run is flying into it; wait for it, or end it")
        yield
