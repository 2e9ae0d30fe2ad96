"""Commands of a segment between its rows."""

from __future__ import annotations

import numpy as np
import pytest

from uqharness.replay.segments import Commands, Segment


def with_commands(k):
    """Six rows, a command that steps between the third and the fourth."""
    fine = np.zeros((5 * k + 1, 1))
    fine[2 * k + 1 :] = 4.0
    return Segment(
        "m",
        "f",
        0.02 * np.arange(6),
        fine[::k],
        np.zeros(9),
        100.0,
        0.0,
        commands=Commands(k, fine, None),
    )


@pytest.mark.parametrize("k", [1, 2, 3])
def test_straight_lines_between_rows_have_the_area_of_what_is_known_at_each_command(k):
    result = with_commands(k)
    fine = np.zeros(5 * k + 1)
    fine[2 * k + k // 2] = 1.0
    rows = result.on_rows(fine)
    assert rows.shape == (6,)
    assert rows.sum() == pytest.approx(1.0 / k)
    np.testing.assert_allclose(result.on_rows(np.full(5 * k + 1, 3.0)), 3.0)
    # Values at the rows alone would have lost it.
    assert k == 1 or fine[::k].sum() == 0.0
