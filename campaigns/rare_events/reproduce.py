"""The rate at which the loiter leaves its circle, at one corner in one air, down to 1e-5 per hour
by multilevel splitting.

    python -m campaigns.rare_events.reproduce fly  # pilot and replicates; resumes too
    python -m campaigns.rare_events.reproduce plain  # flights without splitting, to check
    python -m campaigns.rare_events.reproduce jsbsim  # paths with an excursion once more, in JSBSim
    python -m campaigns.rare_events.reproduce tables  # rates.csv
    python -m campaigns.rare_events.reproduce fly --corner 111111 --cell severe-0  # another

A study's folder has levels.json, replicates.csv, plain.csv, jsbsim.csv and hits.parquet. A piece
counts once its row is in its table: an interruption costs the piece in the air.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow as pa

import uqharness
from campaigns.library.study import exit_code, log_progress, study_parser, write_csv
from campaigns.rare_events.rates import digits, rates
from campaigns.rare_events.study import NAMES, Size, Study, Tuning, chosen_hits
from uqharness.campaign.rare_events import DistancePredictor, FirstExcursion
from uqharness.errors import BadInputError
from uqharness.files import write_bytes
from uqharness.flight import Split
from uqharness.parquet_files import read_table, write_table
from uqharness.statistics import Levels

HOME = Path(__file__).parent
LEVELS, REPLICATES, PLAIN, JSBSIM = "levels.json", "replicates.csv", "plain.csv", "jsbsim.csv"
HITS, RATES = "hits.parquet", "rates.csv"
CORNER, CELL = "100100", "moderate-4"
AIM_M = 21.0
"""Beyond it some 1e-5 excursions per hour are expected in the default cell."""
DIFFERENCE_M = 1e-6
"""Two engines whose paths differ by at most this are alike: a branched path of a minute is within
it."""


def read_tuning(folder: Path) -> Tuning | None:
    """Read what the pilot chose, if it has flown. Raises BadInputError for a damaged file."""
    file = folder / LEVELS
    if not file.exists():
        return None
    try:
        content = json.loads(file.read_bytes())
        fit = content["predicted"]
        if fit["regressors"] != list(NAMES):
            raise ValueError("predictions of other regressors")
        lists = {n: tuple(map(float, fit[n])) for n in ("horizons_s", "constants", "sigmas")}
        rows = tuple(tuple(map(float, row)) for row in fit["coefficients"])
        predicted = DistancePredictor(float(fit["radius_m"]), coefficients=rows, **lists)
        levels = Levels(tuple(map(float, content["scores"])), int(content["copies"]))
        return Tuning(levels, predicted, float(content["core_s"]), float(content["plain_h"]))
    except (ValueError, KeyError, TypeError) as error:
        raise BadInputError(
            f"{file}: no levels of a pilot ({error}); remove it and its replicates, and fly again"
        ) from error


def write_tuning(folder: Path, tuning: Tuning) -> None:
    """Write levels.json: levels in standard deviations, and the predictions' coefficients by
    horizon and regressor."""
    content = {"scores": tuning.levels.scores, "copies": tuning.levels.copies}
    content |= {"core_s": tuning.core_s, "plain_h": tuning.plain_h}
    content |= {"predicted": {"regressors": NAMES} | asdict(tuning.predicted)}
    folder.mkdir(parents=True, exist_ok=True)
    write_bytes(folder / LEVELS, (json.dumps(content) + "\n").encode())


def read_rows(path: Path, study: Study) -> pd.DataFrame:
    """Read a table of pieces, empty where there is none. Raises BadInputError for a damaged one."""
    names = [f"{n}_{r:g}m" for n in ("probability", "events", "squares") for r in study.radii_m]
    names = ["number", "flights", *names, "flights_id"]
    try:
        return pd.read_csv(path)[names] if path.exists() else pd.DataFrame(columns=names)
    except (ValueError, KeyError) as error:
        raise BadInputError(f"{path}: damaged ({error}); restore it, or fly again") from error


def add_row(path: Path, row: dict[str, Any]) -> None:
    """Add a row to a table, in the order of its numbers."""
    rows = pd.read_csv(path, dtype=str, keep_default_na=False) if path.exists() else pd.DataFrame()
    texts = {name: "" if value != value else str(value) for name, value in row.items()}
    rows = pd.concat([rows, pd.DataFrame([texts])])
    if "number" in rows:
        rows = rows.sort_values("number", key=lambda numbers: numbers.astype(int))
    write_csv(path, rows.to_dict("records"))


def read_hits(folder: Path, study: Study) -> list[FirstExcursion]:
    """Read the excursions that were kept with their path, of the replicates that count."""
    counted, hits = set(read_rows(folder / REPLICATES, study)["number"]), []
    for row in read_table(folder / HITS).to_pylist() if (folder / HITS).exists() else []:
        splits = tuple(Split(**split) for split in row.pop("splits"))
        if row.pop("replicate") in counted:
            hits.append(FirstExcursion(**row, splits=splits))
    return hits


def write_hits(folder: Path, number: int, hits: Sequence[FirstExcursion]) -> None:
    """Write the excursions of one replicate."""
    path = folder / HITS
    rows = read_table(path).to_pylist() if path.exists() else []
    rows = [row for row in rows if row["replicate"] != number]
    rows += [{"replicate": number} | asdict(hit) for hit in hits]
    if rows:
        write_table(pa.Table.from_pylist(rows), path)


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


def _run(args: argparse.Namespace) -> int | None:
    size = Size(aim_m=getattr(args, "aim", AIM_M))
    study = Study(args.campaign, args.cell, args.corner, size)
    folder = args.studies / study.name
    commands: dict[str, Callable[[], int | None]] = {
        "fly": lambda: fly(study, folder, args.replicates),
        "plain": lambda: fly_missing(folder / PLAIN, study, args.pieces, study.plain),
        "jsbsim": lambda: jsbsim(study, folder, args.paths),
        "tables": lambda: tables(study, folder),
    }
    return commands[args.command]()


def fly(study: Study, folder: Path, replicates: int) -> None:
    """Fly the pilot unless it has flown, then the replicates that are missing. Raises
    BadInputError."""
    tuning = read_tuning(folder)
    if tuning is None:
        if (folder / REPLICATES).exists():
            raise BadInputError(
                f"{folder}: has replicates and no {LEVELS}; remove {REPLICATES}, and fly again"
            )
        tuning = study.tune()
        write_tuning(folder, tuning)
        scores = ", ".join(digits(score) for score in tuning.levels.scores)
        log_progress(f"pilot: levels at {scores}; {tuning.core_s:.0f} s of a core")

    def replicate(number: int) -> dict[str, Any]:
        row, hits = study.replicate(number, tuning)
        write_hits(folder, number, hits)
        return row

    fly_missing(folder / REPLICATES, study, replicates, replicate)


def fly_missing(
    table: Path, study: Study, total: int, fly_piece: Callable[[int], dict[str, Any]]
) -> None:
    """Fly the pieces that the table lacks, up to ``total`` in all. Raises BadInputError."""
    refuse_other_flights(study, table.parent)
    for number in sorted(set(range(total)) - set(read_rows(table, study)["number"])):
        row = fly_piece(number)
        add_row(table, row | {"version": uqharness.__version__})
        hours = row["path_s"] / 3600.0
        log_progress(f"{table.stem} {number}: {hours:.0f} h in {row['core_s']:.0f} s of a core")


def pieces(study: Study, folder: Path) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Read replicates and plain pieces. Raises BadInputError without a replicate."""
    split, plain = (read_rows(folder / name, study) for name in (REPLICATES, PLAIN))
    if split.empty:
        raise BadInputError(f"{folder}: no replicate yet; run the command fly")
    return split, plain


def has_other_flights(study: Study, folder: Path) -> bool:
    """Return whether pieces were flown with another aircraft, script or campaign file than these,
    or with other levels."""
    tuning = read_tuning(folder)
    split, plain = (read_rows(folder / name, study) for name in (REPLICATES, PLAIN))
    expected = [study.identity(study.replicate_cases(n), tuning) for n in split["number"]]
    expected += [study.identity(study.plain_cases(n)) for n in plain["number"]]
    return expected != [*split["flights_id"], *plain["flights_id"]]


def refuse_other_flights(study: Study, folder: Path) -> None:
    """Raise BadInputError before flights are added to those of another aircraft."""
    if has_other_flights(study, folder):
        raise BadInputError(
            f"{folder}: has pieces flown with another aircraft, script, campaign file or other "
            "levels; name another folder with --studies"
        )


def jsbsim(study: Study, folder: Path, paths: int) -> int:
    """Write jsbsim.csv: branched paths with an excursion, flown by JSBSim unless it has them; 1
    where a path differs. Raises BadInputError."""
    refuse_other_flights(study, folder)
    hits, table = chosen_hits(read_hits(folder, study), paths), folder / JSBSIM
    if not hits:
        raise BadInputError(
            f"{folder}: no branched path with an excursion was kept; fly more replicates"
        )
    for hit in hits:
        row = {"aleatory_id": str(hit.aleatory_id), "radius_m": f"{study.radii_m[hit.kind]:g}"}
        row |= {"time_s": f"{hit.frame * study.dt_s:.6g}", "branches": str(len(hit.splits))}
        since = (hit.frame - hit.splits[-1].frame) * study.dt_s
        row |= {"since_last_branch_s": f"{since:.4g}", "distance_m": f"{hit.distance_m:.9f}"}
        rows = pd.read_csv(table, dtype=str).to_dict("records") if table.exists() else []
        if any(row.items() <= other.items() for other in rows):
            continue
        distance, outside = study.reflown(hit)
        row["difference_m"] = f"{abs(distance - hit.distance_m):.2g}"
        row["first_row_beyond"] = "same" if outside == 1 else "other"
        add_row(table, row)
        log_progress(f"{hit.distance_m:.3f} m at {row['time_s']} s: {row['difference_m']} m apart")
    frame = pd.read_csv(table)
    largest = frame["difference_m"].max()
    print(f"{len(frame)} branched paths in JSBSim: largest difference {largest:.2g} m ({table})")
    same = (frame["first_row_beyond"] == "same").all()
    return 0 if largest <= DIFFERENCE_M and same else 1


def tables(study: Study, folder: Path) -> int:
    """Write rates.csv; 1 where flights that are not split contradict the estimate. Raises
    BadInputError."""
    results = rates(study.radii_m, study.hours, *pieces(study, folder))
    agree = {None: "", True: "yes", False: "no"}
    write_csv(
        folder / RATES,
        (
            {n: digits(v) if isinstance(v, float) else str(v) for n, v in row.items()}
            | {"agree": agree[row["agree"]]}
            for row in results
        ),
    )
    for row in results:
        text = f"{row['radius_m']:g} m: {_words(row, 'split_per_h')} per hour"
        if row["plain_flights"]:
            text += f"; flights with one: {_words(row, 'split')}, not split {_words(row, 'plain')}"
        print(f"{text} {row['reason'] or '(p = ' + digits(row['p_value']) + ')'}")
    if has_other_flights(study, folder):
        print("note: aircraft, script or campaign file have changed since these pieces were flown")
    return 1 if any(row["agree"] is False for row in results) else 0


def _words(row: dict[str, Any], name: str) -> str:
    estimate, *limits = (digits(row[f"{name}{end}"]) for end in ("", "_lower", "_upper"))
    return f"{estimate} ({' to '.join(limits)})"


if __name__ == "__main__":
    sys.exit(main())
