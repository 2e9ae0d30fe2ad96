"""Bounds that hold on flights they have not seen, and those that do not."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from sysid.model_form import MIN_SHARE_INSIDE
from tests.helpers.model_forms import made_up_form
from uqharness.errors import BadInputError
from uqharness.identification.bounds import failed, load_form, validate, verdicts


def covered(error=0.01, **shares):
    rows = {
        c: SimpleNamespace(share={0.95: v, 0.5: 0.0}, error={0.95: error})
        for c, v in shares.items()
    }
    return SimpleNamespace(coverage=rows)


def test_coefficients_that_contain_too_little_are_named():
    assert failed(covered(CX=0.95, CZ=0.94, Cm=0.93)) == ("Cm",)
    assert verdicts(covered(CX=0.95, Cm=0.93)) == {"CX": "holds", "Cm": "fails"}
    # A short flight says neither, but where next to nothing lies inside.
    assert verdicts(covered(0.05, CX=0.93, Cm=MIN_SHARE_INSIDE - 1e-9)) == {
        "CX": "inconclusive",
        "Cm": "fails",
    }
    # A share that is not known does not hold.
    assert failed(covered(CX=float("nan"))) == ("CX",)
    assert failed(covered()) == ()


def test_bounds_of_another_aircraft_are_refused():
    with pytest.raises(BadInputError, match="belong to aircraft 'espaaro', not to 'other'"):
        validate(SimpleNamespace(name="other"), made_up_form(), [], (), [])


def test_a_log_slower_than_the_filter_is_refused_not_judged():
    form = made_up_form()
    rates = {"q_radps": 10.0, "V_mps": 5.0, "az_mps2": 50.0}
    record = SimpleNamespace(metadata=SimpleNamespace(native_hz=rates))
    flight, aircraft = SimpleNamespace(name="loiter", record=record), form.aircraft
    model = SimpleNamespace(name=aircraft.name, accelerometer_m=(0.0, 0.0, 0.0))
    with pytest.raises(BadInputError, match=r"loiter: q_radps were logged at 10 Hz.* need 15 Hz"):
        validate(model, form, [flight], (), [""])


def test_a_form_is_read_and_a_bad_one_refused_by_name(tmp_path):
    form = made_up_form()
    form.write(tmp_path / "model-form.json")
    assert load_form(tmp_path / "model-form.json").to_json() == form.to_json()
    (tmp_path / "model-form.json").write_text("{}")
    with pytest.raises(BadInputError, match=r"model-form\.json.*is no model form"):
        load_form(tmp_path / "model-form.json")
