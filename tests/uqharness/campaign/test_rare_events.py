"""Paths of the batch engine that split at levels, and predictions of the distance to come."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest

from tests.helpers.batch_whole import EXPENSIVE, spec
from uqharness.batch.course import fly_many
from uqharness.campaign.rare_events import (
    CURRENT_SIGMA_M,
    CheckpointPlan,
    DistancePredictor,
    LoiterPaths,
    fit_predictors,
)
from uqharness.flight import OPTIONAL_SIGNALS, record_mission, scored_signals, staged_mission
from uqharness.statistics import Levels, run

RADII = (2.0, 4.0)


@dataclass(frozen=True)
class Lookahead:
    """Score a path by its distance after ``lookahead_s`` seconds at the present rate."""

    lookahead_s: float
    properties: tuple[str, ...] = ()

    def of(self, values, distance_m, closing_mps):
        return distance_m + self.lookahead_s * closing_mps


WATCH = CheckpointPlan(2.0, Lookahead(1.0), max_noted=12)


ONE = spec(duration_s=60.0, burn_in_s=20.0, excursion_radius_m=RADII, rearm_m=1.0, **EXPENSIVE)


FLIGHTS = [replace(ONE, seed_noise=7 + k, seed_turbulence=20 + k) for k in range(3)]


ROOT = 11


@pytest.fixture(scope="module")
def split():
    """Paths that are split at 1 and 3 m of score, and what came of them."""
    paths = LoiterPaths(FLIGHTS, [0, 1, 2], ROOT, WATCH)
    return paths, run(paths, 3, Levels((3.0, 6.0), 2), 2)


def test_unsplit_paths_equal_plain_flights():
    paths = LoiterPaths(FLIGHTS, [0, 1, 2], ROOT, WATCH)
    result = run(paths, 3, Levels(()), 2)
    flight = fly_many(FLIGHTS)
    counts = np.array(
        [[one.metrics[f"excursions_{radius:g}m"] for radius in RADII] for one in flight]
    )
    assert counts.sum() > 2
    np.testing.assert_array_equal(result.events, counts.mean(axis=0))
    np.testing.assert_array_equal(result.probability, (counts > 0).mean(axis=0))
    assert (result.steps, result.max_paths, result.ended) == (90, 3, 0.0)
    for hit in paths.hits:
        signal = np.abs(flight[hit.aleatory_id].signals["cross_track"])
        assert hit.splits == ()
        assert hit.distance_m == signal[np.argmax(signal > RADII[hit.kind])]


def test_the_same_paths_again_and_branches_that_part(split):
    paths, result = split
    repeat = LoiterPaths(FLIGHTS, [0, 1, 2], ROOT, WATCH)
    other = run(repeat, 3, Levels((3.0, 6.0), 2), 2)
    assert other.events.tobytes() == result.events.tobytes()
    assert repeat.hits == paths.hits
    assert result.max_paths > 3
    assert result.steps > 90
    keys = [(s.aleatory_id, s.level, s.branch) for hit in paths.hits for s in hit.splits]
    assert keys
    assert {level for _, level, _ in keys} <= {1, 2}


def test_a_branched_path_is_the_one_that_jsbsim_flies(split):
    """To the rounding of a double at the first excursion; a path with other branches goes
    elsewhere.
    """
    hit = max(
        (one for one in split[0].hits if one.splits),
        key=lambda one: one.frame - one.splits[0].frame,
    )
    assert hit.frame > hit.splits[0].frame + 200
    flight = replace(FLIGHTS[hit.aleatory_id], duration_s=hit.frame * 0.01 - ONE.burn_in_s)
    mission = staged_mission(flight)

    def last(splits):
        trajectory = record_mission(
            mission, flight, scored_signals(mission), OPTIONAL_SIGNALS, splits=splits
        )
        return abs(float(trajectory.signals["cross_track"][-1]))

    assert abs(last(hit.splits) - hit.distance_m) < 1e-6
    assert abs(last(()) - hit.distance_m) > 1e-3
    with pytest.raises(ValueError, match="host's gusts alone"):
        record_mission(
            mission,
            replace(flight, turbulence_source="jsbsim"),
            scored_signals(mission),
            splits=hit.splits,
        )


KEEP = 0.8


@pytest.fixture(scope="module")
def process():
    """x' = KEEP x + noise of variance 1, and a regressor that tells nothing."""
    rng = np.random.default_rng(8)
    x = np.empty((40, 500))
    x[:, 0] = rng.standard_normal(40) / math.sqrt(1.0 - KEEP**2)
    for row in range(1, x.shape[1]):
        x[:, row] = KEEP * x[:, row - 1] + rng.standard_normal(40)
    return x, np.stack([x, rng.standard_normal(x.shape), np.ones_like(x)], axis=-1)


def test_predictions_of_a_first_order_process(process):
    x, regressors = process
    result = fit_predictors(regressors, 5.0 + x, 1.0, 9.0, (0.25, 1.0, 3.0))
    assert result.horizons_s == (1.0, 3.0), "a quarter is no whole number of rows"
    for steps, slopes, constant, sigma in zip(
        (1, 3), result.coefficients, result.constants, result.sigmas, strict=True
    ):
        assert slopes[0] == pytest.approx(KEEP**steps, abs=0.02)
        assert slopes[1] == pytest.approx(0.0, abs=0.03)
        assert constant == pytest.approx(5.0, abs=0.1)
        assert sigma == pytest.approx(
            math.sqrt((1.0 - KEEP ** (2 * steps)) / (1.0 - KEEP**2)), rel=0.03
        )


def test_a_score_is_the_nearest_prediction_in_standard_deviations():
    one = DistancePredictor(10.0, (1.0, 2.0), ((1.0,), (0.0,)), (0.0, 8.0), (0.5, 2.0))
    scores = one.score(np.array([[9.5], [4.0], [11.0]]), np.array([9.5, 4.0, 11.0]))
    assert scores == pytest.approx([-1.0, -1.0, 1.0 / CURRENT_SIGMA_M])
    regressors = np.random.default_rng(1).standard_normal((7, 1))
    complete = one.score(regressors, regressors[:, 0])
    assert [
        one.score(regressors[k : k + 1], regressors[k : k + 1, 0])[0] for k in range(7)
    ] == complete.tolist()
    assert np.isnan(one.score(np.array([[np.nan]]), np.array([np.nan])))[0]
