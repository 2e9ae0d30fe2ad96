"""Build, write and read the tables of a campaign.

A complete campaign has cases.parquet (a row per flight), pbox.parquet, excursions.csv and
statements.csv, and with *decide* decisions.csv. Tables are written atomically, in case order, so
the same results give the same bytes. They are read only if their digest is the one in the manifest.
engine-check.csv holds the comparison of the engines.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import astuple, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa

from sysid.arrays import FloatArray
from sysid.foreign.regular_files import read_regular, sha256_hex
from uqharness.campaign.cases import Case
from uqharness.campaign.conditions import (
    CONFIDENCE,
    ERROR_METRICS,
    OPTIONAL_METRICS,
    counted_radii,
    excursion_columns,
    in_condition,
    pboxes,
)
from uqharness.campaign.manifest import (
    COMPLETE,
    DamageError,
    has_digests,
    read_manifest,
    write_manifest,
)
from uqharness.campaign.processes import BATCH, JSBSIM, CaseOutcome
from uqharness.campaign.rounds import DECISIONS, band_confidence, decision_rows
from uqharness.campaign.spec import CampaignSpec
from uqharness.campaign.statements import (
    STATEMENTS,
    Statement,
    format_number,
    statements,
    statements_csv,
)
from uqharness.errors import BadInputError
from uqharness.files import write_bytes
from uqharness.flight import COEFFICIENTS, STATUSES, TURBULENCE_W20_KT
from uqharness.parquet_files import parse_table, table_bytes
from uqharness.statistics import best_and_worst
from uqharness.text_tables import csv_rows

# cases.parquet: one row per flight, in case order.

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
    """Return cases.parquet for the cases that have an outcome.

    ``duration_s`` is the scored time [s]; of a failed flight it is the part that was flown. Failed
    flights have no error statistics, which would describe a shorter flight, but keep their counts
    so far.
    """
    place = {case.case_id: k for k, case in enumerate(cases)}
    status, reason = [""] * len(cases), [""] * len(cases)
    flown_s = np.zeros(len(cases))
    metrics: dict[str, FloatArray] = {}
    # Numbers go into arrays one by one: a million flights as objects would fill the memory.
    for outcome in outcomes:
        for name in outcome.metrics:
            if name not in metrics:
                metrics[name] = np.full(len(cases), np.nan)
        k = place.get(outcome.case_id)
        if k is None:
            continue
        status[k], flown_s[k] = outcome.status, outcome.flown_s
        reason[k] = outcome.reason or "; ".join(
            f"{name}: {text}" for name, text in sorted(outcome.undefined.items())
        )
        for name, value in outcome.metrics.items():
            metrics[name][k] = value
    finished = np.array([text != "" for text in status], dtype=bool)
    flown_cases = [case for case, done in zip(cases, finished.tolist(), strict=True) if done]
    status, reason = ([t for t, s in zip(of, status, strict=True) if s] for of in (status, reason))
    ok = np.array([text == "ok" for text in status], dtype=bool)
    # A flight that ended early was scored for what it flew after the burn-in.
    planned_s = np.array([case.flight.duration_s for case in flown_cases], dtype=float)
    burn_in_s = np.array([case.flight.burn_in_s for case in flown_cases], dtype=float)
    scored_s = np.clip(flown_s[finished] - burn_in_s, 0.0, planned_s)
    columns: dict[str, Any] = {
        "case_id": [case.case_id for case in flown_cases],
        "epistemic_id": [case.epistemic_id for case in flown_cases],
        "aleatory_id": [case.aleatory_id for case in flown_cases],
        "wind_mps": [case.wind_mps for case in flown_cases],
        "turbulence": [case.turbulence for case in flown_cases],
        "seed": [case.seed for case in flown_cases],
        _ENGINE: [case.engine for case in flown_cases],
        "duration_s": np.where(ok, planned_s, scored_s),
        "status": status,
        "reason": reason,
    }
    columns |= {
        f"level_{name}": [case.levels.get(name) for case in flown_cases] for name in COEFFICIENTS
    }
    # Columns follow from the campaign: radii, optional metrics, inputs.
    radii = cases[0].flight.excursion_radius_m if cases else ()
    inputs = tuple(cases[0].inputs) if cases else ()
    optional = tuple(name for name in OPTIONAL_METRICS if name in metrics)
    columns |= {name: [case.inputs.get(name) for case in flown_cases] for name in inputs}
    absent = np.full(len(cases), np.nan)
    for name in (*ERROR_METRICS, "extrapolated_share", *optional):
        values = metrics.pop(name, absent)[finished]
        columns[name] = pa.array(values, pa.float64(), mask=~(np.isfinite(values) & ok))
    # Counts are integers; a failed flight keeps those that it reached.
    for name in (*excursion_columns(radii), "loss_of_control"):
        values = metrics.pop(name, absent)[finished]
        is_counted = np.isfinite(values)
        counts = np.rint(np.where(is_counted, values, 0.0)).astype(np.int64)
        columns[name] = pa.array(counts, pa.int64(), mask=~is_counted)
    schema = _schema(radii, optional, inputs)
    return pa.table({name: columns[name] for name in schema.names}, schema=schema)


def checked_table(table: pa.Table, path: Path, campaign: Mapping[str, Any]) -> pa.Table:
    """Return the table if it has the columns and values of this campaign's flights.

    ``campaign`` holds the settings as plain types. Raises BadInputError naming the first column
    that is missing, of another type, or has invalid values.
    """
    variables = campaign["aleatory"]["variables"]
    means = tuple(
        f"level_{name}" for name, item in variables.items() if isinstance(item.get("mean"), list)
    )
    types = {field.name: field.type for field in table.schema}
    for field in _schema(counted_radii(campaign["metrics"]), (), means):
        # Tables of older versions have no engine column.
        if field.name == _ENGINE and field.name not in types:
            continue
        if field.name not in types or len(table.schema.get_all_field_indices(field.name)) != 1:
            raise BadInputError(f"{path}: has no column {field.name}; run the campaign again")
        if types[field.name] != field.type:
            raise BadInputError(
                f"{path}: column {field.name} is of type {types[field.name]}, not {field.type}; run"
                " the campaign again"
            )
    # No flight leaves these columns empty or with other values.
    bad_columns = [name for name in _ALWAYS if table[name].null_count]
    allowed: dict[str, tuple[str, ...]] = {
        "status": STATUSES,
        "turbulence": tuple(TURBULENCE_W20_KT),
    }
    for name, allowed_values in (
        allowed | ({_ENGINE: (BATCH, JSBSIM)} if _ENGINE in types else {})
    ).items():
        bad_columns += [name] if set(table[name].unique().to_pylist()) - set(allowed_values) else []
    if bad_columns or not table.num_rows:
        raise BadInputError(
            f"{path}: column {(bad_columns or ['case_id'])[0]} has missing or unknown values (a"
            f" status is one of {', '.join(STATUSES)}); run the campaign again"
        )
    return table


def _schema(radii_m: Sequence[float], more: Sequence[str], inputs: Sequence[str]) -> pa.Schema:
    """Return the schema of cases.parquet."""
    text, real, integer = pa.string(), pa.float64(), pa.int64()
    fields = [
        ("case_id", text),
        ("epistemic_id", text),
        *((f"level_{name}", real) for name in COEFFICIENTS),
    ]
    fields += [
        ("aleatory_id", integer),
        ("wind_mps", real),
        ("turbulence", text),
        ("seed", integer),
        (_ENGINE, text),
        ("duration_s", real),
    ]
    fields += [("status", text), ("reason", text), *((name, real) for name in ERROR_METRICS)]
    fields += [(name, integer) for name in excursion_columns(radii_m)]
    fields += [
        ("loss_of_control", integer),
        ("extrapolated_share", real),
        *((name, real) for name in (*more, *inputs)),
    ]
    return pa.schema(fields)


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
    """Return the content of all tables by name, decisions.csv included if given."""
    table = build_table(cases, outcomes)
    cases_table, campaign = table_bytes(table), spec.as_dict()
    # The table gives its memory to the frame, column by column.
    frame = table.to_pandas(split_blocks=True, self_destruct=True)
    del table
    claims = statements(
        frame, campaign, [] if decisions is None else decision_rows(decisions, Path(DECISIONS))
    )
    tables = {
        CASES: cases_table,
        PBOXES: table_bytes(_pbox_table(frame, band_confidence(campaign, CONFIDENCE))),
        EXCURSIONS: _excursions_csv(frame, claims),
        STATEMENTS: statements_csv(claims),
    }
    return tables if decisions is None else tables | {DECISIONS: decisions}


def write_tables(folder: Path, tables: Mapping[str, bytes]) -> None:
    """Write tables, each in one atomic step. Raises BadInputError."""
    for name, content in tables.items():
        write_bytes(folder / name, content)


def _pbox_table(frame: pd.DataFrame, confidence: float) -> pa.Table:
    """Return pbox.parquet: envelopes and bands of every metric and condition."""
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


def _excursions_csv(frame: pd.DataFrame, claims: Sequence[Statement]) -> bytes:
    """Return excursions.csv: a row per condition, radius, distance and corner."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(_EXCURSION_COLUMNS)
    for statement in claims:
        cell = statement.cell
        # Mark the best and the worst corner of each condition.
        best, worst = best_and_worst(cell.rates)
        # Share of the time that each corner flew outside its bounds' data.
        shares = (
            in_condition(frame, cell.condition)
            .groupby("epistemic_id", sort=False)["extrapolated_share"]
            .mean()
        )
        # One row per corner.
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
                + [format_number(shares[item.epistemic_id])]
            )
    return buffer.getvalue().encode()


# engine-check.csv is not bit-identical between runs: which flights had been compared when a run
# ended depends on the run.

ENGINE_CHECK = "engine-check.csv"
START, FULL_FLIGHT = "start", "whole"
STATUS = "status"
"""Entry of the column metric in the row that compares how a flight ended."""
MAX_CHECK_BYTES = 64_000_000


@dataclass(frozen=True)
class CheckRow:
    """One row of engine-check.csv: a metric of a flight in both engines, as text.

    Attributes
    ----------
    part : str
        start (first seconds) or whole.
    condition, case_id, metric : str
        Flight and metric.
    batch, jsbsim : str
        Values in the two engines.
    spread, difference : str
        Scale of the metric, and difference relative to it.
    verdict, remark : str
        alike, excused (with a remark) or differs.
    """

    part: str
    condition: str
    case_id: str
    metric: str
    batch: str
    jsbsim: str
    spread: str
    difference: str
    verdict: str
    remark: str = ""


_COLUMNS = tuple(field.name for field in fields(CheckRow))


def as_text(value: float) -> str:
    """Return a number as text that is read back exactly; empty if undefined."""
    return "" if math.isnan(value) else repr(float(value))


def as_number(text: str) -> float:
    """Return what `as_text` wrote. Raises ValueError for other text."""
    return float(text) if text else math.nan


def write_check(folder: Path, rows: Iterable[CheckRow]) -> None:
    """Write engine-check.csv. Raises BadInputError."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(_COLUMNS)
    writer.writerows(astuple(row) for row in rows)
    write_bytes(folder / ENGINE_CHECK, buffer.getvalue().encode())


def read_check(folder: Path) -> list[CheckRow]:
    """Return the rows of engine-check.csv.

    None if it is missing or invalid: the comparison flights are then flown again.
    """
    path = folder / ENGINE_CHECK
    try:
        rows = csv_rows(read_regular(path, MAX_CHECK_BYTES), path, (), _COLUMNS)
        checks = [CheckRow(*(row[name] for name in _COLUMNS)) for row in rows]
        for row in checks:
            _ = [as_number(text) for text in (row.batch, row.jsbsim) if row.metric != STATUS]
    except (OSError, BadInputError, ValueError):
        return []
    return checks


def merge_checks(folder: Path, parts: Sequence[Path]) -> None:
    """Write engine-check.csv of a campaign from those of its shards."""
    rows = [row for part in parts for row in read_check(part)]
    if rows:
        write_check(folder, dict.fromkeys(rows))


# Reading of tables, with their digests.

TABLE_NAMES = (
    CASES,
    "pbox.parquet",
    "excursions.csv",
    "statements.csv",
    DECISIONS,
    "sensitivity.csv",
    "convergence.csv",
    "area.csv",
    ENGINE_CHECK,
)
"""Names of the tables that a campaign folder may have."""
MAX_BYTES = 1_000_000_000
"""Maximum size of a table; one of a million flights has a third of it."""
_MAX_TEXT_BYTES = 64_000_000


def is_sealed(manifest: Mapping[str, Any]) -> bool:
    """Return whether the manifest holds digests of all tables: a complete campaign, not of
    uqharness 0.1.
    """
    return has_digests(manifest) and manifest["state"] == COMPLETE


def table_digests(folder: Path, manifest: Mapping[str, Any]) -> dict[str, str | None]:
    """Return the digest of each listed table as it is on the disk; None for a missing one.

    Raises BadInputError if a table cannot be read.
    """
    digests: dict[str, str | None] = {}
    for name in manifest.get("tables", {}):
        try:
            digests[name] = sha256_hex(read_regular(folder / name, MAX_BYTES))
        except FileNotFoundError:
            digests[name] = None
        except OSError as error:
            raise BadInputError(
                f"{folder / name}: cannot be read: {error.strerror or error}"
            ) from None
    return digests


def read_checked(folder: Path, manifest: Mapping[str, Any], name: str) -> bytes:
    """Return the bytes of a table after checking its digest.

    Raises BadInputError if it is missing, DamageError if it is not as it was written.
    """
    path = folder / name
    try:
        content = read_regular(path, MAX_BYTES if path.suffix == ".parquet" else _MAX_TEXT_BYTES)
    except FileNotFoundError:
        raise BadInputError(
            f"{path}: not there; run the campaign first: uqharness campaign run"
        ) from None
    except OSError as error:
        raise BadInputError(f"{path}: cannot be read: {error.strerror or error}") from None
    if is_sealed(manifest):
        expected = manifest.get("tables", {}).get(name)
        if expected is None:
            raise DamageError(
                path,
                "the manifest lists no such table; repeat the command that wrote it",
                folder,
            )
        if sha256_hex(content) != expected:
            raise DamageError(path, "its content does not fit the digest in the manifest", folder)
    return content


def read_cases(folder: Path, manifest: Mapping[str, Any]) -> pd.DataFrame:
    """Return the flights of a complete campaign.

    Parameters
    ----------
    folder : Path
        Campaign folder.
    manifest : mapping
        Its manifest.

    Returns
    -------
    DataFrame
        A row per flight with all columns of cases.parquet.

    Raises
    ------
    BadInputError
        If the table is missing, damaged, or lacks a column.
    """
    path = folder / CASES
    table = parse_table(read_checked(folder, manifest, CASES), path, int(manifest["cases"]))
    return checked_table(table, path, manifest["campaign"]).to_pandas()


def read_decisions(folder: Path, manifest: Mapping[str, Any]) -> list[dict[str, str]]:
    """Return the rows of decisions.csv as text; empty if there is no such table. Raises
    BadInputError.
    """
    sealed = is_sealed(manifest)
    if DECISIONS not in manifest.get("tables", {}) if sealed else not (folder / DECISIONS).exists():
        return []
    return decision_rows(read_checked(folder, manifest, DECISIONS), folder / DECISIONS)


def read_engine_check(folder: Path, manifest: Mapping[str, Any]) -> list[CheckRow]:
    """Return the rows of engine-check.csv; empty if there is none.

    Raises BadInputError if it is listed and missing or damaged.
    """
    if ENGINE_CHECK in manifest.get("tables", {}):
        read_checked(folder, manifest, ENGINE_CHECK)
    return read_check(folder)


def record_table(folder: Path, name: str, content: bytes) -> None:
    """Write a table of another command into a complete campaign, and its digest."""
    write_bytes(folder / name, content)
    manifest = read_manifest(folder)
    if has_digests(manifest):
        tables = manifest.get("tables", {}) | {name: sha256_hex(content)}
        if tables != manifest.get("tables"):
            write_manifest(folder, manifest | {"tables": tables})
