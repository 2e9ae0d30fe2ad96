"""Which of several causes in turbulence flies best: rivals in an effect's place, companions beside it, numbers read once."""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

from sysid.effects.prediction import White
from sysid.effects.score import Evidence, gather, scores
from sysid.effects.selection import Choice, Selection
from uqharness.refinement.contest import many_asked, rivals, winner
from uqharness.refinement.rivals import at_value, companion
from uqharness.refinement.round import Start

KEYS = ("free", "thrust", "speed", "twin", "other")


@pytest.fixture
def evidence() -> Evidence:
    """``speed`` is there; ``thrust`` resembles it, ``twin`` is thrust by another name."""
    rng = np.random.default_rng(6)
    free, speed, own, other = rng.standard_normal((4, 400, 2))
    thrust = speed + 0.3 * own
    columns = np.stack([free, thrust, speed, -2.0 * thrust, other], axis=2)
    white = White(
        2.0 * speed + 0.5 * own + rng.standard_normal((400, 2)), columns.astype(np.float32), 0.0, np.zeros((8, 6)),
        np.ones((400, 2), dtype=bool), np.ones(2), np.zeros((400, 13)),
    )  # fmt: skip
    return gather([white], KEYS, ["one"], {})


def test_rivals_explain_nearly_as_much_and_are_something_else(evidence):
    odds = dict.fromkeys(KEYS[1:], 0.0)
    assert rivals(evidence, ["free"], odds, "thrust") == ["speed"]
    assert rivals(evidence, ["free"], odds, "speed") in (["thrust"], ["twin"])
    assert rivals(evidence, ["free"], {"thrust": 0.0}, "thrust") == []
    assert rivals(evidence, ["free"], odds, "other") != []  # nearly everything beats one that explains nothing


def test_the_rival_that_flies_likeliest_wins_by_a_margin():
    surprise = {"a": 120.0, "b": 90.0, "c": 95.0}

    def alone(key: str) -> Choice:
        return Choice(key, 1.0, 0.1, 10.0, 100.0, 1.0, 0.0)

    def found(to_beat: float, margin: float = 20.0) -> str | None:
        choice = winner(list(surprise), alone, lambda c: surprise[c.key], to_beat, margin)
        return choice and choice.key

    assert found(150.0) == "b"
    assert found(105.0) is None
    assert found(105.0, 10.0) == "b"
    assert winner([], alone, lambda c: 0.0, 150.0, 1.0) is None


@pytest.mark.parametrize(("share", "rival"), [(0.6, True), (1.2, False)])
def test_what_explains_half_as_much_is_a_rival_and_what_explains_less_is_not(evidence, share, rival):
    lag, limit = "effect/actuator.aileron/lag", "effect/actuator.aileron/rate_limit"
    (white,) = evidence.white
    free, speed, noise = (white.columns[:, :, k] for k in (0, 2, 4))

    def found(second: str) -> list[str]:
        columns = np.stack([free, speed, speed + np.float32(share) * noise], axis=2)
        told = gather([replace(white, columns=columns, start=np.zeros((8, 4)))], ("free", lag, second), ["one"], {})
        shares = scores(told, ["free"], [lag, second]).gain
        assert (shares[1] > 0.5 * shares[0]) == rival
        return rivals(told, ["free"], {lag: 0.0, second: 0.0}, lag)

    assert found(limit) == [limit] * rival


def held_flights(wanted, told=0.01, likeliest=0.5):
    """Stands for `_predicted`: what JSBSim reads once; flights want ``wanted`` of the way from its value to the likeliest."""
    flown = []

    def predicted(start, selection, about, folder):
        (choice,) = selection.chosen
        flown.append(choice.value)
        if choice.value < 0.0:
            raise np.linalg.LinAlgError("Matrix is not positive definite")
        following = choice.value + wanted * (likeliest - choice.value)
        rng = np.random.default_rng(2)
        column = rng.standard_normal((400, 2))
        noise = rng.standard_normal((400, 2))
        noise -= column * np.sum(column * noise) / np.sum(column**2)
        white = White(
            (following - choice.value) * column / told + noise, (column / told)[:, :, None].astype(np.float32), 0.0,
            np.zeros((8, 2)), np.ones((400, 2), dtype=bool), np.ones(2), np.zeros((400, 13)),
        )  # fmt: skip
        fit = SimpleNamespace(evidence=gather([white], (choice.key,), ["one"], {}))
        held = [] if choice.key.endswith("free") else [choice.key]
        return SimpleNamespace(surprise=1000.0 * abs(choice.value - likeliest), fit=fit, setup=SimpleNamespace(held=held))

    return flown, predicted


def test_what_is_read_once_flies_until_its_number_stands(tmp_path):
    start = SimpleNamespace(before=SimpleNamespace(columns=[SimpleNamespace(names=())]), confirming=np.zeros(1, dtype=bool))
    first = Choice("effect/actuator.aileron/lag", 0.1, 0.01, 20.0, 400.0, 1.0, 0.0)
    flown, predicted = held_flights(wanted=0.8)
    best, surprise = at_value(start, first, None, tmp_path, predicted)  # type: ignore[arg-type]
    np.testing.assert_allclose(flown, [0.1, 0.42, 0.5], rtol=1e-3)
    assert (best.value, surprise) == (pytest.approx(0.5, rel=1e-3), pytest.approx(0.0, abs=0.1))
    # Where each flight tells a fifteenth of what is left, eight of them get there all the same.
    flown, predicted = held_flights(wanted=1.0 / 15.0)
    best, surprise = at_value(start, first, None, tmp_path, predicted)  # type: ignore[arg-type]
    assert best.value == pytest.approx(0.5, rel=1e-2)
    flown, predicted = held_flights(wanted=0.8)
    best, _ = at_value(start, replace(first, value=0.4999), None, tmp_path, predicted)  # type: ignore[arg-type]
    assert len(flown) == 1
    free = replace(first, key="effect/free")
    assert at_value(start, free, None, tmp_path, predicted)[0] is free  # type: ignore[arg-type]
    assert len(flown) == 2
    assert at_value(start, replace(first, value=-1.0), None, tmp_path, predicted)[1] == np.inf  # type: ignore[arg-type]


@dataclass(frozen=True)
class Noisy:
    noise: float
    held: tuple[str, ...] = ()


def flown_beside(t_of_new):
    """A round that flew ``first`` and asks for others with such t."""
    again = tuple(Choice(k, 1.0, 0.1, t, t * t, 1.0, 0.0) for k, t in {"first": 50.0, **t_of_new}.items())
    return many_asked({"first"}, again)


def test_many_effects_asked_for_at_once_are_doubted():
    many = {"a": -56.0, "b": 22.0, "c": 8.0}
    asked = flown_beside(many)
    assert asked is not None
    assert asked.key == "a"
    assert flown_beside({"a": 56.0, "b": 22.0}) is None
    assert flown_beside({"a": 14.0, "b": 12.0, "c": 8.0}) is None
    assert flown_beside({}) is None


@pytest.mark.parametrize(("surprises", "best"), [((300.0, 100.0), "speed"), ((100.0, 300.0), "thrust"), ((np.nan, np.nan), None)])
def test_of_many_asked_for_the_likeliest_by_itself_flies_beside_what_flew(evidence, tmp_path, surprises, best):
    """``thrust`` is asked for with two more; ``speed``, of which it has a part, explains them as well."""
    flown = {}

    def predicted(start, selection, about, folder):
        (key,) = {c.key for c in selection.chosen} - {"other"}
        flown[key] = (start.gusts, folder)
        surprise = dict(zip(("thrust", "speed"), surprises, strict=True))[key]
        if np.isnan(surprise):
            raise np.linalg.LinAlgError
        return SimpleNamespace(surprise=surprise)

    start = Start(
        None, Noisy(1.0), SimpleNamespace(columns=[SimpleNamespace(names=("free",))]), (), (), {},
        np.zeros(1, dtype=bool), 4.0, (), (), map, "air before", {},
    )  # type: ignore[arg-type]  # fmt: skip
    again = [Choice(k, 1.0, 0.1, t, t * t, 1.0, 0.0) for k, t in {"other": 20.0, "thrust": 50.0, "x": 9.0, "y": 9.0}.items()]
    now = SimpleNamespace(
        keys=frozenset({"other"}), again=Selection(tuple(again)), about=SimpleNamespace(evidence=evidence), gusts="its air",
        setup=Noisy(2.0),
    )  # fmt: skip
    got = companion(start, now, {"thrust": 0.0, "speed": 0.0}, tmp_path, lambda _: None, predicted)  # type: ignore[arg-type]
    assert {c.key for c in got.chosen} - {"other"} == {best} if best else got is None
    assert set(flown) == {"thrust", "speed"}
    assert {air for air, _ in flown.values()} == {"its air"}
    assert len({folder for _, folder in flown.values()}) == 2
    few = SimpleNamespace(**{**vars(now), "again": Selection(tuple(again[:3]))})
    assert companion(start, few, {"thrust": 0.0, "speed": 0.0}, tmp_path, lambda _: None, predicted) is None  # type: ignore[arg-type]
