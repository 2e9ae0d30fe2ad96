"""The page of a comparison: judged by the channels that are to be judged."""

from __future__ import annotations

import re

import pytest

from tests.helpers import report_folders as folders
from tests.helpers.page_checks import page_of, words_of
from uqharness.report.write import write_report


@pytest.fixture
def compared(tmp_path):
    return folders.compared(tmp_path / "compared")


def test_a_comparison_ranks_by_judged_channels_only(compared):
    words = words_of(page_of(compared))
    assert "The model does not reach the noise floor: rms over noise is q 5.00." in words
    output = write_report(compared).text
    assert re.search(
        r"psi \[deg\] +1.15 +- +- +not tested: integral of other channels, drifts", output
    )
    assert "q_radps" not in output
    assert "Farthest in q" in words
    assert "Farthest in psi" not in words
