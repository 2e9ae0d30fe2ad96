"""cases.parquet: one row per flight, in case order, the same bytes for the same results."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa

from uqharness.campaign.cases import Case
from uqharness.campaign.columns import (
    ERROR_METRICS,
    UNCOMMANDED_METRICS,
    counted_radii,
    excursion_columns,
)
from uqharness.campaign.execution.flying import BATCH, JSBSIM
from uqharness.campaign.execution.worker import CaseOutcome
from uqharness.errors import BadInputError
from uqharness.flight import COEFFICIENTS, STATUSES, TURBULENCE_W20_KT

CASES = "cases.parquet"
_ENGINE = "engine"
_ALWAYS = (
    "case_id",
    "epistemic_id",
    "aleatory_id",
    "wind_mps",
    "turbulence",
    "seed",
    "duration_s",
    "status",
    "reason",
)


def build_table(cases: Sequence[Case], outcomes: Iterable[CaseOutcome]) -> pa.Table:
    """Table of the cases that have an outcome.

    ``duration_s`` is scored time: of a flight that failed, what it flew of it. Such a flight has no error statistics (they
    would be those of a shorter flight), but keeps its counts so far.
    """
    by_id = {outcome.case_id: outcome for outcome in outcomes}
    radii = cases[0].flight.excursion_radius_m if cases else ()
    found = {name for outcome in by_id.values() for name in outcome.metrics}
    more = tuple(name for name in UNCOMMANDED_METRICS if name in found)
    schema = _schema(radii, more, tuple(cases[0].inputs) if cases else ())
    columns: dict[str, list[Any]] = {name: [] for name in schema.names}
    for case in cases:
        outcome = by_id.get(case.case_id)
        if outcome is None:
            continue
        for name, value in _row(case, outcome, radii, more).items():
            columns[name].append(value)
    return pa.table([pa.array(columns[field.name], field.type) for field in schema], schema=schema)


def checked_table(table: pa.Table, path: Path, campaign: Mapping[str, Any]) -> pa.Table:
    """The table, if it has every column of ``campaign`` (its settings as plain types) with values such as flights leave.

    Raises BadInputError naming the first column that is missing or of another type.
    """
    variables = campaign["aleatory"]["variables"]
    means = tuple(
        f"level_{name}" for name, item in variables.items() if isinstance(item.get("mean"), list)
    )
    found = {field.name: field.type for field in table.schema}
    for field in _schema(counted_radii(campaign["metrics"]), (), means):
        if field.name == _ENGINE and field.name not in found:
            continue  # a table from before there was another engine than JSBSim
        if field.name not in found or len(table.schema.get_all_field_indices(field.name)) != 1:
            raise BadInputError(f"{path}: has no column {field.name}; run the campaign again")
        if found[field.name] != field.type:
            raise BadInputError(
                f"{path}: column {field.name} is of type {found[field.name]}, not {field.type}; run the campaign again"
            )
    wrong = [name for name in _ALWAYS if table[name].null_count]
    allowed: dict[str, tuple[str, ...]] = {
        "status": STATUSES,
        "turbulence": tuple(TURBULENCE_W20_KT),
    }
    for name, known in (allowed | ({_ENGINE: (BATCH, JSBSIM)} if _ENGINE in found else {})).items():
        wrong += [name] if set(table[name].unique().to_pylist()) - set(known) else []
    if wrong or not table.num_rows:
        raise BadInputError(
            f"{path}: column {(wrong or ['case_id'])[0]} holds what no flight leaves; run the campaign again"
        )
    return table


def _schema(radii_m: Sequence[float], more: Sequence[str], inputs: Sequence[str]) -> pa.Schema:
    text, real, whole = pa.string(), pa.float64(), pa.int64()
    fields = [
        ("case_id", text),
        ("epistemic_id", text),
        *((f"level_{name}", real) for name in COEFFICIENTS),
    ]
    fields += [
        ("aleatory_id", whole),
        ("wind_mps", real),
        ("turbulence", text),
        ("seed", whole),
        (_ENGINE, text),
        ("duration_s", real),
    ]
    fields += [("status", text), ("reason", text), *((name, real) for name in ERROR_METRICS)]
    fields += [(name, whole) for name in excursion_columns(radii_m)]
    fields += [
        ("loss_of_control", whole),
        ("extrapolated_share", real),
        *((name, real) for name in (*more, *inputs)),
    ]
    return pa.schema(fields)


def _row(
    case: Case, outcome: CaseOutcome, radii_m: Sequence[float], more: Sequence[str]
) -> dict[str, Any]:
    ok = outcome.status == "ok"
    flight = case.flight
    scored_s = (
        flight.duration_s
        if ok
        else min(max(outcome.flown_s - flight.burn_in_s, 0.0), flight.duration_s)
    )
    row: dict[str, Any] = {
        "case_id": case.case_id,
        "epistemic_id": case.epistemic_id,
        "aleatory_id": case.aleatory_id,
        "wind_mps": case.wind_mps,
        "turbulence": case.turbulence,
        "seed": case.seed,
        _ENGINE: case.engine,
        "duration_s": scored_s,
        "status": outcome.status,
        "reason": outcome.reason
        or "; ".join(f"{name}: {why}" for name, why in sorted(outcome.undefined.items())),
    }
    row |= {f"level_{name}": case.levels.get(name) for name in COEFFICIENTS} | dict(case.inputs)
    row |= {
        name: _finite(outcome, name) if ok else None
        for name in (*ERROR_METRICS, "extrapolated_share", *more)
    }
    for name in (*excursion_columns(radii_m), "loss_of_control"):
        value = _finite(outcome, name)
        row[name] = None if value is None else round(value)
    return row


def _finite(outcome: CaseOutcome, name: str) -> float | None:
    """A metric, or None (null in the table) where it is undefined."""
    value = outcome.metrics.get(name, math.nan)
    return value if math.isfinite(value) else None
