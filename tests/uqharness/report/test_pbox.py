"""P-boxes as charts: small whatever the number of samples, axes with units."""

from __future__ import annotations

import json

import numpy as np
import pytest

from uqharness.report.pbox import DrawnBox, metric_label, pbox_figure
from uqharness.statistics.pbox import Sample, pbox


def test_many_samples_make_no_large_page():
    draw = np.random.default_rng(1)
    samples = [Sample(f"s{k}", draw.gamma(4.0, size=200) * (1.0 + k / 2000.0)) for k in range(2000)]
    box = pbox(samples)
    words = {sample.epistemic_id: f"level of {sample.epistemic_id}" for sample in samples}
    figure = pbox_figure("many", "error", "m", [DrawnBox("", box, samples, words)], "caption")
    assert len(figure.svg) + len(json.dumps(figure.cursor)) < 150_000
    assert "96 of 2000 samples" in figure.svg
    (cursor,) = figure.cursor["boxes"]
    assert [cursor["corners"][k] for k in cursor["at_least"]] == [words[str(name)] for name in box.corner_lower]
    assert f'data-corner="0.{cursor["at_least"][0]}"' in figure.svg


@pytest.mark.parametrize(
    ("metric", "label"),
    [
        ("cross_track_median_m", "cross track median [m]"), ("speed_median_mps_measured", "speed median, measured [m/s]"),
        ("heading_median_deg", "heading median [deg]"), ("excursions_15m", "excursions_15m [-]"), ("oddity", "oddity [-]"),
    ],
)  # fmt: skip
def test_a_metric_names_its_unit(metric, label):
    assert metric_label(metric) == label
