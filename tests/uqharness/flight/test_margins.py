"""Loop margins measured by injection, against loops whose margins are known in closed form."""

from __future__ import annotations

import cmath
import math
from dataclasses import replace

import numpy as np
import pytest

from uqharness.flight.margins import (
    CoupledActuator,
    Loop,
    margins_of,
    measure_loop,
)

DT = 0.01
POLE, GAIN, DELAY = (
    0.98,
    0.02,
    3,
)  # y[k+1] = POLE y[k] + GAIN u[k], controller output DELAY steps old

LOOP = Loop(
    "toy",
    "inject",
    "output",
    "applied",
    rms=1.0,
    lowest_radps=0.5,
    highest_radps=250.0,
    period_s=40.0,
)


class ToyLoop:
    """First-order plant under u = -k y with a delay, stepped as JSBSim is; L(z) = k GAIN z^-DELAY /
    (z - POLE).
    """

    def __init__(self, controller_gain: float, offset: float = 0.3) -> None:
        self.values = {
            "simulation/dt": DT,
            "inject": 0.0,
            "output": 0.0,
            "applied": 0.0,
            "ap/engaged": 0.0,
        }
        self.k, self.offset = controller_gain, offset
        self.plant, self.history = 0.0, [0.0] * DELAY

    def __getitem__(self, name: str) -> float:
        return self.values[name]

    def __setitem__(self, name: str, value: float) -> None:
        self.values[name] = value

    def run_ic(self) -> bool:
        return True

    def run(self) -> bool:
        self.history.append(-self.k * (self.plant - self.offset))
        self.values["output"] = self.history.pop(0)
        self.values["applied"] = self.values["output"] + self.values["inject"]
        self.plant = POLE * self.plant + GAIN * self.values["applied"]
        return True


def exact_loop(w: float, k: float) -> complex:
    z = cmath.exp(1j * w * DT)
    return k * GAIN * z**-DELAY / (z - POLE)


def root_of(function, low: float, high: float) -> float:
    for _ in range(80):
        middle = 0.5 * (low + high)
        low, high = (
            (middle, high) if (function(middle) > 0) == (function(low) > 0) else (low, middle)
        )
    return low


def exact_margins(k: float) -> tuple[float, float, float]:
    """Gain margin in dB, phase margin in degrees and delay margin in seconds, by bisection of the
    formula.
    """
    crossover = root_of(lambda w: abs(exact_loop(w, k)) - 1, 0.01, 300.0)
    lag = cmath.phase(exact_loop(crossover, k)) + math.pi
    phase_crossing = root_of(
        lambda w: (exact_loop(w, k) * cmath.exp(0.5j * math.pi)).real, 5.0, 100.0
    )
    return -20 * math.log10(abs(exact_loop(phase_crossing, k))), math.degrees(lag), lag / crossover


@pytest.fixture(scope="module")
def measured():
    return measure_loop(lambda: ToyLoop(8.0), LOOP, condition={}, settle_s=5.0)


def test_frequency_response_is_the_formula(measured):
    exact = np.array([exact_loop(w, 8.0) for w in measured.frequency_radps])
    assert np.abs(measured.response / exact - 1).max() < 1e-6
    assert measured.reliable.all()


def test_margins_are_the_formula(measured):
    gain, phase, delay = exact_margins(8.0)
    got = measured.margins
    assert got.gain_up_dB == pytest.approx(gain, abs=0.1)
    assert got.phase_deg == pytest.approx(phase, abs=0.5)
    assert got.delay_s == pytest.approx(delay, rel=0.02)
    assert got.gain_down_dB == math.inf
    # Each was read where the formula's phase is -180 deg, or its gain is 1.
    assert cmath.phase(-exact_loop(got.gain_up_radps, 8.0)) == pytest.approx(0.0, abs=0.01)
    assert abs(exact_loop(got.phase_radps, 8.0)) == pytest.approx(1.0, abs=0.005)
    assert got.delay_radps == got.phase_radps


def test_gain_margin_is_where_the_loop_itself_goes_unstable(measured):
    """No formula: the toy flown with the gain just below and just above the measured margin."""
    factor = 10 ** (measured.margins.gain_up_dB / 20)

    def late_over_early(k: float) -> float:
        toy = ToyLoop(k)
        y = []
        for _ in range(4000):
            toy.run()
            y.append(toy["output"])
        return np.ptp(y[-500:]) / np.ptp(y[200:700])

    assert late_over_early(8.0 * factor * 0.97) < 0.5
    assert late_over_early(8.0 * factor * 1.03) > 2.0


def test_conditionally_stable_loop_has_a_margin_downwards():
    """L = k (s + 1)^2 / s^3 with k = 20: Routh asks 2 k^2 > k, so the gain may fall by a factor 40
    and rise at will.
    """
    w = np.geomspace(0.05, 300.0, 400)
    s = 1j * w
    got = margins_of(w, 20 * (s + 1) ** 2 / s**3)
    assert got.gain_down_dB == pytest.approx(20 * math.log10(40), abs=0.05)
    assert got.gain_up_dB == math.inf
    assert 0 < got.phase_deg < 90


class MixedToy(ToyLoop):
    """The same output moves a second actuator too, by ``mix`` times: the plant gets both, and a
    square of the injection.
    """

    def __init__(self, controller_gain: float, mix: float, bend: float = 0.0) -> None:
        super().__init__(controller_gain)
        self.values |= {"inject-second": 0.0, "mix": mix}
        self.bend = bend

    def run(self) -> bool:
        self.history.append(-self.k * (self.plant - self.offset))
        self.values["output"] = self.history.pop(0)
        self.values["applied"] = self.values["output"] + self.values["inject"]
        second = self.values["mix"] * self.values["output"] + self.values["inject-second"]
        self.plant = (
            POLE * self.plant
            + GAIN * (self.values["applied"] + second)
            + self.bend * self.values["inject"] ** 2
        )
        return True


MIXED = replace(LOOP, mixed=(CoupledActuator("inject-second", "mix", 1.0),))


def test_twice_the_gain_of_a_mixed_loop_halves_its_gain_margin():
    """L(z) = k (1 + mix) GAIN z^-DELAY / (z - POLE): the gain margin is that of a plain loop with k
    (1 + mix).
    """
    result = [
        measure_loop(
            lambda k=k: MixedToy(k, 0.5), MIXED, condition={}, settle_s=5.0
        ).margins.gain_up_dB
        for k in (4.0, 8.0)
    ]
    assert result[0] - result[1] == pytest.approx(20 * math.log10(2), abs=1e-3)
    assert result[1] == pytest.approx(exact_margins(12.0)[0], abs=0.1)
    # Open on one path alone, the second keeps its own feedback, which grows with k too: the
    # difference is another.
    one = [
        measure_loop(
            lambda k=k: MixedToy(k, 0.5), LOOP, condition={}, settle_s=5.0
        ).margins.gain_up_dB
        for k in (4.0, 8.0)
    ]
    assert abs(one[0] - one[1] - 20 * math.log10(2)) > 0.5
