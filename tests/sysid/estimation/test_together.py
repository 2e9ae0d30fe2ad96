"""Parameters that move different segments share a run, and give what each alone would."""

from __future__ import annotations

import numpy as np
import pytest

from sysid.estimation.output_error import (
    SafeSimulation,
    Shift,
    first_steps,
    forward_differences,
    group_shifts,
    rows_affected,
    sensitivities,
    simulate_shifts,
)

LENGTHS = (30, 40, 50)
EDGES = (0, 30, 70, 120)
THETA = np.array([0.7, 1.0, 2.0, 3.0, -0.5])
"""A rate that all segments share, a start for each, a bias of the last two."""


class Decays:
    """Three decays; counts how often it is simulated."""

    def __init__(
        self, of=lambda index: {1: (0,), 2: (1,), 3: (2,), 4: (1, 2)}.get(index), fails=None
    ):
        self.moved, self.fails, self.runs = of, fails, 0

    def __call__(self, theta):
        self.runs += 1
        if self.fails is not None and self.fails(theta):
            raise RuntimeError("no")
        parts = []
        for number, n in enumerate(LENGTHS):
            t = np.linspace(0.0, 2.0, n)
            y = theta[1 + number] * np.exp(-theta[0] * t) + (theta[4] if number else 0.0)
            parts.append(np.column_stack([y, y**2]))
        return parts


def differences(model, central):
    simulation = SafeSimulation(model, LENGTHS, 2)
    base = simulation(THETA)
    limits = (np.full(5, -np.inf), np.full(5, np.inf))
    step, spread = first_steps(THETA, *limits), np.ones(2)
    return sensitivities(
        simulation, THETA, base, step, range(5), limits, spread, central=central, map_fn=None
    )


@pytest.mark.parametrize("central", [False, True])
def test_derivatives_together_are_those_one_by_one(central):
    model, plain = Decays(), Decays(of=lambda index: None)
    together, alone = differences(model, central), differences(plain, central)
    np.testing.assert_allclose(
        together.sensitivity.dense(), alone.sensitivity.dense(), rtol=1e-9, atol=1e-12
    )
    np.testing.assert_allclose(together.step, alone.step, rtol=1e-9)
    # The starts take one run in place of three, the bias of two segments one of its own.
    assert together.runs < alone.runs
    assert (model.runs, plain.runs) == (together.runs + 1, alone.runs + 1)


def test_a_wrong_word_about_what_moves_is_seen_in_the_derivatives():
    """Negative control: a start that is said to move another segment loses its own."""
    wrong = differences(Decays(of=lambda index: (0,) if index in (1, 2) else None), False)
    assert (
        np.abs(wrong.sensitivity.dense() - differences(Decays(), False).sensitivity.dense()).max()
        > 0.5
    )


def test_one_that_fails_does_not_take_its_group_along():
    found = differences(Decays(fails=lambda theta: theta[2] != THETA[2]), False)
    assert found.effect.tolist() == [True, True, False, True, True]
    right = differences(Decays(), False).sensitivity.dense()
    np.testing.assert_allclose(
        np.delete(found.sensitivity.dense(), 2, axis=2),
        np.delete(right, 2, axis=2),
        rtol=1e-9,
        atol=1e-12,
    )


def test_groups_share_no_row():
    rows = [rows_affected(Decays(), index, EDGES) for index in range(5)]
    assert rows[0] == (slice(0, 120),)
    assert rows[4] == (slice(30, 70), slice(70, 120))
    groups = group_shifts([Shift(index, index, 0.1, rows[index]) for index in range(5)])
    assert [[shift.index for shift in group] for group in groups] == [[0], [1, 2, 3], [4]]
    assert rows_affected(lambda theta: theta, 1, EDGES) == (slice(0, 120),)


def test_each_answer_is_of_its_own_rows():
    simulation = SafeSimulation(Decays(), LENGTHS, 2)
    shifts = [
        Shift(index, index, 0.25, rows_affected(simulation.simulate, index, EDGES))
        for index in (1, 3)
    ]
    found = list(simulate_shifts(lambda points: map(simulation, points), THETA, shifts))
    assert [(shift.index, by) for shift, by, _ in found] == [(1, 0.25), (3, 0.25)]
    for shift, by, parts in found:
        moved = THETA.copy()
        moved[shift.index] += by
        np.testing.assert_array_equal(parts[0], simulation(moved)[shift.rows[0]])


def test_forward_differences_at_steps_given():
    found = forward_differences(Decays(), THETA, np.full(5, 1e-6), (LENGTHS, 2))
    assert found is not None
    np.testing.assert_allclose(
        found.dense(), differences(Decays(), True).sensitivity.dense(), atol=1e-4
    )
    assert [columns.tolist() for columns in found.columns] == [[0, 1], [0, 2, 4], [0, 3, 4]]
    assert (
        forward_differences(
            Decays(fails=lambda theta: theta[4] != THETA[4]), THETA, np.full(5, 1e-6), (LENGTHS, 2)
        )
        is None
    )
