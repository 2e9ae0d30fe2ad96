"""A flight as a person asks for it, and its record: heights from the start, noise of its own stream
for each channel.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from uqharness.errors import BadInputError
from uqharness.flight.fly import RecordedFlight
from uqharness.flight.recorded import (
    seeded_spec,
    start_position,
    to_record,
    turbulence_and_noise_seeds,
)
from uqharness.flight.spec import FlightSpec

SPEC = FlightSpec(Path("plane"), Path("loiter.xml"), 60.0, seed_noise=5)
N = 4000
NAMES = ["time_s", "h_m", "psi_rad", "q_radps", "V_mps"]


def recorded(*more):
    t = 0.02 * np.arange(N)
    rows = np.column_stack(
        [
            t,
            300.0 + t,
            0.1 * t - 1.0,
            np.zeros(N),
            np.full(N, 22.0),
            *(values for _, values in more),
        ]
    )
    return RecordedFlight([*NAMES, *(name for name, _ in more)], rows, "ok", "", 80.0)


def aircraft(**noise_std):
    return SimpleNamespace(card=SimpleNamespace(sensors=SimpleNamespace(noise_std=noise_std)))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"duration_s": 0.0}, "duration_s = 0: a number above 0"),
        ({"duration_s": float("nan")}, "duration_s"),
        ({"wind_mps": -1.0}, "wind_mps = -1: a number of at least 0 and up to 100"),
        ({"wind_mps": 101.0}, "up to 100"),
        ({"record_rate_hz": 0.0}, "rate_hz = 0"),
        ({"wind_from_deg": float("inf")}, "an angle in degrees"),
    ],
)
def test_what_cannot_be_flown_is_refused(change, said):
    assert seeded_spec(SPEC, 0).duration_s == 60.0
    with pytest.raises(BadInputError, match=said):
        seeded_spec(replace(SPEC, **change), 0)


def test_one_seed_makes_two_streams():
    with pytest.raises(BadInputError, match="seed = -1"):
        seeded_spec(SPEC, -1)
    found = seeded_spec(replace(SPEC, properties={"a/b": 1.0}), 7)
    assert (found.seed_turbulence, found.seed_noise) == turbulence_and_noise_seeds(7)
    assert found.properties["a/b"] == 1.0
    assert len({seed for k in range(50) for seed in turbulence_and_noise_seeds(k)}) == 100


def test_heights_begin_at_zero_and_headings_stay_in_the_circle():
    flown = recorded()
    frame = to_record(flown, aircraft(), SPEC, "loiter")
    assert frame["h_m"].to_numpy() == pytest.approx(0.02 * np.arange(N))
    assert frame["psi_rad"].between(0.0, 2.0 * np.pi, inclusive="left").all()
    assert np.sin(frame["psi_rad"].to_numpy()) == pytest.approx(np.sin(0.002 * np.arange(N) - 1.0))
    assert set(frame["manoeuvre"]) == {"loiter"}
    assert start_position(flown)["alt_m"] == 300.0


def test_noise_is_the_cards_and_a_channels_own():
    noisy = replace(SPEC, sensor_noise=True)
    quiet = to_record(recorded(), aircraft(q_radps=0.1), SPEC, "m")["q_radps"]
    assert not quiet.any()
    found = to_record(recorded(), aircraft(q_radps=0.1), noisy, "m")
    assert found["q_radps"].std() == pytest.approx(0.1, rel=0.05)
    assert (found["V_mps"] == 22.0).all()
    # Another sensor beside it changes none of its samples.
    both = to_record(recorded(), aircraft(V_mps=1.0, q_radps=0.1, az_mps2=1.0), noisy, "m")
    np.testing.assert_array_equal(both["q_radps"], found["q_radps"])
    assert abs(np.corrcoef(both["q_radps"], both["V_mps"])[0, 1]) < 0.06
    other = to_record(recorded(), aircraft(q_radps=0.1), replace(noisy, seed_noise=6), "m")
    assert not np.array_equal(other["q_radps"], found["q_radps"])


def test_a_scripts_count_names_manoeuvres():
    flown = recorded(("manoeuvre_number", np.repeat([0.0, 1.0, 2.0, 3.0], N // 4)))
    frame = to_record(flown, aircraft(), SPEC, "script", {1: "pull-up", 3: "roll"})
    assert frame["manoeuvre"].iloc[:: N // 4].tolist() == ["", "pull-up", "", "roll"]
    assert "manoeuvre_number" not in frame
    assert set(to_record(flown, aircraft(), SPEC, "script")["manoeuvre"]) == {"script"}
