"""Apportion the p-box of a finished corner campaign to the uncertain coefficients.

For each metric and condition the corner pairs that differ in one coefficient give the share of the
p-box's width that the coefficient causes (the counterpart of Table 4.7 of the dissertation). The
results go to sensitivity.csv and JSON; `find_winner` returns the coefficient whose uncertainty
matters most for a metric over all conditions.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from sysid.arrays import FloatArray
from uqharness.campaign.conditions import (
    ERROR_METRICS,
    OPTIONAL_METRICS,
    Condition,
    conditions,
    excursion_columns,
    in_condition,
)
from uqharness.campaign.manifest import read_complete
from uqharness.campaign.sampling import INTERIOR_MARK, NOMINAL
from uqharness.campaign.statements import format_number
from uqharness.campaign.tables import CASES, read_cases, read_checked
from uqharness.errors import BadInputError
from uqharness.flight import COEFFICIENTS, TURBULENCE_W20_KT
from uqharness.results.campaign import MetricShares
from uqharness.sensitivity import Evaluations, MethodResult, PairRange, Study
from uqharness.sensitivity.measures import Ranking, corner_pairs, rank, unit_of, words
from uqharness.sensitivity.study import corners as box_corners
from uqharness.text_tables import csv_rows

MAX_LEFT_OUT = 0.1
"""Largest share of aleatory samples that may be left out because one of their flights failed at
some corner.
"""

_RANKS_BY = ("levels", "corners")
"""Epistemic methods that fly corners."""


@dataclass(frozen=True)
class CornerCampaign:
    """The flights of one campaign: its folder, case table and manifest."""

    folder: Path
    frame: pd.DataFrame
    manifest: Mapping[str, Any]

    @property
    def coefficients(self) -> tuple[str, ...]:
        """Names with a column of levels: uncertain coefficients, then variables with an uncertain
        mean.
        """
        campaign = self.manifest["campaign"]
        variables = campaign["aleatory"].get("variables", {})
        means = [name for name, item in variables.items() if isinstance(item.get("mean"), list)]
        return (*campaign["epistemic"]["coefficients"], *means)

    @property
    def levels(self) -> FloatArray:
        """Levels (flights, d) of the coefficients, 0 at the lower bound, 1 at the upper."""
        return self.frame[[f"level_{name}" for name in self.coefficients]].to_numpy(dtype=float)


@dataclass(frozen=True)
class _LevelFlights:
    """Flights of one condition by their levels.

    Attributes
    ----------
    keys : tuple of tuple of float
        Levels (n, d) of the groups.
    places : array
        Rows of the case table (n, A), ordered by aleatory id.
    is_valid : array
        Whether a flight did not fail (n, A).
    """

    keys: tuple[tuple[float, ...], ...]
    places: NDArray[np.intp]
    is_valid: NDArray[np.bool_]

    def values(self, campaign: CornerCampaign, metric: str) -> FloatArray:
        """Return a metric (n, A); NaN where a flight failed. Raises BadInputError for an unknown
        metric.
        """
        if metric not in campaign.frame:
            raise BadInputError(
                f"metric {metric}: not in {campaign.folder / CASES}; it has"
                f" {', '.join(metrics_of(campaign))}"
            )
        return np.where(
            self.is_valid, campaign.frame[metric].to_numpy(dtype=float)[self.places], np.nan
        )


@dataclass(frozen=True)
class _ConditionFlights:
    """One campaign in one condition: its corners and levels, and its interior points."""

    campaign: CornerCampaign
    levels: _LevelFlights
    points: _LevelFlights

    @staticmethod
    def read(campaign: CornerCampaign, condition: Condition) -> _ConditionFlights:
        """Group the flights of a condition.

        Raises BadInputError if the combinations of levels did not fly the same aleatory samples.
        """
        return _ConditionFlights(
            campaign,
            *(_group_by_levels(campaign, condition, interior) for interior in (False, True)),
        )


@dataclass(frozen=True)
class MetricSensitivity:
    """The sensitivity of one metric in one condition.

    Attributes
    ----------
    condition : Condition
        Wind and turbulence.
    metric : str
        Column name.
    result : MethodResult
        Shares of the p-box by coefficient.
    flights, left_out : int
        Aleatory samples used, and those left out because a flight failed or lacks a value at some
        corner.
    ranking : Ranking
        Coefficients in order, and whether the first is certain.
    words : str
        The result as a sentence.
    """

    condition: Condition
    metric: str
    result: MethodResult
    flights: int
    left_out: int
    ranking: Ranking
    words: str


def read_corner_campaign(folder: Path) -> CornerCampaign:
    """Read a campaign that flew all corners.

    Raises BadInputError if it is not complete, flew no corners, flew an ellipsoid, or drew
    parameters.
    """
    campaign = _read_campaign(folder)
    epistemic = campaign.manifest["campaign"]["epistemic"]
    # Corners are combinations of the levels 0 and 1.
    method, levels = epistemic["method"], epistemic.get("levels")
    if method not in _RANKS_BY or (method == "levels" and not {0.0, 1.0} <= set(levels or ())):
        description = f'method = "{method}"' + (
            f" with levels {levels}" if method == "levels" else ""
        )
        raise BadInputError(
            f"{folder}: not a corner campaign ({description}); sensitivity compares corners: run"
            ' one with method = "corners", or "levels" that include 0 and 1'
        )
    if epistemic["set"] != "box":
        raise BadInputError(
            f'{folder}: set = "{epistemic["set"]}" has points of an ellipsoid, but sensitivity'
            ' compares the corners of a box; run one with set = "box"'
        )
    if "parameters" in epistemic:
        raise BadInputError(
            f"{folder}: its corners are combined with draws of [epistemic.parameters], which are no"
            " corners; run one without this section"
        )
    return campaign


def read_interior_campaign(folder: Path, corners: CornerCampaign) -> CornerCampaign:
    """Read a campaign of levels between the bounds that met the same air as ``corners``.

    Raises BadInputError naming what differs.
    """
    # Corners are levels of 0 and 1; the others are in a campaign of levels.
    interior = _read_campaign(folder)
    if interior.manifest["campaign"]["epistemic"]["method"] != "levels":
        raise BadInputError(
            f'{folder}: not a campaign of levels; run one with method = "levels", levels = [0.5]'
        )
    mine, theirs = interior.manifest["campaign"], corners.manifest["campaign"]
    # Both campaigns must share random streams, air, bounds and files.
    different = [key for key in ("seed",) if mine["campaign"][key] != theirs["campaign"][key]]
    different += [
        key
        for key in theirs["aleatory"]
        if key != "flights" and mine["aleatory"].get(key) != theirs["aleatory"][key]
    ]
    different += [
        key
        for key in ("coefficients", "bounds")
        if mine["epistemic"].get(key) != theirs["epistemic"].get(key)
    ]
    different += [
        key
        for key, value in corners.manifest["hashes"].items()
        if interior.manifest["hashes"].get(key) != value
    ]
    # Every air of the corners must have been met.
    if mine["aleatory"]["flights"] < theirs["aleatory"]["flights"]:
        different.append(
            f"flights ({mine['aleatory']['flights']}, at least {theirs['aleatory']['flights']} are"
            " needed)"
        )
    if different:
        raise BadInputError(
            f"{folder}: does not belong to {corners.folder}: {', '.join(different)} differ"
        )
    return interior


def _read_campaign(folder: Path) -> CornerCampaign:
    """Read the manifest and case table of a complete campaign."""
    manifest = read_complete(folder)
    return CornerCampaign(folder, read_cases(folder, manifest), manifest)


def metrics_of(campaign: CornerCampaign) -> tuple[str, ...]:
    """Return the error statistics and excursion counts that a case table has."""
    radii = campaign.manifest["campaign"]["metrics"]["excursion_radius_m"]
    names = (*ERROR_METRICS, *OPTIONAL_METRICS, *excursion_columns(radii))
    return tuple(
        name for name in names if name in campaign.frame and campaign.frame[name].notna().any()
    )


def analyse_campaign(
    campaign: CornerCampaign,
    interior: CornerCampaign | None = None,
    metrics: Sequence[str] | None = None,
    seed: int = 0,
    on_progress: Callable[[int, int], None] | None = None,
) -> list[MetricSensitivity]:
    """Compute the sensitivity of every metric in every condition.

    Parameters
    ----------
    campaign : CornerCampaign
        Flights at the corners.
    interior : CornerCampaign, optional
        Flights at levels between the bounds in the same air; they check the assumption that
        extremes
        lie at corners.
    metrics : sequence of str, optional
        Column names; default: all.
    seed : int
        Seed of the bootstrap.
    on_progress : callable, optional
        Called with the number of finished analyses and their total.

    Returns
    -------
    list of MetricSensitivity
        Condition by condition, metric by metric.

    Raises
    ------
    BadInputError
        If the table is not that of a corner campaign.
    """
    requested = tuple(metrics) if metrics else metrics_of(campaign)
    grid = conditions(campaign.frame)
    results: list[MetricSensitivity] = []
    for condition in grid:
        table = _ConditionFlights.read(campaign, condition)
        between = None if interior is None else _ConditionFlights.read(interior, condition)
        for metric in requested:
            results.append(_analyse(table, between, condition, metric, seed))
            if on_progress is not None:
                on_progress(len(results), len(grid) * len(requested))
    return results


def _analyse(
    table: _ConditionFlights,
    between: _ConditionFlights | None,
    condition: Condition,
    metric: str,
    seed: int,
) -> MetricSensitivity:
    """Compute the sensitivity of one metric in one condition."""
    campaign = table.campaign
    names = campaign.coefficients
    d = len(names)
    # Values by combination of levels; the corners are taken out in standard order.
    values = dict(zip(table.levels.keys, table.levels.values(campaign, metric), strict=True))
    ends = box_corners(np.zeros(d), np.ones(d))
    try:
        y = np.array([values.pop(tuple(corner)) for corner in ends])
    except KeyError as missing:
        raise BadInputError(
            f"{campaign.folder}: no flights of corner {missing} in {condition.words}"
        ) from None
    # What remains are levels between the bounds.
    inside = np.array(list(values.values())) if values else None
    if between is not None:
        interior_values = zip(
            between.levels.keys, between.levels.values(between.campaign, metric), strict=True
        )
        added = np.array(
            [v[: y.shape[1]] for key, v in interior_values if not set(key) <= {0.0, 1.0}]
        )
        if added.size:
            inside = added if inside is None else np.concatenate([inside, added])
    # An aleatory sample counts only if all corners have a value: pairs share their air.
    is_valid = np.all(np.isfinite(y), axis=0)
    if inside is not None:
        is_valid &= np.all(np.isfinite(inside), axis=0)
    inside = _with_points(inside, list(table.points.values(campaign, metric)), is_valid)
    left_out = int(np.count_nonzero(~is_valid))
    # Leave out incomplete aleatory samples, unless they are too many: then the result is undefined.
    if left_out <= MAX_LEFT_OUT * is_valid.size:
        y, inside = y[:, is_valid], None if inside is None else inside[:, is_valid]
    zero, one = np.zeros(d), np.ones(d)
    study = Study(names, zero, one, 0.5 * one, 0.01 * one, np.empty((0, d)), True, {})
    # The study has unit bounds; only its corner pairs are used.
    result = corner_pairs(study, Evaluations(corners=y, interior=inside), seed)
    ranking = rank(result, left_out)
    text = words(result, metric, ranking, left_out, is_valid.size)
    return MetricSensitivity(condition, metric, result, y.shape[1], left_out, ranking, text)


def _with_points(
    inside: FloatArray | None, points: list[FloatArray], is_valid: NDArray[np.bool_]
) -> FloatArray | None:
    """Append the interior points of a campaign to ``inside``.

    They check the corners and do not remove an aleatory sample: a point with a failed flight is
    dropped.
    """
    complete = [point for point in points if np.all(np.isfinite(point[is_valid]))]
    parts = ([] if inside is None else [inside]) + ([np.array(complete)] if complete else [])
    return np.concatenate(parts) if parts else None


def _group_by_levels(
    campaign: CornerCampaign, condition: Condition, interior: bool
) -> _LevelFlights:
    """Group the corners and levels of a condition, or its ``interior`` points, by their levels.

    Raises BadInputError if the groups differ in aleatory samples or duration.
    """
    rows = in_condition(campaign.frame.reset_index(drop=True), condition)
    rows = rows[rows["epistemic_id"].str.startswith(INTERIOR_MARK) == interior]
    # The nominal model has no place in the box of levels.
    rows = rows[~rows["epistemic_id"].str.startswith(NOMINAL)]
    # Group flights by their combination of levels.
    level_names = [f"level_{name}" for name in campaign.coefficients]
    ids = np.sort(rows["aleatory_id"].unique())
    keys, places, complete = [], [], []
    for key, group in rows.groupby(level_names, sort=False):
        ordered = group.sort_values("aleatory_id")
        if not np.array_equal(ordered["aleatory_id"].to_numpy(), ids):
            raise BadInputError(
                f"{campaign.folder}: {condition.words}: not every corner flew the same aleatory"
                " samples"
            )
        ok = (ordered["status"] == "ok").to_numpy()
        # Counts of flights of different length cannot be compared.
        durations = ordered["duration_s"].to_numpy()[ok]
        if durations.size and np.ptp(durations) > 1e-6:
            raise BadInputError(
                f"{campaign.folder}: {condition.words}: flights of unequal duration cannot be"
                " compared"
            )
        keys.append(tuple(np.atleast_1d(np.asarray(key, dtype=float)).tolist()))
        places.append(ordered.index.to_numpy())
        complete.append(ok)
    shape = (len(keys), len(ids))
    return _LevelFlights(
        tuple(keys),
        np.array(places, dtype=np.intp).reshape(shape),
        np.array(complete, dtype=bool).reshape(shape),
    )


# Tables and JSON.

SENSITIVITY = "sensitivity.csv"
COLUMNS = (
    "condition",
    "wind_mps",
    "turbulence",
    "metric",
    "unit",
    "coefficient",
    "share_min",
    "share_max",
    "share_low",
    "share_high",
    "shrink_min",
    "shrink_max",
    "shrink_low",
    "shrink_high",
    "width",
    "width_low",
    "width_high",
    "flights",
    "left_out",
    "interior_outside",
    "reason",
)


def _rows(results: Sequence[MetricSensitivity]) -> Iterator[list[str]]:
    """Yield the rows of sensitivity.csv.

    ``share_low`` and ``share_high`` bound ``share_min`` and ``share_max`` with 95 % confidence for
    all coefficients at once. An undefined number is empty and ``reason`` says why.
    """
    for item in results:
        details = item.result.details
        for i, (name, index) in enumerate(item.result.indices.items()):
            assert isinstance(index, PairRange)
            # Share of the width, how much a coefficient known exactly would shrink it, and the
            # width itself, each with its limits.
            shares = [
                index.minimum.value,
                index.maximum.value,
                index.minimum.low,
                index.maximum.high,
            ]
            shrink = [
                details[key][i] if key in details else math.nan
                for key in ("shrink_min", "shrink_max", "shrink_low", "shrink_high")
            ]
            width = [details.get(key, math.nan) for key in ("area", "area_low", "area_high")]
            yield [
                item.condition.label,
                f"{item.condition.wind_mps:g}",
                item.condition.turbulence,
                item.metric,
                unit_of(item.metric),
                name,
                *map(format_number, [*shares, *shrink, *width]),
                str(item.flights),
                str(item.left_out),
                format_number(details.get("interior_outside", math.nan)),
                index.reason,
            ]


def as_csv(results: Sequence[MetricSensitivity]) -> bytes:
    """Return the content of sensitivity.csv, one row per condition, metric and coefficient."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(COLUMNS)
    writer.writerows(_rows(results))
    return buffer.getvalue().encode()


def shares_by_condition(
    results: Sequence[MetricSensitivity],
) -> dict[str, dict[str, MetricShares]]:
    """Return the results by condition and metric."""
    by_condition: dict[str, dict[str, MetricShares]] = {}
    for item in results:
        by_condition.setdefault(item.condition.label, {})[item.metric] = MetricShares(
            **item.result.as_dict(),
            flights=item.flights,
            left_out=item.left_out,
            first=item.ranking.first or None,
            certain=item.ranking.certain,
            rivals_by_ranges=list(item.ranking.by_ranges),
            rivals_by_sampling=list(item.ranking.by_sampling),
            words=item.words,
        )
    return by_condition


_NUMBERS = (
    "share_min",
    "share_max",
    "share_low",
    "share_high",
    "shrink_min",
    "shrink_max",
    "shrink_low",
    "shrink_high",
)


def read_sensitivity(folder: Path, manifest: Mapping[str, Any]) -> list[dict[str, str]] | None:
    """Return the rows of sensitivity.csv; None if the campaign has no such table. Raises
    BadInputError.
    """
    if SENSITIVITY not in manifest.get("tables", {}) and not (folder / SENSITIVITY).exists():
        return None
    content = read_checked(folder, manifest, SENSITIVITY)
    texts = ("condition", "turbulence", "metric", "coefficient", "reason")
    rows = csv_rows(content, folder / SENSITIVITY, ("wind_mps",), texts, _NUMBERS)
    if any(
        row["turbulence"] not in TURBULENCE_W20_KT
        or bool(row["share_min"]) != bool(row["share_max"])
        for row in rows
    ):
        raise BadInputError(
            f"{folder / SENSITIVITY}: holds what `uqharness sensitivity` does not write; run it"
            " again"
        )
    return rows


# Coefficient that matters most for a metric, over all conditions.

DEFAULT_METRIC = "cross_track_median_m"
"""Metric that `find_winner` ranks by default."""


@dataclass(frozen=True)
class Winner:
    """The coefficient whose uncertainty causes most of a metric's p-boxes.

    Attributes
    ----------
    coefficient, metric : str
        Names.
    share : tuple of float
        Smallest and largest share of the p-box in the condition with the widest one.
    condition : str
        That condition.
    certain : bool
        Whether it is first in every condition, for all values of the others and beyond sampling
        error.
    words : tuple of str
        Sensitivity of each condition as a sentence.
    """

    coefficient: str
    metric: str
    share: tuple[float, float]
    condition: str
    certain: bool
    words: tuple[str, ...]


def find_winner(
    folder: Path,
    metric: str | None = None,
    coefficient: str | None = None,
    seed: int = 0,
    on_progress: Callable[[int, int], None] | None = None,
) -> Winner:
    """Find the coefficient with the largest part of the p-box widths, summed over conditions.

    Parameters
    ----------
    folder : Path
        Complete corner campaign.
    metric : str, optional
        Column name; default: the median cross-track error, or the first metric there is.
    coefficient : str, optional
        Report this coefficient instead of the winner.
    seed : int
        Seed of the bootstrap.
    on_progress : callable, optional
        See `analyse_campaign`.

    Raises
    ------
    BadInputError
        If the folder holds no corner campaign, the metric is unknown, nothing can be compared, or
        the
        winner is not an aerodynamic coefficient.
    """
    campaign = read_corner_campaign(folder)
    available = metrics_of(campaign)
    # Default: cross-track error if there is one, else the first metric.
    chosen = metric or (DEFAULT_METRIC if DEFAULT_METRIC in available else (available or ("",))[0])
    if chosen not in available:
        raise BadInputError(
            f"--metric {chosen}: {folder} has"
            f" {', '.join(available) or 'no metric that any flight got'}"
        )
    results = [
        f
        for f in analyse_campaign(campaign, metrics=[chosen], seed=seed, on_progress=on_progress)
        if f.ranking.first
    ]
    if not results:
        raise BadInputError(
            f"{folder}: no sensitivity of {chosen} (uqharness sensitivity {folder} gives the"
            " reason); run more flights, choose another --metric, or name a --coefficient"
        )
    parts: dict[str, float] = {}
    for item in results:
        for name, index in item.result.indices.items():
            assert isinstance(index, PairRange)
            # Weight the middle of the share by the width of the p-box of the condition.
            middle = 0.5 * (index.minimum.value + index.maximum.value)
            parts[name] = parts.get(name, 0.0) + middle * float(item.result.details["area"])
    # The winner has the largest sum of share times width.
    largest = max(parts, key=lambda name: parts[name])
    name = coefficient or largest
    if name not in parts:
        raise BadInputError(
            f"--coefficient {name}: not uncertain in {folder}; there are {', '.join(parts)}"
        )
    if name not in COEFFICIENTS:
        raise BadInputError(
            f"{folder}: {name} drives {chosen}; it is not an aerodynamic coefficient:"
            " measure it. For the aerodynamic coefficient that matters most name it:"
            " --coefficient C"
        )
    widest = max(results, key=lambda f: float(f.result.details["area"]))
    index = widest.result.indices[name]
    assert isinstance(index, PairRange)
    return Winner(
        name,
        chosen,
        (index.minimum.value, index.maximum.value),
        widest.condition.label,
        all(f.ranking.first == name and f.ranking.certain for f in results),
        tuple(f"{f.condition.words}: {f.words}" for f in results),
    )
