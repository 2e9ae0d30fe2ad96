"""Turn the table of flights into samples, p-boxes and excursion rates per condition.

A condition is one cell of the grid wind x turbulence. Within it each epistemic sample (corner)
gives one empirical distribution of a metric; the p-box is their envelope. Nothing here writes a
file. The column names of the metrics are defined here as well.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from uqharness.errors import BadInputError
from uqharness.flight import TURBULENCE_W20_KT
from uqharness.statistics import ExcursionRate, PBox, Sample, excursion_rate
from uqharness.statistics.pbox import pbox

# Column names of the metrics.

ERROR_METRICS = tuple(
    f"{quantity}_{statistic}_{unit}{suffix}"
    for suffix in ("", "_measured")
    for quantity, unit in (("cross_track", "m"), ("altitude", "m"), ("speed", "mps"))
    for statistic in ("median", "mean", "max")
)
"""Statistics of the absolute error over a flight, of the true error and (``_measured``) of the
error as the noisy sensors report it.
"""

PATHLESS_METRICS = (
    "heading_median_deg",
    "heading_mean_deg",
    "heading_max_deg",
    "load_factor_max",
)
"""Metrics of a flight without a commanded path."""

OPTIONAL_METRICS = (*PATHLESS_METRICS,)
"""Metrics whose columns a campaign has only if its flights computed them. A new metric belongs
here: in ``ERROR_METRICS`` it would make earlier campaign tables unreadable.
"""


def requested_metrics(
    frame: pd.DataFrame, names: Iterable[str], default: Iterable[str], path: Path
) -> tuple[str, ...]:
    """Return the requested metrics, or the default ones that the table of ``path`` has.

    Raises
    ------
    BadInputError
        For a requested column that is no metric, or a metric without a value.
    """
    available = [
        name
        for name in (*ERROR_METRICS, *OPTIONAL_METRICS)
        if name in frame and frame[name].notna().any()
    ]
    requested = tuple(names) or tuple(name for name in default if name in available)
    unknown = [name for name in requested if name not in available]
    if unknown:
        raise BadInputError(f"--metric {unknown[0]}: not in {path}; it has {', '.join(available)}")
    return requested


def excursion_columns(radii_m: Iterable[float]) -> tuple[str, ...]:
    """Return the column names of the excursion counts: horizontal distance first, then 3-D."""
    radii = tuple(radii_m)
    return tuple(
        excursion_column(radius, distance) for distance in ("horizontal", "3d") for radius in radii
    )


def excursion_column(radius_m: float, distance: str) -> str:
    """Return the column name of the excursions beyond one radius [m]; ``distance`` is horizontal or
    3d.
    """
    return f"excursions_{radius_m:g}m" + ("_3d" if distance == "3d" else "")


def counted_radii(metrics: Mapping[str, Any]) -> tuple[float, ...]:
    """Return the radii [m] at which a campaign counts excursions.

    ``metrics`` is the section [metrics] as plain types. Radii with an acceptable rate come first,
    then those that only measure dispersion.
    """
    return (
        *map(float, metrics["excursion_radius_m"]),
        *map(float, metrics.get("dispersion_radius_m") or ()),
    )


CONFIDENCE = 0.95
"""Confidence of all limits and bands of a campaign's tables."""


@dataclass(frozen=True)
class Condition:
    """One cell of the wind x turbulence grid.

    Attributes
    ----------
    wind_mps : float
        Mean wind [m/s].
    turbulence : str
        Intensity: none, light, moderate or severe.

    Examples
    --------
    >>> Condition(3.0, "moderate").label
    '3 m/s moderate'
    """

    wind_mps: float
    turbulence: str

    @property
    def label(self) -> str:
        """The condition as tables write it: ``3 m/s moderate``."""
        return f"{self.wind_mps:g} m/s {self.turbulence}"

    @property
    def words(self) -> str:
        """The condition as sentences write it: ``3 m/s wind and moderate turbulence``."""
        air = "no" if self.turbulence == "none" else self.turbulence
        return f"{self.wind_mps:g} m/s wind and {air} turbulence"


@dataclass(frozen=True)
class ExcursionCell:
    """Excursion rates of all corners in one condition, for one radius [m] and one
    distance.

    ``distance`` is horizontal or 3d.
    """

    condition: Condition
    radius_m: float
    distance: str
    rates: tuple[ExcursionRate, ...]


def hardest_condition(candidates: Iterable[Condition]) -> Condition:
    """Return the condition with the strongest turbulence and, within it, the strongest wind."""
    order = tuple(TURBULENCE_W20_KT)
    return max(candidates, key=lambda item: (order.index(item.turbulence), item.wind_mps))


def conditions(frame: pd.DataFrame) -> list[Condition]:
    """Return the conditions of a case table in the order of the table."""
    pairs = frame[["wind_mps", "turbulence"]].drop_duplicates()
    return [
        Condition(float(wind), str(air))
        for wind, air in zip(pairs["wind_mps"], pairs["turbulence"], strict=True)
    ]


def in_condition(frame: pd.DataFrame, condition: Condition) -> pd.DataFrame:
    """Return the rows of one condition."""
    return frame[
        (frame["wind_mps"] == condition.wind_mps) & (frame["turbulence"] == condition.turbulence)
    ]


def samples(frame: pd.DataFrame, metric: str) -> list[Sample]:
    """Return one sample of a metric per epistemic id, from the rows of one condition.

    Parameters
    ----------
    frame : DataFrame
        Rows of cases.parquet of one condition.
    metric : str
        Column name.

    Returns
    -------
    list of Sample
        Known values first. A flight that failed, or has no value, is counted as unknown: dropping
        it
        would make the distribution look better than it is.
    """
    values = frame[metric].to_numpy(dtype=float)
    is_valid = np.isfinite(values) & (frame["status"] == "ok").to_numpy()
    corner_index, names = pd.factorize(frame["epistemic_id"])
    # One stable sort replaces a groupby per metric: rows of each corner stay in the order of the
    # table.
    order = np.argsort(corner_index, kind="stable")
    edges = np.searchsorted(corner_index[order], np.arange(len(names) + 1))
    corner_rows = [order[begin:end] for begin, end in pairwise(edges)]
    aleatory_ids = frame["aleatory_id"].to_numpy() if "aleatory_id" in frame else None
    result = []
    for name, rows in zip(names, corner_rows, strict=True):
        # Known values first, then the flights without one.
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
    """Yield the p-boxes of a case table, metric by metric and condition by condition.

    Parameters
    ----------
    frame : DataFrame
        Rows of cases.parquet.
    confidence : float
        Confidence of the band that accounts for the finite number of flights.

    Yields
    ------
    tuple of (str, Condition, PBox)
        A metric without a value in any flight is left out.
    """
    for metric in (*ERROR_METRICS, *(name for name in OPTIONAL_METRICS if name in frame)):
        for condition in conditions(frame):
            corner_samples = samples(in_condition(frame, condition), metric)
            if any(sample.values.size for sample in corner_samples):
                yield metric, condition, pbox(corner_samples, confidence)


def excursion_cells(frame: pd.DataFrame, radii_m: Iterable[float]) -> list[ExcursionCell]:
    """Return the excursion rates of all corners by condition, distance and radius [m].

    A radius that the flights did not count (no 3-D distance, no commanded path) is left out.
    """
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
        # Counts are NaN for flights without them; the corner's hours and failures are common to all
        # radii.
        corners = [
            _Corner(name, at, int(failed[at].sum()), float(scored_s[at].sum()) / 3600.0)
            for name, at in by_corner
        ]
        # 3-D distances are separate columns with a suffix.
        for distance in ("horizontal", "3d"):
            for radius in radii_m:
                column = excursion_column(radius, distance)
                if _not_measured(rows, column, distance):
                    continue
                counts = rows[column].to_numpy(dtype=float, na_value=np.nan)
                rates = tuple(corner.rate(counts, len(corners)) for corner in corners)
                cells.append(ExcursionCell(condition, float(radius), distance, rates))
    return cells


def _not_measured(rows: pd.DataFrame, column: str, distance: str) -> bool:
    """Return whether the aircraft does not report this count at all.

    A flight that ended well always has the counts of its aircraft, so an empty column with good
    flights means that the aircraft lacks the channel. Failed flights alone do not show it.
    """
    ended_well = rows[rows["status"] == "ok"]
    unknown = bool(rows[column].isna().all())
    return unknown and (distance == "3d" or len(ended_well) > 0)


@dataclass(frozen=True)
class _Corner:
    """One corner's rows of a condition, its failed flights and its scored time [h]."""

    name: str
    places: NDArray[np.intp]
    failed: int
    hours: float

    def rate(self, counts: NDArray[np.float64], corners: int) -> ExcursionRate:
        """Return the excursion rate of the corner from the counts (n,) of the condition's rows."""
        known_counts = [None if np.isnan(count) else int(count) for count in counts[self.places]]
        return excursion_rate(self.name, known_counts, self.failed, self.hours, corners, CONFIDENCE)
