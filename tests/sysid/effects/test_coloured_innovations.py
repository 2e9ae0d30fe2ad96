"""The colour of a filter's innovations, alone and with a model that may lack an effect."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sysid.aerodynamics import NX
from sysid.aerodynamics.rigid_body import OUTPUTS
from sysid.effects.coloured_innovations import innovation_colour, past_rows
from sysid.effects.information import fit_colour, likeliest_colour, normal_equations, score_tests
from sysid.effects.prediction import Columns, LazyColumns, filter_segments, iterate_whitened
from tests.helpers.linear_systems import system
from tests.helpers.whitened import whitened


def coloured_series(rng, n):
    """(n, 2) innovations of a filter whose air is another: the second follows the first."""
    w = rng.standard_normal((n, 2))
    e = w.copy()
    for k in range(1, n):
        e[k] += np.array([[0.4, 0.0], [0.5, 0.2]]) @ e[k - 1]
    return e, w


def test_the_colour_of_innovations_is_estimated_and_taken_out():
    e, w = coloured_series(np.random.default_rng(5), 6000)
    series = [e[:2000], e[2000:]]
    series[1][7, 0] = np.nan
    colour = innovation_colour(series)
    assert colour is not None
    np.testing.assert_allclose(colour.coefficients[0], [[0.4, 0.0], [0.5, 0.2]], atol=0.05)
    np.testing.assert_allclose(colour(series[0])[1:], w[1:2000], atol=0.3)
    columns = np.stack([series[0], 2.0 * series[0]], axis=2)
    np.testing.assert_allclose(colour(columns)[:, :, 1], 2.0 * colour(series[0]), rtol=1e-9)
    # The likelihood of the coloured series is that of the white one.
    cost = np.sum(colour(series[0]) ** 2) + 2.0 * 2000 * colour.logdet
    assert cost == pytest.approx(np.sum(w[:2000] ** 2), rel=0.01)


def test_white_innovations_have_no_colour():
    rng = np.random.default_rng(6)
    assert sum(innovation_colour([rng.standard_normal((900, 8))]) is None for _ in range(5)) > 3


def test_a_column_that_follows_the_air_is_no_effect_once_the_colour_is_out():
    """What a sensor of the first innovation does to the second: gusts move both."""
    t = {"plain": [], "white": []}
    for seed in range(20):
        e, _ = coloured_series(np.random.default_rng(seed), 1500)
        c = np.column_stack([np.zeros(1500), np.concatenate([[0.0], e[:-1, 0]])])
        colour = innovation_colour([e])
        assert colour is not None
        for name, (x, r) in {"plain": (c, e), "white": (colour(c), colour(e))}.items():
            t[name].append(np.sum(x * r) / np.linalg.norm(x))
    assert np.min(t["plain"]) > 10.0
    assert np.abs(t["white"]).max() < 3.0


@pytest.mark.parametrize("size", [0.6, 0.0])
def test_the_colour_does_not_absorb_an_effect(size):
    """A slow output that is in the flight, or not, beside noise of another channel that is coloured
    in any case: its |t| is that in noise whose colour is known.
    """
    rng, n, m = np.random.default_rng(7), 1500, len(OUTPUTS)
    steps = system(n, 3)
    state, z = np.zeros(NX), steps.y_ref + rng.standard_normal((n, m))
    for k in range(n):
        z[k] += steps.H[k] @ state
        state = steps.phi[min(k, n - 2)] @ state + steps.defect[min(k, n - 2)]
    z[1:, 1] += 0.8 * (z - steps.y_ref)[:-1, 1]
    outputs = {
        name: np.convolve(rng.standard_normal(n), np.ones(40) / 6.0, "same")[:, None] * np.eye(m)[0]
        for name in ("own", "effect", "other")
    }
    z += size * outputs["effect"]
    names = tuple(outputs)
    columns = LazyColumns(
        names, lambda k, some: Columns(names, {}, {c: outputs[c] for c in names if c in some}), 1
    )
    followed = [*filter_segments([steps], [z], range(m), np.ones(m))]

    def information(colour):
        return normal_equations(iterate_whitened(followed, columns, colour), names, [0], {})

    fitted = fit_colour(followed, [columns.some(0, ["own"])], {})
    assert fitted[0] is not None
    required = {"effect": 36.0, "other": 36.0}
    colour = likeliest_colour(followed, columns, fitted, information(None), required, {})
    t_fitted, t = (score_tests(information(c), ["own"], [*required]).t for c in (fitted[0], colour))
    if not size:
        assert colour is fitted[0]
        assert np.abs(t).max() < 3.5
        return
    expected = size * np.linalg.norm(outputs["effect"])
    assert abs(t_fitted[0]) < 0.5 * expected
    assert t[0] == pytest.approx(expected, rel=0.1)
    assert abs(t[1]) < 0.3 * t[0]


def test_beside_a_colour_all_its_weights_are_estimated():
    """Estimates and errors are those of least squares with past innovations as further columns."""
    rng, n, channels = np.random.default_rng(5), 300, (0, 2)
    segments, designs = [], []
    for _ in range(2):
        past = past_rows(rng.standard_normal((n, 1)))
        columns = rng.standard_normal((n, 3, 2))
        columns[:, 0, 0] += 2.0 * past[:, 0]
        design = np.zeros((n, 3, 2 + len(channels) * past.shape[1]))
        design[:, :, :2] = columns
        for t, channel in enumerate(channels):
            first = 2 + t * past.shape[1]
            design[:, channel, first : first + past.shape[1]] = past
        residual = rng.standard_normal((n, 3)) + columns @ [0.3, -0.2]
        residual[:, 0] -= 0.4 * past[:, 0]
        segments.append(replace(whitened(residual, columns), motion=channels, past=past))
        designs.append((design.reshape(-1, design.shape[2]), residual.ravel()))
    X, y = (np.concatenate(parts) for parts in zip(*designs, strict=True))
    expected = np.linalg.lstsq(X, y, rcond=None)[0]
    covariance = np.linalg.inv(X.T @ X)[:2, :2]
    information = normal_equations(segments, ["a", "b"], [0, 1], {})
    np.testing.assert_allclose(information.step()[0], expected[:2], atol=1e-4)
    np.testing.assert_allclose(np.linalg.inv(information.total[0]), covariance, rtol=1e-3)
    (remainder, _) = information.residual(information.step()[0])
    np.testing.assert_allclose(remainder.ravel(), y[: 3 * n] - X[: 3 * n] @ expected, atol=1e-4)
    # With the colour taken to be certain, the first column has the error of a longer one.
    certain = np.linalg.inv(information.with_fixed_colour.total[0])
    assert certain[0, 0] < 0.7 * covariance[0, 0]
    half = information.without_values({"a": 0.1})
    np.testing.assert_allclose(half.step()[0], expected[:2] + np.array([0.1, 0.0]), atol=1e-4)
