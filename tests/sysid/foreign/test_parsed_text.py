"""TOML and JSON from anywhere: plain types, or one error with its line."""

from __future__ import annotations

import pytest

from sysid.foreign.regular_files import ParseError, parse_json, parse_toml

DEEP = 100_000


def test_what_is_sound_is_read() -> None:
    assert parse_toml("[a]\nb = [1, 2.5]\n") == {"a": {"b": [1, 2.5]}}
    assert parse_json(b'{"a": [1, null]}') == parse_json('{"a": [1, null]}') == {"a": [1, None]}


@pytest.mark.parametrize(
    ("text", "line", "word"),
    [
        ("a = 1\nb = = 2\n", 2, "TOML"),
        ("a = 1\nb = [", 2, "TOML"),
        (f"a = {'[' * DEEP}{']' * DEEP}", None, "deeply"),
        (f"a = {'9' * 5000}", None, "digits"),
        ("a = 2024-02-31", 1, "date"),
        ("a = 1\na = 2", 2, "TOML"),
    ],
)
def test_toml_that_is_none(text: str, line: int | None, word: str) -> None:
    with pytest.raises(ParseError, match=word) as found:
        parse_toml(text)
    assert found.value.line == line


@pytest.mark.parametrize(
    ("text", "line", "word"),
    [
        ('{"a": 1,\n "b" 2}', 2, "JSON"),
        ("", 1, "JSON"),
        (f"{'[' * DEEP}{']' * DEEP}", None, "deeply"),
        ("9" * 5000, None, "digits"),
        (b'{"a": "\xff"}', None, "UTF-8"),
    ],
)
def test_json_that_is_none(text: str | bytes, line: int | None, word: str) -> None:
    with pytest.raises(ParseError, match=word) as found:
        parse_json(text)
    assert found.value.line == line
