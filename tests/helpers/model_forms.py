"""Model forms made up from random data, for tests that need bounds and no flight."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy import stats

from sysid.aerodynamics.coefficients import full_polynomial, regressors
from sysid.model_form.model_form import (
    AircraftReference,
    CoefficientBounds,
    Filtering,
    FlightUsed,
    Hull,
    ModelForm,
    Outside,
    Parts,
)

MEAN = {"V_mps": 22.0, "alpha_rad": 0.02, "theta_rad": 0.05, "throttle_pct": 60.0}
SPREAD = {
    "V_mps": 1.5,
    "alpha_rad": 0.03,
    "beta_rad": 0.03,
    "phi_rad": 0.3,
    "theta_rad": 0.08,
    "p_radps": 0.4,
    "q_radps": 0.15,
    "r_radps": 0.15,
    "elevator_pos_deg": 3.0,
    "aileron_pos_deg": 3.0,
    "rudder_pos_deg": 3.0,
    "throttle_pct": 12.0,
}
LONGITUDINAL = ("V_mps", "alpha_rad", "q_radps", "theta_rad")
LATERAL = ("V_mps", "beta_rad", "p_radps", "r_radps")
PUBLISHED = {
    "CX": LONGITUDINAL,
    "CY": LATERAL,
    "CZ": LONGITUDINAL,
    "Cl": LATERAL,
    "Cm": LONGITUDINAL,
    "Cn": LATERAL,
}


def made_up_form(
    states: Mapping[str, Sequence[str]] = PUBLISHED,
    outside: Outside = "grow",
    orders: Mapping[str, int] | None = None,
    seed: int = 1,
    size: float = 0.01,
) -> ModelForm:
    """Coefficients with the same states and order share data, and with it their (X'X)^-1; states
    are correlated.
    """
    rng = np.random.default_rng(seed)
    data = {}
    out = {}
    for name, used in states.items():
        order = (orders or {}).get(name, 2)
        key = (tuple(used), order)
        if key not in data:
            k = len(used)
            mix = np.eye(k) + 0.5 * rng.standard_normal((k, k))
            x = rng.standard_normal((900, k)) @ mix * [SPREAD[s] for s in used] + [
                MEAN.get(s, 0.0) for s in used
            ]
            centre, scale = x.mean(axis=0), x.std(axis=0)
            terms = full_polynomial(k, order)
            rows = regressors((x - centre) / scale, terms)
            inverse = np.linalg.inv(rows.T @ rows)
            largest = float(np.einsum("ni,ij,nj->n", rows, inverse, rows).max())
            middle = np.quantile(x, [0.25, 0.5, 0.75], axis=0).T
            data[key] = (
                centre,
                scale,
                terms,
                0.5 * (inverse + inverse.T),
                Hull(x.min(axis=0), x.max(axis=0), largest, middle),
            )
        centre, scale, terms, inverse, hull = data[key]
        out[name] = CoefficientBounds(
            states=tuple(used),
            centre=centre,
            scale=scale,
            terms=terms,
            beta_hat=size * rng.standard_normal(len(terms)),
            XtX_inv=inverse,
            s2=size**2,
            dof=885.0,
            t=1.963,
            confidence=0.95,
            leverage_factor=1.0 + 2.0 * rng.random(),
            n=900,
            n_effective=300.0,
            walk_rate=0.012,
            hull=hull,
        )
    return ModelForm(
        AircraftReference("espaaro", "0" * 64),
        (FlightUsed("made up", "0" * 64, 18.0, 900),),
        Filtering(6.0, 2.0, 0.5, 50.0),
        0.95,
        outside,
        out,
    )


def with_parts(
    form: ModelForm,
    persistent: float = 0.003,
    transient: float | Mapping[str, float] = 0.0,
    time_s: float = 0.5,
    missing: Collection[str] | None = None,
) -> ModelForm:
    """The form with its model error told apart; ``transient`` of every coefficient, or of those
    named.

    missing: coefficients whose model error counts as found; by default all.
    """
    result = {}
    for name, bounds in form.coefficients.items():
        size = transient.get(name, 0.0) if isinstance(transient, Mapping) else transient
        result[name] = replace(
            bounds,
            parts=Parts(
                persistent=persistent,
                transient=size,
                flight=float("nan"),
                transient_time_s=time_s if size else float("nan"),
                noise=0.01,
                noise_scale=1.0,
                total_dof=40.0,
                total_t=2.02,
                not_above=0.02,
                found=missing is None or name in missing,
            ),
        )
    return replace(form, coefficients=result)


def bounds_from(
    x, y, states=("alpha_rad",), order=1, f=1.0, centre=None, scale=None
) -> CoefficientBounds:
    """Least squares written out: with every sample worth 1/f."""
    x = np.atleast_2d(np.asarray(x, dtype=float).T).T
    centre = np.zeros(x.shape[1]) if centre is None else centre
    scale = np.ones(x.shape[1]) if scale is None else scale
    terms = full_polynomial(x.shape[1], order)
    X = regressors((x - centre) / scale, terms)
    C = np.linalg.inv(X.T @ X)
    beta = C @ X.T @ y
    n, m = X.shape
    dof = n / f - m
    s2 = float(np.sum((y - X @ beta) ** 2)) / n * (n / f) / dof
    return CoefficientBounds(
        states=states,
        centre=centre,
        scale=scale,
        terms=terms,
        beta_hat=beta,
        XtX_inv=C,
        s2=s2,
        dof=dof,
        t=float(stats.t.ppf(0.975, dof)),
        confidence=0.95,
        leverage_factor=f,
        n=n,
        n_effective=n / f,
        walk_rate=float("nan"),
        hull=Hull(
            x.min(axis=0),
            x.max(axis=0),
            float(np.max(np.sum((X @ C) * X, axis=1))),
            np.quantile(x, [0.25, 0.5, 0.75], axis=0).T,
        ),
    )
