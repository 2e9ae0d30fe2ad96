"""Which candidates are worth scoring: what a replay, or a log's rows, cannot resolve is left out."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from sysid.effects.prediction import White
from sysid.effects.score import gather
from sysid.effects.selection import Choice, Selection
from sysid.effects.subsystem_effects import subsystem_effects
from uqharness.refinement.rivals import at_values, far_off, without_weak
from uqharness.refinement.rounds import eligible, first_at_values, largest_step, likeliest, resolved
from uqharness.simulator.actuators import Actuator

DT = 0.02
EFFECTS = [e for e in subsystem_effects(["aileron"], [], []) if e.term in ("lag", "rate_limit")]


def at(value: float, late: dict[str, list[str]], servos=None) -> dict[str, float]:
    """Eligible effects where every one of them is estimated at ``value`` exactly; a doublet of 10 deg."""
    rng = np.random.default_rng(1)
    columns = rng.standard_normal((50, 2, len(EFFECTS)))
    residual = value * columns.sum(axis=2)
    white = White(
        residual, columns.astype(np.float32), 0.0, np.zeros((8, 1 + len(EFFECTS))), np.ones((50, 2), dtype=bool),
        np.ones(2), np.zeros((50, 11)),
    )  # fmt: skip
    evidence = gather([white], [e.key for e in EFFECTS], ["one"], {})
    controls = np.zeros((50, 4))
    controls[10:20, 1], controls[20:30, 1] = 10.0, -10.0
    setup = SimpleNamespace(segments=[SimpleNamespace(dt_s=DT, controls=controls)], late=late, servos=servos or {})
    fit = SimpleNamespace(columns=[SimpleNamespace(names=())])
    return eligible(EFFECTS, setup, fit, evidence)  # type: ignore[arg-type]


def test_the_largest_step_is_half_the_commands_range():
    controls = np.array([[0.0, -8.0, 0.0, 50.0], [0.0, 8.0, 0.0, 60.0]])
    setup = SimpleNamespace(segments=[SimpleNamespace(dt_s=DT, controls=controls)])
    assert largest_step(setup, EFFECTS[0]) == 8.0  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("value", "late", "terms"),
    [
        (5e-5, {}, set()),  # 0.5 ms over the doublet, 0.05 ms of lag: below 0.03 rows of 20 ms
        (2e-4, {}, {"rate_limit"}),  # 2 ms over the doublet
        (5e-3, {}, {"rate_limit", "lag"}),
        (5e-4, {"one": ["gyro"]}, set()),  # in a log half a row is not known
        (2e-3, {"one": ["gyro"]}, {"rate_limit"}),
        (2e-2, {"one": ["gyro"]}, {"rate_limit", "lag"}),
        (-2e-2, {}, set()),  # no servo is faster than its command
    ],
)
def test_what_the_rows_do_not_resolve_is_no_candidate(value, late, terms):
    assert {k.rpartition("/")[2] for k in at(value, late)} == terms


def test_a_servo_may_be_faster_than_its_xml_has_it_if_that_has_a_lag():
    assert {k.rpartition("/")[2] for k in at(-2e-2, {}, {"aileron": Actuator(25.0)})} == {"lag"}
    assert at(-2e-2, {}, {"aileron": Actuator(None)}) == {}
    assert at(-2e-2, {}, {"rudder": Actuator(25.0)}) == {}


def test_a_time_below_what_rows_resolve_is_no_effect_though_it_was_flown():
    rng = np.random.default_rng(2)
    keys = ["effect/sensor.rates/delay", "effect/Cm/p_hat^2"]
    columns = rng.standard_normal((200, 2, 3))
    white = White(
        columns @ np.array([0.4, 1.0, 1.0]), columns.astype(np.float32), 0.0, np.zeros((8, 4)), np.ones((200, 2), dtype=bool),
        np.ones(2), np.zeros((200, 11)),
    )  # fmt: skip
    evidence = gather([white], ["aero/Cm_q", *keys], ["one"], {})
    setup = SimpleNamespace(segments=[SimpleNamespace(dt_s=DT)], late={}, servos={})
    units = zip(keys, ("s", "1"), strict=True)
    effects = [SimpleNamespace(key=k, unit=u, positive=False, odds=0.0) for k, u in units]
    start = SimpleNamespace(setup=setup, effects=effects, confirming=np.zeros(1, dtype=bool))

    def kept(late_s: float) -> list[str]:
        chosen = tuple(Choice(k, v, 1e-5, 9.0, 81.0, 1.0, 0.0) for k, v in zip(keys, (late_s, 1.0), strict=True))
        fit = SimpleNamespace(columns=[SimpleNamespace(names=("aero/Cm_q", *keys))])
        found = SimpleNamespace(selection=Selection(chosen), fit=fit, evidence=evidence, keys=frozenset(keys))
        return [c.key for c in resolved(start, found).chosen]  # type: ignore[arg-type]

    assert kept(0.0008) == keys
    assert kept(0.0005) == keys[1:]
    assert kept(-0.0005) == keys[1:]


@pytest.mark.parametrize(("alike", "positive", "beside"), [(0.02, False, True), (0.02, True, False), (3.0, False, False)])
def test_a_time_too_short_to_be_named_stands_beside_the_effect_that_it_may_be(alike, positive, beside):
    rng = np.random.default_rng(4)
    term, delay = "effect/CZ/alphadot_hat", "effect/actuator.elevator/lag"
    columns = rng.standard_normal((200, 2, 2))
    columns[:, :, 1] = -1000.0 * (columns[:, :, 0] + alike * columns[:, :, 1])  # -1 ms of it does what 1 of the term does
    white = White(
        columns[:, :, 0] + 0.1 * rng.standard_normal((200, 2)), columns.astype(np.float32), 0.0, np.zeros((8, 3)),
        np.ones((200, 2), dtype=bool), np.ones(2), np.zeros((200, 11)),
    )  # fmt: skip
    evidence = gather([white], [term, delay], ["one"], {})
    start = SimpleNamespace(
        setup=SimpleNamespace(segments=[SimpleNamespace(dt_s=DT)], late={}, servos={}), confirming=np.zeros(1, dtype=bool),
        effects=[
            SimpleNamespace(key=k, unit=u, positive=positive, odds=0.0, subsystem=of, term=k.rpartition("/")[2])
            for k, u, of in ((term, "1", None), (delay, "s", "actuator.elevator"))
        ],
    )  # fmt: skip
    fit = SimpleNamespace(columns=[SimpleNamespace(names=(term,))])
    chosen = (Choice(term, 1.0, 0.05, 20.0, 400.0, 1.0, 0.0),)
    found = SimpleNamespace(selection=Selection(chosen), fit=fit, evidence=evidence, keys=frozenset([term]))
    (effect,) = resolved(start, found).chosen  # type: ignore[arg-type]
    assert effect.key == term
    assert [a.key for a in effect.alternatives if not a.separable] == ([delay] if beside else [])


@pytest.mark.parametrize(("flown_s", "following"), [(0.0626, ["lag", "scale"]), (0.0622, ["lag", "scale"]), (0.0454, ["lag"])])
def test_a_lag_flies_at_its_value_before_others_stand_beside_it(flown_s, following):
    lag, other = (Choice(k, v, 2e-4, 9.0, 81.0, 1.0, 0.0) for k, v in (("lag", 0.0626), ("scale", 0.1)))
    found = first_at_values(Selection((lag, other)), [lag], far_off([lag], {"lag": flown_s}))
    assert [c.key for c in found.chosen] == following
    assert bool(found.trail) is (following == ["lag"])


def test_calm_rounds_fly_again_until_a_lag_stands(tmp_path):
    """The flights want a lag of 0.16 s; a replay tells a third of what is left."""

    def flown_at(value: float) -> SimpleNamespace:
        wanted = Choice("lag", value + (0.16 - value) / 3.0, 1e-3, 60.0, 3600.0, 1.0, 0.0)
        other = Choice("Cm", 1.0, 0.1, 10.0, 100.0, 1.0, 0.0)
        return SimpleNamespace(
            selection=Selection((wanted, other)), far=far_off([wanted], {"lag": value}), about=None, value=value,
            merit=1e6 * (0.16 - value) ** 2,
        )  # fmt: skip

    seen: list[tuple[float, float]] = []

    def fly(selection: Selection, about: object, folder: Path) -> SimpleNamespace:
        lag, other = selection.chosen
        assert folder.name == f"round2-{len(seen)}"
        seen.append((lag.value, other.value))
        return flown_at(lag.value)

    now = at_values(flown_at(0.04), fly, tmp_path / "round2")  # type: ignore[arg-type]
    assert now.value == pytest.approx(0.16, abs=3e-3)  # type: ignore[attr-defined]
    assert 2 <= len(seen) <= 4
    assert {cm for _, cm in seen} == {1.0}
    seen.clear()

    earned = [0.0]

    def runs_away(value: float, *others: Choice) -> SimpleNamespace:
        wanted = Choice("cg", value - 0.012, 2e-3, -5.0, 25.0, 1.0, 0.0)
        return SimpleNamespace(
            selection=Selection((wanted, *others)), far=far_off([wanted], {"cg": value}), about=None,
            merit=1e3 + earned[0] * value,
        )  # fmt: skip

    def fly_away(selection: Selection, about: object, folder: Path) -> SimpleNamespace:
        keys = [c.key for c in selection.chosen]
        if "cg" not in keys:
            return SimpleNamespace(selection=selection, far={}, about=None, merit=1e3)
        return runs_away(*(c.value for c in selection.chosen if c.key == "cg"), selection.chosen[-1])

    scale = Choice("scale", 0.027, 7e-4, 38.0, 1444.0, 1.0, 0.0)
    left = at_values(runs_away(-0.012, scale), fly_away, tmp_path / "round2")  # type: ignore[arg-type]
    assert [c.key for c in left.selection.chosen] == ["scale"]
    # Where every change makes the flights likelier, the number goes on.
    earned[0] = 1e3
    left = at_values(runs_away(-0.012, scale), fly_away, tmp_path / "round2")  # type: ignore[arg-type]
    assert [c.key for c in left.selection.chosen] == ["cg", "scale"]
    assert at_values(flown_at(0.159), fly, tmp_path / "round2").value == 0.159  # type: ignore
    first = flown_at(0.04)
    assert at_values(first, lambda *_: None, tmp_path / "round2") is first  # type: ignore


def flown(merit: float, *keys: str) -> SimpleNamespace:
    return SimpleNamespace(merit=merit, keys=frozenset(keys))


def test_of_rounds_in_gusts_the_likeliest_stands_and_not_the_last():
    first, second, third = (
        flown(-640.0, "effect/Cn/de"),
        flown(-630.0, "effect/Cn/de", "effect/Cm/V_rel"),
        flown(-650.0),
    )
    assert likeliest([first, second]) is first  # type: ignore[list-item]
    assert likeliest([first, second, third]) is third  # type: ignore[list-item]
    assert likeliest([]) is None


def test_rounds_that_judge_other_samples_are_not_compared():
    """A late sensor's first samples are before the flight's first row: there are fewer to be surprised by."""
    first, late = flown(-640.0), flown(-600.0, "effect/sensor.alpha_rad/delay")
    assert likeliest([first, late]) is late  # type: ignore[list-item]
    better = flown(-610.0, "effect/sensor.alpha_rad/delay", "effect/Cm/V_rel")
    assert likeliest([first, better, late]) is better  # type: ignore[list-item]


def round_of(merit: float, standing: bool = False, gusts: object = None, **t: float) -> SimpleNamespace:
    chosen = tuple(Choice(k, 1.0, 0.1, v, v * v, 1.0, 0.0) for k, v in t.items())
    return SimpleNamespace(merit=merit, standing=standing, gusts=gusts, selection=Selection(chosen), keys=frozenset(t), about=None)


def test_what_says_nothing_once_it_flies_is_left_out(tmp_path):
    """Cm is there; a rate of alpha beside it is there only while it does not fly."""
    asked: list[list[str]] = []

    def fly(selection: Selection, about: object, folder: Path) -> SimpleNamespace:
        asked.append([c.key for c in selection.chosen])
        return round_of(101.0, Cm=-8.0)

    both, alone = round_of(90.0, Cm=-8.0, alphadot=1.7), round_of(100.0, Cm=-8.1)
    found, lines = without_weak(both, [both, alone], 4.0, fly, tmp_path)  # type: ignore
    assert found is alone
    assert "alphadot" in lines[0]
    assert not asked
    found, _ = without_weak(both, [both], 4.0, fly, tmp_path)  # type: ignore
    assert found is not None
    assert found.merit == 101.0
    assert asked == [["Cm"]]
    for best in (
        round_of(90.0, Cm=-8.0, alphadot=5.0), round_of(90.0, True, Cm=-8.0, alphadot=1.7), round_of(90.0, Cm=3.5), None,
    ):  # fmt: skip
        assert without_weak(best, [], 4.0, fly, tmp_path) == (best, [])  # type: ignore
    assert without_weak(both, [both], 4.0, lambda *_: None, tmp_path) == (both, [])  # type: ignore


@pytest.mark.parametrize("standing", [False, True])
def test_nothing_that_says_something_once_it_flies_is_no_effect(tmp_path, standing):
    """Chance: |t| 4.5 on the linearised flight, 2.7 once it flies."""
    best = round_of(90.0, standing, alphadot=2.7)
    assert without_weak(best, [best], 4.0, lambda *_: None, tmp_path) == (
        None,
        ["flown, alphadot has |t| 2.7: no effect"],
    )  # type: ignore
    for kept in (round_of(90.0, standing, alphadot=3.1), round_of(90.0, standing, object(), alphadot=2.7)):
        assert without_weak(kept, [kept], 4.0, lambda *_: None, tmp_path) == (kept, [])  # type: ignore
