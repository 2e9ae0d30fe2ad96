"""Constants against mpmath: numbers in several parts, and the series that the fitted polynomials
stand for.
"""

from __future__ import annotations

import mpmath as mp
import pytest

from uqharness.batch import maths as c

mp.mp.prec = 300


@pytest.mark.parametrize(
    ("parts", "exact", "bits"),
    [
        (c.PI_PARTS, lambda: mp.pi, 100),
        (c.HALF_PI_PARTS, lambda: mp.pi / 2, 130),
        (c.LN2_PARTS, lambda: mp.log(2), 80),
        (c.LN2_THREE, lambda: mp.log(2), 110),
        (c.LOG2_E_PARTS, lambda: 1 / mp.log(2), 100),
        (c.LOG10_E_PARTS, lambda: 1 / mp.log(10), 100),
        (c.LOG10_2_PARTS, lambda: mp.log(2) / mp.log(10), 80),
        (c.TWO_THIRDS, lambda: mp.mpf(2) / 3, 100),
    ],
)
def test_parts_add_up(parts: tuple[float, ...], exact: object, bits: int) -> None:
    true = exact()  # type: ignore[operator]
    assert abs(mp.fsum(map(mp.mpf, parts)) - true) <= abs(true) * mp.mpf(2) ** -bits
    assert (
        abs(mp.fsum(map(mp.mpf, parts)) * (1 + mp.mpf(2) ** -45) - true)
        > abs(true) * mp.mpf(2) ** -bits
    )


@pytest.mark.parametrize(
    ("polynomial", "exact", "largest"),
    [
        (c.SIN, lambda r: (mp.sin(r) - r) / r**3, mp.pi / 4),
        (c.COS, lambda r: (mp.cos(r) - 1 + r * r / 2) / r**4, mp.pi / 4),
    ],
)
def test_polynomials_are_their_functions(
    polynomial: tuple[float, ...], exact: object, largest: mp.mpf
) -> None:
    for k in range(1, 41):
        r = largest * k / 40
        value = mp.fsum(mp.mpf(x) * r ** (2 * n) for n, x in enumerate(polynomial))
        assert abs(value - exact(r)) * r**3 <= mp.mpf(2) ** -56 * r  # type: ignore[operator]
        assert (
            abs(value * (1 + mp.mpf(2) ** -40) - exact(largest)) * largest**3
            > mp.mpf(2) ** -56 * largest
        )  # type: ignore[operator]
