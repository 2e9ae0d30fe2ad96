"""Nothing foreign steers the terminal."""

from __future__ import annotations

import io
import json
import sys

import pytest

from sysid.display import clean_streams, clean_terminal, cursor_stream, visible

HOSTILE = "\x1b]0;owned\x07 \x9b2J \u202egpj.exe \r\x7f \udc80 \x00\x08"


def test_what_a_terminal_acts_on_is_written_out() -> None:
    assert visible(HOSTILE) == r"\x1b]0;owned\x07 \u009b2J \u202egpj.exe \x0d\u007f \udc80 \x00\x08"


def test_ordinary_text_is_untouched() -> None:
    text = "Höhe 3 µs\t±2 °\nπ — 飛行 🛩 e\u0301"
    assert visible(text) == text


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


def test_a_pipe_that_is_not_utf8_gets_what_it_can_hold(monkeypatch: pytest.MonkeyPatch) -> None:
    raw = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(raw, encoding="ascii"))
    with clean_terminal():
        print("Höhe \u2192 \udcff")
        sys.stdout.flush()
    assert raw.getvalue() == b"H\\xf6he \\u2192 \\udcff\n"


def test_json_stays_json(monkeypatch: pytest.MonkeyPatch) -> None:
    plain = io.StringIO()
    monkeypatch.setattr(sys, "stdout", plain)
    with clean_terminal():
        print(json.dumps({"name": HOSTILE}))
        print(json.dumps({"name": "\x7f\x9b\u202e"}, ensure_ascii=False))
    first, second = plain.getvalue().splitlines()
    assert json.loads(first)["name"] == HOSTILE
    assert json.loads(second)["name"] == "\x7f\x9b\u202e"
