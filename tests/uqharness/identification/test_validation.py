"""Bounds that hold on flights they have not seen, and those that do not."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from tests.helpers.model_forms import made_up_form
from uqharness.errors import BadInputError
from uqharness.identification.validation import HOLDS_FROM, failed, load_form, validate


def covered(**shares):
    return SimpleNamespace(coverage={name: SimpleNamespace(share={0.95: share, 0.5: 0.0}) for name, share in shares.items()})


def test_coefficients_that_contain_too_little_are_named():
    assert failed(covered(CX=0.95, CZ=HOLDS_FROM, Cm=HOLDS_FROM - 1e-9)) == ("Cm",)
    # A share that is not known does not hold.
    assert failed(covered(CX=float("nan"))) == ("CX",)
    assert failed(covered()) == ()


def test_bounds_of_another_aircraft_are_refused():
    with pytest.raises(BadInputError, match="belong to aircraft 'espaaro', not to 'other'"):
        validate(SimpleNamespace(name="other"), made_up_form(), [], (), [])


def test_a_form_is_read_and_a_bad_one_refused_by_name(tmp_path):
    form = made_up_form()
    form.write(tmp_path / "model-form.json")
    assert load_form(tmp_path / "model-form.json").to_json() == form.to_json()
    (tmp_path / "model-form.json").write_text("{}")
    with pytest.raises(BadInputError, match=r"model-form\.json.*is no model form"):
        load_form(tmp_path / "model-form.json")
