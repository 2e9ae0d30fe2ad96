"""Cases: seeds, identity, order, common random numbers, groups for the batch engine."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest

from tests.helpers import campaign_fakes as fakes
from tests.helpers.campaign_fakes import CAMPAIGN, campaign_file
from uqharness.campaign.cases import (
    Mission,
    build_cases,
    epistemic_samples,
    group_cases,
    uq_properties,
)
from uqharness.campaign.read_spec import read_campaign
from uqharness.flight.random_numbers import flight_seed, walk_stream

MISSION = Mission(Path("plane"), "a" * 64, Path("loiter.xml"), "b" * 64)


GOLDEN_TURBULENCE = [98091368, 21354800, 1119640398]


GOLDEN_NOISE = [790604505, 1417974109, 472059078]


GOLDEN_WALK = [3525987992, 873814931]


GOLDEN_IDS = ("4c4000eebc386034", "b099e9f67b944cd8")


@pytest.fixture
def spec(tmp_path):
    return read_campaign(campaign_file(tmp_path))


def test_golden_seeds():
    assert [flight_seed(7, index, "turbulence") for index in range(3)] == GOLDEN_TURBULENCE
    assert [flight_seed(7, index, "noise") for index in range(3)] == GOLDEN_NOISE
    walk = walk_stream(7, "010101", "Cm").generate_state(2)
    assert walk.tolist() == GOLDEN_WALK


def test_seeds_are_in_the_range_of_the_generator_and_distinct():
    seeds = [
        flight_seed(0, index, kind) for index in range(2000) for kind in ("turbulence", "noise")
    ]
    assert min(seeds) >= 1
    assert max(seeds) <= 2**31 - 2
    assert len(set(seeds)) == len(seeds)
    assert flight_seed(0, 0, "noise") != flight_seed(1, 0, "noise")
    with pytest.raises(ValueError, match="turbulence or noise"):
        flight_seed(0, 0, "walk")


def test_golden_case_ids(spec):
    cases = build_cases(spec, MISSION)
    assert len(cases) == 3 * 64
    assert (cases[0].case_id, cases[-1].case_id) == GOLDEN_IDS
    assert len({case.case_id for case in cases}) == len(cases)


def test_certain_coefficients_have_no_delta(tmp_path):
    text = (
        CAMPAIGN.partition("bounds =")[0]
        + 'coefficients = ["Cm", "CX"]\ninterior = 0\nnominal = false\n'
    )
    spec = read_campaign(campaign_file(tmp_path, text))
    samples = epistemic_samples(spec)
    assert [sample.epistemic_id for sample in samples] == ["0---0-", "0---1-", "1---0-", "1---1-"]
    properties = uq_properties(spec, samples[0])
    # The aircraft's own bounds may follow the state, so a certain coefficient is switched off and
    # no bound is touched.
    assert {name: value for name, value in properties.items() if name.endswith("/active")} == {
        "uq/active": 1.0,
        "uq/CY/active": 0.0,
        "uq/CZ/active": 0.0,
        "uq/Cl/active": 0.0,
        "uq/Cn/active": 0.0,
    }
    assert not [name for name in properties if name.endswith(("/lower", "/upper"))]
    inputs = 'coefficients = ["Cm", "CX"]\nbounds = { CX = 0.008, Cm = 0.012 }\n'
    constant = read_campaign(campaign_file(tmp_path, CAMPAIGN.partition("bounds =")[0] + inputs))
    properties = uq_properties(constant, epistemic_samples(constant)[0])
    assert (properties["uq/CY/lower"], properties["uq/CY/upper"]) == (0.0, 0.0)


def test_levels_are_a_full_grid_and_none_touches_nothing(tmp_path):
    head = CAMPAIGN.partition("[epistemic]")[0]
    levels = '[epistemic]\nmethod = "levels"\ncoefficients = ["CX", "CZ"]\nlevels = [0, 0.25, 1]\n'
    samples = epistemic_samples(read_campaign(campaign_file(tmp_path, head + levels)))
    assert len(samples) == 9
    assert samples[1].epistemic_id == "0/-/0.25/-/-/-"
    spec = read_campaign(campaign_file(tmp_path, head + '[epistemic]\nmethod = "none"\n'))
    (nominal,) = epistemic_samples(spec)
    assert uq_properties(spec, nominal) == {}


def test_random_numbers_are_common_to_corners_and_conditions(tmp_path):
    text = CAMPAIGN.replace("wind_mps = 3", "wind_mps = [0, 3]").replace(
        '"moderate"', '["light", "severe"]'
    )
    cases = build_cases(read_campaign(campaign_file(tmp_path, text)), MISSION)
    assert len(cases) == 3 * 2 * 2 * 64
    seeds = {
        (case.aleatory_id, case.flight.seed_turbulence, case.flight.seed_noise) for case in cases
    }
    assert len(seeds) == 3
    # Stopped anywhere, corners have flown equally often to within one.
    first = [case.epistemic_id for case in cases[:300]]
    counts = [first.count(name) for name in set(first)]
    assert max(counts) - min(counts) <= 1


def test_case_ids_depend_on_all_that_defines_a_flight(spec):
    base = build_cases(spec, MISSION)[0].case_id
    for change in ({"aircraft_hash": "c" * 64}, {"script_hash": "c" * 64}):
        assert build_cases(spec, dataclasses.replace(MISSION, **change))[0].case_id != base
    for change in (
        {"duration_s": 151.0},
        {"wind_mps": (4.0,)},
        {"turbulence_source": "spec"},
        {"sensor_noise": False},
    ):
        other = dataclasses.replace(spec, aleatory=spec.aleatory.model_copy(update=change))
        assert build_cases(other, MISSION)[0].case_id != base, change
    # Where files lie, and how many flights follow, do not define a flight.
    moved = dataclasses.replace(
        MISSION, aircraft=Path("elsewhere/plane"), script=Path("elsewhere/loiter.xml")
    )
    assert build_cases(spec, moved)[0].case_id == base
    more = dataclasses.replace(spec, aleatory=spec.aleatory.model_copy(update={"flights": 9}))
    assert build_cases(more, MISSION)[0].case_id == base


def cases(tmp_path, flights=6, **changes):
    spec = fakes.small_spec(tmp_path, flights, **changes)
    return build_cases(spec, Mission(spec.path, "a" * 64, spec.path, "b" * 64))


def test_every_case_is_in_one_group_of_one_condition(tmp_path):
    every = cases(tmp_path, wind_mps=(0.0, 3.0))
    by_id = {case.case_id: case for case in every}
    groups = group_cases(every, 2)
    flight = [case_id for group in groups for case_id, _ in group.cases]
    assert sorted(flight) == sorted(by_id)
    for group in groups:
        assert len({by_id[case_id].wind_mps for case_id, _ in group.cases}) == 1
        # Whole airs side by side.
        assert len(group.cases) % 64 == 0
        airs = [by_id[case_id].aleatory_id for case_id, _ in group.cases]
        assert airs == sorted(airs)
    assert groups[0].cases[0][0] == every[0].case_id
    assert len(groups) >= 4, "two workers have something to do"
