"""The page of margins: of a loop in closed form, each mark where the formula has it."""

from __future__ import annotations

import math
import re

import numpy as np
from lxml import html

from tests.helpers.page_checks import problems, words_of
from uqharness.flight.margins import LoopMargins, margins_of
from uqharness.report.pages.margins import margins_page
from uqharness.report.parts import render

W = np.geomspace(0.05, 100.0, 300)


def loop(response, scatter=None, name="elevator"):
    invalid = np.zeros(W.size) if scatter is None else scatter
    return LoopMargins(
        name, margins_of(W[invalid < 0.1], response[invalid < 0.1]), W, response, invalid
    )


def integrator(k=4.0, delay=0.1):
    """L = k exp(-s delay)/s: crossover k, phase margin 90 deg - k delay, gain margin pi/(2 k
    delay).
    """
    return k * np.exp(-1j * W * delay) / (1j * W)


def page(*loops):
    return render(margins_page("toy", "loiter", loops, "uqharness margins toy"))


def figure(text, name):
    return html.document_fromstring(text).xpath(f"//figure[@id='{name}']/svg")[0]


def at(svg, kind):
    """Ends of a vertical or level line of that class in the drawing's units."""
    path = svg.xpath(f".//g[contains(@clip-path, 'clip')]/path[@class='line {kind}']/@d")[0]
    return [tuple(map(float, xy)) for xy in re.findall(r"[ML]([-\d.]+) ([-\d.]+)", path)]


def test_margins_are_said_as_the_formula_has_them():
    text = page(loop(integrator()))
    assert problems(text) == []
    words = words_of(text)
    gain, phase = 20.0 * math.log10(math.pi / 0.8), 90.0 - math.degrees(0.4)
    delay = 1000.0 * (0.5 * math.pi - 0.4) / 4.0
    assert f"gain margin up {gain:.1f} dB, down none in the measured band" in words
    assert f"phase margin {phase:.1f} deg; delay margin {delay:.0f} ms" in words


def test_the_delayed_curve_of_nichols_runs_through_the_critical_point():
    svg = figure(page(loop(integrator())), "nichols-elevator")
    crosses = svg.xpath(".//g[contains(@clip-path, 'clip')]/path[contains(@d, 'l8 8')]/@d")
    critical = [
        np.array(re.match(r"M([-\d.]+) ([-\d.]+)", cross).groups(), dtype=float) + 4.0
        for cross in crosses
    ]
    close = {
        k: min(math.dist(c, p) for c in critical for p in at(svg, k)) for k in ("first", "third")
    }
    assert close["third"] < 3.0 < close["first"]


def test_a_conditionally_stable_loop_shows_its_margin_downwards():
    s = 1j * W
    text = page(loop(20.0 * (s + 1.0) ** 2 / s**3))
    assert problems(text) == []
    assert f"down {20.0 * math.log10(40.0):.1f} dB" in words_of(text)
    assert (
        at(figure(text, "nichols-elevator"), "mark")[0][1]
        < at(figure(text, "nichols-elevator"), "mark")[1][1]
    )
