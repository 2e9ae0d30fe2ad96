"""Controls between rows: where surfaces without a lag stand, and what accelerometers feel of their
jumps or have not seen.
"""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from sysid.estimation import MeasuredSystem, gains, whiten_innovations
from sysid.parallel import SERIAL
from tests.uqharness.identification.linearised.test_gusts import DT, MASS, N, probe_of
from uqharness.identification.linearised import linearise
from uqharness.identification.linearised.flight_data import (
    FlightData,
    ModelState,
    StagedModels,
    jump_share_name,
)
from uqharness.identification.linearised.replay_fit import fit_at, replay_at
from uqharness.replay import CONTROLS, JUMPING_CHANNELS
from uqharness.replay.model import ReplayFolder
from uqharness.replay.segments import Commands, Segment
from uqharness.simulator.aircraft import find_aircraft


def test_a_surface_without_a_lag_stands_where_it_stood_until_the_next_row():
    """Elevator straight through, the others with their servos: how far paths are from straight
    lines, at middles and ends.
    """
    aircraft = find_aircraft("espaaro")
    controls = np.tile([1.0, 0.0, 0.0, 55.0], (12, 1))
    controls[6:, :2] += 4.0
    segment = Segment(
        "step",
        "f",
        0.02 * np.arange(12),
        controls,
        np.array([22.0, 0.03, *np.zeros(7)]),
        100.0,
        100.0,
    )
    with ReplayFolder(aircraft, ideal=("elevator",)) as model:
        (offset,) = linearise.path_deviations(model, SimpleNamespace(segments=[segment]))
    middle, end = offset
    expected = np.zeros(11)
    expected[5] = -4.0
    assert end[:, 0] == pytest.approx(expected, abs=1e-9)
    assert middle[:, 0] == pytest.approx(0.5 * expected, abs=1e-9)
    # A servo is nowhere in two places: at a step's end it is where the next row has it.
    assert not end[:, 1:].any()
    assert np.abs(middle[6:, 1]).max() > 0.01


def test_commands_between_rows_leave_the_middle_the_area_of_their_path():
    """The elevator jumps a third of the way through a row: Simpson's rule over start, middle and
    end has two thirds of the jump.
    """
    aircraft = find_aircraft("espaaro")
    fine = np.tile([1.0, 0.0, 0.0, 55.0], (31, 1))
    fine[16:, 0] += 4.0
    segment = Segment(
        "step",
        "f",
        0.03 * np.arange(11),
        fine[::3],
        np.array([22.0, 0.03, *np.zeros(7)]),
        100.0,
        100.0,
    )
    with ReplayFolder(aircraft, ideal=("elevator",)) as model:
        (between,) = linearise.path_deviations(
            model, SimpleNamespace(segments=[replace(segment, commands=Commands(3, fine))])
        )
        (averaged,) = linearise.path_deviations(model, SimpleNamespace(segments=[segment]))
    rows = fine[::3, 0]

    def area(offset):
        middle, end = offset[0][:, 0] + 0.5 * (rows[:-1] + rows[1:]), offset[1][:, 0] + rows[1:]
        return (rows[:-1] + 4.0 * middle + end) / 6.0

    assert area(between)[5] == pytest.approx(1.0 + 4.0 * 2.0 / 3.0)
    assert area(averaged)[5] == pytest.approx(1.0)


def test_what_accelerometers_feel_of_a_jump_is_force_over_mass_and_the_turn_at_their_arm():
    probe = probe_of(np.random.default_rng(7))
    jumped, by_control = np.zeros((N, 4)), np.zeros((N, 6, 4))
    jumped[5, 0], jumped[6, 1] = 2.0, -1.0
    by_control[:, 2, 0], by_control[:, 4, 1] = -0.05, -0.05
    reference = replace(probe.reference, arm_m=np.array([0.2, 0.0, 0.0]))
    probe = replace(probe, jumped=jumped, by_control=by_control, reference=reference)
    sensed = probe.felt_jump()
    pressure = probe.reference.qbar * MASS.S
    assert sensed[5] == pytest.approx([0.0, 0.0, -0.1 * pressure[5] / MASS.mass])
    # A pitching moment turns an accelerometer ahead of the CG up: z is down.
    assert sensed[6] == pytest.approx(
        [0.0, 0.0, -0.2 * 0.05 * pressure[6] * MASS.c / MASS.inertia[1, 1]]
    )
    assert not replace(probe, jumped=None).felt_jump().any()


@pytest.mark.parametrize("ideal", [("elevator",), CONTROLS])
def test_what_is_unseen_of_a_jump_is_what_a_replay_lacks_without_it(ideal):
    """The column in calm air beside the difference of two replays: accelerometers that have seen
    the jump of a row, and that have not. Nothing of it where every control has its servo."""
    aircraft = find_aircraft("espaaro")
    controls = np.tile([-1.0, 0.0, 0.0, 55.0], (25, 1))
    controls[8:, 0] += 4.0
    controls[15:, 1] -= 3.0
    outputs = (*JUMPING_CHANNELS, "q_radps")
    arm = (0.1, 0.0, 0.05)
    segment = Segment(
        "step",
        "f",
        DT * np.arange(25),
        controls,
        np.array([22.0, 0.03, *np.zeros(7)]),
        100.0,
        100.0,
        arm_m=arm,
    )
    blank = np.zeros((25, len(outputs)))
    data = FlightData(
        (), (segment,), ({},), outputs, (blank,), np.ones(len(outputs)), (), {}, jumping=("f",)
    )
    with (
        ReplayFolder(aircraft, ideal=ideal) as model,
        ReplayFolder(aircraft, ideal=CONTROLS) as level,
    ):
        observed, lacking = (
            replay_at(
                model,
                data,
                ModelState({}, {jump_share_name("f"): share}, (segment.start,)),
                SERIAL,
            )
            for share in (0.0, 1.0)
        )
        fit = fit_at(StagedModels(model, level), data, ("aero/Cm_q",), observed, SERIAL)
        with ReplayFolder(aircraft) as servos:
            assert not linearise.path_deviations(servos, data, observed.point)[0][1].any()
    expected = lacking.outputs[0] - observed.outputs[0]
    result = fit.columns[0].outputs[jump_share_name("f")]
    assert np.abs(expected).max() > 0.5
    np.testing.assert_allclose(result, expected, atol=0.02 * np.abs(expected).max())


@pytest.mark.parametrize("share", [0.0, 1.0])
def test_columns_of_what_goes_with_a_surface_know_when_it_jumps(share):
    """Beside the difference of two replays: terms of a surface that stands at once where it is
    asked to, with accelerometers that have seen the jump of a row, or have not. With surfaces that
    came in straight lines columns are 4 to 80 % off."""
    aircraft = find_aircraft("espaaro")
    controls = np.tile([-1.0, 0.0, 0.0, 55.0], (25, 1))
    controls[8:12, 0] += 4.0
    controls[15:19, 1] -= 3.0
    outputs = (*JUMPING_CHANNELS, "p_radps", "q_radps", "r_radps")
    segment = Segment(
        "step",
        "f",
        DT * np.arange(25),
        controls,
        np.array([22.0, 0.03, *np.zeros(7)]),
        100.0,
        100.0,
    )
    noise = np.array([0.05, 0.05, 0.05, 0.002, 0.002, 0.002])
    data = FlightData(
        (), (segment,), ({},), outputs, (np.zeros((25, 6)),), noise, (), {}, jumping=("f",)
    )
    names = ("aero/Cm_de", "aero/CZ_de", "aero/Cl_da", "aero/Cn_da")
    with (
        ReplayFolder(aircraft, ideal=CONTROLS[:3]) as model,
        ReplayFolder(aircraft, ideal=CONTROLS) as level,
    ):
        fdm = model.open(DT)
        values = {n: float(fdm[n]) for n in names}
        point = ModelState(values, {jump_share_name("f"): share}, (segment.start,))
        fit = fit_at(
            StagedModels(model, level), data, names, replay_at(model, data, point, SERIAL), SERIAL
        )
        (of,), (steps,) = fit.columns, fit.steps
        observed = MeasuredSystem.of(steps, data.measured[0], data.output_rows)
        by = gains(observed, noise, None)
        result = whiten_innovations(observed, by, names, of.inputs, {}, of.ends, of.seen).columns
        ramped = whiten_innovations(observed, by, names, of.inputs, {}).columns
        for k, name in enumerate(names):
            step = 0.02 * values[name]
            sides = [
                replay_at(
                    model, data, replace(point, values={**values, name: values[name] + s}), SERIAL
                )
                for s in (step, -step)
            ]
            expected = (sides[0].outputs[0] - sides[1].outputs[0]) / (2.0 * step) / noise
            error, before = (
                np.linalg.norm(v[:, :, k] - expected) / np.linalg.norm(expected)
                for v in (result, ramped)
            )
            assert error < 0.01 < 0.03 < before


def test_flights_jump_where_the_models_controls_do():
    controls = np.tile([-1.0, 0.0, 0.0, 55.0], (4, 1))
    segment = Segment(
        "step", "f", DT * np.arange(4), controls, np.array([22.0, 0.03, *np.zeros(7)]), 100.0, 100.0
    )
    data = FlightData(
        (),
        (segment,),
        ({},),
        ("q_radps",),
        (np.zeros((4, 1)),),
        np.ones(1),
        (),
        {},
        jumping=("stale",),
    )
    aircraft = find_aircraft("espaaro")
    with ReplayFolder(aircraft, ideal=("elevator",)) as at_once, ReplayFolder(aircraft) as servos:
        assert linearise.with_jumping_flights(data, at_once).jumping == ("f",)
        assert linearise.with_jumping_flights(data, servos).jumping == ()
        # A sensor that is late says nothing of what a row has seen.
        assert (
            linearise.with_jumping_flights(
                replace(data, delayed_sensors={"f": ["gyros"]}), at_once
            ).jumping
            == ()
        )


def test_forces_between_rows_are_the_models_own(monkeypatch):
    """Rolling moment with the aileron cubed and the airspeed squared. An aileron that jumps from 0
    to 8 lacks 512 before its row; by its slope behind the jump it would lack 1,536."""

    def loads(x, u):
        return np.column_stack([u[:, 1] ** 3 + x[:, 0] ** 2, 0.0 * u[:, 0], 0.0 * u[:, 0]])

    def forced(level, request, properties, map_):
        for part in request:
            x = np.column_stack(list(part.states.values()))
            none = np.zeros((len(x), 3))
            yield SimpleNamespace(
                aero_force=none,
                other_force=none,
                aero_moment=loads(x, part.controls),
                other_moment=none,
            )

    monkeypatch.setattr(linearise, "force_all", forced)
    monkeypatch.setattr(linearise, "altitudes", lambda model, segment, height: height)
    x, u = np.full((4, 8), 20.0), np.zeros((4, 4))
    x[2:, 0], u[2:, 1], u[3, 1] = 24.0, 8.0, 6.0
    offset = np.zeros((2, 3, 4))
    offset[:, 1, 1] = -4.0, -8.0  # stands at 0 until the third row
    none = np.zeros((4, 3))
    probe = SimpleNamespace(
        reference=SimpleNamespace(x=x, force=none, moment=loads(x, u)), controls=u
    )
    data = SimpleNamespace(segments=["one"], properties=lambda point: {})
    (bend,) = linearise.load_deviations(
        None, data, SimpleNamespace(height=[np.zeros(4)], point=None), [probe], [offset], map
    )
    assert bend.shape == (2, 3, 6)
    np.testing.assert_allclose(bend[1, :, 3], [0.0, -512.0, 0.0])
    np.testing.assert_allclose(
        bend[0, :, 3],
        [0.0, 22.0**2 - 0.5 * (400.0 + 512.0 + 576.0), 7.0**3 - 0.5 * (512.0 + 216.0)],
    )
    assert not bend[:, :, :3].any()
    assert not bend[:, :, 4:].any()
