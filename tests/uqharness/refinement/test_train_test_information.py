"""What train flights leave uncertain of hold-out flights: t of all flights together, and the spread
of the change of likelihood.
"""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from sysid.effects import Information
from sysid.effects.selection import SelectedEffect, Selection
from tests.helpers.whitened import information_of
from uqharness.refinement.hold_out import (
    TrainTestInformation,
    Verdict,
    compare,
    with_parameter_uncertainty,
)

NAMES, KEY = ("aero/a", "aero/b"), "effect/Cm/c"
TRUE = {"aero/a": 1.0, "aero/b": -0.5, KEY: 0.3}


def side(
    rng: np.random.Generator, low: float, high: float, n: int, at: dict[str, float]
) -> tuple[Information, np.ndarray, np.ndarray]:
    """Evidence of a line, a wave and a bias of its own between two states, about ``at``; its
    columns and what was measured.
    """
    x = np.linspace(low, high, n)
    columns = np.column_stack([np.ones(n), x, np.sin(6.0 * x), np.sin(40.0 * x)])
    values = np.array([TRUE[NAMES[0]], TRUE[NAMES[1]], TRUE[KEY], 0.2])
    measured = columns @ values + rng.standard_normal(n)
    residual = measured - columns[:, :3] @ np.array([at[k] for k in (*NAMES, KEY)])
    names = (*NAMES, KEY, "bias/f/q")
    return information_of(residual[:, None], columns[:, None, :], names), columns, measured


def pair_of(
    rng: np.random.Generator,
) -> tuple[
    TrainTestInformation,
    dict[str, float],
    tuple[np.ndarray, np.ndarray],
    tuple[np.ndarray, np.ndarray],
]:
    """Train flights between 1 and 2, hold-out flights between 0 and 1, each about numbers of its
    own.
    """
    at = ({"aero/a": 0.8, "aero/b": 0.1, KEY: 0.0}, {"aero/a": 1.3, "aero/b": -0.9, KEY: 0.0})
    train, X, z = side(rng, 1.0, 2.0, 400, at[0])
    test, Y, w = side(rng, 0.0, 1.0, 1000, at[1])
    fitted = np.linalg.lstsq(X, z, rcond=None)[0]
    std = np.sqrt(np.linalg.inv(X.T @ X)[2, 2])
    t = fitted[2] / std
    choice = SelectedEffect(KEY, fitted[2], std, t, t * t, 1.0, 0.0)
    result = SimpleNamespace(names=NAMES, selection=Selection((choice,)), critical_t=3.0)
    return (
        TrainTestInformation(result, train, test, at),
        dict(zip((*NAMES, KEY), fitted, strict=False)),
        (X, z),
        (Y, w),
    )  # type: ignore[arg-type]


def test_t_of_both_sides_is_that_of_one_regression():
    result, _, (X, z), (Y, w) = pair_of(np.random.default_rng(3))
    # Each side has a bias of its own.
    complete = np.vstack(
        [np.column_stack([X, 0.0 * X[:, 3]]), np.column_stack([Y[:, :3], 0.0 * Y[:, 3], Y[:, 3]])]
    )
    fitted = np.linalg.lstsq(complete, np.concatenate([z, w]), rcond=None)[0]
    expected = fitted[2] / np.sqrt(np.linalg.inv(complete.T @ complete)[2, 2])
    assert result.t(KEY, [KEY]) == pytest.approx(expected, rel=1e-4)
    assert abs(expected) != pytest.approx(abs(result.result.selection.chosen[0].t), rel=0.05)


def test_the_spread_of_the_change_is_that_of_many_train_flights():
    """Outside the states of the train flights most of it is theirs, not the hold-out flights'
    noise.
    """
    rng = np.random.default_rng(4)
    changes, noise, complete = [], [], []
    for _ in range(200):
        result, fitted, (X, z), (Y, w) = pair_of(rng)
        plain = np.linalg.lstsq(X[:, [0, 1, 3]], z, rcond=None)[0]
        with_, reduced = (
            predictions(r, Y)
            for r in (w - Y[:, :3] @ [fitted[k] for k in (*NAMES, KEY)], w - Y[:, :2] @ plain[:2])
        )
        data = SimpleNamespace(segments=[SimpleNamespace(dt_s=0.02)])
        verdict = compare(reduced, with_, data, with_)  # type: ignore[arg-type]
        sure = with_parameter_uncertainty(verdict, result, reduced, with_, [KEY], KEY)  # type: ignore[arg-type]
        changes.append(verdict.change)
        noise.append(2.0 * np.linalg.norm(reduced.white[0] - with_.white[0]))
        complete.append(sure.std)
        assert sure.excess_t2 == pytest.approx(result.t(KEY, [KEY]) ** 2 - 9.0)
    scatter = float(np.std(changes))
    assert np.sqrt(np.mean(np.square(complete))) == pytest.approx(scatter, rel=0.25)
    assert np.sqrt(np.mean(np.square(noise))) < 0.6 * scatter


def predictions(residual: np.ndarray, Y: np.ndarray) -> SimpleNamespace:
    remaining = residual - Y[:, 3] * (Y[:, 3] @ residual) / (Y[:, 3] @ Y[:, 3])
    cost = float(remaining @ remaining)
    return SimpleNamespace(
        white=[remaining[:, None]], cost=cost, logdet=(0.0,), neg2_log_likelihood=cost
    )


def test_both_sides_say_more_than_the_hold_out_flights():
    """A change against the effect that chance gives is no contradiction where all flights together
    have what is asked.
    """
    verdict = Verdict(-4.0, 5.0, excess_t2=2.0)
    assert verdict.gap == "cannot tell"
    assert Verdict(-4.0, 5.0, excess_t2=-2.0).gap == "grew"
    assert Verdict(-9.0, 5.0, excess_t2=2.0).gap == "grew"
