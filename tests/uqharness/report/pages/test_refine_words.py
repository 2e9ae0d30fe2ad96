"""Sentences about effects: numbers with the figures that their standard error leaves them."""

from __future__ import annotations

import pytest

from uqharness.report.pages.refinement import hold_out_words
from uqharness.results.refinement import HoldOutTest


def run_command(test: dict, withdrawn: bool = False) -> str:
    return hold_out_words(HoldOutTest(**test), withdrawn)


@pytest.mark.parametrize(
    ("change", "std", "text"),
    [
        (64560.0, 479.9, "+64560 ± 480"),
        (12.345, 1.2345, "+12.35 ± 1.23"),
        (-30.0, 5.0, "-30.00 ± 5.00"),
        (123456.0, 98765.0, "+123500 ± 98800"),
        (0.01234, 0.00099, "+0.012340 ± 0.000990"),
        (4.0, 0.0, "+4 ± 0"),
    ],
)
def test_a_change_is_told_to_three_figures_of_its_standard_error(change, std, text):
    output = run_command({"gap": "shrank", "change_of_twice_log_likelihood": change, "std": std})
    assert output.startswith("confirmed")
    assert output.endswith(f"twice the log likelihood changes by {text}")


def test_a_change_of_replays_that_diverge_is_told_without_its_digits():
    test = {
        "gap": "shrank",
        "change_of_twice_log_likelihood": 4.6e24,
        "std": 2e13,
        "share_of_estimate": 1.0,
        "share_std": 1e-12,
    }
    assert "diverges without it, best value 1.00 ± 0.00" in run_command(test)
    grew = run_command({**test, "gap": "grew", "change_of_twice_log_likelihood": -4.6e24})
    assert "diverges with it" in grew
    assert "+999000000 ± 20000000" in run_command(
        {**test, "change_of_twice_log_likelihood": 9.99e8, "std": 2e7}
    )
