"""Does the band of a p-box keep its level over corners on common air? Simulated campaigns whose
distribution functions are known.

    python -m campaigns.levels.bands --out campaigns/levels [--repeats 1500]

Corner c of flight a is uniform from 0 to 1: the normal distribution function of sqrt(r) z_a +
sqrt(1 - r) z_ac, with z_a common to all corners and z_ac its own, so that corners are correlated by
r. A campaign misses where some corner's empirical distribution function is further from the true
one than the band's half-width, at any value. Writes DIR/bands.csv. Exit code 0: the band misses in
5 of 100 campaigns at most, chance in so many repeats granted, and the two controls beside it do
not; 1: otherwise; 2: bad input. The controls are bands of one corner taken for all of them:
Kolmogorov's, and one from drawing the airs of the first corner again.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass

import numpy as np
from scipy import stats

from campaigns.levels.study import LevelStudy, Results, allowed
from sysid.arrays import FloatArray
from uqharness.statistics.pbox import band_half_width, common_air_half_width

CONFIDENCE, SEED = 0.95, 20161224
_COLUMNS = """corners airs correlation:g missed:.4f missed_bonferroni:.4f missed_one_corner:.4f
    missed_first_drawn:.4f half_width:.4f half_width_bonferroni:.4f kept"""


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


def distances(values: FloatArray) -> FloatArray:
    """Return (r, c) largest distance of the empirical distribution functions of ``values`` (r, c,
    n) from the uniform one."""
    ordered = np.sort(values, axis=-1)
    steps = np.arange(1, values.shape[-1] + 1) / values.shape[-1]
    return np.asarray(np.maximum(steps - ordered, ordered - steps + steps[0]).max(axis=-1))


def measured(truth: Truth, repeats: int) -> dict[str, float]:
    """Simulate ``repeats`` campaigns; return the shares missed by the band, by Bonferroni's and by
    the two controls, and mean half-widths of the first two."""
    rng = np.random.default_rng([SEED, truth.corners, truth.airs, round(100 * truth.correlation)])
    common = rng.normal(size=(repeats, 1, truth.airs))
    single = rng.normal(size=(repeats, truth.corners, truth.airs))
    r = truth.correlation
    values = stats.norm.cdf(np.sqrt(r) * common + np.sqrt(1.0 - r) * single)
    worst = distances(values).max(axis=1)
    bonferroni, kolmogorov = (
        band_half_width(truth.airs, corners, CONFIDENCE) for corners in (truth.corners, 1)
    )
    drawing, first = (
        np.array([common_air_half_width(campaign, CONFIDENCE) for campaign in part])
        for part in (values, values[:, :1])
    )
    band = np.minimum(drawing, bonferroni)
    limits = {"missed": band, "missed_bonferroni": bonferroni}
    limits |= {"missed_one_corner": kolmogorov, "missed_first_drawn": first}
    level = {name: float(np.mean(worst > limit)) for name, limit in limits.items()}
    return level | {"half_width": float(band.mean()), "half_width_bonferroni": bonferroni}


def keeps_level(share: float, repeats: int) -> bool:
    """Return whether 5 in 100 are not exceeded, chance in so many repeats (three standard
    deviations) granted."""
    return share <= allowed(1.0 - CONFIDENCE, repeats)


def passes(results: Results, repeats: int) -> bool:
    """Return whether every band keeps its level, and neither control does in the worst campaign."""
    worst = {n: max(level[n] for _, level in results) for n in results[0][1]}
    controls = ("missed_one_corner", "missed_first_drawn")
    constant = keeps_level(worst["missed"], repeats)
    return constant and not any(keeps_level(worst[name], repeats) for name in controls)


STUDY = LevelStudy(
    __doc__,
    "bands.csv",
    1500,
    100,
    _COLUMNS,
    TRUTHS,
    measured,
    lambda level, repeats: keeps_level(level["missed"], repeats),
    passes,
)
main = STUDY.main

if __name__ == "__main__":
    sys.exit(main())
