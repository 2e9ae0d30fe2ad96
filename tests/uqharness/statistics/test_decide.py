"""*decide* over simulated campaigns of known truth: how often it is wrong, what it costs, and what
it cannot know.
"""

from __future__ import annotations

import numpy as np
import pytest

from tests.helpers.few import few
from uqharness.statistics.decide import NO, OPEN, YES, Question, add, begin, close, decide_cell

# Worst corner's excursions per hour beyond 15 m (Hale 2016, Table 3.2): light, moderate, severe
# turbulence at 0 to 7 m/s.
PUBLISHED = (
    (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.028),
    (0.0, 0.0, 0.0, 0.0, 0.002, 0.036, 0.324, 3.886),
    (0.068, 0.092, 0.136, 0.31, 0.868, 2.44, 7.762, 25.342),
)


CORNERS, MOST, LOOK = 64, 500, 10


def question(error=0.05, dispersion=2.0, **changes):
    return Question(0.1, (0.08, 0.12), dispersion, error, **changes)


def corner_rates(worst, corners=CORNERS):
    """Few corners near the worst, many near zero, as a [best, worst] of [0, worst] suggests."""
    return worst * np.linspace(0.0, 1.0, corners) ** 6


def draw(generator, rates, flights, dispersion):
    """Counts (c, n): excursions come ``dispersion`` at a time, so that Var/mean is that."""
    if dispersion == 1.0:
        return generator.poisson(np.outer(rates, np.ones(flights))).astype(float)
    clusters = generator.poisson(np.outer(rates, np.ones(flights)) / dispersion)
    return (dispersion * clusters).astype(float)


def decide(counts, request, look_every=LOOK):
    evidence = begin(counts.shape[0])
    for first in range(0, counts.shape[1], look_every):
        block = np.where(evidence.open[:, None], counts[:, first : first + look_every], np.nan)
        evidence = decide_cell(add(evidence, request, block, block), request)
        if not evidence.open.any():
            break
    return close(evidence)


def errors(truth, dispersion, request, campaigns=1500, flights=400, seed=11):
    """Shares of campaigns that said yes and no; each corner of one cell is a campaign of
    its own.
    """
    generator = np.random.default_rng(seed)
    result = decide(draw(generator, np.full(campaigns, truth), flights, dispersion), request)
    return np.mean([answer == YES for answer in result.answers]), np.mean(
        [answer == NO for answer in result.answers]
    )


@pytest.mark.parametrize("dispersion", few([2.0, 1.0, 3.0, 8.0], 1))
def test_it_errs_no_more_often_than_stated_right_at_the_threshold(dispersion):
    """The hardest truths: hardly above, where yes is wrong, and hardly below, where no is.

    Looked at 40 times.
    """
    request = question(dispersion=dispersion, every_corner=True)
    chance = 2.0 * np.sqrt(0.05 * 0.95 / 1500)
    assert errors(0.1001, dispersion, request)[0] <= 0.05 + chance
    assert errors(0.0999, dispersion, request)[1] <= 0.05 + chance
    # Far from it the answer comes, and is right.
    assert errors(0.5 if dispersion < 8 else 2.0, dispersion, request)[1] > 0.95


def test_many_corners_a_little_below_do_not_add_up_to_a_no():
    """What the mean of the evidence is for: 16 corners at once, wrong no more often than one."""
    generator = np.random.default_rng(11)
    request = question(dispersion=2.0)
    result = [
        decide(draw(generator, np.full(16, 0.0999), 150, 2.0), request, 30).cell for _ in range(120)
    ]
    assert result.count(NO) / 120 <= 0.05 + 2.0 * np.sqrt(0.05 * 0.95 / 120)


def test_allowing_for_less_dispersion_than_there_is_errs():
    """What the declared dispersion is for: clusters of 12 taken as independent."""
    rash = question(dispersion=1.0, every_corner=True)
    assert errors(0.101, 12.0, rash, flights=100)[0] > 0.2
    assert errors(0.101, 12.0, question(dispersion=12.0, every_corner=True))[0] <= 0.05


@pytest.mark.parametrize(
    ("dispersion", "cells", "saving"), few([(2.0, 1, 6.0), (1.0, 24, 6.0), (1.0, 1, 9.0)], 1)
)
def test_it_needs_a_fifth_of_the_published_hours_at_most(dispersion, cells, saving):
    """All 24 cells of the published table against 500 h each; ``cells`` share the error rate."""
    generator = np.random.default_rng(14)
    request = question(error=0.05 / cells, dispersion=dispersion)
    flight, invalid = 0.0, []
    for row in PUBLISHED:
        for worst in row:
            result = decide(draw(generator, corner_rates(worst), MOST, dispersion), request)
            flight += result.flights.sum()
            if result.cell != OPEN and (result.cell == YES) != (worst <= 0.1):
                invalid.append(worst)
            if worst == 0.0:
                assert result.cell == YES
            if worst > 0.8:
                assert result.cell == NO
    assert not invalid
    assert 24 * CORNERS * MOST / flight >= saving >= 5.0


def test_a_single_bad_corner_answers_for_its_cell_and_good_ones_land_early():
    counts = np.zeros((4, 200))
    counts[2] = 1.0
    result = decide(counts, question())
    assert (result.cell, result.flights.max()) == (NO, LOOK)
    each = decide(counts, question(every_corner=True))
    assert (each.cell, each.answers) == (NO, (YES, YES, NO, YES))
    assert each.flights[0] > each.flights[2]


def test_what_lies_within_the_zone_is_left_open_before_the_flights_are_used_up():
    generator = np.random.default_rng(15)
    wide = Question(0.1, (0.04, 0.25), 1.0, 0.05)
    result = [decide(draw(generator, np.full(2, 0.1), 2000, 1.0), wide, 20) for _ in range(20)]
    inside = [item for item in result if item.reason == "within the indifference zone"]
    assert len(inside) >= 12
    assert all(item.cell == OPEN and item.flights.max() < 2000 for item in inside)
    tired = decide(draw(generator, np.full(2, 0.1), 40, 1.0), question())
    assert (tired.cell, tired.reason, tired.flights.max()) == (OPEN, "all flights flown", 40)


def test_failed_flights_count_against_yes_and_not_for_no():
    request = question()
    zero, failed = np.zeros((1, 80)), np.zeros((1, 80))
    assert decide_cell(add(begin(1), request, zero, zero), request).cell == YES
    failed[0, :20] = 1.0
    assert decide_cell(add(begin(1), request, zero, failed), request).cell == ""
    assert decide_cell(add(begin(1), request, failed, failed), request).cell == NO


def test_observed_dispersion_takes_over_where_it_is_larger():
    counts = np.zeros((1, 100))
    counts[0, 0] = 9.0
    evidence = add(begin(1), question(), counts, counts)
    assert evidence.dispersion[0] == pytest.approx(counts.var(ddof=1) / counts.mean())
    assert evidence.dispersion[0] > 2.0
