"""Sentences about effects: numbers with the figures that their standard error leaves them."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from uqharness.refinement.showing import words
from uqharness.refinement.showing.document import moments_of, strong_of


@pytest.mark.parametrize(
    ("change", "std", "text"),
    [
        (64560.0, 479.9, "+64560 ± 480"), (12.345, 1.2345, "+12.35 ± 1.23"), (-30.0, 5.0, "-30.00 ± 5.00"),
        (123456.0, 98765.0, "+123500 ± 98800"), (0.01234, 0.00099, "+0.012340 ± 0.000990"), (4.0, 0.0, "+4 ± 0"),
    ],
)  # fmt: skip
def test_a_change_is_told_to_three_figures_of_its_standard_error(change, std, text):
    said = words.test_says({"test": {"gap": "shrank", "change_of_twice_log_likelihood": change, "std": std}})
    assert said == f"on the test flights the gap shrank: twice the log likelihood {text} with it"


def test_the_share_of_an_estimate_is_told_where_it_says_something():
    test = {"gap": "cannot tell", "change_of_twice_log_likelihood": -31.0, "std": 59.0, "share_of_estimate": 0.39}
    said = words.test_says({"withdrawn": True, "test": {**test, "share_std": 0.21}})
    assert said.endswith("with it, 0.39 ± 0.21 of the estimate fits them best; withdrawn beside what nothing explains")
    for vague in ({"share_std": 0.7}, {"share_std": None}, {"share_of_estimate": None, "share_std": None}):
        assert "fits them best" not in words.test_says({"test": {**test, **vague}})


@pytest.mark.parametrize(("gains", "told"), [((5.0, 99.0, np.nan), []), ((5.0, 400.0, 101.0), ["Cm", "Cn"])])
def test_moments_that_nothing_explains_are_told_by_their_axes(gains, told):
    air = SimpleNamespace(moments=np.array(gains))
    found = SimpleNamespace(gusts=air, setup=SimpleNamespace(outputs=("p_radps", "q_radps", "r_radps")))
    said = moments_of(found)
    assert [row["coefficient"] for row in said.values()] == told
    assert all(f"{row['twice_log_likelihood']:.0f}" in row["words"] for row in said.values())
    assert not moments_of(SimpleNamespace(gusts=None, setup=found.setup))


def test_of_the_nearest_candidates_those_are_told_that_are_strong_and_not_told_yet():
    near = [
        {"coefficient": "Cl", "term": "alpha^3", "t": 33.1},
        {"coefficient": "Cl", "term": "alpha*CT", "t": -31.2},
        {"subsystem": "propulsion", "term": "torque", "t": 9.0},
    ]
    assert strong_of(near, {"effect/Cl/alpha*CT"}) == [("effect/Cl/alpha^3", 33.1)]
    assert strong_of(near, set()) == [("effect/Cl/alpha^3", 33.1), ("effect/Cl/alpha*CT", -31.2)]
