"""How gusty the air was: intensities, what gusts do and the sensors' noise, found in flights drawn
from the filter's equations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from sysid.aerodynamics import NX
from sysid.aerodynamics.air_motion import GustStates
from sysid.aerodynamics.rigid_body import Reference, Steps, linearise
from sysid.effects import turbulence
from sysid.effects.tuned import CERTAIN_T
from sysid.effects.turbulence import (
    V_REFERENCE,
    Score,
    TurbulenceModel,
    TurbulenceSearch,
    gust_strength_mps2,
    process_of,
)
from sysid.estimation import Process
from sysid.parallel import SERIAL
from tests.helpers.open_equations import OpenEquations
from tests.sysid.aerodynamics.test_rigid_body import DT, MASS, TERMS, flight, reference

NOISE = np.array([0.3, 2e-3, 2e-3, 2e-3, 2e-3, 2e-3, 2e-3, 2e-3, 0.05, 0.05, 0.05])
INTENSITIES = np.array([0.2, 1e-3, 1e-3, 0.04, *[1e-9] * 5])


class Made(dict[GustStates, list[Steps]]):
    """Four flights linearised with gusts that act in any way, each way once."""

    def __init__(self, ref: list[Reference]) -> None:
        super().__init__()
        self.ref = ref

    def __missing__(self, states: GustStates) -> list[Steps]:
        self[states] = [linearise(r, MASS, gusts=states) for r in self.ref]
        return self[states]

    def __call__(self, some, active):
        return [self[a][k] for k, a in zip(some, active, strict=True)]


def draw(
    truth: GustStates,
    values: np.ndarray,
    moment: float = 0.0,
    faster: Sequence[float] = (0.0,) * 4,
    n: int = 110,
    axis: int = 3,
    stronger: Sequence[float] = (1.0,) * 4,
    headings: Sequence[float] = (0.0,) * 4,
) -> tuple[Made, list[np.ndarray]]:
    """Four flights of n samples drawn from the linear system itself, by what gusts may do; moment:
    a wave of that size besides, in Cl or that of CX..Cn which axis says; faster: of each flight
    [m/s]; stronger: factor on its intensities; headings: mean heading [rad]."""
    rng = np.random.default_rng(4)
    equations = OpenEquations(TERMS, (), ("V_mps",), MASS)
    ref = []
    for k in range(4):
        x = flight(n + 20 * k)[20 * k :]
        x[:, 5] += 0.35
        x[:, 0] += faster[k]
        ref.append(reference(x, equations))
    result = Made(ref)
    data = []
    of_segment = [truth._replace(psi_rad=psi) for psi in headings]
    for k, (states, factor) in enumerate(zip(of_segment, stronger, strict=True)):
        steps = result[states][k]
        Q, begin = process_of(factor * values, 22.0, states)
        d = np.sqrt(begin) * rng.standard_normal(NX)
        z = np.empty((n, len(NOISE)))
        wave = moment * np.sin(9.0 * DT * np.arange(n) + rng.uniform(0.0, 6.0))
        for k in range(n):
            u = wave[k] * np.eye(6)[axis]
            z[k] = (
                steps.y_ref[k]
                + steps.H[k] @ d
                + steps.D[k] @ u
                + NOISE * rng.standard_normal(len(NOISE))
            )
            if k < n - 1:
                d = (
                    steps.phi[k] @ (d + np.sqrt(0.5 * DT * Q) * rng.standard_normal(NX))
                    + steps.defect[k]
                )
                d = d + np.sqrt(0.5 * DT * Q) * rng.standard_normal(NX)
                d = d + steps.g0[k] @ u + steps.g1[k] @ (wave[k + 1] * np.eye(6)[axis])
        data.append(z)
    return result, data


def found_in(
    result: Made,
    data: list[np.ndarray],
    close: TurbulenceModel | None = None,
    headings: Sequence[float] = (0.0,) * 4,
) -> TurbulenceModel:
    return TurbulenceSearch(
        result,
        data,
        range(len(NOISE)),
        NOISE,
        [22.0] * 4,
        ["a"] * 2 + ["b"] * 2,
        states=GustStates(MASS.b),
        initial=close,
        psi_rad=headings,
    ).run()[0]


@pytest.mark.parametrize(
    ("rotating", "turning"),
    [(True, True), (False, False), pytest.param(True, False, marks=pytest.mark.slow)],
)
def test_intensities_and_what_gusts_do_are_found(rotating, turning):
    """Intensities within a factor, the air's ways by likelihood."""
    output, data = draw(GustStates(MASS.b, rotating=rotating, turning_with=turning), INTENSITIES)
    result = found_in(output, data)
    assert {(s.rotating, s.turning_with) for s in result.states} == {(rotating, turning)}
    np.testing.assert_allclose(np.log(result.values[:4] / INTENSITIES[:4]), 0.0, atol=np.log(1.7))
    assert set(result.by_flight) == {"a", "b"}
    assert result.gain > 1000.0
    assert result.is_turbulent
    repeat = found_in(output, data, result)
    np.testing.assert_allclose(np.log(repeat.values[:4] / result.values[:4]), 0.0, atol=np.log(1.4))
    np.testing.assert_allclose(
        result.values[:4], 0.5 * (result.by_flight["a"] + result.by_flight["b"])[:4]
    )
    assert repeat.across == result.across
    # However often it is sought from there, it stays.
    last = found_in(output, data, found_in(output, data, repeat))
    np.testing.assert_allclose(np.log(last.values[:4] / result.values[:4]), 0.0, atol=np.log(1.4))


def test_axes_and_lengths_of_gusts_are_the_likeliest():
    """Rolling air of twice the length, and pitching air of less than half of it, are told from the
    standard's, which stays where it is true.
    """
    standard = found_in(*draw(GustStates(MASS.b), INTENSITIES)).states[0]
    assert (standard.in_body, standard.q_share) == (False, 1.0)
    assert (standard.p_length, standard.q_length) == pytest.approx((1.0, 1.0), abs=0.31)
    short = GustStates(MASS.b, p_length=2.4, q_length=0.4)
    other = found_in(*draw(short, INTENSITIES)).states[0]
    assert (other.p_length, other.q_length) == pytest.approx((2.4, 0.4), rel=0.35)
    reversed_ = found_in(*draw(GustStates(MASS.b, q_share=-1.0), INTENSITIES))
    assert reversed_.states[0].q_share == -1.0


def test_axes_of_the_mean_wind_are_the_likeliest():
    """Gusts and rotation in axes of one azimuth over the earth, as JSBSim's, whose pitch is
    reversed, against those that follow the heading. The second flight meets another wind.
    """
    headings, measured = (0.0, 1.3, 2.6, 4.4), (0.0, 1.3, 3.6, 5.4)
    wind = GustStates(MASS.b, turning_with=False, in_earth=True, azimuth_rad=0.9, q_share=-1.0)
    air = found_in(*draw(wind, INTENSITIES, headings=headings), headings=measured)
    first = air.states[0]
    assert (first.in_earth, first.q_share, first.r_share) == (True, -1.0, 1.0)
    assert air.azimuth_rad == pytest.approx({"a": 0.9, "b": 1.9}, abs=0.1)
    repeat = air.in_segments([22.0, 22.0], ["b", "c"], [1.0, 2.0]).states
    assert [s.psi_rad for s in repeat] == [1.0, 2.0]
    assert repeat[0].azimuth_rad == air.azimuth_rad["b"]
    standard = draw(GustStates(MASS.b), INTENSITIES, headings=headings)
    assert not found_in(*standard, headings=headings).states[0].in_earth


@pytest.mark.parametrize(("rotating", "turning"), [(True, True), (False, True)])
def test_what_gusts_were_first_taken_to_do_is_asked_again(rotating, turning):
    """A sensor that is off, or an effect that is missing, may have decided it."""
    result, data = draw(GustStates(MASS.b, rotating=rotating, turning_with=turning), INTENSITIES)
    first = found_in(result, data)
    invalid = tuple(
        s._replace(rotating=not rotating, turning_with=not turning) for s in first.states
    )
    repeat = found_in(result, data, replace(first, states=invalid))
    assert repeat.kind[:2] == (rotating, turning)
    np.testing.assert_allclose(np.log(repeat.values[:4] / first.values[:4]), 0.0, atol=np.log(1.4))


@pytest.mark.slow
@pytest.mark.parametrize(
    "truth", [GustStates(MASS.b, q_share=-1.0, r_share=-1.0), GustStates(MASS.b, rotating=False)]
)
def test_reversed_rotation_of_air_that_was_taken_not_to_rotate(truth):
    """Rotation by the standard is less likely than none where the air's is reversed."""
    values, steady = 5.0 * INTENSITIES, (GustStates(MASS.b, rotating=False),) * 4
    of_flight, speed = dict.fromkeys("ab", values), dict.fromkeys("ab", 0.0)
    factors, process = np.ones(len(NOISE)), Process(*np.zeros((2, 4, NX)))
    first = TurbulenceModel(
        steady, values, of_flight, speed, process, 1.0, 1.0, np.zeros(3), factors
    )
    last = found_in(*draw(truth, INTENSITIES), first).states[0]
    assert last._replace(passing_mps=0.0) == truth


def test_air_that_gains_nothing_stands(monkeypatch):
    """Searched from where it was found, no flight's own, no speed and nothing that gusts do is
    asked; from half of it, all is.
    """
    result, data = draw(GustStates(MASS.b, 22.0), INTENSITIES)
    first = found_in(result, data)
    request = []
    original = turbulence._Search.by_flight
    monkeypatch.setattr(
        turbulence._Search, "by_flight", lambda *a, **k: request.append(1) or original(*a, **k)
    )
    repeat = found_in(result, data, first)
    assert not request
    assert repeat.passing == first.passing
    np.testing.assert_allclose(repeat.moments, first.moments, atol=9.0)
    found_in(
        result,
        data,
        replace(
            first,
            values=0.5 * first.values,
            by_flight={f: 0.5 * v for f, v in first.by_flight.items()},
        ),
    )
    assert request


def test_noise_that_is_half_of_what_is_stated_is_found_beside_the_gusts():
    """Gyros half as noisy as taken: their factor is found, the others' is one, and what is known is
    left alone.
    """
    output, data = draw(GustStates(MASS.b), INTENSITIES)
    kinds = [
        "wind" if k < 3 else "attitude" if k < 5 else "rate" if k < 8 else "force"
        for k in range(len(NOISE))
    ]
    rate = np.array([kind == "rate" for kind in kinds])
    stated = np.where(rate, 2.0, 1.0) * NOISE

    def searched(kinds, noise, close=None):
        return TurbulenceSearch(
            output,
            data,
            range(len(NOISE)),
            noise,
            [22.0] * 4,
            ["a"] * 4,
            states=GustStates(MASS.b),
            initial=close,
            kinds=kinds,
        ).run()

    gusts, result = searched(kinds, stated)
    np.testing.assert_allclose(result[rate], 0.5, rtol=0.1)
    np.testing.assert_allclose(result[~rate], 1.0, atol=0.1)
    np.testing.assert_array_equal(searched((), stated)[1], 1.0)
    # Searched again from there, the noise stays; from one that is lost, where no slope leads back,
    # what is stated does.
    repeat, change = searched(kinds, result * stated, gusts)
    np.testing.assert_allclose(change, 1.0, atol=0.05)
    np.testing.assert_allclose(repeat.factors, result, rtol=0.05)
    is_lost = replace(gusts, factors=np.where(rate, 1e-5, result))
    repeat, change = searched(kinds, is_lost.factors * stated, is_lost)
    np.testing.assert_allclose(repeat.factors, result, rtol=0.1)
    np.testing.assert_allclose(change * is_lost.factors, repeat.factors)


def test_the_search_ends_where_no_number_makes_the_flights_likelier():
    """Scales of the intensities about the optimum, one by one, against the likelihood itself."""
    output, data = draw(GustStates(MASS.b), INTENSITIES)
    search = turbulence._Search(output, data, range(len(NOISE)), NOISE, [22.0] * 4, SERIAL)
    some, ones = list(range(4)), np.ones(len(NOISE))
    begin = turbulence._Point((GustStates(MASS.b),) * 4, 3.0 * INTENSITIES, ones)
    result = search.descend(some, begin, ())
    assert result.cost < search.best(some, [begin]).cost - 100.0
    for k in range(4):
        for factor in (0.8, 1.25):
            moved = np.where(np.arange(9) == k, factor, 1.0) * result.values
            assert (
                search.best(some, [turbulence._Point(result.states, moved, ones)]).cost
                > result.cost - 1.0
            )


def test_a_moment_that_comes_and_goes_is_no_air():
    """Nearly still air and a wave in Cl: the filter has it rotate, and nothing moves. A hundredth
    of light air is air; what moves along the path alone is none, as a sensor that is off would have
    it."""
    steady = 1e-6 * INTENSITIES
    wave = found_in(*draw(GustStates(MASS.b), steady, 0.003))
    assert wave.gain > 100.0
    assert not wave.is_turbulent
    faint = found_in(*draw(GustStates(MASS.b), 0.01 * INTENSITIES))
    assert faint.gain > 100.0
    assert faint.is_turbulent
    axial = found_in(
        *draw(
            GustStates(MASS.b), np.where(np.arange(len(INTENSITIES)) == 0, 1.0, 1e-6) * INTENSITIES
        )
    )
    assert axial.gain > 100.0
    assert not axial.is_turbulent


@pytest.mark.parametrize(
    ("axis", "reports"), [(4, [False, True, False]), (5, [False, False, True])]
)
def test_moments_that_nothing_explains_stand_apart_from_the_air(axis, reports):
    """Light air and a wave in Cm or Cn: told about its own axis alone, and the air is what
    it was.
    """
    wave = found_in(*draw(GustStates(MASS.b), INTENSITIES, 0.003, axis=axis))
    np.testing.assert_array_equal(wave.moments > CERTAIN_T**2, reports)
    np.testing.assert_allclose(np.log(wave.values[:4] / INTENSITIES[:4]), 0.0, atol=np.log(1.7))


def test_light_air_needs_no_moments():
    plain = found_in(*draw(GustStates(MASS.b), INTENSITIES))
    assert np.abs(plain.moments).max() < CERTAIN_T**2 / 5.0


@pytest.mark.parametrize("passing", [0.0, 22.0])
def test_gusts_pass_at_the_airspeed_or_at_one_speed(passing):
    """Flights of 18 and 26 m/s on the whole: air that passes at the airspeed, and air made
    beforehand for 22 m/s, the mean.
    """
    result, data = draw(
        GustStates(MASS.b, passing), INTENSITIES, faster=(-4.0, -4.0, 4.0, 4.0), n=260
    )
    search = turbulence._Search(result, data, range(len(NOISE)), NOISE, [22.0] * 4, SERIAL)
    local = turbulence._Point((GustStates(MASS.b),) * 4, INTENSITIES, np.ones(len(NOISE)))
    one = search.passing({"a": range(4)}, local)
    (speed,) = {s.passing_mps for s in one.states}
    assert search.best(range(4), [local, one]).states == (one if passing else local).states
    if passing:
        assert speed == pytest.approx(passing, rel=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("passing", [35.0, 12.0, 0.0])
def test_gusts_of_all_flights_pass_far_from_the_airspeed(passing):
    """A simulator that makes gusts for one speed, and one that makes them for the airspeed."""
    result = found_in(*draw(GustStates(MASS.b, passing), INTENSITIES, n=160))
    assert result.states[0].passing_mps == pytest.approx(passing, rel=0.15)
    np.testing.assert_allclose(np.log(result.values[:4] / INTENSITIES[:4]), 0.0, atol=np.log(1.4))
    delayed = result.in_segments([25.0], ["c"], [0.0]).passing["c"]
    assert delayed == pytest.approx(passing, rel=0.15)


def test_the_air_of_a_flight_alone_is_the_likeliest_from_wherever_it_is_sought():
    """Sought from four times the air, which passes at the airspeed: found again."""
    output, data = draw(GustStates(MASS.b, 23.5), INTENSITIES, n=260)

    def result(close: turbulence.TurbulenceModel | None) -> turbulence.TurbulenceModel:
        air, _ = turbulence.TurbulenceSearch(
            output,
            data,
            range(len(NOISE)),
            NOISE,
            [22.0] * 4,
            ["a"] * 4,
            states=GustStates(MASS.b),
            initial=close,
        ).run()
        return air

    first = result(None)
    at_airspeed = tuple(s._replace(passing_mps=0.0) for s in first.states)
    off = replace(
        first,
        values=4.0 * first.values,
        by_flight={"a": 4.0 * first.values},
        states=at_airspeed,
        passing={"a": 0.0},
    )
    repeat = result(off)
    np.testing.assert_allclose(
        np.log(repeat.by_flight["a"][:4] / first.by_flight["a"][:4]), 0.0, atol=0.2
    )


def test_flights_in_air_of_unlike_strength_tell_how_fast_their_gusts_pass():
    """Air made for 23.5 m/s, met at 22 m/s: four times weaker than on the whole in one flight, four
    times stronger in the other.
    """
    factors = (0.25, 0.25, 4.0, 4.0)
    result, data = draw(GustStates(MASS.b, 23.5), INTENSITIES, n=260, stronger=factors)
    search = turbulence._Search(result, data, range(len(NOISE)), NOISE, [22.0] * 4, SERIAL)
    flights, of = ["a", "a", "b", "b"], {"a": [0, 1], "b": [2, 3]}
    common = search.descend(
        range(4), turbulence._Point((GustStates(MASS.b),) * 4, INTENSITIES, np.ones(len(NOISE))), ()
    )
    point = search.by_flight(of, common, flights)
    np.testing.assert_allclose(
        np.log(point.of(2)[:3] / point.of(0)[:3] / 16.0), 0.0, atol=np.log(2.0)
    )
    np.testing.assert_allclose(point.values[:4], 0.5 * (point.of(0) + point.of(3))[:4])
    np.testing.assert_allclose([point.of(1)[4:7], point.of(3)[4:7]], [common.values[4:7]] * 2)
    assert search.best(range(4), [point]).cost < common.cost - 100.0
    output = np.array([s.passing_mps for s in search.passing(of, point).states])
    assert np.abs(output / 23.5 - 1.0).max() < 0.04


def test_the_air_of_some_flights_in_others():
    """What is known of a flight stays; others have what all have, and gusts that pass at one speed
    in each flight pass at their mean airspeed.
    """
    kind = GustStates(MASS.b, rotating=True)
    output, data = draw(kind, INTENSITIES)
    result = found_in(output, data)
    other = result.in_segments([19.0, 21.0, 30.0], ["c", "c", "a"], [0.0] * 3)
    assert [s.passing_mps for s in other.states] == [0.0] * 3
    np.testing.assert_array_equal(other.by_flight["a"], result.by_flight["a"])
    np.testing.assert_array_equal(other.by_flight["c"], result.values)
    assert len(other.process.noise) == 3
    one_speed = tuple(s._replace(passing_mps=25.0) for s in result.states)
    # A speed of each flight, and one that all have.
    for of_b, expected in ((24.0, [20.0, 20.0, 25.0]), (25.0, [25.0] * 3)):
        at_one = replace(result, states=one_speed, passing={"a": 25.0, "b": of_b})
        delayed = at_one.in_segments([19.0, 21.0, 30.0], ["c", "c", "a"], [0.0] * 3)
        assert [s.passing_mps for s in delayed.states] == expected
    assert "one speed" in at_one.words
    assert "one speed" not in result.words


def test_where_no_filter_follows_gusts_pass_at_the_mean_airspeed(monkeypatch):
    def score(*_, **__):
        return Score(np.inf, np.zeros(1), np.zeros((1, 13)), np.zeros((1, 13)), ())

    monkeypatch.setattr(turbulence._Search, "score", score)
    search = turbulence._Search(
        lambda *_: [], [np.zeros((2, 1))] * 2, [0], np.ones(1), [20.0, 24.0], SERIAL
    )  # type: ignore
    local = turbulence._Point((GustStates(3.0),) * 2, np.ones(9), np.ones(1))
    assert [s.passing_mps for s in search.passing({"a": [0, 1]}, local).states] == [22.0, 22.0]


def test_the_strength_of_gusts_is_sigma_squared_over_their_length():
    sigma, length = 1.54, 150.0
    values = np.zeros(9)
    values[0] = 2.0 * sigma**2 * V_REFERENCE / length
    values[1:3] = 3.0 * sigma**2 / (length * V_REFERENCE)
    assert gust_strength_mps2(values) == pytest.approx(sigma**2 / length)
    values[2] *= 100.0
    assert gust_strength_mps2(values) == pytest.approx(100.0 * sigma**2 / length)
