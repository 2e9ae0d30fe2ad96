"""Damage to what binary containers hold: Parquet columns, SQLite rows, arrays of .npz."""

from __future__ import annotations

import io
import json
import sqlite3
import zipfile
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from tests.fuzz import damage_bytes, hostile
from tests.fuzz.damage_tree import damaged_tree, value
from tests.fuzz.hostile import pick


def parquet_damage(data: bytes, rng: np.random.Generator) -> bytes:
    """A Parquet file with injured columns, rows or metadata; one in three is injured as bytes
    instead.
    """
    bomb = pq.read_metadata(io.BytesIO(data)).num_rows > 1_000_000
    if bomb and rng.random() < 0.5:
        return data
    if bomb or rng.random() < 0.35:
        return damage_bytes.damaged(data, rng)
    table = pq.read_table(io.BytesIO(data))
    for _ in range(int(rng.integers(1, 4))):
        if not table.num_columns:
            break
        table = pick(_PARQUET, rng)(table, rng)
    out = io.BytesIO()
    compression = str(rng.choice(["zstd", "snappy", "gzip", "none", "brotli"]))
    try:
        pq.write_table(
            table, out, compression=compression, row_group_size=int(rng.choice([3, 100, 10**6]))
        )
    except (pa.ArrowException, ValueError, TypeError):  # what Parquet cannot hold is no input
        return damage_bytes.damaged(data, rng)
    return out.getvalue()


def _pick(table: pa.Table, rng: np.random.Generator) -> int:
    return int(rng.integers(0, table.num_columns))


def _with(table: pa.Table, k: int, values: pa.Array, name: str | None = None) -> pa.Table:
    return table.set_column(k, name or table.column_names[k], values)


def _lose(table: pa.Table, rng: np.random.Generator) -> pa.Table:
    return table.remove_column(_pick(table, rng))


def _double(table: pa.Table, rng: np.random.Generator) -> pa.Table:
    k = _pick(table, rng)
    return table.append_column(table.column_names[k], table.column(k))


def _rename(table: pa.Table, rng: np.random.Generator) -> pa.Table:
    names = list(table.column_names)
    names[_pick(table, rng)] = hostile.string(rng)
    return table.rename_columns(names)


def _swap(table: pa.Table, rng: np.random.Generator) -> pa.Table:
    names = list(table.column_names)
    j, k = _pick(table, rng), _pick(table, rng)
    names[j], names[k] = names[k], names[j]
    return table.rename_columns(names)


def _retype(table: pa.Table, rng: np.random.Generator) -> pa.Table:
    """A column of another type, nested ones among them."""
    k, n = _pick(table, rng), table.num_rows
    kinds: list[Any] = [
        lambda: pa.array([str(v) for v in table.column(k).to_pylist()]),
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
    return _with(table, k, pick(kinds, rng)())


def _fill(table: pa.Table, rng: np.random.Generator) -> pa.Table:
    """Values of the column's own type that nobody expects."""
    k, n = _pick(table, rng), table.num_rows
    column = table.column(k)
    if pa.types.is_floating(column.type):
        values = np.array(column.to_numpy(), dtype=float)
        where = slice(None) if rng.random() < 0.5 else slice(n // 3, n // 3 + 2)
        values[where] = float(
            rng.choice([np.nan, np.inf, -np.inf, 0.0, 1e300, -1e300, 5e-324, 7.0, -1.0])
        )
        return _with(table, k, pa.array(values, column.type))
    if pa.types.is_integer(column.type):
        limits = np.iinfo(column.type.to_pandas_dtype())
        # The same draw for every type, brought into its range: an unsigned column holds no -1.
        drawn = int(rng.choice([0, -1, 1, 2**31, -(2**62)]))
        return _with(table, k, pa.array([min(max(drawn, limits.min), limits.max)] * n, column.type))
    if pa.types.is_string(column.type):
        text = hostile.string(rng).encode("utf-8", "replace").decode()
        return _with(table, k, pa.array([text] * n))
    return _retype(table, rng)


def _nulls(table: pa.Table, rng: np.random.Generator) -> pa.Table:
    k = _pick(table, rng)
    values = table.column(k).to_pylist()
    for j in rng.integers(0, max(1, len(values)), 3):
        if values:
            values[int(j)] = None
    return _with(table, k, pa.array(values, table.column(k).type))


def _rows(table: pa.Table, rng: np.random.Generator) -> pa.Table:
    n = table.num_rows
    kind = int(rng.integers(0, 6))
    if kind == 0:
        return table.slice(0, 0)
    if kind == 1:
        return table.slice(0, 1)
    if kind == 2:
        return table.take(pa.array(np.arange(n)[::-1]))
    if kind == 3:
        return table.take(pa.array(rng.integers(0, max(1, n), n)))
    if kind == 4:
        return pa.concat_tables([table, table])
    return table.slice(int(rng.integers(0, max(1, n))))


def _metadata(table: pa.Table, rng: np.random.Generator) -> pa.Table:
    kept = dict(table.schema.metadata or {b"pandas": b'{"index_columns": [], "columns": []}'})
    key = pick(list(kept), rng)
    if rng.random() < 0.3:
        kept[key] = rng.bytes(50)
    else:
        try:
            kept[key] = json.dumps(damaged_tree(json.loads(kept[key]), rng)).encode()
        except ValueError:
            kept[key] = hostile.string(rng).encode("utf-8", "replace")
    return table.replace_schema_metadata(kept)


_PARQUET = (
    *(_lose, _lose, _double, _rename, _swap, _retype, _retype, _retype, _fill, _fill),
    *(_nulls, _rows, _metadata),
)


def sqlite_damage(data: bytes, rng: np.random.Generator) -> bytes:
    """An SQLite database with injured tables and cells; one in three is injured as bytes
    instead.
    """
    if rng.random() < 0.35:
        return damage_bytes.damaged(data, rng)
    base = sqlite3.connect(":memory:")
    try:
        base.deserialize(data)
        for _ in range(int(rng.integers(1, 3))):
            _statement(base, rng)
        base.commit()
        return base.serialize()
    except sqlite3.Error:  # refused by SQLite itself
        return damage_bytes.damaged(data, rng)
    finally:
        base.close()


def _statement(base: sqlite3.Connection, rng: np.random.Generator) -> None:
    tables = [row[0] for row in base.execute("select name from sqlite_master where type = 'table'")]
    if not tables:
        return
    table = pick(tables, rng)
    columns = [row[1] for row in base.execute(f'pragma table_info("{table}")')]
    column = pick(columns, rng)
    kind = int(rng.integers(0, 12))
    some = " where rowid % 2" if rng.random() < 0.3 else ""
    if (
        "without rowid"
        in (
            base.execute("select sql from sqlite_master where name = ?", (table,)).fetchone()[0]
            or ""
        ).lower()
    ):
        some = ""
    if kind == 0:
        base.execute(f'drop table "{table}"')
    elif kind == 1:
        base.execute(f'alter table "{table}" rename to other')
    elif kind == 2:
        base.execute(f'alter table "{table}" rename column "{column}" to other')
    elif kind == 3:
        base.execute(f'delete from "{table}"{some}')
    elif kind == 4:
        base.execute(f'alter table "{table}" add column more text default "x"')
    elif kind == 5:
        base.execute(f'drop table "{table}"')
        base.execute(f'create view "{table}" as select {", ".join(f"1 as {c}" for c in columns)}')
    elif kind == 6:
        base.execute("pragma user_version = 77")
    elif kind == 7:
        # The same table without its constraints, so that NULL and other types get in.
        base.execute(f'create table copy as select * from "{table}"')
        base.execute(f'drop table "{table}"')
        base.execute(f'alter table copy rename to "{table}"')
        base.execute(f'update "{table}" set "{column}" = null{some}')
    elif kind == 8:
        _rewrite_json(base, table, column, rng)
    else:
        new: Any = value(rng)
        if (isinstance(new, int) and not -(2**63) <= new < 2**63) or not isinstance(
            new, (int, float, str, type(None))
        ):
            new = rng.bytes(9)
        base.execute(f'update or ignore "{table}" set "{column}" = ?{some}', (new,))


def _rewrite_json(
    base: sqlite3.Connection, table: str, column: str, rng: np.random.Generator
) -> None:
    """Cells that hold JSON, injured as JSON."""
    for (text,) in base.execute(f'select distinct "{column}" from "{table}" limit 3').fetchall():
        try:
            new = json.dumps(damaged_tree(json.loads(text), rng))
        except (TypeError, ValueError):
            new = "{" + str(text)
        base.execute(
            f'update or ignore "{table}" set "{column}" = ? where "{column}" = ?', (new, text)
        )


class _Runs:
    """Unpickling this would be told of by the interpreter's audit hook (pickle.find_class)."""

    def __reduce__(self) -> tuple[Any, tuple[str]]:
        return print, ("unpickled",)


def npz_damage(data: bytes, rng: np.random.Generator) -> bytes:
    """A .npz with injured arrays, members and headers; one in three is injured as bytes instead."""
    if rng.random() < 0.3:
        return damage_bytes.damaged(data, rng)
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    name = pick(list(members), rng)
    kind = int(rng.integers(0, 9))
    if kind == 0:
        del members[name]
    elif kind == 1:
        members[name] = damage_bytes.damaged(members[name], rng)
    elif kind == 2:
        members[f"../{name}"] = members.pop(name)
    elif kind in (3, 4) and "header.npy" in members:
        header = json.loads(np.load(io.BytesIO(members["header.npy"])).tobytes())
        members["header.npy"] = _array(
            np.frombuffer(json.dumps(damaged_tree(header, rng)).encode(), np.uint8)
        )
    elif kind == 5:
        members[name] = _array(np.array([_Runs()], dtype=object))
    elif kind == 6:
        members[name] = _claims(
            tuple(int(rng.choice([0, 3, 10**6, 10**10])) for _ in range(int(rng.integers(1, 4)))),
            rng,
        )
    elif kind == 7:
        members[name] = _array(
            np.zeros(tuple(int(rng.choice([0, 1, 3, 7])) for _ in range(int(rng.integers(0, 4)))))
        )
    else:
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


def _claims(shape: tuple[int, ...], rng: np.random.Generator) -> bytes:
    """An array whose header promises more than follows."""
    out = io.BytesIO()
    descr = str(rng.choice(["<f8", "|O", "<U1000000", "|V9999999"]))
    np.lib.format.write_array_header_1_0(
        out, {"descr": descr, "fortran_order": False, "shape": shape}
    )
    return out.getvalue() + bytes(800)
