"""The ground track: a circle is recognised from signed distances, one lap is cut out, each line has
its legend.
"""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from lxml import etree

from uqharness.report.ground_track import (
    circle_of,
    flight_track,
    ground_track,
    lap_of,
)

TIME = np.arange(0.0, 200.0, 0.2)


def lap(offset, period_s=40.0, radius=120.0):
    """A flight around (10, 130) that is ``away`` from the circle."""
    angle = 2.0 * np.pi * TIME / period_s
    r = radius + offset
    return {
        "time_s": TIME,
        "north_m": 10.0 + r * np.cos(angle),
        "east_m": 130.0 + r * np.sin(angle),
        "distance_m": offset,
    }


AWAY = 3.0 * np.sin(0.7 * TIME) + 20.0 * np.exp(-(((TIME - 120.0) / 4.0) ** 2))


def table(**tracks):
    rows = [
        pd.DataFrame(
            columns | {"when": key.split("_")[0], "model": key.split("_")[1].replace("-", " ")}
        )
        for key, columns in tracks.items()
    ]
    return pd.concat(rows, ignore_index=True)


def pair():
    return table(
        **{
            "before_nominal": lap(0.5 * AWAY),
            "before_worst-corner": lap(AWAY),
            "after_nominal": lap(0.4 * AWAY),
            "after_worst-corner": lap(0.9 * AWAY),
        }
    )


def test_the_circle_is_found_from_where_the_distances_are_zero():
    flight = lap(AWAY)
    result = circle_of(flight["north_m"], flight["east_m"], flight["distance_m"])
    assert (result.north_m, result.east_m, result.radius_m) == pytest.approx(
        (10.0, 130.0, 120.0), abs=1e-6
    )


LINES = {"nominal, before", "worst corner, before", "nominal, after", "worst corner, after"}


def words_in(figure):
    return {e.text for e in etree.fromstring(str(figure.svg)).iter("text")}


def lines_in(figure):
    """Classes of the lines inside the axes, in the order in which they are drawn."""
    (inside,) = [e for e in etree.fromstring(str(figure.svg)).iter("g") if e.get("clip-path")]
    return [
        e.get("class").removeprefix("line ")
        for e in inside.iter("path")
        if e.get("class", "").startswith("line")
    ]


def test_the_track_has_a_line_and_a_legend_for_every_flight():
    figure = ground_track("track", lap_of(pair()), 15.0, "12 m/s wind")
    assert {"commanded path", "15 m from it"} | LINES <= words_in(figure)
    # The path and two limits, worst corners below, and the dashed lines of before above those of
    # after.
    assert lines_in(figure) == [
        "third",
        "limit",
        "limit",
        "first",
        "second",
        "first thin",
        "second thin",
    ]
    largest = 0.9 * np.abs(AWAY).max()
    assert f"{largest:.3g} m (worst corner, after)" in figure.svg


def test_the_lap_is_the_one_in_which_the_flights_are_farthest_apart():
    """Both flights go out by 20 m at 120 s, and differ by 3 m at 60 s."""
    other = AWAY + 3.0 * np.exp(-(((TIME - 60.0) / 4.0) ** 2))
    result = lap_of(table(**{"before_nominal": lap(AWAY), "before_worst-corner": lap(other)}))
    assert (result.at_s, result.apart_m) == (
        pytest.approx(60.0, abs=0.2),
        pytest.approx(3.0, abs=0.01),
    )
    # The course turns a little faster or slower than the circle where the distance changes.
    assert result.end_s - result.begin_s == pytest.approx(40.0, abs=2.0)
    assert result.begin_s < 60.0 < result.end_s
    assert result.largest_m == pytest.approx(np.abs(other).max())
    assert "in which the lines are 3 m apart" in ground_track("track", result, 15.0, "calm").caption
    same = lap_of(table(**{"before_nominal": lap(AWAY), "before_worst-corner": lap(AWAY)}))
    assert same.at_s == pytest.approx(TIME[np.abs(AWAY).argmax()])
    assert (
        "in which the worst corner is farthest from its path"
        in ground_track("track", same, 15.0, "calm").caption
    )


def columns_of(flight, sign=1.0):
    return {
        "time_s": TIME,
        "north_m": flight["north_m"],
        "east_m": flight["east_m"],
        "cross_track_m": sign * flight["distance_m"],
    }


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_recorded_flight_has_its_track_and_the_commanded_circle(sign):
    figure = flight_track("track", columns_of(lap(AWAY), sign))
    words = {e.text for e in etree.fromstring(str(figure.svg)).iter("text")}
    assert {"flown", "start", "end", "commanded circle, radius 120 m"} <= words
