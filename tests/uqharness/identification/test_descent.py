"""The time left of a descent whose steps become shorter by a constant factor, and of one whose
steps do not.
"""

from __future__ import annotations

import pytest

from uqharness.identification.identify import DescentProgress


def told(lengths, seconds=2.0, tolerance=0.05, most=40):
    now, said = [50.0], []
    descent = DescentProgress("output error", said.append, tolerance, most, clock=lambda: now[0])
    left = []
    for iteration, length in enumerate(lengths, 1):
        descent(iteration, length)
        left.append(descent.seconds_left(iteration))
        now[0] += seconds
    return said, left


def test_steps_that_shorten_by_a_factor_end_when_they_will():
    lengths = [0.05 * 2.0 ** (10 - k) for k in range(10)]
    said, left = told(lengths)
    assert left[:2] == [None, None]
    # Ten halvings in all, two seconds each.
    assert left[2:] == pytest.approx([2.0 * (10 - k) for k in range(2, 10)])
    assert said[0].startswith("output error: iteration 1, next step 51 standard errors")
    assert "iteration 5, next step 3.2 standard errors" in said[4]
    assert said[4].endswith("about 12 s left")


def test_steps_that_do_not_shorten_may_take_all_iterations():
    _, left = told([5.0] * 6)
    assert left[5] == pytest.approx(2.0 * (40 - 6))
    assert told([5.0, 4.0, 3.0, 0.01])[1][3] == pytest.approx(2.0)


def test_a_second_descent_counts_anew():
    now, said = [0.0], []
    descent = DescentProgress("filter error", said.append, 0.01, 60, clock=lambda: now[0])
    for iteration in (1, 2, 3, 1, 2):
        descent(iteration, float("inf") if iteration == 1 else 1.0)
        now[0] += 1.0
    assert descent.seconds_left(2) is None
    assert said[3] == "filter error: iteration 1"
