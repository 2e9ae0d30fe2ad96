"""Names that are more than names: control characters, markup and formulas in what a page or a figure shows."""

from __future__ import annotations

import re
from pathlib import Path
from xml.dom import minidom

from matplotlib.figure import Figure

from uqharness.report.parts import Page, render
from uqharness.report.plots.files import save

NAME = "fl\x1b[31m<b>&$\\foo$\x07\u202e"
UNSEEN = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202e]")


def test_a_figure_with_such_a_name_is_a_drawing_like_others(tmp_path: Path) -> None:
    figure = Figure()
    axes = figure.subplots()
    axes.set_title(NAME)
    axes.set_yscale("log")
    axes.plot([1, 2], [1, 1000], label=NAME)
    axes.legend()
    save(figure, tmp_path / "a.svg")
    text = (tmp_path / "a.svg").read_text(encoding="utf-8")
    minidom.parseString(text)
    assert not UNSEEN.search(text)
    # Powers of ten on the axis are formulas still.
    assert any("10^" in label.get_text() and label.get_parse_math() for label in axes.get_yticklabels())
    assert not axes.title.get_parse_math()


def test_a_page_shows_it_as_text() -> None:
    page = render(Page(title=NAME, asked=NAME, verdict=()))
    assert not UNSEEN.search(page)
    assert "<b>" not in page.replace("<body>", "")
    assert "fl\\x1b[31m&lt;b&gt;" in page
