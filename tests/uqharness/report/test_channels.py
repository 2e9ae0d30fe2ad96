"""Channels over time: each in its unit and its group, shading where it belongs, flags in their
channel alone.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from lxml import etree

from uqharness.report.pages.flight import (
    Flag,
    Shade,
    channel_sections,
    shown_signal,
)

TIME = np.linspace(0.0, 100.0, 1001)


def draw(columns, shades=(), flags=None):
    sections = channel_sections({"time_s": TIME, **columns}, shades, flags or {}, ())
    return {s.title: {f.name: f for f in s.blocks[0].items} for s in sections}


def areas(figure, kind):
    """Left and right end of each area of that class, as shares of the axis."""
    svg = etree.fromstring(str(figure.svg))
    remaining, _, width, _ = map(float, svg.get("data-plot").split(","))
    result = [e.get("d") for e in svg.iter("path") if e.get("class") == f"band {kind}"]
    ends = []
    for d in result:
        u = [float(p.split(" ")[0]) for p in d.strip("MZ").split("L")]
        ends.append(((min(u) - remaining) / width, (max(u) - remaining) / width))
    return ends


@pytest.mark.parametrize(
    ("name", "quantity", "unit", "factor"),
    [
        ("q_radps", "q", "deg/s", 180.0 / math.pi),
        ("az_mps2", "az", "m/s²", 1.0),
        ("rpm", "rpm", "1/min", 1.0),
        ("cross_track_m", "cross track", "m", 1.0),
        ("thrust_N", "thrust", "N", 1.0),
        ("gear_norm", "gear_norm", "-", 1.0),
    ],
)
def test_shown_signal_units(name, quantity, unit, factor):
    assert shown_signal(name) == (quantity, unit, pytest.approx(factor))


def test_shading_stands_at_its_time_with_its_number_where_there_is_room():
    figure = draw(
        {"V_mps": TIME}, [Shade(20.0, 40.0, "fill1", "7"), Shade(50.0, 50.4, "fill1", "8")]
    )["Air data"]["channel-V_mps"]
    assert areas(figure, "fill1")[0] == pytest.approx((0.2, 0.4), abs=0.002)
    texts = [e.text for e in etree.fromstring(str(figure.svg)).iter("text")]
    assert "7" in texts
    assert "8" not in texts


def test_a_flag_is_in_its_own_channel_and_said_in_the_caption():
    result = draw(
        {"V_mps": TIME, "alpha_rad": TIME},
        flags={"V_mps": [Flag("error stuck", ((30.0, 60.0),)), Flag("estimate")]},
    )
    assert areas(result["Air data"]["channel-V_mps"], "fillbad") == [
        pytest.approx((0.3, 0.6), abs=0.002)
    ]
    assert "Findings: error stuck, estimate." in result["Air data"]["channel-V_mps"].caption
    assert areas(result["Air data"]["channel-alpha_rad"], "fillbad") == []
    assert "Findings" not in result["Air data"]["channel-alpha_rad"].caption


def test_what_stands_still_looks_so_and_what_is_nowhere_says_so():
    result = draw({"V_mps": 20.0 + 1e-9 * np.sin(TIME), "alpha_rad": np.full(1001, np.nan)})[
        "Air data"
    ]
    svg = etree.fromstring(str(result["channel-V_mps"].svg))
    path = next(e.get("d") for e in svg.iter("path") if e.get("class") == "line first thin")
    heights = {p.split(" ")[1] for p in path.lstrip("M").split("L")}
    assert len(heights) == 1
    assert "No finite value." in result["channel-alpha_rad"].caption
