"""Flights of a study simulated by a function instead of an engine."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from campaigns.library.flights import RESOLUTION, cases_of, write_flights
from tests.helpers import campaign_fakes as fakes
from uqharness.campaign.processes import CaseOutcome
from uqharness.campaign.tables import build_table
from uqharness.flight import FlightResult, FlightSpec


def with_medians(change: Callable[[FlightSpec], float]) -> Callable[[FlightSpec], FlightResult]:
    """A flight of ``fakes.steady`` but for the medians, each of which is ``change`` of it."""

    def fly(flight: FlightSpec) -> FlightResult:
        result = fakes.steady(flight)
        medians = {name: change(flight) for name in result.metrics if "_median_" in name}
        return replace(result, metrics={**result.metrics, **medians})

    return fly


def fly_study(
    campaign: Path,
    cell: str,
    path: Path,
    fly: Callable[[FlightSpec], FlightResult],
    airs: int = 25,
    samples: range | None = None,
    resolution: float = RESOLUTION,
) -> Path:
    """Write the flights of one cell to a Parquet file, its campaign file beside it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    shutil.copy(campaign, path.parent / "campaign.toml")
    cases = cases_of(campaign, cell, range(airs), samples)
    outcomes = []
    for case in cases:
        result = fly(case.flight)
        outcomes.append(
            CaseOutcome(case.case_id, result.status, result.reason, result.flown_s, result.metrics)
        )
    write_flights(build_table(cases, outcomes).to_pandas(), path, resolution)
    return path
