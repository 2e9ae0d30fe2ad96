"""Scores of signals made by hand."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from uqharness.flight.fly import (
    RecordedFlight,
    commanded_signals,
    from_start_signals,
    score_commanded,
    score_from_start,
)
from uqharness.flight.spec import FlightResult, FlightSpec

SPEC = FlightSpec(Path("plane"), Path("mission.xml"), 3.0)
NAMES = ["cross_track", "altitude", "speed", "phi_rad", "alpha_rad", "extrapolated"]
ROWS = np.array(
    [
        [20.0, -1.0, 0.5, 0.0, 0.0, 0.0],
        [-10.0, 2.0, -0.5, 0.1, 0.1, 1.0],
        [-30.0, 6.0, 2.0, 0.1, 0.1, 0.0],
        [5.0, 0.0, 0.0, 0.1, 0.1, 1.0],
    ]
)


def test_deviations_by_hand():
    names = ["height_m", "V_mps", "psi_rad", "load_factor", "phi_rad", "alpha_rad"]
    rows = np.array(
        [
            [100.0, 50.0, 6.2, 1.0, 0.0, 0.0],
            [103.0, 49.0, 6.3 - 2 * np.pi, 1.5, 0.1, 0.0],
            [98.0, 52.0, 6.1, 0.7, 0.1, 0.0],
        ]
    )
    result = score_from_start(SPEC, RecordedFlight(names, rows, "ok", "", 3.0))
    assert isinstance(result, FlightResult)
    assert [result.metrics[f"altitude_{kind}_m"] for kind in ("median", "mean", "max")] == [
        2.0,
        5.0 / 3.0,
        3.0,
    ]
    assert result.metrics["speed_max_mps"] == 2.0
    # The heading passes north, which is no jump of 360 deg.
    assert result.metrics["heading_max_deg"] == pytest.approx(np.rad2deg(0.1))
    assert result.metrics["load_factor_max"] == 1.5
    assert result.metrics["loss_of_control"] == 0.0
    # Nothing says that this flight is to go straight on.
    assert result.undefined["cross_track"] == "no path is commanded"
    assert "excursions_15m" not in result.metrics
    straight = np.column_stack(
        [rows, [0.0, 10.0, 20.0], [0.0, 10.0, 52.0], [5.0, 0.0, 0.0], [5.0, 9.0, 9.0]]
    )
    onwards = score_from_start(
        SPEC,
        RecordedFlight([*names, "north_m", "east_m", "vn_mps", "ve_mps"], straight, "ok", "", 3.0),
    )
    # Began towards the north-east; 52 m east and 20 m north lies 32/sqrt(2) m to the right of that
    # line.
    assert onwards.metrics["cross_track_max_m"] == pytest.approx(32.0 / np.sqrt(2.0))
    assert (onwards.metrics["excursions_15m"], onwards.metrics["excursions_25m"]) == (1.0, 0.0)
    broken = score_from_start(SPEC, RecordedFlight(names, rows, "crashed", "hit the ground", 3.0))
    assert np.isnan(broken.metrics["altitude_max_m"])
    assert broken.undefined["altitude"] == "hit the ground"
    assert broken.metrics["loss_of_control"] == 1.0


def test_errors_from_a_path_by_hand():
    found = score_commanded(SPEC, RecordedFlight(NAMES, ROWS, "ok", "", 3.0))
    assert [found.metrics[f"cross_track_{kind}_m"] for kind in ("median", "mean", "max")] == [
        15.0,
        16.25,
        30.0,
    ]
    assert found.metrics["speed_max_mps"] == 2.0
    # Out at 20 m, back inside 13 m, out again: two beyond 15 m, one beyond 25 m.
    assert (found.metrics["excursions_15m"], found.metrics["excursions_25m"]) == (2.0, 1.0)
    assert found.metrics["loss_of_control"] == 0.0
    assert found.metrics["extrapolated_share"] == 0.5
    assert math.isnan(found.metrics["cross_track_mean_m_measured"])
    assert (
        found.undefined["cross_track_mean_m_measured"]
        == "the card names no cross_track_measured under [metrics]"
    )
    assert found.undefined["excursions_15m_3d"] == "the card names no distance_3d under [metrics]"


def test_a_flight_that_ended_badly_keeps_what_it_counted():
    found = score_commanded(SPEC, RecordedFlight(NAMES, ROWS, "crashed", "hit the ground", 3.0))
    assert math.isnan(found.metrics["cross_track_max_m"])
    assert found.undefined["cross_track_max_m"] == "hit the ground"
    assert found.metrics["excursions_15m"] == 2.0
    assert found.metrics["loss_of_control"] == 1.0


@pytest.mark.parametrize(
    ("column", "value"),
    [("altitude", 61.0), ("phi_rad", 1.4), ("alpha_rad", 0.45), ("alpha_rad", np.nan)],
)
def test_control_is_lost_beyond_a_limit(column, value):
    rows = ROWS.copy()
    rows[2, NAMES.index(column)] = value
    assert (
        score_commanded(SPEC, RecordedFlight(NAMES, rows, "ok", "", 3.0)).metrics["loss_of_control"]
        == 1.0
    )


def test_the_rearming_distance_counts():
    near = ROWS.copy()
    near[1, 0] = -14.0
    flight = RecordedFlight(NAMES, near, "ok", "", 3.0)
    assert score_commanded(SPEC, flight).metrics["excursions_15m"] == 1.0
    assert score_commanded(replace(SPEC, rearm_m=0.5), flight).metrics["excursions_15m"] == 2.0


def test_signals_are_those_that_the_card_names():
    metrics = {
        "cross_track": SimpleNamespace(true="a", measured="b"),
        "speed": SimpleNamespace(true="c", measured=None),
    }
    found = commanded_signals(SimpleNamespace(card=SimpleNamespace(metrics=metrics)))
    assert list(found) == ["cross_track", "speed", "cross_track_measured"]
    assert set(from_start_signals(True)) - set(from_start_signals(False)) == {
        "north_m",
        "east_m",
        "vn_mps",
        "ve_mps",
    }
