"""Where a fit by replays ended, as a point of the linearised flights, and the other way."""

from types import SimpleNamespace

import pytest

from uqharness.identification.linearised.flight_data import ModelState
from uqharness.identification.linearised.replay_fit import fit_start_values, point_of


def test_a_fit_is_sought_from_where_a_point_stands():
    """What `point_of` makes of a fit, the other way: biases lie before the sensor's gain."""
    nuisance = {
        "bias/f/p_radps": 0.03,
        "lateness/f/controls": 0.004,
        "delay/f/alpha_rad": 0.01,
        "unseen/f": 0.25,
    }
    point = ModelState({}, nuisance, (), {"effect/sensor.p_radps/scale": 0.5})
    begin = fit_start_values(point)
    assert begin == {
        "bias/f/p_radps": pytest.approx(0.02),
        "delay/f/controls": 0.004,
        "delay/f/alpha_rad": 0.01,
        "unseen/f": 0.25,
    }


def test_a_point_has_what_a_fit_found_and_nothing_of_what_it_did_not_estimate():
    values = {
        "aero/Cm_q": -10.0,
        "delay/f/controls": 0.03,
        "delay/f/alpha_rad": 0.04,
        "unseen/f": 0.5,
    }
    result = SimpleNamespace(values=lambda: values, starts=list)
    data = SimpleNamespace(nuisance=("bias/f/p_radps", "lateness/f/controls", "delay/f/alpha_rad"))
    point = point_of(result, data, ["aero/Cm_q"])
    assert point.values == {"aero/Cm_q": -10.0}
    assert point.nuisance == {
        "bias/f/p_radps": 0.0,
        "lateness/f/controls": 0.03,
        "delay/f/alpha_rad": 0.04,
        "unseen/f": 0.5,
    }
