"""Rows of a FlightGear playback: units, position and rate against what reads logs, dropouts, what
is refused.
"""

from __future__ import annotations

import numpy as np
import pytest

from sysid.logs import channels
from sysid.record import FlightRecord
from uqharness.errors import BadInputError
from uqharness.flight.recorded import PLAYBACK_COLUMNS, playback_rows

START = {"lat_deg": 37.2, "lon_deg": -80.4, "alt_m": 630.0}


def record(**changed: np.ndarray) -> FlightRecord:
    time_s = np.arange(0.0, 10.01, 0.02)
    columns = {
        "time_s": time_s,
        "north_m": 30.0 * time_s,
        "east_m": -20.0 * time_s,
        "h_m": 2.0 * time_s,
        "phi_rad": 0.1 * np.sin(time_s),
        "theta_rad": np.full_like(time_s, 0.05),
        "psi_rad": np.full_like(time_s, -0.5),
        "V_mps": np.full_like(time_s, 22.0),
    }
    return FlightRecord(columns | changed)


def test_units_and_rate():
    rows = playback_rows(record(), START, 25.0)
    assert rows.shape == (251, 7)
    first, last = rows[0], rows[-1]
    assert first[:3] == pytest.approx([37.2, -80.4, 630.0 / 0.3048])
    assert last[2] == pytest.approx(650.0 / 0.3048)
    assert last[4] == pytest.approx(2.864789, abs=1e-6)
    # A true heading is from 0 to 360 deg: -0.5 rad is 331.35 deg.
    assert last[5] == pytest.approx(331.352110, abs=1e-6)
    assert last[6] == pytest.approx(42.764579, abs=1e-6)


def test_positions_are_those_that_a_reader_of_logs_finds():
    given = record()
    rows = playback_rows(given, START, 50.0)
    north, east = channels.local_position_m(rows[:, 0], rows[:, 1])
    assert np.abs(north - given["north_m"]).max() < 1e-3
    assert np.abs(east - given["east_m"]).max() < 1e-3
    # The check is not blind: a tenth of a metre is seen.
    assert (
        np.abs(
            channels.local_position_m(rows[:, 0] + 1e-6, rows[:, 1])[0] - given["north_m"] - 0.1
        )[1:].max()
        > 0.05
    )


def test_dropouts_hold_the_last_value_and_the_first_known_one_before_it():
    height = np.asarray(record()["h_m"]).copy()
    height[:10], height[20:30] = np.nan, np.nan
    rows = playback_rows(record(h_m=height), START, 50.0)
    assert np.isfinite(rows).all()
    assert rows[0, 2] == rows[10, 2]
    assert (rows[19:30, 2] == rows[19, 2]).all()
    assert rows[30, 2] > rows[19, 2]


def test_a_record_that_cannot_be_shown_is_refused():
    columns = dict(record().columns)
    del columns["north_m"], columns["east_m"]
    with pytest.raises(BadInputError, match=f"needs north_m, east_m, which.*{PLAYBACK_COLUMNS[0]}"):
        playback_rows(FlightRecord(columns), START, 30.0)
    with pytest.raises(BadInputError, match="no value of it"):
        playback_rows(record(h_m=np.full(501, np.nan)), START, 30.0)
