"""Flights that were aborted: loss of control, ground contact, divergence, or a flight that ended for a reason of its own.

What such a flight would have done in the rest of its time is not known, so its rate has an acceptable size of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sysid.arrays import FloatArray
from uqharness.campaign.execution import CaseOutcome
from uqharness.flight import FlightSpec
from uqharness.statistics import upper_limits

LOSS_OF_CONTROL, GROUND_CONTACT, DIVERGED, OTHER = (
    "loss_of_control",
    "ground_contact",
    "diverged",
    "other",
)
KINDS = (LOSS_OF_CONTROL, GROUND_CONTACT, DIVERGED, OTHER)
"""Each aborted flight is of one kind: how it ended, else that control was lost and it flew on."""
_BY_STATUS = {
    "ground-contact": GROUND_CONTACT,
    "diverged": DIVERGED,
    "crashed": OTHER,
    "timeout": OTHER,
}


@dataclass(frozen=True)
class Aborted:
    """Aborted flights of one condition, per corner and flight (c, n), NaN where a corner flew fewer.

    ``lost``: 1 where the flight was aborted; ``missing``: the share of its time that was not flown; ``kinds``: how many there are.
    """

    lost: FloatArray
    missing: FloatArray
    kinds: dict[str, int]

    @property
    def total(self) -> int:
        """Aborted flights of all corners."""
        return int(np.nansum(self.lost))

    @property
    def missing_shares(self) -> FloatArray:
        """Flights' worth of time that was not flown, per corner (c,)."""
        found: FloatArray = np.nansum(self.missing, axis=1)
        return found

    def upper(self, error: float, assumed: float | None) -> FloatArray:
        """Upper limits (c,) of aborted flights per flight's length flown, each missed with probability ``error`` at most.

        A flight is aborted once, so its count clusters no more than independent ones do.
        """
        flights, total = (
            np.isfinite(self.lost).sum(axis=1).astype(float),
            np.nansum(self.lost, axis=1),
        )
        return upper_limits(
            flights, total, np.ones_like(total), error, assumed, self.missing_shares
        )


def aborted_flight(outcome: CaseOutcome, flight: FlightSpec) -> tuple[float, float]:
    """Whether a flight was aborted, 1 or 0, and the share of its scored time that it did not fly."""
    if outcome.status == "ok":
        return float(outcome.metrics.get(LOSS_OF_CONTROL, 0.0) > 0.0), 0.0
    scored_s = min(max(outcome.flown_s - flight.burn_in_s, 0.0), flight.duration_s)
    return 1.0, 1.0 - scored_s / flight.duration_s


def aborted(groups: Sequence[Any], duration_s: float) -> Aborted:
    """From a condition's rows of a case table, one group a corner."""
    lost, missing = np.full((2, len(groups), max(len(group) for group in groups)), np.nan)
    kinds = dict.fromkeys(KINDS, 0)
    for row, group in enumerate(groups):
        ended = [_BY_STATUS.get(str(status), "") for status in group["status"]]
        flags = [0.0] * len(group)
        if LOSS_OF_CONTROL in group:
            flags = np.nan_to_num(
                group[LOSS_OF_CONTROL].to_numpy(dtype=float, na_value=np.nan)
            ).tolist()
        found = [
            kind or (LOSS_OF_CONTROL if flag else "")
            for kind, flag in zip(ended, flags, strict=True)
        ]
        for kind in filter(None, found):
            kinds[kind] += 1
        flown = np.clip(group["duration_s"].to_numpy(dtype=float) / duration_s, 0.0, 1.0)
        lost[row, : len(group)] = [float(bool(kind)) for kind in found]
        missing[row, : len(group)] = np.where([bool(kind) for kind in ended], 1.0 - flown, 0.0)
    return Aborted(lost, missing, kinds)
