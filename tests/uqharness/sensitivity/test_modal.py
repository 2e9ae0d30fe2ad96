"""The dissertation's modal example: its trim and its modes against numpy."""

from __future__ import annotations

import numpy as np
import pytest

from uqharness.sensitivity.modal import (
    ALEATORY,
    NOMINAL,
    intervals,
    longitudinal_modes,
    modes_of,
    system_matrix,
)

VALUES = NOMINAL | {name: mean for name, (mean, _) in ALEATORY.items()}


def test_the_readings_differ_in_one_entry_alone():
    published, corrected = (
        system_matrix(r, VALUES).dense() for r in ("as_published", "as_corrected")
    )
    assert np.argwhere(published != corrected).tolist() == [[1, 0]]


@pytest.mark.parametrize(
    ("slow", "fast"),
    [((0.1, 0.5), (0.7, 6.0)), ((0.02, 0.3), (1.4, 4.0)), ((-0.05, 0.4), (0.5, 5.0))],
)
def test_modes_of_a_matrix_made_from_them(slow, fast):
    """A companion form of the two pairs, turned at random; 1.4 is a pair of two real roots."""
    coefficients = np.polymul(*([1.0, 2.0 * zeta * wn, wn**2] for zeta, wn in (slow, fast)))
    companion = np.diag(np.ones(3), -1)
    companion[0] = -coefficients[1:]
    turn = np.random.default_rng(0).standard_normal((4, 4))
    result = longitudinal_modes(turn @ companion @ np.linalg.inv(turn))
    assert result == pytest.approx((*slow, *fast), rel=1e-6)


def test_a_pair_with_one_unstable_root_has_no_frequency():
    zeta, wn, _, fast = longitudinal_modes(np.diag([0.1, -0.2, -3.0, -4.0]))
    assert np.isnan(zeta)
    assert np.isnan(wn)
    assert fast == pytest.approx(np.sqrt(12.0))


def test_a_pair_between_two_real_roots_is_neither_phugoid_nor_short_period():
    """Roots of a statically unstable aircraft: the pair must not be cut into both modes."""
    A = np.zeros((4, 4))
    A[0, 0], A[3, 3] = -21.6, 0.86
    A[1:3, 1:3] = [[-1.5, 1.2], [-1.2, -1.5]]
    assert np.isnan(longitudinal_modes(A)).all()
    values = VALUES | {"Cm_alpha": 0.4}
    matrix = system_matrix("as_corrected", values)
    roots = sorted(np.linalg.eigvals(matrix.dense()), key=abs)
    assert [root.imag != 0 for root in roots] == [False, True, True, False]
    assert np.isnan(np.array(modes_of(matrix))).all()


@pytest.mark.parametrize("reading", ["as_corrected", "as_published"])
def test_the_fast_way_to_the_modes_is_that_of_eigenvalues(reading):
    rng = np.random.default_rng(1)
    values = {
        name: np.append(rng.uniform(low, high, 200), NOMINAL[name])
        for name, (low, high) in intervals().items()
    }
    values |= {name: mean for name, (mean, _) in ALEATORY.items()}
    # A short period that is hardly there: the iteration does not settle, and eigenvalues are taken.
    values["Cm_alpha"][-1] = -1e-3
    matrix = system_matrix(reading, values)
    np.testing.assert_allclose(modes_of(matrix), longitudinal_modes(matrix.dense()), rtol=1e-8)
