"""First-order recursions against their closed form and against scipy's own filter."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from sysid.linalg import first_order


def test_a_step_rises_as_the_closed_form_says() -> None:
    k = np.arange(50)
    np.testing.assert_allclose(first_order(np.full(50, 0.2), 0.8), 1.0 - 0.8 ** (k + 1), rtol=1e-12)
    np.testing.assert_allclose(
        first_order(np.zeros(50), 0.8, 3.0), 3.0 * 0.8 ** (k + 1), rtol=1e-12
    )


@pytest.mark.parametrize("keep", [0.0, 0.3, 0.999, -0.5])
def test_noise_as_another_implementation_has_it(keep: float) -> None:
    x = np.random.default_rng(1).standard_normal(3000)
    given = x.copy()
    expected = lfilter([1.0], [1.0, -keep], x, zi=[keep * 2.0])[0]
    np.testing.assert_allclose(first_order(x, keep, 2.0), expected, rtol=1e-10, atol=1e-10)
    np.testing.assert_array_equal(x, given)


def test_one_value_and_what_is_no_number() -> None:
    assert first_order(np.array([2.0]), 0.5, 1.0).tolist() == [2.5]
    out = first_order(np.array([1.0, np.nan, 1.0]), 0.5)
    assert out[0] == 1.0
    assert np.isnan(out[1:]).all()
