"""Flights of a finished study: one Parquet file, or the campaign folder of somebody who flies them
again.

    python -m campaigns.library.flights RESULTS FLIGHTS.parquet

packs a complete campaign folder. A row group holds a condition, one row per flight. Counts and
statuses are exact. Medians and maxima are small whole numbers on a grid: a value v > 0 is kept as
the k with g^(k-1) < v <= g^k, g = (1 + r) / (1 - r), and read as 2 g^k / (g + 1), off by at most
the resolution r of itself (DDSketch: Masson, Rim and Lee 2019). Distribution functions are exact at
the grid's edges. 0 has a number of its own, undefined values are null.
"""

from __future__ import annotations

import io
import json
import math
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from campaigns.library.study import exit_code, study_parser
from sysid.arrays import FloatArray
from uqharness.campaign.cases import Case, Part, build_cases, unit_draw
from uqharness.campaign.conditions import ERROR_METRICS, Condition, conditions, in_condition
from uqharness.campaign.manifest import read_complete
from uqharness.campaign.read_spec import read_campaign
from uqharness.campaign.run import find_mission
from uqharness.campaign.sampling import epistemic_samples
from uqharness.campaign.spec import CampaignSpec
from uqharness.campaign.tables import read_cases
from uqharness.errors import BadInputError
from uqharness.files import write_bytes

FLIGHTS = "flights.parquet"
RESOLUTION = 0.005
METRICS = tuple(
    name
    for name in ERROR_METRICS
    if "_median_" in name or ("_max_" in name and not name.endswith("_measured"))
)
"""Kept of a flight: medians of the errors, true and measured, and their largest true values."""
SKETCHED = (*METRICS, "extrapolated_share")
_PLACE = {"wind_mps": "float32", "aleatory_id": "int32"}
_ZERO = -(2**15)


def coded(values: FloatArray, resolution: float = RESOLUTION) -> np.ma.MaskedArray:
    """Return numbers of the grid (n,), masked where a value is not finite."""
    finite = np.isfinite(values)
    positive = finite & (values > 0.0)
    numbers = np.full(values.shape, _ZERO, dtype=np.int16)
    steps = np.ceil(np.log(np.where(positive, values, 1.0)) / _log_step(resolution))
    numbers[positive] = np.clip(steps, _ZERO + 1, 2**15 - 1)[positive].astype(np.int16)
    return np.ma.MaskedArray(numbers, mask=~finite)


def decoded(numbers: FloatArray, resolution: float = RESOLUTION) -> FloatArray:
    """Return the values (n,) of numbers of the grid as floats, NaN where one is NaN."""
    step = _log_step(resolution)
    middle = 2.0 / (math.exp(step) + 1.0)
    return np.asarray(np.where(numbers == _ZERO, 0.0, middle * np.exp(numbers * step)))


def _log_step(resolution: float) -> float:
    """Return the logarithm of g."""
    return math.log((1.0 + resolution) / (1.0 - resolution))


def cell_name(condition: Condition) -> str:
    """Return the short name of a condition: ``severe-3``."""
    return f"{condition.turbulence}-{condition.wind_mps:g}"


def case_tables(
    source: Path, campaign: Path | None = None, cell: str = ""
) -> Iterator[pd.DataFrame]:
    """Yield the case table of each condition, or of ``cell`` alone; one is in memory at a time.

    ``campaign`` is the campaign file of a Parquet file, by default the one beside it. Raises
    BadInputError for a source that is damaged, incomplete, or lacks the cell.
    """
    if source.is_dir():
        frame = read_cases(source, read_complete(source))
        cells = {cell_name(c): in_condition(frame, c) for c in conditions(frame)}
        _require_cell(source, cell, list(cells))
        yield from (cells[name] for name in ([cell] if cell else cells))
        return
    spec, names = read_campaign(campaign or source.parent / "campaign.toml"), list(records(source))
    _require_cell(source, cell, names)
    try:
        with pq.ParquetFile(source, page_checksum_verification=True) as file:
            resolution = float(file.metadata.metadata[b"grid"].split()[1])
            for number in [names.index(cell)] if cell else range(len(names)):
                yield _case_table(file.read_row_group(number, use_threads=False), spec, resolution)
    except (pa.ArrowException, OSError) as error:
        raise BadInputError(f"{source}: damaged ({error}); restore it") from error


def _require_cell(source: Path, cell: str, names: Sequence[str]) -> None:
    if cell and cell not in names:
        raise BadInputError(f"{source}: has no flights of {cell}, but of {', '.join(names)}")


def settings(source: Path, campaign: Path | None = None) -> dict[str, Any]:
    """Return the campaign's settings as plain types. Raises BadInputError."""
    if source.is_dir():
        return dict(read_complete(source)["campaign"])
    return read_campaign(campaign or source.parent / "campaign.toml").as_dict()


def _case_table(table: pa.Table, spec: CampaignSpec, resolution: float) -> pd.DataFrame:
    """Return rows as cases.parquet has them, with columns of levels and drawn variables."""
    frame = table.to_pandas()
    planned = frame["duration_s"].where(frame["status"] != "ok", spec.aleatory.duration_s)
    frame["duration_s"] = planned.astype(float)
    frame["wind_mps"] = frame["wind_mps"].astype(float)
    for name in SKETCHED:
        frame[name] = decoded(frame[name].to_numpy(dtype=float, na_value=np.nan), resolution)
    for name in frame.columns:
        if name.startswith("excursions_") or name == "loss_of_control":
            frame[name] = frame[name].astype("Int64")
    levels = {sample.epistemic_id: sample.levels for sample in epistemic_samples(spec)}
    for name in next(iter(levels.values())):
        frame[f"level_{name}"] = frame["epistemic_id"].map({k: v[name] for k, v in levels.items()})
    for name, item in spec.aleatory.variables.items():
        ids, seed = frame["aleatory_id"].unique(), spec.campaign.seed
        values = {k: item.value(unit_draw(seed, int(k), name, item), 0.5) for k in ids}
        frame[f"variable_{name}"] = frame["aleatory_id"].map(values)
    return frame


def records(source: Path) -> dict[str, list[dict[str, Any]]]:
    """Return by cell what the flights of a Parquet file cost. Raises BadInputError."""
    try:
        return dict(json.loads(pq.read_metadata(source).metadata[b"shards"]))
    except (pa.ArrowException, OSError, KeyError, TypeError, ValueError) as error:
        raise BadInputError(
            f"{source}: not the flights of a study ({error}); restore it"
        ) from error


def write_flights(frame: pd.DataFrame, path: Path, resolution: float = RESOLUTION) -> None:
    """Write a case table into one Parquet file."""
    groups, costs = [], {}
    for condition in conditions(frame):
        rows = in_condition(frame, condition)
        failed = rows["status"] != "ok"
        columns = {"turbulence": pa.array(rows["turbulence"])}
        columns |= {name: pa.array(rows[name].astype(kind)) for name, kind in _PLACE.items()}
        columns |= {name: pa.array(rows[name]) for name in ("epistemic_id", "status")}
        columns["duration_s"] = pa.array(
            rows["duration_s"].where(failed), pa.float32(), from_pandas=True
        )
        for name in rows.columns:
            if name.startswith("excursions_") or name == "loss_of_control":
                counts = rows[name].astype("Int32")
                columns[name] = pa.array(counts, pa.int32(), from_pandas=True)
        for name in SKETCHED:
            numbers = coded(rows[name].to_numpy(dtype=float, na_value=np.nan), resolution)
            columns[name] = pa.array(numbers.data, pa.int16(), mask=np.ma.getmaskarray(numbers))
        groups.append(pa.table(columns))
        hours = float(rows["duration_s"].sum()) / 3600.0
        costs[cell_name(condition)] = [
            {"flights": len(rows), "hours": hours, "failed": int(failed.sum())}
        ]
    buffer = io.BytesIO()
    options = {"compression": "zstd", "compression_level": 19, "write_page_checksum": True}
    with pq.ParquetWriter(buffer, groups[0].schema, store_schema=False, **options) as writer:
        for group in groups:
            writer.write_table(group, row_group_size=group.num_rows)
        grid = f"resolution {resolution:g}"
        writer.add_key_value_metadata({"shards": json.dumps(costs), "grid": grid})
    write_bytes(path, buffer.getvalue())


def cases_of(
    campaign: Path, cell: str, airs: range, samples: range | None = None, copies: Path = Path()
) -> tuple[Case, ...]:
    """Build flights of one condition in the batch engine; an aircraft with bounds from a model form
    is looked for in ``copies``. Raises BadInputError."""
    spec = read_campaign(campaign).with_engine("batch")
    turbulence, _, wind = cell.rpartition("-")
    air = ((float(wind), turbulence),)
    if turbulence not in spec.aleatory.turbulence or float(wind) not in spec.aleatory.wind_mps:
        raise BadInputError(f"{campaign}: has no cell {cell} (TURBULENCE-WIND, as in severe-3)")
    return build_cases(spec, find_mission(spec, copies), Part(airs, air, samples))


def main(argv: Sequence[str] | None = None) -> int:
    """Pack a campaign folder; exit code 0, or 2 for bad input."""
    parser = study_parser(__doc__)
    parser.add_argument("results", type=Path, metavar="RESULTS")
    parser.add_argument("flights", type=Path, metavar="FLIGHTS.parquet")
    parser.add_argument("--resolution", type=float, default=RESOLUTION, metavar="R")
    args = parser.parse_args(argv)

    def run() -> None:
        frame = read_cases(args.results, read_complete(args.results))
        write_flights(frame, args.flights, args.resolution)

    return exit_code(run)


if __name__ == "__main__":
    sys.exit(main())
