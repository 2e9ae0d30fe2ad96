"""Calm and turbulent air are told apart by likelihood, whatever residuals look like at first."""

from __future__ import annotations

import pytest

from sysid.parallel import SERIAL
from tests.helpers.sixdof import Airframe
from tests.hidden_effects.catalogue import ENTRIES
from tests.hidden_effects.flights import Flight, fly
from tests.hidden_effects.manoeuvres import card
from uqharness.identification.linearised import make_flight_data
from uqharness.refinement import baseline as baseline_module
from uqharness.refinement.estimators import PredictionErrorEstimator, ReplayEstimator
from uqharness.refinement.stages import Stages
from uqharness.replay.flights import read_flights
from uqharness.simulator import find_aircraft

PAIR = tuple(ENTRIES[k].effect(100.0) for k in ("CX:q_hat", "Cn:alpha*p_hat"))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("effects", "w20_kt", "estimator"),
    [(PAIR, 0.0, ReplayEstimator), ((), 6.0, PredictionErrorEstimator)],
)
def test_effects_in_calm_air_are_no_gusts(effects, w20_kt, estimator, tmp_path, monkeypatch):
    monkeypatch.setattr(baseline_module, "is_turbulent", lambda *_: True)
    cards = [card(60 + k, 20.5 + 3.0 * k, seconds=40.0, first=4 * k, w20_kt=w20_kt) for k in (0, 1)]
    paths = [tmp_path / f"{k}.parquet" for k in (0, 1)]
    for record, path in zip(
        fly([Flight(c, Airframe(), effects) for c in cards]), paths, strict=True
    ):
        record.write(path)
    aircraft = find_aircraft("espaaro")
    flights, measured = read_flights(paths, aircraft, align=False)
    data = make_flight_data(aircraft, flights, measured, ())
    baseline = baseline_module.fit_baseline(
        aircraft, data, (), [], pool=SERIAL, callback=lambda _: None, stages=Stages(None, ())
    )
    assert isinstance(baseline.context.estimator, estimator)
