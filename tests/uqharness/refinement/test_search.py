"""The search: which effects fly, what flies in their place, and which model stands."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from sysid.effects.catalogue import coefficient_effect, subsystem_effects
from sysid.effects.prediction import White
from sysid.effects.score import Evidence, gather, scores
from sysid.effects.selection import Choice, Selection
from uqharness.refinement import search as module
from uqharness.refinement.round import Round, Start
from uqharness.refinement.search import (
    comparable,
    likeliest,
    lone_among_times,
    search,
    without_weak,
)

KEYS = ("free", "thrust", "speed", "twin", "other")


AIR = SimpleNamespace(moments=np.zeros(3))


def told(own_part: float = 0.0) -> Evidence:
    """``speed`` is there, and a part of what is thrust's own; ``thrust`` resembles speed, ``twin``
    is thrust by another name.
    """
    rng = np.random.default_rng(6)
    free, speed, own, other = rng.standard_normal((4, 400, 2))
    thrust = speed + 0.3 * own
    columns = np.stack([free, thrust, speed, -2.0 * thrust, other], axis=2)
    residual = 2.0 * speed + own_part * own + rng.standard_normal((400, 2))
    white = White(
        residual,
        columns.astype(np.float32),
        0.0,
        np.zeros((8, 6)),
        np.ones((400, 2), dtype=bool),
        np.ones(2),
    )
    return gather([white], KEYS, [0], {})


@pytest.fixture
def evidence() -> Evidence:
    return told()


def test_comparable_candidates_explain_nearly_as_much_and_are_something_else(evidence):
    assert comparable(evidence, ["free"], KEYS[1:], "thrust") == ["speed"]
    assert comparable(evidence, ["free"], KEYS[1:], "speed") in (["thrust"], ["twin"])
    assert comparable(evidence, ["free"], ["thrust"], "thrust") == []
    assert (
        comparable(evidence, ["free"], KEYS[1:], "other") != []
    )  # nearly everything beats one that explains nothing


@pytest.mark.parametrize(("share", "found"), [(0.6, True), (1.2, False)])
def test_what_explains_half_as_much_is_comparable_and_what_explains_less_is_not(
    evidence, share, found
):
    lag, limit = "effect/actuator.aileron/lag", "effect/actuator.aileron/rate_limit"
    (white,) = evidence.white
    free, speed, noise = (white.columns[:, :, k] for k in (0, 2, 4))
    columns = np.stack([free, speed, speed + np.float32(share) * noise], axis=2)
    both = gather(
        [White(**{**vars(white), "columns": columns, "start": np.zeros((8, 4))})],
        ("free", lag, limit),
        [0],
        {},
    )
    shares = scores(both, ["free"], [lag, limit]).gain
    assert (shares[1] > 0.5 * shares[0]) == found
    assert comparable(both, ["free"], [lag, limit], lag) == [limit] * found


def started(merit: float = 1e4, gusts: object = None) -> Start:
    effects = [
        SimpleNamespace(key=k, unit="1", positive=False, odds=0.0, subsystem=None, term=k)
        for k in KEYS[1:]
    ]
    before = SimpleNamespace(
        columns=[SimpleNamespace(names=("free",))], trajectory=SimpleNamespace(point="plain")
    )
    setup = SimpleNamespace(segments=[SimpleNamespace(dt_s=0.02)], late={}, servos={})
    return Start(None, setup, before, (), {e.key: e for e in effects}, {}, 4.0, map, merit, gusts)  # type: ignore[arg-type]


def chosen(**t: float) -> Selection:
    return Selection(tuple(Choice(k, 1.0, 0.1, v, v * v, 1.0, 0.0) for k, v in t.items()))


def round_of(
    merit: float,
    standing: bool = False,
    gusts: object = None,
    again: Selection | None = None,
    **t: float,
) -> SimpleNamespace:
    flown = chosen(**t)
    return SimpleNamespace(
        merit=merit,
        standing=standing,
        gusts=gusts,
        selection=flown,
        keys=frozenset(t),
        evidence=told(),
        flown=dict.fromkeys(t, 1.0),
        again=again or flown,
        far={},
    )


class Flights:
    """Stands for `fly`: what is flown ends as said by its keys."""

    def __init__(self, **ends: SimpleNamespace | None) -> None:
        self.ends, self.asked = ends, list[list[str]]()

    def __call__(
        self, start: Start, selection: Selection, about: Round, folder: Path
    ) -> SimpleNamespace | None:
        keys = [c.key for c in selection.chosen]
        self.asked.append(keys)
        return self.ends["_".join(sorted(keys))]


def searched(
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    evidence: Evidence,
    flights: Flights,
    **start: float,
):
    monkeypatch.setattr(module, "fly", flights)
    begun = started(**start)
    return search(begun, evidence, tmp_path, lambda _: None)


def test_a_model_that_proposes_itself_ends_the_search(monkeypatch, tmp_path, evidence):
    flights = Flights(speed=round_of(100.0, True, speed=50.0))
    found = searched(monkeypatch, tmp_path, evidence, flights)
    assert flights.asked == [["speed"]]
    assert found.best.keys == {"speed"}


def test_what_asks_for_several_more_is_doubted(monkeypatch, tmp_path):
    """``thrust`` seems to be there, and leaves three more to be asked for; ``speed``, which it
    resembles, leaves nothing.
    """
    evidence = told(own_part=0.5)
    more = chosen(thrust=50.0, other=9.0, twin=8.0, speed=7.0)
    flights = Flights(
        thrust=round_of(300.0, again=more, thrust=50.0), speed=round_of(100.0, True, speed=50.0)
    )
    found = searched(monkeypatch, tmp_path, evidence, flights)
    assert flights.asked == [["thrust"], ["speed"]]
    assert found.best.keys == {"speed"}
    assert any("speed flies better than thrust" in line for line in found.trail)
    # Where it flies no better, what was asked for follows.
    flights = Flights(
        thrust=round_of(300.0, again=more, thrust=50.0),
        speed=round_of(400.0, True, speed=50.0),
        other_speed_thrust_twin=round_of(90.0, True, thrust=50.0, other=9.0, twin=8.0, speed=7.0),
    )
    found = searched(monkeypatch, tmp_path, evidence, flights)
    assert len(found.best.keys) == 4
    # Two more are two more.
    few = chosen(thrust=50.0, other=9.0, twin=8.0)
    flights = Flights(
        thrust=round_of(300.0, again=few, thrust=50.0),
        other_thrust_twin=round_of(90.0, True, thrust=50.0, other=9.0, twin=8.0),
    )
    found = searched(monkeypatch, tmp_path, evidence, flights)
    assert flights.asked == [["thrust"], ["thrust", "other", "twin"]]


@pytest.mark.parametrize("t", [50.0, 8.4])
@pytest.mark.parametrize(
    ("moments", "asked"), [(6000.0, [["thrust"], ["speed"]]), (90.0, [["thrust"]])]
)
def test_what_leaves_moments_that_nothing_explains_is_doubted(
    monkeypatch, tmp_path, moments, asked, t
):
    """A servo's rate limit stands for its lag, asks for nothing more, and yaw moves as by moments
    from nowhere.
    """
    gusts = SimpleNamespace(moments=np.array([np.nan, 0.0, moments]))
    flights = Flights(
        thrust=round_of(300.0, True, gusts=gusts, thrust=t),
        speed=round_of(100.0, True, gusts=gusts, speed=50.0),
    )
    searched(monkeypatch, tmp_path, told(own_part=0.5), flights)
    assert flights.asked == asked


def test_a_choice_that_goes_to_and_fro_ends_at_the_better_of_the_two(
    monkeypatch, tmp_path, evidence
):
    flights = Flights(
        speed=round_of(120.0, again=chosen(thrust=9.0), speed=50.0),
        thrust=round_of(110.0, again=chosen(speed=9.0), thrust=50.0),
    )
    found = searched(monkeypatch, tmp_path, evidence, flights)
    assert flights.asked == [["speed"], ["thrust"]]
    assert found.best.keys == {"thrust"}
    assert "not one that stands" in found.trail[-1]


@pytest.mark.parametrize(
    ("merit", "gusts", "kept"),
    [(100.0, None, True), (10_000.0, None, False), (10_000.0, AIR, False)],
)
def test_effects_that_do_not_earn_their_place_are_none(
    monkeypatch, tmp_path, evidence, merit, gusts, kept
):
    flights = Flights(speed=round_of(merit, True, gusts, speed=50.0))
    found = searched(monkeypatch, tmp_path, evidence, flights, merit=5000.0)
    assert found.best.keys == ({"speed"} if kept else set())
    if not kept:
        assert (found.best.flown, found.best.merit, found.best.evidence) == ({}, 5000.0, evidence)
        assert [c.key for c in found.best.again.chosen] == ["speed"]
    assert any("must earn" in line for line in found.trail) is not kept


def test_where_no_filter_follows_what_was_flown_before_stands(monkeypatch, tmp_path, evidence):
    flights = Flights(speed=round_of(100.0, again=chosen(thrust=9.0), speed=50.0), thrust=None)
    found = searched(monkeypatch, tmp_path, evidence, flights)
    assert found.best.keys == {"speed"}
    assert (
        searched(monkeypatch, tmp_path, evidence, Flights(speed=None, thrust=None)).best.keys
        == set()
    )


def test_where_no_filter_follows_what_explains_as_much_flies(monkeypatch, tmp_path, evidence):
    """An airspeed sensor 40 % off in turbulence: thrust explains most at first, and flies away."""
    flights = Flights(speed=None, thrust=round_of(100.0, True, thrust=50.0))
    found = searched(monkeypatch, tmp_path, evidence, flights)
    assert flights.asked == [["speed"], ["thrust"]]
    assert found.best.keys == {"thrust"}
    assert any("thrust flies better than speed" in line for line in found.trail)


def flown(merit: float, *keys: str, gusts: object = AIR) -> SimpleNamespace:
    return SimpleNamespace(merit=merit, keys=frozenset(keys), gusts=gusts)


def test_of_rounds_in_gusts_the_likeliest_stands_and_not_the_last():
    first, second, third = (
        flown(-640.0, "effect/Cn/de"),
        flown(-630.0, "effect/Cn/de", "effect/Cm/V_rel"),
        flown(-650.0),
    )
    assert likeliest([first, second]) is first  # type: ignore[list-item]
    assert likeliest([first, second, third]) is third  # type: ignore[list-item]


def test_rounds_that_judge_other_samples_are_not_compared():
    """A late sensor's first samples are before the flight's first row: there are fewer to be
    surprised by.
    """
    first, late = flown(-640.0), flown(-600.0, "effect/sensor.alpha_rad/delay")
    assert likeliest([first, late]) is late  # type: ignore[list-item]
    better = flown(-610.0, "effect/sensor.alpha_rad/delay", "effect/Cm/V_rel")
    assert likeliest([first, better, late]) is better  # type: ignore[list-item]
    calm = [flown(-640.0, gusts=None), flown(-600.0, "effect/sensor.alpha_rad/delay", gusts=None)]
    assert likeliest(calm) is calm[0]  # type: ignore[arg-type]


def test_what_says_nothing_once_it_flies_is_left_out(tmp_path):
    """Cm is there; a rate of alpha beside it is there only while it does not fly."""
    asked: list[list[str]] = []

    def fly(selection: Selection, about: object, folder: Path) -> SimpleNamespace:
        asked.append([c.key for c in selection.chosen])
        return round_of(101.0, Cm=-8.0)

    bare, both, alone = (
        round_of(200.0),
        round_of(90.0, Cm=-8.0, alphadot=1.7),
        round_of(100.0, Cm=-8.1),
    )
    found, lines = without_weak(both, bare, [both, alone], 4.0, fly, tmp_path)  # type: ignore
    assert found is alone
    assert "alphadot" in lines[0]
    assert not asked
    found, _ = without_weak(both, bare, [both], 4.0, fly, tmp_path)  # type: ignore
    assert found is not None
    assert found.merit == 101.0
    assert asked == [["Cm"]]
    for best in (
        round_of(90.0, Cm=-8.0, alphadot=5.0),
        round_of(90.0, True, Cm=-8.0, alphadot=1.7),
        round_of(90.0, Cm=3.5),
        bare,
    ):
        assert without_weak(best, bare, [], 4.0, fly, tmp_path) == (best, [])  # type: ignore
    assert without_weak(both, bare, [both], 4.0, lambda *_: None, tmp_path) == (both, [])  # type: ignore


@pytest.mark.parametrize("gusts", [None, AIR])
@pytest.mark.parametrize("standing", [False, True])
def test_nothing_that_says_something_once_it_flies_is_no_effect(tmp_path, standing, gusts):
    """Chance: |t| 4.5 on the linearised flight, 2.7 once it flies."""
    bare, (best, kept) = (
        round_of(95.0),
        (round_of(90.0, standing, gusts, alphadot=t) for t in (2.7, 3.1)),
    )
    found = without_weak(best, bare, [best], 4.0, lambda *_: None, tmp_path)  # type: ignore[arg-type]
    assert found == (bare, ["flown, alphadot has |t| 2.7: no effect"])
    assert without_weak(kept, bare, [kept], 4.0, lambda *_: None, tmp_path) == (kept, [])  # type: ignore[arg-type]


LONE = {
    e.key: e
    for e in (
        *subsystem_effects(
            ["aileron"], ["p_radps", "alpha_rad"], ["rates", "alpha_rad"], ["p_radps", "phi_rad"]
        ),
        coefficient_effect("Cm", "p_hat^2"),
    )
}


@pytest.mark.parametrize(
    ("keys", "doubted"),
    [
        (["sensor.p_radps/delay", "actuator.aileron/lag"], True),
        (["sensor.p_radps/delay", "sensor.phi_rad/delay"], True),
        (["sensor.p_radps/delay", "sensor.alpha_rad/delay"], True),
        (["actuator.aileron/deadband", "sensor.phi_rad/delay"], True),
        ([], False),
        (["sensor.p_radps/delay"], False),
        (["sensor.p_radps/delay", "Cm/p_hat^2"], False),
        (["sensor.rates/delay", "actuator.aileron/lag"], False),
        (["sensor.p_radps/scale", "actuator.aileron/lag"], False),
    ],
)
def test_one_channel_late_by_itself_is_not_believed_beside_another_time(keys, doubted):
    some = [Choice(f"effect/{k}", 1.0, 0.1, 10.0, 100.0, 30.0, 0.0) for k in keys]
    assert bool(lone_among_times(some, LONE)) is doubted


@pytest.mark.parametrize(("merit", "believed"), [(90.0, False), (151.0, True), (None, True)])
def test_then_the_search_is_made_without_such_delays(
    monkeypatch, tmp_path, evidence, merit, believed
):
    """Which stands unless it is less likely than with the delay by a hundred in twice the log
    likelihood.
    """
    (white,) = evidence.white
    names = ("free", "effect/actuator.aileron/lag", "effect/sensor.p_radps/delay", "twin", "other")
    renamed = gather([white], names, [0], {})
    start = started()
    effects = {k: LONE[k] for k in names[1:3]}
    both = {names[1]: 50.0, names[2]: 40.0}
    alone = None if merit is None else round_of(merit, True, **{names[1]: 50.0})
    ends = {"_".join(sorted(both)): round_of(50.0, True, **both), names[1]: alone}
    flights = Flights(
        **{**ends, names[2]: round_of(100.0, again=chosen(**both), **{names[2]: 40.0})}
    )
    monkeypatch.setattr(module, "fly", flights)
    object.__setattr__(start, "effects", effects)
    found = search(start, renamed, tmp_path, lambda _: None)
    assert found.best.keys == (set(both) if believed else {names[1]})
    if believed:
        assert not found.notes
        return
    assert "late by itself was not believed" in found.notes[0]
    assert "p_radps" in found.notes[0]
