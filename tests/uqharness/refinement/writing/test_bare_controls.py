"""Servo effects of surfaces that follow their commands at once: the XML has no <actuator>."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from sysid.effects.catalogue import subsystem_effects
from sysid.record import FlightRecord
from uqharness.cli.main import main
from uqharness.errors import BadInputError
from uqharness.identification.linearised import servo_change
from uqharness.identification.linearised.flight_data import servos_of
from uqharness.plugin import Bounds, instrument_aircraft, with_card
from uqharness.refinement.write_xml import EffectToWrite, carrier, switch_of, write_effects
from uqharness.replay import ReplayFolder
from uqharness.replay.replay import CHANNELS, fly_segment, initial_actuator_positions
from uqharness.replay.segments import Segment
from uqharness.simulator import engine
from uqharness.simulator.actuators import Actuator
from uqharness.simulator.aircraft import find_aircraft, open_aircraft
from uqharness.xml.servo import servo_property

EFFECTS = {
    e.key.removeprefix("effect/actuator."): e
    for e in subsystem_effects(["elevator", "aileron", "rudder"], [], [])
}
POSITIONS = ("elevator-pos-rad", "left-aileron-pos-rad", "right-aileron-pos-rad", "rudder-pos-rad")


@pytest.fixture(scope="module")
def glider(tmp_path_factory):
    """JSBSim's sgs126, whose commands move the surfaces through summers and scales."""
    out = tmp_path_factory.mktemp("glider") / "sgs126"
    instrument_aircraft(with_card(find_aircraft("sgs126")), Bounds(), out, check=False)
    return find_aircraft(out)


def with_effects(aircraft, folder, **values):
    """The aircraft with servo effects, such as elevator_lag=0.1."""
    effects = [EffectToWrite(EFFECTS[k.replace("_", "/", 1)], v, "", {}) for k, v in values.items()]
    write_effects(aircraft, effects, {}, folder / "sgs126")
    return find_aircraft(folder / "sgs126")


def positions(aircraft, settings=None):
    """(100, 4) surface positions [rad] in a second of commands that step."""
    fdm = open_aircraft(aircraft)
    for name, value in (settings or {}).items():
        engine.set_property(fdm, name, value)
    fdm["ic/h-sl-ft"], fdm["ic/u-fps"] = 3000.0, 100.0
    engine.run_ic(fdm)
    rows = []
    for k in range(100):
        for control in ("elevator", "aileron", "rudder"):
            fdm[f"fcs/{control}-cmd-norm"] = 0.4 if k < 50 else -0.2
        fdm.run()
        rows.append([fdm[f"fcs/{name}"] for name in POSITIONS])
    return np.array(rows)


def test_a_surface_without_an_actuator_can_lag(glider, tmp_path):
    """All surfaces of a control lag alike, as Tustin's rule and a slew by hand have it."""
    assert set(servos_of(glider, (), ())) == {"elevator", "aileron", "rudder"}
    limit_deg = 30.0
    changed = with_effects(
        glider, tmp_path, elevator_lag=0.1, aileron_lag=0.08, rudder_rate_limit=1.0 / limit_deg
    )
    before, after = positions(glider), positions(changed)
    dt = glider.dt_s
    steps = np.array([0.0, *[0.4] * 50, *[-0.2] * 50])
    for columns, lag in (((0,), 10.0), ((1, 2), 12.5)):
        share = Actuator(lag).follow(steps, dt, dt)[1:]
        for k in columns:
            # The scale is linear on either side of zero.
            scale = np.where(share >= 0.0, before[0, k] / 0.4, before[-1, k] / -0.2)
            np.testing.assert_allclose(after[:, k], scale * share, atol=1e-9)
    throw_deg = glider.card.inputs["rudder"].throw_deg
    slew = Actuator(None, rate=limit_deg / abs(throw_deg)).follow(steps, dt, dt)[1:]
    np.testing.assert_allclose(after[:, 3], before[0, 3] / 0.4 * slew, atol=1e-6)


def test_a_dead_zone_counts_in_degrees(glider, tmp_path):
    """Half of 4 degrees are missing from each position."""
    before, after = (
        positions(a) for a in (glider, with_effects(glider, tmp_path, rudder_deadband=4.0))
    )
    missing = np.degrees(np.abs(before[:, 3]) - np.abs(after[:, 3]))
    throw_deg = abs(glider.card.inputs["rudder"].throw_deg)
    expected = 2.0 * np.degrees(np.abs(before[0, 3])) / (0.4 * throw_deg)
    assert missing[[20, 80]] == pytest.approx(expected, rel=1e-6)


def test_the_old_rate_limit_restores_the_surfaces_bit_for_bit(glider, tmp_path):
    effect = EFFECTS["rudder/rate_limit"]
    changed = with_effects(glider, tmp_path, rudder_rate_limit=0.05)
    name, off = switch_of(effect, glider)
    assert np.array_equal(positions(changed, {name: off}), positions(glider))
    # A servo that never lagged has no such number.
    assert switch_of(EFFECTS["elevator/lag"], glider) is None


def test_replays_know_the_new_actuator(glider, tmp_path):
    changed = with_effects(glider, tmp_path, elevator_lag=0.1)
    with ReplayFolder(changed) as model:
        assert model.lagging == ("elevator",)
        assert model.positions()["elevator"] == "fcs/elevator-servo-norm"
    # The effect is changed in the aircraft that has it: the number of its property.
    servos = servos_of(changed, (), ())
    assert servos["elevator"].lag == pytest.approx(10.0)
    place = carrier(EFFECTS["elevator/lag"], changed)
    assert place.absent == pytest.approx(10.0)
    assert place.exact


def test_a_surface_that_an_actuator_of_another_name_moves_gets_no_second_one():
    aircraft = with_card(find_aircraft("c172x"))
    assert "elevator" not in servos_of(aircraft, (), ())
    # Nor if the card names another property than JSBSim's, which the actuator moves.
    inputs = aircraft.card.inputs
    elevator = inputs["elevator"].model_copy(update={"position": "fcs/pitch-trim-sum"})
    card = aircraft.card.model_copy(update={"inputs": {**inputs, "elevator": elevator}})
    assert "elevator" not in servos_of(replace(aircraft, card=card), (), ())


def test_an_aircraft_that_cannot_be_opened_is_none_without_actuators():
    """Its servos' rate limit is a property, so JSBSim must be asked for the number."""
    aircraft = find_aircraft("espaaro")
    modes = {"open_loop": {"ap/absent": 1.0}}
    aircraft = replace(aircraft, card=aircraft.card.model_copy(update={"modes": modes}))
    with pytest.raises(BadInputError, match="ap/absent"):
        servos_of(aircraft, (), ())


def rudder_doublet(dt_s, before=None):
    """A segment of a rudder doublet of 5 degrees, with rows ``dt_s`` apart."""
    time = dt_s * np.arange(round(1.6 / dt_s) + 1)
    controls = np.zeros((len(time), 4))
    at = time + 1e-9
    controls[:, 2] = 5.0 * ((at > 0.4) * 1.0 - (at > 0.8) * 2.0 + (at > 1.2) * 1.0)
    start = np.array([33.0, 0.03, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    return Segment("doublet", "f", time, controls, start, 500.0, 500.0, before=before)


def test_a_rate_limit_without_a_lag_is_replayed_in_time(glider, tmp_path):
    """Against rows of 2 ms; the surface begins a segment where its slew has brought it."""
    changed = with_effects(glider, tmp_path, rudder_rate_limit=1.0 / 30.0)
    before = np.zeros((100, 4))
    before[-5:, 2] = 5.0
    with ReplayFolder(changed) as model:
        coarse = fly_segment(model, rudder_doublet(0.02), {})
        fine = fly_segment(model, rudder_doublet(0.002), {})[::10]
        limits = np.tile([-20.0, 20.0], (4, 1))
        (start,) = initial_actuator_positions(model, rudder_doublet(0.02, before), {}, limits)[[2]]
    r = CHANNELS.index("r_radps")
    assert np.abs(coarse - fine)[:, r].max() < 1e-3 * np.ptp(fine[:, r])
    assert start == pytest.approx(5 * 0.02 * 30.0, abs=0.05)


def test_a_trial_lag_changes_a_jump_as_the_lag_does():
    """The 2 ms of a servo with a lag pass between two rows: no rows resembled a lag of 0.1 s."""
    command = np.repeat([0.0, 5.0, -5.0, 0.0], 20)
    actual = Actuator(10.0).follow(command, 0.02, 0.005) - command
    trial = servo_change("lag", Actuator(None), command, 0.02, lag_s=0.1)
    np.testing.assert_allclose(0.1 * trial, actual, atol=1e-12)
    small = servo_change("lag", Actuator(None), command, 0.02)
    assert np.abs(np.corrcoef(small, actual)[0, 1]) < 0.7


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_a_slow_servo_is_named_from_commands_alone(glider, tmp_path):
    """The lag of an elevator without an actuator; the log has no position."""
    truth = with_effects(glider, tmp_path, elevator_lag=0.1)
    paths = []
    for k, (speed, mission) in enumerate(((30, "doublets"), (36, "3-2-1-1"), (33, "doublets"))):
        path = tmp_path / f"{k}.parquet"
        words = ["--mission", mission, "--speed-mps", str(speed), "--altitude-m", "500", "--noise"]
        words += ["--duration-s", "30", "--seed", str(41 + k), "--out", str(path)]
        assert main(["fly", str(truth.folder), *words]) == 0
        record = FlightRecord.read(path)
        columns = {c: v for c, v in record.columns.items() if "_pos_" not in c}
        replace(record, columns=columns).write(path)
        paths.append(str(path))
    out = tmp_path / "refined"
    words = ["--train", *paths[:2], "--test", paths[2], "--out", str(out)]
    words += ["--no-pbox", "--no-figures", "--workers", "1"]
    assert main(["refine", str(glider.folder), *words]) == 0
    (effect,) = json.loads((out / "refinement.json").read_text())["effects"]
    assert (effect["subsystem"], effect["term"]) == ("actuator.elevator", "lag")
    assert abs(effect["value"] - 10.0) < 3.0 * effect["std"]


def test_a_rate_limit_counts_in_the_unit_of_the_actuator_that_is_added(glider):
    """The former position's unit is not that of the new actuator, which is normalised."""
    inputs = dict(glider.card.inputs)
    unit = {"position": "fcs/effective-aileron-pos", "position_unit": "rad"}
    inputs["aileron"] = inputs["aileron"].model_copy(update=unit)
    aircraft = replace(glider, card=glider.card.model_copy(update={"inputs": inputs}))
    name, unit_deg = servo_property(aircraft, "aileron")
    assert name == "fcs/aileron-servo-norm"
    assert unit_deg == pytest.approx(abs(inputs["aileron"].throw_deg))
