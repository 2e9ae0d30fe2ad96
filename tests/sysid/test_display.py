"""Notebook views and terminal output with foreign text."""

from __future__ import annotations

import io
import json
import math
import sys
from xml.etree import ElementTree

import pytest

from sysid.display import (
    clean_streams,
    clean_terminal,
    cursor_stream,
    rows_table,
    view,
    visible,
)


def test_a_view_is_well_formed_and_escapes_what_logs_say():
    evil = "<script>alert(1)</script>"
    table = rows_table([{evil: evil, "estimate": 0.5}, {evil: "b", "estimate": math.nan}])
    displayed = view(evil, table, facts={evil: evil}, warnings=[evil])
    assert "<script" not in displayed
    tree = ElementTree.fromstring(displayed)
    assert [cell.text for cell in tree.iter("td")] == [evil, "0.5", "b", None]
    assert [item.text for item in tree.iter("li")] == [evil]
    # The same check sees a text that is not escaped.
    assert "<script" in view("a flight", evil)


# Nothing foreign steers the terminal.

HOSTILE = "\x1b]0;owned\x07 \x9b2J \u202egpj.exe \r\x7f \udc80 \x00\x08"


def test_what_a_terminal_acts_on_is_written_out() -> None:
    assert visible(HOSTILE) == r"\x1b]0;owned\x07 \u009b2J \u202egpj.exe \x0d\u007f \udc80 \x00\x08"


@pytest.mark.parametrize("name", ["stdout", "stderr"])
def test_both_streams_are_cleaned_for_the_block_and_only_once(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    plain = io.StringIO()
    monkeypatch.setattr(sys, name, plain)
    with clean_terminal():
        clean_streams()
        print("a\x1bb", file=getattr(sys, name))
        cursor_stream(getattr(sys, name)).write("\r\x1b[K")
    print("c\x1bd", file=getattr(sys, name))
    assert plain.getvalue() == "a\\x1bb\n\r\x1b[Kc\x1bd\n"


def test_json_stays_json(monkeypatch: pytest.MonkeyPatch) -> None:
    plain = io.StringIO()
    monkeypatch.setattr(sys, "stdout", plain)
    with clean_terminal():
        print(json.dumps({"name": HOSTILE}))
        print(json.dumps({"name": "\x7f\x9b\u202e"}, ensure_ascii=False))
    first, second = plain.getvalue().splitlines()
    assert json.loads(first)["name"] == HOSTILE
    assert json.loads(second)["name"] == "\x7f\x9b\u202e"
