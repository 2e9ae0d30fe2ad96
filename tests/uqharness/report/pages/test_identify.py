"""The page of an identification says what fit.json and histories.parquet say."""

from __future__ import annotations

import json

import pytest
from lxml import html

from tests.helpers import report_folders as folders
from tests.helpers.page_checks import page_of, words_of


@pytest.fixture
def identified(tmp_path):
    return folders.identified(tmp_path / "identified")


def test_identify_page(identified):
    page = page_of(identified)
    words = words_of(page)
    assert "2 of 3 parameters are identified; not identified: aero/Cn_p." in words
    assert "rms over noise is q 2.50" in words
    assert "&lt;no&gt; roll" in page
    assert "a&lt;b&gt;.parquet" in page
    # An unknown noise, a share without a value and a parameter that is not identified say so.
    assert "undefined" in words
    assert "not identified" in words
    row = [
        e.text_content().strip()
        for e in html.document_fromstring(page).xpath("//tr[th[contains(., 'V [m/s]')]]/td")
    ]
    assert row == ["0.5", "undefined", "undefined", "undefined", "undefined"]
    # 0.01 rad/s is 0.573 deg/s.
    assert "0.573" in words


def test_a_tick_stands_only_where_residuals_were_compared_with_the_noise(identified):
    fit = json.loads((identified / "fit.json").read_text())
    reference = {
        name: row for name, row in fit["parameters"].items() if row["status"] == "identified"
    }
    inside = {c: {**row, "rms": row["noise"]} for c, row in fit["fit"].items()}
    output_of(identified, parameters=reference, fit=inside)
    tree = html.document_fromstring(page_of(identified))
    ticked = [e.text_content().split()[1] for e in tree.xpath("//*[@class='good']")]
    # The sentence about the channels, and the channel.
    assert ticked == ["Every", "1.00"]


def output_of(folder, **changed):
    fit = json.loads((folder / "fit.json").read_text())
    (folder / "fit.json").write_text(json.dumps({**fit, **changed}))
    return words_of(page_of(folder))


def test_replays_without_the_gusts_do_not_judge_an_ordinary_flight(identified):
    assert "A model term is missing" in output_of(identified)
    assert "A model term is missing" not in output_of(identified, method="equation error")


def test_standard_errors_are_not_vouched_for_where_the_model_does_not_explain_the_flights(
    identified,
):
    fit = json.loads((identified / "fit.json").read_text())
    doubt = "Standard errors assume that the model form is correct"
    assert doubt in words_of(page_of(identified))
    inside = {c: {**row, "rms": row["noise"]} for c, row in fit["fit"].items()}
    assert doubt not in output_of(identified, fit=inside)
    # Gusts of a sample are in filter error's innovations: their size is no reproach, their colour
    # is.
    large = {
        c: {**row, "rms": 2.0, "noise": 1.0, "whiteness_p": 0.3, "predictable_share": 0.0}
        for c, row in fit["fit"].items()
    }
    result = output_of(identified, fit=large, method="filter error")
    assert doubt not in result
    assert "innovations are white" in result
    tinted = {c: {**row, "whiteness_p": 1e-9, "predictable_share": 0.4} for c, row in large.items()}
    result = output_of(identified, fit=tinted, method="filter error")
    assert doubt in result
    assert "q 40 %" in result
