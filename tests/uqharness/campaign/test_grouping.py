"""Groups for the batch engine: every case once, one condition each, airs whole, of a size that a
worker flies in some 20 s.
"""

from __future__ import annotations

from dataclasses import replace

import pytest

from tests.helpers import campaign_fakes as fakes
from uqharness.campaign.cases import (
    FLIGHT_S_PER_CORE_S,
    GROUP_S,
    MAX_LANES,
    Mission,
    build_cases,
    group_cases,
)


def cases(tmp_path, flights=6, **changes):
    spec = fakes.small_spec(tmp_path, flights, **changes)
    return build_cases(spec, Mission(spec.path, "a" * 64, spec.path, "b" * 64))


def test_every_case_is_in_one_group_of_one_condition(tmp_path):
    every = cases(tmp_path, wind_mps=(0.0, 3.0))
    by_id = {case.case_id: case for case in every}
    groups = group_cases(every, 2)
    flown = [case_id for group in groups for case_id, _ in group.cases]
    assert sorted(flown) == sorted(by_id)
    for group in groups:
        assert len({by_id[case_id].wind_mps for case_id, _ in group.cases}) == 1
        # Whole airs side by side.
        assert len(group.cases) % 64 == 0
        airs = [by_id[case_id].aleatory_id for case_id, _ in group.cases]
        assert airs == sorted(airs)
    assert groups[0].cases[0][0] == every[0].case_id
    assert len(groups) >= 4, "two workers have something to do"


@pytest.mark.parametrize(
    ("duration_s", "most"), [(150.0, MAX_LANES), (3600.0, 491), (86_000.0, 20)]
)
def test_a_group_takes_no_longer_than_meant(tmp_path, duration_s, most):
    groups = group_cases(cases(tmp_path, 40, duration_s=duration_s), 1)
    lanes = max(len(group.cases) for group in groups)
    assert lanes <= most
    assert lanes * (duration_s + 60.0) / FLIGHT_S_PER_CORE_S <= GROUP_S
    assert group_cases([], 1) == []


def test_what_is_left_of_a_round_may_be_odd(tmp_path):
    every = cases(tmp_path, 4)[5:200]
    flown = [case_id for group in group_cases(every, 3) for case_id, _ in group.cases]
    assert sorted(flown) == sorted(case.case_id for case in every)
    assert group_cases(every[:1], 8)[0].cases == ((every[0].case_id, every[0].flight),)
    assert group_cases([replace(every[0])], 1)[0].engine == "batch"
