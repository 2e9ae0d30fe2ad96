"""Results of sensitivity: of a campaign, and of the dissertation's modal example."""

from __future__ import annotations

from typing import Any

from pydantic import Field

from uqharness.results.base import Ends, Number, Part, Texts


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
