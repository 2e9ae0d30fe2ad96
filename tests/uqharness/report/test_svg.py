"""Charts: what is drawn lands where its axes put it, colours are told apart, files stand alone."""

from __future__ import annotations

import itertools
import math
import re
from importlib import resources

import numpy as np
import pytest
from lxml import etree

from uqharness.report.svg import Chart, Scale, log_scale, standalone, style, thin_line


def luminance(colour):
    parts = [int(colour[k : k + 2], 16) / 255.0 for k in (1, 3, 5)]
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in parts]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def contrast(a, b):
    """WCAG 2.2, relative luminance and contrast ratio."""
    high, low = sorted((luminance(a), luminance(b)), reverse=True)
    return (high + 0.05) / (low + 0.05)


def test_contrast_as_published():
    assert contrast("#000000", "#ffffff") == pytest.approx(21.0)
    assert contrast("#777777", "#ffffff") == pytest.approx(4.48, abs=0.01)


@pytest.mark.parametrize("scheme", [0, 1])
def test_text_and_lines_stand_out_in_both_schemes(scheme):
    page = (
        resources.files("uqharness.report")
        .joinpath("templates/page.css")
        .read_text(encoding="utf-8")
    )
    blocks = re.findall(r":root \{(.*?)\}", style() + page, re.S)
    assert len(blocks) == 2
    colours = dict(re.findall(r"--([\w-]+): (#\w{6})", blocks[scheme]))
    for text in ("ink", "soft", "good", "warn", "bad"):
        for ground in ("paper", "box"):
            assert contrast(colours[text], colours[ground]) >= 4.5, (text, ground)
    for level in ("good", "warn", "bad"):
        for text in (level, "ink"):
            assert contrast(colours[text], colours[f"{level}-paper"]) >= 4.5, (text, level)
    for line in ("first", "second", "third"):
        assert contrast(colours[line], colours["paper"]) >= 3.0, line


def test_lines_are_told_apart_without_colour():
    """Solid, dashed, dotted: no two of the series' classes have the same dash."""
    rules = re.findall(r"\.chart \.line\.(first|second|third) \{(.*?)\}", style())
    dashes = [re.findall(r"stroke-dasharray: ([\d .]+)", rule) for _, rule in rules]
    assert len(rules) == 3
    assert len({str(d) for d in dashes}) == 3


def test_a_point_lands_where_its_axes_put_it():
    chart = Chart("a", "label", Scale("x [m]", 0.0, 10.0), Scale("y [m]", -1.0, 1.0))
    remaining, top, width, height = chart.plot
    u, v = chart.at(5.0, 0.5)
    assert (float(u), float(v)) == pytest.approx((remaining + width / 2, top + height / 4))


def test_a_gap_in_the_data_is_a_gap_in_the_line():
    chart = Chart("a", "label", Scale("x [m]", 0.0, 4.0), Scale("y [m]", 0.0, 1.0))
    chart.line(np.arange(5.0), np.array([0.1, 0.2, math.nan, 0.3, 0.4]), "first")
    assert chart.marks[0].count("M") == 2
    chart.line(np.arange(2.0), np.array([math.nan, math.inf]), "first")
    assert len(chart.marks) == 1


def test_thinning_keeps_the_first_extremes_and_the_first_gap_of_each_bucket():
    rng = np.random.default_rng(0)
    y = rng.normal(size=5000).round(1)  # many equal values
    y[rng.integers(0, 5000, 300)] = math.nan
    y[1000:1100], y[3000] = math.nan, math.inf
    x, retained = np.arange(5000.0), []
    edges = np.linspace(0, 5000, 201).astype(int)
    for low, high in itertools.pairwise(edges):
        part = y[low:high].tolist()
        reference = [v for v in part if not math.isnan(v)]
        expected = [part.index(min(reference)), part.index(max(reference))] if reference else []
        gaps = [k for k, v in enumerate(part) if math.isnan(v)]
        retained += [low + k for k in {*expected, *gaps[:1]}]
    few, values = thin_line(x, y)
    np.testing.assert_array_equal(few, sorted(retained))
    np.testing.assert_array_equal(values, y[sorted(retained)])
    assert few.size < np.unique(np.concatenate([few, x[::40]])).size  # not every 40th


@pytest.mark.parametrize(
    ("low", "high"),
    [(0.0, 1.0), (-3e-5, 2e-5), (1000.0, 1003.0), (-0.5, 7.3), (1e-12, 3e-12), (2e6, 9e6)],
)
def test_ticks_are_round_inside_and_distinct(low, high):
    ticks = Scale("x [m]", low, high).ticks()
    assert 3 <= len(ticks) <= 8
    assert all(low - 1e-9 * (high - low) <= v <= high + 1e-9 * (high - low) for v, _ in ticks)
    assert len({text for _, text in ticks}) == len(ticks)
    for value, text in ticks:
        assert float(text.replace("−", "-")) == pytest.approx(value, abs=0.01 * (high - low))


def test_a_logarithmic_axis_has_decades_of_equal_length():
    axis = log_scale("frequency [rad/s]", [np.array([0.0, 0.1, 10.0, math.nan])], margin=0.0)
    assert (axis.low, axis.high) == pytest.approx((0.1, 10.0))
    assert [float(axis.place(w)) for w in (0.1, 1.0, 10.0)] == pytest.approx([0.0, 0.5, 1.0])
    assert math.isnan(float(axis.place(-1.0)))
    assert [words for _, words in axis.ticks()] == ["0.1", "0.2", "0.5", "1", "2", "5", "10"]
    assert len(log_scale("x [1]", [np.array([1e-6, 1e6])]).ticks()) > 5
    assert log_scale("x [1]", [np.zeros(2)]).ticks()


# Files.


def chart(name="a"):
    drawing = Chart(name, "label", Scale("x [m]", 0.0, 1.0), Scale("y [m]", 0.0, 1.0))
    drawing.line(np.array([0.0, 1.0]), np.array([0.0, 1.0]), "first", "words")
    return drawing.svg()


def test_a_file_stands_alone_in_light_colours_without_variables():
    text = standalone([(chart(), "A caption.")], "A title & more", [("fill1", "band")])
    root = etree.fromstring(text.encode())
    assert root.tag == "{http://www.w3.org/2000/svg}svg"
    assert not re.search(r"var\(|@media|https?://(?!www\.w3\.org/2000/svg)|--ink", text)
    words = [e.text for e in root.iter("{*}text")]
    assert {"A title & more", "A caption.", "band", "words", "x [m]", "y [m]"} <= set(words)
    # The page's own sheet does have what was looked for.
    assert "var(--ink)" in style()


def test_a_control_character_in_a_name_is_made_visible():
    text = standalone([(chart(), "a\x1b[31mb")], "\u202etitle")
    etree.fromstring(text.encode())
    assert "\x1b" not in text
    assert "\u202e" not in text
