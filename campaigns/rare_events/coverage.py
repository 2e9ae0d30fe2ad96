"""Do the 95 % intervals of splitting hold a rate that plain flights show? Many short studies of the
real loiter.

    python -m campaigns.rare_events.coverage [--repeats 100] [--roots 8] [--out DIR]

A repeat is a study of eight means of eight roots each, flights of 300 s; its levels come from one
pilot that is not counted, its predictions from the pilot of the default study (moderate-4-100100/).
The truth is the share of plain flights of that length with an excursion. Writes DIR/coverage.csv, a
row a repeat (coverage-N-roots.csv with another number of roots than eight). Exit code 0: nine of
ten intervals hold the truth; 1: otherwise; 2: bad input; 130 interrupted.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy import stats

from campaigns.library.study import exit_code, study_parser, write_csv
from campaigns.rare_events.rates import digits
from campaigns.rare_events.reproduce import AIM_M, CELL, CORNER, HOME, read_tuning
from campaigns.rare_events.study import GRID, TOP, LoiterScore, Size, Study
from sysid.arrays import FloatArray
from uqharness.campaign.processes import BATCH, fly_group
from uqharness.campaign.rare_events import CheckpointPlan, LoiterPaths
from uqharness.errors import BadInputError
from uqharness.flight import FlightSpec
from uqharness.statistics import Levels, interval, pilot, run

RADIUS_M, DURATION_S = 13.0, 300.0
"""Some one excursion per hour: a plain flight in ten has one, so that the truth is known within
some per cent."""
OBSERVATIONS, ROOTS, SHARE = 8, 8, 0.02
SIDE_BY_SIDE = 25
"""Repeats flown in one course: their roots are independent, whoever flies beside them."""
PILOT_ROOTS, PLAIN_A_GROUP = 256, 250
FIRST_REPEAT, FIRST_PILOT, FIRST_PLAIN = 3_000_000, 4_000_000, 5_000_000
SEED = 20161227
TABLE = "coverage.csv"


def flights(study: Study, first: int, count: int) -> tuple[list[FlightSpec], list[int]]:
    """Return so many flights of DURATION_S, and their aleatory ids."""
    cases = study.cases(first, count)
    settings = {"duration_s": DURATION_S, "excursion_radius_m": (RADIUS_M,)}
    specs = [replace(case.flight, **settings) for case in cases]
    return specs, [case.aleatory_id for case in cases]


def truth(study: Study, count: int) -> tuple[int, int]:
    """Fly plain flights, and return how many have an excursion and how many were flown."""
    hit, name = 0, f"excursions_{RADIUS_M:g}m"
    for first in range(0, count, PLAIN_A_GROUP):
        specs, _ = flights(study, FIRST_PLAIN + first, PLAIN_A_GROUP)
        hit += sum(result.metrics[name] > 0 for result in fly_group(BATCH, specs))
    return hit, -(-count // PLAIN_A_GROUP) * PLAIN_A_GROUP


def observed(
    study: Study, levels: Levels, watch: CheckpointPlan, repeats: int, roots: int
) -> tuple[FloatArray, float]:
    """Return (repeats, OBSERVATIONS) estimates of the share of flights with an excursion, and the
    hours of paths."""
    each, estimates, steps = OBSERVATIONS * roots, [], 0
    for first in range(0, repeats, SIDE_BY_SIDE):
        count = min(SIDE_BY_SIDE, repeats - first) * each
        specs, ids = flights(study, FIRST_REPEAT + first * each, count)
        course = run(LoiterPaths(specs, ids, SEED, watch), count, levels, 1)
        by_root = course.probability_by_root.reshape(-1, OBSERVATIONS, roots)
        estimates.append(by_root.mean(axis=2))
        steps += course.steps
    return np.concatenate(estimates), steps * watch.step_s / 3600.0


def rows(values: FloatArray, hit: int, flights: int) -> list[dict[str, str]]:
    """Return coverage.csv of (repeats, OBSERVATIONS) estimates and ``hit`` of ``flights`` plain
    flights.

    A row has a repeat's means, its estimate with limits, and whether these hold the share of plain
    flights. Limits are empty where a mean has no excursion.
    """
    table = []
    for number, means in enumerate(values):
        one = interval(means)
        row = {"repeat": str(number)}
        row |= {n: digits(getattr(one, n), 9) for n in ("estimate", "lower", "upper")}
        row["held"] = "yes" if one.lower <= hit / flights <= one.upper else "no"
        row |= {"plain_hit": str(hit), "plain_flights": str(flights)}
        row |= {f"mean_{place}": digits(float(mean), 9) for place, mean in enumerate(means)}
        table.append(row)
    return table


def table_name(roots: int) -> str:
    """Return the file of studies of so many roots a mean."""
    return TABLE if roots == ROOTS else f"coverage-{roots}-roots.csv"


def main(argv: Sequence[str] | None = None) -> int:
    """Print the coverage, and write the result of each repeat."""
    parser = study_parser(__doc__, out=HOME)
    parser.add_argument("--repeats", type=int, default=100, help="studies that are repeated (100)")
    parser.add_argument("--roots", type=int, default=ROOTS, help=f"flights of a mean ({ROOTS})")
    parser.add_argument("--plain", type=int, default=4000, help="plain flights (4000)")
    args = parser.parse_args(argv)
    return exit_code(lambda: _run(args.repeats, args.roots, args.plain, args.out))


def _run(repeats: int, roots: int, plain: int, out: Path) -> int:
    if repeats < 20 or min(roots, plain) < 1:
        raise BadInputError(
            f"--repeats {repeats} --roots {roots} --plain {plain}: 20 repeats, a root and a plain "
            "flight at least"
        )
    initial = time.process_time()
    study = Study(HOME / "campaign.toml", CELL, CORNER, Size(aim_m=AIM_M))
    tuning = read_tuning(HOME / study.name)
    if tuning is None:
        raise BadInputError(f"no predictions of {study.name} in {HOME}: run reproduce fly first")
    watch = CheckpointPlan(
        study.size.step_s, LoiterScore(replace(tuning.predicted, radius_m=RADIUS_M))
    )

    def start(number: int) -> LoiterPaths:
        specs, ids = flights(study, FIRST_PILOT + number * PILOT_ROOTS, PILOT_ROOTS)
        return LoiterPaths(specs, ids, SEED, watch)

    def report(text: str) -> None:
        print(f"{text}; {time.process_time() - initial:.0f} s of a core", flush=True)

    levels = pilot(start, PILOT_ROOTS, 1, GRID, TOP, share=SHARE)
    report(f"levels at {', '.join(f'{score:.3g}' for score in levels.scores)}")
    values, hours = observed(study, levels, watch, repeats, roots)
    report(f"{repeats} repeats, {hours:.0f} h of paths")
    hit, count = truth(study, plain)
    write_csv(out / table_name(roots), rows(values, hit, count))
    limits = [interval(one) for one in values]
    true, error = hit / count, float(np.sqrt(hit)) / count
    lowest = int(stats.binom.ppf(0.025, repeats, 0.95))
    count_held = sum(one.lower <= true <= one.upper for one in limits)
    factors = [one.upper / one.estimate for one in limits if one.lower > 0.0]
    ratio = float(values.mean() / true)
    scatter = float(values.mean(axis=1).std(ddof=1) / np.sqrt(repeats) / true)
    mean = f"mean of all repeats over it {ratio:.3f} +- {scatter:.2g}"
    print(f"plain: {hit} of {count} flights, {true:.4g} +- {error:.2g}; {mean}")
    report(
        f"{count_held} of {repeats} intervals hold it, {repeats - len(factors)} are not defined, "
        f"factor {float(np.median(factors)):.2f} in the middle; of right ones {lowest} or more "
        "would in 39 of 40 cases"
    )
    return 0 if count_held >= 0.9 * repeats else 1


if __name__ == "__main__":
    sys.exit(main())
