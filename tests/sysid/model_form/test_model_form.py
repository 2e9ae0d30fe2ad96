"""Intervals against statsmodels and known truth; their file; their hull."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest
import statsmodels.api as sm

from sysid.aerodynamics.coefficients import full_polynomial, regressors, term_name
from sysid.aerodynamics.residuals import Cutoffs, ResidualPiece, Residuals, combine_flights
from sysid.errors import LogError
from sysid.model_form.coverage import coverage, leave_one_out
from sysid.model_form.fit import Design, FitOptions, default_designs, fit_bounds, with_walk_rates
from sysid.model_form.model_form import (
    AircraftReference,
    Filtering,
    FlightUsed,
    ModelForm,
    read_model_form,
)

STATES = ("V_mps", "alpha_rad", "q_radps", "theta_rad")
MEAN, SPREAD = np.array([21.0, 0.03, 0.0, 0.06]), np.array([1.5, 0.02, 0.15, 0.08])


def truth(x: np.ndarray) -> np.ndarray:
    """A residual that is a second-order polynomial of the states."""
    z = (x - MEAN) / SPREAD
    return (
        0.002
        + 0.003 * z[:, 1]
        - 0.001 * z[:, 2]
        + 0.0008 * z[:, 1] ** 2
        + 0.0005 * z[:, 0] * z[:, 3]
    )


def made_up(
    seed: int, n: int = 400, pieces: int = 4, noise: float = 0.004, memory: float = 0.0
) -> Residuals:
    """CX, CZ, Cm residuals `truth` plus Gaussian noise (first-order memory a sample); the states
    wander as in flight.
    """
    rng = np.random.default_rng(seed)
    out = []
    for number in range(pieces):
        time = 0.02 * np.arange(n)
        waves = [
            np.sin(2 * np.pi * f * time + 6.3 * rng.random()) for f in rng.uniform(0.1, 0.8, 4)
        ]
        x = MEAN + SPREAD * (
            np.column_stack(waves)
            + 0.5 * rng.standard_normal(4)
            + 0.2 * rng.standard_normal((n, 4))
        )
        white = rng.standard_normal((n, 6))
        e = np.empty((n, 6))
        e[0] = white[0]
        for k in range(1, n):
            e[k] = memory * e[k - 1] + np.sqrt(1 - memory**2) * white[k]
        delta = noise * e + truth(x)[:, None]
        out.append(ResidualPiece(f"m{number}", time, delta, dict(zip(STATES, x.T, strict=True))))
    return Residuals(tuple(out), 0.02, Cutoffs())


def form_of(
    residuals: Residuals,
    options: FitOptions | None = None,
    coefficients: tuple[str, ...] = ("CX", "CZ", "Cm"),
) -> ModelForm:
    designs = {c: default_designs()[c] for c in coefficients}
    fitted = fit_bounds(residuals, designs, options)
    return ModelForm(
        AircraftReference("x", "00"),
        (FlightUsed("f", "11", 32.0, 1600, ("alpha_rad",)),),
        Filtering(6.0, 2.0, 0.5, 50.0),
        (options or FitOptions()).confidence,
        "grow",
        with_walk_rates(fitted, dict.fromkeys(designs, 0.012)),
    )


@pytest.mark.parametrize("confidence", [0.68, 0.95, 0.99])
def test_published_intervals_are_those_of_statsmodels(confidence):
    """Statsmodels on raw states (its own matrix, its own quantile) agrees with ours on normalised
    ones.
    """
    residuals = made_up(1)
    bounds = fit_bounds(residuals, {"CX": Design(STATES)}, FitOptions(confidence, samples="all"))[
        "CX"
    ].bounds
    x = np.column_stack([residuals.states[s] for s in STATES])
    terms = full_polynomial(4)
    fit = sm.OLS(np.concatenate(residuals.columns("CX")), regressors(x - MEAN, terms)).fit()
    new = MEAN + SPREAD * np.random.default_rng(5).uniform(-4, 4, (50, 4))
    theirs = fit.get_prediction(regressors(new - MEAN, terms)).conf_int(
        obs=True, alpha=1 - confidence
    )
    ours = np.column_stack(bounds.interval(dict(zip(STATES, new.T, strict=True))))
    width = theirs[:, 1] - theirs[:, 0]
    assert np.max(np.abs(ours - theirs) / width[:, None]) < 1e-8
    assert bounds.dof == 1600 - 15
    # The comparison can say no: a confidence one percent off is seen.
    other = np.column_stack(
        bounds.interval(dict(zip(STATES, new.T, strict=True)), confidence - 0.01)
    )
    assert np.max(np.abs(other - theirs) / width[:, None]) > 1e-3


def test_the_bounds_enclose_zero_and_the_interval_within_them():
    form = form_of(made_up(2, noise=0.0005))
    states = dict(
        zip(
            STATES,
            (MEAN + SPREAD * np.random.default_rng(0).uniform(-3, 3, (200, 4))).T,
            strict=True,
        )
    )
    b = form.coefficients["CX"]
    low, high = b.interval(states)
    lower, upper = b.bounds(states)
    assert np.all(lower <= 0.0)
    assert np.all(upper >= 0.0)
    assert (low > 0.0).any()
    assert (high < 0.0).any()
    assert np.array_equal(lower, np.where(low < 0.0, low, 0.0))
    assert np.array_equal(upper, np.where(high > 0.0, high, 0.0))


def test_autocorrelation_breaks_the_published_interval_and_effective_samples_mend_it():
    """At 20 samples' memory over 32 s the fit follows the noise: counted one by one the samples
    promise too much.
    """
    published, ours, effective = [], [], []
    for seed in range(25):
        result, new = made_up(seed, memory=0.9), made_up(1000 + seed, memory=0.9)
        published.append(
            coverage(form_of(result, FitOptions(samples="all"), ("CX",)), new)["CX"].share[0.95]
        )
        form = form_of(result, coefficients=("CX",))
        ours.append(coverage(form, new)["CX"].share[0.95])
        effective.append(form.coefficients["CX"].n_effective)
    assert np.mean(published) < 0.925
    assert np.mean(ours) == pytest.approx(0.95, abs=0.02), (np.mean(published), np.mean(ours))
    assert np.mean(effective) == pytest.approx(1600 * (1 - 0.9) / (1 + 0.9), rel=0.4)


def test_the_file_keeps_every_bit(tmp_path):
    form = form_of(made_up(5))
    form = dataclasses.replace(
        form,
        outside="clamp",
        filtering=Filtering(6.0, float("inf"), 0.5, 50.0),
        coefficients={
            **form.coefficients,
            "CX": dataclasses.replace(form.coefficients["CX"], walk_rate=float("nan")),
        },
    )
    path = tmp_path / "model-form.json"
    form.write(path)
    repeat = read_model_form(path)
    assert repeat.to_json() == form.to_json()
    assert repeat.flights == form.flights
    assert np.isnan(repeat.coefficients["CX"].walk_rate)
    assert repeat.filtering.airspeed_cutoff_hz == float("inf")
    states = dict(zip(STATES, (MEAN + 3 * SPREAD)[:, None], strict=True))
    for c, (low, high) in form.bounds(states).items():
        assert np.array_equal([low, high], repeat.bounds(states)[c])
    assert "NaN" not in path.read_text()
    assert "Infinity" not in path.read_text()


@pytest.mark.parametrize(
    ("change", "output"),
    [
        (lambda d: d.pop("format"), "is no model form"),
        (lambda d: d["coefficients"]["CX"].pop("s2"), "lacks the key 's2'"),
        (lambda d: d["coefficients"]["CX"]["beta_hat"].pop(), "beta_hat must be 15 finite numbers"),
        (
            lambda d: d["coefficients"]["CX"]["terms"].__setitem__(1, "V_kt"),
            "'V_kt' is not among the states",
        ),
        (
            lambda d: d["coefficients"]["CX"].update(
                states=["V_mps", "alpha_rad", "q_radps", "speed"]
            ),
            "states holds",
        ),
        (
            lambda d: d["coefficients"].update(CL=d["coefficients"].pop("CX")),
            "'CL' is no coefficient",
        ),
        (lambda d: d.update(outside="shrink"), "allowed are grow and clamp"),
        (lambda d: d["coefficients"]["CX"].update(s2=-1.0), "must not be negative"),
        (lambda d: d["coefficients"].clear(), "holds no coefficient"),
    ],
)
def test_a_damaged_file_is_refused_in_words(tmp_path, change, output):
    document = json.loads(form_of(made_up(6)).to_json())
    change(document)
    path = tmp_path / "form.json"
    path.write_text(json.dumps(document))
    with pytest.raises(LogError) as refused:
        read_model_form(path)
    assert output in str(refused.value)
    assert "form.json" in str(refused.value)


def test_no_file_and_no_json_are_refused(tmp_path):
    path = tmp_path / "form.json"
    with pytest.raises(LogError, match="cannot be read"):
        read_model_form(path)
    path.write_text("{")
    with pytest.raises(LogError, match="line 1"):
        read_model_form(path)


def test_collinear_states_leave_terms_out_and_the_bounds_finite():
    residuals = made_up(10)
    tied = [
        dataclasses.replace(p, states={**p.states, "theta_rad": 0.5 * p.states["alpha_rad"]})
        for p in residuals.pieces
    ]
    fitted = fit_bounds(Residuals(tuple(tied), 0.02, Cutoffs()), {"CX": Design(STATES)})["CX"]
    assert len(fitted.bounds.terms) == 10
    assert "theta_rad" in fitted.notes[0]
    assert np.isfinite(fitted.bounds.XtX_inv).all()


def test_a_short_flight_lowers_the_order_and_too_short_a_one_is_refused():
    short = fit_bounds(made_up(11, n=60, pieces=1, memory=0.7), {"CX": Design(STATES)})["CX"]
    assert len(short.bounds.terms) < 15
    assert any("too short a flight for order 2" in note for note in short.notes)
    with pytest.raises(ValueError, match="fly longer or choose fewer terms"):
        fit_bounds(made_up(11, n=20, pieces=1), {"CX": Design(STATES, full_polynomial(4))})


def test_stepwise_keeps_the_true_terms():
    fitted = fit_bounds(
        made_up(12, noise=0.001), {"CX": Design(STATES)}, FitOptions(select="stepwise")
    )["CX"]
    names = {term_name(t, STATES) for t in fitted.bounds.terms}
    assert {"1", "alpha_rad", "q_radps", "alpha_rad^2", "V_mps*theta_rad"} <= names
    assert len(names) <= 8
    assert "stepwise choice" in fitted.notes[0]


def test_a_manoeuvre_of_its_own_kind_is_found_by_leaving_it_out():
    """One manoeuvre carries an offset that no state explains: inside the others' bounds it
    is rare.
    """
    residuals = made_up(13)
    odd = dataclasses.replace(residuals.pieces[2], delta=residuals.pieces[2].delta + 0.02)
    changed = Residuals((*residuals.pieces[:2], odd, residuals.pieces[3]), 0.02, Cutoffs())
    result = leave_one_out(changed, {"CX": Design(STATES)}, FitOptions())
    assert result["m2"]["CX"] < 0.2
    assert result["m0"]["CX"] > 0.9
    assert leave_one_out(residuals.only(["m0"]), {"CX": Design(STATES)}, FitOptions()) == {}


def test_pieces_of_one_name_are_left_out_by_stretch():
    residuals = made_up(13, n=150, pieces=24)
    same = tuple(
        dataclasses.replace(p, label="excited", time_s=p.time_s + 10.0 * k)
        for k, p in enumerate(residuals.pieces)
    )
    result = leave_one_out(Residuals(same, 0.02, Cutoffs()), {"CX": Design(STATES)}, FitOptions())
    assert len(result) == 10
    assert "excited, 0 to 23 s" in result
    assert np.mean([row["CX"] for row in result.values()]) == pytest.approx(0.95, abs=0.02)


def test_flights_of_other_filters_are_not_mixed():
    with pytest.raises(ValueError, match="different cut-offs"):
        combine_flights([made_up(1), dataclasses.replace(made_up(2), cutoffs=Cutoffs(3.0))])
    with pytest.raises(ValueError, match="no beta_rad"):
        fit_bounds(made_up(1))
