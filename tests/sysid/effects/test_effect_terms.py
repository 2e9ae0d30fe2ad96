"""The language of coefficient terms, the catalogue, and a user's own effects."""

from __future__ import annotations

import numpy as np
import pytest

from sysid.effects.catalogue import (
    catalogue,
    coefficient_effect,
    parse,
    read_effects,
    subsystem_effects,
    words,
)
from sysid.errors import LogError


@pytest.mark.parametrize(
    ("text", "canonical", "name"),
    [
        ("p_hat*p_hat", "p_hat^2", "aero/Cm_p2"),
        ("beta*alpha", "alpha*beta", "aero/Cm_alpha_beta"),
        ("beta*abs(beta)", "abs(beta)*beta", "aero/Cm_absbeta_beta"),
        ("CT*de", "de*CT", "aero/Cm_de_CT"),
        ("1/h_over_b", "1/h_over_b", "aero/Cm_overh_over_b"),
        ("alphadot_hat", "alphadot_hat", "aero/Cm_alphadot"),
    ],
)
def test_a_term_has_one_form_and_a_legal_property(text, canonical, name):
    assert parse(text).text == canonical
    assert coefficient_effect("Cm", text).property_name == name


@pytest.mark.parametrize("text", ["gamma", "p_hat^", "alpha+beta", "", "alpha*1/alpha"])
def test_what_is_no_term_is_refused_with_what_is_allowed(text):
    with pytest.raises(ValueError, match=r"term '"):
        parse(text)


def test_values_of_terms():
    result = {
        "alpha": np.array([0.1, -0.2]),
        "beta": np.array([-0.3, 0.4]),
        "h_over_b": np.array([2.0, 4.0]),
    }
    assert parse("alpha^2").values(result) == pytest.approx([0.01, 0.04])
    assert parse("abs(beta)*beta").values(result) == pytest.approx([-0.09, 0.16])
    assert parse("1/h_over_b").values(result) == pytest.approx([0.5, 0.25])


def test_left_and_right_decide_the_penalty():
    assert not parse("p_hat^2").odd_lateral
    assert parse("alpha*beta").odd_lateral
    assert not parse("abs(beta)").odd_lateral
    assert (
        coefficient_effect("Cm", "p_hat^2").penalty
        < coefficient_effect("Cm", "alpha*p_hat").penalty
    )


def test_the_catalogue_is_complete_and_without_doubles():
    effects = [*catalogue(), *subsystem_effects(["elevator"], ["V_mps", "q_radps"], ["rates"])]
    assert len({e.key for e in effects}) == len(effects)
    assert {e.coefficient for e in effects if e.coefficient} == {"CX", "CY", "CZ", "Cl", "Cm", "Cn"}
    assert all(e.physics and e.name for e in effects)
    assert {(e.subsystem, e.term) for e in effects} >= {
        ("actuator.elevator", "lag"),
        ("sensor.rates", "delay"),
        ("mass", "Ixz"),
    }
    assert words("p_hat^2") == "roll rate squared"


def test_a_file_of_own_effects(tmp_path):
    path = tmp_path / "own.toml"
    path.write_text(
        '[[effect]]\ncoefficient = "Cm"\nterm = "CT*p_hat^2"\nphysics = "mine"\n', encoding="utf-8"
    )
    (effect,) = read_effects(path)
    assert (effect.key, effect.physics) == ("effect/Cm/p_hat^2*CT", "mine")


_OWN = '[[effect]]\ncoefficient = "Cm"\nterm = "p_hat^2"\n'


@pytest.mark.parametrize(
    ("text", "output"),
    [
        ('[[effect]]\ncoefficient = "Cm"\n', "needs coefficient and term"),
        ('[[effect]]\ncoefficient = "CQ"\nterm = "alpha"\n', "coefficient 'CQ'"),
        ('[[effect]]\ncoefficient = "Cm"\nterm = "x"\n', "is no factor"),
        ('[[effect]]\ncoefficient = "Cm"\nterm = "alpha"\nsize = 3\n', "unknown key 'size'"),
        ("a = 1\n", "needs tables"),
        (f'{_OWN}name = "a\\u0000b"\n', r"name has the control character '\\x00'"),
        (f'{_OWN}physics = "\\u001b[31mred"\n', r"physics has the control character '\\x1b'"),
        (f'{_OWN}regime = "{"x" * 2001}"\n', "regime has 2001 characters; allowed are 2000"),
        (f"{_OWN}sign = 3\n", "sign must be text"),
        (f"{_OWN}[[effect]]\ncoefficient = 'Cm'\nterm = 'p_hat*p_hat'\n", "is .*effect.* 1 too"),
    ],
)
def test_a_wrong_file_of_own_effects_is_refused(tmp_path, text, output):
    path = tmp_path / "own.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(LogError, match=output):
        read_effects(path)
