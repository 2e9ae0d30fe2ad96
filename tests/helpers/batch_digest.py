"""A digest of all transcendental functions at points that need no C library: ``python -m
tests.helpers.batch_digest`` prints it.
"""

from __future__ import annotations

import hashlib

import numpy as np

from uqharness.batch.ir import TRANSCENDENTAL, Builder, Function
from uqharness.batch.maths import lower


def function() -> Function:
    """All of them, of inputs x and y."""
    b = Builder()
    x, y = b.input("x"), b.input("y")
    return lower(
        b.finish({name: b.op(name, *(x, y)[:count]) for name, count in TRANSCENDENTAL.items()})
    )


def points() -> dict[str, np.ndarray]:
    """Numbers of many sizes, by multiplication alone."""
    rng = np.random.default_rng(2024)
    u = rng.random((8, 4000)) * 2 - 1
    wide = u[0] * u[1] * u[2] * 8.0
    return {
        "x": np.concatenate([u[3], wide, u[4] * 700.0, u[5] * 1e6]),
        "y": np.concatenate([u[6], u[7] * 30.0, u[0] * 3.0, u[1]]),
    }


def digest(outputs: dict[str, np.ndarray]) -> str:
    """SHA-256 of the results, every NaN made the same."""
    sha = hashlib.sha256()
    for name in sorted(outputs):
        sha.update(np.where(np.isnan(outputs[name]), np.nan, outputs[name]).astype("<f8").tobytes())
    return sha.hexdigest()


if __name__ == "__main__":
    from uqharness.batch.ir import evaluate

    print(digest(evaluate(function(), points())[0]))
