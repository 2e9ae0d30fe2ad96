"""From the table of flights to p-boxes and excursion rates by condition. Writes nothing."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from uqharness.flight import TURBULENCE_W20_KT
from uqharness.statistics import ExcursionRate, PBox, Sample, excursion_rate
from uqharness.statistics.pbox import pbox

# Names of the columns that a campaign's flights are scored by.

ERROR_METRICS = tuple(
    f"{quantity}_{statistic}_{unit}{suffix}"
    for suffix in ("", "_measured")
    for quantity, unit in (("cross_track", "m"), ("altitude", "m"), ("speed", "mps"))
    for statistic in ("median", "mean", "max")
)
"""Statistics of |error| over a flight, true and (``_measured``) as the noise-laden sensors
saw it.
"""

UNCOMMANDED_METRICS = (
    "heading_median_deg",
    "heading_mean_deg",
    "heading_max_deg",
    "load_factor_max",
)
"""What a flight without a commanded path is scored by besides; columns only of a campaign that has
them.
"""


def excursion_columns(radii_m: Iterable[float]) -> tuple[str, ...]:
    """Names of the excursion counts: horizontal distance first, then the 3-D ones."""
    radii = tuple(radii_m)
    return tuple(
        excursion_column(radius, distance) for distance in ("horizontal", "3d") for radius in radii
    )


def excursion_column(radius_m: float, distance: str) -> str:
    """Name of the excursion counts beyond one radius; ``distance``: horizontal or 3d."""
    return f"excursions_{radius_m:g}m" + ("_3d" if distance == "3d" else "")


def counted_radii(metrics: Mapping[str, Any]) -> tuple[float, ...]:
    """Radii [m] at which a campaign counts excursions, from its section [metrics] as plain types:
    asked about, then the others.
    """
    return (
        *map(float, metrics["excursion_radius_m"]),
        *map(float, metrics.get("dispersion_radius_m") or ()),
    )


CONFIDENCE = 0.95


@dataclass(frozen=True)
class Condition:
    """One cell of the wind x turbulence grid."""

    wind_mps: float
    turbulence: str

    @property
    def label(self) -> str:
        """The condition as tables name it: ``3 m/s moderate``."""
        return f"{self.wind_mps:g} m/s {self.turbulence}"

    @property
    def words(self) -> str:
        """The condition as a sentence names it."""
        air = "no" if self.turbulence == "none" else self.turbulence
        return f"{self.wind_mps:g} m/s wind and {air} turbulence"


@dataclass(frozen=True)
class ExcursionCell:
    """Rates of all corners in one condition, for one radius and one way of measuring distance."""

    condition: Condition
    radius_m: float
    distance: str
    rates: tuple[ExcursionRate, ...]


def hardest_condition(candidates: Iterable[Condition]) -> Condition:
    """The strongest turbulence, in it the strongest wind."""
    order = tuple(TURBULENCE_W20_KT)
    return max(candidates, key=lambda item: (order.index(item.turbulence), item.wind_mps))


def conditions(frame: pd.DataFrame) -> list[Condition]:
    """Conditions of a case table, in its order."""
    pairs = frame[["wind_mps", "turbulence"]].drop_duplicates()
    return [
        Condition(float(wind), str(air))
        for wind, air in zip(pairs["wind_mps"], pairs["turbulence"], strict=True)
    ]


def in_condition(frame: pd.DataFrame, condition: Condition) -> pd.DataFrame:
    """The rows of one condition."""
    return frame[
        (frame["wind_mps"] == condition.wind_mps) & (frame["turbulence"] == condition.turbulence)
    ]


def samples(frame: pd.DataFrame, metric: str) -> list[Sample]:
    """One sample per epistemic id from the rows of one condition; an unknown value of a flight is
    counted, not dropped.
    """
    values = frame[metric].to_numpy(dtype=float)
    is_valid = np.isfinite(values) & (frame["status"] == "ok").to_numpy()
    corner_index, names = pd.factorize(frame["epistemic_id"])
    order = np.argsort(corner_index, kind="stable")
    edges = np.searchsorted(corner_index[order], np.arange(len(names) + 1))
    corner_rows = [order[begin:end] for begin, end in pairwise(edges)]
    aleatory_ids = frame["aleatory_id"].to_numpy() if "aleatory_id" in frame else None
    result = []
    for name, rows in zip(names, corner_rows, strict=True):
        valid_rows, invalid_rows = rows[is_valid[rows]], rows[~is_valid[rows]]
        flight_airs = (
            None
            if aleatory_ids is None
            else aleatory_ids[np.concatenate([valid_rows, invalid_rows])]
        )
        result.append(Sample(str(name), values[valid_rows], invalid_rows.size, flight_airs))
    return result


def pboxes(
    frame: pd.DataFrame, confidence: float = CONFIDENCE
) -> Iterator[tuple[str, Condition, PBox]]:
    """Every p-box of a case table: metric by metric, condition by condition.

    A metric that no flight has is left out.
    """
    for metric in (*ERROR_METRICS, *(name for name in UNCOMMANDED_METRICS if name in frame)):
        for condition in conditions(frame):
            corner_samples = samples(in_condition(frame, condition), metric)
            if any(sample.values.size for sample in corner_samples):
                yield metric, condition, pbox(corner_samples, confidence)


def excursion_cells(frame: pd.DataFrame, radii_m: Iterable[float]) -> list[ExcursionCell]:
    """Excursion rates of all corners by condition, distance and radius."""
    cells = []
    for condition in conditions(frame):
        rows = in_condition(frame, condition)
        places = rows.groupby("epistemic_id", sort=False).indices
        failed = (rows["status"] != "ok").to_numpy(dtype=bool)
        scored_s = rows["duration_s"].to_numpy(dtype=float)
        by_corner = [
            (str(name), np.asarray(places[name], dtype=np.intp))
            for name in rows["epistemic_id"].unique()
        ]
        corners = [
            _Corner(name, at, int(failed[at].sum()), float(scored_s[at].sum()) / 3600.0)
            for name, at in by_corner
        ]
        for distance, suffix in (("horizontal", ""), ("3d", "_3d")):
            for radius in radii_m:
                column = f"excursions_{radius:g}m{suffix}"
                if _not_measured(rows, column, distance):
                    continue
                counts = rows[column].to_numpy(dtype=float, na_value=np.nan)
                rates = tuple(corner.rate(counts, len(corners)) for corner in corners)
                cells.append(ExcursionCell(condition, float(radius), distance, rates))
    return cells


def _not_measured(rows: pd.DataFrame, column: str, distance: str) -> bool:
    """Whether no flight of this aircraft has that count: one that ended well lacks it.

    Failed flights alone tell nothing.
    """
    ended_well = rows[rows["status"] == "ok"]
    unknown = bool(rows[column].isna().all())
    return unknown and (distance == "3d" or len(ended_well) > 0)


@dataclass(frozen=True)
class _Corner:
    """A corner's flights among a condition's rows, how many of them failed and how long they were
    to last.
    """

    name: str
    places: NDArray[np.intp]
    failed: int
    hours: float

    def rate(self, counts: NDArray[np.float64], corners: int) -> ExcursionRate:
        known_counts = [None if np.isnan(count) else int(count) for count in counts[self.places]]
        return excursion_rate(self.name, known_counts, self.failed, self.hours, corners, CONFIDENCE)
