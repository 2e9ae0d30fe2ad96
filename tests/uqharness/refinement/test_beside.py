"""What is named beside something that nothing explains, and what flights leave."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import lfilter

from sysid.effects.selection import Choice, Selection
from uqharness.refinement import unnamed as refine_beside
from uqharness.refinement.evaluation import Left, left_in
from uqharness.refinement.round import Bent
from uqharness.refinement.unnamed import named_beside, too_weak

LIMIT = 4.0


def chosen(**t):
    return tuple(Choice(k, v / 10.0, 0.1, v, v * v, 30.0, 0.0) for k, v in t.items())


@pytest.mark.parametrize(
    ("t", "weak"),
    [
        ({}, []),
        ({"a": 5.0}, ["a"]),
        ({"a": -5.9}, ["a"]),
        ({"a": 6.9}, ["a"]),
        ({"a": 7.1}, []),
        ({"a": 28.0, "b": 8.5, "c": -7.1}, ["b", "c"]),
        ({"a": -28.0, "b": -14.0}, []),
        ({"a": 142.0, "b": -29.0}, []),
        ({"a": 142.0, "b": 14.0}, ["b"]),
        ({"a": 8.0, "b": 5.0}, ["b"]),
    ],
)
def test_what_is_too_weak(t, weak):
    assert [c.key for c in too_weak(chosen(**t), LIMIT)] == weak


def test_an_effect_that_is_no_number_is_too_weak():
    assert too_weak(chosen(a=float("nan"), b=30.0), LIMIT)[0].key == "a"


def shown(residual):
    noise = np.array([0.1, 0.2])
    rms = [
        float(np.sqrt(np.mean(np.concatenate([r[:, k] for r in residual]) ** 2))) for k in (0, 1)
    ]
    return SimpleNamespace(residual=residual, noise=noise, channel_rms=lambda k: rms[k])


def white(factor=1.0):
    rng = np.random.default_rng(3)
    return [np.array([0.1, 0.2]) * factor * rng.normal(size=(1000, 2)) for _ in range(2)]


SETUP = SimpleNamespace(outputs=("q_radps", "az_mps2"))


def test_noise_leaves_nothing():
    left = left_in(SETUP, shown(white()), gusty=False)
    assert not left
    assert left == Left({}, ())


def test_a_channel_above_its_noise_is_left_in_any_air():
    residual = [r * [1.0, 1.3] for r in white()]
    for gusty in (False, True):
        left = left_in(SETUP, shown(residual), gusty)
        assert left
        assert left.above == {"az_mps2": pytest.approx(1.3, rel=0.03)}


def test_colour_counts_in_calm_air_alone():
    residual = [
        lfilter([0.8], [1.0, -0.6], r, axis=0) * [1.0, 0.0] + r * [0.0, 1.0] for r in white()
    ]
    assert left_in(SETUP, shown(residual), gusty=False) == Left({}, ("q_radps",))
    assert not left_in(SETUP, shown(residual), gusty=True)


@dataclass(frozen=True)
class Found:
    selection: Selection
    limit: float = LIMIT
    gusty: bool = False
    trail: tuple[str, ...] = ("first",)
    unnamed: tuple[Choice, ...] = ()
    bent: Bent | None = None
    after: SimpleNamespace = field(
        default_factory=lambda: SimpleNamespace(trajectory=SimpleNamespace(point=None))
    )


@pytest.fixture
def flown(monkeypatch):
    """The models flown by `named_beside`, whose train flights leave what they are told to."""
    models = []

    def asked(found, residual):
        side = SimpleNamespace(setup=SETUP, air=None)
        monkeypatch.setattr(
            refine_beside, "show", lambda aircraft, *_: models.append(aircraft) or shown(residual)
        )
        return named_beside(found, side, found.selection.chosen, map)

    def left_out(found, evidence, keys):
        kept = tuple(replace(c, t=1.1 * c.t) for c in found.selection.chosen if c.key not in keys)
        return replace(found, selection=replace(found.selection, chosen=kept))

    monkeypatch.setattr(refine_beside, "bent", lambda found: None)
    monkeypatch.setattr(refine_beside, "left_out", left_out)
    monkeypatch.setattr(refine_beside, "evidence_of", lambda found: None)
    monkeypatch.setattr(refine_beside, "written_at", lambda *_: None)
    monkeypatch.setattr(refine_beside, "property_values", lambda *_: {})
    return asked, models


def test_weak_ones_go_where_flights_stay_unexplained(flown):
    ask, models = flown
    found = Found(Selection(chosen(a=28.0, b=8.5, c=-7.1)))
    got = ask(found, white(1.3))
    assert [(c.key, c.t) for c in got.selection.chosen] == [("a", pytest.approx(30.8))]
    assert [(c.key, c.t) for c in got.unnamed] == [("b", 8.5), ("c", -7.1)]
    assert got.trail == (
        "first",
        "too weak beside what is unexplained: - b t 8.5",
        "too weak beside what is unexplained: - c t -7.1",
    )
    assert models == [found.selection.chosen]


FORM = Bent("CY", ("p_hat",), "smooth term of roll rate in side force", 1258.0, 1e-200, ("a", "b"))


@pytest.mark.parametrize(
    ("beside", "unnamed"),
    [
        # Half the strongest is asked, at most 15: of those that the curve can be, as they are; of
        # others, beside the curve.
        ({"c": 8.2, "d": 3.7}, ["b", "c", "d"]),
        ({"c": 15.5, "d": -13.0}, ["b", "d"]),
        ({"c": 20.0, "d": -15.5}, ["b"]),
    ],
)
def test_beside_a_curve_others_are_as_strong_as_it_leaves_them(flown, monkeypatch, beside, unnamed):
    ask, models = flown
    monkeypatch.setattr(refine_beside, "bent", lambda found: (FORM, chosen(**beside)))
    got = ask(Found(Selection(chosen(a=-30.0, b=4.5, c=22.0, d=16.0))), white())
    assert [c.key for c in got.unnamed] == unnamed
    assert {c.key for c in got.selection.chosen} == {"a", "b", "c", "d"} - {*unnamed}
    assert got.bent is FORM
    assert models == []


def test_they_stay_where_nothing_is_left(flown):
    ask, models = flown
    found = Found(Selection(chosen(a=28.0, b=8.5)))
    assert ask(found, white()) is found
    assert len(models) == 1


def test_nothing_is_flown_where_none_is_weak(flown):
    ask, models = flown
    found = Found(Selection(chosen(a=142.0, b=-29.0)))
    assert ask(found, white(1.3)) is found
    assert models == []
