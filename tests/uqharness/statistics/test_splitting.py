"""Splitting against paths whose probabilities are known by quadrature, and against paths that are
counted one by one.
"""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from campaigns.rare_events.closed_form import (
    EACH,
    REARM,
    STEPS,
    THRESHOLD,
    Careless,
    Crossings,
    coverage,
    exact,
)
from uqharness.statistics.splitting import (
    Checkpoint,
    Levels,
    Occupancy,
    interval,
    more_levels,
    pilot,
    run,
)

REPEATS = 20


def paths(seed, roots=50, thresholds=(2.5, THRESHOLD), result=Crossings):
    return result(np.random.default_rng([3, seed]), roots, STEPS, thresholds, REARM)


class Scripted:
    """Paths whose scores are given: one root each; remembers who was followed."""

    def __init__(self, scores, ended=()):
        self.scores, self.ended, self.followed, self.step, self.who = (
            scores,
            ended,
            [],
            -1,
            list(range(len(scores[0]))),
        )

    def advance(self):
        self.step += 1
        if self.step == len(self.scores):
            return None
        score = np.array([self.scores[self.step][k] for k in self.who])
        ended = np.array([(self.step, k) in self.ended for k in self.who])
        return Checkpoint(score, (score[:, None] > 9.0).astype(np.int64), ended)

    def follow(self, parents, levels):
        self.followed.append((list(parents), list(levels)))
        self.who = [self.who[k] for k in parents]


@pytest.mark.parametrize("repeats", [5, pytest.param(REPEATS, marks=pytest.mark.slow)])
def test_intervals_hold_what_quadrature_gives(repeats):
    """95 % intervals of the probability and of the events, each in nine of ten repeats at least;
    not so with copies that begin elsewhere."""
    result = coverage(repeats)
    assert min(result.counts) >= 0.87 * repeats
    assert abs(result.ratio - 1.0) < 0.06 * np.sqrt(REPEATS / repeats)
    assert coverage(min(repeats, 8), Careless).counts[0] < 4


def test_frequent_events_are_those_of_plain_paths():
    """Without levels nothing is copied; with levels the frequent event keeps its probability."""
    first, events = exact(STEPS, 2.5, REARM)
    plain = run(paths(1, 4000), 4000, Levels(()), 2)
    split = [run(paths(10 + k, 100), 100, Levels((1.3, 1.9, 2.4, 2.9, 3.4)), 2) for k in range(20)]
    assert plain.steps == 4000 * STEPS // EACH
    assert plain.max_paths == 4000
    assert abs(plain.probability[0] - first) < 4.0 * math.sqrt(first / 4000)
    assert abs(plain.events[0] - events) < 6.0 * math.sqrt(events / 4000)
    means = np.array([one.probability[0] for one in split])
    assert abs(means.mean() - first) < 4.0 * means.std(ddof=1) / math.sqrt(20)
    assert split[0].steps > 100 * STEPS // 4
    assert split[0].highest == 5


def test_weights_of_paths_that_rise_fall_and_end():
    """Two levels at once make nine of one; falling by two ends those made at the upper one, the
    three that stay weigh a third.
    """
    scores = [[0.0], [7.0], [7.0], [3.0], [0.0]]
    one = Scripted(scores)
    result = run(one, 1, Levels((2.0, 6.0)), 1)
    assert [len(parents) for parents, _ in one.followed] == [9, 3], (
        "where nothing changes nobody is followed"
    )
    assert sorted(one.followed[0][1]) == [0, 1, 1, 2, 2, 2, 2, 2, 2]
    assert result.max_paths == 9
    # Everything ends in an event at the last checkpoint: nine paths of a ninth.
    hit = run(Scripted([[0.0], [7.0], [9.5]]), 1, Levels((2.0, 6.0)), 1)
    np.testing.assert_allclose([hit.probability[0], hit.events[0]], 1.0)
    # A path that ends early counts once, and is followed no more.
    early = Scripted([[0.0, 0.0], [7.0, 0.0], [7.0, 0.0]], ended={(1, 0)})
    is_lost = run(early, 2, Levels((2.0, 6.0)), 1)
    assert (is_lost.probability[0], is_lost.events[0], is_lost.ended) == (0.5, 0.5, 0.5)
    assert early.followed[-1][0] == [1]
    assert run(Scripted([[0.0], [0.0]], ended={(0, 0)}), 1, Levels(()), 1).steps == 1


def test_a_path_that_has_fallen_back_is_one_again():
    one = Scripted([[3.0], [-2.0], [-2.0]])
    assert run(one, 1, Levels((0.5, 2.0)), 1).max_paths == 9
    assert [len(parents) for parents, _ in one.followed] == [9, 1]
    assert Levels((0.5, 2.0, 3.0)).floors == (-1.0, 0.5, 2.0)
    assert Levels((0.5,)).floors == (0.5,)


def test_the_pilot_finds_levels_a_factor_apart_and_says_when_it_cannot():
    grid = np.arange(-1.0, THRESHOLD + 0.05, 0.05)
    levels = pilot(lambda number: paths(100 + number, 200), 200, 2, grid, THRESHOLD).scores
    assert 1.1 < levels[0] < 1.5  # above 1.28 a tenth of the time
    shares = [0.5 * math.erfc(score / math.sqrt(2.0)) for score in levels]
    assert all(2.0 < one / other < 4.5 for one, other in itertools.pairwise(shares))
    assert 0.5 * math.erfc(THRESHOLD / math.sqrt(2.0)) > shares[-1] / 4.5
    with pytest.raises(ValueError, match=r"found no level above .*, 4 is needed"):
        pilot(lambda number: paths(number, 2), 2, 2, grid, THRESHOLD)


def test_levels_from_shares_that_fall_by_a_factor_a_unit():
    grid = np.arange(0.0, 8.0)
    share = 0.3 * 3.0**-grid
    result, complete = more_levels(Occupancy(grid, share, np.full(8, 1000.0)), Levels(()), 4.5)
    np.testing.assert_allclose(result.scores, [1.0, 2.0, 3.0, 4.0])
    assert complete
    observed = np.where(grid > 3.5, 10.0, 1000.0)
    result, complete = more_levels(Occupancy(grid, share, observed), Levels(()), 7.0)
    np.testing.assert_allclose(result.scores, [1.0, 2.0, 3.0])
    assert not complete


def test_levels_that_lie_too_close_are_refused():
    with pytest.raises(ValueError, match="paths would go on side by side"):
        run(Scripted([[20.0]]), 1, Levels(tuple(0.1 * k for k in range(1, 12))), 1)
    for invalid in (((1.0, 1.0), 3), ((2.0, 1.0), 3), ((1.0,), 1)):
        with pytest.raises(ValueError, match="levels rise"):
            Levels(*invalid)


def test_intervals_and_what_they_say_where_there_is_none():
    result = interval([1.0, 2.0, 3.0, 2.0])
    assert (result.estimate, result.replicates, result.reason) == (2.0, 4, "")
    # t of 3 degrees of freedom, 3.182; standard deviation 0.8165.
    np.testing.assert_allclose(
        [result.lower, result.upper], [2.0 / 1.9148, 2.0 * 1.9148], rtol=1e-3
    )
    some = interval([0.0, 2.0])
    assert some.estimate == 1.0
    assert math.isnan(some.lower)
    assert "1 of 2 replicates have no event" in some.reason
    assert math.isnan(interval([0.0, 0.0]).estimate)
    assert "2 at least" in interval([1.0]).reason
    assert math.isnan(interval([]).estimate)
