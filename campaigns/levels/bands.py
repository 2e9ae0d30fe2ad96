"""Does the band of a p-box keep its level over corners on common air? Simulated campaigns whose distribution functions are known.

    python -m campaigns.levels.bands --out campaigns/levels [--repeats 1500]

Corner c of flight a is uniform from 0 to 1: the normal distribution function of sqrt(r) z_a + sqrt(1 - r) z_ac, with z_a common to
all corners and z_ac its own, so that corners are correlated by r. A campaign misses where some corner's empirical distribution
function is further from the true one than the band's half-width, at any value. Writes DIR/bands.csv. Exit code 0: the band misses
in 5 of 100 campaigns at most, chance in so many repeats granted, and the two controls beside it do not; 1: otherwise; 2: bad input.
The controls are bands of one corner taken for all of them: Kolmogorov's, and one from drawing the airs of the first corner again.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy import stats

from sysid.arrays import FloatArray
from uqharness.files import write_bytes
from uqharness.statistics.pbox import band_half_width, common_air_half_width
from uqharness.text_tables import csv_text, text_table

CONFIDENCE, SEED = 0.95, 20161224


@dataclass(frozen=True)
class Truth:
    """A campaign: corners, airs and the correlation of corners."""

    corners: int
    airs: int
    correlation: float


TRUTHS = (
    Truth(16, 40, 0.9),
    Truth(64, 40, 0.9),
    Truth(16, 40, 0.0),
    Truth(4, 40, 0.99),
    Truth(8, 100, 0.8),
)


@dataclass(frozen=True)
class Level:
    """Shares of campaigns missed by the band, by Bonferroni's and by the two controls; mean half-widths of the first two."""

    band: float
    bonferroni: float
    one_corner: float
    first_drawn: float
    width: float
    bonferroni_width: float


def distances(values: FloatArray) -> FloatArray:
    """(repeats, corners) largest distance of the empirical distribution functions of ``values`` (r, c, n) from the uniform one."""
    ordered = np.sort(values, axis=-1)
    steps = np.arange(1, values.shape[-1] + 1) / values.shape[-1]
    found: FloatArray = np.maximum(steps - ordered, ordered - steps + steps[0]).max(axis=-1)
    return found


def measured(truth: Truth, repeats: int) -> Level:
    """Simulate ``repeats`` campaigns."""
    rng = np.random.default_rng([SEED, truth.corners, truth.airs, round(100 * truth.correlation)])
    common = rng.normal(size=(repeats, 1, truth.airs))
    own = rng.normal(size=(repeats, truth.corners, truth.airs))
    values = stats.norm.cdf(
        np.sqrt(truth.correlation) * common + np.sqrt(1.0 - truth.correlation) * own
    )
    worst = distances(values).max(axis=1)
    bonferroni, single = (
        band_half_width(truth.airs, corners, CONFIDENCE) for corners in (truth.corners, 1)
    )
    drawn = np.array([common_air_half_width(campaign, CONFIDENCE) for campaign in values])
    band = np.minimum(drawn, bonferroni)
    alone = np.array([common_air_half_width(campaign[:1], CONFIDENCE) for campaign in values])
    return Level(
        float(np.mean(worst > band)),
        float(np.mean(worst > bonferroni)),
        float(np.mean(worst > single)),
        float(np.mean(worst > alone)),
        float(band.mean()),
        bonferroni,
    )


def kept(share: float, repeats: int) -> bool:
    """Whether 5 in 100 are not exceeded, chance in so many repeats (three standard deviations) granted."""
    error = 1.0 - CONFIDENCE
    return share <= error + 3.0 * float(np.sqrt(error * CONFIDENCE / repeats))


def main(argv: Sequence[str] | None = None) -> int:
    """Run the study; the process's exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m campaigns.levels.bands", description="Do bands keep their level?"
    )
    parser.add_argument("--out", type=Path, required=True, metavar="DIR")
    parser.add_argument("--repeats", type=int, default=1500)
    args = parser.parse_args(argv)
    if args.repeats < 100:
        print("bands: error: --repeats: 100 at least, or nothing is shown", file=sys.stderr)
        return 2
    found = [(truth, measured(truth, args.repeats)) for truth in TRUTHS]
    rows = [
        {
            "corners": str(truth.corners),
            "airs": str(truth.airs),
            "correlation": f"{truth.correlation:g}",
            "missed": f"{level.band:.4f}",
            "missed_bonferroni": f"{level.bonferroni:.4f}",
            "missed_one_corner": f"{level.one_corner:.4f}",
            "missed_first_drawn": f"{level.first_drawn:.4f}",
            "half_width": f"{level.width:.4f}",
            "half_width_bonferroni": f"{level.bonferroni_width:.4f}",
            "kept": "yes" if kept(level.band, args.repeats) else "no",
        }
        for truth, level in found
    ]
    args.out.mkdir(parents=True, exist_ok=True)
    write_bytes(args.out / "bands.csv", csv_text(rows).encode())
    print("\n".join(text_table(rows)))
    controls = (
        max(level.one_corner for _, level in found),
        max(level.first_drawn for _, level in found),
    )
    held = all(kept(level.band, args.repeats) for _, level in found)
    return 0 if held and not any(kept(share, args.repeats) for share in controls) else 1


if __name__ == "__main__":
    sys.exit(main())
