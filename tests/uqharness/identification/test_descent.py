"""The time left of a descent whose steps become shorter by a constant factor, and of one whose
steps do not.
"""

from __future__ import annotations

import pytest

from uqharness.identification.identify import DescentProgress


def messages_of(lengths, seconds=2.0, tolerance=0.05, maximum=40):
    current, output = [50.0], []
    descent = DescentProgress(
        "output error", output.append, tolerance, maximum, clock=lambda: current[0]
    )
    remaining = []
    for iteration, length in enumerate(lengths, 1):
        descent(iteration, length)
        remaining.append(descent.seconds_left(iteration))
        current[0] += seconds
    return output, remaining


def test_steps_that_shorten_by_a_factor_end_when_they_will():
    lengths = [0.05 * 2.0 ** (10 - k) for k in range(10)]
    output, remaining = messages_of(lengths)
    assert remaining[:2] == [None, None]
    # Ten halvings in all, two seconds each.
    assert remaining[2:] == pytest.approx([2.0 * (10 - k) for k in range(2, 10)])
    assert output[0].startswith("output error: iteration 1, next step 51 standard errors")
    assert "iteration 5, next step 3.2 standard errors" in output[4]
    assert output[4].endswith("about 12 s left")


def test_steps_that_do_not_shorten_may_take_all_iterations():
    _, remaining = messages_of([5.0] * 6)
    assert remaining[5] == pytest.approx(2.0 * (40 - 6))
    assert messages_of([5.0, 4.0, 3.0, 0.01])[1][3] == pytest.approx(2.0)


def test_a_second_descent_counts_anew():
    current, output = [0.0], []
    descent = DescentProgress("filter error", output.append, 0.01, 60, clock=lambda: current[0])
    for iteration in (1, 2, 3, 1, 2):
        descent(iteration, float("inf") if iteration == 1 else 1.0)
        current[0] += 1.0
    assert descent.seconds_left(2) is None
    assert output[3] == "filter error: iteration 1"
