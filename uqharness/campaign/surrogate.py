"""The real autopilot as a check of the built-in one: paired flights of a campaign's cases.

`fly_pairs` flies some cases of a complete campaign again with the real autopilot, in the same air,
with the same noise and the same epistemic member. `control_variate` takes the campaign's many
flights as the control variate of these few: the real metric is a line of the surrogate's, and what
the line leaves is scatter.

Source: B. L. Nelson, Control Variate Remedies, Operations Research 38(6), 1990; the line's limits
are those of a regression's mean response.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from sysid.arrays import FloatArray
from sysid.distributions import student_quantile
from uqharness.campaign.cases import Case, build_cases
from uqharness.campaign.conditions import (
    ERROR_METRICS,
    OPTIONAL_METRICS,
    Condition,
    conditions,
    hardest_condition,
    in_condition,
    requested_metrics,
)
from uqharness.campaign.engines import make_copy, needs_copy
from uqharness.campaign.manifest import (
    describe,
    read_manifest,
    refuse_if_different,
    refuse_without_digests,
    spec_of,
)
from uqharness.campaign.processes import CaseOutcome, ProcessExecutor
from uqharness.campaign.run import find_mission
from uqharness.campaign.tables import CASES, read_cases
from uqharness.errors import BadInputError
from uqharness.flight import AutopilotSettings, FlightResult, FlightSpec
from uqharness.flight.fly import fly
from uqharness.statistics import Sample
from uqharness.statistics.pbox import pbox

PROBABILITIES = (0.05, 0.25, 0.5, 0.75, 0.95)
FEWEST_PAIRS = 4
"""A line and its scatter need two more flights than it has parameters."""
DEFAULT_METRICS = tuple(
    name
    for name in (*ERROR_METRICS, *OPTIONAL_METRICS)
    if "median" in name and not name.endswith("_measured")
)
"""Metrics that are compared by default."""


@dataclass(frozen=True)
class RealAutopilot:
    """Fly and score a case with the real autopilot; runs in a separate process."""

    settings: AutopilotSettings

    def __call__(self, spec: FlightSpec) -> FlightResult:
        """Fly the case."""
        return fly(spec, autopilot=self.settings)


@dataclass(frozen=True)
class Pairs:
    """Flights of the same cases with both autopilots.

    Attributes
    ----------
    condition : Condition
        Wind and turbulence of the cases.
    rows : DataFrame
        The campaign's rows of the condition.
    cases : tuple of Case
        The cases that the real autopilot flew.
    outcomes : tuple of CaseOutcome
        What it made of them, in the same order.
    metrics : tuple of str
        Metrics to compare.
    """

    condition: Condition
    rows: pd.DataFrame
    cases: tuple[Case, ...]
    outcomes: tuple[CaseOutcome, ...]
    metrics: tuple[str, ...]


@dataclass(frozen=True)
class Correction:
    """One metric with both autopilots, and the p-box that the real one has.

    Attributes
    ----------
    pairs : int
        Pairs with a value of both.
    difference : tuple of float
        Mean of real less surrogate, and its confidence limits.
    scatter : float
        Standard deviation of the difference.
    correlation, slope : float
        Of the real metric with the surrogate's.
    mean_surrogate : float
        Mean of the surrogate over the campaign's flights.
    mean : tuple of float
        Mean of the real metric over the same cases, and its confidence limits.
    quantiles : mapping of float to ((low, high), (low, high))
        Ends of the p-box at each probability: the surrogate's, and the corrected.
    """

    pairs: int
    difference: tuple[float, float, float]
    scatter: float
    correlation: float
    slope: float
    mean_surrogate: float
    mean: tuple[float, float, float]
    quantiles: Mapping[float, tuple[tuple[float, float], tuple[float, float]]]

    @property
    def differs(self) -> bool:
        """Return whether the mean difference is beyond chance."""
        return not self.difference[1] <= 0.0 <= self.difference[2]


def fly_pairs(
    folder: Path, count: int, settings: AutopilotSettings, metrics: Sequence[str] = ()
) -> Pairs:
    """Fly cases of the hardest condition of a complete campaign with a real autopilot.

    Parameters
    ----------
    folder : Path
        Campaign folder.
    count : int
        Number of flights; epistemic members and airs are drawn evenly, by the campaign's seed.
    settings : AutopilotSettings
        The real autopilot.
    metrics : sequence of str
        Metrics to compare; default: `DEFAULT_METRICS`.

    Raises
    ------
    BadInputError
        Before the first flight, if the campaign is incomplete, a metric is unknown, or aircraft,
        script or versions have changed.
    """
    manifest = read_manifest(folder)
    refuse_without_digests(folder, manifest)
    frame = read_cases(folder, manifest)
    spec = spec_of(manifest)
    mission = find_mission(spec, folder)
    refuse_if_different(folder, manifest, describe(spec, mission, manifest["cases"], ""))
    condition = hardest_condition(conditions(frame))
    rows = in_condition(frame, condition)
    requested = requested_metrics(rows, metrics, DEFAULT_METRICS, folder / CASES)
    if settings.warmup_s > float(spec.aleatory.burn_in_s):
        raise BadInputError(
            f"--autopilot-warmup-s {settings.warmup_s:g}: the campaign scores from"
            f" {float(spec.aleatory.burn_in_s):g} s on (burn_in_s); a warm-up ends before"
        )
    chosen = _varied_cases(rows[rows["status"] == "ok"], count, spec.campaign.seed)
    if needs_copy(spec):
        make_copy(spec, mission, folder)
    by_id = {case.case_id: case for case in build_cases(spec, mission)}
    cases = tuple(by_id[case_id] for case_id in chosen)
    # One after the other: the autopilot's port is one. A real autopilot may be slow.
    executor = ProcessExecutor(
        1, timeout_s=lambda flight: 600.0 + 10.0 * (flight.duration_s + flight.burn_in_s), retries=0
    )
    outcomes = {
        item.case_id: item
        for batch in executor.run(
            RealAutopilot(settings), [(case.case_id, case.flight) for case in cases]
        )
        for item in batch
    }
    refused = next((o for o in outcomes.values() if o.bad_input), None)
    if refused is not None:
        raise BadInputError(refused.reason)
    results = tuple(outcomes[case.case_id] for case in cases)
    return Pairs(condition, rows, cases, results, requested)


def _varied_cases(rows: pd.DataFrame, count: int, seed: int) -> list[str]:
    """Return case ids of different airs and members as far as there are any."""
    if len(rows) < count:
        raise BadInputError(
            f"--flights {count}: the condition has {len(rows)} flights that ended well; at least"
            f" {FEWEST_PAIRS} pairs are needed"
        )
    order = np.random.default_rng(seed).permutation(len(rows))
    columns = [rows[name].to_numpy()[order] for name in ("epistemic_id", "aleatory_id")]
    case_ids = rows["case_id"].to_numpy()[order]
    used = np.zeros(len(rows))
    chosen: list[str] = []
    for _ in range(count):
        k = int(np.argmin(used))
        chosen.append(str(case_ids[k]))
        for column in columns:
            used[column == column[k]] += 1.0
        used[k] = math.inf
    return chosen


def corrections(pairs: Pairs, confidence: float = 0.95) -> dict[str, Correction]:
    """Return the correction of each requested metric that enough pairs have."""
    out = {}
    for metric in pairs.metrics:
        stored = dict(
            zip(pairs.rows["case_id"], pairs.rows[metric].to_numpy(dtype=float), strict=True)
        )
        metric_pairs = [
            (float(stored[case.case_id]), outcome.metrics.get(metric, math.nan))
            for case, outcome in zip(pairs.cases, pairs.outcomes, strict=True)
            if outcome.status == "ok"
        ]
        x, y = np.array(metric_pairs, dtype=float).reshape(-1, 2).T
        is_defined = np.isfinite(x) & np.isfinite(y)
        if is_defined.sum() < FEWEST_PAIRS:
            continue
        good = pairs.rows[np.isfinite(pairs.rows[metric]) & (pairs.rows["status"] == "ok")]
        members = {
            str(name): group[metric].to_numpy(dtype=float)
            for name, group in good.groupby("epistemic_id", sort=False)
        }
        out[metric] = control_variate(x[is_defined], y[is_defined], members, confidence)
    return out


def control_variate(
    surrogate: FloatArray,
    real: FloatArray,
    members: Mapping[str, FloatArray],
    confidence: float = 0.95,
) -> Correction:
    """Correct a p-box of a surrogate by a few paired flights.

    Parameters
    ----------
    surrogate, real : ndarray
        (k,) the metric of the same cases.
    members : mapping of str to ndarray
        The surrogate's metric in all flights, by epistemic member.
    confidence : float
        Of the limits.

    Returns
    -------
    Correction
        Each flight of a member becomes k flights: the line's value at the surrogate's metric plus
        each residual (with the k - 2 degrees of freedom that the line leaves). Ends of the
        corrected p-box are those of the members' quantiles, beyond which the line's confidence
        limits at the matching metric lie.

    Examples
    --------
    >>> x = np.array([1.0, 2.0, 3.0, 4.0, 5.0])
    >>> c = control_variate(x, 2.0 * x + 1.0, {"a": x})
    >>> [round(end, 6) for end in c.quantiles[0.5][1]], round(c.mean[0], 6)
    ([7.0, 7.0], 7.0)
    """
    k = len(surrogate)
    # Paired differences with their t interval.
    difference = real - surrogate
    t = float(student_quantile(0.5 + 0.5 * confidence, k - 1))
    half = t * float(difference.std(ddof=1)) / math.sqrt(k)
    # The line from the surrogate's metric to the real one's.
    centre = float(surrogate.mean())
    sum_of_squares = float(np.sum((surrogate - centre) ** 2))
    # Without a spread of the surrogate the pairs cannot tell a slope.
    has_slope = sum_of_squares > 1e-12 * k * max(centre**2, 1e-300)
    slope = float((surrogate - centre) @ real) / sum_of_squares if has_slope else 1.0
    freedom = k - 2 if has_slope else k - 1
    residuals = real - real.mean() - slope * (surrogate - centre)
    sigma = math.sqrt(float(residuals @ residuals) / freedom)
    # Scaled, the residuals have the variance that the fit estimates.
    residuals = residuals * math.sqrt(k / freedom)
    t_line = float(student_quantile(0.5 + 0.5 * confidence, freedom))

    def line(x: FloatArray) -> FloatArray:
        return np.asarray(real.mean() + slope * (x - centre))

    def limit(x: float) -> float:
        lever = (x - centre) ** 2 / sum_of_squares if has_slope else 0.0
        return t_line * sigma * math.sqrt(1.0 / k + lever)

    # The mean of all flights of the campaign, carried by the line.
    every = np.concatenate(list(members.values()))
    mean_surrogate = float(every.mean())
    mean = float(line(np.array([mean_surrogate]))[0])
    box = pbox([Sample(name, values) for name, values in members.items()])
    # Each member's distribution is its metric on the line, with the residuals' scatter.
    moved = {
        name: np.sort((line(values)[:, None] + residuals[None, :]).ravel())
        for name, values in members.items()
    }
    # Ends of the p-box, wider by the confidence limits of the line there.
    quantiles = {}
    for probability in PROBABILITIES:
        ends = box.quantile(probability)
        corrected = [float(np.quantile(values, probability)) for values in moved.values()]
        at = [float(np.quantile(values, probability)) for values in members.values()]
        low, high = int(np.argmin(corrected)), int(np.argmax(corrected))
        quantiles[probability] = (
            ends,
            (corrected[low] - limit(at[low]), corrected[high] + limit(at[high])),
        )
    both_vary = has_slope and float(np.ptp(real)) > 0.0
    return Correction(
        pairs=k,
        difference=(
            float(difference.mean()),
            float(difference.mean()) - half,
            float(difference.mean()) + half,
        ),
        scatter=float(difference.std(ddof=1)),
        correlation=float(np.corrcoef(surrogate, real)[0, 1]) if both_vary else math.nan,
        slope=slope,
        mean_surrogate=mean_surrogate,
        mean=(mean, mean - limit(mean_surrogate), mean + limit(mean_surrogate)),
        quantiles=quantiles,
    )
