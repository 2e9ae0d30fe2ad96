"""What the benchmark of the batch engine measures and prints."""

from __future__ import annotations

import os

import pytest

from uqharness.batch import VECTORS, target_names
from uqharness.cli import benchmark_batch
from uqharness.cli.benchmark_batch import as_text, measure_batch


@pytest.mark.slow
@pytest.mark.usefixtures("flights_here")
def test_every_loop_is_measured_and_said(monkeypatch):
    monkeypatch.delenv(VECTORS, raising=False)
    ends = (target_names()[-1],)
    monkeypatch.setattr(benchmark_batch, "target_names", lambda: ends)
    found = measure_batch("espaaro", 1.0, 1, campaign_airs=1)
    loops = {"a_us_per_step", "c_us_per_step"}
    loops |= {
        f"d_{name}_{source}_{what}"
        for name in ends
        for source in ("spec", "jsbsim")
        for what in ("us_per_step", "over_a")
    }
    campaigns = {"e_1_flight_hours_per_hour", "e_2_flight_hours_per_hour", "e_2_over_1"}
    assert set(found) == loops | campaigns
    assert all(value > 0.0 for value in found.values())
    text = as_text(found)
    assert len(text.splitlines()) == 2 + 2 * len(ends) + 3
    # What is compiled for is put back.
    assert VECTORS not in os.environ
