"""Refinement in turbulence: sensors in step with each other, regressors that inertia and air ask
for, which rival flies best.
"""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.linalg import expm

from sysid.aerodynamics import flow_by_wind, rates, with_gust_states
from sysid.aerodynamics.air_motion import GustStates
from sysid.aerodynamics.coefficients import MassProperties
from sysid.aerodynamics.rigid_body import OUTPUTS as STEP_OUTPUTS
from sysid.aerodynamics.rigid_body import STATES, Reference, Steps, linearise
from sysid.effects import turbulence
from sysid.effects.catalogue import subsystem_effects
from sysid.effects.turbulence import Score
from sysid.parallel import SERIAL
from sysid.units import FT_M
from tests.helpers.batch_flights import DT_S, aircraft, craft
from tests.helpers.flown import fly as flown
from tests.helpers.sixdof import Airframe
from tests.hidden_effects.flights import Flight, fly
from tests.hidden_effects.manoeuvres import card
from uqharness.identification.linearised import prediction_error as refine_gusts
from uqharness.identification.linearised import stage_models
from uqharness.identification.linearised.flight_data import ModelState, make_flight_data
from uqharness.identification.linearised.linearise import (
    Probe,
    control_delay_regressor,
    effect_columns,
    with_sensor_errors,
)
from uqharness.identification.linearised.prediction_error import (
    aligned_outputs,
    delay_rows,
    shift_rows,
    with_equal_readings,
)
from uqharness.identification.linearised.replay_fit import (
    apply_step,
    positions,
    slopes_of,
    step_from,
    steps_of,
)
from uqharness.replay.flights import prepare, read_flights
from uqharness.replay.model import ReplayFolder
from uqharness.simulator import engine
from uqharness.simulator.aircraft import find_aircraft

OUTPUTS = ("V_mps", "alpha_rad", "ax_mps2")
N, DT = 40, 0.02
MASS = MassProperties(
    21.0, np.array([[11.1, 0.0, -0.5], [0.0, 7.7, 0.0], [-0.5, 0.0, 18.4]]), 1.38, 0.38, 3.66
)


def point(**sensed: float) -> ModelState:
    return ModelState(
        {}, {}, (), {f"effect/sensor.{k.replace('__', '/')}": v for k, v in sensed.items()}
    )


def data_of(measured: np.ndarray) -> SimpleNamespace:
    segment = SimpleNamespace(flight="one", dt_s=DT)
    return SimpleNamespace(
        outputs=OUTPUTS,
        measured=(measured,),
        segments=(segment,),
        output_rows=[0, 1, 8],
        servos={},
        trial_rate_limits={},
    )


@pytest.mark.parametrize("rows", [0, 3, -2, 50, -50])
def test_rows_are_moved_whole_and_leave_nothing_behind(rows):
    values = np.arange(10.0)
    result = shift_rows(values, rows)
    reference = np.isfinite(result)
    assert reference.sum() == max(0, 10 - abs(rows))
    np.testing.assert_array_equal(result[reference], (np.arange(10.0) - rows)[reference])


def test_a_path_goes_with_the_sensors_that_measured_it():
    """An airspeed sensor that reads a quarter too much, a gyro with a bias: the states change, what
    was measured stays.
    """
    x = np.abs(np.random.default_rng(2).standard_normal((N, len(STATES)))) + 1.0
    data = data_of(np.zeros((N, 3)))
    before = replace(
        point(V_mps__scale=0.1, alpha_rad__bias=0.02), nuisance={"bias/one/q_radps": 0.01}
    )
    after = replace(
        point(V_mps__scale=0.25), nuisance={"bias/one/q_radps": -0.03, "bias/other/q_radps": 9.0}
    )
    (result,) = with_equal_readings(data, [x], before, after)  # type: ignore[arg-type]
    V, alpha, q = (STATES.index(c) for c in ("V_mps", "alpha_rad", "q_radps"))
    np.testing.assert_allclose(1.25 * result[:, V], 1.1 * x[:, V])
    np.testing.assert_allclose(result[:, alpha], x[:, alpha] + 0.02)
    np.testing.assert_allclose(result[:, q], x[:, q] + 0.04)
    remainder = [k for k in range(len(STATES)) if k not in (V, alpha, q)]
    np.testing.assert_allclose(result[:, remainder], x[:, remainder])


def test_a_late_sensor_is_compared_with_what_it_was_to_measure():
    """A vane 95 ms late: four whole rows in the record, the rest along the curve."""
    t = DT * np.arange(N)
    truth = np.column_stack([20.0 + t, np.sin(6.0 * t), np.cos(t)])
    record = truth.copy()
    record[:, 1] = np.sin(6.0 * (t - 0.095))
    data, present = data_of(record), point(alpha_rad__delay=0.095)
    (segment,) = data.segments
    late = delay_rows(data, segment, present)
    assert late == {"V_mps": 0, "alpha_rad": 5, "ax_mps2": 0}
    (z,) = aligned_outputs(data, present)
    model = with_sensor_errors(
        truth.copy(),
        data,
        segment,
        present,
        shifted_rows=late,
        behind=-0.25 * np.gradient(truth, axis=0),
    )
    inside = slice(8, N - 8)
    np.testing.assert_allclose(z[inside], model[inside], atol=1.5e-3)
    np.testing.assert_allclose(model[inside, 1], np.sin(6.0 * (t + 0.005))[inside], atol=1.5e-3)
    # As the record has it, the sample is far from the state of its row.
    assert np.abs(record - model)[inside, 1].max() > 0.3
    assert np.isnan(z[-5:, 1]).all()
    np.testing.assert_array_equal(z[:, [0, 2]], record[:, [0, 2]])


@pytest.mark.parametrize("late", [0.34, -0.5])
def test_a_sensor_late_by_a_part_of_a_row_sees_the_states_of_then(late):
    """Beside the fractional power of what takes states from row to row, one of which it damps by a
    third.
    """
    rng = np.random.default_rng(8)
    turn = 0.1 * rng.standard_normal((3, 3)) - np.diag([0.4, 0.2, 0.0])
    phi, H = expm(turn), rng.standard_normal((N, 3, 3))
    steps = Steps(
        DT,
        np.tile(phi, (N - 1, 1, 1)),
        np.tile(expm(0.5 * turn).T, (N - 1, 1, 1)),
        *(np.zeros((N - 1, 3, 6)),) * 2,
        np.zeros((N - 1, 3)),
        H,
        H,
        np.zeros((N, 3)),
    )
    result = refine_gusts.output_matrix_between_rows(steps, [0, 2], [late, 0.0])
    expected = H[:, 0] @ expm(-late * turn)
    assert np.abs(result[:, 0] - expected).max() < np.abs(H[:, 0] - expected).max() / 100.0
    np.testing.assert_array_equal(result[:, 1:], H[:, 1:])


@pytest.mark.parametrize("late", [0.4, -0.4])
def test_outputs_between_rows_go_as_the_model_moves_them_however_the_reference_jumps(late):
    """States of a roll that 12 1/s damps, at 25 Hz, beside the model's own steps to there, which
    controls move; by the rate at the row alone they are off by ten times as much."""
    rng = np.random.default_rng(6)
    probe, active, h = probe_of(rng), GustStates(MASS.b), 2.0 * DT
    slopes = np.zeros((N, 6, 6))
    slopes[:, 3, 3] = -12.0 * MASS.inertia[0, 0]
    rolled = replace(
        probe.reference,
        dt_s=h,
        slopes=slopes,
        consistent=False,
        x=0.3 * probe.reference.x + [14.0, *[0.0] * 7],
    )
    probe = replace(probe, reference=rolled)
    names = ("beta_rad", "p_radps", "az_mps2")
    index = [STEP_OUTPUTS.index(n) for n in names]
    segment = SimpleNamespace(flight="one", dt_s=h)
    data = SimpleNamespace(
        outputs=names, output_rows=index, segments=(segment,), measured=(np.zeros((N, 3)),)
    )
    linear = refine_gusts._LinearSystems(data, SimpleNamespace(point=point()), [probe], SERIAL)  # type: ignore[arg-type]
    steps = linearise(rolled, probe.mass, gusts=active)
    y = steps.y_ref[:, index]
    behind = linear._behind(probe, steps, y, active, np.array([late, late, 0.0]))
    x = with_gust_states(rolled.x, active)

    def after(part: float, at: np.ndarray) -> np.ndarray:
        """States that the model takes in a part of each step, in many small ones; loads are on
        straight lines between the rows.
        """
        many = 200
        for j in range(many):
            share = part * j / many
            r = replace(
                rolled,
                **{
                    n: (v := getattr(rolled, n))[:-1] + share * np.diff(v, axis=0)
                    for n in ("x", "force", "moment")
                },
            )
            r = replace(r, slopes=slopes[:-1])
            at = at + part * h / many * rates(r, probe.mass, at, gusts=active)
        return at

    # Late ones are where the step before began to go to its end, but for what the row did not
    # predict.
    ends = after(1.0, x[:-1])
    expected = x[:-1] - after(-late, x[:-1]) if late < 0.0 else ends - after(1.0 - late, x[:-1])
    rows = slice(0, N - 1) if late < 0.0 else slice(1, N)
    expected = expected[:, [STATES.index(n) for n in names[:2]]]
    by_rate = (
        late
        * h
        * rates(rolled, probe.mass, x, gusts=active)[rows][:, [STATES.index(n) for n in names[:2]]]
    )
    assert np.abs(behind[rows, :2] - expected).max() < 0.1 * np.abs(by_rate - expected).max()
    # The reference's own differences are its jumps, here much larger than anything that moves.
    assert np.abs(np.diff(y[:, 0])).max() > 10.0 * np.abs(behind[:, 0]).max()
    np.testing.assert_array_equal(behind[:, 2], 0.0)
    # A force that a control alone changes goes with the control, between its rows.
    flat = replace(
        probe, reference=replace(rolled, x=np.tile(rolled.x[:1], (N, 1)), consistent=True)
    )
    steps = linearise(flat.reference, flat.mass, gusts=active)
    y = steps.y_ref[:, index]
    result = linear._behind(flat, steps, y, active, np.array([0.0, 0.0, 1e-6]))
    first = h * rates(
        flat.reference, flat.mass, with_gust_states(flat.reference.x, active), gusts=active
    )
    ended = -first[:-1]
    steady = np.einsum("nj,nj->n", steps.H[1:, index[2]], ended)
    np.testing.assert_allclose(1e6 * result[1:, 2], np.diff(y[:, 2]) + steady, rtol=1e-4, atol=1e-4)


def probe_of(rng: np.random.Generator) -> Probe:
    """Of a replay."""
    x = np.column_stack([20.0 + 0.1 * np.arange(N) / N, *(0.1 * rng.standard_normal((7, N)))])
    loads = rng.standard_normal((N, 6))
    reference = Reference(
        DT, x, loads[:, :3], loads[:, 3:], np.zeros((N, 6, 6)), np.full(N, 245.0), np.zeros(3), True
    )
    none, rate = np.zeros((N, 3)), np.gradient(x, DT, axis=0)
    return Probe(
        reference,
        MASS,
        rng.standard_normal((N, 6)),
        none,
        none,
        np.zeros((N, 6, 4)),
        np.zeros((N, 4)),
        np.zeros(N),
        np.full(N, np.inf),
        x,
        x,
        rate,
        rate[:, 1:3],
    )


def predicted_of(rng: np.random.Generator) -> Probe:
    """In turbulence."""
    (body, x, rate), flow_rate, probe = (
        rng.standard_normal((3, N, 8)),
        rng.standard_normal((N, 2)),
        probe_of(rng),
    )
    reference = replace(probe.reference, consistent=False)
    return replace(probe, reference=reference, body=body, x=x, rate=rate, flow_rate=flow_rate)


def test_inertia_does_not_know_the_airs_rotation():
    rng = np.random.default_rng(1)
    probe = predicted_of(rng)
    (ixz,) = [e for e in subsystem_effects([], [], []) if e.term == "Ixz"]
    data, flight = (
        data_of(np.zeros((N, 3))),
        SimpleNamespace(outputs=[np.zeros((N, 3))], point=point()),
    )
    (columns,) = effect_columns(data, [probe], flight, [ixz])  # type: ignore[arg-type]
    _, result = columns.inputs[ixz.key]
    (p, q, r), (dp, _, dr) = probe.body[:, 3:6].T, probe.rate[:, 3:6].T
    moment = np.column_stack([dr + p * q, r**2 - p**2, dp - q * r])
    np.testing.assert_allclose(
        result[:, 3:], moment / (245.0 * MASS.S * np.array([MASS.b, MASS.c, MASS.b]))
    )


def test_coefficients_know_the_airs_rotation_and_not_its_acceleration():
    rng = np.random.default_rng(2)
    present = predicted_of(rng)
    variables = present.variables()
    V = present.x[:, 0]
    np.testing.assert_allclose(variables["p_hat"], present.x[:, 3] * 0.5 * MASS.b / V)
    np.testing.assert_allclose(
        variables["alphadot_hat"], present.flow_rate[:, 0] * 0.5 * MASS.c / V
    )
    np.testing.assert_allclose(variables["betadot_hat"], present.flow_rate[:, 1] * 0.5 * MASS.b / V)


def test_a_delay_takes_the_models_rate_in_gusts_and_the_outputs_own_in_calm_air():
    rng = np.random.default_rng(3)
    probe, ramp = predicted_of(rng), 3.0 * DT * np.arange(N)
    np.testing.assert_array_equal(
        probe.rate_of("alpha_rad", ramp), probe.rate[:, STATES.index("alpha_rad")]
    )
    np.testing.assert_allclose(probe.rate_of("ax_mps2", ramp)[1:], 3.0)
    np.testing.assert_allclose(probe_of(rng).rate_of("alpha_rad", ramp), 3.0)


def test_what_a_scale_does_is_the_slope_of_what_the_sensor_says():
    rng = np.random.default_rng(4)
    truth = rng.standard_normal((N, 3))
    data = data_of(np.zeros((N, 3)))
    (segment,) = data.segments
    (scale,) = [
        e
        for e in subsystem_effects([], ["alpha_rad"], [])
        if (e.subsystem, e.term) == ("sensor.alpha_rad", "scale")
    ]

    def read(size: float) -> np.ndarray:
        return with_sensor_errors(
            truth.copy(), data, segment, point(alpha_rad__scale=size, alpha_rad__bias=0.4)
        )  # type: ignore[arg-type]

    local = point(alpha_rad__scale=0.8, alpha_rad__bias=0.4)
    flight = SimpleNamespace(outputs=[read(0.8)], point=local)
    (columns,) = effect_columns(data, [probe_of(rng)], flight, [scale])  # type: ignore[arg-type]
    np.testing.assert_allclose(
        columns.outputs[scale.key], (read(0.8 + 1e-6) - read(0.8 - 1e-6)) / 2e-6, atol=1e-8
    )


def test_a_sensor_that_reads_more_reads_more_of_everything():
    rng = np.random.default_rng(5)
    probe, data = probe_of(rng), data_of(np.zeros((N, 3)))
    plain, scaled = (
        steps_of(slopes_of([probe]), [None], data, at)[0]
        for at in (point(), point(alpha_rad__scale=0.8))
    )  # type: ignore[arg-type]
    np.testing.assert_allclose(scaled.H[:, 1], 1.8 * plain.H[:, 1])
    np.testing.assert_array_equal(np.delete(scaled.H, 1, axis=1), np.delete(plain.H, 1, axis=1))
    np.testing.assert_array_equal(scaled.phi, plain.phi)


def test_noise_that_no_filter_can_follow_is_not_the_likeliest(monkeypatch):
    """No filter follows above a noise of one, where the first step leads: the search ends at the
    optimum below.
    """
    calls: list[float] = []

    class Made:
        def __init__(self, steps, measured, index, by):
            pass

        def __call__(self, noise, process, slopes=True):
            calls.append(float(noise[0]))
            offset = np.log(noise[0]) + 1.0
            fails = noise[0] > 1.0
            none = np.zeros((1, 13))
            slope = np.zeros(1) if fails else np.array([1000.0 * offset])
            return Score(
                np.inf if fails else 500.0 * offset**2,
                slope,
                none,
                none,
                (np.array([100.0]), none, none),
            )

    monkeypatch.setattr("sysid.effects.turbulence.AirLikelihood", Made)
    search = turbulence._Search(
        lambda some, states: [None], [np.zeros((2, 1))], [0], np.ones(1), [20.0], SERIAL
    )  # type: ignore
    result = search.descend(
        [0], turbulence._Point((GustStates(3.0),), np.ones(9), np.array([0.1])), ["wind"]
    )
    assert max(calls) > 1.0
    assert result.factors[0] == pytest.approx(np.exp(-1.0), rel=0.05)


@pytest.mark.parametrize(
    ("gain", "shares"),
    [(2.5, [1.0, 0.4]), (0.4, [1.0, 2.5]), (1.0, [1.0]), (20.0, [1.0, 0.125]), (0.1, [1.0, 4.0])],
)
def test_steps_too_long_are_shortened_and_those_too_short_lengthened(gain, shares):
    """Of steps that go so many times as far as they should, the second is right, within bounds;
    lengths in standard errors.
    """
    information = np.array([[4.0, 1.0], [1.0, 9.0]])
    x, answer, share, before, selected = np.zeros(2), np.array([1.0, -3.0]), 1.0, None, []
    for _ in shares:
        step = gain * (answer - x)
        share = 1.0 if before is None else refine_gusts.step_share(share, before, step, information)
        x, before = x + share * step, step
        selected.append(share)
    assert selected == pytest.approx(shares)
    if gain in (2.5, 0.4, 1.0):
        np.testing.assert_allclose(x, answer)


def test_shares_of_jumps_stay_between_none_and_all():
    """A step beyond an end is held back there, and what the others do is asked without it."""
    data = SimpleNamespace(
        active=(),
        fixed_effects=[],
        jumping=("f", "g"),
        nuisance=("unseen/f", "unseen/g"),
        lower_bounds={},
    )
    request = []

    def step(constant):
        request.append(constant)
        return np.array([0.3, 0.3]), 1.0

    information = SimpleNamespace(names=("unseen/f", "unseen/g"), step=step)
    point = ModelState({}, {"unseen/f": 1.0, "unseen/g": 0.9}, ())
    step_from(data, point, information)  # type: ignore[arg-type]
    assert request == [[], ["unseen/f"]]
    moved = apply_step(data, point, {"unseen/f": -0.2, "unseen/g": 0.3}, {})  # type: ignore[arg-type]
    assert moved.nuisance == {"unseen/f": 0.8, "unseen/g": 1.0}


def test_a_rate_limit_stays_where_it_is_felt():
    """Beyond, nothing changes: it ends there, and the others are asked without it."""
    key = "effect/actuator.aileron/rate_limit"
    effect = SimpleNamespace(key=key)
    data = SimpleNamespace(
        active=(effect,),
        fixed_effects=[],
        jumping=(),
        nuisance=(),
        lower_bounds={key: -0.02},
        carriers={key: None},
    )
    request = []
    information = SimpleNamespace(
        names=(key,), step=lambda constant: request.append(constant) or (np.array([-0.03]), 1.0)
    )
    inside, at_end = (ModelState({}, {}, (), {key: value}) for value in (-0.01, -0.02))
    step_from(data, inside, information)  # type: ignore[arg-type]
    step_from(data, at_end, information)  # type: ignore[arg-type]
    assert request == [[], [], [key]]
    assert apply_step(data, inside, {key: -0.03}, {}).effects == {key: -0.02}  # type: ignore[arg-type]
    assert apply_step(data, inside, {key: 0.03}, {}).effects == {key: pytest.approx(0.02)}  # type: ignore[arg-type]


@pytest.mark.parametrize("late_s", [0.011, -0.0263])
def test_surfaces_stand_where_commands_that_act_late_have_them(late_s):
    """Predictions' positions beside those of the same flight with its commands recorded when they
    acted; moved by their slopes from the rows alone, they are off by a twentieth of their travel.
    """
    aircraft = find_aircraft("espaaro")
    flight = prepare("f", flown((("pitch-doublet", 22.0),), seed=1, seconds=8.0), ())
    data = make_flight_data(aircraft, [flight], ())
    with ReplayFolder(aircraft) as model:
        paths = refine_gusts.ControlPaths(model, data)
        result, _ = paths.at(ModelState({}, {"lateness/f/controls": late_s}, ()))
        expected = positions(
            model, make_flight_data(aircraft, [flight.with_delayed_commands(late_s)], ())
        )
        rows = positions(model, data)
        in_time, _ = paths.at(ModelState({}, {}, ()))
    np.testing.assert_array_equal(in_time, rows)
    for one, other, at_rows in zip(result, expected, rows, strict=True):
        rough = at_rows - late_s * np.gradient(at_rows, DT, axis=0)
        assert np.abs(one - other)[3:].max() < 0.03
        assert np.abs(rough - other)[3:].max() > 0.2


def test_where_surfaces_stand_goes_with_how_late_commands_act_without_a_step():
    """Half-way between two places, a little to either side is the same; from place to place the
    whole way is gone.
    """
    aircraft = find_aircraft("espaaro")
    flight = prepare("f", flown((("pitch-doublet", 22.0),), seed=1, seconds=8.0), ())
    data, step = make_flight_data(aircraft, [flight], ()), refine_gusts.DELAY_GRID * DT
    with ReplayFolder(aircraft) as model:
        paths = refine_gusts.ControlPaths(model, data)

        def at(places):
            point = ModelState({}, {"lateness/f/controls": places * step}, ())
            return np.concatenate(paths.at(point)[0])

        way = np.abs(at(1.0) - at(0.0)).max()
        for places in (0.0, 0.5, 1.0, -1.0):
            assert np.abs(at(places + 1e-3) - at(places - 1e-3)).max() < 0.004 * way


def test_a_jump_that_comes_later_is_lacking_from_its_row_on():
    """The time by which controls act late, as a column and as it is flown: by slope and by
    difference the same.
    """
    u = np.tile([1.0, 0.0, 0.0, 55.0], (N, 1))
    u[6:, 0] += 4.0
    u[:, 1] = 0.3 * np.arange(N)
    # What jumps is lacking at its row, what moves steadily everywhere.
    change = (
        np.column_stack([-np.diff(u[:, 0], prepend=u[0, 0]), -np.gradient(u[:, 1]), 0.0 * u[:, 2:]])
        / DT
    )
    probe = probe_of(np.random.default_rng(3))
    jumped = np.zeros((N, 4))
    steady = np.repeat(np.random.default_rng(4).standard_normal((1, 6, 4)), N, axis=0)
    jumped[6, 0] = 4.0
    jumping = replace(probe, controls=u, jumped=jumped, by_control=steady)
    slopes = np.einsum("ncj,nj->nc", steady, change)
    impulse, remainder = slopes[6] - slopes[5], np.tile(slopes[5], (N, 1))
    for late_s, share in ((1e-3, 1.0), (0.0, 0.5), (-1e-3, 0.0)):
        (_, values), ends, sensed = control_delay_regressor(jumping, late_s)
        begin, end = (values - remainder)[:-1], (ends - remainder)[1:]
        # In the step after the row, or before it, its centre at the row itself; the row's
        # accelerometers see nothing of it.
        expected = np.zeros((N - 1, 6))
        expected[5], expected[6] = (1.0 - share) * impulse, share * impulse
        np.testing.assert_allclose(0.5 * (begin + end), expected, atol=1e-9)
        np.testing.assert_allclose((begin + 2.0 * end)[6] / 6.0, 0.0, atol=1e-9)
        np.testing.assert_allclose((2.0 * begin + end)[5] / 6.0, 0.0, atol=1e-9)
        np.testing.assert_allclose(sensed, remainder, atol=1e-9)


def test_wind_in_jsbsims_rates_of_alpha_and_beta():
    """In a steady wind they differ from the derivatives of alpha and beta, in turns."""
    names = ("alpha", "beta")
    with craft(aircraft("<aerodynamics/>")) as model:
        fdm = model.open()
        engine.run_ic(fdm)
        fdm["atmosphere/wind-north-fps"], fdm["atmosphere/wind-east-fps"] = 15.0, -20.0
        rows = []
        for _ in range(160):
            fdm.run()
            angles = [fdm[f"attitude/{n}-rad"] for n in ("phi", "theta", "psi")]
            air = [FT_M * fdm["velocities/vt-fps"], *(fdm[f"aero/{n}-rad"] for n in names)]
            body_rates = [fdm[f"velocities/{n}-rad_sec"] for n in "pqr"]
            ground = [FT_M * fdm[f"velocities/v-{n}-fps"] for n in ("north", "east", "down")]
            flow = [fdm[f"aero/{n}dot-rad_sec"] for n in names]
            rows.append([*air, *body_rates, *angles, *ground, *flow])
    series = np.array(rows)
    by_wind = flow_by_wind(series[:, :8], *series[:, 8:12].T, DT_S)
    excess = series[:, 12:] - np.gradient(series[:, 1:3], DT_S, axis=0)
    middle = slice(60, -60)
    assert np.abs(excess[middle]).min(axis=0).max() > 0.01
    np.testing.assert_allclose(by_wind[middle], excess[middle], atol=0.003)


def test_controls_start_in_time_if_replays_in_turbulence_have_them_early(tmp_path):
    """Replays of a flight in gusts took controls to act 0.12 s early. The filter stayed there, in
    other air, with Cl_da seven standard errors off.
    """
    aircraft, path = find_aircraft("espaaro"), tmp_path / "one.parquet"
    (record,) = fly([Flight(card(1, 22.0, seconds=14.0, w20_kt=12.0), Airframe(), ())])
    record.write(path)
    data = make_flight_data(aircraft, *read_flights([path], aircraft, align=False))
    starts = tuple(s.start for s in data.segments)
    early = {n: -0.12 if n.startswith("lateness/") else 0.0 for n in data.nuisance}
    with stage_models(aircraft, data) as models:
        fit = refine_gusts.gust_refit(
            models, data, ModelState({}, early, starts), (), {}, SERIAL, iterations=1
        )
    point = fit.fit.trajectory.point
    assert all(point.nuisance[n] == 0.0 for n in early)
