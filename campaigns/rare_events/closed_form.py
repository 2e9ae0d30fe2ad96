"""Level crossings of a first-order process: splitting in numpy beside what quadrature gives.

    python -m campaigns.rare_events.closed_form [--repeats 100] [--out DIR]

The probability that a path exceeds a threshold within so many steps, and its mean number of
excursions, are integrals over the transition density; splitting estimates both from paths, with
intervals that should hold them 95 times in a hundred. Writes DIR/closed-form.csv, a row a repeat.
Exit code 0: both intervals hold the truth in nine of ten repeats, and those of copies that begin
elsewhere do not; 1: otherwise; 2: bad input.
"""

from __future__ import annotations

import itertools
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from campaigns.library.study import exit_code, study_parser, write_csv
from campaigns.rare_events.rates import digits
from uqharness.errors import BadInputError
from uqharness.statistics import Checkpoint, interval, pilot, run
from uqharness.statistics.splitting import Interval

KEEP = 0.9
"""x' = KEEP x + sqrt(1 - KEEP^2) n, of variance 1: an Ornstein-Uhlenbeck process at steps of a
tenth of its time constant."""
NOISE = np.sqrt(1.0 - KEEP**2)
STEPS, THRESHOLD, REARM = 200, 4.0, 0.5
"""A path exceeds the threshold with a probability of some 0.0038: one in 260 plain paths would."""
ROOTS, REPLICATES, SEED = 100, 8, 20161226
EACH = 2
"""Steps between checkpoints: four jump over levels, and 90 of 100 intervals hold the probability
instead of 96."""
GRID = np.arange(-1.0, THRESHOLD + 0.05, 0.05)
HOME, TABLE = Path(__file__).parent, "closed-form.csv"


class Crossings:
    """Paths from the stationary distribution; an event of a kind: x exceeds its threshold, re-armed
    ``rearm`` below."""

    def __init__(
        self,
        rng: np.random.Generator,
        roots: int,
        steps: int,
        thresholds: Sequence[float],
        rearm: float,
        each: int = EACH,
    ) -> None:
        self._rng, self._remaining, self._each = rng, steps // each, each
        self._thresholds, self._rearm = np.asarray(thresholds), rearm
        self._x = rng.standard_normal(roots)
        self._outside = np.zeros((roots, len(thresholds)), bool)

    def advance(self) -> Checkpoint | None:
        """Advance by ``each`` steps; None at the end."""
        if self._remaining == 0:
            return None
        self._remaining -= 1
        events = np.zeros(self._outside.shape, np.int64)
        for _ in range(self._each):
            self._x = KEEP * self._x + NOISE * self._rng.standard_normal(self._x.size)
            x = self._x[:, None]
            outside = x > self._thresholds
            events += outside & ~self._outside
            self._outside = outside | (self._outside & (x >= self._thresholds - self._rearm))
        return Checkpoint(self._x, events, np.zeros(self._x.size, bool))

    def follow(self, parents: Sequence[int], levels: Sequence[int]) -> None:
        """Continue with these paths."""
        self._x, self._outside = self._x[list(parents)], self._outside[list(parents)]


class Careless(Crossings):
    """Paths whose copies begin a fifth of a standard deviation further out than the path that is
    copied."""

    def follow(self, parents: Sequence[int], levels: Sequence[int]) -> None:
        """Continue with these paths, the copies displaced."""
        super().follow(parents, levels)
        self._x = self._x + np.where(np.asarray(levels) > 0, 0.2, 0.0)


def exact(steps: int, threshold: float, rearm: float, nodes: int = 80) -> tuple[float, float]:
    """Return the probability of an event within ``steps``, and the mean number of events, by
    quadrature of the transition density.

    Gauss and Legendre's nodes between the places where the integrand jumps: with 60 or 80 nodes the
    same to nine digits.
    """
    ends = list(itertools.pairwise((-7.0, threshold - rearm, threshold, 9.0)))
    places, weights = np.polynomial.legendre.leggauss(nodes)
    x = np.concatenate([0.5 * (b - a) * places + 0.5 * (a + b) for a, b in ends])
    dx = np.concatenate([0.5 * (b - a) * weights for a, b in ends])
    density = np.exp(-0.5 * ((x[None, :] - KEEP * x[:, None]) / NOISE) ** 2)
    move = density / (NOISE * np.sqrt(2.0 * np.pi)) * dx
    start = np.exp(-0.5 * x**2) / np.sqrt(2.0 * np.pi) * dx
    never, armed, outside = start.copy(), start.copy(), np.zeros_like(start)
    excess, inside = x > threshold, x < threshold - rearm
    first = events = 0.0
    for _ in range(steps):
        never, armed, outside = never @ move, armed @ move, outside @ move
        first += never[excess].sum()
        never[excess] = 0.0
        events += armed[excess].sum()
        outside[excess] += armed[excess]
        armed[excess] = 0.0
        armed[inside] += outside[inside]
        outside[inside] = 0.0
    return float(first), float(events)


@dataclass(frozen=True)
class Coverage:
    """Studies that were repeated, each with limits of the probability and of the events of a path,
    and what quadrature gives for both."""

    studies: tuple[tuple[Interval, Interval], ...]
    truth: tuple[float, float]

    @property
    def counts(self) -> tuple[int, int]:
        """Numbers of 95 % intervals that hold the probability, and the events of a path."""
        hits = [
            [holds(*pair) for pair in zip(one, self.truth, strict=True)] for one in self.studies
        ]
        first, events = np.sum(hits, axis=0)
        return int(first), int(events)

    @property
    def ratio(self) -> float:
        """Mean of all estimates of the probability over the truth; a study without an event counts
        as zero."""
        estimates = [one[0].estimate for one in self.studies]
        return float(np.mean(np.nan_to_num(estimates)) / self.truth[0])

    def rows(self, paths: str) -> list[dict[str, str]]:
        """Return rows of closed-form.csv; ``paths`` names the kind. Limits are empty where a
        replicate has no event."""
        table = []
        for number, one in enumerate(self.studies):
            row = {"paths": paths, "repeat": str(number)}
            for name, limits, true in zip(("probability", "events"), one, self.truth, strict=True):
                row |= {
                    name: digits(limits.estimate, 9),
                    f"{name}_lower": digits(limits.lower, 9),
                }
                row |= {
                    f"{name}_upper": digits(limits.upper, 9),
                    f"{name}_true": digits(true, 9),
                }
                row[f"{name}_held"] = "yes" if holds(limits, true) else "no"
            table.append(row)
        return table


def holds(limits: Interval, true: float) -> bool:
    """Return whether limits hold a number; undefined ones do not."""
    return limits.lower <= true <= limits.upper


def coverage(repeats: int, kind: type[Crossings] = Crossings) -> Coverage:
    """Repeat a study of REPLICATES replicates, the levels from one pilot that is not counted."""

    def start(kind: type[Crossings], repeat: int, number: int, roots: int) -> Crossings:
        rng = np.random.default_rng([SEED, repeat, number])
        return kind(rng, roots, STEPS, (THRESHOLD,), REARM)

    many = 4 * ROOTS
    levels = pilot(lambda n: start(Crossings, 10**6, n, many), many, 1, GRID, THRESHOLD)
    studies = []
    for repeat in range(repeats):
        results = [run(start(kind, repeat, n, ROOTS), ROOTS, levels, 1) for n in range(REPLICATES)]
        first = interval([one.probability[0] for one in results])
        studies.append((first, interval([one.events[0] for one in results])))
    return Coverage(tuple(studies), exact(STEPS, THRESHOLD, REARM))


def main(argv: Sequence[str] | None = None) -> int:
    """Print the coverage of both, and write the result of each repeat."""
    parser = study_parser(__doc__, out=HOME)
    parser.add_argument("--repeats", type=int, default=100, help="studies that are repeated (100)")
    args = parser.parse_args(argv)
    return exit_code(lambda: _run(args.repeats, args.out))


def _run(repeats: int, out: Path) -> int:
    if repeats < 20:
        raise BadInputError(f"--repeats {repeats}: 20 at least tell nine of ten from less")
    valid, invalid = coverage(repeats), coverage(repeats, Careless)
    print("by quadrature: probability {:.6g}, {:.6g} events a path".format(*valid.truth))
    kinds = {"splitting": valid, "copies that begin elsewhere": invalid}
    write_csv(out / TABLE, [row for name, each in kinds.items() for row in each.rows(name)])
    for name, each in kinds.items():
        counts = "{} hold the probability, {} the events".format(*each.counts)
        print(f"{name}: of {repeats} intervals {counts}; mean over truth {each.ratio:.3f}")
    return 0 if min(valid.counts) >= 0.9 * repeats > invalid.counts[0] else 1


if __name__ == "__main__":
    sys.exit(main())
