"""Charts of a convergence study: repeats and growth, whichever there are, under the file's name."""

from __future__ import annotations

import numpy as np
import pytest
from lxml import etree

from uqharness.campaign.conditions import Condition
from uqharness.campaign.convergence import MetricConvergence
from uqharness.report.pbox import convergence_section
from uqharness.statistics.pbox import Growth, Repeats

REPEATS = Repeats(
    2, 3, 0.3, 0.9, np.array([2.0, 3.0]), np.array([[1.0, 2.0, 3.0], [2.0, 3.0, np.inf]])
)
GROWTH = (
    Growth(1, 0.5, 0.2, 0.8, 0.5),
    Growth(2, 0.9, 0.6, 1.2, 0.3),
    Growth(4, 1.3, 1.3, 1.3, 0.2),
)


@pytest.mark.parametrize(
    ("repeats", "growth", "names"),
    [
        (REPEATS, GROWTH, ["repeats", "growth"]),
        (REPEATS, (), ["repeats"]),
        (None, GROWTH, ["growth"]),
    ],
)
def test_what_there_is_is_drawn(repeats, growth, names):
    item = MetricConvergence("cross_track_median_m", Condition(3.0, "light"), "0", repeats, growth)
    section = convergence_section(item)
    (figures,) = section.blocks
    assert figures.file == "convergence-cross-track-median-m-3mps-light"
    assert section.title.startswith("cross_track_median_m, 3 m/s")
    assert [figure.name.partition("-")[0] for figure in figures.items] == names
    for figure in figures.items:
        root = etree.fromstring(str(figure.svg))
        axes = [e.text for e in root.iter("text") if e.get("class") == "label"]
        assert any("[m]" in text for text in axes)
        lines = [e.get("d") for e in root.iter("path") if "first" in (e.get("class") or "")]
        assert lines
        assert not any("nan" in d or "inf" in d for d in lines)
    if repeats:
        # A flight that failed has no step: the second curve ends at two of three.
        drawn = [
            e
            for e in etree.fromstring(str(figures.items[0].svg)).iter("path")
            if e.get("class") == "line first thin"
        ]
        assert [e.get("d").count("V") for e in drawn] == [3, 2]
