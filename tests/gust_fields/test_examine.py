"""The examination in other air runs, and finds standard air as it is."""

from __future__ import annotations

import numpy as np
import pytest

import uqharness as uq
from sysid.effects import TURBULENCE_CRITICAL_T
from tests.gust_fields import examine
from tests.gust_fields.fields import FAMILIES


def test_each_kind_of_air_is_flown(tmp_path):
    for family in FAMILIES:
        (path, *_) = examine.write_flights(family, 0, 2.0, 15.0, tmp_path, ())
        assert path.stat().st_size > 1000


@pytest.mark.slow
@pytest.mark.parametrize("family", ["heading", "body", "tail-delay", "field-wing"])
def test_flights_that_lack_nothing_show_nothing_in_any_air(family, tmp_path):
    row = examine.measure(examine.write_flights(family, 1, 45.0, 15.0, tmp_path))
    assert row.largest[1] < TURBULENCE_CRITICAL_T + 1.0
    assert max(row.vane_t) < 4.0
    assert row.covered > 0.75


@pytest.mark.slow
def test_intervals_hold_in_the_turbulence_of_jsbsim(tmp_path):
    """A stock glider that turns through the azimuth of JSBSim's gusts; every scale is 1."""
    aircraft, paths = examine.jsbsim_flights("sgs126", "null", 1, 45.0, 15.0, tmp_path)
    result = uq.identify(aircraft, paths[:2], workers=1)
    assert any("axes at an azimuth" in note for note in result.notes)
    identified = np.array([result.status[n] == "identified" for n in result.names])
    z = ((result.theta - 1.0) / result.std)[identified]
    assert identified.sum() == 20
    assert np.sqrt(np.mean(z**2)) < 1.6
    assert np.mean(np.abs(z) < examine.COVERED) > 0.75
