"""Whitened innovations against the dense Gaussian likelihood of the same linear system; the scores
built on them.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

import numpy as np
import pytest

from sysid.aerodynamics import NX
from sysid.aerodynamics.rigid_body import OUTPUTS, Steps
from sysid.effects.information import (
    corrected_estimate,
    corrected_estimates,
    normal_equations,
    score_tests,
)
from sysid.effects.prediction import (
    Columns,
    FilteredSegment,
    LazyColumns,
    filter_segments,
    iterate_whitened,
    neg2_log_likelihood,
    whiten,
    whiten_filtered,
    with_air,
)
from sysid.effects.selection import sidak_critical_t
from sysid.estimation.kalman import Process
from tests.helpers.linear_systems import system

M = len(OUTPUTS)


def dense(
    steps: Steps, noise: np.ndarray, Q: np.ndarray, P0: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean (n m,), covariance and the response to the start state (n m, 8), written out in full."""
    n = len(steps.y_ref)
    phi, eye = steps.phi, np.eye(NX)
    added = []
    for k in range(n - 1):
        half = steps.half_columns[k].T
        added.append(steps.dt_s / 6.0 * (Q + 4.0 * half @ Q @ half.T + phi[k] @ Q @ phi[k].T))
    mean, cov = [np.zeros(NX)], [[P0]]
    start = [eye[:, :8] if steps.start is None else steps.start]
    for k in range(n - 1):
        mean.append(phi[k] @ mean[-1] + steps.defect[k])
        start.append(phi[k] @ start[-1])
        row = [phi[k] @ c for c in cov[k]]
        cov.append([*row, phi[k] @ cov[k][k] @ phi[k].T + added[k]])
    full = np.zeros((n * NX, n * NX))
    for i in range(n):
        for j in range(i + 1):
            full[i * NX : (i + 1) * NX, j * NX : (j + 1) * NX] = cov[i][j]
            full[j * NX : (j + 1) * NX, i * NX : (i + 1) * NX] = cov[i][j].T
    H = np.zeros((n * M, n * NX))
    for k in range(n):
        H[k * M : (k + 1) * M, k * NX : (k + 1) * NX] = steps.H[k]
    y = np.concatenate([steps.y_ref[k] + steps.H[k] @ mean[k] for k in range(n)])
    X = np.vstack([steps.H[k] @ start[k] for k in range(n)])
    return y, H @ full @ H.T + np.kron(np.eye(n), np.diag(noise**2)), X


@pytest.mark.parametrize("gusty", [False, True])
def test_the_filter_is_the_dense_likelihood(gusty):
    n = 7
    steps, rng = system(n, 1), np.random.default_rng(2)
    noise = 0.2 + rng.random(M)
    Q = P0 = np.zeros(NX)
    if gusty:
        Q = np.where(np.arange(NX) % 2 == 0, 2.0 * rng.random(NX), 0.0)
        P0 = np.where(np.arange(NX) < 8, 0.0, 1.0 + rng.random(NX))
    z = rng.standard_normal((n, M))
    z[3, 4] = np.nan
    u = rng.standard_normal((n, 6))
    process = Process(Q[None], P0[None]) if gusty else None
    (white,) = whiten([steps], [z], [Columns(("c",), {"c": (-1, u)}, {})], range(M), noise, process)
    y, V, X = dense(steps, noise, np.diag(Q), np.diag(P0))
    observed = np.isfinite(z).ravel()
    e = (z.ravel() - y)[observed]
    V, X = V[np.ix_(observed, observed)], X[observed]
    inverse = np.linalg.inv(V)
    P = inverse - inverse @ X @ np.linalg.solve(
        X.T @ inverse @ X, X.T @ inverse
    )  # the start state estimated
    forced = [np.zeros(NX)]
    for k in range(n - 1):
        forced.append(steps.phi[k] @ forced[-1] + steps.g0[k] @ u[k] + steps.g1[k] @ u[k + 1])
    s = np.concatenate([steps.H[k] @ forced[k] + steps.D[k] @ u[k] for k in range(n)])[observed]
    assert np.sum(white.residual**2) == pytest.approx(e @ P @ e, rel=1e-6)
    assert 2.0 * white.logdet == pytest.approx(np.linalg.slogdet(V)[1], rel=1e-9)
    column = white.columns[:, :, 0].astype(float).ravel()
    assert column @ white.residual.ravel() == pytest.approx(s @ P @ e, rel=1e-4)
    assert column @ column == pytest.approx(s @ P @ s, rel=1e-4)


def test_a_filter_that_has_followed_a_flight_whitens_any_columns_of_it():
    steps, rng = system(9, 3), np.random.default_rng(4)
    z, Q = rng.standard_normal((9, M)), rng.random(NX)
    process = Process(Q[None], np.zeros((1, NX)))
    followed = [*filter_segments([steps], [z], range(M), np.ones(M), process)]
    for seed in (5, 6):
        columns = [
            Columns(("c",), {"c": (-1, np.random.default_rng(seed).standard_normal((9, 6)))}, {})
        ]
        (ours,), (single,) = (
            whiten_filtered(followed, columns),
            whiten([steps], [z], columns, range(M), np.ones(M), process),
        )
        for name in ("residual", "columns", "start", "deviation"):
            np.testing.assert_array_equal(getattr(ours, name), getattr(single, name))
    (calm,) = whiten([steps], [z], columns, range(M), np.ones(M))
    assert not np.array_equal(calm.residual, ours.residual)


def test_columns_hold_nothing_that_another_strength_of_the_air_would_do():
    n, steps, rng = 80, system(80, 7), np.random.default_rng(8)
    z, names = rng.standard_normal((n, M)), ("c", "d")
    inputs = {name: (-1, rng.standard_normal((n, 6))) for name in names}
    Q = np.where(np.arange(NX) % 4 == 0, 2.0, 0.0)

    def process(factors: np.ndarray) -> Process:
        return Process((factors * Q)[None], np.zeros((1, NX)))

    def followed(factors: np.ndarray) -> FilteredSegment:
        return next(filter_segments([steps], [z], range(M), np.ones(M), process(factors)))

    columns = LazyColumns(names, lambda k, some: Columns(names, inputs, {}), 1)
    local = followed(np.ones(NX))
    (plain,) = iterate_whitened([local], columns)
    (ours,) = iterate_whitened(with_air([local], process(np.ones(NX)), np.ones(M)), columns)
    assert np.sum(ours.residual**2) < np.sum(plain.residual**2)
    assert neg2_log_likelihood([ours]) == pytest.approx(neg2_log_likelihood([plain]), rel=1e-12)
    np.testing.assert_allclose(ours.start[:, 0], plain.start[:, 0], rtol=1e-9)

    def change(state: int, step: float) -> np.ndarray:
        one = followed(np.where(np.arange(NX) == state, np.exp(step), 1.0))
        remaining = (
            one.innovations_only.innovations - one.innovations_only.starts @ plain.start[:, 0]
        )
        return remaining * np.sqrt(one.gains.variance / local.gains.variance)

    for state in np.flatnonzero(Q):
        slope = (change(state, 0.01) - change(state, -0.01)) / 0.02
        size = np.linalg.norm(slope)
        inside = np.abs(slope.ravel() @ ours.columns.reshape(-1, 2))
        assert inside.max() < 1e-4 * size * np.linalg.norm(ours.columns, axis=(0, 1)).min()
        assert inside.max() < np.abs(slope.ravel() @ plain.columns.reshape(-1, 2)).max()
    assert np.all(
        np.linalg.norm(ours.columns, axis=(0, 1)) < np.linalg.norm(plain.columns, axis=(0, 1))
    )


def flights(effect: dict[str, float], seed: int, segments: int = 9, n: int = 60, group=range(9)):
    """Evidence of white flights with the columns a, b (parameters), c1..c6 (candidates), c6 being
    c1 again under another name.
    """
    rng = np.random.default_rng(seed)
    names = ("a", "b", "c1", "c2", "c3", "c4", "c5", "c6")
    parts, noise = [], np.full(M, 0.5)
    for k in range(segments):
        steps = system(n, 10 + k)
        inputs = {name: (j % 6, rng.standard_normal(n)) for j, name in enumerate(names)}
        inputs["c6"] = inputs["c1"]
        state, z = np.zeros(NX), np.empty((n, M))
        u = np.zeros((n, 6))
        for name, value in {"a": 0.3, **effect}.items():
            u[:, inputs[name][0]] += value * inputs[name][1]
        for i in range(n):
            z[i] = (
                steps.y_ref[i]
                + steps.H[i] @ state
                + steps.D[i] @ u[i]
                + noise * rng.standard_normal(M)
            )
            if i < n - 1:
                state = (
                    steps.phi[i] @ state
                    + steps.defect[i]
                    + steps.g0[i] @ u[i]
                    + steps.g1[i] @ u[i + 1]
                )
        parts.append(whiten([steps], [z], [Columns(names, inputs, {})], range(M), noise)[0])
    return normal_equations(parts, names, group, {})


CONFIRMING = np.arange(9) % 3 == 1
ODDS = dict.fromkeys(("c1", "c2", "c3", "c4", "c5"), 0.0)


def test_a_candidate_that_the_parameters_hold_already_has_no_score():
    evidence = flights({}, 6)
    assert np.isnan(score_tests(evidence, ["a", "b", "c1"], ["c6"]).t[0])


def test_scores_of_nothing_are_standard_normal():
    t = np.concatenate(
        [score_tests(flights({}, seed, 4, 40), ["a", "b"], list(ODDS)).t for seed in range(40, 60)]
    )
    assert abs(t.mean()) < 0.3
    assert 0.8 < t.std() < 1.2
    evidence = flights({}, 41)
    _, std, white = corrected_estimate(evidence, ["a", "b"], "c2")
    assert std == pytest.approx(white, rel=0.1)


def test_all_of_a_fit_at_once_are_as_each_alone():
    """Errors were the residuals white: the diagonal of the information's inverse.

    Without another column they are smaller.
    """
    evidence = flights({"c3": 0.2}, 42)
    names = ["a", "b", "c3", "c5"]
    result = corrected_estimates(evidence, names, ["c3", "a"])
    for name, mine in result.items():
        assert mine == pytest.approx(
            corrected_estimate(evidence, [n for n in names if n != name], name), rel=1e-9
        )
    some = evidence.index(names)
    expected = np.sqrt(np.diagonal(np.linalg.inv(evidence.total[0][np.ix_(some, some)])))
    assert [result["c3"][2], result["a"][2]] == pytest.approx([expected[2], expected[0]], rel=1e-6)
    assert corrected_estimates(evidence, ["c3", "c5"], ["c3"])["c3"][2] < 0.999 * expected[2]


def test_the_limit_grows_with_the_number_of_candidates():
    assert sidak_critical_t(1, 0.01) == pytest.approx(2.5758, abs=1e-3)
    assert sidak_critical_t(300, 0.01) > 4.0


def test_a_step_leaves_what_is_held_where_it_is():
    evidence = flights({"c3": 0.2}, 3)
    complete, length = evidence.step()
    constant, shorter = evidence.step(["c3"])
    at = evidence.index(["c3"])[0]
    assert abs(complete[at]) > 0.1
    assert constant[at] == 0.0
    np.testing.assert_allclose(
        constant, evidence.estimates(evidence.index([n for n in evidence.names if n != "c3"]))
    )
    assert 0.0 < shorter < length


@pytest.mark.parametrize("gusty", [True, False])
def test_evidence_that_makes_columns_again_says_the_same_as_one_that_holds_them(gusty):
    rng = np.random.default_rng(9)
    n, names = 60, ("a", "b", "off", "c1", "c2", "c3")
    steps = [system(n, k) for k in range(3)]
    z = [rng.standard_normal((n, M)) for _ in steps]
    inputs = [{name: (4, rng.standard_normal(n)) for name in names if name != "off"} for _ in steps]
    columns = [
        Columns(
            names,
            some,
            {"off": np.ones((n, M))},
            {"c2": rng.standard_normal(n)},
            {"c1": np.ones(n)},
        )
        for some in inputs
    ]
    air = (0.05 * (np.arange(13) < 3), np.zeros(13))
    process = Process(np.tile(air[0], (3, 1)), np.tile(air[1], (3, 1))) if gusty else None
    request: list[Collection[str]] = []

    def make(k: int, some: Collection[str]) -> Columns:
        request.append(some)
        return columns[k]

    group = [0, 1, 2]
    complete = normal_equations(
        whiten(steps, z, columns, range(M), np.ones(M), process), names, group, {}
    )
    white = iterate_whitened(
        filter_segments(steps, z, range(M), np.ones(M), process), LazyColumns(names, make, 3)
    )
    constant = normal_equations(white, names, group, {}, ("off", "b", "a"))
    assert constant.white[0].columns.shape == (n, M, 3)
    np.testing.assert_array_equal(constant.gram, complete.gram)
    for some in (["a", "b"], ["c2", "a", "c1"], ["c2"]):
        for one, other in zip(constant.white, complete.white, strict=True):
            at = complete.index(some)
            np.testing.assert_allclose(
                constant.series(one, at), complete.series(other, at), atol=1e-6
            )
    assert request[3:] == [{"c2", "c1"}] * 3
    assert corrected_estimate(constant, ["a", "b"], "c3") == pytest.approx(
        corrected_estimate(complete, ["a", "b"], "c3"), rel=1e-6
    )
    selected, other = constant.without_values({"c3": 0.3}), complete.without_values({"c3": 0.3})
    np.testing.assert_allclose(selected.white[0].residual, other.white[0].residual, atol=1e-6)
    absent = replace(constant, white=[replace(w, more=None) for w in constant.white])
    with pytest.raises(KeyError):
        corrected_estimate(absent, ["a", "b"], "c1")


def test_a_column_of_which_the_data_hold_nothing_has_no_standard_error():
    each = flights({"c3": 0.2}, 3)
    k = each.names.index("c1")
    none = np.where(np.arange(len(each.names)) == k, 0.0, 1.0)
    white = [replace(w, columns=(w.columns * none).astype(np.float32)) for w in each.white]
    is_lost = normal_equations(white, each.names, range(9), {})
    value, std, plain = corrected_estimate(is_lost, ["a", "b"], "c1")
    assert value == 0.0
    assert np.isnan([std, plain]).all()
    assert np.isfinite(corrected_estimate(is_lost, ["a", "b", "c1"], "c3")).all()


def test_groups_of_segments_say_the_same_as_their_segments_and_are_not_split():
    each = flights({"c3": 0.2}, 3)
    groups = normal_equations(each.white, each.names, CONFIRMING, {})
    assert groups.gram.shape[0] == 2
    for part in (CONFIRMING, ~CONFIRMING, None):
        for one, other in zip(each.of_segments(part), groups.of_segments(part), strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-6, atol=1e-6)
    some = CONFIRMING.copy()
    some[np.flatnonzero(some)[0]] = False
    with pytest.raises(ValueError, match="of a group"):
        groups.of_segments(some)
