"""Which cases the batch engine flies together: all corners in the same air side by side, several airs of one condition."""

from __future__ import annotations

import math
from collections.abc import Sequence

from uqharness.campaign.cases import Case
from uqharness.campaign.execution.flying import BATCH
from uqharness.campaign.execution.worker import Group

GROUP_S = 20.0
"""Core time that a group should take: a kill loses no more, and what a worker does once a group does not show."""
FLOWN_PER_CORE = 90_000.0
"""Flight time over core time of the batch engine, roughly; only sizes of groups depend on it."""
MOST_LANES = 1024
LEAST_LANES = 64
"""Below that vectors and steps are badly used."""
_GROUPS_PER_WORKER = 4


def lanes_of(cases: Sequence[Case], workers: int) -> int:
    """Cases to fly together: some 20 s of a core, and a few groups for every worker where there are cases enough."""
    flight = cases[0].flight
    by_time = GROUP_S * FLOWN_PER_CORE / (flight.duration_s + flight.burn_in_s)
    by_worker = math.ceil(len(cases) / (_GROUPS_PER_WORKER * max(workers, 1)))
    return min(MOST_LANES, max(1, int(by_time)), max(LEAST_LANES, by_worker))


def groups_of(cases: Sequence[Case], workers: int) -> list[Group]:
    """Cases of one condition each, in case order; the largest groups first, so that no worker waits long for the last."""
    if not cases:
        return []
    lanes = lanes_of(cases, workers)
    corners = len({case.epistemic_id for case in cases})
    if lanes > corners:
        # Whole airs: streams of air and noise are made once for all who fly in it.
        lanes -= lanes % corners
    place = {case.case_id: number for number, case in enumerate(cases)}
    by_condition: dict[tuple[float, str], list[Case]] = {}
    for case in cases:
        by_condition.setdefault((case.wind_mps, case.turbulence), []).append(case)
    groups = [
        Group(BATCH, tuple((case.case_id, case.flight) for case in members[first : first + lanes]))
        for members in by_condition.values()
        for first in range(0, len(members), lanes)
    ]
    return sorted(groups, key=lambda group: (-len(group.cases), place[group.cases[0][0]]))
