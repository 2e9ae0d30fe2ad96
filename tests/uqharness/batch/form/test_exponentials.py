"""What exponential, logarithms and power keep beside their errors (``test_maths``): order, whole
powers of two, inverses.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from uqharness.batch.ir import Builder, Value, evaluate
from uqharness.batch.maths import exp, log, log2, log10, power


def _values(function: Callable[..., Value], *columns: np.ndarray) -> np.ndarray:
    b = Builder()
    names = [str(k) for k in range(len(columns))]
    made = b.finish({"r": function(*(b.input(name) for name in names))})
    return evaluate(made, dict(zip(names, columns, strict=True)))[0]["r"]


def test_powers_of_two_are_whole() -> None:
    n = np.arange(-1074.0, 1024.0)
    assert (_values(log2, np.ldexp(1.0, n.astype(int))) == n).all()
    assert (_values(power, np.full(len(n), 2.0), n) == np.ldexp(1.0, n.astype(int))).all()


def test_decimal_powers_are_whole() -> None:
    n = np.arange(0.0, 23.0)
    assert (_values(log10, np.array([float(10 ** int(k)) for k in n])) == n).all()


def test_exp_undoes_log() -> None:
    x = np.exp2(np.random.default_rng(1).uniform(-500, 500, 2000))
    logs = _values(log, x)
    np.testing.assert_allclose(_values(exp, logs), x, rtol=4e-16 * np.abs(logs).max())
    assert np.abs(_values(exp, np.nextafter(logs, np.inf)) / x - 1).max() > 1e-14


def test_the_logarithm_grows_with_its_argument() -> None:
    x = np.sort(np.exp2(np.random.default_rng(2).uniform(-3, 3, 20_000)))
    for function in (log, log2, log10):
        assert (np.diff(_values(function, x)) >= 0).all()


def test_a_constant_exponent_costs_little() -> None:
    b = Builder()
    x = b.input("x")
    assert b.finish({"r": power(x, b.constant(2.0))}).counts() == {"input": 1, "mul": 1}
    assert sum(b.finish({"r": power(x, b.constant(1.7))}).counts().values()) > 100
