"""Parquet tables of this program: reproducible bytes, and reading within memory limits.

Tables may come from elsewhere. Sizes are checked before memory is allocated, and texts are counted
before dictionaries are expanded.
"""

from __future__ import annotations

import io
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from sysid.foreign.regular_files import read_regular
from uqharness.errors import BadInputError
from uqharness.files import write_bytes

_MAX_BYTES = 1_000_000_000
_MAX_MEMORY_BYTES = 1_500_000_000
_TEXT_BASE_BYTES, _TEXT_PER_BYTE = 50_000_000, 100.0


def table_bytes(table: pa.Table) -> bytes:
    """Return a table as parquet, with every option fixed that affects the bytes."""
    buffer = io.BytesIO()
    pq.write_table(
        table,
        buffer,
        version="2.6",
        data_page_version="1.0",
        compression="zstd",
        compression_level=3,
        use_dictionary=True,
        write_statistics=True,
        row_group_size=65536,
        store_schema=False,
    )
    return buffer.getvalue()


def write_table(table: pa.Table, path: Path) -> None:
    """Write a table as parquet. Raises BadInputError."""
    write_bytes(path, table_bytes(table))


def read_table(path: Path) -> pa.Table:
    """Read a table of this program. Raises BadInputError."""
    try:
        content = read_regular(path, _MAX_BYTES)
    except FileNotFoundError:
        raise BadInputError(
            f"{path}: not there; run the campaign first: uqharness campaign run"
        ) from None
    except OSError as error:
        raise BadInputError(
            f"{path}: not a readable parquet file: {error.strerror or error}"
        ) from None
    return parse_table(content, path)


def _decode(content: bytes, schema: pa.Schema, path: Path) -> pa.Table:
    """Return the table with texts expanded, unless that takes too much memory.

    A dictionary holds each text once and rows refer to it: 16 kB can stand for gigabytes. Column
    chunks are decoded with their dictionaries, and texts are counted before they are expanded.
    """
    texts = [field.name for field in schema if _is_text(field.type)]
    text_bytes, row_bytes = 0, 0
    parts: list[pa.Table] = []
    with pq.ParquetFile(pa.BufferReader(content), read_dictionary=texts) as file:
        # One row group at a time, so that the check precedes the memory.
        for group in range(file.num_row_groups):
            part = file.read_row_group(group, use_threads=False)
            parts.append(part)
            row_bytes += part.nbytes
            for column in part.columns:
                for chunk in column.chunks:
                    if pa.types.is_dictionary(chunk.type) and _is_text(chunk.type.value_type):
                        text_bytes += _text_bytes(chunk)
            if row_bytes + text_bytes > _MAX_MEMORY_BYTES or text_bytes > _max_text_bytes(
                len(content)
            ):
                raise BadInputError(
                    f"{path}: its texts would take {(row_bytes + text_bytes) / 1e9:.3g} GB of"
                    " memory, and"
                    f" it has {len(content) / 1e6:.3g} MB: it is damaged or made to fill the memory"
                )
        table = pa.concat_tables(parts) if parts else file.read()
    columns = [
        column.cast(column.type.value_type) if pa.types.is_dictionary(column.type) else column
        for column in table.columns
    ]
    return pa.table(columns, names=table.column_names)


def _max_text_bytes(file_bytes: int) -> float:
    """Return the bytes of text that a file of a size may hold; reasons of failed flights compress
    well.
    """
    return _TEXT_BASE_BYTES + _TEXT_PER_BYTE * file_bytes


def _text_bytes(chunk: pa.DictionaryArray) -> int:
    """Return the bytes of the texts that a column chunk stands for."""
    lengths = pc.binary_length(chunk.dictionary)
    total = pc.sum(pc.take(pc.cast(lengths, pa.int64()), chunk.indices)).as_py()
    return int(total or 0)


def _is_text(kind: pa.DataType) -> bool:
    """Return whether an Arrow type is text or binary."""
    return bool(
        pa.types.is_string(kind)
        or pa.types.is_large_string(kind)
        or pa.types.is_binary(kind)
        or pa.types.is_large_binary(kind)
    )


def parse_table(content: bytes, path: Path, rows: int | None = None) -> pa.Table:
    """Return a parquet table from the bytes of a file.

    Parameters
    ----------
    content : bytes
        Content of the file.
    path : Path
        Name of the file in messages.
    rows : int, optional
        Expected number of rows, from the manifest.

    Raises
    ------
    BadInputError
        If the file is damaged, too large, or has another number of rows.
    """
    try:
        with pq.ParquetFile(pa.BufferReader(content)) as file:
            metadata = file.metadata
            if rows is not None and metadata.num_rows != rows:
                raise BadInputError(
                    f"{path}: has {metadata.num_rows} flights, the manifest lists {rows}; run the"
                    " campaign again"
                )
            # Sizes in the metadata are checked before any column is decoded.
            groups = [
                metadata.row_group(number).total_byte_size
                for number in range(metadata.num_row_groups)
            ]
            needed_bytes = max(8 * metadata.num_rows * metadata.num_columns, sum(groups))
            if needed_bytes > _MAX_MEMORY_BYTES:
                raise BadInputError(
                    f"{path}: would take {needed_bytes / 1e9:.3g} GB of memory; at most"
                    f" {_MAX_MEMORY_BYTES / 1e9:g} GB"
                )
            table = _decode(content, file.schema_arrow, path)
            # The reader itself accepts invalid UTF-8 and offsets outside a buffer.
            table.validate(full=True)
            # Metadata of other programs would influence later readers.
            return table.replace_schema_metadata(None)
    except (OSError, pa.ArrowException, ValueError, OverflowError, MemoryError) as error:
        raise BadInputError(
            f"{path}: not a readable parquet file: {' '.join(str(error).split())}"
        ) from None
