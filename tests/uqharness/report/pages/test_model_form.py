"""The pages of bounds and of their validation."""

from __future__ import annotations

import re

import numpy as np
import pytest
from lxml import html

from tests.helpers import report_folders as folders
from tests.helpers.model_forms import made_up_form, with_parts
from tests.helpers.page_checks import page_of, words_of


@pytest.fixture
def bounded(tmp_path):
    return folders.bounded(tmp_path / "bounds")


def test_bounds_from_the_form_alone(bounded):
    form = made_up_form()
    page = page_of(bounded)
    tree = html.document_fromstring(page)
    slices = {e.get("id") for e in tree.iter("figure")}
    assert slices == {f"slice-{c}-{s}" for c, b in form.coefficients.items() for s in b.states}
    assert form.aircraft.sha256 in page


def test_coverage_page(tmp_path):
    page = page_of(folders.covered(tmp_path / "check"))
    words = words_of(page)
    assert "The 95 % bounds do not hold: they contain only Cm 40.0 % of the samples." in words
    assert "97.0 ± 1.0" in words
    assert "40.0 ± undefined" in words
    # 0.8 bounds two pieces of a sine and a cosine: what lies outside is counted by hand.
    share = np.mean(np.abs(np.concatenate(folders.wave())) <= 0.8)
    assert f"{100 * share:.1f} % of the samples inside" in words
    assert "dots dotout" in page


def test_what_bounds_json_has_stands_on_the_page(bounded):
    row = {"mean_width": 0.02, "noise_width": 0.01, "left_out_share": 0.9}
    names = list(made_up_form().coefficients)
    trial = {"cutoff_hz": 3.0, "airspeed_cutoff_hz": None, "mean_width": dict.fromkeys(names, 0.03)}
    details = {"coefficients": dict.fromkeys(names, row), "cutoffs": [trial]}
    folders.write_document(bounded, "bounds.json", details)
    tree = html.document_fromstring(page_of(bounded))
    first, second = tree.xpath("//table[starts-with(caption, 'Mean width')]/tbody/tr")
    assert [e.text_content().strip() for e in first][:3] == ["6", "2", "0.02"]
    assert [e.text_content().strip() for e in second][:4] == ["3", "none", "0.03", "0.03"]
    states = [
        e.text_content().strip()
        for e in tree.xpath("//table[contains(caption, 'every state')]/tbody/tr/th")
    ]
    assert states[:2] == ["V [m/s]", "alpha [deg]"]


def test_bounds_say_where_there_is_model_error_and_where_none_was_found(bounded):
    words = words_of(page_of(bounded))
    assert "These intervals include sensor noise." in words
    form = with_parts(made_up_form(), missing={"Cm"})
    form.write(bounded / "model-form.json")
    words = words_of(page_of(bounded))
    sizes = re.search(
        r"Model error, at most \(95 %\): Cm ±\S+ \((\S+) times that of the sensor noise\)\.", words
    )
    assert sizes is not None
    assert float(sizes[1]) > 0.0
    assert "No model error found above CX ±" in words
    assert "One flight: variation from flight to flight is not estimable." in words
