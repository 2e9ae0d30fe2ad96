"""The page of an identification says what fit.json and histories.parquet say."""

from __future__ import annotations

import pytest
from lxml import html

from tests.helpers import report_folders as folders
from tests.helpers.page_checks import page_of, words_of


@pytest.fixture
def identified(tmp_path):
    return folders.identified(tmp_path / "identified")


def test_an_identification(identified):
    page = page_of(identified)
    words = words_of(page)
    assert "2 of 3 parameters are identified; not identified: aero/Cn_p." in words
    assert "rms over noise is q 2.50" in words
    assert "&lt;no&gt; roll" in page
    assert "a&lt;b&gt;.parquet" in page
    # An unknown noise, a share without a value and a parameter that is not identified say so.
    assert "undefined" in words
    assert "not identified" in words
    row = [e.text_content().strip() for e in html.document_fromstring(page).xpath("//tr[th[contains(., 'V [m/s]')]]/td")]
    assert row == ["0.5", "undefined", "undefined", "undefined", "undefined"]
    # 0.01 rad/s is 0.573 deg/s.
    assert "0.573" in words


def test_a_channel_without_a_value_draws_nothing_and_says_so(identified):
    tree = html.document_fromstring(page_of(identified))
    figure = tree.get_element_by_id("fit-history-0-V_mps")
    assert "The log has no value of it here." in figure.find("svg").get("aria-label")
    assert not figure.xpath(".//path[contains(@class, 'dots')]")
