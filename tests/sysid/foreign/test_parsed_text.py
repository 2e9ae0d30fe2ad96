"""TOML and JSON from anywhere: plain types, or one error with its line."""

from __future__ import annotations

import pytest

from sysid.errors import MOST_CHARACTERS, MOST_LINES, LogError, shortened
from sysid.foreign.parsed_text import ParseError, parse_json, parse_toml

DEEP = 100_000


def test_what_is_sound_is_read() -> None:
    assert parse_toml("[a]\nb = [1, 2.5]\n") == {"a": {"b": [1, 2.5]}}
    assert parse_json(b'{"a": [1, null]}') == parse_json('{"a": [1, null]}') == {"a": [1, None]}


@pytest.mark.parametrize(
    ("text", "line", "word"),
    [
        ("a = 1\nb = = 2\n", 2, "TOML"), ("a = 1\nb = [", 2, "TOML"), (f"a = {'[' * DEEP}{']' * DEEP}", None, "deeply"),
        (f"a = {'9' * 5000}", None, "digits"), ("a = 2024-02-31", 1, "date"), ("a = 1\na = 2", 2, "TOML"),
    ],
)  # fmt: skip
def test_toml_that_is_none(text: str, line: int | None, word: str) -> None:
    with pytest.raises(ParseError, match=word) as found:
        parse_toml(text)
    assert found.value.line == line


@pytest.mark.parametrize(
    ("text", "line", "word"),
    [
        ('{"a": 1,\n "b" 2}', 2, "JSON"), ("", 1, "JSON"), (f"{'[' * DEEP}{']' * DEEP}", None, "deeply"),
        ("9" * 5000, None, "digits"), (b'{"a": "\xff"}', None, "UTF-8"),
    ],
)  # fmt: skip
def test_json_that_is_none(text: str | bytes, line: int | None, word: str) -> None:
    with pytest.raises(ParseError, match=word) as found:
        parse_json(text)
    assert found.value.line == line


def test_an_error_is_one_line_of_a_length_to_be_read() -> None:
    assert shortened("short\n" + "x" * MOST_CHARACTERS) == "short\n" + "x" * MOST_CHARACTERS
    long = shortened("begin" + "x" * 10**6 + "end")
    assert len(long) <= MOST_CHARACTERS
    assert long.startswith("beginx")
    assert long.endswith("xend")
    assert shortened(long) == long
    many = shortened("\n".join(f"a.toml:{k}: wrong and not what it should be" for k in range(500)))
    assert many.splitlines()[-1] == f"and {500 - MOST_LINES + 1} more"
    assert len(many.splitlines()) == MOST_LINES
    assert shortened(many) == many
    assert str(LogError("unknown signal 'a\nb'", "m.toml", "line 3")) == "m.toml: line 3: unknown signal 'a b'"
