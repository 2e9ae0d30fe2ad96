"""Vectors, matrices and quaternions against numpy."""

from __future__ import annotations

import numpy as np
import pytest

from uqharness.batch.ir import Builder, Value, evaluate
from uqharness.batch.models import vectors


def computed(function, *arguments):
    """The function of arrays, as an array."""
    b = Builder()
    inputs = {}

    def named(array, name):
        if np.ndim(array) == 0:
            inputs[name] = np.array([float(array)])
            return b.input(name)
        return tuple(named(part, f"{name}.{k}") for k, part in enumerate(array))

    made = function(*[named(argument, f"x{k}") for k, argument in enumerate(arguments)])
    flat: dict[str, Value] = {}

    def collect(part, name):
        if isinstance(part, Value | float):
            flat[name] = b.value(part)
            return name
        return [collect(one, f"{name}.{k}") for k, one in enumerate(part)]

    names = collect(made, "out")
    found, _ = evaluate(b.finish(flat), inputs)

    def filled(part):
        return float(found[part][0]) if isinstance(part, str) else [filled(one) for one in part]

    return np.array(filled(names))


RNG = np.random.default_rng(0)
A, B, C = (RNG.normal(size=3) for _ in range(3))
M, N = (RNG.normal(size=(3, 3)) for _ in range(2))
Q = RNG.normal(size=4)
Q /= np.linalg.norm(Q)


def test_sums_and_products():
    assert computed(vectors.plus, A, B) == pytest.approx(A + B)
    assert computed(vectors.minus, A, B) == pytest.approx(A - B)
    assert computed(vectors.times, A, 2.5) == pytest.approx(2.5 * A)
    assert computed(vectors.cross, A, B) == pytest.approx(np.cross(A, B))
    assert computed(vectors.dot, A, B) == pytest.approx(A @ B)


def test_matrices():
    assert computed(vectors.matvec, M, A) == pytest.approx(M @ A)
    assert computed(vectors.transpose, M) == pytest.approx(M.T)
    assert computed(vectors.matmul, M, N) == pytest.approx(M @ N)
    assert computed(vectors.inverse, M) == pytest.approx(np.linalg.inv(M))


def test_a_quaternions_matrix_and_rate():
    matrix = computed(vectors.rotation, Q)
    assert matrix @ matrix.T == pytest.approx(np.eye(3))
    assert np.linalg.det(matrix) == pytest.approx(1.0)
    # Rodrigues: the axis stays, and the trace is 1 + 2 cos of the angle.
    assert matrix @ Q[1:] == pytest.approx(Q[1:])
    assert np.trace(matrix) == pytest.approx(4.0 * Q[0] ** 2 - 1.0)
    step = 1e-6
    later = Q + step * computed(vectors.quaternion_rate, Q, A)
    # Components in axes that turn with A: dM/dt = -[A x] M.
    turned = -np.array([[0.0, -A[2], A[1]], [A[2], 0.0, -A[0]], [-A[1], A[0], 0.0]]) @ matrix
    assert (computed(vectors.rotation, later) - matrix) / step == pytest.approx(turned, abs=1e-5)


@pytest.mark.parametrize("size", [1.0, 1e-9, 3e-200, 1e50])
def test_direction(size):
    for angle in np.linspace(-3.1, 3.1, 41):
        found = computed(vectors.direction, size * np.cos(angle), size * np.sin(angle))
        assert found == pytest.approx([np.cos(angle), np.sin(angle)], rel=0.0, abs=4e-16)
        assert found != pytest.approx(
            [np.cos(angle + 1e-14), np.sin(angle + 1e-14)], rel=0.0, abs=4e-16
        )


def test_the_origin_has_no_direction():
    assert np.isnan(computed(vectors.direction, 0.0, 0.0)).all()
