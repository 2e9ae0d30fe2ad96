"""``uqharness campaign convergence | area``: what a flown campaign says of its own size, and of real flights."""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict
from pathlib import Path

from uqharness.cli.verb_parser import add_verb
from uqharness.errors import BadInputError

_CONVERGENCE_EXAMPLE = """examples:
  uqharness campaign convergence campaigns/demo/results --repeats 4
  uqharness campaign run campaigns/convergence/campaign.toml --out fig35; uqharness campaign convergence fig35

Writes DIR/convergence.csv and DIR/figures/convergence-*.svg from the flights that were flown; flies nothing.
Exit codes: 0 done, 2 bad input (too few flights and samples included)."""
_AREA_EXAMPLE = """examples:
  uqharness campaign area campaigns/demo/results --value cross_track_median_m_measured=9.41
  uqharness campaign area results --flight flights.csv       one row per flight, columns as in cases.parquet

Writes DIR/area.csv: the area by which the flights lie outside the p-box, in the metric's unit.
Exit codes: 0 no contradiction, 1 flights lie outside by more than chance explains, 2 bad input."""


def register(verbs: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the verbs to those of ``campaign``."""
    convergence = add_verb(verbs, "convergence", "were there enough flights and epistemic samples", _CONVERGENCE_EXAMPLE)
    convergence.add_argument("folder", type=Path, metavar="DIR", help="campaign folder")
    convergence.add_argument("--repeats", type=int, default=10, metavar="N", help="parts of the flights (default 10)")
    convergence.add_argument("--metric", action="append", default=[], metavar="NAME", help="column of cases.parquet (repeatable)")
    convergence.set_defaults(handler=_convergence)
    area = add_verb(verbs, "area", "area metric of real flights against the p-boxes", _AREA_EXAMPLE)
    area.add_argument("folder", type=Path, metavar="DIR", help="campaign folder")
    area.add_argument("--flight", type=Path, metavar="FILE", help="table of flights, .csv or .parquet")
    area.add_argument(
        "--value", action="append", default=[], metavar="METRIC=NUMBER", help="metric of a single flight (repeatable)"
    )
    area.set_defaults(handler=_area)


def _convergence(args: argparse.Namespace) -> int:
    from uqharness.campaign.convergence_study import CONVERGENCE, as_rows, sentences, study, table
    from uqharness.campaign.folder.files import record_table
    from uqharness.files import inner_folder, write_bytes
    from uqharness.report.plots.convergence import draw_convergence

    found = study(args.folder, args.metric, args.repeats)
    record_table(args.folder, CONVERGENCE, table(found))
    figures = inner_folder(args.folder, "figures")
    paths = []
    for item in found:
        if item.repeats is not None or item.growth:
            condition = f"{item.condition.wind_mps:g}mps-{item.condition.turbulence}"
            paths.append(figures / f"convergence-{item.metric.replace('_', '-')}-{condition}.svg")
            write_bytes(paths[-1], draw_convergence(item))
    if args.json:
        print(json.dumps({"table": str(args.folder / CONVERGENCE), "figures": list(map(str, paths)), "rows": as_rows(found)}))
    else:
        print("\n".join([*sentences(found), f"{args.folder / CONVERGENCE}: written, with {len(paths)} figures"]))
    return 0


def _area(args: argparse.Namespace) -> int:
    from uqharness.campaign.area_study import AREAS, compare, read_flights, table
    from uqharness.campaign.folder.files import record_table

    found = compare(args.folder, read_flights(args.flight, dict(map(_value, args.value))))
    record_table(args.folder, AREAS, table(found))
    rows = [
        {"metric": item.metric, "condition": item.condition.label, "verdict": item.verdict} | asdict(item.found) for item in found
    ]
    if args.json:
        print(json.dumps({"table": str(args.folder / AREAS), "rows": rows}))
    else:
        for row in rows:
            print(
                f"{row['metric']}, {row['condition']}: {row['flights']} flights, area {row['area']:.3g} outside the p-box, "
                f"{row['beyond_chance']:.3g} beyond chance: {row['verdict']}"
            )
    return int(any(item.verdict == "outside" for item in found))


def _value(text: str) -> tuple[str, float]:
    name, _, number = text.partition("=")
    try:
        return name.strip(), float(number)
    except ValueError:
        raise BadInputError(f"--value {text}: must be METRIC=NUMBER, such as cross_track_median_m_measured=9.41") from None
