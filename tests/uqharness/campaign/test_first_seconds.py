"""The first seconds in both engines before a campaign, and the pace of this machine."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
import pytest

from tests.helpers import campaign_fakes as fakes
from tests.helpers.engine_fakes import Flown, Understanding, engines
from uqharness.campaign.cases import Part, build_cases
from uqharness.campaign.cost import TRIAL_CONDITIONS, size_of, trial_conditions
from uqharness.campaign.engines import (
    CASES_EACH,
    STORING_S,
    batch_pace,
    compare_start,
    is_rounding,
    reasons_against,
    throwaway_process,
)
from uqharness.campaign.processes import SerialExecutor
from uqharness.campaign.run import find_mission
from uqharness.errors import BadInputError


@pytest.fixture
def cases(tmp_path):
    spec = fakes.small_spec(tmp_path, 2, wind_mps=(0.0, 3.0))
    return build_cases(spec.with_engine("batch"), find_mission(spec))


def test_some_cases_of_each_condition_are_compared_over_ten_seconds_without_burn_in(cases):
    flown = []

    def group(engine, flights):
        flown.extend((engine, flight.duration_s, flight.burn_in_s) for flight in flights)
        return Flown()(engine, flights)

    rows = compare_start(replace(engines(Flown()), fly_group=group), cases, SerialExecutor())
    assert {row.condition for row in rows} == {"0 m/s moderate", "3 m/s moderate"}
    assert {row.part for row in rows} == {"start"}
    assert len({row.case_id for row in rows}) == 2 * CASES_EACH
    assert set(flown) == {("batch", 10.0, 0.0), ("jsbsim as judge", 10.0, 0.0)}
    assert {row.verdict for row in rows} == {"alike"}
    moved = compare_start(engines(Flown(offset=0.1)), cases, SerialExecutor())
    assert {row.metric for row in moved if row.verdict == "differs"} == {"cross_track_median_m"}


@dataclass(frozen=True)
class Unstable(Flown):
    """A model in which an error of each frame grows: one ulp in JSBSim, ``error`` in the batch
    engine.
    """

    rate_per_s: float = 3.0
    error: float = 0.0

    def flight(self, engine, flight):
        error = {"batch": self.error, "jsbsim one ulp off": 1e-16}.get(engine, 0.0)
        grown = min(error * np.exp(self.rate_per_s * flight.duration_s), 30.0)
        return replace(self, offset=grown, rounding=grown, error=0.0, rate_per_s=0.0).moved(
            engine, flight
        )

    def moved(self, engine, flight):
        return Flown.flight(self, engine, flight)


@pytest.mark.parametrize("rate_per_s", [2.5, 3.0, 5.0, 12.0])
def test_rounding_in_an_unstable_model_is_told_from_a_wrong_translation(cases, rate_per_s):
    def verdicts(error):
        given = engines(Unstable(rate_per_s=rate_per_s, error=error))
        return {row.verdict for row in compare_start(given, cases[:1], SerialExecutor())}

    assert verdicts(1e-13) == {"alike", "excused"}
    for wrong in (1e-3, 1e-6, 1e-9):
        assert "differs" in verdicts(wrong)


def test_a_difference_that_does_not_grow_is_not_rounding(cases):
    given = engines(Flown(offset=1e-2))
    case = cases[0]
    assert not is_rounding(given, case, SerialExecutor())
    assert is_rounding(engines(Flown()), case, SerialExecutor())


def test_what_cannot_be_flown_is_bad_input(cases):
    given = replace(
        engines(Flown()),
        fly_group=lambda engine, flights: [fakes.refuses(flight) for flight in flights],
    )
    with pytest.raises(BadInputError, match="uq/active"):
        compare_start(given, cases, SerialExecutor())


def test_the_pace_is_that_of_many_lanes_however_few_cases_there_are(cases):
    with contextlib.closing(throwaway_process()) as process:
        pace = batch_pace(engines(Flown(sleep_s=0.002)), cases[:3], process)
    assert pace is not None
    assert pace.flight_s == STORING_S
    assert 0.002 / 60.0 < pace.per_second < 0.02 / 60.0
    failing = replace(
        engines(Flown()),
        fly_group=lambda engine, flights: [fakes.diverges(flight) for flight in flights],
    )
    assert batch_pace(failing, cases, SerialExecutor()) is None


@pytest.mark.slow
def test_the_work_before_a_campaign_does_not_grow_with_its_grid_of_conditions(tmp_path):
    winds = tuple(float(wind) for wind in np.random.default_rng(1).permutation(2000) * 0.002)
    air = {"wind_mps": winds, "turbulence": ("light", "moderate")}
    spec = fakes.small_spec(tmp_path, 1, **air).with_engine("batch")
    flown, read = [], []

    @dataclass(frozen=True)
    class Reading(Understanding):
        def refusals(self, spec, varying):
            read.append(spec.wind_mps)
            return ()

    def group(engine, flights):
        flown.extend((flight.wind_mps, flight.turbulence) for flight in flights)
        return Flown()(engine, flights)

    counted = replace(engines(Flown(), Reading()), fly_group=group)
    mission = find_mission(spec)
    assert reasons_against(spec, mission, counted) == ()
    assert len(read) == TRIAL_CONDITIONS
    cases = build_cases(spec, mission, Part(range(1), tuple(product(*air.values()))))
    compare_start(
        counted,
        [case for case in cases if case.epistemic_id == cases[0].epistemic_id],
        SerialExecutor(),
    )
    assert len(flown) == 2 * TRIAL_CONDITIONS
    assert {air for _, air in flown} == {"light", "moderate"}
    tried = {wind for wind, _ in flown}
    # The extremes are among them, and no wind of the grid is far from one that was flown.
    assert (min(tried), max(tried)) == (0.0, max(winds))
    assert np.max(np.diff(sorted(tried))) <= 2 * max(winds) / TRIAL_CONDITIONS * 1.1
    assert size_of(spec).trial_conditions == TRIAL_CONDITIONS < size_of(spec).conditions


def test_every_condition_of_a_small_grid_is_tried_out():
    assert len(trial_conditions((3.0, 0.0, 6.0), ("none", "severe"))) == 6
    # A grid of one wind in each turbulence, and of two winds, keeps both.
    assert trial_conditions((5.0,), ("light",)) == ((5.0, "light"),)
