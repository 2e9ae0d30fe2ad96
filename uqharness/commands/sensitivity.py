"""Command sensitivity: which uncertainty to reduce first."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from uqharness.campaign import (
    SENSITIVITY,
    MetricSensitivity,
    analyse_campaign,
    as_csv,
    read_corner_campaign,
    read_interior_campaign,
    record_table,
    shares_by_condition,
)
from uqharness.heartbeat import Callback, counting, silent
from uqharness.report import condition_sections, write_figures
from uqharness.requests.campaign import SensitivityRequest
from uqharness.results.base import Outcome
from uqharness.results.campaign import CampaignSensitivity, ModalIndices, ModalSensitivity
from uqharness.sensitivity import MethodResult
from uqharness.sensitivity.analysis import cell
from uqharness.sensitivity.modal import modal_sensitivity

_TEXT_METRICS = ("cross_track_median_m", "altitude_median_m", "speed_median_mps")


def sensitivity(
    request: SensitivityRequest, callback: Callback = silent
) -> Outcome[CampaignSensitivity | ModalSensitivity]:
    """Rank coefficients by the width they give to a campaign's p-box, or for the dissertation's
    modal example.
    """
    if request.folder is None:
        return _modal(request, callback)
    folder = request.folder
    campaign = read_corner_campaign(folder)
    interior = (
        None if request.interior is None else read_interior_campaign(request.interior, campaign)
    )
    results = analyse_campaign(
        campaign, interior, seed=request.seed, on_progress=counting("metrics", callback)
    )
    content = as_csv(results)
    # The manifest stores the table's digest, so that `verify` can check it.
    record_table(folder, SENSITIVITY, content)
    figures = write_figures(folder, condition_sections(content), "Sensitivity")
    document = CampaignSensitivity(
        sensitivity=shares_by_condition(results),
        csv=str(folder / SENSITIVITY),
        figures=[str(path) for path in figures],
    )
    lines = list(_campaign_lines(results, [folder / SENSITIVITY, *figures]))
    return Outcome(document, document, lines, 0 if any(r.ranking.first for r in results) else 1)


def _campaign_lines(results: Sequence[MetricSensitivity], files: Sequence[Path]) -> Iterator[str]:
    """Yield what to reduce first in each condition, the files, and then the tables."""
    modes = {
        condition: [
            item
            for metric in _TEXT_METRICS
            for item in results
            if item.condition == condition and item.metric == metric
        ]
        for condition in dict.fromkeys(item.condition for item in results)
    }
    for condition, items in modes.items():
        yield f"{condition.words}:"
        yield from (f"  {item.words}" for item in items)
        first = (item.result.statement for item in items if item.ranking.first)
        yield from (f"  {statement}" for statement in dict.fromkeys(first))
    yield f"written: {', '.join(map(str, files))}"
    for condition, items in modes.items():
        yield (
            f"{condition.words}: share of the p-box's width, smallest..largest over the pairs [95 %"
            " interval of both]"
        )
        yield f"  {'':<4}" + "".join(f"{item.metric:>32}" for item in items)
        for name in items[0].result.indices if items else ():
            cells = "".join(f"{cell(item.result.indices[name]):>32}" for item in items)
            yield f"  {name:<4}{cells}"


def _modal(request: SensitivityRequest, callback: Callback) -> Outcome[ModalSensitivity]:
    """Return the indices of the modal example."""
    assert request.modal is not None
    results = modal_sensitivity(
        request.modal, request.repeats, request.seed, on_progress=counting("repeats", callback)
    )
    rows = {output: _modal_indices(methods) for output, methods in results.results.items()}
    document = ModalSensitivity(**rows)
    of = f"{request.repeats} repeats, E = 1024, A = 100; 95 % interval of the mean"
    lines = [f"{request.modal}: mean of {of}"]
    # The largest share of each output first: a terminal shows the first table only.
    for output, methods in results.results.items():
        shares = {n: row.proposed[1] for n, row in rows[output].items() if row.proposed}
        name = max(shares, key=lambda n: shares[n] or 0.0)
        lines.append(f"{output}: most by {name}, {cell(methods['proposed'].indices[name])}")
    return Outcome(document, document, [*lines, "", results.text()])


def _modal_indices(methods: Mapping[str, MethodResult]) -> dict[str, ModalIndices]:
    """Return, by parameter, the indices with intervals, one run's standard deviation and
    reasons.
    """
    rows: dict[str, ModalIndices] = {}
    for k, name in enumerate(next(iter(methods.values())).indices):
        indices = {method: result.indices[name].as_dict() for method, result in methods.items()}
        reasons = {m: index["reason"] for m, index in indices.items() if "reason" in index}
        row: dict[str, Any] = {method: index["value"] for method, index in indices.items()}
        row["interval"] = {method: index["interval"] for method, index in indices.items()}
        row["std_of_one_run"] = {
            method: float(result.details["std_of_one_run"][k]) for method, result in methods.items()
        }
        row |= {"reason": reasons} if reasons else {}
        rows[name] = ModalIndices(**row)
    return rows
