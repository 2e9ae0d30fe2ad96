"""The questions of the regression test: what they hide, flights and folders that are as said."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.helpers.sixdof import Airframe
from tests.hidden_effects.cases import THIRD
from tests.hidden_effects.catalogue import ENTRIES
from tests.hidden_effects.effects import SURFACES, Effect
from tests.hidden_effects.flights import Flight, earlier, fly, fly_and_tell
from tests.hidden_effects.folders import folder_of, state
from tests.hidden_effects.manoeuvres import card
from tests.hidden_effects.motion import IDEAL, Model, evaluate, trim
from tests.hidden_effects.questions import ROWS, Stated, question
from uqharness.simulator.actuators import actuators
from uqharness.simulator.aircraft import find_aircraft


def test_the_forty_questions_hide_what_their_kinds_say():
    request = [question(number) for number in range(40)]
    assert [row["number"] for row in ROWS] == list(range(40))
    assert len({q.id for q in request}) == 40
    limits = {"clear": (10.0, np.inf), "marginal": (4.0, 10.0), "weak": (3.0, 4.0)}
    for q in request:
        hidden = {"null": 0, "pair": 2, "card": len(q.entries)}.get(q.kind, 1)
        assert len(q.entries) == len(q.effects) == hidden
        assert (q.wrong is not None) == (q.kind == "card")
        assert set(q.entries) <= ENTRIES.keys() or q.kind == "off-form"
        low, high = limits.get(q.kind, (10.0, np.inf))
        assert all(low <= t <= high for t in q.t)


def test_the_folder_says_what_is_stated(tmp_path):
    request = replace(
        question(8),
        stated=Stated({"rudder": 60.0, "elevator": None}, {"aileron": 40.0}, 0.9, (0.1, 0.0, -0.2)),
    )
    folder = folder_of(request, tmp_path)
    aircraft = find_aircraft(str(folder))
    servos = actuators(aircraft, SURFACES)
    assert (servos["rudder"].lag, servos["elevator"].lag, servos["aileron"].lag) == (
        60.0,
        None,
        25.0,
    )
    assert (servos["rudder"].rate, servos["aileron"].rate) == (240.0, 40.0)
    assert aircraft.card.sensors.position_m["accelerometer"] == (0.1, 0.0, -0.2)
    assert '<property value="0.9">propulsion/thrust-scale<' in (
        folder / f"{request.aircraft}.xml"
    ).read_text(encoding="utf-8")
    with pytest.raises(ValueError, match="stands 0 times"):
        state(folder, Stated({"elevator": 30.0}))


def test_accelerometers_and_vanes_feel_their_place():
    """Acceleration of a point from d/dt (v + w x r) + w x (v + w x r) less gravity; the air's
    velocity at the vane.
    """
    rng = np.random.default_rng(5)
    x = 0.3 * rng.normal(size=(12, 3))
    x[0] += 22.0
    r = np.array([0.2, -0.1, 0.3])
    moved = tuple(
        Effect("sensor.accelerometer", f"place_{a}", float(v))
        for a, v in zip("xyz", r, strict=True)
    )
    plain, present = (
        evaluate(Model([Airframe()] * 3, [e] * 3), x, np.full((4, 3), 1.0), None)
        for e in ((), (*moved, Effect("sensor.vane", "place_x", 0.7)))
    )
    np.testing.assert_array_equal(plain.dot, present.dot)
    for lane in range(3):
        v, w, wdot = x[:3, lane], x[3:6, lane], plain.dot[3:6, lane]
        specific = plain.felt[:, lane] - plain.dot[:3, lane] - np.cross(w, v)  # less gravity
        expected = (
            plain.dot[:3, lane] + np.cross(wdot, r) + np.cross(w, v + np.cross(w, r)) + specific
        )
        np.testing.assert_allclose(present.felt[:, lane], expected, rtol=1e-9, atol=1e-12)
        at = v + np.cross(w, [0.7, 0.0, 0.0])
        assert present.alpha[lane] == pytest.approx(np.arctan2(at[2], at[0]))
        assert present.beta[lane] == pytest.approx(np.arcsin(at[1] / np.linalg.norm(at)))
        assert abs(present.alpha[lane] - plain.alpha[lane]) > 1e-4
    with pytest.raises(ValueError, match="place_x"):
        Effect("sensor.vane", "place_z", 0.1)


def test_servos_at_once_and_clocks_of_commands():
    flight = replace(card(9, 22.0, seconds=11.0), noise=0.0, positions=True)
    late = Effect("record", "delay", 0.02)
    at_once, lagging, shifted = fly_and_tell(
        [
            Flight(flight, Airframe(), (), IDEAL),
            Flight(flight, Airframe()),
            Flight(flight, Airframe(), (late,), IDEAL),
        ]
    )
    np.testing.assert_allclose(
        at_once.record["elevator_pos_deg"][1:], at_once.record["elevator_deg"][:-1], atol=1e-9
    )
    assert (
        np.abs(lagging.record["elevator_pos_deg"][1:] - lagging.record["elevator_deg"][:-1]).max()
        > 1.0
    )
    # A record whose commands act 20 ms late has them a row early.
    np.testing.assert_array_equal(
        shifted.record["elevator_deg"][:-1], at_once.record["elevator_deg"][1:]
    )
    np.testing.assert_array_equal(shifted.record["q_radps"], at_once.record["q_radps"])
    assert earlier(np.arange(4.0), -1).tolist() == [0.0, 0.0, 1.0, 2.0]


@pytest.mark.slow
def test_the_third_aeroplane_flies():
    x, s = trim(Model([THIRD] * 3, [()] * 3), np.array([16.0, 22.0, 28.0]), np.full(3, 100.0))
    assert (np.abs(s[:3]) < 6.0).all()
    assert ((s[3] > 15.0) & (s[3] < 90.0)).all()
    assert (np.degrees(x[7]) < 10.0).all()
    record = fly([Flight(card(4, 23.0, seconds=30.0), THIRD)])[0]
    assert np.abs(record["phi_rad"]).max() < 1.2
    assert np.abs(record["alpha_rad"]).max() < 0.3
