"""Damage to bytes, lines and the cells of CSV tables: what disks, editors and spreadsheets do."""

from __future__ import annotations

import numpy as np

from tests.fuzz import hostile
from tests.fuzz.hostile import WORDS, pick

_HEADER, _LONG = 2048, 5000
_BYTES = "cut removed twice zeros noise moved longer flips flip flip header footer integer integer"
_LINES = "lost doubled moved joined broken word word word word odd few long"
_TABLE = (
    "lost lost doubled renamed names fill fill fill scale cell cell shuffled reversed few ragged"
)


def damaged(data: bytes, rng: np.random.Generator) -> bytes:
    """``data`` with one to three injuries; never longer than three times itself."""
    for _ in range(int(rng.integers(1, 4))):
        data = _injured(data, rng) if data else data
    return data


def _injured(data: bytes, rng: np.random.Generator) -> bytes:
    n = len(data)
    a = int(rng.integers(0, n))
    b = min(n, a + int(rng.integers(1, max(2, n // 10))))
    head, part, tail = data[:a], data[a:b], data[b:]
    match pick(_BYTES.split(), rng):
        case "cut":
            return head
        case "removed":
            return head + tail
        case "twice":
            return head + part + part + tail
        case "zeros":
            return head + bytes(b - a) + tail
        case "noise":
            return head + rng.bytes(b - a) + tail
        case "moved":
            return part + head + tail
        case "longer":
            return data + (rng.bytes(int(rng.integers(1, 300))) if rng.random() < 0.5 else data)
        case "integer":
            size = int(rng.choice([1, 2, 4, 8]))
            value = pick(WORDS["integers"], rng) % 2 ** (8 * size)
            a = a if rng.random() < 0.5 else a % _HEADER
            order = "little" if rng.random() < 0.8 else "big"
            return data[:a] + value.to_bytes(size, order) + data[a + size :]
        case "flip":
            return _flipped(data, [a], rng)
        case "flips":
            return _flipped(data, rng.integers(0, n, int(rng.integers(1, 40))), rng)
        case place:
            # Headers steer a reader more than payload does; Parquet and ZIP have theirs at the end.
            where = rng.integers(0, min(n, _HEADER), int(rng.integers(1, 40)))
            return _flipped(data, where if place == "header" else n - 1 - where, rng)


def _flipped(data: bytes, places, rng: np.random.Generator) -> bytes:
    out = bytearray(data)
    for place in places:
        out[int(place)] ^= 1 << int(rng.integers(0, 8))
    return bytes(out)


def damaged_text(data: bytes, rng: np.random.Generator) -> bytes:
    """Lines lost, doubled, moved, joined or broken; words replaced; other ends of lines, other
    encodings.
    """
    lines = data.split(b"\n")
    for _ in range(int(rng.integers(1, 4))):
        _injure_lines(lines, rng)
    out = b"\n".join(lines)
    match int(rng.integers(0, 20)):
        case 0:
            return b"\xef\xbb\xbf" + out
        case 1:
            return out.decode("utf-8", "replace").encode("utf-16")
        case 2 | 3 as kind:
            return out.replace(b"\n", b"\r\n" if kind == 2 else b"\r")
        case 4:
            return damaged(out, rng)
    return out


def _injure_lines(lines: list[bytes], rng: np.random.Generator) -> None:
    lines[:] = lines or [b""]
    a = int(rng.integers(0, len(lines)))
    line = lines[a]
    many = 200 if len(line) < _LONG else 2
    match pick(_LINES.split(), rng):
        case "lost":
            del lines[a : a + int(rng.integers(1, 4))]
        case "doubled":
            lines[a:a] = [line] * int(rng.choice([1, 1, many]))
        case "moved":
            lines.insert(int(rng.integers(0, len(lines))), lines.pop(a))
        case "joined":
            lines[a : a + 2] = [b" ".join(lines[a : a + 2])]
        case "broken":
            section = int(rng.integers(0, len(line) + 1))
            lines[a : a + 1] = [line[:section], line[section:]]
        case "word":
            separator = b"," if b"," in line else b" "
            cells = line.split(separator)
            new = _word(rng).encode("utf-8", "surrogatepass")
            cells[int(rng.integers(0, len(cells)))] = new
            lines[a] = separator.join(cells)
        case "odd":
            lines[a] += rng.bytes(5)
        case "few":
            del lines[int(rng.integers(0, 3)) :]
        case "long":
            lines[a] = (line + b",") * many


def _word(rng: np.random.Generator) -> str:
    if rng.random() < 0.6:
        return hostile.string(rng)
    value = hostile.number(rng)
    # Longer integers than repr may print are what some of these are for.
    return "1" + "0" * 400 if isinstance(value, int) and value > 10**300 else repr(value)


def damaged_table(data: bytes, rng: np.random.Generator) -> bytes:
    """A CSV table with injured columns and rows; one in three is injured as text instead."""
    if rng.random() < 0.35:
        return damaged_text(data, rng)
    lines = data.decode().splitlines()
    remarks = [line for line in lines if line.startswith("#")] if rng.random() < 0.85 else []
    rows = [line.split(",") for line in lines if not line.startswith("#")]
    for _ in range(int(rng.integers(1, 4))):
        if rows and rows[0]:
            _injure_rows(rows, rng)
    text = "\n".join([*remarks, *(",".join(row) for row in rows)]) + "\n"
    return text.encode("utf-8", "surrogatepass")


def _injure_rows(rows: list[list[str]], rng: np.random.Generator) -> None:
    j, k = (int(rng.integers(0, len(rows[0]))) for _ in "jk")
    row = pick(rows, rng)
    start = int(rng.integers(1, max(2, len(rows))))
    match pick(_TABLE.split(), rng):
        case "lost" | "doubled" as kind:
            for each in rows:
                each[k : k + 1] = each[k : k + 1] * (2 if kind == "doubled" else 0)
        case "renamed":
            rows[0][k] = hostile.string(rng)
        case "names":
            rows[0][j], rows[0][k] = rows[0][k], rows[0][j]
        case "fill":
            new = str(rng.choice(WORDS["cells"]))
            for each in rows[1:] if rng.random() < 0.6 else rows[start : start + 5]:
                each[k : k + 1] = [new] * len(each[k : k + 1])
        case "scale":
            factor = float(rng.choice([-1.0, 0.0, 1e-12, 1e9, 1e18, 1e200]))
            for each in rows[1:]:
                if k < len(each) and each[k].replace(".", "").lstrip("-").isdigit():
                    each[k] = repr(float(each[k]) * factor)
        case "cell":
            row[k : k + 1] = [_word(rng)] * len(row[k : k + 1])
        case "shuffled":
            rows[1:] = [rows[1 + int(i)] for i in rng.permutation(len(rows) - 1)]
        case "reversed":
            rows[1:] = rows[:0:-1]
        case "few":
            del rows[int(rng.integers(0, 4)) :]
        case "ragged":
            row += ["7"] * int(rng.choice([1, 2, 500]))
