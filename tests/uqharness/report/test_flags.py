"""Where findings apply: their channel, their message's channels, and the time that the record
tells.
"""

from __future__ import annotations

import numpy as np
import pytest

from sysid.errors import Finding
from sysid.record import FlightRecord, Metadata
from uqharness.report.pages.flight import channels_of, spans_of

TIME = np.arange(0.0, 100.0, 0.1)
SOURCES = {"V_mps": "ARSP.Airspeed x CTUN.E2T", "alpha_rad": "AOA.AOA", "beta_rad": "AOA.SSA"}


def record(*findings, **columns):
    usual = {
        "time_s": TIME,
        "V_mps": np.full(TIME.size, 20.0),
        "alpha_rad": 0.0 * TIME,
        "beta_rad": 0.0 * TIME,
        "vn_mps": TIME,
    }
    return FlightRecord({**usual, **columns}, Metadata(channels=SOURCES, findings=tuple(findings)))


def finding(code, channel, severity="warning", **numbers):
    return Finding(code, channel, severity, f"{code} in {channel}", numbers)


@pytest.mark.parametrize(
    ("channel", "names"),
    [
        ("V_mps", ("V_mps",)),
        ("AOA", ("alpha_rad", "beta_rad")),
        ("ground velocity", ("vn_mps",)),
        ("", ()),
        ("AO", ()),
        ("GPS", ()),
    ],
)
def test_flagged_channels(channel, names):
    assert channels_of(finding("gap", channel), record()) == names


def test_stretches_that_the_record_shows():
    speed = np.full(TIME.size, 20.0)
    speed[100:111], speed[500] = np.nan, 2000.0
    result = record(V_mps=speed)
    assert spans_of(finding("dropouts", "V_mps"), "V_mps", result) == (
        (pytest.approx(10.0), pytest.approx(11.0)),
    )
    assert spans_of(finding("out-of-range", "V_mps"), "V_mps", result) == (
        (pytest.approx(50.0), pytest.approx(50.0)),
    )
    assert spans_of(finding("negative-airspeed", "V_mps"), "V_mps", result) == ()
    assert spans_of(finding("delay", "V_mps"), "V_mps", result) == ()
