"""Results of `uqharness campaign`: cost, run, status, page, shards, repeated flights, checks.

Those of `uqharness sensitivity` follow.
"""

from __future__ import annotations

from typing import Any

from pydantic import Field

from uqharness.results.base import Ends, Number, Part, Texts

Counts = dict[str, int]


class CampaignCost(Part):
    """Document of `campaign check`: size, expected time and engine of a campaign."""

    flights: int = Field(description="flights")
    at_most: bool = Field(description="whether the stopping rule may end the campaign sooner")
    flights_each: int = Field(description="flights per corner and condition")
    conditions: int = Field(description="conditions of wind and turbulence")
    conditions_tried: int = Field(description="conditions that are tried out before the campaign")
    epistemic_samples: int = Field(description="epistemic samples")
    interior_samples: int = Field(description="those between the corners")
    flight_hours: float = Field(description="flight hours, burn-in included")
    workers: int = Field(description="processes")
    expected_s: Number = Field(description="expected time, s; null: not measured")
    disk_bytes: int = Field(description="size of journal and tables, bytes")
    more_than_a_day: bool = Field(description="whether --yes or --hours is needed")
    engine: str = Field(description="engine that will fly: batch or jsbsim")
    engine_why: Texts = Field(description="reasons of that choice")
    joint_level: Number = Field(description="joint confidence of the intervals; null if not known")
    joint: Texts = Field(description="sentences on the joint confidence")
    bounds_hold_at: str = Field(description="epistemic points that will be flown")


class CampaignRun(Part):
    """Document of `campaign run`: what was flown."""

    folder: str = Field(description="campaign folder")
    cases: int = Field(description="flights of the campaign")
    done_before: int = Field(description="flights that earlier runs stored")
    failed: int = Field(description="flights whose status is not ok")
    statuses: Counts = Field(description="number of flights by status")
    flight_hours: float = Field(description="flight hours of this run")
    elapsed_s: float = Field(description="time of this run, s")
    flight_hours_per_core_hour: Number = Field(description="speed of this run")
    engine: str = Field(description="engine that flew")
    bounds_hold_at: str = Field(description="epistemic points that were flown")


class Answer(Part):
    """Answer of one condition: whether excursions are acceptable at every corner."""

    condition: str = Field(description="wind and turbulence")
    radius_m: float = Field(description="radius of the excursions, m")
    acceptable_per_h: float = Field(description="acceptable excursions per hour")
    answer: str = Field(description="yes, no, open, or flying")
    reason: str = Field(default="", description="why it is open")
    hours: float = Field(description="flight hours")
    flight_share_upper: Number = Field(
        default=None,
        description="upper limit of the share of flights with an excursion at the worst corner, if"
        " the number of flights was fixed",
    )


class CampaignStatus(Part):
    """Document of `campaign status`."""

    state: str = Field(description="complete, running or interrupted")
    cases: int = Field(description="flights of the campaign")
    done: int = Field(description="finished flights")
    failed: int = Field(description="finished flights whose status is not ok")
    statuses: Counts = Field(description="number of finished flights by status")
    engine: str = Field(description="engine that flies it")
    engine_why: Texts = Field(description="reasons of that choice")
    joint_level: Number = Field(
        description="joint confidence of the intervals; null if it is not known"
    )
    joint: Texts = Field(description="sentences on the joint confidence")
    answers: list[Answer] = Field(description="answers by condition")
    command: str = Field(default="", exclude=True, description="command that continues it")


class CampaignPage(Part):
    """Document of `campaign report`."""

    report: str = Field(description="report.html")
    figures: Texts = Field(description="drawings")
    verdict: Texts = Field(description="sentences of the verdict")
    flown_again: Texts = Field(
        description="ids of the cases that were flown again for the ground track"
    )


class Merged(Part):
    """Document of `campaign merge`."""

    cases: int = Field(description="flights of the campaign")
    done: int = Field(description="flights that are in some shard")
    missing: int = Field(description="flights in no shard; above 0: exit code 1")
    statuses: Counts = Field(description="number of flights by status")
    shards: Texts = Field(description="names of the shards' folders")
    rewritten: Texts = Field(default=[], exclude=True, description="tables written again")


class Rerun(Part):
    """Document of `campaign rerun`."""

    case_id: str = Field(description="id of the case")
    status: str = Field(description="how the flight ended: ok, or how it failed")
    reason: str = Field(description="why it failed")
    same_as_stored: bool | None = Field(
        description="whether status and metrics equal the stored ones; null: not flown before"
    )
    differences: Texts = Field(description="what differs")
    files: Texts = Field(description="files written")


class SurrogateQuantile(Part):
    """One quantile of a metric over the epistemic members."""

    probability: float = Field(description="probability of the quantile")
    surrogate: Ends = Field(description="ends of the campaign's p-box; null: open")
    corrected: Ends = Field(description="ends of the p-box of the real autopilot")


class SurrogateMetric(Part):
    """One metric with the built-in and with the real autopilot, limits at 95 %."""

    pairs: int = Field(description="flights with a value of both")
    difference: Number = Field(description="mean of real less built-in")
    difference_limits: Ends = Field(description="confidence limits of that mean")
    scatter: Number = Field(description="standard deviation of the difference")
    correlation: Number = Field(description="of both; null where one does not vary")
    slope: Number = Field(description="change of the real metric with the built-in's")
    mean_surrogate: Number = Field(description="mean over all flights of the condition")
    mean: Number = Field(description="mean of the real autopilot over the same flights")
    mean_limits: Ends = Field(description="confidence limits of that mean")
    differs: bool = Field(description="whether the difference is beyond chance")
    quantiles: list[SurrogateQuantile] = Field(description="p-box before and after")


class SurrogateFlight(Part):
    """One flight with the real autopilot."""

    case_id: str = Field(description="id of the case")
    epistemic_id: str = Field(description="epistemic member")
    aleatory_id: int = Field(description="air and noise")
    status: str = Field(description="how it ended: ok, or how it failed")
    reason: str = Field(description="why it failed")
    metrics: dict[str, Number] = Field(description="metrics; null where undefined")


class SurrogateCheck(Part):
    """Document of `campaign surrogate-check`: real autopilot against the built-in one."""

    condition: str = Field(description="wind and turbulence of the flights")
    flights: list[SurrogateFlight] = Field(description="flights with the real autopilot")
    failed: int = Field(description="those that did not end well")
    metrics: dict[str, SurrogateMetric] = Field(description="comparison by metric")


class RerunDocument(Part):
    """result.json of a case that was flown again."""

    case_id: str = Field(description="id of the case")
    epistemic_id: str = Field(description="epistemic sample")
    aleatory_id: int = Field(description="aleatory sample")
    wind_mps: float = Field(description="mean wind, m/s")
    turbulence: str = Field(description="intensity of the turbulence")
    status: str = Field(description="how the flight ended: ok, or how it failed")
    reason: str = Field(description="why it failed")
    flown_s: float = Field(description="simulated time, s")
    same_as_stored: bool | None = Field(
        description="whether status and metrics equal the stored ones; null: not flown before"
    )
    differences: Texts = Field(description="what differs")
    metrics: dict[str, Number] = Field(description="metrics; null where undefined")
    properties: dict[str, int | float] = Field(description="JSBSim properties that the case sets")
    levels: dict[str, Any] | None = Field(description="levels that vary in flight")
    transient: dict[str, Any] | None = Field(description="transient part of the model error")


class Item(Part):
    """A manifest, journal, table or other file of a folder that was checked."""

    name: str = Field(description="name of the file")
    state: str = Field(description="whole, damaged, missing, or no digests")
    remark: str = Field(default="", description="what is wrong")
    digest: str | None = Field(default=None, description="SHA-256 of a table's current bytes")


class FolderCheck(Part):
    """Document of `campaign verify`: a folder and its shards."""

    folder: str = Field(description="folder")
    whole: bool = Field(description="whether everything is as it was written")
    complete: bool | None = Field(
        description="whether the campaign is complete; null: the manifest cannot be read"
    )
    files: list[Item] = Field(alias="items", description="state of each file")
    shards: list[FolderCheck] = Field(default=[], description="the same of inner folders")


class Salvaged(Part):
    """Document of `campaign salvage`: a folder and its shards."""

    folder: str = Field(description="folder")
    kept: int = Field(description="sound flights")
    flown: int = Field(description="flights that were flown again")
    missing: int = Field(description="flights that no shard has flown; above 0: exit code 1")
    statuses: Counts = Field(description="number of flights by status")
    rewritten: Texts = Field(description="tables written again")
    aside: Texts = Field(description="new names of damaged files")
    shards: list[Salvaged] = Field(default=[], description="the same of damaged shards")


class ConvergenceRow(Part):
    """A row of convergence.csv; cells that do not apply are absent."""

    metric: str = Field(description="column of cases.parquet")
    condition: str = Field(description="wind and turbulence")
    kind: str = Field(description="aleatory (repeats of flights) or epistemic (size of the p-box)")
    epistemic_id: str = Field(default="", description="sample whose repeats lie farthest apart")
    repeats: int = Field(default=0, description="number of repeats")
    flights: int = Field(default=0, description="flights of each")
    distance: Number = Field(default=None, description="largest distance of two repeats")
    expected_distance: Number = Field(default=None, description="that of chance alone, at most")
    median_low: Number = Field(default=None, description="smallest median of a repeat")
    median_high: Number = Field(default=None, description="largest median of a repeat")
    samples: int = Field(default=0, description="epistemic samples")
    area: Number = Field(default=None, description="area of their p-box, in the metric's unit")
    area_low: Number = Field(default=None, description="smallest area over random orders")
    area_high: Number = Field(default=None, description="largest area over random orders")
    chance_of_more: Number = Field(
        default=None, description="largest chance that one more sample lies outside"
    )


class Convergence(Part):
    """Document of `campaign convergence`."""

    table: str = Field(description="convergence.csv")
    figures: Texts = Field(description="drawings")
    rows: list[ConvergenceRow] = Field(description="rows of the table")


class AreaRow(Part):
    """Real flights compared with one p-box."""

    metric: str = Field(description="column of cases.parquet")
    condition: str = Field(description="wind and turbulence")
    verdict: str = Field(description="outside: beyond chance; or no contradiction")
    area: Number = Field(description="area by which the flights lie outside, in the metric's unit")
    below: Number = Field(description="part of it at values smaller than the model allows")
    above: Number = Field(description="part of it at larger values")
    beyond_chance: Number = Field(description="area beyond sampling error")
    flights: int = Field(description="number of flights")


class Areas(Part):
    """Document of `campaign area`."""

    table: str = Field(description="area.csv")
    rows: list[AreaRow] = Field(description="rows of the table")


# Results of sensitivity: of a campaign, and of the dissertation's modal example.


class CampaignIndex(Part):
    """Share of a p-box's width that one coefficient causes, over the pairs of corners."""

    value: Ends = Field(description="smallest and largest share")
    interval: Ends = Field(description="95 % interval of both")
    reason: str = Field(default="", description="why the shares are undefined")


class MetricShares(Part):
    """Shares of one metric in one condition."""

    runs: int = Field(description="flights")
    indices: dict[str, CampaignIndex] = Field(description="shares by coefficient")
    holds: bool | None = Field(description="whether the method's assumption holds; null: unknown")
    statement: str = Field(description="the same in words")
    details: dict[str, Any] = Field(description="further numbers by name")
    flights: int = Field(description="aleatory samples")
    left_out: int = Field(description="those left out because a flight of theirs failed")
    first: str | None = Field(description="coefficient to reduce first; null: undefined")
    certain: bool = Field(description="whether it is first beyond sampling error everywhere")
    rivals_by_ranges: Texts = Field(
        description="coefficients that may come first at some values of the others"
    )
    rivals_by_sampling: Texts = Field(
        description="coefficients that may come first by sampling error"
    )
    words: str = Field(description="sentence")


class CampaignSensitivity(Part):
    """Document of `sensitivity DIR`."""

    sensitivity: dict[str, dict[str, MetricShares]] = Field(
        description="shares by condition, then metric"
    )
    csv: str = Field(description="sensitivity.csv")
    figures: Texts = Field(description="drawings")


class ModalIndices(Part):
    """Indices of one parameter of the modal example by method; null is undefined."""

    local: Number = Field(description="local derivative")
    interval: dict[str, Ends] = Field(description="95 % interval of the mean by method")
    std_of_one_run: dict[str, Number] = Field(
        description="standard deviation of a single repeat by method"
    )
    scatter: Number = Field(description="scatter plot")
    anova: Number = Field(description="analysis of variance")
    pbox: Number = Field(description="pinching of the p-box")
    proposed: Ends | None = Field(description="corner pairs: smallest and largest")
    reason: dict[str, str] = Field(default={}, description="why an index is undefined, by method")


class ModalSensitivity(Part):
    """Document of `sensitivity --modal`: indices by parameter of three outputs."""

    phugoid_damping: dict[str, ModalIndices] = Field(description="damping of the phugoid")
    short_period_damping: dict[str, ModalIndices] = Field(description="damping of the short period")
    short_period_frequency: dict[str, ModalIndices] = Field(
        description="frequency of the short period"
    )
