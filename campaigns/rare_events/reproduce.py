"""The rate at which the loiter leaves its circle, at one corner in one air, down to 1e-5 per hour by multilevel splitting.

python -m campaigns.rare_events.reproduce fly                        # pilot and replicates; goes on where it was ended
python -m campaigns.rare_events.reproduce plain                      # flights that are not split, to check the estimate
python -m campaigns.rare_events.reproduce jsbsim                     # paths with an excursion once more, in JSBSim
python -m campaigns.rare_events.reproduce tables                     # rates.csv
python -m campaigns.rare_events.reproduce fly --corner 111111 --cell severe-0     # any corner and air of campaign.toml
"""

from __future__ import annotations

import argparse
import itertools
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import uqharness
from campaigns.full_size.ending import ending
from campaigns.full_size.folder import locked
from campaigns.full_size.plan import Plan, identity
from campaigns.rare_events.folder import JSBSIM, LEVELS, PLAIN, REPLICATES, Folder, Line
from campaigns.rare_events.rates import Limits, Rate, rates, shown
from campaigns.rare_events.study import Size, Study, chosen_hits
from uqharness.campaign.rare_events import FirstExcursion
from uqharness.errors import BadInputError
from uqharness.files import write_bytes
from uqharness.text_tables import csv_text

HOME = Path(__file__).parent
CORNER, CELL = "100100", "moderate-4"
RATES = "rates.csv"
AIM_M = 21.0
"""Beyond it some 1e-5 excursions per hour are to be found in the default cell."""
REPLICATES_WANTED, PLAIN_WANTED, PATHS = 24, 16, 20
DIFFERENCE_M = 1e-6
"""Two engines whose paths differ by no more are alike: a branched path of a minute is within it."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command; exit code 0 done, 1 JSBSim flies another path, or flights that are not split contradict the estimate, 2 bad
    input, 130 interrupted."""
    parser = argparse.ArgumentParser(
        prog="python -m campaigns.rare_events.reproduce", description="Rates of rare excursions"
    )
    commands = parser.add_subparsers(dest="command", required=True)
    flying = commands.add_parser("fly", help="fly the pilot and the replicates that are missing")
    flying.add_argument(
        "--replicates",
        type=int,
        default=REPLICATES_WANTED,
        metavar="N",
        help=f"so many in all ({REPLICATES_WANTED})",
    )
    plain = commands.add_parser(
        "plain", help="fly the flights that are not split, 125 h a piece, that are missing"
    )
    plain.add_argument(
        "--pieces", type=int, default=PLAIN_WANTED, metavar="N", help="so many in all (16)"
    )
    for each in (flying, plain):
        each.add_argument(
            "--most", type=int, default=sys.maxsize, metavar="N", help="fly so many at most"
        )
    again = commands.add_parser(
        "jsbsim", help="fly branched paths with an excursion again, in JSBSim"
    )
    again.add_argument("--paths", type=int, default=PATHS, metavar="N", help="so many (20)")
    made = commands.add_parser("tables", help="rates.csv of what is there")
    for each in (flying, plain, again, made):
        each.add_argument("--corner", default=CORNER, help=f"of the bounds ({CORNER})")
        each.add_argument(
            "--cell", default=CELL, metavar="AIR-WIND", help=f"turbulence and wind ({CELL})"
        )
        each.add_argument("--campaign", type=Path, default=HOME / "campaign.toml", metavar="FILE")
        each.add_argument("--shards", type=Path, default=HOME / "shards", metavar="DIR")
    flying.add_argument(
        "--aim",
        type=float,
        default=AIM_M,
        metavar="M",
        help=f"radius of the pilot's scores, m ({AIM_M:g})",
    )
    args = parser.parse_args(argv)
    return ending(lambda: _run(args))


def _run(args: argparse.Namespace) -> int:
    study = default_study(args.campaign, args.cell, args.corner, getattr(args, "aim", AIM_M))
    folder = Folder(args.shards / study.name, study.radii_m)
    if args.command == "tables":
        return tables(study, folder)
    with locked(folder.path):
        if args.command == "jsbsim":
            return jsbsim(study, folder, args.paths)
        if args.command == "fly":
            fly(study, folder, args.replicates, args.most)
        else:
            fly_plain(study, folder, args.pieces, args.most)
    return 0


def default_study(campaign: Path, cell: str, corner: str, aim_m: float = AIM_M) -> Study:
    """A corner in a cell of a campaign file. Raises BadInputError."""
    plan = Plan.read(campaign, 1)
    return Study(plan, plan.condition(cell), corner, Size(aim_m=aim_m))


def fly(study: Study, folder: Folder, replicates: int, most: int = sys.maxsize) -> None:
    """Fly the pilot where it has not flown, then the replicates that are missing, ``most`` at most. Raises BadInputError."""
    tuned = folder.tuned()
    if tuned is None:
        if folder.lines(REPLICATES):
            raise BadInputError(
                f"{folder.path}: has replicates and no {LEVELS}; remove {REPLICATES}, and fly again"
            )
        tuned = study.tune()
        folder.keep_tuned(tuned)
        scores = ", ".join(f"{score:.3g}" for score in tuned.levels.scores)
        _say(
            f"pilot: levels at {scores} standard deviations to {tuned.predicted.radius_m:g} m; {tuned.core_s:.0f} s of a core"
        )

    def flown(number: int) -> Line:
        found, hits = study.replicate(number, tuned)
        folder.keep_hits(number, hits)
        _say(
            f"replicate {number}: {found.path_s / 3600.0:.0f} h of paths, {found.most} at most, {found.core_s:.0f} s of a core"
        )
        return Line(
            number,
            found,
            study.tuned_by(study.replicate_cases(number), tuned),
            uqharness.__version__,
        )

    _fly_missing(folder, REPLICATES, replicates, most, flown)


def fly_plain(study: Study, folder: Folder, pieces: int, most: int = sys.maxsize) -> None:
    """Fly the pieces without splitting that are missing, ``most`` at most. Raises BadInputError."""

    def flown(number: int) -> Line:
        found = study.plain(number)
        _say(f"plain {number}: {found.path_s / 3600.0:g} h, {found.core_s:.0f} s of a core")
        return Line(number, found, identity(study.plain_cases(number)), uqharness.__version__)

    _fly_missing(folder, PLAIN, pieces, most, flown)


def _fly_missing(
    folder: Folder, table: str, wanted: int, most: int, flown: Callable[[int], Line]
) -> None:
    missing = (number for number in range(wanted) if number not in folder.lines(table))
    for number in itertools.islice(missing, most):
        folder.add(table, flown(number))


def known_lines(study: Study, folder: Folder) -> tuple[list[Line], list[Line]]:
    """Replicates and plain pieces that are there. Raises BadInputError for those of other flights, and without a replicate."""
    tuned, split = folder.tuned(), folder.lines(REPLICATES)
    if tuned is None or not split:
        raise BadInputError(f"{folder.path}: no replicate yet; run the command fly")
    plain = folder.lines(PLAIN)
    whose = {number: study.tuned_by(study.replicate_cases(number), tuned) for number in split}
    others = [n for n, line in split.items() if line.flights_id != whose[n]]
    others += [n for n, line in plain.items() if line.flights_id != identity(study.plain_cases(n))]
    if others:
        raise BadInputError(
            f"{folder.path}: piece {others[0]} was flown with another aircraft, script, campaign file or other levels; go "
            "on where those are, or remove the folder and fly it again"
        )
    return list(split.values()), list(plain.values())


def jsbsim(study: Study, folder: Folder, paths: int) -> int:
    """jsbsim.csv: branched paths with an excursion, flown by JSBSim where it lacks them; 1 where a path differs.

    Raises BadInputError.
    """
    known_lines(study, folder)
    wanted = chosen_hits(folder.hits(), paths)
    if not wanted:
        raise BadInputError(
            f"{folder.path}: no branched path with an excursion was kept; fly more replicates"
        )
    for hit in wanted:
        row = _path(study, hit)
        rows = folder.reflown()
        if any(row.items() <= known.items() for known in rows):
            continue
        distance, beyond = study.reflown(hit)
        found = {
            "difference_m": f"{abs(distance - hit.distance_m):.2g}",
            "first_row_beyond": "same" if beyond == 1 else "other",
        }
        folder.keep_reflown([*rows, row | found])
        _say(
            f"{len(rows) + 1}: {hit.distance_m:.3f} m at {row['time_s']} s, {found['difference_m']} m from JSBSim's"
        )
    rows = folder.reflown()
    largest = max(float(row["difference_m"]) for row in rows)
    print(
        f"{len(rows)} branched paths in JSBSim: largest difference {largest:.2g} m at the excursion ({folder.path / JSBSIM})"
    )
    return (
        0
        if largest <= DIFFERENCE_M and all(row["first_row_beyond"] == "same" for row in rows)
        else 1
    )


def _path(study: Study, hit: FirstExcursion) -> dict[str, str]:
    return {
        "aleatory_id": str(hit.aleatory_id),
        "radius_m": f"{study.radii_m[hit.kind]:g}",
        "time_s": f"{hit.frame * study.dt_s:.6g}",
        "branches": str(len(hit.splits)),
        "since_last_branch_s": f"{(hit.frame - hit.splits[-1].frame) * study.dt_s:.4g}",
        "distance_m": f"{hit.distance_m:.9f}",
    }


def tables(study: Study, folder: Folder) -> int:
    """rates.csv of what is there; 1 where flights that are not split contradict the estimate. Raises BadInputError."""
    split, plain = known_lines(study, folder)
    found = rates(
        study.radii_m,
        study.hours,
        [line.counted for line in split],
        [line.counted for line in plain],
    )
    write_bytes(folder.path / RATES, csv_text([_row(one) for one in found]).encode())
    for one in found:
        print(_words(one))
    return 1 if any(one.agree is False for one in found) else 0


def _row(one: Rate) -> dict[str, str]:
    row = {
        "radius_m": f"{one.radius_m:g}",
        "observations": str(one.observations),
        "largest_share": shown(one.largest),
    }
    for name in ("split", "split_per_h", "plain", "plain_per_h"):
        limits = getattr(one, name)
        row |= {
            name: shown(limits.estimate),
            f"{name}_lower": shown(limits.lower),
            f"{name}_upper": shown(limits.upper),
        }
    row |= {
        "cluster": shown(one.cluster),
        "plain_flights": str(one.plain_flights),
        "plain_hit": str(one.plain_hit),
    }
    row["p_value"] = shown(one.p_value)
    return row | {"agree": {None: "", True: "yes", False: "no"}[one.agree], "reason": one.reason}


def _words(one: Rate) -> str:
    if one.reason:
        return f"{one.radius_m:g} m: no rate to use; {one.reason}; {one.plain_hit} of {one.plain_flights} plain flights have one"
    told = f"{one.radius_m:g} m: {_limits(one.split_per_h)} per hour by {one.observations} means, {shown(one.cluster)} a cluster"
    told += f", one replicate has {100.0 * one.largest:.2g} %"
    if one.plain_flights:
        told += f"; flights with one: {_limits(one.split)}, not split {_limits(one.plain)} ({one.plain_hit} of {one.plain_flights})"
    return (
        told
        if one.agree is None
        else f"{told}: {'they agree' if one.agree else 'they differ'} (p = {shown(one.p_value)})"
    )


def _limits(limits: Limits) -> str:
    return f"{shown(limits.estimate)} ({shown(limits.lower)} to {shown(limits.upper)})"


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
