"""Points, and errors in units of the last place against mpmath."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import mpmath as mp
import numpy as np

from uqharness.batch.ir import TRANSCENDENTAL, Builder, Function, evaluate
from uqharness.batch.maths import lower

Points = tuple[np.ndarray, ...]


def _signed(rng: np.random.Generator, count: int, low: float, high: float) -> np.ndarray:
    """Numbers of both signs whose size is 2^low to 2^high, evenly in the exponent."""
    return (
        np.ldexp(rng.uniform(1, 2, count), 0)
        * np.exp2(np.floor(rng.uniform(low, high, count)))
        * rng.choice([-1.0, 1.0], count)
    )


def _angles(rng: np.random.Generator, n: int) -> Points:
    close = np.round(rng.uniform(-6e5, 6e5, n // 4)) * (np.pi / 2)
    return (
        np.concatenate(
            [
                rng.uniform(-8, 8, n // 4),
                rng.uniform(-1e6, 1e6, n // 4),
                _signed(rng, n - 3 * (n // 4), -60, 19),
                close,
            ]
        ),
    )


def _ratios(rng: np.random.Generator, n: int) -> Points:
    return (
        np.concatenate(
            [
                rng.uniform(-1, 1, n // 2),
                1 - np.exp2(rng.uniform(-53, 0, n // 4)),
                _signed(rng, n - n // 2 - n // 4, -60, -1),
            ]
        ),
    )


def _positives(rng: np.random.Generator, n: int) -> Points:
    wide = np.abs(_signed(rng, n // 3, -1074, 1023))
    return (
        np.concatenate(
            [wide, rng.uniform(0.5, 2, n // 3), 1 + _signed(rng, n - 2 * (n // 3), -50, -3)]
        ),
    )


def _powers(rng: np.random.Generator, n: int) -> Points:
    half = n // 2
    x = np.concatenate([rng.uniform(0, 4, half), np.abs(_signed(rng, n - half, -1000, 1000))])
    y = np.concatenate(
        [
            rng.uniform(-30, 30, half),
            rng.uniform(-1, 1, n - half) * 700 / np.maximum(np.abs(np.log(x[half:])), 1e-3),
        ]
    )
    return x, y


POINTS: dict[str, Callable[[np.random.Generator, int], Points]] = {
    "sin": _angles,
    "cos": _angles,
    "tan": _angles,
    "asin": _ratios,
    "acos": _ratios,
    "atan": lambda r, n: (
        np.concatenate([_signed(r, n // 2, -60, 60), r.uniform(-4, 4, n - n // 2)]),
    ),
    "exp": lambda r, n: (
        np.concatenate([r.uniform(-745, 709.7, n // 2), _signed(r, n - n // 2, -60, 6)]),
    ),
    "log": _positives,
    "log2": _positives,
    "log10": _positives,
    "atan2": lambda r, n: (
        np.concatenate([_signed(r, n // 2, -900, 900), r.normal(size=n - n // 2)]),
        np.concatenate([_signed(r, n // 2, -900, 900), r.normal(size=n - n // 2)]),
    ),
    "pow": _powers,
    "fmod": lambda r, n: (_signed(r, n, -20, 20), _signed(r, n, -20, 20)),
}
"""The ranges in which each operation is measured."""


@cache
def lowered(operation: str, exponent: float | None = None) -> Function:
    """The operation alone, written out, of inputs x and y to output r."""
    b = Builder()
    arguments = [b.input(name) for name in ("x", "y")[: TRANSCENDENTAL[operation]]]
    if exponent is not None:
        arguments[1] = b.constant(exponent)
    return lower(b.finish({"r": b.op(operation, *arguments)}))


def values(operation: str, points: Points, exponent: float | None = None) -> np.ndarray:
    """Computed by numpy from the intermediate form."""
    return evaluate(lowered(operation, exponent), dict(zip("xy", points, strict=False)))[0]["r"]


def errors(operation: str, points: Points, result: np.ndarray) -> np.ndarray:
    """Errors in units of the last place of the exact result, NaN where the exact result is no
    double's neighbour.
    """
    exact = {
        "log2": lambda x: mp.log(x, 2),
        "pow": mp.power,
        "fmod": mp.fmod,
        "log10": lambda x: mp.log(x, 10),
    }.get(operation, getattr(mp, operation, None))
    assert exact is not None
    out = np.empty(len(result))
    with mp.workprec(140 if operation != "fmod" else 400):
        for k, (arguments, got) in enumerate(
            zip(zip(*(p.tolist() for p in points), strict=True), result.tolist(), strict=True)
        ):
            true = (
                abs(mp.fmod(*map(abs, arguments))) * (1 if arguments[0] > 0 else -1)
                if operation == "fmod"
                else exact(*arguments)
            )
            nearest = float(true)
            if np.isinf(nearest):
                out[k] = 0.0 if got == nearest else np.inf
            else:
                out[k] = abs(float((mp.mpf(got) - true) / float(np.spacing(abs(nearest)))))
    return out
