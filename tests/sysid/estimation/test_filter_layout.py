"""Order of filter error's unknowns: what is packed comes back, each entry under its name and within
its bounds.
"""

from __future__ import annotations

import numpy as np
import pytest

from sysid.estimation.filter_error import Layout

THETA = np.array([1.0, 2.0, 3.0])
Q, R = np.array([0.0, 0.5, 0.0, 0.25]), np.array([0.1, 10.0])
X0 = np.arange(8.0).reshape(4, 2)


def layout(with_x0: bool) -> Layout:
    return Layout(
        THETA, np.array([0, 2]), np.array([1, 3]), outputs=2, states=4, segments=2, with_x0=with_x0
    )


@pytest.mark.parametrize("with_x0", [False, True])
def test_what_is_packed_comes_back(with_x0):
    order = layout(with_x0)
    free = np.array([7.0, 99.0, 8.0])
    vector = order.pack(free, Q, R, X0)
    theta, q, r, x0 = order.unpack(vector, np.full((4, 2), -1.0))
    # What is held keeps the value it was given, whatever is packed.
    assert theta.tolist() == [7.0, 2.0, 8.0]
    assert q.tolist() == Q.tolist()
    assert r == pytest.approx(R)
    assert x0.tolist() == (X0.tolist() if with_x0 else [[-1.0] * 2] * 4)


def test_places_and_names_agree():
    order = layout(True)
    vector, names = order.pack(THETA, Q, R, X0), order.names(("a", "b", "c"))
    assert len(names) == vector.size == 14
    assert names[:2] == ["a", "c"]
    assert names[order.process] == ["Q of state 1", "Q of state 3"]
    assert vector[order.process].tolist() == [0.5, 0.25]
    assert names[order.logs] == ["ln r of output 0", "ln r of output 1"]
    assert vector[order.logs] == pytest.approx(np.log(R))
    assert vector[names.index("x0[3] of segment 1")] == X0[3, 1]
    assert vector[names.index("x0[1] of segment 0")] == X0[1, 0]


def test_bounds_hold_the_start_and_no_variance_below_zero():
    order = layout(True)
    lower, upper = np.array([0.0, -9.0, 2.5]), np.array([5.0, 9.0, 3.5])
    low, high = order.limits(lower, upper, np.ones(4), np.array([0.2, 20.0]))
    vector = order.pack(THETA, Q, R, X0)
    assert (low < high).all()
    assert ((low <= vector) & (vector <= high)).all()
    assert low[:2].tolist() == [0.0, 2.5]
    assert low[order.process].tolist() == [0.0, 0.0]
    assert np.isinf(high[order.logs.stop :]).all()
    # Noise of a hundred times the output's spread lies outside.
    loud = order.pack(THETA, Q, 100.0 * R, X0)
    assert (loud > high).any()
