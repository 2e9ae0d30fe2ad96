"""The servos that together explain a flight best, on surfaces whose motion is measured itself."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from tests.helpers.whitened import information_of
from uqharness.identification.linearised import control_delay_name
from uqharness.refinement.servos import LikeliestServos, likeliest_servos
from uqharness.replay import CONTROLS, Segment, delayed_command, runs_per_row
from uqharness.simulator import Actuator

DT, NOISE_DEG = 0.02, 0.1
SURFACES = CONTROLS[:3]


class Measured:
    """An estimator that measures each coefficient's change, one surface a coefficient."""

    def __init__(self, residual: np.ndarray) -> None:
        self.residual = residual

    def information(self, data, fit, columns):
        """Normal equations of the surfaces' motion over its noise."""
        (segment,) = columns
        values = np.stack([segment.inputs[n][1][:, :3] for n in segment.names], axis=2)
        return information_of(
            self.residual / NOISE_DEG, values / NOISE_DEG, segment.names, fit.columns[0].names
        )


def likeliest(
    servos: dict[str, Actuator], late_s: float, commanded: tuple[str, ...] = SURFACES
) -> LikeliestServos | None:
    """The likeliest servos of doublets, fitted with a delay of all controls.

    Surfaces that are not ``commanded`` have no servo that could be estimated.
    """
    rng = np.random.default_rng(5)
    controls = np.zeros((600, 4))
    for k in range(3):
        for first in range(20 + 40 * k, 560, 120):
            size = rng.choice([-6.0, 6.0])
            controls[first : first + 20, k], controls[first + 20 : first + 40, k] = size, -size
    time_s = DT * np.arange(len(controls))
    segment = Segment("m", "f", time_s, controls, np.zeros(9), 100.0, 0.0)
    by_control = np.zeros((len(controls), 6, 4))
    by_control[:, range(3), range(3)] = 1.0
    residual = rng.normal(0.0, NOISE_DEG, (len(controls), 3))
    for k, surface in enumerate(SURFACES):
        flown = servos[surface].follow(controls[:, k], DT, DT / runs_per_row(DT))
        residual[:, k] += flown - delayed_command(controls[:, k], time_s, late_s)
    data = SimpleNamespace(
        segments=[segment], servos=dict.fromkeys(commanded, Actuator(None)), timed=("f",)
    )
    point = SimpleNamespace(nuisance={control_delay_name("f"): late_s})
    fit = SimpleNamespace(
        probes=[SimpleNamespace(by_control=by_control)],
        columns=[SimpleNamespace(names=())],
        trajectory=SimpleNamespace(point=point),
    )
    required = {
        f"effect/actuator.{s}/{term}": 16.0 for s in SURFACES for term in ("lag", "rate_limit")
    }
    return likeliest_servos(data, fit, Measured(residual), required)


def explained(servos: dict[str, Actuator], late_s: float) -> dict[str, float]:
    """The effects of the likeliest servos by surface and term."""
    result = likeliest(servos, late_s)
    effects = {} if result is None else result.effects
    return {key.removeprefix("effect/actuator."): value for key, value in effects.items()}


def test_slow_servos_are_named_together_where_a_delay_stood_for_them():
    # A trial rate limit is 5 % of the fastest motion, of 12 deg in a row.
    servos = {"elevator": Actuator(12.5), "aileron": Actuator(6.25), "rudder": Actuator(None, 30.0)}
    effects = explained(servos, 0.09)
    assert effects.keys() == {"elevator/lag", "aileron/lag", "rudder/rate_limit"}
    assert effects["elevator/lag"] == pytest.approx(0.08)
    assert effects["aileron/lag"] == pytest.approx(0.16)
    assert 1.0 / effects["rudder/rate_limit"] == pytest.approx(30.0)


def test_one_slow_servo_is_one_effect():
    prompt = Actuator(None)
    servos = {"elevator": prompt, "aileron": Actuator(12.5), "rudder": prompt}
    assert explained(servos, 0.03).keys() == {"aileron/lag"}


def test_prompt_servos_stay():
    assert explained(dict.fromkeys(SURFACES, Actuator(None)), 0.0) == {}


def test_without_the_delay_the_other_controls_are_in_time():
    """A prompt rudder without a servo contradicts the delay as one with a servo does."""
    prompt = Actuator(None)
    servos = {"elevator": Actuator(12.5), "aileron": prompt, "rudder": prompt}
    complete, partial = (
        likeliest(servos, 0.05, commanded) for commanded in (SURFACES, ("elevator", "aileron"))
    )
    assert (
        complete.effects == partial.effects == pytest.approx({"effect/actuator.elevator/lag": 0.08})
    )
    assert partial.gain == pytest.approx(complete.gain, rel=1e-6)
