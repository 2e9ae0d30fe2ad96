"""Figs 3.7 to 3.9 and 4.3 and Table 4.7 from the flights of Tables 3.1 and 3.2 in their air: 3 m/s of wind, severe turbulence.

python -m campaigns.loiter.full_size                                     # beside the shards that are there
python -m campaigns.excursions.full_size fly --cell severe-3             # flies more of them
python -m campaigns.excursions.full_size rerun --cell severe-3 --shard 0 # one of them once more, against its digest
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from campaigns.excursions.full_size import HOME as EXCURSIONS
from campaigns.excursions.full_size import plan
from campaigns.full_size.cells import flown_cell, hours_each
from campaigns.full_size.figures import MEDIANS, drawn_pboxes
from uqharness.campaign.conditions import CONFIDENCE, samples
from uqharness.campaign.sensitivity import CornerCampaign, MetricSensitivity, analyse_campaign
from uqharness.errors import BadInputError
from uqharness.files import PROJECT_ROOT, write_bytes, write_text
from uqharness.sensitivity import PairRange
from uqharness.statistics.pbox import pbox
from uqharness.text_tables import csv_text

CELL = "severe-3"
HOME = Path(__file__).parent
SHARES, PBOXES, PICTURE = "shares.csv", "pboxes.csv", "pboxes.svg"
METRICS = tuple(f"{name}{suffix}" for name in MEDIANS for suffix in ("", "_measured"))
"""Medians of an hour's |error|: true, and as the noise-laden sensors saw it."""
PUBLISHED_FLIGHT = {
    "cross_track_median_m": 9.41,
    "altitude_median_m": 2.16,
    "speed_median_mps": 0.61,
}
"""Medians of the published flight in 3 m/s of wind (Fig 3.6), as its sensors saw them."""
PROBABILITIES = (0.05, 0.5, 0.95)


@dataclass(frozen=True)
class Share:
    """Part of a p-box's area that a coefficient has: smallest and largest over the 32 pairs of corners that differ in it alone.

    ``limits`` bound both at 95 % for all coefficients at once; ``published`` is the print's range (Table 4.7).
    """

    metric: str
    coefficient: str
    found: tuple[float, float]
    limits: tuple[float, float]
    published: tuple[float, float]

    @property
    def beside(self) -> str:
        """``overlaps`` where the limits and the print's range have a value in common, else ``above`` or ``below`` the print."""
        if self.limits[0] > self.published[1]:
            return "above"
        return "below" if self.limits[1] < self.published[0] else "overlaps"


def published_shares() -> pd.DataFrame:
    """Table 4.7: coefficient -> ranges."""
    return pd.read_csv(
        PROJECT_ROOT / "tests" / "reference" / "table_4_7.csv", comment="#"
    ).set_index("coefficient")


def shares(found: Sequence[MetricSensitivity]) -> Iterator[Share]:
    """What the analysis of corner pairs found, beside the print; measured and true metrics beside the same print."""
    print_ = published_shares()
    for item in found:
        quantity = item.metric.partition("_median")[0]
        for name, index in item.result.indices.items():
            assert isinstance(index, PairRange)
            theirs = (
                float(print_.loc[name, f"{quantity}_min"]),
                float(print_.loc[name, f"{quantity}_max"]),
            )
            low, high = index.minimum, index.maximum
            yield Share(item.metric, name, (low.value, high.value), (low.low, high.high), theirs)


def pbox_rows(frame: pd.DataFrame) -> Iterator[dict[str, str]]:
    """Quantiles of each p-box: best and worst corner, their limits at 95 % over all corners, and which corners set them."""
    for metric in METRICS:
        found = samples(frame, metric)
        box = pbox(found, CONFIDENCE)
        for probability in PROBABILITIES:
            (best, worst), (low, high) = box.quantile(probability), box.band_quantile(probability)
            first, last = box.set_by(probability)
            yield {
                "metric": metric,
                "probability": f"{probability:g}",
                "best": f"{best:.4g}",
                "worst": f"{worst:.4g}",
                "band_low": f"{low:.4g}",
                "band_high": f"{high:.4g}",
                "best_corner": first,
                "worst_corner": last,
                "corners": str(len(found)),
                "hours_per_corner": f"{hours_each(frame):g}",
            }


def share_rows(found: Sequence[Share]) -> list[dict[str, str]]:
    """shares.csv."""
    return [
        {
            "metric": item.metric,
            "coefficient": item.coefficient,
            "share_min": f"{item.found[0]:.4f}",
            "share_max": f"{item.found[1]:.4f}",
            "share_low": f"{item.limits[0]:.4f}",
            "share_high": f"{item.limits[1]:.4f}",
            "published_min": f"{item.published[0]:g}",
            "published_max": f"{item.published[1]:g}",
            "beside": item.beside,
        }
        for item in found
    ]


def write_tables(flown: CornerCampaign, out: Path) -> list[str]:
    """shares.csv, pboxes.csv and pboxes.svg of a cell's flights; lines for the terminal. Raises BadInputError."""
    out.mkdir(parents=True, exist_ok=True)
    analysed = analyse_campaign(flown, metrics=METRICS)
    found = list(shares(analysed))
    write_bytes(out / SHARES, csv_text(share_rows(found)).encode())
    write_bytes(out / PBOXES, csv_text(list(pbox_rows(flown.frame))).encode())
    marks = {
        f"{name}_measured": (value, "published flight") for name, value in PUBLISHED_FLIGHT.items()
    }
    title = f"64 corners, {hours_each(flown.frame):g} h each, 3 m/s of wind, severe turbulence"
    write_text(out / PICTURE, drawn_pboxes({"": flown.frame}, METRICS, title, marks))
    counted = {
        word: sum(item.beside == word for item in found) for word in ("overlaps", "above", "below")
    }
    return [item.words for item in analysed] + [
        f"{len(found)} shares: " + ", ".join(f"{n} {w}" for w, n in counted.items())
    ]


def main(argv: Sequence[str] | None = None) -> int:
    """Make the tables; exit code 0, or 2 for bad input."""
    parser = argparse.ArgumentParser(
        prog="python -m campaigns.loiter.full_size", description="Figs 3.7 to 3.9, 4.3, Table 4.7"
    )
    parser.add_argument("--shards", type=Path, default=EXCURSIONS / "shards", metavar="DIR")
    parser.add_argument("--out", type=Path, default=HOME, metavar="DIR")
    args = parser.parse_args(argv)
    try:
        planned = plan()
        told = write_tables(flown_cell(planned, args.shards, planned.condition(CELL))[0], args.out)
    except BadInputError as error:
        print(f"full_size: error: {error}", file=sys.stderr)
        return 2
    print("\n".join(told))
    return 0


if __name__ == "__main__":
    sys.exit(main())
