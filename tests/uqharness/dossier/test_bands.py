"""Tolerances against the regulation's own units, typed in once more from its text."""

import math
from dataclasses import replace

import pytest

from uqharness.dossier.match import TESTS, Band

# Entry, channel: absolute tolerance in the unit of the regulation, what a unit of it is in SI,
# share of the measured value.
DEG, KT, FT, G = math.pi / 180.0, 1852.0 / 3600.0, 0.3048, 9.80665
PRINTED = {
    ("2.b.4", "q_radps"): (0.15, DEG, 0.20),
    ("2.b.5", "p_radps"): (0.15, DEG, 0.20),
    ("2.b.6", "r_radps"): (0.15, DEG, 0.20),
    ("2.c.1", "V_mps"): (3.0, KT, 0.0),
    ("2.c.1", "h_m"): (100.0, FT, 0.0),
    ("2.c.1", "theta_rad"): (1.5, DEG, 0.20),
    ("2.c.10", "theta_rad"): (1.5, DEG, 0.0),
    ("2.c.10", "q_radps"): (2.0, DEG, 0.0),
    ("2.c.10", "az_mps2"): (0.10, G, 0.0),
    ("2.d.2", "p_radps"): (2.0, DEG, 0.10),
    ("2.d.4", "phi_rad"): (2.0, DEG, 0.10),
    ("2.d.6", "r_radps"): (2.0, DEG, 0.10),
}


def as_printed(entry: str, band: Band) -> bool:
    number, unit, share = PRINTED[entry, band.channel]
    return band.absolute == pytest.approx(number * unit, rel=1e-12) and band.share == share


def test_time_histories():
    result = {(t.entry, b.channel): as_printed(t.entry, b) for t in TESTS for b in t.bands}
    assert result == dict.fromkeys(PRINTED, True)


def test_another_number_is_seen():
    band = next(t for t in TESTS if t.entry == "2.c.10").bands[1]
    assert not as_printed("2.c.10", replace(band, absolute=band.absolute * 1.01))
    assert not as_printed("2.c.10", replace(band, share=0.1))


def test_oscillations():
    result = {t.entry: t.oscillation for t in TESTS if t.oscillation is not None}
    assert set(result) == {"2.c.9", "2.d.7"}
    for entry, period_s, cycles in (("2.c.9", 0.0, 3.0), ("2.d.7", 0.5, 6.0)):
        request = result[entry]
        assert (request.period_s, request.period_share, request.half_share, request.damping) == (
            period_s,
            0.10,
            0.10,
            0.02,
        )
        assert request.cycles == cycles


def test_what_a_record_needs():
    times = {t.entry: (t.before_s, t.after_s) for t in TESTS if t.before_s or t.after_s}
    assert times == {
        "2.b.4": (5, 5),
        "2.b.5": (5, 5),
        "2.b.6": (5, 5),
        "2.c.1": (5, 15),
        "2.d.4": (0, 20),
    }
