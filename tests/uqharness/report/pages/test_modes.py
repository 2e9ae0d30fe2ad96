"""The page of modes: what it says are the figures it is given, and a root stands where the axes put
it.
"""

from __future__ import annotations

import math
import re
from dataclasses import replace

import pytest
from lxml import html

from tests.helpers.page_checks import problems, words_of
from uqharness.flight import Assessment, Locus, LocusPoint
from uqharness.report.pages.modes import ModesFacts, modes_page
from uqharness.report.parts import render
from uqharness.simulator import Mode

ASKED = ModesFacts("toy", "B", "I", (("Altitude", "0 m"),), "uqharness modes toy --speed-mps 20")


def pair(name, real, imag):
    wn = math.hypot(real, imag)
    return Mode(name, real, imag, wn, -real / wn)


def point(V, short=(-4.0, 3.0), roll=-8.0, spiral=-0.01, level=1):
    modes = [
        pair("phugoid", -0.1, 0.4),
        pair("dutch_roll", -0.7, 3.0),
        pair("roll", roll, 0.0),
        pair("spiral", spiral, 0.0),
    ]
    combined = (
        [pair("short_period", *short)]
        if short[1]
        else [pair("short_period", short[0], 0.0), pair("short_period", -1.0, 0.0)]
    )
    levels = (
        Assessment("short_period", "damping", 0.8, "1", 1, "3.2.2.1.2"),
        Assessment("short_period", "CAP", 4.7, "1/(g s^2)", 2, "3.2.2.1.1"),
        Assessment("phugoid", "damping", 0.24, "1", 1, "3.2.1.2"),
        Assessment("dutch_roll", "damping", 0.23, "1", 1, "3.3.1.1"),
        Assessment("roll", "time constant", -1.0 / roll, "s", 1, "3.3.1.2"),
        Assessment(
            "spiral",
            "time to double",
            math.inf if spiral < 0 else math.log(2) / spiral,
            "s",
            level,
            "3.3.1.3",
        ),
    )
    return LocusPoint(V, (*combined, *modes), levels, 0.02 * V * V)


def page(request=20.0, points=(), refused=()):
    result = Locus(tuple(points) or tuple(point(V) for V in (16.0, 20.0, 24.0)), tuple(refused))
    local = next(p for p in result.points if p.V_mps == request)
    return render(modes_page(ASKED, local, result))


def test_the_page_is_sound_and_says_levels_and_speeds():
    text = page()
    assert problems(text) == []
    words = words_of(text)
    assert "At 20 m/s all modes reach Level 2 or better." in words
    assert "Short period: damping 0.8, Level 1; CAP 4.7 1/(g s^2), Level 2." in words
    assert "Trimmed at 3 speeds from 16 to 24 m/s." in words
    assert "Speeds without a trim" not in words


def test_a_mode_worse_than_level_3_is_said_first():
    points = [point(20.0, spiral=0.4, level=4)]
    words = words_of(page(points=points))
    assert "At 20 m/s a mode is worse than Level 3." in words
    assert "Spiral: time to double 1.73 s, worse than Level 3." in words


@pytest.mark.parametrize(("roll", "inside"), [(-8.0, True), (-0.2, False)])
def test_the_marker_lies_in_the_area_of_its_level(roll, inside):
    """Roll at Level 1: a root below -1/1.4 1/s, category B; the area's lower edge is the
    frame's.
    """
    points = [replace(point(V, roll=roll), V_mps=V) for V in (16.0, 20.0, 24.0)]
    svg = html.document_fromstring(page(points=points)).xpath("//figure[@id='locus-roll']/svg")[0]
    band = [
        float(v)
        for v in re.findall(
            r"[ML][-\d.]+ ([-\d.]+)", svg.xpath(".//path[contains(@class, 'fillgood')]/@d")[0]
        )
    ]
    disc = float(svg.xpath(".//g[contains(@clip-path, 'clip')]//circle/@cy")[0])
    assert (min(band) <= disc <= max(band)) is inside
