"""Estimates written into an aircraft's XML as a hand would."""

from __future__ import annotations

from pathlib import Path

import pytest

from uqharness.errors import BadInputError
from uqharness.plugin.apply import Estimate, put_values, with_value, write_estimates
from uqharness.simulator.aircraft import find_aircraft
from uqharness.xml.document import parse_document

TEXT = (
    "<a><!-- <property value=\"1\">a/b</property> -->\n  <property  value = '2'"
    ' >a/b</property>\t<!-- old -->\r\n<property value="3">a/bc</property></a>'
)


def edited(text: str, name: str, estimate: Estimate, encoding: str = "utf-8") -> str | None:
    done = with_value(parse_document(Path("a.xml"), text.encode(encoding)), name, estimate)
    return None if done is None else done.decode(encoding)


def test_a_value_is_edited_in_place_and_nowhere_else():
    done = edited(TEXT, "a/b", Estimate(-0.5, "x -- y"))
    assert done == TEXT.replace("'2'", "'-0.5'").replace(
        "<!-- old -->", "<!-- old -->  <!-- identified x - - y -->"
    )
    again = edited(done, "a/b", Estimate(7, "z"))
    assert again is not None
    assert again.count("identified") == 1
    assert edited(TEXT, "b/c", Estimate(1, "")) is None


def test_a_remark_that_begins_on_the_line_is_not_ended_by_ours():
    text = '<a><property value="1">a/b</property> <!-- goes\n on --></a>'
    assert edited(text, "a/b", Estimate(2.0, "x")) == text.replace('"1"', '"2"')


def test_a_remark_is_in_the_encoding_of_the_file():
    text = (
        '<?xml version="1.0" encoding="ISO-8859-1"?>\n<a><!-- ä -->\n<property'
        ' value="1">a/b</property>\n</a>'
    )
    done = edited(text, "a/b", Estimate(2.0, "± 1"), "iso-8859-1")
    assert done == text.replace('"1">a', '"2">a').replace(
        "</property>", "</property>  <!-- identified ± 1 -->"
    )


def test_names_without_a_place_come_back_and_other_files_stay(tmp_path: Path):
    (tmp_path / "Systems").mkdir()
    broken = '<property value="1">a/b</property'
    (tmp_path / "broken.xml").write_text(broken)
    (tmp_path / "Systems" / "a.xml").write_bytes(TEXT.encode())
    left = put_values(
        tmp_path, {"a/b": Estimate(5, "x"), "a/bc": Estimate(6, "y"), "no/where": Estimate(7, "z")}
    )
    assert left == ["no/where"]
    assert (tmp_path / "broken.xml").read_text() == broken
    text = (tmp_path / "Systems" / "a.xml").read_bytes().decode()
    assert text.startswith(
        "<a><!-- <property value=\"1\">a/b</property> -->\n  <property  value = '5' >a/b</property>"
    )
    assert text.endswith('\r\n<property value="6">a/bc</property></a>  <!-- identified y -->')


def test_two_values_on_one_line_are_both_written(tmp_path: Path):
    line = (
        '<a><property value="1">a/b</property> <property value="2">a/c</property>\n<property'
        ' value="3">a/d</property></a>'
    )
    (tmp_path / "a.xml").write_text(line)
    assert (
        put_values(
            tmp_path, {"a/c": Estimate(5, "x"), "a/b": Estimate(4, "y"), "a/d": Estimate(6, "z")}
        )
        == []
    )
    text = (tmp_path / "a.xml").read_text()
    assert [part.partition('"')[0] for part in text.split('value="')[1:]] == ["4", "5", "6"]
    assert text.count("identified z") == 1


def test_a_folder_that_is_no_aircraft_is_not_replaced(tmp_path: Path):
    out = tmp_path / "out"
    out.mkdir()
    (out / "mine.txt").write_text("mine")
    with pytest.raises(BadInputError, match="is no aircraft folder"):
        write_estimates(find_aircraft("espaaro"), {}, out)
    (out / "mine.txt").unlink()
    assert (
        write_estimates(
            find_aircraft("espaaro"), {"aero/Cm_q": Estimate(-9.5, "from one flight")}, out
        )
        == []
    )
    assert "identified from one flight" in "".join(path.read_text() for path in out.rglob("*.xml"))
