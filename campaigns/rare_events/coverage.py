"""Do the 95 % intervals of splitting hold a rate that plain flights show? Many short studies of the real loiter.

    python -m campaigns.rare_events.coverage [--repeats 100] [--roots 8] [--out DIR]

A repeat is a study of eight means of eight roots each, flights of 300 s; its levels come from one pilot that is not counted, its
predictions from the pilot of the default study (shards/). The truth is the share of plain flights of that length with an excursion.
Writes DIR/coverage.csv, a row a repeat (coverage-N-roots.csv with another number of roots than eight).
Exit code 0: nine of ten intervals hold the truth; 1: otherwise; 2: bad input; 130 interrupted.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from campaigns.full_size.ending import ending
from campaigns.rare_events.folder import Folder
from campaigns.rare_events.rates import shown
from campaigns.rare_events.reproduce import CELL, CORNER, HOME, default_study
from campaigns.rare_events.states import LoiterScore
from campaigns.rare_events.study import GRID, TOP, Study
from uqharness.campaign.execution.worker import BATCH, fly_group
from uqharness.campaign.rare_events import LoiterPaths, Watch
from uqharness.errors import BadInputError
from uqharness.files import write_bytes
from uqharness.flight import FlightSpec
from uqharness.statistics import Levels, interval, pilot, run
from uqharness.text_tables import csv_text

RADIUS_M, DURATION_S = 13.0, 300.0
"""Some one excursion per hour: a plain flight in ten has one, so that the truth is known within some per cent."""
OBSERVATIONS, ROOTS, SHARE = 8, 8, 0.02
SIDE_BY_SIDE = 25
"""Repeats flown in one course: their roots are independent, whoever flies beside them."""
PILOT_ROOTS, PLAIN_A_GROUP = 256, 250
FIRST_REPEAT, FIRST_PILOT, FIRST_PLAIN = 3_000_000, 4_000_000, 5_000_000
SEED = 20161227
TABLE = "coverage.csv"


def flights(study: Study, first: int, count: int) -> tuple[list[FlightSpec], list[int]]:
    """So many flights of DURATION_S, and their aleatory ids."""
    cases = study.cases(first, count)
    specs = [
        replace(case.flight, duration_s=DURATION_S, excursion_radius_m=(RADIUS_M,))
        for case in cases
    ]
    return specs, [case.aleatory_id for case in cases]


def truth(study: Study, count: int) -> tuple[int, int]:
    """Plain flights with an excursion, and how many were flown."""
    hit = 0
    for first in range(0, count, PLAIN_A_GROUP):
        specs, _ = flights(study, FIRST_PLAIN + first, PLAIN_A_GROUP)
        hit += sum(
            flown.metrics[f"excursions_{RADIUS_M:g}m"] > 0 for flown in fly_group(BATCH, specs)
        )
    return hit, -(-count // PLAIN_A_GROUP) * PLAIN_A_GROUP


def observed(
    study: Study, levels: Levels, watch: Watch, repeats: int, roots: int
) -> tuple[NDArray[np.float64], float]:
    """(repeats, OBSERVATIONS) estimates of the share of flights with an excursion, and the hours of paths."""
    each, found, steps = OBSERVATIONS * roots, [], 0
    for first in range(0, repeats, SIDE_BY_SIDE):
        count = min(SIDE_BY_SIDE, repeats - first) * each
        specs, ids = flights(study, FIRST_REPEAT + first * each, count)
        one = run(LoiterPaths(specs, ids, SEED, watch), count, levels, 1)
        found.append(one.probability_by_root.reshape(-1, OBSERVATIONS, roots).mean(axis=2))
        steps += one.steps
    return np.concatenate(found), steps * watch.step_s / 3600.0


def rows(values: NDArray[np.float64], hit: int, flown: int) -> list[dict[str, str]]:
    """coverage.csv of (repeats, OBSERVATIONS) estimates and ``hit`` of ``flown`` plain flights: a repeat's means, its estimate with
    limits, and whether these hold the share of plain flights. Limits are empty where a mean has no excursion."""
    found = []
    for number, means in enumerate(values):
        one = interval(means)
        row = {
            "repeat": str(number),
            "estimate": shown(one.estimate, 9),
            "lower": shown(one.lower, 9),
            "upper": shown(one.upper, 9),
        }
        row |= {
            "held": "yes" if one.lower <= hit / flown <= one.upper else "no",
            "plain_hit": str(hit),
            "plain_flights": str(flown),
        }
        found.append(
            row
            | {f"mean_{place}": shown(value, 9) for place, value in enumerate(map(float, means))}
        )
    return found


def table_name(roots: int) -> str:
    """The file of studies of so many roots a mean."""
    return TABLE if roots == ROOTS else f"coverage-{roots}-roots.csv"


def main(argv: Sequence[str] | None = None) -> int:
    """Print the coverage, and write what each repeat found."""
    parser = argparse.ArgumentParser(
        prog="python -m campaigns.rare_events.coverage",
        description="Coverage of splitting in flight",
    )
    parser.add_argument("--repeats", type=int, default=100, help="studies that are repeated (100)")
    parser.add_argument(
        "--roots",
        type=int,
        default=ROOTS,
        help=f"flights of a mean, of which a repeat has {OBSERVATIONS} ({ROOTS})",
    )
    parser.add_argument(
        "--plain", type=int, default=4000, help="plain flights for the truth (4000)"
    )
    parser.add_argument(
        "--out",
        type=Path,
        default=HOME,
        metavar="DIR",
        help=f"folder of {TABLE} (that of this module)",
    )
    args = parser.parse_args(argv)
    return ending(lambda: _run(args.repeats, args.roots, args.plain, args.out))


def _run(repeats: int, roots: int, plain: int, out: Path) -> int:
    if repeats < 20 or min(roots, plain) < 1:
        raise BadInputError(
            f"--repeats {repeats} --roots {roots} --plain {plain}: 20 repeats, a root and a plain flight at least"
        )
    begun = time.process_time()
    study = default_study(HOME / "campaign.toml", CELL, CORNER)
    tuned = Folder(HOME / "shards" / study.name, study.radii_m).tuned()
    if tuned is None:
        raise BadInputError(
            f"no predictions of {study.name} under {HOME / 'shards'}: run reproduce fly first"
        )
    watch = Watch(study.size.step_s, LoiterScore(replace(tuned.predicted, radius_m=RADIUS_M)))

    def start(number: int) -> LoiterPaths:
        specs, ids = flights(study, FIRST_PILOT + number * PILOT_ROOTS, PILOT_ROOTS)
        return LoiterPaths(specs, ids, SEED, watch)

    levels = pilot(start, PILOT_ROOTS, 1, GRID, TOP, share=SHARE)
    print(
        f"levels at {', '.join(f'{score:.3g}' for score in levels.scores)}; {time.process_time() - begun:.0f} s of a core",
        flush=True,
    )
    values, hours = observed(study, levels, watch, repeats, roots)
    limits = [interval(one) for one in values]
    print(
        f"{repeats} repeats, {hours:.0f} h of paths; {time.process_time() - begun:.0f} s of a core",
        flush=True,
    )
    hit, flown = truth(study, plain)
    out.mkdir(parents=True, exist_ok=True)
    write_bytes(out / table_name(roots), csv_text(rows(values, hit, flown)).encode())
    true, error = hit / flown, float(np.sqrt(hit)) / flown
    held = sum(one.lower <= true <= one.upper for one in limits)
    undefined = sum(not one.lower > 0.0 for one in limits)
    factor = float(np.median([one.upper / one.estimate for one in limits if one.lower > 0.0]))
    ratio, spread = (
        float(values.mean() / true),
        float(values.mean(axis=1).std(ddof=1) / np.sqrt(repeats) / true),
    )
    lowest = int(stats.binom.ppf(0.025, repeats, 0.95))
    print(
        f"plain: {hit} of {flown} flights, {true:.4g} +- {error:.2g}; mean of all repeats over it {ratio:.3f} +- {spread:.2g}"
    )
    print(
        f"{held} of {repeats} intervals hold it, {undefined} are not defined, factor {factor:.2f} in the middle; of right ones "
        f"{lowest} or more would in 39 of 40 cases; {time.process_time() - begun:.0f} s of a core"
    )
    return 0 if held >= 0.9 * repeats else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
