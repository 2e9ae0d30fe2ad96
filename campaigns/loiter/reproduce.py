"""Figs 3.7 to 3.9 and 4.3 and Table 4.7 from the flights of Tables 3.1 and 3.2 in their air: 3 m/s
of wind, severe turbulence.

    python -m campaigns.loiter.reproduce  # of campaigns/excursions/flights.parquet
    python -m campaigns.loiter.reproduce SOURCE --out DIR  # of a complete campaign folder
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from campaigns.excursions.reproduce import HOME as EXCURSIONS
from campaigns.library.flights import FLIGHTS, case_tables, settings
from campaigns.library.study import cells, exit_code, published_table, study_parser, write_csv
from campaigns.library.tables import MEDIANS, PICTURE, hours_per_sample, pbox_drawing
from uqharness.campaign.conditions import CONFIDENCE, samples
from uqharness.campaign.sensitivity import CornerCampaign, MetricSensitivity, analyse_campaign
from uqharness.files import write_text
from uqharness.sensitivity import PairRange
from uqharness.statistics.pbox import pbox

CELL = "severe-3"
HOME = Path(__file__).parent
METRICS = tuple(f"{name}{suffix}" for name in MEDIANS for suffix in ("", "_measured"))
"""Medians of an hour's |error|: true, and as the noise-laden sensors saw it."""
PUBLISHED_FLIGHT = dict(zip(MEDIANS, (9.41, 2.16, 0.61), strict=True))
"""Medians of the published flight in 3 m/s of wind (Fig 3.6), as its sensors saw them."""
PROBABILITIES = (0.05, 0.5, 0.95)
_SHARE = """metric coefficient share_min:.4f share_max:.4f share_low:.4f share_high:.4f
    published_min:g published_max:g beside"""
_PBOX = """metric probability:g best:.4g worst:.4g band_low:.4g band_high:.4g best_corner
    worst_corner corners hours_per_corner:g"""


def compare(limits: tuple[float, float], printed: tuple[float, float]) -> str:
    """Return ``overlaps`` where limits and the print's range have a value in common, else ``above``
    or ``below`` the print."""
    if limits[0] > printed[1]:
        return "above"
    return "below" if limits[1] < printed[0] else "overlaps"


def shares(analysis: Sequence[MetricSensitivity]) -> Iterator[dict[str, Any]]:
    """Yield the part of a p-box's area that each coefficient has, beside Table 4.7.

    Smallest and largest over the 32 pairs of corners that differ in the coefficient alone;
    ``share_low`` and ``share_high`` bound both at 95 % for all coefficients at once. True and
    measured metrics stand beside the same print.
    """
    table = published_table("4.7").set_index("coefficient")
    for item in analysis:
        quantity = item.metric.partition("_median")[0]
        for name, index in item.result.indices.items():
            assert isinstance(index, PairRange)
            low, high = index.minimum, index.maximum
            row: dict[str, Any] = {"metric": item.metric, "coefficient": name}
            row |= {"share_min": low.value, "share_max": high.value}
            row |= {"share_low": low.low, "share_high": high.high}
            printed = [float(table.loc[name, f"{quantity}_{end}"]) for end in ("min", "max")]
            row |= {"published_min": printed[0], "published_max": printed[1]}
            yield row | {"beside": compare((low.low, high.high), (printed[0], printed[1]))}


def pbox_rows(frame: pd.DataFrame) -> Iterator[dict[str, str]]:
    """Yield quantiles of each p-box: best and worst corner, their limits at 95 % over all corners,
    and which corners set them."""
    for metric in METRICS:
        curves = samples(frame, metric)
        box = pbox(curves, CONFIDENCE)
        for probability in PROBABILITIES:
            row = {"metric": metric, "probability": probability, "corners": len(curves)}
            row["best"], row["worst"] = box.quantile(probability)
            row["band_low"], row["band_high"] = box.band_quantile(probability)
            row["best_corner"], row["worst_corner"] = box.set_by(probability)
            yield cells(row | {"hours_per_corner": hours_per_sample(frame)}, _PBOX)


def write_tables(frame: pd.DataFrame, campaign: Mapping[str, Any], out: Path) -> list[str]:
    """Write shares.csv, pboxes.csv and pboxes.svg of a cell's flights, and return lines for the
    terminal. Raises BadInputError."""
    analysis = analyse_campaign(CornerCampaign(out, frame, {"campaign": campaign}), metrics=METRICS)
    rows = list(shares(analysis))
    write_csv(out / "shares.csv", (cells(row, _SHARE) for row in rows))
    write_csv(out / "pboxes.csv", pbox_rows(frame))
    marks = {f"{n}_measured": (v, "published flight") for n, v in PUBLISHED_FLIGHT.items()}
    title = f"64 corners, {hours_per_sample(frame):g} h each, 3 m/s of wind, severe turbulence"
    write_text(out / PICTURE, pbox_drawing({"": frame}, METRICS, title, marks))
    counts = Counter(row["beside"] for row in rows)
    words = ", ".join(f"{counts[word]} {word}" for word in ("overlaps", "above", "below"))
    return [*(item.words for item in analysis), f"{len(rows)} shares: {words}"]


def main(argv: Sequence[str] | None = None) -> int:
    """Make the tables; exit code 0, or 2 for bad input."""
    parser, default = study_parser(__doc__, out=HOME), EXCURSIONS / FLIGHTS
    parser.add_argument("source", type=Path, nargs="?", default=default, metavar="SOURCE")
    args = parser.parse_args(argv)

    def run() -> None:
        frame = next(case_tables(args.source, cell=CELL))
        print("\n".join(write_tables(frame, settings(args.source), args.out)))

    return exit_code(run)


if __name__ == "__main__":
    sys.exit(main())
