"""Damage to lines and cells of text: tables in CSV, logs in words, any file of lines."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tests.fuzz import damage_bytes, hostile
from tests.fuzz.hostile import pick

Lines = list[bytes]
_LONG = 5000


def damaged_text(data: bytes, rng: np.random.Generator) -> bytes:
    """Lines lost, doubled, swapped, joined or broken; words replaced; other ends of lines, other
    encodings.
    """
    lines = data.split(b"\n")
    for _ in range(int(rng.integers(1, 4))):
        lines = pick(_LINES, rng)(lines or [b""], rng)
    out = b"\n".join(lines)
    kind = int(rng.integers(0, 20))
    if kind == 0:
        return b"\xef\xbb\xbf" + out
    if kind == 1:
        return out.decode("utf-8", "replace").encode("utf-16")
    if kind == 2:
        return out.replace(b"\n", b"\r\n")
    if kind == 3:
        return out.replace(b"\n", b"\r")
    return damage_bytes.damaged(out, rng) if kind == 4 else out


def _at(lines: Lines, rng: np.random.Generator) -> int:
    return int(rng.integers(0, len(lines)))


def _lost(lines: Lines, rng: np.random.Generator) -> Lines:
    a = _at(lines, rng)
    return lines[:a] + lines[a + int(rng.integers(1, 4)) :]


def _doubled(lines: Lines, rng: np.random.Generator) -> Lines:
    a = _at(lines, rng)
    times = int(rng.choice([2, 2, 3, 200]))
    return lines[:a] + lines[a : a + 1] * (times if len(lines[a]) < _LONG else 2) + lines[a + 1 :]


def _moved(lines: Lines, rng: np.random.Generator) -> Lines:
    out = list(lines)
    out.insert(_at(lines, rng), out.pop(_at(lines, rng)))
    return out


def _joined(lines: Lines, rng: np.random.Generator) -> Lines:
    a = _at(lines, rng)
    return [*lines[:a], b" ".join(lines[a : a + 2]), *lines[a + 2 :]]


def _broken(lines: Lines, rng: np.random.Generator) -> Lines:
    a = _at(lines, rng)
    cut = int(rng.integers(0, len(lines[a]) + 1))
    return [*lines[:a], lines[a][:cut], lines[a][cut:], *lines[a + 1 :]]


def _word(lines: Lines, rng: np.random.Generator) -> Lines:
    """A cell, a number or a word replaced."""
    a = _at(lines, rng)
    separator = b"," if b"," in lines[a] else b" "
    cells = lines[a].split(separator)
    new = hostile.string(rng) if rng.random() < 0.6 else _plain(hostile.number(rng))
    cells[int(rng.integers(0, len(cells)))] = new.encode("utf-8", "surrogatepass")
    return [*lines[:a], separator.join(cells), *lines[a + 1 :]]


def _odd_bytes(lines: Lines, rng: np.random.Generator) -> Lines:
    a = _at(lines, rng)
    return [*lines[:a], lines[a] + bytes(rng.integers(0, 256, 5).tolist()), *lines[a + 1 :]]


def _empty(lines: Lines, rng: np.random.Generator) -> Lines:
    return lines[: int(rng.integers(0, 3))]


def _long_line(lines: Lines, rng: np.random.Generator) -> Lines:
    a = _at(lines, rng)
    return [*lines[:a], (lines[a] + b",") * (300 if len(lines[a]) < _LONG else 2), *lines[a + 1 :]]


def _plain(value: float) -> str:
    # Longer integers than repr may print are what some of these are for.
    return "1" + "0" * 400 if isinstance(value, int) and value > 10**300 else repr(value)


_LINES: tuple[Callable[[Lines, np.random.Generator], Lines], ...] = (
    *(_lost, _doubled, _moved, _joined, _broken, _word, _word, _word, _word, _odd_bytes),
    *(_empty, _long_line),
)


def damaged_table(data: bytes, rng: np.random.Generator) -> bytes:
    """A CSV table with injured columns and rows; one in three is injured as text instead."""
    if rng.random() < 0.35:
        return damaged_text(data, rng)
    lines = data.decode().splitlines()
    remarks = [line for line in lines if line.startswith("#")]
    rows = [line.split(",") for line in lines if not line.startswith("#")]
    for _ in range(int(rng.integers(1, 4))):
        if not rows or not rows[0]:
            break
        pick(_COLUMNS, rng)(rows, rng)
    if rng.random() < 0.15:
        remarks = []
    text = "\n".join([*remarks, *(",".join(row) for row in rows)]) + "\n"
    return text.encode("utf-8", "surrogatepass")


def _column(rows: list[list[str]], rng: np.random.Generator) -> int:
    return int(rng.integers(0, len(rows[0])))


def _lose_column(rows: list[list[str]], rng: np.random.Generator) -> None:
    k = _column(rows, rng)
    for row in rows:
        del row[k : k + 1]


def _double_column(rows: list[list[str]], rng: np.random.Generator) -> None:
    k = _column(rows, rng)
    for row in rows:
        row += row[k : k + 1]


def _rename_column(rows: list[list[str]], rng: np.random.Generator) -> None:
    rows[0][_column(rows, rng)] = hostile.string(rng)


def _swap_names(rows: list[list[str]], rng: np.random.Generator) -> None:
    j, k = _column(rows, rng), _column(rows, rng)
    rows[0][j], rows[0][k] = rows[0][k], rows[0][j]


def _fill_column(rows: list[list[str]], rng: np.random.Generator) -> None:
    k = _column(rows, rng)
    new = str(rng.choice(hostile.WORDS["cells"]))
    start = int(rng.integers(1, max(2, len(rows))))
    for row in rows[1:] if rng.random() < 0.6 else rows[start : start + 5]:
        if k < len(row):
            row[k] = new


def _scale_column(rows: list[list[str]], rng: np.random.Generator) -> None:
    k, factor = _column(rows, rng), float(rng.choice([-1.0, 0.0, 1e-12, 1e9, 1e18, 1e200]))
    for row in rows[1:]:
        try:
            row[k] = repr(float(row[k]) * factor)
        except (ValueError, IndexError):
            continue


def _one_cell(rows: list[list[str]], rng: np.random.Generator) -> None:
    row = pick(rows, rng)
    if row:
        row[int(rng.integers(0, len(row)))] = (
            hostile.string(rng) if rng.random() < 0.5 else _plain(hostile.number(rng))
        )


def _shuffle_rows(rows: list[list[str]], rng: np.random.Generator) -> None:
    body = rows[1:]
    rows[1:] = (
        [body[int(k)] for k in rng.permutation(len(body))] if rng.random() < 0.5 else body[::-1]
    )


def _few_rows(rows: list[list[str]], rng: np.random.Generator) -> None:
    del rows[int(rng.integers(0, 4)) :]


def _ragged(rows: list[list[str]], rng: np.random.Generator) -> None:
    row = pick(rows, rng)
    row += ["7"] * int(rng.choice([1, 2, 500]))


_COLUMNS = (
    *(_lose_column, _lose_column, _double_column, _rename_column, _swap_names),
    *(_fill_column, _fill_column, _fill_column, _scale_column, _one_cell, _one_cell),
    *(_shuffle_rows, _few_rows, _ragged),
)
