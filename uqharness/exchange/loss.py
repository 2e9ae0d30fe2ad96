"""What an exported model loses: target minus source over flight states, and the model's bounds."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from sysid.aerodynamics import COEFFICIENTS
from sysid.arrays import FloatArray
from sysid.model_form import ModelForm
from uqharness.exchange.states import FlightStates, SourceModel

SHARE = 0.95
"""Share of the states at which the difference must lie within the half-width."""


@dataclass(frozen=True)
class CoefficientLoss:
    """Difference of one coefficient over the states [-].

    Attributes
    ----------
    largest, rms, quantile : float
        Of the absolute difference; the quantile is that of `SHARE`.
    spread : float
        Standard deviation of the source over the states, for comparison.
    half_width : float
        Mean half-width of the model form over the states; NaN without one.
    """

    largest: float
    rms: float
    quantile: float
    spread: float
    half_width: float

    @property
    def is_beyond(self) -> bool:
        """Return whether the difference exceeds the half-width; False without one."""
        return self.quantile > self.half_width


def losses(
    source: SourceModel, target: FloatArray, states: FlightStates, form: ModelForm | None
) -> dict[str, CoefficientLoss]:
    """Compare a target's coefficients (n, 6) with the source's at the same states."""
    widths = {} if form is None else _half_widths(source, states, form)
    return differences(target, source.coefficients(states), widths)


def differences(
    target: FloatArray, values: FloatArray, half_widths: Mapping[str, float] | None = None
) -> dict[str, CoefficientLoss]:
    """Compare coefficients (n, 6) of two models at the same states."""
    difference = np.abs(target - values)
    return {
        name: CoefficientLoss(
            largest=float(difference[:, k].max()),
            rms=float(np.sqrt(np.mean(difference[:, k] ** 2))),
            quantile=float(np.quantile(difference[:, k], SHARE)),
            spread=float(values[:, k].std()),
            half_width=(half_widths or {}).get(name, math.nan),
        )
        for k, name in enumerate(COEFFICIENTS)
    }


def worst(
    first: Mapping[str, CoefficientLoss], second: Mapping[str, CoefficientLoss]
) -> dict[str, CoefficientLoss]:
    """Return the larger difference of each coefficient, and the smaller half-width.

    A coefficient that one of them lacks is the other's.
    """
    result = {**first, **second}
    for name in first.keys() & second.keys():
        a, b = first[name], second[name]
        result[name] = CoefficientLoss(
            largest=max(a.largest, b.largest),
            rms=max(a.rms, b.rms),
            quantile=max(a.quantile, b.quantile),
            spread=a.spread,
            half_width=min(a.half_width, b.half_width),
        )
    return result


def _half_widths(source: SourceModel, states: FlightStates, form: ModelForm) -> dict[str, float]:
    """Return the mean half-width of each coefficient's bounds at the states."""
    rate, value = 2.0 * states.V_mps, states.values
    n = len(states)
    flight_states = {
        "V_mps": states.V_mps,
        "alpha_rad": value["alpha"],
        "beta_rad": value["beta"],
        "phi_rad": np.zeros(n),
        "theta_rad": value["alpha"],
        "p_radps": value["p"] * rate / states.b_m,
        "q_radps": value["q"] * rate / states.c_m,
        "r_radps": value["r"] * rate / states.b_m,
        "elevator_pos_deg": value["de"],
        "aileron_pos_deg": value["da"],
        "rudder_pos_deg": value["dr"],
        "throttle_pct": np.full(n, source.controls.get("throttle", 0.0)),
    }
    widths = {}
    for name, bounds in form.coefficients.items():
        known = {state: flight_states[state] for state in bounds.states if state in flight_states}
        if len(known) == len(bounds.states):
            # Clamped: the box is wider than the flights that the bounds were made from.
            lower, upper = bounds.bounds(known, outside="clamp")
            widths[name] = float(np.mean(0.5 * (upper - lower)))
    return widths
