"""Parts of a page: what a terminal shows of them, figures as text, what is undefined."""

from __future__ import annotations

import math

import pytest

from uqharness.report.parts import (
    Bullets,
    Cell,
    Page,
    Section,
    Sentence,
    Table,
    Words,
    first_lines,
    format_value,
    percent,
    render,
)


def test_a_terminal_shows_the_verdict_and_what_is_key():
    key = Table(
        "Caption.", ("Name", "Value"), (("a", Cell("1.0", "good", "why")), ("bb", "20")), key=True
    )
    inner = Section("inner", (Bullets(("a note",), key=True),))
    other = (
        Words("words"),
        Table("Other.", ("x",), (("y",),)),
        Bullets(("left out",)),
        Table("Empty.", ("x",), (), key=True),
    )
    page = Page(
        "Title",
        "What?",
        (Sentence("So.", "good"), Sentence("But.", "warn")),
        (Section("s", (*other, key), (inner,)),),
    )
    assert first_lines(page) == [
        "So.",
        "But.",
        "",
        "Caption.",
        "Name      Value",
        "   a  1.0 (why)",
        "  bb         20",
        "",
        "a note",
    ]


def test_what_is_undefined_says_so():
    assert [format_value(v) for v in (None, math.nan, math.inf, 0.0, 1234.5)] == [
        "undefined",
        "undefined",
        "open",
        "0",
        "1.23e+03",
    ]
    assert (percent(None), percent(0.123, ".1f")) == ("undefined", "12.3")


@pytest.mark.parametrize("text", ["<b>", "&", "a\x1b[31mb"])
def test_a_page_shows_text_as_text(text):
    page = render(Page(text, text, (Sentence(text),)))
    assert "<b>" not in page.replace("<body>", "")
    assert "\x1b" not in page
