"""Which candidates are worth scoring: what a replay, or a log's rows, cannot resolve is
left out.
"""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from sysid.effects.catalogue import subsystem_effects
from sysid.effects.selection import SelectedEffect, Selection
from tests.helpers.whitened import information_of
from uqharness.refinement.candidates import eligible, largest_step, without_unresolved
from uqharness.simulator.actuators import Actuator

DT = 0.02
EFFECTS = [e for e in subsystem_effects(["aileron"], [], []) if e.term in ("lag", "rate_limit")]


def at(value: float, late: dict[str, list[str]], servos=None, held=EFFECTS) -> dict[str, float]:
    """Eligible effects where every one of them is estimated at ``value`` exactly; a doublet of 10
    deg; held: of which the information has columns."""
    rng = np.random.default_rng(1)
    columns = rng.standard_normal((50, 2, len(held)))
    residual = value * columns.sum(axis=2)
    information = information_of(residual, columns, [e.key for e in held])
    controls = np.zeros((50, 4))
    controls[10:20, 1], controls[20:30, 1] = 10.0, -10.0
    data = SimpleNamespace(
        segments=[SimpleNamespace(dt_s=DT, controls=controls)],
        delayed_sensors=late,
        servos=servos or {},
    )
    return eligible(EFFECTS, data, (), information)  # type: ignore[arg-type]


def test_the_largest_step_is_half_the_commands_range():
    controls = np.array([[0.0, -8.0, 0.0, 50.0], [0.0, 8.0, 0.0, 60.0]])
    data = SimpleNamespace(segments=[SimpleNamespace(dt_s=DT, controls=controls)])
    assert largest_step(data, EFFECTS[0]) == 8.0  # type: ignore[arg-type]


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


def test_what_the_search_did_without_is_no_candidate():
    """Where delays of single channels were not believed, the last flight's information has no columns
    of them.
    """
    assert {k.rpartition("/")[2] for k in at(5e-3, {}, held=EFFECTS[:1])} == {EFFECTS[0].term}


def test_a_servo_may_be_faster_than_its_xml_has_it_if_that_has_a_lag():
    assert {k.rpartition("/")[2] for k in at(-2e-2, {}, {"aileron": Actuator(25.0)})} == {"lag"}
    assert at(-2e-2, {}, {"aileron": Actuator(None)}) == []
    assert at(-2e-2, {}, {"rudder": Actuator(25.0)}) == []


@pytest.mark.parametrize(
    ("limit_dps", "late", "listed"),
    [(282.0, {"one": ["p"]}, False), (282.0, {}, True), (480.0, {"one": ["p"]}, True)],
)
def test_a_rate_limit_below_what_rows_resolve_is_no_effect_though_it_was_flown(
    limit_dps, late, listed
):
    """1/282 - 1/240 s/deg are 6 ms over a doublet of 10 deg, where a log leaves 10 ms open; 1/480 -
    1/240 are 21 ms.
    """
    rng = np.random.default_rng(3)
    (effect,) = (e for e in EFFECTS if e.term == "rate_limit")
    value = 1.0 / limit_dps - 1.0 / 240.0
    columns = rng.standard_normal((200, 2, 2))
    residual = columns @ np.array([1.0, value])
    keys = ("aero/Cl_p", effect.key)
    controls = np.array([[0.0, -10.0, 0.0, 50.0], [0.0, 10.0, 0.0, 50.0]])
    data = SimpleNamespace(
        segments=[SimpleNamespace(dt_s=DT, controls=controls)],
        delayed_sensors=late,
        servos={"aileron": Actuator(25.0, 240.0)},
    )
    selection = Selection((SelectedEffect(effect.key, value, 1e-6, 17.0, 289.0, 1.0, 0.0),))
    information = information_of(residual, columns, keys)
    retained = without_unresolved(selection, [effect], data, keys, information)  # type: ignore[arg-type]
    assert bool(retained.chosen) is listed


def test_a_time_below_what_rows_resolve_is_no_effect_though_it_was_flown():
    rng = np.random.default_rng(2)
    keys = ["effect/sensor.rates/delay", "effect/Cm/p_hat^2"]
    columns = rng.standard_normal((200, 2, 3))
    residual = columns @ np.array([0.4, 1.0, 1.0])
    information = information_of(residual, columns, ["aero/Cm_q", *keys])
    data = SimpleNamespace(segments=[SimpleNamespace(dt_s=DT)], delayed_sensors={}, servos={})
    units = zip(keys, ("s", "1"), strict=True)
    effects = {k: SimpleNamespace(key=k, unit=u, positive=False, penalty=0.0) for k, u in units}

    def retained(late_s: float) -> list[str]:
        chosen = tuple(
            SelectedEffect(k, v, 1e-5, 9.0, 81.0, 1.0, 0.0)
            for k, v in zip(keys, (late_s, 1.0), strict=True)
        )
        remainder = without_unresolved(
            Selection(chosen), [*effects.values()], data, ("aero/Cm_q", *keys), information
        )
        return [c.key for c in remainder.chosen]

    assert retained(0.0008) == keys
    assert retained(0.0005) == keys[1:]
    assert retained(-0.0005) == keys[1:]


@pytest.mark.parametrize(
    ("alike", "positive", "reference"),
    [(0.02, False, True), (0.02, True, False), (3.0, False, False)],
)
def test_a_time_too_short_to_be_named_stands_beside_the_effect_that_it_may_be(
    alike, positive, reference
):
    rng = np.random.default_rng(4)
    term, delay = "effect/CZ/alphadot_hat", "effect/actuator.elevator/lag"
    columns = rng.standard_normal((200, 2, 2))
    columns[:, :, 1] = -1000.0 * (
        columns[:, :, 0] + alike * columns[:, :, 1]
    )  # -1 ms of it does what 1 of the term does
    residual = columns[:, :, 0] + 0.1 * rng.standard_normal((200, 2))
    information = information_of(residual, columns, [term, delay])
    data = SimpleNamespace(segments=[SimpleNamespace(dt_s=DT)], delayed_sensors={}, servos={})
    effects = [
        SimpleNamespace(
            key=k, unit=u, positive=positive, penalty=0.0, subsystem=of, term=k.rpartition("/")[2]
        )
        for k, u, of in ((term, "1", None), (delay, "s", "actuator.elevator"))
    ]
    chosen = (SelectedEffect(term, 1.0, 0.05, 20.0, 400.0, 1.0, 0.0),)
    (effect,) = without_unresolved(Selection(chosen), effects, data, (term,), information).chosen
    assert effect.key == term
    assert [a.key for a in effect.alternatives if not a.separable] == ([delay] if reference else [])
