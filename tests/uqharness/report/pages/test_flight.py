"""The page of a flight: track and channels of the record, how it ended, manoeuvres by number."""

from __future__ import annotations

import numpy as np

from tests.helpers.page_checks import problems, words_of
from uqharness.report.pages.flight import FlightFacts, flight_page
from uqharness.report.parts import render

TIME = np.arange(0.0, 80.0, 0.1)
ANGLE = 2.0 * np.pi * TIME / 40.0
AWAY = 3.0 * np.sin(0.5 * TIME)
ASKED = FlightFacts("toy", "loiter", "No steady wind.", "toy.parquet", "uqharness fly toy")
COLUMNS = {
    "time_s": TIME,
    "V_mps": 20.0 + np.sin(TIME),
    "psi_rad": np.mod(ANGLE, 2.0 * np.pi),
    "elevator_deg": np.sin(TIME),
    "north_m": (120.0 + AWAY) * np.cos(ANGLE),
    "east_m": (120.0 + AWAY) * np.sin(ANGLE),
    "cross_track_m": AWAY,
    "manoeuvre": np.where(TIME < 20.0, "pitch doublet", "").astype(object),
}


def page(columns=COLUMNS, status="ok", reason=""):
    return render(flight_page(ASKED, columns, status, reason))


def test_a_flight_that_ended_as_planned():
    text = page()
    assert problems(text) == []
    words = words_of(text)
    assert "The flight ended as planned; 79.9 s, 800 rows." in words
    assert f"median {np.median(np.abs(AWAY)):.3g} m, largest {np.abs(AWAY).max():.3g} m" in words
    assert "commanded circle, radius 120 m" in words
    assert "pitch doublet" in words


def test_a_flight_that_ended_early_says_so_first():
    words = words_of(page(status="ground-contact", reason="the left wheel"))
    assert "The flight ended early, ground-contact: the left wheel" in words
    assert "as planned" not in words
