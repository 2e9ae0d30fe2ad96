"""Memory that tables of a million flights need: shards with made-up numbers, and the peak while
tables are made of them.

    python -m campaigns.library.memory corners [--flights 1000000]
    python -m campaigns.library.memory walks [--flights 1000000]

``corners`` are the 64 of Tables 3.1 and 3.2 in one cell: statements, p-boxes and shares. ``walks``
are the 2,000 of Fig 3.10, 500 flights each at full number: containment beside the corners of
campaigns/excursions, and how many walks are enough. Nothing flies; shards have the columns, types
and digests of flown ones. The peak is that of the process, and can be read on Linux and macOS. Exit
code 0: the peak is below 2 GB; 1: above; 2: bad input.
"""

from __future__ import annotations

import importlib
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa

from campaigns.excursions import full_size as excursions
from campaigns.library.grid import SKETCHED, coded
from campaigns.library.plan import Plan, cell_name, identity
from campaigns.library.store import ShardRecord, add, cell_table
from campaigns.library.study import exit_code, log_progress, study_parser
from campaigns.loiter import full_size as loiter
from sysid.digests import sha256_hex
from uqharness.campaign.cases import Case
from uqharness.campaign.conditions import Condition, excursion_columns
from uqharness.errors import BadInputError
from uqharness.parquet_files import table_bytes

ALLOWED_MB = 2000.0
CELL, CORNERS, WALKS = "severe-3", 64, 2000
ENDS_EARLY = 1e-5
"""Share of flights that are marked as diverged."""


def synthetic_table(cases: Sequence[Case], rng: np.random.Generator, resolution: float) -> pa.Table:
    """Make a shard's table of invented numbers: medians with a sample's and an air's part, Poisson
    excursions."""
    _, sample = np.unique([case.epistemic_id for case in cases], return_inverse=True)
    _, air = np.unique([case.aleatory_id for case in cases], return_inverse=True)
    of_sample = np.random.default_rng(1).normal(0.0, 0.05, len(cases))[sample]
    of_air = rng.normal(0.0, 0.03, len(cases))[air]
    ended = rng.random(len(cases)) < ENDS_EARLY
    columns = {
        "status": pa.array(np.where(ended, "diverged", "ok").tolist(), pa.string()),
        "duration_s": pa.array(np.where(ended, 1800.0, np.nan), pa.float32(), from_pandas=True),
    }
    for name in (*excursion_columns(cases[0].flight.excursion_radius_m), "loss_of_control"):
        rate = 0.0 if name == "loss_of_control" else 2.0
        columns[name] = pa.array(rng.poisson(rate, len(cases)), pa.int32())
    for name in SKETCHED:
        values = 2.0 * np.exp(of_sample + of_air + rng.normal(0.0, 0.02, len(cases)))
        numbers = coded(values, resolution)
        columns[name] = pa.array(numbers.data, pa.int16(), mask=np.ma.getmaskarray(numbers) | ended)
    return pa.table(columns)


def fill(plan: Plan, folder: Path, condition: Condition) -> int:
    """Write invented shards of all flights of a condition, and return how many flights."""
    flights = 0
    for shard in plan.only([cell_name(condition)]):
        cases = plan.cases(shard)
        table = synthetic_table(cases, np.random.default_rng([2, shard.number]), plan.resolution)
        content = table_bytes(table)
        ended = int(np.sum(np.array(table["status"].to_pylist()) != "ok"))
        hours = sum(case.flight.duration_s for case in cases) / 3600.0 - 0.5 * ended
        airs = shard.part.aleatory_ids
        place = (shard.number, airs.start, len(airs), len(cases), ended, hours)
        digests = (identity(cases), "", sha256_hex(content), "", "")
        record = ShardRecord(*place, 0.0, 0, 0.0, 0, 0.0, "", *digests)
        add(folder, shard, record, content)
        flights += len(cases)
    return flights


def corners(folder: Path, flights: int) -> int:
    """Fill a cell of Tables 3.1 and 3.2, make the tables of it, and return how many flights it
    has."""
    plan = excursions.plan().with_flights(flights // CORNERS)
    condition = plan.condition(CELL)
    count = fill(plan, folder / "shards", condition)
    log_progress(f"{count} flights lie in {folder}: {peak_mb():.0f} MB so far")
    excursions.tables(plan, folder / "shards", folder)
    log_progress(f"statements are made: {peak_mb():.0f} MB so far")
    loiter.write_tables(cell_table(plan, folder / "shards", condition)[0], folder)
    return count


def walks(folder: Path, flights: int) -> int:
    """Fill the walks of Fig 3.10, make the tables of them, and return how many flights they are."""
    module = importlib.import_module("campaigns.time-varying.full_size")
    plan = module.plan().with_flights(flights // WALKS)
    count = fill(plan, folder / "shards", plan.conditions[0])
    log_progress(f"{count} flights lie in {folder}: {peak_mb():.0f} MB so far")
    module.tables(plan, folder / "shards", folder)
    return count


def peak_mb() -> float:
    """Return the largest resident memory of this process so far, in MB. Raises BadInputError where
    it cannot be read."""
    try:
        import resource
    except ImportError as error:
        raise BadInputError("the peak of the memory can be read on Linux and macOS only") from error
    unit = 1e6 if sys.platform == "darwin" else 1e3
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / unit


def main(argv: Sequence[str] | None = None) -> int:
    """Make the tables of one kind, and print the peak."""
    parser = study_parser(__doc__)
    parser.add_argument("kind", choices=["corners", "walks"])
    parser.add_argument(
        "--flights", type=int, default=1_000_000, metavar="N", help="how many (1000000)"
    )
    args = parser.parse_args(argv)
    return exit_code(lambda: _run(args.kind, args.flights))


def _run(kind: str, flights: int) -> int:
    if flights < WALKS:
        raise BadInputError(f"--flights {flights}: {WALKS} at least, one of each walk")
    started, before = time.process_time(), peak_mb()
    with tempfile.TemporaryDirectory() as folder:
        count = {"corners": corners, "walks": walks}[kind](Path(folder), flights)
    peak, cost = peak_mb(), time.process_time() - started
    print(
        f"{kind}: tables of {count} flights, {peak:.0f} MB at most ({before:.0f} MB before the "
        f"first); {cost:.0f} s of a core"
    )
    return 0 if peak <= ALLOWED_MB else 1


if __name__ == "__main__":
    sys.exit(main())
