"""The likelihood of many airs at once is that of the filter, one after the other."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from sysid.aerodynamics.rigid_body import NX
from sysid.effects import gust_cost
from sysid.effects.gust_cost import Likelihood, costs
from sysid.effects.prediction import Columns, minus_twice_log, whiten
from sysid.estimation.kalman import Process
from sysid.parallel import Held
from tests.helpers.linear_systems import system

STATES = np.arange(NX)
ROWS = (0, 1, 2, 5, 6, 7, 8)


def flights(seed: int = 3):
    """Three segments of unequal length, of seven channels, with gaps; and five airs with noise of the sensors of their own."""
    rng = np.random.default_rng(seed)
    steps = [system(n, seed + n) for n in (40, 55, 31)]
    data = [s.y_ref[:, ROWS] + rng.standard_normal((len(s.y_ref), len(ROWS))) for s in steps]
    data[0][3:9, 2] = np.nan
    data[2][12] = np.nan
    airs = []
    for k in range(5):
        noise = [np.diag(np.where(STATES < 8, 0.3 * (k + 1) * (1 + i), 0.1)) for i in range(3)]
        begin = [np.diag(np.where(STATES < 8, 0.0, 0.5 + k)) for _ in range(3)]
        airs.append(Process(np.stack(noise), np.stack(begin)))
    return steps, data, np.abs(rng.normal(1.0, 0.2, (5, len(ROWS)))), airs


def one_by_one(steps, data, noise, airs):
    nothing = [Columns((), {}, {})] * len(steps)
    return np.array([minus_twice_log(whiten(steps, data, nothing, ROWS, r, p)) for r, p in zip(noise, airs, strict=True)])


@pytest.mark.parametrize("lanes", [80, 7, 1])
def test_trials_side_by_side_are_as_likely_as_alone(monkeypatch, lanes):
    monkeypatch.setattr(gust_cost, "LANES", lanes)
    steps, data, noise, airs = flights()
    found = costs(steps, data, ROWS, noise, airs)
    np.testing.assert_allclose(found, one_by_one(steps, data, noise, airs), rtol=1e-6)
    assert np.ptp(found) > 10.0
    other = costs(steps, data, ROWS, 1.01 * noise, airs)
    assert np.abs(other / found - 1.0).max() > 1e-3


def test_a_violent_step_is_left_to_the_careful_filter():
    steps, data, noise, airs = flights()
    steps[1].phi[20] *= 300.0
    found = costs(steps, data, ROWS, noise, airs)
    np.testing.assert_allclose(found, one_by_one(steps, data, noise, airs), rtol=1e-9)


def test_an_air_that_no_filter_follows_is_impossible_and_the_others_are_what_they_were():
    steps, data, noise, airs = flights()
    before = costs(steps, data, ROWS, noise, airs)
    broken = Process(airs[2].noise.copy(), airs[2].begin - 1e3 * np.eye(NX))
    found = costs(steps, data, ROWS, noise, [*airs[:2], broken, *airs[3:]])
    assert np.isinf(found[2])
    np.testing.assert_allclose(np.delete(found, 2), np.delete(before, 2), rtol=1e-6)


class Several:
    """Stands for processes: what is shared and every job goes through a pickle."""

    def __init__(self, count: int) -> None:
        self.count, self.jobs = count, 0

    def __call__(self, function, jobs):
        for job in jobs:
            self.jobs += 1
            yield function(pickle.loads(pickle.dumps(job)))

    def share(self, value):
        return Held(value)


@pytest.mark.parametrize("count", [2, 3, 8])
def test_shared_among_processes_the_figures_are_the_same_to_the_bit(count):
    steps, data, noise, airs = flights()
    alone, several = costs(steps, data, ROWS, noise, airs), Several(count)
    found = Likelihood(steps, data, ROWS, several).costs(noise, airs)
    np.testing.assert_array_equal(found, alone)
    assert several.jobs == min(count, len(steps))
