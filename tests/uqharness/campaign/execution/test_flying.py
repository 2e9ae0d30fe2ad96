"""What a worker flies with: JSBSim by several names, and the batch engine where there is one."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from tests.helpers import campaign_fakes as fakes
from uqharness import batch
from uqharness.campaign import worker
from uqharness.flight.fly import fly, fly_one_ulp_off
from uqharness.flight.spec import FlightResult, FlightSpec

SPEC = FlightSpec(Path("espaaro"), Path("loiter"), duration_s=4.0, wind_mps=3.0, turbulence="light")


def signals(result: FlightResult) -> bytes:
    return result.signals["alpha_rad"].tobytes()


def test_each_name_flies_what_it_says():
    alone, moved = fly(SPEC), fly_one_ulp_off(SPEC)
    assert signals(alone) != signals(moved)
    for name, expected in (
        (worker.JSBSIM, alone),
        (worker.JUDGE, alone),
        (worker.ONE_ULP_OFF, moved),
    ):
        (found,) = worker.fly_group(name, [SPEC])
        assert signals(found) == signals(expected)
        assert expected.metrics.items() <= found.metrics.items()


def test_the_judge_tells_how_near_a_radius_a_flight_came():
    (found,) = worker.fly_group(
        worker.JUDGE, [replace(SPEC, excursion_radius_m=(1.0,), rearm_m=0.25)]
    )
    distance = np.abs(found.signals["cross_track"])
    expected = min(np.abs(distance - 1.0).min(), np.abs(distance - 0.75).min())
    assert found.metrics["nearest_excursions_1m"] == expected
    without = replace(fakes.steady(SPEC), signals={})
    assert np.isnan(worker.with_distances(without, SPEC).metrics["nearest_excursions_15m"])


def test_the_batch_engine_is_asked_for_its_own(monkeypatch):
    monkeypatch.setattr(
        batch, "fly_many", lambda specs: [fakes.steady(spec) for spec in specs], raising=False
    )
    monkeypatch.setattr(
        batch, "refusals", lambda spec, varying: (spec.aircraft.name, *varying), raising=False
    )
    monkeypatch.setattr(batch, "available", lambda: "llvmlite is not installed", raising=False)
    assert worker.fly_group("batch", [SPEC, SPEC]) == [fakes.steady(SPEC)] * 2
    assert worker.LocalBatch().refusals(SPEC, ("x",)) == ("espaaro", "x")
    assert (
        worker.LocalBatch().available()
        == worker.unavailable_reason("batch")
        == "llvmlite is not installed"
    )
    assert worker.unavailable_reason("jsbsim") is None
