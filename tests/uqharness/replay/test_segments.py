"""A segment's step."""

from __future__ import annotations

import numpy as np
import pytest

from uqharness.replay.segments import Commands, Segment


@pytest.mark.parametrize("dt", [0.02, 0.04])
def test_the_step_is_the_mean_over_all_rows(dt):
    time = 1e5 + dt * np.arange(500) + 1e-4 * np.sin(np.arange(500) * np.pi / 4.0)
    made = Segment("m", "f", time, np.zeros((500, 4)), np.zeros(9), 100.0, 0.0)
    assert made.dt_s == pytest.approx(dt, rel=1e-4)
    assert made.dt_s != time[1] - time[0]


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


@pytest.mark.parametrize("k", [2, 3])
def test_a_piece_at_its_commands_has_a_row_for_each(k):
    made = with_commands(k)
    own = made.at_commands()
    assert (made.per_row, own.per_row) == (k, 1)
    assert own.dt_s == pytest.approx(made.command_s) == pytest.approx(0.02 / k)
    assert own.controls is made.commands.controls
    np.testing.assert_allclose(own.time_s[::k], made.time_s, atol=1e-15)
    assert made.at_commands().at_commands() is not made
    plain = Segment("m", "f", 0.02 * np.arange(6), np.zeros((6, 1)), np.zeros(9), 100.0, 0.0)
    assert plain.at_commands() is plain


@pytest.mark.parametrize("k", [1, 2, 3])
def test_straight_lines_between_rows_have_the_area_of_what_is_known_at_each_command(k):
    made = with_commands(k)
    fine = np.zeros(5 * k + 1)
    fine[2 * k + k // 2] = 1.0
    rows = made.on_rows(fine)
    assert rows.shape == (6,)
    assert rows.sum() == pytest.approx(1.0 / k)
    np.testing.assert_allclose(made.on_rows(np.full(5 * k + 1, 3.0)), 3.0)
    # Values at the rows alone would have lost it.
    assert k == 1 or fine[::k].sum() == 0.0


def test_the_kind_of_a_manoeuvre_is_its_label_without_the_speed():
    made = Segment(
        "roll doublet, 22 m/s", "f", 0.02 * np.arange(6), np.zeros((6, 1)), np.zeros(9), 100.0, 0.0
    )
    assert made.kind == "roll doublet"
