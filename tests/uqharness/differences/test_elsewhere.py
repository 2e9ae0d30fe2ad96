"""B flown by the interpreter of another environment."""

import sys
from pathlib import Path

import pytest

from uqharness.differences.elsewhere import FlightSettings, channels_of, fly_elsewhere
from uqharness.differences.ranking import MatchedRequest, differences, fly_matched
from uqharness.errors import BadInputError
from uqharness.simulator import engine, find_aircraft, open_aircraft

HOW = FlightSettings(max_s=1.0, dt_s=0.01)


def test_the_same_jsbsim_flies_the_same_bits():
    aircraft = find_aircraft("espaaro")
    request = MatchedRequest(
        speeds_mps=(22.0,), missions=("steady",), python_b=Path(sys.executable)
    )
    channels, (flight,) = fly_matched(aircraft, aircraft, request)
    assert flight.jsbsim_b == engine.JSBSIM_VERSION
    assert flight.reason == ""
    assert len(flight.time_s) > 1000
    assert all((flight.a[c] == flight.b[c]).all() for c in flight.a)
    assert differences(channels, [flight], []) == []


@pytest.mark.slow
def test_another_model_there_is_seen():
    one, two = find_aircraft("espaaro"), find_aircraft("espaaro_truth")
    request = MatchedRequest(
        speeds_mps=(22.0,), missions=("steady",), python_b=Path(sys.executable)
    )
    channels, (flight,) = fly_matched(one, two, request)
    assert differences(channels, [flight], []) != []


@pytest.mark.parametrize(
    ("code", "output"),
    [
        ("exit 3", "exit code 3"),
        ("echo no module named jsbsim >&2; exit 1", "no module named jsbsim"),
        ("kill -11 $$", "SIGSEGV"),
    ],
)
def test_an_environment_that_cannot_fly(tmp_path, code, output):
    python = tmp_path / "python"
    python.write_text(f"#!/bin/sh\n{code}\n")
    python.chmod(0o755)
    aircraft = find_aircraft("espaaro")
    channels = channels_of(aircraft, open_aircraft(aircraft))
    with pytest.raises(BadInputError, match=output):
        fly_elsewhere(python, aircraft, Path("scripts/loiter.xml").resolve(), channels, HOW)
