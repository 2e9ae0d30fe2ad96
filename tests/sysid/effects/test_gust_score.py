"""The likelihood of flights in an air is that of the whole filter, and its slopes are those of
differences.
"""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest

from sysid.aerodynamics import NX
from sysid.effects.prediction import Columns, neg2_log_likelihood, whiten
from sysid.effects.turbulence import AirLikelihood
from sysid.estimation.kalman import Process
from sysid.parallel import LocalValue
from tests.helpers.linear_systems import system

STATES = np.arange(NX)
ROWS = (0, 1, 2, 5, 6, 7, 8)


def flights(seed: int = 3):
    """Three segments of unequal length, of seven channels, with gaps; and five airs with noise of
    the sensors of their own.
    """
    rng = np.random.default_rng(seed)
    steps = [system(n, seed + n) for n in (40, 55, 31)]
    data = [s.y_ref[:, ROWS] + rng.standard_normal((len(s.y_ref), len(ROWS))) for s in steps]
    data[0][3:9, 2] = np.nan
    data[2][12] = np.nan
    airs = []
    for k in range(5):
        noise = [np.where(STATES < 8, 0.3 * (k + 1) * (1 + i), 0.1) for i in range(3)]
        begin = [np.where(STATES < 8, 0.0, 0.5 + k) for _ in range(3)]
        airs.append(Process(np.stack(noise), np.stack(begin)))
    return steps, data, np.abs(rng.normal(1.0, 0.2, (5, len(ROWS)))), airs


def one_by_one(steps, data, noise, airs):
    empty = [Columns((), {}, {})] * len(steps)
    return np.array(
        [
            neg2_log_likelihood(whiten(steps, data, empty, ROWS, r, p))
            for r, p in zip(noise, airs, strict=True)
        ]
    )


def test_an_air_is_as_likely_as_by_the_whole_filter():
    steps, data, noise, airs = flights()
    likelihood = AirLikelihood(steps, data, ROWS)
    result = np.array([likelihood(r, p).cost for r, p in zip(noise, airs, strict=True)])
    np.testing.assert_allclose(result, one_by_one(steps, data, noise, airs), rtol=1e-6)
    assert np.ptp(result) > 10.0
    assert abs(likelihood(1.01 * noise[0], airs[0]).cost / result[0] - 1.0) > 1e-4
    plain = likelihood(noise[0], airs[0], slopes=False)
    assert plain.cost == result[0]
    assert not plain.process.any()


@pytest.mark.parametrize("violent", [False, True])
def test_slopes_are_those_of_differences(violent):
    """Of the cost, with each sensor's noise and with the elements of process noise and begin, start
    states fitted.
    """
    steps, data, noise, airs = flights()
    if violent:
        steps[1].phi[20] *= 30.0
    likelihood, r, air = AirLikelihood(steps, data, ROWS), noise[1], airs[1]
    result = likelihood(r, air)
    h = 1e-4
    for k in range(len(r)):
        up, down = (likelihood(r * np.exp(s * np.eye(len(r))[k]), air).cost for s in (h, -h))
        np.testing.assert_allclose(result.noise[k], (up - down) / (2.0 * h), rtol=1e-4, atol=1e-3)
    rng = np.random.default_rng(5)
    for kind in ("noise", "begin"):
        for s in range(3):
            change = np.zeros((3, NX))
            some = STATES[:8] if kind == "noise" else STATES[8:]
            change[s, some] = rng.uniform(0.1, 1.0, len(some))
            up, down = (
                likelihood(r, replace(air, **{kind: getattr(air, kind) + sign * h * change})).cost
                for sign in (1.0, -1.0)
            )
            slope = np.sum((result.process if kind == "noise" else result.begin) * change)
            np.testing.assert_allclose(slope, (up - down) / (2.0 * h), rtol=1e-4, atol=1e-3)
            assert abs(slope) > 0.1


def test_an_air_that_no_filter_follows_is_impossible():
    steps, data, noise, airs = flights()
    broken = Process(airs[2].noise, airs[2].begin - 1e3)
    result = AirLikelihood(steps, data, ROWS)(noise[2], broken)
    assert np.isinf(result.cost)
    assert not result.noise.any()


class Several:
    """Stands for processes: what is shared and every job goes through a pickle."""

    def __init__(self, count: int) -> None:
        self.count, self.jobs = count, 0

    def __call__(self, function, jobs):
        for job in jobs:
            self.jobs += 1
            yield function(pickle.loads(pickle.dumps(job)))

    def share(self, value):
        return LocalValue(value)


@pytest.mark.parametrize("count", [2, 3, 8])
def test_shared_among_processes_the_figures_are_the_same_to_the_bit(count):
    steps, data, noise, airs = flights()
    single, several = AirLikelihood(steps, data, ROWS)(noise[0], airs[0]), Several(count)
    result = AirLikelihood(steps, data, ROWS, several)(noise[0], airs[0])
    assert result.cost == single.cost
    for name in ("noise", "process", "begin"):
        np.testing.assert_array_equal(getattr(result, name), getattr(single, name))
    assert several.jobs == min(count, len(steps))
