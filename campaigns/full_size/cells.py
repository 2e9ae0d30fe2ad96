"""What flew in one cell, as the analyses of corner campaigns take it, and airs that two cells have in common."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from campaigns.full_size.folder import Line, cell_table
from campaigns.full_size.plan import Plan, cell_name
from uqharness.campaign.conditions import Condition
from uqharness.campaign.sensitivity import CornerCampaign
from uqharness.errors import BadInputError


def flown_cell(plan: Plan, shards: Path, condition: Condition) -> tuple[CornerCampaign, list[Line]]:
    """The flights of a condition that are there, and the lines of their shards. Raises BadInputError as ``cell_table`` does."""
    frame, used = cell_table(plan, shards, condition)
    return CornerCampaign(
        shards / cell_name(condition), frame, {"campaign": plan.spec.as_dict()}
    ), used


def common_airs(first: pd.DataFrame, second: pd.DataFrame) -> tuple[pd.DataFrame, pd.DataFrame]:
    """The flights of both tables in the airs that every sample flew: those of each that most of its samples flew, and both have.

    A round of samples that is not complete is left out, so that all fly the same airs. Raises BadInputError where none is common.
    """
    airs = np.intersect1d(_whole(first), _whole(second))
    if not airs.size:
        raise BadInputError(
            "the two campaigns have no air in common; fly shards of the same numbers, with the same seed"
        )
    return first[first["aleatory_id"].isin(airs)], second[second["aleatory_id"].isin(airs)]


def _whole(frame: pd.DataFrame) -> np.ndarray:
    flown = frame.groupby("aleatory_id")["epistemic_id"].nunique()
    return np.asarray(flown.index[flown == flown.max()])


def hours_each(frame: pd.DataFrame) -> float:
    """Scored hours of a table per epistemic sample."""
    return float(frame["duration_s"].sum()) / 3600.0 / frame["epistemic_id"].nunique()
