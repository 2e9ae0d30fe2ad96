"""Compiled loops give what they give uncompiled, where their code can be kept and where it
cannot.
"""

from __future__ import annotations

import numba
import numpy as np
import pytest

from sysid.linalg import compiled


def total(values):
    found = 0.0
    for k in range(len(values)):
        found += values[k] ** 2
    return found


@pytest.mark.parametrize("writable", [True, False])
def test_a_compiled_loop_is_the_loop(monkeypatch: pytest.MonkeyPatch, writable: bool) -> None:
    plain = numba.njit

    def njit(cache: bool = False, nogil: bool = False, error_model: str = "python"):
        if cache and not writable:
            raise RuntimeError("cannot cache function: no locator available")
        return plain(nogil=nogil, error_model=error_model)

    monkeypatch.setattr(numba, "njit", njit)
    values = np.linspace(0.0, 1.0, 50)
    assert compiled(total)(values) == total(values)
