"""One fit for identify, compare and refine: the same estimates and gap from each, and what the
flights do not tell stays.
"""

from dataclasses import replace

import numpy as np
import pytest

from sysid.parallel import SERIAL
from tests.helpers.flown import fly
from tests.helpers.sixdof import Airframe
from tests.hidden_effects import motion
from tests.hidden_effects.cases import cards
from tests.hidden_effects.flights import Flight
from tests.hidden_effects.flights import fly as fly_hidden
from uqharness.errors import BadInputError
from uqharness.identification import replay_fit
from uqharness.identification.compare import compare
from uqharness.identification.identify import identify
from uqharness.identification.linearised import (
    ModelState,
    make_flight_data,
    observations_of,
    stage_models,
)
from uqharness.identification.replay_fit import Observed, fit_replays, jumping_flights
from uqharness.refinement.baseline import fit_without_effects, note_unestimated
from uqharness.refinement.estimators import Dataset
from uqharness.refinement.evaluation import evaluate
from uqharness.replay import CONTROL_DELAY, CONTROLS, ReplayFolder, delayed_command
from uqharness.replay.flights import prepare
from uqharness.replay.simulation import batched_pool
from uqharness.simulator.aircraft import find_aircraft

NAMES = ("aero/Cl_p", "aero/Cl_da", "aero/Cm_q", "aero/Cm_alpha", "aero/Cn_r")


@pytest.fixture(scope="module")
def aircraft():
    return find_aircraft("espaaro")


@pytest.fixture(scope="module")
def flight():
    return prepare("f", fly((("pitch-3211", 22.0), ("roll-yaw", 22.0)), positions=False), ())


def refined(aircraft, flight):
    data = make_flight_data(aircraft, [flight], ())
    limits = {n: aircraft.card.parameters[n].bounds for n in NAMES}
    with stage_models(aircraft, data) as models:
        result = fit_without_effects(aircraft, models, data, NAMES, limits, SERIAL)
        fit, retained, excited = result.fit, result.names, result.excited
    assert retained == excited == NAMES
    return fit.trajectory.point


def test_identify_and_refine_estimate_the_same(aircraft, flight):
    result = identify(aircraft, [flight], (), NAMES, method="output-error", workers=1)
    point = refined(aircraft, flight)
    difference = (np.array([point.values[n] for n in NAMES]) - result.theta) / result.std
    assert np.abs(difference).max() < 0.05
    late, std = result.nuisance[f"delay/f/{CONTROL_DELAY}"]
    assert abs(point.nuisance[f"lateness/f/{CONTROL_DELAY}"] - late) < 0.05 * std
    assert np.abs(late) < 4.0 * std < 0.002
    # Commands 3 ms later are seen by both: by their lateness, not in the parameters.
    moved = {
        c: delayed_command(flight.record[c], flight.record["time_s"], 0.003)
        for c in flight.record.columns
        if c.endswith("_deg")
    }
    other = prepare("f", flight.record.with_columns(moved), ())
    shifted = refined(aircraft, other).nuisance[f"lateness/f/{CONTROL_DELAY}"]
    assert shifted - late == pytest.approx(-0.003, abs=0.001)


def test_compare_and_refine_show_the_same_gap(aircraft, flight):
    gap = compare(aircraft, flight, (), workers=1)
    data = make_flight_data(aircraft, [flight], ())
    visible = evaluate(aircraft, Dataset(data), SERIAL, ModelState({}, {}, ()))
    ours = {c: visible.channel_rms(k) / visible.noise[k] for k, c in enumerate(data.outputs)}
    assert ours == pytest.approx({c: gap.channels[c].ratio for c in data.outputs}, rel=1e-3)
    # A sensor's scale, known, is taken out before the fit and put back: the same flight with a vane
    # that reads 1.1 times.
    scaled = prepare(
        "f", flight.record.with_columns({"alpha_rad": 1.1 * flight.record["alpha_rad"]}), ()
    )
    data = make_flight_data(aircraft, [scaled], ())
    side, scale = Dataset(data), {"effect/sensor.alpha_rad/scale": 0.1}
    blind, reports = (
        evaluate(aircraft, side, SERIAL, ModelState({}, {}, (), s)).cost for s in ({}, scale)
    )
    assert reports < blind - 100.0


def test_what_the_flights_do_not_determine_stays(aircraft, flight):
    data = make_flight_data(aircraft, [flight], ())
    observed = Observed(data.segments, data.outputs, data.measured, data.biased, {})
    names, values = ("aero/Cm_q", "aero/CX_alpha2"), np.array([-13.8, 1.86])
    with ReplayFolder(aircraft) as model:
        fit = fit_replays(
            model,
            observed,
            names,
            (values + np.array([0.5, 0.02]), values),
            [(-60.0, 0.0), (1.8, 1.9)],
            batched_pool(map),
        )
        assert fit.undetermined == ("aero/CX_alpha2",)
        assert fit.values()["aero/CX_alpha2"] == 1.86
        assert fit.values()["aero/Cm_q"] == pytest.approx(-13.8, abs=1.0)
        with pytest.raises(BadInputError, match="cannot fly these segments"):
            fit_replays(
                model,
                observed,
                names,
                (np.array([1e9, 1e9]),),
                [(None, None)] * 2,
                batched_pool(map),
            )


@pytest.mark.parametrize("distant", [False, True])
def test_beside_what_goes_back_the_estimate_begins_where_replays_are_nearest(
    aircraft, flight, monkeypatch, distant
):
    data = make_flight_data(aircraft, [flight], ())
    observed = Observed(data.segments, data.outputs, data.measured, data.biased, {})
    names, close, card = (
        ("aero/Cm_q", "aero/CX_alpha2"),
        np.array([-13.0, 1.84]),
        np.array([-11.0, 1.86]),
    )
    start, real = [], replay_fit.output_error

    def estimated(replay, theta, *arguments, **more):
        start.append(theta)
        fit = real(replay, theta, *arguments, **more)
        if len(start) == 1 and distant:
            # Beside a value at its bound, another one was driven away.
            fit.theta[0] = -50.0
        return fit

    monkeypatch.setattr(replay_fit, "output_error", estimated)
    with ReplayFolder(aircraft) as model:
        fit = fit_replays(
            model, observed, names, (close, card), [(-60.0, 0.0), (1.8, 1.9)], batched_pool(map)
        )
    assert fit.undetermined == ("aero/CX_alpha2",)
    assert [theta[1] for theta in start] == [1.84, 1.86]
    first = start[1][0]
    assert first == -13.0 if distant else first == pytest.approx(-13.8, abs=0.5)
    assert fit.values()["aero/Cm_q"] == pytest.approx(-13.8, abs=1.0)


def test_what_replays_have_at_a_bound_is_free_beside_effects_and_told(aircraft, flight):
    data, names = make_flight_data(aircraft, [flight], ()), ("aero/Cm_q", "aero/CX_alpha2")
    limits = {"aero/Cm_q": (-60.0, 0.0), "aero/CX_alpha2": (1.86, 1.9)}
    with stage_models(aircraft, data) as models:
        result = fit_without_effects(aircraft, models, data, names, limits, SERIAL)
    fit, notes = result.fit, result.notes
    assert result.names == result.excited == names
    assert fit.trajectory.point.values["aero/CX_alpha2"] == 1.86
    assert set(names) <= set(fit.columns[0].names)
    assert any(n.endswith("only with effects: aero/CX_alpha2") for n in notes)
    assert note_unestimated(names, names[:1])[0].endswith(": aero/CX_alpha2")
    assert note_unestimated(names, names) == []


@pytest.fixture
def jumping(monkeypatch):
    """Three manoeuvres of equations of motion whose servos act at once, and whose rows were read
    before their commands went out.
    """
    monkeypatch.setattr(motion, "LAG", (1e6,) * 4)
    monkeypatch.setattr(motion, "RATE", (1e9,) * 4)
    card = cards("jumps", "mixed", 0.0, 1.0, 50.0)[0]
    return prepare("f", fly_hidden([Flight(card, Airframe())])[0], ())


@pytest.mark.slow
def test_what_accelerometers_have_not_seen_of_a_jump_is_estimated(aircraft, jumping):
    names = ("aero/CZ_de", "aero/Cm_de", "aero/CY_dr", "aero/Cl_da")
    true = [Airframe().coefficients[n.removeprefix("aero/")] for n in names]
    data = make_flight_data(aircraft, [jumping], (), CONTROLS)
    bounds = [aircraft.card.parameters[n].bounds for n in names]
    with ReplayFolder(aircraft, ideal=CONTROLS) as model:
        fit = fit_replays(
            model, observations_of(data), names, (np.array(true),), bounds, batched_pool(map)
        )
        blind = fit_replays(
            replace(model, lagging=("throttle_pct",)),
            observations_of(data),
            names,
            (np.array(true),),
            bounds,
            batched_pool(map),
        )
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(replay_fit, "jumping_flights", lambda *_: [])
            reduced = fit_replays(
                model, observations_of(data), names, (np.array(true),), bounds, batched_pool(map)
            )
    share, std = (
        fit.values()["unseen/f"],
        float(fit.fit.std[fit.layout.names.index("unseen/f")]),
    )
    assert share == pytest.approx(1.0, abs=4.0 * std)
    assert std < 0.05
    assert (np.array([fit.values()[n] for n in names]) - true) / fit.fit.std[:4] == pytest.approx(
        0.0, abs=4.0
    )
    assert blind.values()["unseen/f"] == pytest.approx(share, abs=3.0 * std)
    # Taken to have seen their jumps, the same flights put the force of a surface elsewhere.
    assert "unseen/f" not in reduced.layout.names
    assert (
        np.abs((np.array([reduced.values()[n] for n in names]) - true) / reduced.fit.std[:4]).max()
        > 4.0
    )


def test_a_lag_in_every_servo_leaves_nothing_to_see(aircraft, flight):
    data = make_flight_data(aircraft, [flight], ())
    with ReplayFolder(aircraft) as model:
        assert model.jumping == ()
        assert jumping_flights(model, data.segments, {}) == []
    with ReplayFolder(aircraft, ideal=("elevator",)) as model:
        assert jumping_flights(model, data.segments, {"f": [CONTROL_DELAY]}) == ["f"]
        assert jumping_flights(model, data.segments, {"f": ["rates"]}) == []
