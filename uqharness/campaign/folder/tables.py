"""The tables a campaign leaves behind, each whole or not at all: cases, p-boxes, excursions, statements."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import pandas as pd
import pyarrow as pa

from uqharness.campaign.cases import Case
from uqharness.campaign.conditions import CONFIDENCE, in_condition, pboxes
from uqharness.campaign.execution.worker import CaseOutcome
from uqharness.campaign.folder.case_table import CASES, build_table
from uqharness.campaign.rounds import DECISIONS, band_confidence, decision_rows
from uqharness.campaign.spec.campaign import CampaignSpec
from uqharness.campaign.statements import STATEMENTS, Statement, number, statements, statements_csv
from uqharness.files import write_bytes
from uqharness.parquet_files import table_bytes
from uqharness.statistics import best_and_worst

PBOXES = "pbox.parquet"
EXCURSIONS = "excursions.csv"

_EXCURSION_COLUMNS = (
    "condition",
    "wind_mps",
    "turbulence",
    "radius_m",
    "distance",
    "epistemic_id",
    "best",
    "worst",
    "flights",
    "failed",
    "hours",
    "excursions",
    "excursions_upper",
    "rate_per_h",
    "rate_upper_per_h",
    "limit_lower_per_h",
    "limit_upper_per_h",
    "simultaneous_lower_per_h",
    "simultaneous_upper_per_h",
    "flights_lower_per_h",
    "flights_upper_per_h",
    "dispersion",
    "extrapolated_share",
)


def make_tables(
    spec: CampaignSpec,
    cases: Sequence[Case],
    outcomes: Iterable[CaseOutcome],
    decisions: bytes | None = None,
) -> dict[str, bytes]:
    """cases.parquet, pbox.parquet, excursions.csv and statements.csv of what was flown, and ``decisions``, by name."""
    table = build_table(cases, outcomes)
    frame, campaign = table.to_pandas(), spec.as_dict()
    found = statements(
        frame, campaign, [] if decisions is None else decision_rows(decisions, Path(DECISIONS))
    )
    made = {
        CASES: table_bytes(table),
        PBOXES: table_bytes(_pbox_table(frame, band_confidence(campaign, CONFIDENCE))),
        EXCURSIONS: _excursions_csv(frame, found),
        STATEMENTS: statements_csv(found),
    }
    return made if decisions is None else made | {DECISIONS: decisions}


def write_tables(folder: Path, tables: Mapping[str, bytes]) -> None:
    """Write tables, each whole or not at all. Raises BadInputError."""
    for name, content in tables.items():
        write_bytes(folder / name, content)


def _pbox_table(frame: pd.DataFrame, confidence: float) -> pa.Table:
    text, real = pa.string(), pa.float64()
    names = ("value", "lower", "upper", "band_lower", "band_upper")
    fields = [("metric", text), ("condition", text), *((name, real) for name in names)]
    schema = pa.schema([*fields, ("corner_lower", text), ("corner_upper", text)])
    parts = []
    for metric, condition, box in pboxes(frame, confidence):
        rows = box.value.size
        columns = [
            [metric] * rows,
            [condition.label] * rows,
            box.value,
            box.lower,
            box.upper,
            box.band_lower,
        ]
        columns += [box.band_upper, box.corner_lower.tolist(), box.corner_upper.tolist()]
        arrays = [
            pa.array(column, field.type) for column, field in zip(columns, schema, strict=True)
        ]
        parts.append(pa.table(arrays, schema=schema))
    return pa.concat_tables(parts).combine_chunks() if parts else schema.empty_table()


def _excursions_csv(frame: pd.DataFrame, found: Sequence[Statement]) -> bytes:
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(_EXCURSION_COLUMNS)
    for statement in found:
        cell = statement.cell
        best, worst = best_and_worst(cell.rates)
        shares = (
            in_condition(frame, cell.condition)
            .groupby("epistemic_id", sort=False)["extrapolated_share"]
            .mean()
        )
        for item, limits, dispersion in zip(
            cell.rates, statement.corner_limits, statement.dispersions, strict=True
        ):
            writer.writerow(
                [
                    cell.condition.label,
                    f"{cell.condition.wind_mps:g}",
                    cell.condition.turbulence,
                    f"{cell.radius_m:g}",
                ]
                + [
                    cell.distance,
                    item.epistemic_id,
                    int(item is best),
                    int(item is worst),
                    item.flights,
                    item.failed,
                ]
                + [
                    f"{item.hours:.6f}",
                    item.events,
                    item.events_upper,
                    f"{item.rate:.6g}",
                    f"{item.rate_upper:.6g}",
                ]
                + [
                    f"{limit:.6g}"
                    for limit in (*item.limits, *item.simultaneous, *limits, dispersion)
                ]
                + [number(shares[item.epistemic_id])]
            )
    return buffer.getvalue().encode()
