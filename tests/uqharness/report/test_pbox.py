"""P-boxes as charts: small whatever the number of samples, axes with units."""

from __future__ import annotations

import json

import numpy as np
import pytest
from lxml import etree

from uqharness.report.pbox import (
    LabelledBox,
    pbox_figure,
    smooth_pbox,
    smoothing_error,
)
from uqharness.statistics.pbox import Sample, pbox


def test_many_samples_make_no_large_page():
    draw = np.random.default_rng(1)
    samples = [Sample(f"s{k}", draw.gamma(4.0, size=200) * (1.0 + k / 2000.0)) for k in range(2000)]
    box = pbox(samples)
    words = {sample.epistemic_id: f"level of {sample.epistemic_id}" for sample in samples}
    figure = pbox_figure("many", "error", "m", [LabelledBox("", box, samples, words)], "caption")
    assert len(figure.svg) + len(json.dumps(figure.cursor)) < 150_000
    assert "96 of 2000 samples" in figure.svg
    (cursor,) = figure.cursor["boxes"]
    assert [cursor["corners"][k] for k in cursor["at_least"]] == [
        words[str(name)] for name in box.corner_lower
    ]
    assert f'data-corner="0.{cursor["at_least"][0]}"' in figure.svg


def draw_sample(flights, factor=1.0, unknown=0):
    draw = np.random.default_rng(2)
    return [
        Sample(f"s{k}", factor * (1.0 + k / 40.0) * draw.gamma(9.0, 0.3, size=flights), unknown)
        for k in range(20)
    ]


def test_the_smooth_box_keeps_failed_flights_and_a_band_that_holds_the_steps():
    samples = draw_sample(40, unknown=10)
    box = pbox(samples)
    curve = smooth_pbox(samples, box, np.linspace(0.0, 30.0, 160))
    assert curve.lower[-1] == pytest.approx(0.8)
    assert curve.upper[0] == pytest.approx(0.2)
    assert 0.0 < smoothing_error(samples, curve) < 0.1
    places = np.searchsorted(box.value, curve.value, side="right") - 1
    reference = places >= 0
    assert np.all(curve.band_lower[reference] <= box.band_lower[places[reference]] + 1e-12)
    assert np.all(curve.band_upper[reference] >= box.band_upper[places[reference]] - 1e-12)


@pytest.mark.parametrize("names", [("",), ("after", "before")])
def test_smooth_curves_are_drawn_without_steps_and_say_how_far_they_are_from_them(names):
    boxes = []
    for name in names:
        samples = draw_sample(40, 1.5 if name == "before" else 1.0)
        boxes.append(LabelledBox(name, pbox(samples), samples, {}, smooth=True))
    figure = pbox_figure("smooth", "error", "m", boxes, "Caption.")
    (inside,) = [e for e in etree.fromstring(str(figure.svg)).iter("g") if e.get("clip-path")]
    assert not any("V" in path.get("d") for path in inside.iter("path"))
    assert "Caption. Curves are smoothed: within " in figure.caption
    for cursor in figure.cursor["boxes"]:
        assert np.all(np.diff(cursor["upper"]) >= 0.0)
        # Lines of the samples are there to be picked where a box is alone.
        assert bool(cursor["corners"]) == (len(names) == 1)
    assert ('data-corner="0.0"' in figure.svg) == (len(names) == 1)
    low, high = boxes[0].box.quantile(0.5)
    assert f"{low:.3g} to {high:.3g} m" in figure.svg
