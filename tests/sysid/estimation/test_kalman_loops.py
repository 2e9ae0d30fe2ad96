"""The loops compiled give what they give as Python, which the filter's own tests compare with the
textbook's.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from sysid.aerodynamics import NX
from sysid.estimation import kalman_loops as loops
from sysid.estimation.kalman import ColumnInputs, Gains, MeasuredSystem
from tests.helpers.linear_systems import system

RNG = np.random.default_rng(4)
ROWS = (0, 3, 5)


def plain(loop: Any, *arguments: Any) -> Any:
    return loop.py_func(*arguments)


def test_compiled_the_loops_are_what_they_say() -> None:
    steps = system(6, 1)
    z = steps.y_ref[:, ROWS] + RNG.standard_normal((6, 3))
    z[2, 1] = np.nan
    seen = MeasuredSystem.of(steps, z, ROWS)
    r, q, begin = 0.1 + RNG.random(3), np.where(np.arange(NX) < 2, 0.5, 0.0), RNG.random(NX)
    found = [
        call(seen, r, q, begin, True)
        for call in (loops.filter_gains, lambda *a: plain(loops.filter_gains, *a))
    ]
    for one, other in zip(*found, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-14)
    by = Gains(*found[0])
    names = ("a", "b")
    acting = ColumnInputs.of(
        names, {"a": (-1, RNG.standard_normal((6, 6)))}, {"b": np.ones((6, 3))}, 6, 3
    )
    outs = []
    for call in (loops.whiten_columns, lambda *a: plain(loops.whiten_columns, *a)):
        out, path = np.zeros((6, 3, 3)), np.zeros((6, NX))
        call(seen, by.gain, 1.0 / np.sqrt(by.variance), np.zeros((NX, 3)), acting, out, path)
        outs.append((out, path))
    for one, other in zip(*outs, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-14)
    assert np.abs(outs[0][0]).min(axis=(0, 1)).max() < np.abs(outs[0][0]).max()
    innovation = RNG.standard_normal((6, 3))
    ways = [
        call(seen, by, innovation, q)
        for call in (loops.backward, lambda *a: plain(loops.backward, *a))
    ]
    for one, other in zip(*ways, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-14)
    assert not ways[0][1][:, 2:].any()
