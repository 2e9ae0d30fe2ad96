"""Payload varied: the corners at 3 m/s and severe turbulence with another mass in every flight,
compared with the same flights without.

    python -m campaigns.payload.reproduce  # of flights.parquet
    python -m campaigns.payload.reproduce SOURCE --constant SOURCE --out DIR

A SOURCE is a flights.parquet or a complete campaign folder. Writes effects.csv, rates.csv,
pboxes.svg and cost.csv of the airs that both flew.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import pandas as pd
from scipy import stats

from campaigns.excursions.reproduce import HOME as EXCURSIONS
from campaigns.library.flights import FLIGHTS, case_tables
from campaigns.library.study import cells, exit_code, study_parser, write_csv
from campaigns.library.tables import (
    MEDIANS,
    PICTURE,
    common_airs,
    hours_per_sample,
    pbox_drawing,
    write_cost,
    write_rates,
)
from sysid.units import SLUG_KG
from uqharness.campaign.conditions import samples
from uqharness.errors import BadInputError
from uqharness.files import write_text
from uqharness.statistics.pbox import containment
from uqharness.text_tables import text_table

HOME = Path(__file__).parent
CELL = "severe-3"
MASS = "variable_inertia/mass-slugs"
_COLUMNS = """metric airs slope_per_kg:.4g slope_error:.2g best:.4g worst:.4g constant_best:.4g
    constant_worst:.4g area_ratio:.4g spread:.3g constant_spread:.3g"""


def effect(varied: pd.DataFrame, constant: pd.DataFrame, metric: str) -> dict[str, float | str]:
    """Estimate what the mass does to a metric, from two case tables of the same corners and airs.

    ``slope_per_kg`` with its standard error is the change of a flight's metric per kg of mass, from
    the same corner in the same air without the change; the mean over the corners is one observation
    an air, and the line is free at 0 kg. ``best`` and ``worst`` corner's medians: the p-box at
    probability 0.5 with the payload, ``constant_`` without; ``area_ratio`` area over area.
    ``spread`` is the standard deviation of a corner's flights, in the mean over the corners. Raises
    BadInputError below three airs.
    """
    keys = ["epistemic_id", "aleatory_id"]
    pairs = varied[[*keys, metric, MASS]].merge(
        constant[[*keys, metric]], on=keys, suffixes=("", "_constant"), validate="1:1"
    )
    pairs["change"] = pairs[metric] - pairs[f"{metric}_constant"]
    by_air = pairs.groupby("aleatory_id")[[MASS, "change"]].mean().dropna()
    if len(by_air) < 3:
        raise BadInputError(
            f"{metric}: {len(by_air)} airs have a value with and without the payload; "
            "a slope needs three at least"
        )
    line = stats.linregress(SLUG_KG * by_air[MASS], by_air["change"])
    frames = {"": varied, "constant_": constant}
    row = {"metric": metric, "airs": len(by_air)}
    row |= {"slope_per_kg": line.slope, "slope_error": line.stderr}
    for prefix, frame in frames.items():
        by_corner = frame.groupby("epistemic_id")[metric]
        medians = by_corner.median()
        row |= {f"{prefix}best": medians.min(), f"{prefix}worst": medians.max()}
        row[f"{prefix}spread"] = by_corner.std().mean()
    curves = (samples(frame, metric) for frame in frames.values())
    return row | {"area_ratio": containment(*curves).area_ratio}


def tables(source: Path, constant_source: Path, out: Path) -> None:
    """Write the tables of the airs that were flown with and without the payload. Raises
    BadInputError where there is none."""
    varied, constant = common_airs(
        next(case_tables(source, cell=CELL)), next(case_tables(constant_source, cell=CELL))
    )
    rows = [cells(effect(varied, constant, metric), _COLUMNS) for metric in MEDIANS]
    write_csv(out / "effects.csv", rows)
    kinds = {"payload varied": varied, "constant": constant}
    write_rates(out, kinds)
    title = f"64 corners, {hours_per_sample(varied):g} h each, 3 m/s, severe turbulence"
    write_text(out / PICTURE, pbox_drawing(kinds, MEDIANS, title, {}, columns=3))
    write_cost(source, out)
    print("\n".join(text_table(rows)))


def main(argv: Sequence[str] | None = None) -> int:
    """Make the tables; exit code 0, or 2 for bad input."""
    parser = study_parser(__doc__, out=HOME)
    parser.add_argument("source", type=Path, nargs="?", default=HOME / FLIGHTS, metavar="SOURCE")
    parser.add_argument("--constant", type=Path, default=EXCURSIONS / FLIGHTS, metavar="SOURCE")
    args = parser.parse_args(argv)
    return exit_code(lambda: tables(args.source, args.constant, args.out))


if __name__ == "__main__":
    sys.exit(main())
