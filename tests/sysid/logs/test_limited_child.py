"""Answers of the reader process to sound, refused and failing orders."""

from __future__ import annotations

import io
import struct
from pathlib import Path

import numpy as np

from sysid.foreign.typed_files import load
from sysid.logs import limited_child


def served(kind: str, path: Path, wanted=None) -> list[tuple[str, bytes]]:
    out = io.BytesIO()
    limited_child._serve(
        {"kind": kind, "path": str(path), "selection": wanted, "memory": 2_000_000_000}, out
    )
    data, pos, frames = out.getvalue(), 0, []
    while pos < len(data):
        (size,) = struct.unpack_from("<Q", data, pos + 1)
        frames.append((chr(data[pos]), data[pos + 9 : pos + 9 + size]))
        pos += 9 + size
    assert pos == len(data)
    return frames


def test_a_log_is_sent_table_by_table_and_then_what_is_known_of_it(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("t,x,y\n0,1,2\n1,3,4\n")
    frames = served("csv", tmp_path / "a.csv", {"csv": ["x"]})
    assert [kind for kind, _ in frames] == ["r", "c", "c", "d"]
    name, key, instance, time_s, fields, place = load(frames[1][1])
    assert len(place) == 0  # a table has no order but its own
    assert (name, key, instance) == ("table", "csv", 0)
    assert time_s.tolist() == [0.0, 1.0]
    assert {k: v.tolist() for k, v in fields.items()} == {"x": [1.0, 3.0]}
    about, facts = load(frames[2][1])
    assert about == "about"
    assert (facts["dialect"], facts["count_names"].tolist(), facts["counts"].tolist()) == (
        "csv",
        ["csv"],
        [2],
    )


def test_a_record_and_a_small_table_go_column_by_column(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("time_s,q_radps\n0,1\n1,3\n")
    parts = [load(content) for kind, content in served("record", tmp_path / "a.csv") if kind == "c"]
    assert [p[:2] for p in parts] == [("column", "time_s"), ("column", "q_radps"), ("metadata", "")]
    np.testing.assert_array_equal(parts[1][2], [1.0, 3.0])
    (tmp_path / "m.csv").write_text("manoeuvre,start_s\na,1\n")
    parts = [load(content) for kind, content in served("table", tmp_path / "m.csv") if kind == "c"]
    assert [p[1] for p in parts] == ["manoeuvre", "start_s"]


def test_a_refusal_is_its_sentence_and_a_failure_its_traceback(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("x,y\n0,1\n1,3\n")
    frames = served("csv", tmp_path / "a.csv")
    assert [kind for kind, _ in frames] == ["r", "e"]
    assert "no time column" in frames[1][1].decode()
    ((kind, content),) = served("riddle", tmp_path / "a.csv")
    assert kind == "x"
    assert "KeyError: 'riddle'" in content.decode()
