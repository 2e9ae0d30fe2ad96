"""Level crossings of a first-order process: splitting in numpy beside what quadrature gives.

    python -m campaigns.rare_events.closed_form [--repeats 100] [--out DIR]

The probability that a path exceeds a threshold within so many steps, and its mean number of excursions, are integrals over the
transition density; splitting has to find them from paths, with intervals that hold them 95 times in a hundred.
Writes DIR/closed-form.csv, a row a repeat.
Exit code 0: both intervals hold the truth in nine of ten repeats, and those of copies that begin elsewhere do not;
1: otherwise; 2: bad input.
"""

from __future__ import annotations

import argparse
import itertools
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from campaigns.rare_events.rates import shown
from uqharness.files import write_bytes
from uqharness.statistics import Checkpoint, interval, pilot, run
from uqharness.statistics.splitting import Interval
from uqharness.text_tables import csv_text

KEEP = 0.9
"""x' = KEEP x + sqrt(1 - KEEP^2) n, of variance 1: an Ornstein-Uhlenbeck process at steps of a tenth of its time constant."""
STEPS, THRESHOLD, REARM = 200, 4.0, 0.5
"""A path exceeds the threshold with a probability of some 0.0038: one in 260 plain paths would."""
ROOTS, REPLICATES, SEED = 100, 8, 20161226
EACH = 2
"""Steps between checkpoints: four jump over levels, and 90 of 100 intervals hold the probability instead of 96."""
GRID = np.arange(-1.0, THRESHOLD + 0.05, 0.05)
HOME, TABLE = Path(__file__).parent, "closed-form.csv"


class Crossings:
    """Paths from the stationary distribution; an event of a kind: x exceeds its threshold, re-armed ``rearm`` below."""

    def __init__(
        self,
        rng: np.random.Generator,
        roots: int,
        steps: int,
        thresholds: Sequence[float],
        rearm: float,
        each: int = EACH,
    ) -> None:
        self._rng, self._left, self._each = rng, steps // each, each
        self._thresholds, self._rearm = np.asarray(thresholds), rearm
        self._x = rng.standard_normal(roots)
        self._outside = np.zeros((roots, len(thresholds)), bool)

    def advance(self) -> Checkpoint | None:
        """Go on by ``each`` steps."""
        if self._left == 0:
            return None
        self._left -= 1
        events = np.zeros(self._outside.shape, np.int64)
        for _ in range(self._each):
            self._x = KEEP * self._x + np.sqrt(1.0 - KEEP**2) * self._rng.standard_normal(
                self._x.size
            )
            beyond = self._x[:, None] > self._thresholds
            events += beyond & ~self._outside
            self._outside = beyond | (
                self._outside & (self._x[:, None] >= self._thresholds - self._rearm)
            )
        return Checkpoint(self._x, events, np.zeros(self._x.size, bool))

    def follow(self, parents: Sequence[int], levels: Sequence[int]) -> None:
        """Go on with these paths."""
        self._x, self._outside = self._x[list(parents)], self._outside[list(parents)]


def exact(steps: int, threshold: float, rearm: float, nodes: int = 80) -> tuple[float, float]:
    """Probability of an event within ``steps``, and the mean number of events, by quadrature of the transition density.

    Gauss and Legendre's nodes between the places where the integrand jumps: with 60 or 80 nodes the same to nine digits.
    """
    ends = (-7.0, threshold - rearm, threshold, 9.0)
    places, weights = np.polynomial.legendre.leggauss(nodes)
    x = np.concatenate(
        [0.5 * (b - a) * places + 0.5 * (a + b) for a, b in itertools.pairwise(ends)]
    )
    dx = np.concatenate([0.5 * (b - a) * weights for a, b in itertools.pairwise(ends)])
    sd = np.sqrt(1.0 - KEEP**2)
    move = (
        np.exp(-0.5 * ((x[None, :] - KEEP * x[:, None]) / sd) ** 2)
        / (sd * np.sqrt(2.0 * np.pi))
        * dx
    )
    start = np.exp(-0.5 * x**2) / np.sqrt(2.0 * np.pi) * dx
    never, armed, outside, first, events = (
        start.copy(),
        start.copy(),
        np.zeros_like(start),
        0.0,
        0.0,
    )
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
class Repeat:
    """Limits of one study: of the probability, and of the events of a path."""

    probability: Interval
    events: Interval


@dataclass(frozen=True)
class Coverage:
    """Studies that were repeated, and what quadrature gives: probability and events."""

    studies: tuple[Repeat, ...]
    truth: tuple[float, float]

    @property
    def repeats(self) -> int:
        """Number of studies."""
        return len(self.studies)

    @property
    def probability(self) -> int:
        """How many 95 % intervals hold the probability."""
        return sum(holds(one.probability, self.truth[0]) for one in self.studies)

    @property
    def events(self) -> int:
        """How many hold the events of a path."""
        return sum(holds(one.events, self.truth[1]) for one in self.studies)

    @property
    def ratio(self) -> float:
        """Mean of all estimates of the probability over the truth; a study without an event has none."""
        known = [one.probability.estimate for one in self.studies]
        return float(np.mean(np.nan_to_num(known)) / self.truth[0])

    def rows(self, paths: str) -> list[dict[str, str]]:
        """Rows of closed-form.csv; ``paths`` says which these are. Limits are empty where a replicate has no event."""
        found = []
        for number, one in enumerate(self.studies):
            row = {"paths": paths, "repeat": str(number)}
            for name, limits, true in (
                ("probability", one.probability, self.truth[0]),
                ("events", one.events, self.truth[1]),
            ):
                row |= {
                    name: shown(limits.estimate, 9),
                    f"{name}_lower": shown(limits.lower, 9),
                    f"{name}_upper": shown(limits.upper, 9),
                }
                row |= {
                    f"{name}_true": shown(true, 9),
                    f"{name}_held": "yes" if holds(limits, true) else "no",
                }
            found.append(row)
        return found


def holds(limits: Interval, true: float) -> bool:
    """Whether limits hold a number; those that are not defined do not."""
    return limits.lower <= true <= limits.upper


def coverage(repeats: int, made: type[Crossings] = Crossings) -> Coverage:
    """Repeat a study of REPLICATES replicates, the levels from one pilot that is not counted."""
    truth = exact(STEPS, THRESHOLD, REARM)
    levels = pilot(
        lambda number: _begun(Crossings, 10**6, number, 4 * ROOTS), 4 * ROOTS, 1, GRID, THRESHOLD
    )
    studies = []
    for repeat in range(repeats):
        found = [
            run(_begun(made, repeat, number, ROOTS), ROOTS, levels, 1)
            for number in range(REPLICATES)
        ]
        studies.append(
            Repeat(
                interval([one.probability[0] for one in found]),
                interval([one.events[0] for one in found]),
            )
        )
    return Coverage(tuple(studies), truth)


def _begun(made: type[Crossings], repeat: int, number: int, roots: int) -> Crossings:
    return made(np.random.default_rng([SEED, repeat, number]), roots, STEPS, (THRESHOLD,), REARM)


def main(argv: Sequence[str] | None = None) -> int:
    """Print the coverage of both, and write what each repeat found."""
    parser = argparse.ArgumentParser(
        prog="python -m campaigns.rare_events.closed_form", description="Coverage of splitting"
    )
    parser.add_argument("--repeats", type=int, default=100, help="studies that are repeated (100)")
    parser.add_argument(
        "--out",
        type=Path,
        default=HOME,
        metavar="DIR",
        help=f"folder of {TABLE} (that of this module)",
    )
    args = parser.parse_args(argv)
    if args.repeats < 20:
        print(
            f"closed_form: error: --repeats {args.repeats}: 20 at least tell nine of ten from less",
            file=sys.stderr,
        )
        return 2
    first, events = exact(STEPS, THRESHOLD, REARM)
    print(f"by quadrature: probability {first:.6g}, {events:.6g} events a path")
    good, bad = coverage(args.repeats), coverage(args.repeats, Careless)
    both = {"splitting": good, "copies that begin elsewhere": bad}
    args.out.mkdir(parents=True, exist_ok=True)
    write_bytes(
        args.out / TABLE,
        csv_text([row for name, found in both.items() for row in found.rows(name)]).encode(),
    )
    for name, found in both.items():
        held = f"{found.probability} of {found.repeats} intervals hold the probability, {found.events} the events"
        print(f"{name}: {held}; mean over truth {found.ratio:.3f}")
    return 0 if min(good.probability, good.events) >= 0.9 * args.repeats > bad.probability else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
