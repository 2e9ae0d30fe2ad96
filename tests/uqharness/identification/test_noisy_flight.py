"""What a flight in turbulence holds beside the model's error, on flights of the model itself."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sysid.aerodynamics import COEFFICIENTS, Cutoffs
from uqharness.cli.main import main
from uqharness.identification.bounds import NoisyFlight, air_note, noise_sizes
from uqharness.replay import flight_residuals, prediction_of, read_bounds_flights
from uqharness.simulator import find_aircraft


@pytest.fixture(scope="module", params=["light", "none"])
def looked_at(request, tmp_path_factory):
    """Air; a flight of the model with sensor noise in that air; the residuals before and after;
    what was found.
    """
    path = Path(tmp_path_factory.mktemp("air")) / "f.parquet"
    output = [
        "fly",
        "espaaro",
        "--script",
        "flight-bounds",
        "--noise",
        "--seed",
        "5",
        "--turbulence",
        request.param,
    ]
    assert main([*output, "--out", str(path)]) == 0
    aircraft = find_aircraft("espaaro")
    (flight,), measured = read_bounds_flights([path], aircraft)
    with prediction_of(aircraft, measured) as pair:
        residuals = flight_residuals(pair, flight, aircraft.accelerometer_m, Cutoffs())
        noisy = NoisyFlight.of(pair, flight, residuals, aircraft)
        estimates = replace(flight.record.metadata, estimates=("alpha_rad",))
        guessed = NoisyFlight.of(
            pair,
            replace(flight, record=replace(flight.record, metadata=estimates)),
            residuals,
            aircraft,
        )
    return request.param, flight, noisy, noisy.in_still_air(noisy.residuals), guessed


def _rms(residuals, coefficient):
    return float(np.sqrt(np.mean(residuals.delta[:, COEFFICIENTS.index(coefficient)] ** 2)))


def test_the_air_is_told_from_the_model_where_it_moves_and_only_there(looked_at):
    air, flight, noisy, (steady, result), guessed = looked_at
    assert result is not None
    if air == "none":
        assert result.level == 0.0
        assert np.array_equal(steady.delta, noisy.residuals.delta)
        return
    assert result.share == pytest.approx(1.0, abs=4.0 * result.std + 0.1)
    assert _rms(steady, "Cm") < 0.5 * _rms(noisy.residuals, "Cm")
    assert _rms(steady, "Cn") < 0.9 * _rms(noisy.residuals, "Cn")
    assert _rms(steady, "CX") == pytest.approx(_rms(noisy.residuals, "CX"), rel=0.01)
    assert len(steady.pieces[0].noise.passages) == len(noisy.residuals.pieces[0].noise.passages) + 1
    assert f"{100.0 * result.share:.0f} ±" in air_note(flight, result)
    # An estimator's alpha feels no gusts: nothing is taken out.
    assert guessed.in_still_air(guessed.residuals) == (guessed.residuals, None)


def test_noise_is_what_the_flight_shows_whatever_the_card_says(looked_at):
    _, flight, noisy, _, _ = looked_at
    doubled = noise_sizes(flight, {c: 2.0 * s for c, s in noisy.std.items()}, Cutoffs())
    assert doubled["q_radps"].std == pytest.approx(noisy.std["q_radps"], rel=0.1)
