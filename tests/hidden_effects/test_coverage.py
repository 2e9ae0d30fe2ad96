"""The coverage of parameters: its marks can say no, and its draws are what they are called."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sysid.record import FlightRecord
from tests.hidden_effects.coverage import draw, marks, rows_of


def rows(count=1080, scale=1.0, shift=0.0, apart=0.0, seed=3):
    z = scale * np.random.default_rng(seed).standard_normal(count)
    return [
        {
            "draw": k // 27,
            "parameter": str(k % 27),
            "identify": v,
            "refine": v + shift,
            "apart": apart,
        }
        for k, v in enumerate(z)
    ]


def test_intervals_that_cover_and_commands_that_agree():
    reached, text = marks(rows(shift=0.05))
    assert reached, text
    assert "40 of 40 draws" in text


@pytest.mark.parametrize(
    "change", [{"scale": 1.4}, {"scale": 0.7}, {"shift": 0.2}, {"apart": 0.2}, {"apart": math.inf}]
)
def test_each_mark_says_no(change):
    reached, text = marks(rows(**change))
    assert not reached
    assert "MISSED" in text
    assert marks([])[0] is False


def test_in_turbulence_intervals_may_cover_a_little_less():
    z = rows(scale=1.13)
    assert not marks(z)[0]
    assert marks(z, light=True)[0]
    assert not marks(rows(scale=1.4), light=True)[0]


def test_a_draw_in_which_refine_names_something_counts_against_it():
    truth = {"Cm_q": -13.0}
    one = {"aero/Cm_q": (-12.9, 0.1)}
    good, none = (
        rows_of(1, truth, one, {"aero/Cm_q": (-12.9, 0.1)}, 0.0),
        rows_of(1, truth, one, {}, math.inf),
    )
    assert good[0]["identify"] == good[0]["refine"] == pytest.approx(1.0)
    assert math.isnan(none[0]["refine"])
    assert not marks([*rows(), *none])[0]
    assert marks([*rows(), *none], both=False)[0]


@pytest.mark.slow
def test_every_second_draw_has_servos_that_act_at_once(tmp_path, monkeypatch):
    from tests.hidden_effects import coverage
    from tests.hidden_effects.manoeuvres import card

    monkeypatch.setattr(
        coverage,
        "cards",
        lambda name, w20_kt, rate_hz: tuple(
            card(k, 22.0, seconds=11.0, rate_hz=rate_hz) for k in range(4)
        ),
    )
    truths = []
    for number, lags in ((1, 4), (2, 0)):
        airframe, aircraft, paths = draw(number, tmp_path)
        assert (aircraft / "espaaro.xml").read_text(encoding="utf-8").count("<lag>") == lags
        assert len(FlightRecord.read(paths[3])) == 550
        truths.append(airframe.coefficients)
    assert truths[0] != truths[1]
