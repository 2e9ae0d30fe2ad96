"""Sums, products and quotients in two doubles against fractions; what works on bits against
numpy.
"""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction

import numpy as np
import pytest

from tests.helpers.batch_against import same_bits
from uqharness.batch import maths as a
from uqharness.batch.ir import Builder, Value, evaluate

RNG = np.random.default_rng(6)
X = RNG.normal(size=400) * np.exp2(RNG.integers(-30, 30, 400))
Y = RNG.normal(size=400) * np.exp2(RNG.integers(-30, 30, 400))


def _made(
    make: Callable[[Value, Value], dict[str, Value]], x: np.ndarray = X, y: np.ndarray = Y
) -> dict[str, np.ndarray]:
    b = Builder()
    return evaluate(b.finish(make(b.input("x"), b.input("y"))), {"x": x, "y": y})[0]


def _two(two: a.DoubleDouble) -> dict[str, Value]:
    return {"high": two.high, "low": two.low}


def _error(made: dict[str, np.ndarray], exact: list[Fraction]) -> float:
    """The largest error over the exact size."""
    rows = zip(made["high"].tolist(), made["low"].tolist(), exact, strict=True)
    return max(float(abs(Fraction(h) + Fraction(low) - e) / abs(e)) for h, low, e in rows)


@pytest.mark.parametrize(
    ("make", "exact", "bound"),
    [
        (a.two_sum, lambda x, y: x + y, 0.0),
        (lambda x, y: a.quick_sum(x, y * 2.0**-80), lambda x, y: x + y / 2**80, 0.0),
        (a.two_product, lambda x, y: x * y, 2.0**-103),
        (
            lambda x, y: a.quotient(a.two_sum(x, y), a.two_product(x, y)),
            lambda x, y: (x + y) / (x * y),
            2.0**-98,
        ),
        (
            lambda x, y: a.product(a.two_sum(x, y), a.two_product(x, y)),
            lambda x, y: (x + y) * (x * y),
            2.0**-100,
        ),
    ],
)
def test_two_doubles_are_that_exact(
    make: Callable[[Value, Value], a.DoubleDouble],
    exact: Callable[[Fraction, Fraction], Fraction],
    bound: float,
) -> None:
    wanted = [exact(Fraction(x), Fraction(y)) for x, y in zip(X.tolist(), Y.tolist(), strict=True)]
    made = _made(lambda x, y: _two(make(x, y)))
    assert _error(made, wanted) <= bound
    # One double alone is not that exact.
    assert _error({"high": made["high"], "low": np.zeros(len(X))}, wanted) > 2.0**-60


def test_signs_and_whole_numbers() -> None:
    special = np.array([0.0, -0.0, 1.5, -1.5, 2.5, -2.5, 1e15, -1e15])
    made = _made(
        lambda x, y: {
            "signed": a.copysign(x.builder.op("abs", y), x),
            "flipped": a.flip_sign(y, a.sign_bit(x)),
            "cut": a.truncate(x),
            "near": a.round_to_even(x),
            "third": a.bit_set(a.to_integer(a.truncate(x)), 1).choose(1.0, 0.0),
            "power": a.power_of_two(a.to_integer(a.round_to_even(y))),
        },
        special,
        np.arange(-4.0, 4.0),
    )
    y = np.arange(-4.0, 4.0)
    assert same_bits(made["signed"], np.copysign(y, special)).all()
    assert same_bits(made["flipped"], np.where(np.signbit(special), -y, y)).all()
    assert (made["cut"] == np.trunc(special)).all()
    assert (made["near"] == np.rint(special)).all()
    assert made["third"].tolist() == [float((int(x) >> 1) & 1) for x in special]
    assert made["power"].tolist() == np.exp2(y).tolist()


def test_a_polynomial_is_its_sum() -> None:
    c = [0.5, -1.25, 2.0, 0.75, -3.0]
    x = np.linspace(-1, 1, 9)
    np.testing.assert_allclose(
        _made(lambda v, _: {"r": a.polynomial(v, c)}, x, x)["r"],
        np.polyval(c[::-1], x),
        rtol=0,
        atol=1e-15,
    )
