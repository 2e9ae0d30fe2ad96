"""The pages of bounds and of their validation."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from lxml import html

from sysid.model_form.components import STEP_S, Variation
from tests.helpers import report_folders as folders
from tests.helpers.model_forms import made_up_form, with_parts
from tests.helpers.page_checks import page_of, words_of
from uqharness.replay.histories import History
from uqharness.report.pages.model_form import coverage_page_of, slice_section, variation_section
from uqharness.report.parts import Page, render
from uqharness.results.identification import Coverage


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


def test_a_validation(tmp_path):
    page = page_of(folders.covered(tmp_path / "check"))
    words = words_of(page)
    assert "The 95 % bounds do not hold: they contain only Cm 40.0 % of the samples." in words
    assert "97.0 ± 1.0" in words
    assert "40.0 ± undefined" in words
    # 0.8 bounds two pieces of a sine and a cosine: what lies outside is counted by hand.
    share = np.mean(np.abs(np.concatenate(folders.wave())) <= 0.8)
    assert f"{100 * share:.1f} % of the samples inside" in words
    assert "dots dotout" in page


def pieces_of(bounds):
    """One piece of flight around the middle of the data."""
    time_s = np.arange(0.0, 2.0, 0.02)
    middle = dict(zip(bounds.states, bounds.hull.middle[:, 1], strict=True))
    return [
        History(
            0,
            "f",
            "m",
            time_s,
            {**{s: v + 0.0 * time_s for s, v in middle.items()}, "Cm": 0.01 * np.sin(time_s)},
        )
    ]


def test_what_bounds_json_has_stands_on_the_page(bounded):
    row = {"mean_width": 0.02, "noise_width": 0.01, "left_out_share": 0.9}
    names = list(made_up_form().coefficients)
    tried = {"cutoff_hz": 3.0, "airspeed_cutoff_hz": None, "mean_width": dict.fromkeys(names, 0.03)}
    details = {"coefficients": dict.fromkeys(names, row), "cutoffs": [tried]}
    folders.written(bounded, "bounds.json", details)
    tree = html.document_fromstring(page_of(bounded))
    first, second = tree.xpath("//table[starts-with(caption, 'Mean width')]/tbody/tr")
    assert [e.text_content().strip() for e in first][:3] == ["6", "2", "0.02"]
    assert [e.text_content().strip() for e in second][:4] == ["3", "none", "0.03", "0.03"]
    states = [
        e.text_content().strip()
        for e in tree.xpath("//table[contains(caption, 'every state')]/tbody/tr/th")
    ]
    assert states[:2] == ["V [m/s]", "alpha [deg]"]


def test_other_bounds_are_drawn_beside_a_slice():
    form = made_up_form()
    pieces = pieces_of(form.coefficients["Cm"])
    one = replace(form, coefficients={"Cm": form.coefficients["Cm"]})
    plain, beside = (
        slice_section(one, pieces, baseline=other)
        for other in (None, {"Cm": form.coefficients["CX"]})
    )
    for section, kinds in ((plain, 0), (beside, 2)):
        (figures,) = section.parts[0].blocks
        assert figures.file == "slices-Cm"
        assert figures.items[0].svg.count('class="line third"') == kinds
        assert any(words == "bounds of the usual states" for _, words in figures.legend) == bool(
            kinds
        )


def test_the_rate_of_variation_is_drawn_with_the_rates_over_other_steps():
    draw = 0.01 * np.random.default_rng(1).standard_normal(4000)
    found = Variation(draw, 0.0, 0.01, 0.01 / np.sqrt(STEP_S), {0.02: 0.07, 1.0: 0.3})
    short = Variation(np.zeros(0), np.nan, np.nan, np.nan, {})
    section = variation_section({"Cm": found, "CX": short})
    (figures,) = section.blocks
    assert figures.file == "variation"
    (figure,) = figures.items
    assert figure.caption == "Cm: 1.00 % in 0.02 s. Rate [%/√s]: 7 over 0.02 s, 30 over 1 s"


def coverage(document: dict) -> Page:
    return coverage_page_of(Coverage.model_validate(document))


def test_a_validation_tells_its_manoeuvres(tmp_path):
    row = {"0.95": 0.97, "0.68": 0.7}
    document = {
        "coverage": {"CX": row},
        "manoeuvres": {"roll": {"CX": {"0.95": 0.5, "0.68": None}}},
        "outside_data": {"CX": 0.25},
    }
    words = words_of(render(coverage(document)))
    assert "50 / undefined" in words
    assert "97.0 ± undefined" in words
    assert "25.0" in words
    assert "Hale" not in words
    assert (
        "The bounds hold: every coefficient's share of this flight agrees with the 95 % that its"
        " bounds state." in words
    )
    for said, sentence in (
        ("fails", "The 95 % bounds do not hold: they contain only CX 97.0 % of the samples."),
        (
            "inconclusive",
            "Inconclusive: the flight is too short to tell whether the bounds of CX hold.",
        ),
    ):
        assert sentence in words_of(render(coverage(document | {"verdicts": {"CX": said}})))


def test_a_validation_tells_speeds_incidences_and_manoeuvres():
    thirds = [
        {"state": "V_mps", "from": 18.0, "to": 21.0, "samples": 80, "share": {"CX": 0.9}},
        {
            "state": "alpha_rad",
            "from": 0.0,
            "to": np.pi / 180,
            "samples": 70,
            "share": {"CX": None},
        },
    ]
    document = {
        "coverage": {"CX": {"0.95": 0.97, "0.68": 0.7}},
        "by_speed": thirds[:1],
        "by_incidence": thirds[1:],
        "conformal": {"CX": {"factor": 1.25, "level": 0.9, "manoeuvres": 9}},
        "flight_variance": {"CX": None},
    }
    words = words_of(render(coverage(document)))
    for said in ("18 to 21 m/s", "0 to 1 deg", "1.25", "not estimable for CX: one flight"):
        assert said in words
    assert "not estimable" not in words_of(
        render(coverage(document | {"flight_variance": {"CX": 0.001}}))
    )


def test_bounds_say_where_there_is_model_error_and_where_none_was_found(bounded):
    words = words_of(page_of(bounded))
    assert "These intervals hold the sensors' noise besides the model's error." in words
    form = with_parts(made_up_form(), missing={"Cm"})
    form.write(bounded / "model-form.json")
    words = words_of(page_of(bounded))
    sizes = re.search(
        r"Model error, at most \(95 %\): Cm ±\S+ \((\S+) times that of the sensor noise\)\.", words
    )
    assert sizes is not None
    assert float(sizes[1]) > 0.0
    assert "No model error found above CX ±" in words
    assert "One flight: what changes from flight to flight is not estimable." in words
