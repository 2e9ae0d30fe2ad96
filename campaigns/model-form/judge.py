"""One seed of one case: the bounds, and how much of the true error they hold.

The true error at a sample is held against delta(x) +- t sqrt(leverage + tau_u^2 + tau_eta^2), at
noise-free states: once as it stands, once stretched to hold zero, as all bounds of this project
are. Samples of the noisy flights are held against the same with the sensors' noise added back.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.aerodynamics import Residuals, combine_flights
from sysid.aerodynamics.coefficients import COEFFICIENTS
from sysid.arrays import FloatArray
from sysid.model_form.components import WALK_CUTOFF_HZ
from sysid.model_form.coverage import coverage
from sysid.model_form.fit import FitOptions, FittedBounds, fit_bounds
from sysid.model_form.model_form import AircraftReference, CoefficientBounds, Filtering, ModelForm
from uqharness.files import finite
from uqharness.simulator.aircraft import content_hash, find_aircraft

from .flights import (
    CASES,
    CUTOFFS,
    MODEL,
    PLANS_FLOWN,
    SPEEDS,
    Case,
    Noisy,
    Quiet,
    model_pair,
    noisy_twin,
    quiet_flight,
)

CARDS = {"default": 1.0, "card x 2": 2.0, "card / 2": 0.5}
"""Ways of making bounds -> factor by which the card's noise is off."""
EXACT = "noise known"
PUBLISHED = FitOptions(samples="all", noise="inside")


def run_seed(case: Case, seed: int) -> dict[str, Any]:
    """Return everything that the tables need of one seed. Raises BadInputError."""
    calm = [quiet_flight(case, plan, 10 * seed + k) for k, plan in enumerate(PLANS_FLOWN)]
    number, factors = CASES.index(case), tuple(CARDS.values())
    with model_pair(calm[0].measured) as pair:
        noisy = [
            noisy_twin(q, pair, (seed, number, k), (1.0,) if k else factors)
            for k, q in enumerate(calm)
        ]
    forms = fitted_ways(noisy[0])
    published = fit_bounds(noisy[0].residuals, options=PUBLISHED)
    rows, fits = [], []
    for way, fitted in forms.items():
        rows += _rows(way, fitted, calm[1:], noisy[1:])
        fits += [_fit_row(way, c, fitted[c], calm[0].true, published[c]) for c in COEFFICIENTS]
    return {"case": case.name, "seed": seed, "rows": rows, "fits": fits}


def fitted_ways(noisy: Noisy) -> dict[str, dict[str, FittedBounds]]:
    """Fit bounds to one noisy flight: by way and coefficient."""
    fits = {way: fit_bounds(noisy.knowing(noisy.sizes[factor])) for way, factor in CARDS.items()}
    return {**fits, EXACT: fit_bounds(noisy.exactly())}


def form_of(fitted: Mapping[str, FittedBounds], rate_hz: float) -> ModelForm:
    """Make a model form of the study's model."""
    model = find_aircraft(MODEL)
    return ModelForm(
        AircraftReference(model.name, content_hash(model)),
        (),
        Filtering(CUTOFFS.all_hz, CUTOFFS.airspeed_hz, WALK_CUTOFF_HZ, rate_hz),
        0.95,
        "grow",
        {c: f.bounds for c, f in fitted.items()},
    )


def error_interval(
    bounds: CoefficientBounds, states: Mapping[str, FloatArray]
) -> tuple[FloatArray, FloatArray]:
    """Return middle and half-width (n,) of the interval of the total model error, before it is
    stretched to hold zero."""
    return bounds.sample_middle(states, np.zeros(len(states["V_mps"])))


def _rows(
    way: str, fitted: Mapping[str, FittedBounds], calm: list[Quiet], noisy: list[Noisy]
) -> list[dict[str, Any]]:
    form = form_of(fitted, 1.0 / noisy[0].residuals.dt_s)
    measured = [n.knowing(n.sizes[1.0]) for n in noisy]
    pooled = coverage(form, combine_flights(measured)) if way == "default" else {}
    rows = []
    for speed, q, m in zip(SPEEDS, calm, measured, strict=True):
        single, states = coverage(form, m) if way == "default" else {}, q.true.states
        for k, c in enumerate(COEFFICIENTS):
            bounds, true = fitted[c].bounds, q.true.delta[:, k]
            middle, half = error_interval(bounds, states)
            distance = bounds.distance(states)
            covered = distance == 0.0
            plain = np.abs(true - middle) <= half
            low, high = np.minimum(middle - half, 0.0), np.maximum(middle + half, 0.0)
            stretched = (true >= low) & (true <= high)
            row = {
                "way": way,
                "coefficient": c,
                "speed_mps": speed,
                "n": len(true),
                "outside": float(np.mean(~covered)),
                "furthest": float(distance.max()),
                "inside": _mean(plain, covered),
                "inside_stretched": _mean(stretched, covered),
                "inside_all": float(plain.mean()),
                "inside_stretched_all": float(stretched.mean()),
                "width": _mean(2.0 * half, covered),
                "true_rms": float(np.sqrt(np.mean(true**2))),
            }
            if single:
                row |= {"third": single[c].share[0.95], "third_error": single[c].error[0.95]}
                factor = pooled[c].conformal
                if factor is not None:
                    row |= {"conformal": factor.factor, "conformal_level": factor.level}
            rows.append(finite(row))
    return rows


def _mean(values: NDArray[Any], chosen: NDArray[np.bool_]) -> float:
    return float(values[chosen].mean()) if chosen.any() else float("nan")


def _fit_row(
    way: str, coefficient: str, fitted: FittedBounds, true: Residuals, published: FittedBounds
) -> dict[str, Any]:
    """Return parts of one coefficient, beside the true error and the part of it that no polynomial
    holds."""
    bounds, states = fitted.bounds, true.states
    assert bounds.parts is not None
    assert fitted.separation is not None
    error = true.delta[:, COEFFICIENTS.index(coefficient)]
    middle, half = error_interval(bounds, states)
    low, high = bounds.bounds(states)
    print_ = published.bounds.bounds(states)
    chosen = {k: v for k, v in asdict(bounds.parts).items() if k not in ("flight", "noise")}
    return finite(
        {
            "way": way,
            "coefficient": coefficient,
            **chosen,
            "log_odds": fitted.separation.components().log_odds,
            "true_rms": float(np.sqrt(np.mean(error**2))),
            "left_rms": float(np.sqrt(np.mean((error - middle) ** 2))),
            "middle_rms": float(np.sqrt(np.mean(middle**2))),
            "width": float(np.mean(2.0 * half)),
            "persistent_width": float(np.mean(high - low)),
            "published_width": float(np.mean(print_[1] - print_[0])),
        }
    )
