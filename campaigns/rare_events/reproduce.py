"""The rate at which the loiter leaves its circle, at one corner in one air, down to 1e-5 per hour
by multilevel splitting.

    python -m campaigns.rare_events.reproduce fly  # pilot and replicates; resumes too
    python -m campaigns.rare_events.reproduce plain  # flights without splitting, to check
    python -m campaigns.rare_events.reproduce jsbsim  # paths with an excursion once more, in JSBSim
    python -m campaigns.rare_events.reproduce tables  # rates.csv
    python -m campaigns.rare_events.reproduce fly --corner 111111 --cell severe-0  # another
"""

from __future__ import annotations

import argparse
import itertools
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import uqharness
from campaigns.library.plan import Plan, identity
from campaigns.library.store import locked
from campaigns.library.study import exit_code, log_progress, study_parser, write_csv
from campaigns.rare_events.folder import JSBSIM, LEVELS, PLAIN, REPLICATES, Folder, Piece
from campaigns.rare_events.rates import Limits, Rate, rates, shown
from campaigns.rare_events.study import Size, Study, chosen_hits
from uqharness.campaign.rare_events import FirstExcursion
from uqharness.errors import BadInputError

HOME = Path(__file__).parent
CORNER, CELL = "100100", "moderate-4"
AIM_M = 21.0
"""Beyond it some 1e-5 excursions per hour are expected in the default cell."""
MANY = sys.maxsize
DIFFERENCE_M = 1e-6
"""Two engines whose paths differ by at most this are alike: a branched path of a minute is within
it."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command; exit code 0 done, 1 JSBSim flies another path, or flights that are not split
    contradict the estimate, 2 bad input, 130 interrupted."""
    parser = study_parser(__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    fly = commands.add_parser("fly", help="fly the pilot and the replicates that are missing")
    fly.add_argument("--replicates", type=int, default=24, metavar="N", help="so many in all (24)")
    fly.add_argument(
        "--aim", type=float, default=AIM_M, metavar="M", help="the scores' radius (21 m)"
    )
    plain = commands.add_parser("plain", help="fly the missing flights without splitting")
    plain.add_argument("--pieces", type=int, default=16, metavar="N", help="of 125 h, in all (16)")
    for each in (fly, plain):
        each.add_argument("--most", type=int, default=MANY, metavar="N", help="fly so many at most")
    jsbsim = commands.add_parser("jsbsim", help="fly branched paths with an excursion in JSBSim")
    jsbsim.add_argument("--paths", type=int, default=20, metavar="N", help="so many (20)")
    tables = commands.add_parser("tables", help="rates.csv of the pieces so far")
    for each in (fly, plain, jsbsim, tables):
        each.add_argument("--corner", default=CORNER, help=f"of the bounds ({CORNER})")
        each.add_argument("--cell", default=CELL, metavar="AIR-WIND", help=f"default {CELL}")
        each.add_argument("--campaign", type=Path, default=HOME / "campaign.toml", metavar="FILE")
        each.add_argument("--studies", type=Path, default=HOME, metavar="DIR", help="their folders")
    args = parser.parse_args(argv)
    return exit_code(lambda: _run(args))


def _run(args: argparse.Namespace) -> int:
    study = default_study(args.campaign, args.cell, args.corner, getattr(args, "aim", AIM_M))
    folder = Folder(args.studies / study.name, study.radii_m)
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
    """Return a corner in a cell of a campaign file. Raises BadInputError."""
    plan = Plan.read(campaign, 1)
    return Study(plan, plan.condition(cell), corner, Size(aim_m=aim_m))


def fly(study: Study, folder: Folder, replicates: int, most: int = MANY) -> None:
    """Fly the pilot unless it has flown, then the replicates that are missing, ``most`` at most.
    Raises BadInputError."""
    tuning = folder.tuning()
    if tuning is None:
        if folder.pieces(REPLICATES):
            raise BadInputError(
                f"{folder.path}: has replicates and no {LEVELS}; remove {REPLICATES}, and fly again"
            )
        tuning = study.tune()
        folder.keep_tuning(tuning)
        scores = ", ".join(f"{score:.3g}" for score in tuning.levels.scores)
        aim = f"standard deviations to {tuning.predicted.radius_m:g} m"
        log_progress(f"pilot: levels at {scores} {aim}; {tuning.core_s:.0f} s of a core")

    def replicate(number: int) -> Piece:
        counts, hits = study.replicate(number, tuning)
        folder.keep_hits(number, hits)
        paths = f"{counts.path_s / 3600.0:.0f} h of paths, {counts.most} at most"
        log_progress(f"replicate {number}: {paths}, {counts.core_s:.0f} s of a core")
        digest = study.tuned_identity(study.replicate_cases(number), tuning)
        return Piece(number, counts, digest, uqharness.__version__)

    _fly_missing(folder, REPLICATES, replicates, most, replicate)


def fly_plain(study: Study, folder: Folder, pieces: int, most: int = MANY) -> None:
    """Fly the pieces without splitting that are missing, ``most`` at most. Raises BadInputError."""

    def piece(number: int) -> Piece:
        counts = study.plain(number)
        log_progress(
            f"plain {number}: {counts.path_s / 3600.0:g} h, {counts.core_s:.0f} s of a core"
        )
        digest = identity(study.plain_cases(number))
        return Piece(number, counts, digest, uqharness.__version__)

    _fly_missing(folder, PLAIN, pieces, most, piece)


def _fly_missing(
    folder: Folder, table: str, total: int, most: int, fly_piece: Callable[[int], Piece]
) -> None:
    missing = (number for number in range(total) if number not in folder.pieces(table))
    for number in itertools.islice(missing, most):
        folder.add(table, fly_piece(number))


def checked_pieces(study: Study, folder: Folder) -> tuple[list[Piece], list[Piece]]:
    """Read replicates and plain pieces. Raises BadInputError for those of other flights, and
    without a replicate."""
    tuning, split, plain = folder.tuning(), folder.pieces(REPLICATES), folder.pieces(PLAIN)
    if tuning is None or not split:
        raise BadInputError(f"{folder.path}: no replicate yet; run the command fly")
    digests = {n: study.tuned_identity(study.replicate_cases(n), tuning) for n in split}
    others = [n for n, piece in split.items() if piece.flights_id != digests[n]]
    others += [
        n for n, piece in plain.items() if piece.flights_id != identity(study.plain_cases(n))
    ]
    if others:
        raise BadInputError(
            f"{folder.path}: piece {others[0]} was flown with another aircraft, script, campaign "
            "file or other levels; go on where those are, or remove the folder and fly it again"
        )
    return list(split.values()), list(plain.values())


def jsbsim(study: Study, folder: Folder, paths: int) -> int:
    """Write jsbsim.csv: branched paths with an excursion, flown by JSBSim unless it has them; 1
    where a path differs.

    Raises BadInputError.
    """
    checked_pieces(study, folder)
    hits = chosen_hits(folder.hits(), paths)
    if not hits:
        raise BadInputError(
            f"{folder.path}: no branched path with an excursion was kept; fly more replicates"
        )
    for hit in hits:
        row, rows = _path(study, hit), folder.reflown()
        if any(row.items() <= other.items() for other in rows):
            continue
        distance, beyond = study.reflown(hit)
        row["difference_m"] = f"{abs(distance - hit.distance_m):.2g}"
        row["first_row_beyond"] = "same" if beyond == 1 else "other"
        folder.keep_reflown([*rows, row])
        place = f"{hit.distance_m:.3f} m at {row['time_s']} s"
        log_progress(f"{len(rows) + 1}: {place}, {row['difference_m']} m from JSBSim's")
    rows = folder.reflown()
    largest = max(float(row["difference_m"]) for row in rows)
    words = f"largest difference {largest:.2g} m at the excursion"
    print(f"{len(rows)} branched paths in JSBSim: {words} ({folder.path / JSBSIM})")
    same = all(row["first_row_beyond"] == "same" for row in rows)
    return 0 if largest <= DIFFERENCE_M and same else 1


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
    """Write rates.csv; 1 where flights that are not split contradict the estimate. Raises
    BadInputError."""
    split, plain = ([p.counts for p in part] for part in checked_pieces(study, folder))
    results = rates(study.radii_m, study.hours, split, plain)
    write_csv(folder.path / "rates.csv", [_row(rate) for rate in results])
    print("\n".join(_words(rate) for rate in results))
    return 1 if any(rate.agree is False for rate in results) else 0


def _row(rate: Rate) -> dict[str, str]:
    row = {"radius_m": f"{rate.radius_m:g}", "observations": str(rate.observations)}
    row["largest_share"] = shown(rate.largest)
    for name in ("split", "split_per_h", "plain", "plain_per_h"):
        limits = getattr(rate, name)
        row |= {name: shown(limits.estimate), f"{name}_lower": shown(limits.lower)}
        row[f"{name}_upper"] = shown(limits.upper)
    row |= {"cluster": shown(rate.cluster), "plain_flights": str(rate.plain_flights)}
    row |= {"plain_hit": str(rate.plain_hit), "p_value": shown(rate.p_value)}
    return row | {"agree": {None: "", True: "yes", False: "no"}[rate.agree], "reason": rate.reason}


def _words(rate: Rate) -> str:
    plain = f"{rate.plain_hit} of {rate.plain_flights}"
    if rate.reason:
        return f"{rate.radius_m:g} m: no rate to use; {rate.reason}; {plain} plain flights have one"
    words = (
        f"{rate.radius_m:g} m: {_limits(rate.split_per_h)} per hour by {rate.observations} means"
    )
    words += f", {shown(rate.cluster)} a cluster, one replicate has {100.0 * rate.largest:.2g} %"
    if rate.plain_flights:
        shares = f"{_limits(rate.split)}, not split {_limits(rate.plain)} ({plain})"
        words += f"; flights with one: {shares}"
    if rate.agree is None:
        return words
    return f"{words}: {'they agree' if rate.agree else 'they differ'} (p = {shown(rate.p_value)})"


def _limits(limits: Limits) -> str:
    return f"{shown(limits.estimate)} ({shown(limits.lower)} to {shown(limits.upper)})"


if __name__ == "__main__":
    sys.exit(main())
