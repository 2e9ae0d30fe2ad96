"""Damage to what binary containers hold: Parquet columns, SQLite rows, arrays of .npz."""

from __future__ import annotations

import io
import json
import sqlite3
import zipfile
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from tests.fuzz import hostile
from tests.fuzz.damage_bytes import damaged
from tests.fuzz.damage_tree import damaged_tree, value
from tests.fuzz.hostile import pick

_PARQUET = "lost lost doubled renamed names type type type fill fill nulls rows metadata"


def parquet_damage(data: bytes, rng: np.random.Generator) -> bytes:
    """A Parquet file with injured columns, rows or metadata; one in three is injured as bytes
    instead.
    """
    bomb = pq.read_metadata(io.BytesIO(data)).num_rows > 1_000_000
    if bomb and rng.random() < 0.5:
        return data
    if bomb or rng.random() < 0.35:
        return damaged(data, rng)
    table, out = pq.read_table(io.BytesIO(data)), io.BytesIO()
    compression = str(rng.choice(["zstd", "snappy", "gzip", "none", "brotli"]))
    size = int(rng.choice([3, 100, 10**6]))
    try:
        for _ in range(int(rng.integers(1, 4))):
            table = _injured(table, rng) if table.num_columns else table
        pq.write_table(table, out, compression=compression, row_group_size=size)
    except (pa.ArrowException, ValueError, TypeError):  # what Parquet cannot hold is no input
        return damaged(data, rng)
    return out.getvalue()


def _injured(table: pa.Table, rng: np.random.Generator) -> pa.Table:
    j, k = (int(rng.integers(0, table.num_columns)) for _ in "jk")
    names, column = list(table.column_names), table.column(k)
    match pick(_PARQUET.split(), rng):
        case "lost":
            return table.remove_column(k)
        case "doubled":
            return table.append_column(names[k], column)
        case "renamed":
            names[k] = hostile.string(rng)
            return table.rename_columns(names)
        case "names":
            names[j], names[k] = names[k], names[j]
            return table.rename_columns(names)
        case "type":
            return table.set_column(k, names[k], _of_another_type(column, rng))
        case "fill":
            return table.set_column(k, names[k], _filled(column, rng))
        case "nulls":
            some = pa.array(rng.random(len(column)) < 3.0 / max(len(column), 3))
            empty = pc.if_else(some, pa.scalar(None, column.type), column)
            return table.set_column(k, names[k], empty)
        case "rows":
            return _other_rows(table, rng)
    return _other_metadata(table, rng)


def _of_another_type(column: pa.ChunkedArray, rng: np.random.Generator) -> pa.Array:
    """Nested ones among them."""
    n = len(column)
    kinds: list[Any] = [
        lambda: pa.array([str(v) for v in column.to_pylist()]),
        lambda: pa.array([rng.bytes(5) for _ in range(n)], pa.binary()),
        lambda: pa.array([b"\xff\xfe\xfd%d" % j for j in range(n)], pa.binary()),
        lambda: pa.array([bool(j % 2) for j in range(n)]),
        lambda: pa.array(range(n), pa.timestamp("us")),
        lambda: pa.array(range(n), pa.date32()),
        lambda: pa.array(range(n), pa.duration("ns")),
        lambda: pa.array([[1.0, 2.0]] * n),
        lambda: pa.array([{"a": 1, "b": [None]}] * n),
        lambda: pa.array([[[["x"]]]] * n),
        lambda: pa.nulls(n),
        lambda: pa.array(["x"] * n).dictionary_encode(),
        lambda: pa.array([10**30] * n, pa.decimal128(38, 2)),
        lambda: pa.array([2**63 - 1] * n, pa.int64()),
        lambda: pa.array([2**64 - 1] * n, pa.uint64()),
        lambda: pa.array([[("k", 1)]] * n, pa.map_(pa.string(), pa.int64())),
        lambda: pa.array(np.zeros(n, np.float16)),
        lambda: pa.array(["a" * 2000] * n),
    ]
    return pick(kinds, rng)()


def _filled(column: pa.ChunkedArray, rng: np.random.Generator) -> pa.Array:
    """Values of the column's own type that nobody expects."""
    n, kind = len(column), column.type
    if pa.types.is_floating(kind):
        values = np.array(column.to_numpy(), dtype=float)
        where = slice(None) if rng.random() < 0.5 else slice(n // 3, n // 3 + 2)
        numbers = [np.nan, np.inf, -np.inf, 0.0, 1e300, -1e300, 5e-324, 7.0, -1.0]
        values[where] = pick(numbers, rng)
        return pa.array(values, kind)
    if pa.types.is_integer(kind):
        limits = np.iinfo(kind.to_pandas_dtype())
        # The same draw for every type, brought into its range: an unsigned column holds no -1.
        drawing = pick([0, -1, 1, 2**31, -(2**62)], rng)
        return pa.array([min(max(drawing, limits.min), limits.max)] * n, kind)
    if pa.types.is_string(kind):
        return pa.array([hostile.string(rng).encode("utf-8", "replace").decode()] * n)
    return _of_another_type(column, rng)


def _other_rows(table: pa.Table, rng: np.random.Generator) -> pa.Table:
    n = table.num_rows
    match int(rng.integers(0, 5)):
        case 0 | 1 as few:
            return table.slice(0, few)
        case 2:
            return table.take(pa.array(np.arange(n)[::-1]))
        case 3:
            return table.take(pa.array(rng.integers(0, max(1, n), n)))
    return pa.concat_tables([table, table])


def _other_metadata(table: pa.Table, rng: np.random.Generator) -> pa.Table:
    retained = dict(table.schema.metadata or {b"pandas": b'{"index_columns": [], "columns": []}'})
    key = pick(list(retained), rng)
    retained[key] = rng.bytes(50) if rng.random() < 0.3 else _json(retained[key], rng).encode()
    return table.replace_schema_metadata(retained)


def _json(text: Any, rng: np.random.Generator) -> str:
    """Text that holds JSON, injured as JSON."""
    try:
        return json.dumps(damaged_tree(json.loads(text), rng))
    except (TypeError, ValueError):
        return "{" + str(text)


def sqlite_damage(data: bytes, rng: np.random.Generator) -> bytes:
    """An SQLite database with injured tables and cells; one in three is injured as bytes
    instead.
    """
    if rng.random() < 0.35:
        return damaged(data, rng)
    base = sqlite3.connect(":memory:")
    try:
        base.deserialize(data)
        for _ in range(int(rng.integers(1, 3))):
            _injure_database(base, rng)
        base.commit()
        return base.serialize()
    except sqlite3.Error:  # refused by SQLite itself
        return damaged(data, rng)
    finally:
        base.close()


def _injure_database(base: sqlite3.Connection, rng: np.random.Generator) -> None:
    result = dict(base.execute("select name, sql from sqlite_master where type = 'table'"))
    if not result:
        return
    table = pick(list(result), rng)
    columns = [row[1] for row in base.execute(f'pragma table_info("{table}")')]
    column = pick(columns, rng)
    has_rows = "without rowid" not in (result[table] or "").lower()
    some = " where rowid % 2" if has_rows and rng.random() < 0.3 else ""
    match int(rng.integers(0, 12)):
        case 0:
            base.execute(f'drop table "{table}"')
        case 1:
            base.execute(f'alter table "{table}" rename to other')
        case 2:
            base.execute(f'alter table "{table}" rename column "{column}" to other')
        case 3:
            base.execute(f'delete from "{table}"{some}')
        case 4:
            base.execute(f'alter table "{table}" add column more text default "x"')
        case 5:
            ones = ", ".join(f"1 as {name}" for name in columns)
            base.execute(f'drop table "{table}"')
            base.execute(f'create view "{table}" as select {ones}')
        case 6:
            base.execute("pragma user_version = 77")
        case 7:
            # The same table without its constraints, so that NULL and other types get in.
            base.execute(f'create table copy as select * from "{table}"')
            base.execute(f'drop table "{table}"')
            base.execute(f'alter table copy rename to "{table}"')
            base.execute(f'update "{table}" set "{column}" = null{some}')
        case 8:
            cells = base.execute(f'select distinct "{column}" from "{table}" limit 3').fetchall()
            change = f'update or ignore "{table}" set "{column}" = ? where "{column}" = ?'
            for (text,) in cells:
                base.execute(change, (_json(text, rng), text))
        case _:
            new = value(rng)
            if isinstance(new, list | dict) or (isinstance(new, int) and abs(new) >= 2**63):
                new = rng.bytes(9)
            base.execute(f'update or ignore "{table}" set "{column}" = ?{some}', (new,))


class _Runs:
    """Unpickling this would be told of by the interpreter's audit hook (pickle.find_class)."""

    def __reduce__(self) -> tuple[Any, tuple[str]]:
        return print, ("unpickled",)


def npz_damage(data: bytes, rng: np.random.Generator) -> bytes:
    """A .npz with injured arrays, members and headers; one in three is injured as bytes instead."""
    if rng.random() < 0.3:
        return damaged(data, rng)
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    name = pick(list(members), rng)
    shape = [pick([0, 1, 3, 7], rng) for _ in range(int(rng.integers(0, 4)))]
    match int(rng.integers(0, 9)):
        case 0:
            del members[name]
        case 1:
            members[name] = damaged(members[name], rng)
        case 2:
            members[f"../{name}"] = members.pop(name)
        case 3 | 4 if "header.npy" in members:
            header = np.load(io.BytesIO(members["header.npy"])).tobytes()
            members["header.npy"] = _array(np.frombuffer(_json(header, rng).encode(), np.uint8))
        case 5:
            members[name] = _array(np.array([_Runs()], dtype=object))
        case 6:
            members[name] = _promising(rng)
        case 7:
            members[name] = _array(np.zeros(shape))
        case _:
            old = np.load(io.BytesIO(members[name]))
            types = ["f2", "i8", "U5", "S3", "c16", "M8[s]", "?"]
            members[name] = _array(np.zeros(old.shape, dtype=pick(types, rng)))
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for key, content in members.items():
            # A fixed date: the same seed gives the same bytes.
            archive.writestr(zipfile.ZipInfo(key, (2026, 1, 1, 0, 0, 0)), content)
    return out.getvalue()


def _array(values: np.ndarray) -> bytes:
    out = io.BytesIO()
    np.save(out, values, allow_pickle=True)
    return out.getvalue()


def _promising(rng: np.random.Generator) -> bytes:
    """An array whose header promises more than follows."""
    out = io.BytesIO()
    sizes = tuple(pick([0, 3, 10**6, 10**10], rng) for _ in range(int(rng.integers(1, 4))))
    kind = pick(["<f8", "|O", "<U1000000", "|V9999999"], rng)
    header = {"descr": kind, "fortran_order": False, "shape": sizes}
    np.lib.format.write_array_header_1_0(out, header)
    return out.getvalue() + bytes(800)
