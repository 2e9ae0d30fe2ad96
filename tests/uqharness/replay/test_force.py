"""Forces at measured states by JSBSim and by the batch engine."""

from __future__ import annotations

import logging

import numpy as np
import pytest

from uqharness import batch
from uqharness.cli.main import main
from uqharness.plugin import with_card
from uqharness.replay import CONTROLS, ReplayFolder, force
from uqharness.replay.force import ForcedModel, SegmentStates, force_states, property_slopes
from uqharness.replay.segments import Segment
from uqharness.simulator import find_aircraft

N = 40
MOTION = {
    "V_mps": np.linspace(17.0, 27.0, N),
    "alpha_rad": np.linspace(-0.05, 0.15, N),
    "beta_rad": np.linspace(0.1, -0.1, N),
    "phi_rad": np.linspace(-1.0, 1.0, N),
    "theta_rad": np.linspace(0.2, -0.2, N),
    "p_radps": np.linspace(-1.0, 1.0, N),
    "q_radps": np.linspace(0.5, -0.5, N),
    "r_radps": np.linspace(-0.3, 0.3, N),
}
U = np.column_stack(
    [
        np.linspace(-10.0, 10.0, N),
        np.linspace(8.0, -8.0, N),
        np.linspace(-5.0, 5.0, N),
        np.linspace(0.0, 100.0, N),
    ]
)
HEIGHT_M = np.linspace(100.0, 900.0, N)


@pytest.fixture(scope="module")
def straight_flight():
    with ReplayFolder(find_aircraft("espaaro"), ideal=CONTROLS) as model:
        yield model


@pytest.fixture(autouse=True)
def nothing_known():
    force._cached_programs.clear()
    yield
    force._cached_programs.clear()


def of_step(dt_s: float) -> Segment:
    start = np.array(
        [MOTION[c][0] for c in ("V_mps", "alpha_rad", "beta_rad", "phi_rad", "theta_rad")]
        + [0.0] * 4
    )
    return Segment("f", "f", dt_s * np.arange(N), U, start, 300.0, 0.0)


def output_of(model, monkeypatch, gain: int, **properties: float) -> ForcedModel:
    monkeypatch.setattr(force, "MIN_BATCH_STATES", gain)
    return force_states(
        model, of_step(0.02), MOTION, U, {f"aero/{k}": v for k, v in properties.items()}, HEIGHT_M
    )


def differences(a: ForcedModel, b: ForcedModel) -> float:
    return float(
        np.abs(a.coefficients / b.coefficients - 1.0).max()
        + np.abs(a.other_force - b.other_force).max()
    )


def test_both_engines_say_the_same(straight_flight, monkeypatch):
    theirs = output_of(straight_flight, monkeypatch, 10**9, Cm_q=-11.0)
    ours = output_of(straight_flight, monkeypatch, 1, Cm_q=-11.0)
    assert force._cached_programs[straight_flight.identity].program is not None
    assert 0.0 < differences(ours, theirs) < 1e-8
    assert differences(output_of(straight_flight, monkeypatch, 1, Cm_q=-11.1), theirs) > 1e-3


def test_jsbsim_answers_where_the_engines_differ(straight_flight, monkeypatch, caplog):
    theirs = output_of(straight_flight, monkeypatch, 10**9)
    answer = batch.at_states
    monkeypatch.setattr(batch, "at_states", lambda *inputs: 1.00001 * answer(*inputs))
    with caplog.at_level(logging.WARNING, logger="uqharness"):
        ours = output_of(straight_flight, monkeypatch, 1)
    assert "the batch engine differs" in caplog.text
    assert differences(ours, theirs) == 0.0


@pytest.mark.parametrize(
    ("name", "speed_mps"),
    [
        ("c310", 65.0),
        pytest.param("c172p", 50.0, marks=pytest.mark.slow),
        pytest.param("T37", 90.0, marks=pytest.mark.slow),
    ],
)
def test_engines_settle_as_in_jsbsim(name, speed_mps):
    """Propellers that JSBSim's own iteration leaves out of balance; two engines of one lever."""
    controls = ("elevator", "aileron", "rudder", "throttle")
    with ReplayFolder(with_card(find_aircraft(name)), controls, ideal=controls) as model:
        states = force.States(
            {**MOTION, "V_mps": MOTION["V_mps"] * speed_mps / 22.0},
            model.to_property(np.abs(U) * [0.3, 0.3, 0.3, 0.3] + [0.0, 0.0, 0.0, 65.0]),
            HEIGHT_M,
            np.full(N, -200.0),
        )
        program = force._compile(model, 0.01, set(), force._RECORDS)
        batch_forces = force._evaluate(program, model, states, 0.01, {})
        theirs = force._by_jsbsim((model, 0.01, {}, states))
        size = np.maximum(np.abs(theirs).max(axis=0), 1e-3)
        assert np.max(np.abs(batch_forces - theirs) / size) < 1e-7
        # A throttle that differs by a ten thousandth of its travel shows.
        states.controls[:, -1] *= 1.0 + 1e-4
        other = force._evaluate(program, model, states, 0.01, {})
        assert np.max(np.abs(other - theirs) / size) > 1e-6


def test_both_engines_settle_a_propeller_and_agree_on_slopes(tmp_path, monkeypatch):
    """Throttles from idle, where JSBSim's own iteration leaves the propeller out of balance."""
    names = ("uq/scale/CLDe", "uq/scale/CLadot", "uq/scale/CDwbh", "uq/scale/Cmq")
    values = dict.fromkeys(names, 1.0)
    motion = MOTION | {"V_mps": 2.2 * MOTION["V_mps"]}
    assert main(["instrument", "c172p", "--out", str(tmp_path / "c172p"), "--no-check"]) == 0
    with ReplayFolder(find_aircraft(tmp_path / "c172p"), ideal=CONTROLS) as model:
        parts = [SegmentStates(of_step(0.02), motion, U, HEIGHT_M)]
        loads, slopes = [], []
        for gain in (10**9, 1):
            monkeypatch.setattr(force, "MIN_BATCH_STATES_ENGINES", gain)
            loads.append(force_states(model, of_step(0.02), motion, U, values, HEIGHT_M))
            slopes += property_slopes(model, parts, values, names)
        entry = force._cached_programs[model.identity]
    assert entry.program is not None
    assert all(entry.slopes[name] for name in names)
    assert np.ptp(loads[0].other_force[:, 0]) > 1000.0
    assert 0.0 < np.abs(loads[1].other_force - loads[0].other_force).max() < 1e-4
    assert np.abs(loads[1].coefficients - loads[0].coefficients).max() < 1e-7
    size = np.abs(slopes[0]).max(axis=(0, 2), keepdims=True)
    assert np.all(size > 1.0)
    assert np.abs((slopes[1] - slopes[0]) / size).max() < 2e-3


def test_forces_do_not_depend_on_the_state_before():
    """c172x: ailerons of unequal travel have no position in the card, but actuators with a
    hysteresis and a rate limit, which stayed.
    """
    motion = dict.fromkeys(("beta_rad", "phi_rad", "p_radps", "q_radps", "r_radps"), np.zeros(2))
    motion |= {"V_mps": np.full(2, 50.0), "alpha_rad": np.full(2, 0.05)}
    motion |= {"theta_rad": np.full(2, 0.05)}
    with ReplayFolder(with_card(find_aircraft("c172x")), ideal=CONTROLS) as model:
        moments = []
        for before_deg in (10.0, 0.0):
            controls = np.zeros((2, 4))
            controls[0, 1] = before_deg
            forced = force_states(model, of_step(0.02), motion, controls, {}, HEIGHT_M[:2])
            moments.append(forced.aero_moment[1])
    np.testing.assert_allclose(moments[0], moments[1], rtol=1e-9)
