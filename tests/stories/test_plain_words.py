"""Phrases that docs/style.md retires stand nowhere in the project's prose."""

from __future__ import annotations

import re

import pytest

from tests.helpers.places import ROOT
from tests.helpers.prose import Piece, newest_section, pieces, strings, without_code

STYLE = (ROOT / "docs" / "style.md").read_text(encoding="utf-8")


def retired(page: str) -> dict[str, str]:
    """Retired phrase -> what to write, from the page's table."""
    table = page.split("## Retired phrases", 1)[1]
    found = {}
    for phrases, term in re.findall(r'^\| (".*") \| (.+) \|$', table, re.M):
        found.update(dict.fromkeys(re.findall(r'"([^"]+)"', phrases), term))
    return found


def pattern(phrase: str) -> re.Pattern[str]:
    """The phrase as whole words, in either case, over line breaks."""
    words = r"\s+".join(re.escape(word) for word in phrase.split())
    begin = r"(?<![\w/-])" if phrase[0].isalnum() else r"(?<![\w\])])"
    end = r"(?![\w/-])" if phrase[-1].isalnum() else ""
    return re.compile(begin + words + end, re.I)


PATTERNS = {phrase: pattern(phrase) for phrase in retired(STYLE)}


def found_in(piece: Piece) -> list[str]:
    """Where a retired phrase stands, and what to write."""
    terms = retired(STYLE)
    return [
        f'{piece.where(match.start())}: "{phrase}" is retired; write: {terms[phrase]}'
        for phrase, wanted in PATTERNS.items()
        for match in wanted.finditer(piece.text)
    ]


def test_no_retired_phrase_stands_in_prose():
    every = list(pieces())
    assert len(every) > 3000
    found = [line for piece in every for line in found_in(piece)]
    assert found == [], "\n" + "\n".join(found)


def test_the_table_is_read_whole():
    rows = [line for line in STYLE.split("## Retired phrases", 1)[1].splitlines() if line.startswith("| ")][1:]
    assert len(rows) >= 20
    assert all(re.match(r'\| "[^"]+"(; "[^"]+")* \| [^|]+ \|$', row) for row in rows)
    assert len(PATTERNS) >= len(rows)


@pytest.mark.parametrize("phrase", PATTERNS)
def test_a_planted_phrase_is_found(phrase: str):
    assert found_in(Piece("page.md", 3, f"Words.\nHere {phrase}, it stands."))[0].startswith("page.md:4")
    assert found_in(Piece("page.md", 1, f"Words {phrase.replace(' ', chr(10)).capitalize()} end."))


def test_parts_of_words_code_and_indices_are_not_found():
    text = without_code("the hulled boat, `the hull`, surprised, ``noises``, shape[1], [text](the/hull.md), values()[1]")
    assert found_in(Piece("page.md", 1, text)) == []


def test_strings_of_a_module_are_read():
    source = 'def f(x):\n    """Edge of the hull."""\n    return f"one {x} rival", "hull", ("two "\n        "noises")\n'
    lines = [line for at, text in strings(source) for line in found_in(Piece("m.py", at, text))]
    assert sorted(line.split(" is")[0] for line in lines) == ['m.py:2: "the hull"', 'm.py:3: "noises"', 'm.py:3: "rival"']


def test_old_sections_of_the_changelog_are_left_alone():
    assert "hull" not in newest_section("# Changelog\n\n## 2\n\nnew\n\n## 1\n\nhull\n")
