"""What a flight would bring, with data whose worth is known."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from sysid.aerodynamics.residuals import Cutoffs, ResidualPiece, Residuals
from tests.helpers.model_forms import LONGITUDINAL, MEAN, SPREAD, made_up_form
from uqharness.next_flight.plan import designs_of, prospects, scatter_ratios, widths_over
from uqharness.next_flight.points import Occupancy

FORM = made_up_form({"CZ": LONGITUDINAL, "Cm": LONGITUDINAL})
MISSION = Occupancy(
    {name: np.full(20, MEAN.get(name, 0.0)) for name in LONGITUDINAL}, 1, 0, 2.0, "the mission"
)


def states(rng, n, speed=22.0):
    return {s: MEAN.get(s, 0.0) + SPREAD[s] * rng.standard_normal(n) for s in LONGITUDINAL} | {
        "V_mps": np.full(n, speed)
    }


def flown(n=2000, **more) -> Residuals:
    rng = np.random.default_rng(0)
    return Residuals(
        (ResidualPiece("m", 0.02 * np.arange(n), np.zeros((n, 6)), states(rng, n, **more)),),
        0.02,
        Cutoffs(),
    )


def trial(speed, power=-4.0, n=400):
    rng = np.random.default_rng(int(speed))
    delta = np.sqrt(speed**power) * rng.standard_normal((n, 6))
    return SimpleNamespace(states={"V_mps": np.full(n, speed)}, delta=delta)


STEADY = [trial(22.0)] * 4


def test_more_data_narrow_and_endless_data_narrow_most():
    few, many = (prospects(FORM, MISSION, flown(n), 0.2, STEADY) for n in (500, 20_000))
    for name in ("CZ", "Cm"):
        assert few[name].narrowing < many[name].narrowing <= many[name].at_most < 1.0
        assert few[name].parameter_narrowing < many[name].parameter_narrowing < 1.0
        assert many[name].current == widths_over(FORM, MISSION)[name]
        assert many[name].asymptotic.parameter == 0.0
    nothing = prospects(FORM, MISSION, flown(500), 0.0, STEADY)
    assert nothing["CZ"].parameter_narrowing == pytest.approx(0.0, abs=0.01)


def test_scatter_follows_the_speed_as_the_trials_do():
    trials = [trial(v) for v in np.linspace(16.0, 28.0, 40)]
    slow, fast = (scatter_ratios(FORM, flown(speed=v), trials)["CZ"] for v in (18.0, 26.0))
    assert slow / fast == pytest.approx((26.0 / 18.0) ** 4, rel=0.3)
    assert scatter_ratios(FORM, flown(speed=18.0), STEADY) == {"CZ": 1.0, "Cm": 1.0}
    # Bounds that do not know the speed cannot tell.
    blind = replace(
        FORM,
        coefficients={
            n: replace(b, states=("x", *b.states[1:])) for n, b in FORM.coefficients.items()
        },
    )
    assert scatter_ratios(blind, flown(speed=18.0), trials)["CZ"] == 1.0


def test_the_forms_own_terms():
    found = designs_of(FORM)
    assert {n: (d.states, d.terms) for n, d in found.items()} == {
        n: (b.states, b.terms) for n, b in FORM.coefficients.items()
    }
