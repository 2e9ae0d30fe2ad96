"""Read MATLAB files as logs: version 5 by scipy, version 7.3 (HDF5) by h5py.

A file becomes nested dictionaries of arrays (`_read_v5`, `_read_hdf5`). Every numeric vector, and
every column of a matrix, is a field that is named by its path. Fields of equal length that share a
time column are one message; a struct may hold several loggers with separate times.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.errors import LogError, one_line
from sysid.foreign.limited import MAX_COLUMNS
from sysid.foreign.raw import FieldSelection, MessageTable, RawLog, TimeColumn
from sysid.foreign.regular_files import open_regular
from sysid.logs.tables import time_names, times_of
from sysid.logs.time_base import TIME_UNITS

_TimeBase = tuple[str, NDArray[np.float64], str]
"""Time field, times in s, and unit of the field."""
WORKSPACE = "workspace"
"""Message of the variables that are not in a struct."""
_MAX_DEPTH = 12
_MAX_MATRIX_COLUMNS = 64
_HDF5 = b"\x89HDF\r\n\x1a\n"


def read(
    path: Path, selection: FieldSelection | None = None, time: TimeColumn | None = None
) -> RawLog:
    """Read a .mat file of version 5 or 7.3.

    Parameters
    ----------
    path : Path
        File.
    selection : mapping or None
        Message to fields that are returned; None returns all.
    time : TimeColumn or None
        Time column of the main message by a map; None detects it.

    Returns
    -------
    RawLog
        Each message is named by its struct ("flight_data"; "workspace" for variables without one).
        Further time columns of the struct name further messages ("flight_data/motor_time"), and so
        do vectors of another length. ``facts["columns"]`` lists all fields.

    Raises
    ------
    LogError
        If the file is damaged, holds no vector of numbers, or no time column.
    """
    with open_regular(path) as handle:
        head = handle.read(520)
    try:
        # Version 7.3 is HDF5, whose signature follows an optional block of 512 bytes.
        is_hdf5 = head.startswith(_HDF5) or head[512:520] == _HDF5
        tree = _read_hdf5(path) if is_hdf5 else _read_v5(path)
    except (LogError, MemoryError):
        raise
    except Exception as error:  # a damaged file may make the libraries raise anything
        raise LogError(
            f"not a readable MATLAB file ({type(error).__name__}: {one_line(error)}); save it again"
            " with `save FILE.mat`",
            path,
        ) from None
    # Vectors of all structs; objects of MATLAB classes are listed, they cannot be read.
    arrays: dict[tuple[str, str], NDArray[Any]] = {}
    objects: list[str] = []
    for struct, name, values in _fields(tree, "", objects, 0):
        arrays[struct, name] = values
        if len(arrays) > MAX_COLUMNS:
            raise LogError(f"has more than {MAX_COLUMNS} fields; save fewer variables", path)
    if not arrays:
        reason = (
            f"; {', '.join(objects[:5])} are objects (timeseries, tables), which no other program"
            " reads: save structs with fields time and data, or export a CSV"
            if objects
            else ""
        )
        raise LogError(f"holds no vector of numbers{reason}", path)
    messages, findings, clocks = _messages(arrays, time, path)
    if selection is not None:
        messages = {
            (name, 0): MessageTable(
                table.time_s,
                {f: v for f, v in table.fields.items() if f in selection.get(name, ())},
            )
            for (name, _), table in messages.items()
            if name in selection
        }
    return RawLog(
        dialect="mat",
        messages=messages,
        counts={name: len(column) for name, (_, column, _) in clocks.items()},
        facts={
            "columns": "\n".join(f"{struct}.{name}" for struct, name in arrays),
            "time column": next(iter(clocks.values()))[0],
            "time unit": next(iter(clocks.values()))[2],
        },
        findings=tuple(findings),
    )


def _read_v5(path: Path) -> Mapping[str, Any]:
    """Return the variables of a file of version 4 to 7 as nested dictionaries."""
    from scipy.io import loadmat

    with open_regular(path) as handle:
        variables = loadmat(handle, simplify_cells=True)
    return {name: value for name, value in variables.items() if not name.startswith("__")}


def _read_hdf5(path: Path) -> Mapping[str, Any]:
    """Return the variables of a file of version 7.3 as nested dictionaries."""
    try:
        import h5py
    except ModuleNotFoundError:
        raise LogError(
            "this is a MATLAB file of version 7.3 (HDF5), which needs the package h5py: `pip"
            " install uqharness[matlab]`, or save it with `save -v7 FILE.mat`",
            path,
        ) from None

    visited = 0

    def group_of(node: Any, depth: int) -> dict[str, Any]:
        """Return the members of a group. Links to other places and files are not followed."""
        return {
            str(name): value_of(node[name], depth + 1)
            for name in node
            if name != "#refs#" and isinstance(node.get(name, getlink=True), h5py.HardLink)
        }

    def value_of(node: Any, depth: int) -> Any:
        """Return a group as a dictionary, a data set as an array; follow references."""
        nonlocal visited
        visited += 1
        if visited > 10 * MAX_COLUMNS:
            raise LogError(f"has more than {10 * MAX_COLUMNS} nodes; save fewer variables", path)
        if depth > _MAX_DEPTH:
            return None
        if isinstance(node, h5py.Group):
            return group_of(node, depth)
        if not isinstance(node, h5py.Dataset) or node.external or node.is_virtual:
            return None
        if node.dtype == object or h5py.check_ref_dtype(node.dtype) is not None:
            references = np.ravel(node[()], order="F")
            if len(references) > MAX_COLUMNS:
                return None
            return [value_of(node.file[r], depth + 1) for r in references if r]
        if node.attrs.get("MATLAB_class") in (b"char", "char") or node.dtype.kind not in "fiub":
            return None
        if "MATLAB_empty" in node.attrs:
            return None
        # HDF5 stores the columns of MATLAB as rows.
        return np.squeeze(node[()].T)

    with h5py.File(path, "r") as file:
        return group_of(file, 0)


def _fields(
    node: Any, path: str, objects: list[str], depth: int
) -> Iterator[tuple[str, str, NDArray[Any]]]:
    """Yield struct path, field name and values of every vector of at least two numbers."""
    if depth > _MAX_DEPTH:
        return
    # Structs and cells are walked; their path names the field.
    if isinstance(node, Mapping):
        for name, value in node.items():
            yield from _fields(value, f"{path}.{name}" if path else str(name), objects, depth + 1)
        return
    if isinstance(node, np.ndarray) and node.dtype == object:
        node = list(node.ravel())
    if isinstance(node, list):
        for number, value in enumerate(node[:MAX_COLUMNS], start=1):
            if isinstance(value, Mapping | list | np.ndarray):
                yield from _fields(value, f"{path}({number})", objects, depth + 1)
        return
    # Objects of MATLAB classes cannot be read and are listed.
    if not isinstance(node, np.ndarray):
        if not isinstance(node, str | bytes | int | float | complex | np.generic | None):
            objects.append(path)
        return
    if node.dtype.names is not None or type(node).__name__ == "MatlabOpaque":
        objects.append(path)
        return
    if node.dtype.kind not in "fiub" or node.size < 2:
        return
    # Vectors are fields; the columns of a narrow matrix are fields by number.
    values = np.squeeze(node)
    struct, _, name = path.rpartition(".")
    struct = struct or WORKSPACE
    if values.ndim == 1:
        yield struct, name, np.ascontiguousarray(values)
    elif values.ndim == 2 and min(values.shape) <= _MAX_MATRIX_COLUMNS:
        columns = values if values.shape[0] >= values.shape[1] else values.T
        for number in range(columns.shape[1]):
            yield struct, f"{name}({number + 1})", np.ascontiguousarray(columns[:, number])


def _messages(
    arrays: Mapping[tuple[str, str], NDArray[Any]], time: TimeColumn | None, path: Path
) -> tuple[dict[tuple[str, int], MessageTable], list[Any], dict[str, _TimeBase]]:
    """Group fields by struct, length and time column.

    A struct without a time column uses that of the nearest struct around it with equal length.
    """
    groups: dict[tuple[str, int], dict[str, NDArray[Any]]] = {}
    for (struct, name), values in arrays.items():
        groups.setdefault((struct, len(values)), {})[name] = values
    clocks: dict[tuple[str, int], _TimeBase] = {}
    findings: list[Any] = []
    time_field = None if time is None else _field_of(time.field, arrays)
    if time is not None and time_field is None:
        raise LogError(
            f"no field {time.field} for the time ([signals.time_s] of the map); the fields are"
            f" {', '.join(f'{s}.{n}' for s, n in list(arrays)[:40])}",
            path,
        )
    for (struct, length), fields in groups.items():
        candidates = time_names(list(fields))
        if time_field is not None and time_field[0] == struct and len(arrays[time_field]) == length:
            assert time is not None
            seconds = TIME_UNITS[time.unit] if time.unit in TIME_UNITS else float(time.unit)
            values = fields[time_field[1]].astype(np.float64) * seconds
            clocks[struct, length] = (time_field[1], values, str(time.unit))
        elif candidates:
            column, time_s, notes = times_of({n: fields[n] for n in candidates}, None, path)
            clocks[struct, length] = (column.field, time_s, column.unit)
            findings += notes
    if not clocks:
        raise LogError(
            'no time column; name it in a map ([signals.time_s] field = "..." unit = "s", ms, us or'
            f" ns); the fields are {', '.join(f'{s}.{n}' for s, n in list(arrays)[:40])}",
            path,
        )
    messages: dict[tuple[str, int], MessageTable] = {}
    sources: dict[str, _TimeBase] = {}
    # The longest group of a struct has the name of the struct.
    used_names: set[str] = set()
    for (struct, length), fields in sorted(groups.items(), key=lambda item: -item[0][1]):
        clock = clocks.get((struct, length)) or _outer_clock(struct, length, clocks)
        if clock is None:
            continue
        name = struct if struct not in used_names else f"{struct}/{clock[0]}"
        used_names.add(struct)
        messages[name, 0] = MessageTable(clock[1], dict(fields))
        sources[name] = clock
    return messages, findings, sources


def _field_of(text: str, arrays: Mapping[tuple[str, str], NDArray[Any]]) -> tuple[str, str] | None:
    """Return struct and name of a field by its full path or its last name."""
    return next((key for key in arrays if text in (f"{key[0]}.{key[1]}", key[1])), None)


def _outer_clock(
    struct: str, length: int, clocks: Mapping[tuple[str, int], _TimeBase]
) -> _TimeBase | None:
    """Return the clock of equal length whose struct shares the longest begin of the path."""

    def shared(other: str) -> int:
        """Return the number of leading names that two paths share."""
        pairs = zip(struct.split("."), other.split("."), strict=False)
        return next((k for k, (a, b) in enumerate(pairs) if a != b), len(other.split(".")))

    fitting = [key for key in clocks if key[1] == length]
    return clocks[max(fitting, key=lambda key: shared(key[0]))] if fitting else None
