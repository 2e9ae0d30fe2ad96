"""Names that are more than names: control characters, markup and formulas in what a page or a
figure shows.
"""

from __future__ import annotations

import re
from pathlib import Path
from xml.dom import minidom

import numpy as np

from uqharness.report.parts import Figure, Figures, Page, Section, render
from uqharness.report.svg import Chart, Scale
from uqharness.report.write import write_figures

NAME = "fl\x1b[31m<b>&$\\foo$\x07\u202e"
UNSEEN = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202e]")


def test_a_figure_with_such_a_name_is_a_drawing_like_others(tmp_path: Path) -> None:
    chart = Chart("a", NAME, Scale(NAME, 0.0, 1.0), Scale(NAME, 0.0, 1.0, ((0.5, NAME),)))
    chart.line(np.array([0.0, 1.0]), np.array([0.0, 1.0]), "first", NAME)
    figures = Figures((Figure("a", chart.svg(), NAME),), (("first", NAME),), file="a")
    (path,) = write_figures(tmp_path, [Section(NAME, (figures,))], NAME)
    text = path.read_text(encoding="utf-8")
    minidom.parseString(text)
    assert not UNSEEN.search(text)
    assert "<b>" not in text
    assert "fl\\x1b[31m&lt;b&gt;" in text


def test_a_page_shows_it_as_text() -> None:
    page = render(Page(title=NAME, question=NAME, verdict=()))
    assert not UNSEEN.search(page)
    assert "<b>" not in page.replace("<body>", "")
    assert "fl\\x1b[31m&lt;b&gt;" in page
