"""Texts written for corners name what was flown instead; drawings stay as they are."""

from __future__ import annotations

import pytest
from markupsafe import Markup

from uqharness.report.campaign import with_sample_noun
from uqharness.report.parts import Cell, Figure, Figures, Section, Table


@pytest.mark.parametrize(
    ("method", "noun"),
    [("corners", "corner"), ("levels", "combination"), ("walk", "walk"), ("lhs", "sample")],
)
def test_every_text_of_a_part_is_renamed(method, noun):
    figure = Figure("f", Markup("<svg>corner</svg>"), "Corner by corner")
    section = Section(
        "Worst corner", (Table("c", ("Corner",), ((Cell("a corner"),),)), Figures((figure,)))
    )
    found = with_sample_noun(section, method)
    table, figures = found.blocks
    assert found.title == f"Worst {noun}"
    assert table.head == (noun.capitalize(),)
    assert table.rows[0][0].text == f"a {noun}"
    assert figures.items[0].caption == f"{noun.capitalize()} by {noun}"
    assert figures.items[0].svg == figure.svg
    assert with_sample_noun("best corner", method) == f"best {noun}"
