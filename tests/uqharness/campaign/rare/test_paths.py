"""Paths of the batch engine: excursions as campaigns count them, branches that part, paths that
JSBSim flies again.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from tests.helpers.batch_whole import EXPENSIVE, spec
from uqharness.batch.course import fly_many
from uqharness.campaign.rare_events import CheckpointPlan, LoiterPaths
from uqharness.errors import BadInputError
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


def test_paths_that_are_not_split_have_the_excursions_of_plain_flights():
    paths = LoiterPaths(FLIGHTS, [0, 1, 2], ROOT, WATCH)
    found = run(paths, 3, Levels(()), 2)
    flown = fly_many(FLIGHTS)
    counts = np.array(
        [[one.metrics[f"excursions_{radius:g}m"] for radius in RADII] for one in flown]
    )
    assert counts.sum() > 2
    np.testing.assert_array_equal(found.events, counts.mean(axis=0))
    np.testing.assert_array_equal(found.probability, (counts > 0).mean(axis=0))
    assert (found.steps, found.max_paths, found.ended) == (90, 3, 0.0)
    for hit in paths.hits:
        signal = np.abs(flown[hit.aleatory_id].signals["cross_track"])
        assert hit.splits == ()
        assert hit.distance_m == signal[np.argmax(signal > RADII[hit.kind])]


def test_the_same_paths_again_and_branches_that_part(split):
    paths, found = split
    again = LoiterPaths(FLIGHTS, [0, 1, 2], ROOT, WATCH)
    other = run(again, 3, Levels((3.0, 6.0), 2), 2)
    assert other.events.tobytes() == found.events.tobytes()
    assert again.hits == paths.hits
    assert found.max_paths > 3
    assert found.steps > 90
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
        flown = record_mission(
            mission, flight, scored_signals(mission), OPTIONAL_SIGNALS, splits=splits
        )
        return abs(float(flown.signals["cross_track"][-1]))

    assert abs(last(hit.splits) - hit.distance_m) < 1e-6
    assert abs(last(()) - hit.distance_m) > 1e-3
    with pytest.raises(ValueError, match="host's gusts alone"):
        record_mission(
            mission,
            replace(flight, turbulence_source="jsbsim"),
            scored_signals(mission),
            splits=hit.splits,
        )


def test_steps_and_aircraft_that_cannot_be_split():
    for step_s in (0.1, 0.25):
        with pytest.raises(BadInputError, match="a multiple of the recorded"):
            LoiterPaths(FLIGHTS[:1], [0], ROOT, CheckpointPlan(step_s, Lookahead(1.0)))
