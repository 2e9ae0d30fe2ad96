"""Where rounds begin, and at which limit a slower servo is judged."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from sysid.effects.prediction import White
from sysid.effects.score import Evidence, gather
from uqharness.identification.linearised import ModelState, around, servo_change
from uqharness.refinement.round import joint_point
from uqharness.refinement.rounds import SHARES, just_so
from uqharness.replay.replay import STATES
from uqharness.simulator.actuators import Actuator

NAMES = ("aero/a", "effect/one", "effect/two")


def evidence_of(values: tuple[float, ...], seed: int = 0, noise: float = 1.0) -> Evidence:
    """Two segments whose residual holds each column ``values`` times."""
    rng = np.random.default_rng(seed)
    parts = []
    for _ in range(2):
        columns = rng.standard_normal((400, 2, len(NAMES)))
        residual = columns @ np.array(values) + noise * rng.standard_normal((400, 2))
        start = rng.standard_normal((8, 1 + len(NAMES)))
        parts.append(
            White(
                residual,
                columns.astype(np.float32),
                0.0,
                start,
                np.ones((400, 2), dtype=bool),
                np.ones(2),
            )
        )
    return gather(parts, NAMES, [0, 1], {})


def test_parameters_and_start_states_move_with_the_effects():
    evidence = evidence_of((2.0, 3.0, 0.0), noise=0.0)
    starts = (np.zeros(9), np.ones(9))
    fit = SimpleNamespace(
        trajectory=SimpleNamespace(point=ModelState({"aero/a": 10.0}, {}, starts))
    )
    about = SimpleNamespace(fit=fit, evidence=evidence, flown={"effect/two": 0.5})
    setup = SimpleNamespace(active=(), carriers={}, nuisance=(), jumping=())
    plain = ModelState({"aero/a": 1.0, "aero/b": 7.0}, {}, starts)
    before = SimpleNamespace(trajectory=SimpleNamespace(point=plain))
    start = SimpleNamespace(setup=setup, before=before, free=["aero/a"], limits={})
    found = joint_point(start, about, ["effect/one"])  # type: ignore[arg-type]
    assert found.values == pytest.approx({"aero/a": 12.0, "aero/b": 7.0}, abs=1e-5)
    V = STATES.index("V_mps")
    for at, begun, w in zip(found.starts, starts, evidence.white, strict=True):
        # Two of a and three of one more than was flown, and a half of the other less.
        assert at[V] - begun[V] == pytest.approx(w.start[0] @ [1.0, 2.0, 3.0, -0.5], abs=1e-4)
    start.limits["aero/a"] = (0.0, 11.0)
    within = joint_point(start, about, ["effect/one"])  # type: ignore[arg-type]
    assert within.values["aero/a"] == 11.0


def test_the_limit_is_the_one_of_which_the_flights_want_just_what_it_does():
    servo, h = Actuator(lag=25.0, rate=240.0), 0.02
    ramp = np.concatenate(
        [
            np.zeros(20),
            np.linspace(0.0, 9.6, 5),
            np.full(30, 9.6),
            np.linspace(9.6, -9.6, 9),
            np.full(30, -9.6),
        ]
    )
    before = servo.follow(ramp, h, 0.01)
    fastest = float(np.abs(np.diff(before)).max()) / h
    limits = np.array(SHARES) * fastest
    for true in (0.9 * fastest, 0.7 * fastest, 0.4 * fastest):
        hidden = Actuator(lag=25.0, rate=true).follow(ramp, h, 0.01) - before
        per_unit = [servo_change("rate_limit", servo, ramp, h, (240.0, x)) for x in limits]
        estimate = np.array([c @ hidden / (c @ c) for c in per_unit])
        t = np.array([c @ hidden / np.sqrt(c @ c) for c in per_unit])
        found = just_so(limits, estimate / (1.0 / limits - 1.0 / 240.0), t)
        assert found == pytest.approx(true, rel=0.03)
    # One slope for all limits makes something else of a servo that is a little slow.
    hidden = Actuator(lag=25.0, rate=0.9 * fastest).follow(ramp, h, 0.01) - before
    felt = servo_change("rate_limit", servo, ramp, h)
    assert abs(1.0 / (felt @ hidden / (felt @ felt) + 1.0 / 240.0) / (0.9 * fastest) - 1.0) > 0.1
    assert just_so(limits, -np.ones(len(limits)), -np.ones(len(limits))) is None
    assert (
        just_so(limits, np.full(len(limits), 0.1), np.arange(len(limits), 0.0, -1.0)) == limits[0]
    )
    assert around(servo, 1.0 / 80.0 - 1.0 / 240.0) == pytest.approx((80.0, 77.6))
    # Faster than the servo's own, where it may hardly be reached: halfway back, in travel time.
    assert around(servo, 1.0 / 480.0 - 1.0 / 240.0) == pytest.approx((480.0, 320.0))
