"""The warning on coloured residuals: when it is given, what it suspects, and that it is short."""

from __future__ import annotations

import numpy as np
import pytest

from sysid.estimation.coloured_residuals import Colour, colour_warnings

MOST_WORDS = 60


def found(predictable=0.4, explained=np.nan, p_value=1e-30, outputs=6):
    """A colour alike in all outputs."""
    return Colour(*(np.full(outputs, value) for value in (p_value, predictable, 0.9, explained)))


@pytest.mark.parametrize("method", ["output error", "filter error"])
@pytest.mark.parametrize(
    ("explained", "first"),
    [
        (0.9, "suspect the model's form before"),
        (0.1, "suspect process noise (turbulence) before"),
        (np.nan, "turbulence) or the model"),
    ],
)
def test_the_cause_first_and_few_words(method, explained, first):
    (text,) = colour_warnings(found(explained=explained), np.full(3, 3.2), np.ones(3), method)
    assert text.startswith("coloured residuals: ")
    assert first in text
    assert "3.2 times the Cramer-Rao bounds" in text
    assert text.endswith("(docs/estimators.md, Coloured residuals).")
    assert len(text.split()) <= MOST_WORDS


@pytest.mark.parametrize(
    ("colour", "std"),
    [
        (found(p_value=0.5), 3.2),  # white
        (found(predictable=0.05), 1.1),  # too little colour to matter
        (found(), np.nan),  # no parameter identified
    ],
)
def test_no_warning(colour, std):
    assert colour_warnings(colour, np.full(3, std), np.ones(3), "output error") == []


def test_turbulence_that_another_test_ruled_out_is_not_suspected():
    for explained in (0.9, 0.1, np.nan):
        (text,) = colour_warnings(
            found(explained=explained), np.full(3, 3.2), np.ones(3), "output error", calm_air=True
        )
        assert "turbulence" not in text
        assert "filter error" not in text
        assert "the model's form" in text
