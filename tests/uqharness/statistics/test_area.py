"""The area metric: closed forms and simulation."""

from __future__ import annotations

import numpy as np
import pytest

from uqharness.statistics.pbox import Sample, area_metric, pbox


def box(*corners, unknown=0):
    return pbox(
        [
            Sample(str(number), np.asarray(values, float), unknown)
            for number, values in enumerate(corners)
        ]
    )


def test_the_area_of_a_single_flight_is_its_mean_distance():
    """One corner, one flight: integral of |F - step| = mean |X - x|; within a wide box the flight
    is inside.
    """
    values = [1.0, 2.0, 4.0]
    for flight in (0.0, 2.0, 7.0):
        found = area_metric(box(values), np.array([flight]))
        assert found.area == pytest.approx(np.mean(np.abs(np.array(values) - flight)))
    assert area_metric(box([0.0, 1.0], [5.0, 6.0]), np.array([3.0])).area == 0.0


def test_the_area_is_the_shift_where_one_distribution_is_moved():
    values = np.random.default_rng(1).normal(size=200)
    for shift in (0.5, -0.5):
        found = area_metric(box(values), values + shift)
        assert found.area == pytest.approx(abs(shift), rel=0.05)
        assert (found.above if shift > 0 else found.below) == pytest.approx(found.area)
    # Between two corners nothing is left of it.
    assert area_metric(box(values, values + 1.0), values + 0.5).area == pytest.approx(0.0, abs=1e-9)


def test_failed_flights_leave_room_above():
    flights = np.array([9.0] * 8)
    assert area_metric(box([1.0] * 8), flights).area == pytest.approx(8.0)
    assert area_metric(box([1.0] * 4, unknown=4), flights).area == pytest.approx(4.0)


def test_chance_is_blamed_before_the_model_is():
    generator = np.random.default_rng(2)
    false = 0
    for _ in range(200):
        model = box(*(generator.normal(shift, 1.0, 60) for shift in (0.0, 0.5, 1.0)))
        false += area_metric(model, generator.normal(1.0, 1.0, 12)).beyond_chance > 0.0
    assert false / 200 <= 0.05
    model = box(generator.normal(size=200))
    assert area_metric(model, generator.normal(2.0, 1.0, 30)).beyond_chance > 0.0
    # A single flight far away is no proof: the model may send one in fifty there.
    assert area_metric(model, np.array([9.0])).beyond_chance == 0.0


@pytest.mark.parametrize("values", [[], [1.0, np.nan], [np.inf]])
def test_no_flight_and_no_number_are_refused(values):
    with pytest.raises(ValueError, match="at least one flight"):
        area_metric(box([1.0, 2.0]), np.array(values))
