"""The examination of refine: its flights are true flights, and its effects are what they are
called.
"""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad

from tests.helpers import sixdof
from tests.helpers.sixdof import Airframe
from tests.hidden_effects.airframes import write_aircraft
from tests.hidden_effects.cases import SECOND, perturbed
from tests.hidden_effects.catalogue import IN_FORM, OFF_FORM
from tests.hidden_effects.effects import Effect
from tests.hidden_effects.flights import NOISE, Flight, fly
from tests.hidden_effects.gusts import NODE_S, turbulence
from tests.hidden_effects.manoeuvres import Manoeuvre, Pulse, card
from tests.hidden_effects.motion import Model, Servos, evaluate, trim
from uqharness.cli.main import main


def some_states(n):
    rng = np.random.default_rng(3)
    x = rng.normal(size=(12, n)) * np.array([2, 2, 2, 0.5, 0.5, 0.5, 0.3, 0.3, 1, 9, 9, 9])[:, None]
    x[0] += 22.0
    x[11] -= 80.0
    surfaces = 3.0 * rng.normal(size=(4, n))
    surfaces[3] += 60.0
    return x, surfaces


# The flights


def test_the_equations_are_those_of_the_other_integration():
    x, s = some_states(6)
    result = evaluate(Model([SECOND] * 6, [()] * 6), x, s, None).dot
    expected = np.column_stack([sixdof.derivative(SECOND, x[:, i], s[:, i]) for i in range(6)])
    np.testing.assert_allclose(result, expected, rtol=1e-12, atol=1e-12)
    other = evaluate(Model([replace(SECOND, Ixz=-SECOND.Ixz)] * 6, [()] * 6), x, s, None).dot
    assert np.abs(other - expected).max() > 0.01


def test_the_step_is_short_enough_and_a_trim_stays():
    flight = replace(card(5, 21.0, seconds=8.0, first=1), noise=0.0)
    coarse, fine = (fly([Flight(flight, Airframe())], step_s=h)[0] for h in (0.004, 0.002))
    for name, std in NOISE.items():
        assert np.abs(coarse[name] - fine[name]).max() < 0.06 * std, name
    model = Model([Airframe(), SECOND], [()] * 2)
    x, s = trim(model, np.array([20.0, 24.0]), np.array([0.0, 0.0]))
    assert np.abs(evaluate(model, x, s, None).dot[:6]).max() < 1e-9
    # Table of method.md: 1.850 deg, -0.380 deg, 53.9 percent at 20 m/s.
    assert np.degrees(x[7, 0]) == pytest.approx(1.85, abs=0.05)
    assert (s[0, 0], s[3, 0]) == (pytest.approx(-0.38, abs=0.03), pytest.approx(53.9, abs=0.4))


def test_servos_are_exact_and_their_faults_are_as_named():
    effects = [
        (),
        (Effect("actuator.elevator", "lag", 10.0),),
        (Effect("actuator.elevator", "deadband", 1.0),),
        (Effect("actuator.elevator", "rate_limit", 30.0),),
        (Effect("actuator.elevator", "backlash", 1.0),),
    ]
    model = Model([Airframe()] * 5, effects)
    servos = Servos(model, 0.002, np.zeros((4, 5)))
    command = np.zeros((4, 5))
    command[0] = 4.0
    for _ in range(50):
        servos.advance(command)
    assert servos.s[0, 0] == pytest.approx(4.0 * (1 - np.exp(-2.5)))
    assert servos.s[0, 1] == pytest.approx(4.0 * (1 - np.exp(-1.0)))
    assert servos.s[0, 2] == pytest.approx(servos.s[0, 0] - 0.5)
    assert servos.s[0, 3] == pytest.approx(3.0)
    assert servos.s[0, 4] == pytest.approx(servos.s[0, 0] - 0.5)
    for _ in range(500):
        servos.advance(-command)
    # Back from above: the dead zone takes its half from both sides, the play follows half a width
    # behind.
    assert servos.s[0, 2] == pytest.approx(-3.5, abs=1e-3)
    assert servos.s[0, 4] == pytest.approx(-3.5, abs=1e-3)
    for _ in range(500):
        servos.advance(0.0 * command)
    assert servos.s[0, 2] == pytest.approx(0.0, abs=1e-3)
    assert servos.s[0, 4] == pytest.approx(-0.5, abs=1e-3)


def test_gusts_have_the_spectra_of_the_specification():
    from uqharness.flight.dryden import dryden_psd

    V, h, b = 22.0, 100.0, 3.66
    series = np.concatenate(
        [turbulence(V, h, 15.0, b, 150.0, np.random.default_rng(k)) for k in range(8)]
    )
    for i, name in enumerate("uvwpqr"):
        top = 40.0 if name in "uvw" else 200.0
        expected = np.sqrt(
            quad(lambda w, c=name: float(dryden_psd(c, w, V, h, 15.0, b)), 0.0, top, limit=400)[0]
        )
        assert series[:, i].std() == pytest.approx(expected, rel=0.2 if name in "uv" else 0.12), (
            name
        )
    # q = -dw/dx: the air pitches down where the upward gust (negative w) grows.
    slope = np.gradient(series[:, 2], NODE_S) / V
    smooth = np.convolve(slope, np.ones(20) / 20.0, "same")
    assert np.corrcoef(smooth, series[:, 4])[0, 1] < -0.4
    assert np.corrcoef(np.gradient(series[:, 1], NODE_S), series[:, 5])[0, 1] > 0.1


@pytest.fixture(scope="module")
def plain():
    kinds = ("roll and yaw", "roll and pitch")
    return fly([Flight(card(11, 22.0, seconds=23.0, kinds=kinds), Airframe())])[0]


def compare(record, folder, aircraft="espaaro"):
    record.write(folder / "flight.parquet")
    out = folder / "gap"
    code = main(
        [
            "compare",
            str(aircraft),
            "--flight",
            str(folder / "flight.parquet"),
            "--out",
            str(out),
            "--workers",
            "1",
            "--no-figures",
        ]
    )
    return code, {
        c: row["ratio"]
        for c, row in json.loads((out / "compare.json").read_text())["channels"].items()
        if row["judged"]
    }


def test_a_flight_without_an_effect_is_at_jsbsims_noise_floor(plain, tmp_path):
    code, ratios = compare(plain, tmp_path)
    assert code == 0
    assert max(ratios.values()) < 1.07, ratios


def test_commands_one_sample_early_or_late_would_be_seen(plain, tmp_path):
    for shift in (1, -1):
        moved = plain.with_columns(
            {c: np.roll(plain[c], shift) for c in ("elevator_deg", "aileron_deg", "rudder_deg")}
        )
        folder = tmp_path / str(shift)
        folder.mkdir()
        code, ratios = compare(moved, folder)
        result = json.loads((folder / "gap" / "compare.json").read_text())
        assert code == 1
        # The delay is found and taken out, so it is the delay that says so and not the gaps.
        assert result["controls_late_s"] == pytest.approx(-0.02 * shift, abs=2e-3)
        assert not result["aligned"]
        assert max(ratios.values()) < 1.1


@pytest.mark.slow
def test_the_second_aeroplane_is_its_xml(tmp_path):
    folder = write_aircraft("second", SECOND, tmp_path)
    flight = card(12, 23.0, seconds=13.0, kinds=("roll and pitch",))
    its, other = fly(
        [Flight(flight, SECOND), Flight(flight, perturbed(SECOND, np.random.default_rng(0)))]
    )
    code, ratios = compare(its, tmp_path, folder)
    assert code == 0, ratios
    assert compare(other, tmp_path, folder)[0] == 1


def test_records_tell_nothing():
    flight = card(3, 22.0, seconds=8.0)
    minimal, hidden = fly(
        [Flight(flight, Airframe()), Flight(flight, Airframe(), (Effect("Cm", "p_hat^2", 5.0),))]
    )
    assert minimal.metadata == hidden.metadata
    assert list(minimal.columns) == list(hidden.columns)
    assert not np.array_equal(minimal["q_radps"], hidden["q_radps"])


# The effects


def test_terms_enter_as_the_vocabulary_says():
    x, s = some_states(4)
    plain_air = evaluate(Model([Airframe()] * 4, [()] * 4), x, s, None)
    qS = 0.5 * plain_air.rho * plain_air.V**2 * 1.97

    def gained(*effects):
        return evaluate(Model([Airframe()] * 4, [effects] * 4), x, s, None).dot - plain_air.dot

    p_hat = x[3] * 3.66 / (2.0 * plain_air.V)
    np.testing.assert_allclose(
        gained(Effect("Cm", "p_hat^2", 3.0))[4], qS * 0.53 * 3.0 * p_hat**2 / 8.26, rtol=1e-9
    )
    np.testing.assert_allclose(
        gained(Effect("CX", "beta^2", -0.1))[0], qS * -0.1 * plain_air.beta**2 / 21.34, rtol=1e-9
    )
    np.testing.assert_allclose(
        gained(Effect("CY", "abs(beta)*beta", 0.5))[1],
        qS * 0.5 * abs(plain_air.beta) * plain_air.beta / 21.34,
        rtol=1e-9,
    )
    # The same thing under two names: thrust along x is CT.
    np.testing.assert_allclose(
        gained(Effect("propulsion", "thrust_scale", 0.1)),
        gained(Effect("CX", "CT", 0.1)),
        atol=1e-12,
    )
    # alphadot_hat c/2V of the motion itself.
    a, dot = plain_air, plain_air.dot
    alphadot = (x[0] * dot[2] - x[2] * dot[0]) / (x[0] ** 2 + x[2] ** 2)
    expected = qS * 0.53 * -4.0 * alphadot * 0.53 / (2.0 * a.V) / 8.26
    np.testing.assert_allclose(gained(Effect("Cm", "alphadot_hat", -4.0))[4], expected, rtol=1e-9)
    # Force terms in alphadot change alphadot: the loop is closed.
    repeat = evaluate(
        Model([Airframe()] * 4, [(Effect("CZ", "alphadot_hat", -3.0),)] * 4), x, s, None
    ).dot
    alphadot = (x[0] * repeat[2] - x[2] * repeat[0]) / (x[0] ** 2 + x[2] ** 2)
    np.testing.assert_allclose(
        repeat[2] - dot[2], qS * -3.0 * alphadot * 0.53 / (2.0 * a.V) / 21.34, rtol=1e-4
    )
    with pytest.raises(ValueError, match="unknown \\['gamma'\\]"):
        Effect("Cm", "gamma^2", 1.0)
    with pytest.raises(ValueError, match="known are"):
        Effect("wing", "bend", 1.0)


def test_every_effect_of_the_catalogue_changes_what_is_measured():
    pulses = (
        Pulse("aileron", "doublet", 8.0, 0.6),
        Pulse("rudder", "doublet", 6.0, 0.6, 1.4),
        Pulse("elevator", "doublet", -6.0, 0.5, 2.4),
        Pulse("throttle", "doublet", 25.0, 1.5),
    )
    flights = []
    for entry in (*IN_FORM, *OFF_FORM):
        # The break comes at 45 s; the test does not wait for it.
        form = entry.form.replace("45", "1")
        effect = Effect(entry.subject, entry.term, entry.guess, form).scaled(
            3.0 if entry.term != "late" else 1.0
        )
        trajectory = replace(
            card(1, {"slow": 15.0, "ground": 20.0, "mixed": 20.0}[entry.flown]),
            seconds=5.0,
            noise=0.0,
            manoeuvres=(Manoeuvre("all", 0.2, 4.8, pulses),),
            h_m=3.0 if entry.flown == "ground" else 100.0,
        )
        flights += [Flight(trajectory, Airframe()), Flight(trajectory, Airframe(), (effect,))]
    records = fly(flights)
    for minimal, hidden, flight in zip(records[::2], records[1::2], flights[1::2], strict=True):
        maximum = max(np.abs(hidden[c] - minimal[c]).max() / std for c, std in NOISE.items())
        assert maximum > 0.02, flight.effects
