"""Level crossings of a first-order process: splitting in numpy beside what quadrature gives.

    python -m campaigns.rare_events.closed_form [--repeats 100]

The probability that a path exceeds a threshold within so many steps, and its mean number of excursions, are integrals over the
transition density; splitting has to find them from paths, with intervals that hold them 95 times in a hundred.
Exit code 0: both intervals hold the truth in nine of ten repeats, and those of copies that begin elsewhere do not;
1: otherwise; 2: bad input.
"""

from __future__ import annotations

import argparse
import itertools
import sys
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from uqharness.statistics import Seen, interval, pilot, run

KEEP = 0.9
"""x' = KEEP x + sqrt(1 - KEEP^2) n, of variance 1: an Ornstein-Uhlenbeck process at steps of a tenth of its time constant."""
STEPS, THRESHOLD, REARM = 200, 4.0, 0.5
"""A path exceeds the threshold with a probability of some 0.0038: one in 260 plain paths would."""
ROOTS, REPLICATES, SEED = 100, 8, 20161226
EACH = 2
"""Steps between checkpoints: four jump over levels, and 90 of 100 intervals hold the probability instead of 96."""
GRID = np.arange(-1.0, THRESHOLD + 0.05, 0.05)


class Crossings:
    """Paths from the stationary distribution; an event of a kind: x exceeds its threshold, re-armed ``rearm`` below."""

    def __init__(
        self, rng: np.random.Generator, roots: int, steps: int, thresholds: Sequence[float], rearm: float, each: int = EACH
    ) -> None:  # fmt: skip
        self._rng, self._left, self._each = rng, steps // each, each
        self._thresholds, self._rearm = np.asarray(thresholds), rearm
        self._x = rng.standard_normal(roots)
        self._outside = np.zeros((roots, len(thresholds)), bool)

    def advance(self) -> Seen | None:
        """Go on by ``each`` steps."""
        if self._left == 0:
            return None
        self._left -= 1
        events = np.zeros(self._outside.shape, np.int64)
        for _ in range(self._each):
            self._x = KEEP * self._x + np.sqrt(1.0 - KEEP**2) * self._rng.standard_normal(self._x.size)
            beyond = self._x[:, None] > self._thresholds
            events += beyond & ~self._outside
            self._outside = beyond | (self._outside & (self._x[:, None] >= self._thresholds - self._rearm))
        return Seen(self._x, events, np.zeros(self._x.size, bool))

    def follow(self, parents: Sequence[int], levels: Sequence[int]) -> None:
        """Go on with these paths."""
        self._x, self._outside = self._x[list(parents)], self._outside[list(parents)]


def exact(steps: int, threshold: float, rearm: float, nodes: int = 80) -> tuple[float, float]:
    """Probability of an event within ``steps``, and the mean number of events, by quadrature of the transition density.

    Gauss and Legendre's nodes between the places where the integrand jumps: with 60 or 80 nodes the same to nine digits.
    """
    ends = (-7.0, threshold - rearm, threshold, 9.0)
    places, weights = np.polynomial.legendre.leggauss(nodes)
    x = np.concatenate([0.5 * (b - a) * places + 0.5 * (a + b) for a, b in itertools.pairwise(ends)])
    dx = np.concatenate([0.5 * (b - a) * weights for a, b in itertools.pairwise(ends)])
    sd = np.sqrt(1.0 - KEEP**2)
    move = np.exp(-0.5 * ((x[None, :] - KEEP * x[:, None]) / sd) ** 2) / (sd * np.sqrt(2.0 * np.pi)) * dx
    start = np.exp(-0.5 * x**2) / np.sqrt(2.0 * np.pi) * dx
    never, armed, outside, first, events = start.copy(), start.copy(), np.zeros_like(start), 0.0, 0.0
    beyond, inside = x > threshold, x < threshold - rearm
    for _ in range(steps):
        never, armed, outside = never @ move, armed @ move, outside @ move
        first += never[beyond].sum()
        never[beyond] = 0.0
        events += armed[beyond].sum()
        outside[beyond] += armed[beyond]
        armed[beyond] = 0.0
        armed[inside] += outside[inside]
        outside[inside] = 0.0
    return float(first), float(events)


class Careless(Crossings):
    """Paths whose copies begin a fifth of a standard deviation further out than the path that is copied."""

    def follow(self, parents: Sequence[int], levels: Sequence[int]) -> None:
        """Go on with these paths."""
        super().follow(parents, levels)
        self._x = self._x + np.where(np.asarray(levels) > 0, 0.2, 0.0)


@dataclass(frozen=True)
class Coverage:
    """Of ``repeats`` studies how many 95 % intervals held the probability, and the events of a path; their mean over the truth."""

    repeats: int
    probability: int
    events: int
    ratio: float


def coverage(repeats: int, made: type[Crossings] = Crossings) -> Coverage:
    """Repeat a study of REPLICATES replicates, the levels from one pilot that is not counted."""
    truth = exact(STEPS, THRESHOLD, REARM)
    levels = pilot(lambda number: _begun(Crossings, 10**6, number, 4 * ROOTS), 4 * ROOTS, 1, GRID, THRESHOLD)
    held, means = np.zeros(2, int), []
    for repeat in range(repeats):
        found = [run(_begun(made, repeat, number, ROOTS), ROOTS, levels, 1) for number in range(REPLICATES)]
        limits = (interval([one.probability[0] for one in found]), interval([one.events[0] for one in found]))
        held += [one.lower <= true <= one.upper for one, true in zip(limits, truth, strict=True)]
        means.append(np.mean([one.probability[0] for one in found]))
    return Coverage(repeats, int(held[0]), int(held[1]), float(np.mean(means) / truth[0]))


def _begun(made: type[Crossings], repeat: int, number: int, roots: int) -> Crossings:
    return made(np.random.default_rng([SEED, repeat, number]), roots, STEPS, (THRESHOLD,), REARM)


def main(argv: Sequence[str] | None = None) -> int:
    """Print the coverage of both."""
    parser = argparse.ArgumentParser(prog="python -m campaigns.rare_events.closed_form", description="Coverage of splitting")
    parser.add_argument("--repeats", type=int, default=100, help="studies that are repeated (100)")
    args = parser.parse_args(argv)
    if args.repeats < 20:
        print(f"closed_form: error: --repeats {args.repeats}: 20 at least tell nine of ten from less", file=sys.stderr)
        return 2
    first, events = exact(STEPS, THRESHOLD, REARM)
    print(f"by quadrature: probability {first:.6g}, {events:.6g} events a path")
    good, bad = coverage(args.repeats), coverage(args.repeats, Careless)
    for name, found in (("splitting", good), ("copies that begin elsewhere", bad)):
        held = f"{found.probability} of {found.repeats} intervals hold the probability, {found.events} the events"
        print(f"{name}: {held}; mean over truth {found.ratio:.3f}")
    return 0 if min(good.probability, good.events) >= 0.9 * args.repeats > bad.probability else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
